"""Homogeneous slope of Griffiths and Lane (1999), example 1: two to one, height 1 (m), base at the level of the toe.

    python meshes/slope.py          writes slope.msh beside this file, of quadratic triangles

The crest is 1.2 wide; the toe is at (3.2, 0). Physical groups: soil (cells), base, back, crest, face (facets).
"""

from pathlib import Path

import gmsh

height, crest = 1.0, 1.2
toe = crest + 2 * height
size = 0.25

gmsh.initialize(interruptible=False)
gmsh.option.setNumber("General.Terminal", 0)
gmsh.model.add("slope")
geo = gmsh.model.geo

corners = [geo.addPoint(x, y, 0, size) for x, y in ((0, 0), (toe, 0), (crest, height), (0, height))]
lines = [geo.addLine(a, b) for a, b in zip(corners, corners[1:] + corners[:1])]
soil = geo.addPlaneSurface([geo.addCurveLoop(lines)])
geo.synchronize()
for line, name in zip(lines, ["base", "face", "crest", "back"]):
    gmsh.model.addPhysicalGroup(1, [line], name=name)
gmsh.model.addPhysicalGroup(2, [soil], name="soil")

gmsh.model.mesh.generate(2)
gmsh.model.mesh.setOrder(2)
gmsh.write(str(Path(__file__).with_suffix(".msh")))
gmsh.finalize()
