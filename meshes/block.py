"""A block of 2 x 1 x 1 (m) in two layers that meet at z = 0.5.

    python meshes/block.py          writes block.msh beside this file

Physical groups: clay below and sand above (cells), base, top (facets).
"""

from pathlib import Path

import gmsh

length, width, thickness = 2.0, 1.0, 0.5
size = 0.6

gmsh.initialize(interruptible=False)
gmsh.option.setNumber("General.Terminal", 0)
gmsh.model.add("block")
occ = gmsh.model.occ

clay = (3, occ.addBox(0, 0, 0, length, width, thickness))
sand = (3, occ.addBox(0, 0, thickness, length, width, thickness))
# without this the two layers would not share the nodes between them
(_, clay_and_sand) = occ.fragment([clay], [sand])
occ.synchronize()
for name, [(dim, tag)] in zip(["clay", "sand"], clay_and_sand):
    gmsh.model.addPhysicalGroup(dim, [tag], name=name)
for name, z in ("base", 0.0), ("top", 2 * thickness):
    faces = gmsh.model.getEntitiesInBoundingBox(-0.1, -0.1, z - 0.1, length + 0.1, width + 0.1, z + 0.1, dim=2)
    gmsh.model.addPhysicalGroup(2, [tag for _, tag in faces], name=name)

for bound in "Min", "Max":
    gmsh.option.setNumber(f"Mesh.MeshSize{bound}", size)
gmsh.model.mesh.generate(3)
gmsh.write(str(Path(__file__).with_suffix(".msh")))
gmsh.finalize()
