"""Two cracks from opposite sides of a plate, each drawn to the hole at its side: paths that mirror each other.

Set-up. A plate 20 x 10, dimensionless, E = 98000, nu = 0.3, plane strain, small strain, with holes of radius 2 at (-7, 2) and
(7, -2) and a crack of length 1 from the left side at -2.15 and from the right side at 2.15. A tension of 100 pulls at the
top and the bottom. The body, its cracks and loads are the same after half a turn. After Bouchard, Bay and Chastel (2003);
dimensions and load as in the input files of Sutula's XFEM_Fracture2D (2holes2crack_buchard2003.geo, Input_Crack.m, Input_BC.m);
the plate is held along short pieces at its corners, where the half turn of the supports costs no reaction.

Measured. `KI` of the left crack at the start; the place `x`, `y` of its tip after a way of 4; `skew`, how far the tips come to be
from where half a turn takes the other one, over their way.

Reference. Overkill: this method on finer meshes in shorter steps. A skew is an error, 0 by symmetry; errors of the place are those
of its coordinates over the way of 4.

What must fail. Meshes that are not the same after half a turn part the two paths by what their intensity factors are off.

Length. 4, the way of the cracks; cells grow away from the middle of both paths.
"""

from __future__ import annotations

import numpy as np

from geofem.reference import reference
from geofem.scene import CRITERIA, Crack, Disc, Growth, History, Load, Material, Measure, Polygon, Probe, Region, Scene, Support
from geofem.scenes._parts import all_of, at_least, at_most, check_choice

TENSION = 100.0
WAY = 4.0
"""How far the faster crack grows."""
PIECE = 0.2
"""Length of the sides that are held at the lower corners."""
LEFT, RIGHT = (-9.0, -2.15), (9.0, 2.15)
CORNERS = ((-10.0, -5.0), (-10.0 + PIECE, -5.0), (10.0 - PIECE, -5.0), (10.0, -5.0), (10.0, 5.0), (-10.0, 5.0))
"""The held pieces end at corners, so that a mesh has sides there."""


def skew(h: History) -> float:
    """How far the tips are from where half a turn would take the other one, over their way."""
    return float(np.hypot(h["x"] + h["x2"], h["y"] + h["y2"]).max() / WAY)


def place(name: str) -> Measure:
    """A coordinate of the left tip at the end."""
    known = reference("c09_bouchard_double_edge", name)
    assert known.value is not None
    target = known.value
    return Measure(name, "-", lambda h: float(h[name][-1]), lambda h: abs(float(h[name][-1]) - target) / WAY, known)


def scene(*, criterion: str = "hoop") -> Scene:
    """Knobs

    criterion : hoop, energy or symmetry, see ``Growth``; default hoop.
    """
    check_choice("bouchard_double_edge", "criterion", criterion, CRITERIA)
    bottom, top = at_most(1, -5.0), at_least(1, 5.0)
    left, right = all_of(bottom, at_most(0, -10.0 + PIECE)), all_of(bottom, at_least(0, 10.0 - PIECE))
    shape = Polygon(CORNERS, (Disc((-7.0, 2.0), 2.0), Disc((7.0, -2.0), 2.0)))
    return Scene(
        name="bouchard_double_edge",
        regions=(Region("plate", shape, Material("linear_elastic", 1.0, {"E": 98000.0, "nu": 0.3})),),
        length=WAY,
        supports=(Support("left_x", left, (0,)), Support("left_y", left, (1,)), Support("right_y", right, (1,))),
        loads=(Load("traction", (0.0, TENSION), where=top), Load("traction", (0.0, -TENSION), where=bottom)),
        cracks=(Crack(((-10.1, LEFT[1]), LEFT)), Crack((RIGHT, (10.1, RIGHT[1])))),
        growth=Growth(WAY, criterion=criterion),
        probes=(
            Probe("KI", "KI", at=LEFT),
            Probe("x", "tip", at=LEFT),
            Probe("y", "tip", at=LEFT, component=1),
            Probe("x2", "tip", at=RIGHT),
            Probe("y2", "tip", at=RIGHT, component=1),
        ),
        measures=(
            Measure("KI", "-", lambda h: float(h["KI"][0]), reference=reference("c09_bouchard_double_edge", "KI")),
            Measure("skew", "-", error=skew),
            *(place(name) for name in ("x", "y")),
        ),
        strain="small",
        singular=((-7.5, -1.7), (7.5, 1.7)),
        dimensionless=True,
        knobs={"criterion": criterion},
    )
