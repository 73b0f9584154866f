"""Half of a strip footing on soil: x = 0 is the plane of symmetry, the footing is 0 <= x <= 1 at y = 0 (m).

    python meshes/footing.py        writes footing.msh beside this file

Physical groups: soil (cells), footing, surface, symmetry, side, base (facets).
"""

from pathlib import Path

import gmsh

half_width, width, depth = 1.0, 5.0, 4.0
coarse, fine = 1.0, 0.15

gmsh.initialize(interruptible=False)
gmsh.option.setNumber("General.Terminal", 0)
gmsh.model.add("footing")
geo = gmsh.model.geo

corners = [
    geo.addPoint(0, -depth, 0, coarse),
    geo.addPoint(width, -depth, 0, coarse),
    geo.addPoint(width, 0, 0, coarse),
    geo.addPoint(half_width, 0, 0, fine),
    geo.addPoint(0, 0, 0, 2 * fine),
]
names = ["base", "side", "surface", "footing", "symmetry"]
lines = [geo.addLine(a, b) for a, b in zip(corners, corners[1:] + corners[:1])]
soil = geo.addPlaneSurface([geo.addCurveLoop(lines)])
geo.synchronize()
for line, name in zip(lines, names):
    gmsh.model.addPhysicalGroup(1, [line], name=name)
gmsh.model.addPhysicalGroup(2, [soil], name="soil")

gmsh.model.mesh.generate(2)
gmsh.write(str(Path(__file__).with_suffix(".msh")))
gmsh.finalize()
