"""Bent beam with three holes: a crack that finds its way between them.

Set-up. A beam 20 x 8 on two supports 18 apart, pressed down in the middle of its top by a force of 1; lengths in inches, all
else dimensionless, E = 1, nu = 0.3, plane strain, small strain. Three holes of radius 0.25 lie above each other, 4 to the left
of the load and 2.75, 4.75 and 6.75 above the bottom. A crack of the length a rises from the bottom, b to the left of the load.
The experiment of Ingraffea and Grigoriu (1990) on PMMA, simulated by Bittencourt et al. (1996); dimensions as in the input
files of Sutula's XFEM_Fracture2D (PMMA_3Holes_v3.geo, PMMA_cracks.m). Supports and load are 0.2 wide.

Measured. How near the crack comes to the rim of the `lower`, the `middle` and the `upper` hole, 0 if it runs into it.

Reference. Overkill: this method on 31 000 and 69 000 dofs in steps of 0.05 and 0.03, for (a, b) = (1.5, 5) and (1, 6). With b = 6
the crack leaves the lower hole to its right and runs into the middle one from the left; with b = 5 it bends around the lower
hole, crosses the row of holes between that and the middle one, and passes the middle one on its right. Method `fem` on meshes
that follow the crack takes the same way (gaps 0.107 and 0.155 in steps of 0.1).

What must fail. A mesh that follows the crack is made anew at every step. Steps longer than the distance to a rim miss how
sharply the crack turns there; intensity factors taken where the ring of their integral meets a hole send it elsewhere.

Length. 4, about twice the distance of the holes: the beam is 20 long, but what counts is how well the way between the holes is
resolved. Cells grow away from there.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from geofem.reference import reference, table
from geofem.scene import (
    CRITERIA,
    Crack,
    Disc,
    Growth,
    History,
    Load,
    Material,
    Measure,
    Polygon,
    Probe,
    Reference,
    Region,
    Scene,
    Support,
)
from geofem.scenes._parts import all_of, at_least, at_most, check_choice, check_number

HOLES = {"lower": (-4.0, -1.25), "middle": (-4.0, 0.75), "upper": (-4.0, 2.75)}
RADIUS = 0.25
LENGTH = 4.0
WAY = 4.5
"""How far the crack grows: past the middle hole."""
CORNERS = (
    (-10.0, -4.0), (-9.1, -4.0), (-8.9, -4.0), (8.9, -4.0), (9.1, -4.0), (10.0, -4.0), (10.0, 4.0),
    (0.1, 4.0), (-0.1, 4.0), (-10.0, 4.0),
)  # fmt: skip
"""The pieces that are held and pressed end at corners, so that a mesh has sides there."""


def gap(hole: str) -> Callable[[History], float]:
    """The least distance of the tip from the rim of a hole."""
    x, y = HOLES[hole]
    return lambda h: float((np.hypot(h["x"] - x, h["y"] - y) - RADIUS).clip(0.0).min())


def off(hole: str, known: Reference | None) -> Callable[[History], float] | None:
    """The error of the least distance by the diameter of a hole; None without a reference."""
    if known is None:
        return None
    low, high = (known.value, known.value) if known.value is not None else (known.lower, known.upper)
    assert low is not None and high is not None
    return lambda h: max(0.0, gap(hole)(h) - high, low - gap(hole)(h)) / (2.0 * RADIUS)


def scene(*, a: float = 1.5, b: float = 5.0, criterion: str = "hoop") -> Scene:
    """Knobs

    a : length of the crack at the start, 0.5 to 3; default 1.5.
    b : its distance from the middle of the beam, 4.5 to 8; default 5.
    criterion : hoop, energy or symmetry, see ``Growth``; default hoop.
    """
    check_number("three_holes", "a", a, 0.5, 3.0)
    check_number("three_holes", "b", b, 4.5, 8.0)
    check_choice("three_holes", "criterion", criterion, CRITERIA)
    bottom, top = at_most(1, -4.0), at_least(1, 4.0)
    left, right = (all_of(bottom, at_least(0, x - 0.1), at_most(0, x + 0.1)) for x in (-9.0, 9.0))
    start = (-b, a - 4.0)
    names = {hole: f"a{a:g}_b{b:g}_{hole}" for hole in HOLES}
    known = {hole: reference("c08_three_holes", n) for hole, n in names.items() if n in table("c08_three_holes")}
    shape = Polygon(CORNERS, tuple(Disc(centre, RADIUS) for centre in HOLES.values()))
    return Scene(
        name="three_holes",
        regions=(Region("beam", shape, Material("linear_elastic", 1.0, {"E": 1.0, "nu": 0.3})),),
        length=LENGTH,
        supports=(Support("left_x", left, (0,)), Support("left_y", left, (1,)), Support("right_y", right, (1,))),
        loads=(Load("traction", (0.0, -5.0), where=all_of(top, at_least(0, -0.1), at_most(0, 0.1))),),
        cracks=(Crack(((-b, -4.5), start)),),
        growth=Growth(WAY, criterion=criterion),
        probes=(
            Probe("KI", "KI", at=start),
            Probe("KII", "KII", at=start),
            Probe("x", "tip", at=start),
            Probe("y", "tip", at=start, component=1),
        ),
        measures=tuple(Measure(hole, "in", gap(hole), off(hole, known.get(hole)), known.get(hole)) for hole in HOLES),
        strain="small",
        singular=((-4.2, -0.4),),
        dimensionless=True,
        knobs={"a": a, "b": b, "criterion": criterion},
    )
