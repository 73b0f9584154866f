"""Notched square in shear: a crack that turns down at once, and stays on its new way.

Set-up. A unit square, dimensionless, E = 210, nu = 0.3, plane strain, small strain, with a notch from the middle of its left side
to its centre. The bottom is held; the top moves by 0.01 to the right and stays level (Bourdin, Francfort and Marigo 2000;
Miehe, Welschinger and Hofacker 2010).

Measured. The `kink` at the start, degrees below the notch; `KI` of the notch; the `chord`, the direction from the notch's tip to the
crack's at the end, degrees below the notch.

Reference. Exact. A square that is the same after half a turn or a reflection, sheared, does not open its middle line: K_I = 0. The
kink in pure shear is arccos(1/3) = 70.529 degrees by the largest hoop stress (Erdogan and Sih 1963), and 75.76 and 77.33 by
energy and symmetry with the expansions of Amestoy and Leblond (1992). All three go on alike: the chord is 66.7 degrees by each.

What must fail. Models that do not tell tension from pressure let a second crack rise above the notch, where K_II turns the other way.

Length. The side of the square, 1; cells may shrink towards the notch's tip.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from geofem.scene import (
    CRITERIA,
    Array,
    Box,
    Crack,
    Growth,
    History,
    Material,
    Measure,
    Probe,
    Reference,
    Region,
    Scene,
    Support,
)
from geofem.scenes._parts import at_least, at_most, check_choice

SHIFT = 0.01
"""How far the top moves to the right."""
WAY = 0.3
"""How far the crack grows: most of the way to the lower side."""
TIP = (0.5, 0.5)
KINKS = {"hoop": math.degrees(math.acos(1.0 / 3.0)), "energy": 75.757, "symmetry": 77.330}
"""In pure shear, degrees."""
SOURCE = "pure shear: Erdogan and Sih (1963); expansions of Amestoy and Leblond (1992)"


def below(last: int) -> Callable[[History], float]:
    """The direction from the notch to the tip of that sample (degrees), positive downwards."""
    return lambda h: math.degrees(math.atan2(h["y"][0] - h["y"][last], h["x"][last] - h["x"][0]))


def shift(x: Array, t: float) -> Array:
    return np.full(x.shape[1], SHIFT)


def scene(*, criterion: str = "hoop") -> Scene:
    """Knobs

    criterion : hoop, energy or symmetry, see ``Growth``; default hoop.
    """
    check_choice("sen_shear", "criterion", criterion, CRITERIA)
    bottom, top = at_most(1, 0.0), at_least(1, 1.0)
    return Scene(
        name="sen_shear",
        regions=(Region("square", Box((0.0, 0.0), (1.0, 1.0)), Material("linear_elastic", 1.0, {"E": 210.0, "nu": 0.3})),),
        length=1.0,
        supports=(
            Support("bottom_x", bottom, (0,)),
            Support("bottom_y", bottom, (1,)),
            Support("top_x", top, (0,), shift),
            Support("top_y", top, (1,)),
        ),
        cracks=(Crack(((-0.1, 0.5), TIP)),),
        growth=Growth(WAY, criterion=criterion),
        probes=(
            Probe("KI", "KI", at=TIP),
            Probe("KII", "KII", at=TIP),
            Probe("x", "tip", at=TIP),
            Probe("y", "tip", at=TIP, component=1),
        ),
        measures=(
            Measure("kink", "deg", below(1), reference=Reference("exact", SOURCE, KINKS[criterion])),
            Measure("KI", "-", lambda h: float(h["KI"][0]), reference=Reference("exact", "Symmetry", 0.0)),
            Measure("chord", "deg", below(-1)),
        ),
        strain="small",
        singular=(TIP,),
        dimensionless=True,
        knobs={"criterion": criterion},
    )
