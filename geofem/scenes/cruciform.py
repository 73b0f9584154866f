"""Two cracks that cross in a plate pulled from all sides: the four quarters must part, each from each.

Set-up. A plate 2 x 2, dimensionless, E = 1, nu = 0.3, plane strain, small strain. Two straight cracks of half length a cross in
its middle, along x and y (Rooke and Sneddon 1969 for the infinite plate; Daux et al. 2000 for this method). A unit tension
pulls at all four sides, which may turn freely; the plate is held along short pieces of its sides at the lower right corner.

Measured. The stress intensity factors `KI` at the right tip and `KI_top` at the upper one, and `F` = KI / sqrt(pi a).

Reference. Overkill: finite elements of third order on meshes that follow the cracks, for a = 0.3 and 0.5. By symmetry both
factors are the same.

What must fail. Cracks whose jumps are added without a junction: the quarters are tied in the cell where the cracks cross.

Length. The width of the plate, 2; cells may shrink towards the tips.
"""

from __future__ import annotations

import math

from geofem.scene import Crack, Measure, Probe, Scene
from geofem.scenes._parts import check_number
from geofem.scenes._plate import known, plate

WIDTH = 2.0


def scene(*, a: float = 0.5) -> Scene:
    """Knobs

    a : half length of the cracks, 0.1 to 0.8; default 0.5.
    """
    check_number("cruciform", "a", a, 0.1, 0.8)
    scale = math.sqrt(math.pi * a)
    intensity = known("c06_cruciform", f"a{a:g}", scale)
    tips = ((a, 0.0), (0.0, a), (-a, 0.0), (0.0, -a))
    return Scene(
        name="cruciform",
        length=WIDTH,
        cracks=(Crack((tips[2], tips[0])), Crack((tips[3], tips[1]))),
        probes=(Probe("KI", "KI", at=tips[0]), Probe("KI_top", "KI", at=tips[1])),
        measures=(
            Measure("KI", "-", lambda h: float(h["KI"][-1]), reference=intensity),
            Measure("F", "-", lambda h: float(h["KI"][-1]) / scale, reference=known("c06_cruciform", f"a{a:g}")),
            Measure("KI_top", "-", lambda h: float(h["KI_top"][-1]), reference=intensity),
        ),
        singular=tips,
        knobs={"a": a},
        **plate(WIDTH, WIDTH, (1.0, 1.0)),
    )
