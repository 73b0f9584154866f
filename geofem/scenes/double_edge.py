"""Plate in tension with a crack from either side: two cracks that share the load.

Set-up. A plate 2 x 4, dimensionless, E = 1, nu = 0.3, plane strain, small strain. From the left and the right side, at mid
height, straight cracks run to a depth a, across a unit tension that pulls at both ends, which may turn freely: the plate is
held along short pieces of its sides at the lower right corner only, where uniform tension moves all points alike.

Measured. The stress intensity factor `KI` of the right crack, `F` = KI / sqrt(pi a), and `KI_left` of the left one.

Reference. Overkill: finite elements of third order on meshes that follow the cracks, for a = 0.3 and 0.5. For an infinitely
long plate, F = (1 + 0.122 cos^4(pi a / 2)) sqrt(2 / (pi a) tan(pi a / 2)) (Tada, Paris and Irwin 1985, as collected by
Dowling, Mechanical Behavior of Materials, figure 8.12). By symmetry both factors are the same.

What must fail. Jumps without functions of the tips: several percent at 80 cells.

Length. The width of the plate, 2; cells may shrink towards the tips.
"""

from __future__ import annotations

import math

from geofem.scene import Crack, Measure, Probe, Scene
from geofem.scenes._parts import check_number
from geofem.scenes._plate import known, plate

WIDTH, HEIGHT = 2.0, 4.0
OUTSIDE = 1.1
"""Where the cracks start (|x|), so that they run through the sides."""


def scene(*, a: float = 0.5) -> Scene:
    """Knobs

    a : depth of each crack, 0.1 to 0.8; default 0.5.
    """
    check_number("double_edge", "a", a, 0.1, 0.8)
    scale, tip = math.sqrt(math.pi * a), 0.5 * WIDTH - a
    intensity = known("c05_double_edge", f"a{a:g}", scale)
    return Scene(
        name="double_edge",
        length=WIDTH,
        cracks=(Crack(((-OUTSIDE, 0.0), (-tip, 0.0))), Crack(((OUTSIDE, 0.0), (tip, 0.0)))),
        probes=(Probe("KI", "KI", at=(tip, 0.0)), Probe("KI_left", "KI", at=(-tip, 0.0))),
        measures=(
            Measure("KI", "-", lambda h: float(h["KI"][-1]), reference=intensity),
            Measure("F", "-", lambda h: float(h["KI"][-1]) / scale, reference=known("c05_double_edge", f"a{a:g}")),
            Measure("KI_left", "-", lambda h: float(h["KI_left"][-1]), reference=intensity),
        ),
        singular=((-tip, 0.0), (tip, 0.0)),
        knobs={"a": a},
        **plate(WIDTH, HEIGHT),
    )
