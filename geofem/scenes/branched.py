"""A crack that forks in a plate in tension: three tips, one junction, mixed modes.

Set-up. A plate 10 x 10, dimensionless, E = 1, nu = 0.3, plane strain, small strain. A crack runs from (-1, 0) to the origin and
forks there into two straight branches of length 1 at angles of +-theta to its way (the crack of Chen and Hasebe 1995, in a
finite plate; Daux et al. 2000 for this method). A unit tension pulls at both ends in y; the plate is held along short pieces
of its sides at the lower right corner only, where uniform tension moves all points alike.

Measured. The stress intensity factors `KI` and `KII` at the tip of the upper branch, and `KI_stem` at that of the stem.

Reference. Overkill: finite elements of third order on meshes that follow the cracks, for theta = 45 degrees.

What must fail. A branch whose jump runs on across the stem: it parts what is whole beyond it.

Length. The width of the plate, 10; cells may shrink towards the tips.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from geofem.scene import Crack, History, Measure, Probe, Scene
from geofem.scenes._parts import check_number
from geofem.scenes._plate import known, plate

WIDTH = 10.0


def last(name: str) -> Callable[[History], float]:
    """The last value of a probe."""
    return lambda history: float(history[name][-1])


def scene(*, theta: float = 45.0) -> Scene:
    """Knobs

    theta : angle of either branch to the way of the stem, 10 to 100 degrees; default 45.
    """
    check_number("branched", "theta", theta, 10.0, 100.0)
    c, s = math.cos(math.radians(theta)), math.sin(math.radians(theta))
    stem, junction, upper, lower = (-1.0, 0.0), (0.0, 0.0), (c, s), (c, -s)
    names = {"KI": upper, "KII": upper, "KI_stem": stem}
    return Scene(
        name="branched",
        length=WIDTH,
        cracks=(Crack((stem, junction, upper)), Crack((junction, lower))),
        probes=tuple(Probe(name, name.removesuffix("_stem"), at=at) for name, at in names.items()),
        measures=tuple(
            Measure(name, "-", last(name), reference=known("c07_branched", f"theta{theta:g}_{name}")) for name in names
        ),
        singular=(stem, upper, lower),
        knobs={"theta": theta},
        **plate(WIDTH, WIDTH),
    )
