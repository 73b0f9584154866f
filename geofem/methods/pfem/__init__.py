"""The particle finite element method: the nodes are the material, and are tessellated anew whenever the mesh asks for it."""
