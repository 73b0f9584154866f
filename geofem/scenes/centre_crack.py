"""Plate in tension with a crack in its middle: two tips, and the formulas of the handbooks put to the test.

Set-up. A plate 2 x 4, dimensionless, E = 1, nu = 0.3, plane strain, small strain. A straight crack of half length a lies in
its middle, across a unit tension that pulls at both ends, which may turn freely: the plate is held along short pieces of its
sides at the lower right corner only, where uniform tension moves all points alike.

Measured. The stress intensity factor `KI` of the right tip and `F` = KI / sqrt(pi a).

Reference. Overkill: finite elements of third order on meshes that follow the crack, for a = 0.3 and 0.5. For an infinitely
long plate, F = (1 - a / 2 + 0.326 a^2) / sqrt(1 - a) (Tada, Paris and Irwin 1985, as collected by Dowling, Mechanical
Behavior of Materials, figure 8.12).

What must fail. Jumps without functions of the tips: several percent at 80 cells.

Length. The width of the plate, 2; cells may shrink towards the tips.
"""

from __future__ import annotations

import math

from geofem.scene import Crack, Measure, Probe, Scene
from geofem.scenes._parts import check_number
from geofem.scenes._plate import known, plate

WIDTH, HEIGHT = 2.0, 4.0


def scene(*, a: float = 0.5) -> Scene:
    """Knobs

    a : half length of the crack, 0.1 to 0.9; default 0.5.
    """
    check_number("centre_crack", "a", a, 0.1, 0.9)
    scale = math.sqrt(math.pi * a)
    return Scene(
        name="centre_crack",
        length=WIDTH,
        cracks=(Crack(((-a, 0.0), (a, 0.0))),),
        probes=(Probe("KI", "KI", at=(a, 0.0)),),
        measures=(
            Measure("KI", "-", lambda h: float(h["KI"][-1]), reference=known("c04_centre_crack", f"a{a:g}", scale)),
            Measure("F", "-", lambda h: float(h["KI"][-1]) / scale, reference=known("c04_centre_crack", f"a{a:g}")),
        ),
        singular=((-a, 0.0), (a, 0.0)),
        knobs={"a": a},
        **plate(WIDTH, HEIGHT),
    )
