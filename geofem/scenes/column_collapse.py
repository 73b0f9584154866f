"""Collapse of a granular column: how far a heap of grains runs when its wall is taken away.

Set-up. A column of width L0 = 0.1 m and height `a` L0 in plane strain, against a smooth wall at x <= 0 (the plane of
symmetry of a column twice as wide), on a horizontal floor with Coulomb's friction. At t = 0 the other wall is gone and
gravity acts; the run lasts 4 sqrt(H0 / g), when all has come to rest. E = 1.98 MPa, nu = 0.23, density 1800 kg/m3,
phi = 23.2 degrees, no cohesion, no dilation, floor friction 0.466 (Kumar 2015). Laws: `mohr_coulomb`, `drucker_prager`,
or `mu_i`, whose friction grows with the rate of flow (Jop, Forterre and Pouliquen 2006) from the same strength at rest.

Measured. `run_out`: (Lf - L0) / L0; `height`: Hf / L0. Lf and Hf are the coordinates below which 99.8 % of the mass lie,
so that single grains ahead of the front do not count; that is 0.1 to 0.3 L0 short of the very toe.

Reference. A band, not a value. Below: experiments between side walls (Lube and others 2005), 1.2 a to a = 1.8 and
1.9 a**(2/3) from 2.8, whatever the grains, less a tenth for their scatter and a tenth for the toe that is not counted.
Above: simulations of grains in two dimensions (Kumar 2015), 1.67 a and 2.5 a**(2/3), plus a tenth. Where the laws leave a
gap, between a = 1.8 and 2.8, the lower and the higher of the two bound the band. The height: a to a = 1.15 and a**(2/5)
above (Lube and others 2005), with the same margins below and above.

What must fail. A mesh that follows the material tangles at once. Mohr-Coulomb with a constant angle runs too far for a >
1.7 (Kumar 2015): an error of the model that no mesh removes, and that mu(I) is there to lessen; here it takes a twentieth
off. It begins lower than that: at a = 1 affine material points run 1.2, 1.7 and 2.1 with 10, 20 and 40 cells, and so leave
the band, in which coarse cells and flip = 0.998 hold it by numerical friction. Pure flip errs the other way: its noise takes
a seventh off the friction of sheared layers. Domains that follow the flow (CPDI) become needles and break down, unless they
are cut anew (split = 1). A method that smears the front (CEL) or loses points to empty cells shows it here.

Length. The width of the column, L0.
"""

from __future__ import annotations

import math
from dataclasses import replace

from geofem import materials
from geofem.mistake import Mistake
from geofem.reference import reference
from geofem.scene import Box, Load, Material, Measure, Probe, Region, Scene, Support, Wall
from geofem.scenes._parts import at_most, check_choice, check_number

L0, G = 0.1, 9.81
SHARE = 0.998
"""Share of the mass behind the front, and below the top."""
ELASTIC = {"E": 1.98e6, "nu": 0.23}
PHI = 23.2
CONE = ELASTIC | {"c": 0.0, "phi": PHI, "psi": 0.0, "gap": 1.0}
GRAINS = ELASTIC | {"mu_s": math.sin(math.radians(PHI)), "mu_2": math.sin(math.radians(PHI)) + 0.26, "I_0": 0.279, "d": 1.15e-3}
"""At rest mu_s bears as much shear in plane strain as phi does; mu_2 - mu_s and I_0 of glass beads (Jop and others 2006)."""
LAWS = {"mohr_coulomb": CONE, "drucker_prager": CONE, "mu_i": GRAINS}
SHORT, TALL = 1.8, 2.8
"""Aspect ratios up to which and from which the laws of Lube and others (2005) hold."""


def band(a: float) -> tuple[float, float]:
    """Lower and upper bound of the run-out."""
    experiment, grains = (1.2 * a, 1.9 * a ** (2 / 3)), (1.67 * a, 2.5 * a ** (2 / 3))
    if a <= SHORT:
        lower, upper = experiment[0], grains[0]
    elif a >= TALL:
        lower, upper = experiment[1], grains[1]
    else:
        lower, upper = min(experiment), max(grains)
    return 0.8 * lower, 1.1 * upper


def height_band(a: float) -> tuple[float, float]:
    """Lower and upper bound of the final height over L0."""
    height = a if a < 1.15 else a**0.4
    return 0.8 * height, 1.1 * height


def scene(*, a: float = 1.0, law: str = "mohr_coulomb", friction: float = 0.466) -> Scene:
    """Knobs

    a : aspect ratio H0 / L0, dimensionless; default 1.
    law : ``mohr_coulomb``, ``drucker_prager`` or ``mu_i``; default ``mohr_coulomb``.
    friction : Coulomb's coefficient of the floor, dimensionless; default 0.466.
    """
    check_number("column_collapse", "a", a, 0.1, 20.0)
    check_choice("column_collapse", "law", law, LAWS)
    check_number("column_collapse", "friction", friction, 0.0, 1e6)
    if law not in materials.LAWS:
        raise Mistake(f"scene column_collapse: law {law} is not among the materials here; see geofem list materials")
    tall = a * L0
    duration = math.sqrt(tall / G)
    (low, high), (flat, steep) = band(a), height_band(a)
    return Scene(
        name="column_collapse",
        regions=(Region("column", Box((0.0, 0.0), (L0, tall)), Material(law, 1800.0, LAWS[law])),),
        length=L0,
        supports=(Support("symmetry", at_most(0, 0.0), (0,)),),
        loads=(Load("gravity", (0.0, -G)),),
        probes=(
            Probe("front", "quantile", component=0, share=SHARE),
            Probe("top", "quantile", component=1, share=SHARE),
            Probe("mean_velocity", "mean_velocity", component=0),
        ),
        measures=(
            Measure(
                "run_out",
                "-",
                lambda history: float(history["front"][-1]) / L0 - 1,
                reference=replace(reference("g05_column_collapse", "run_out"), lower=low, upper=high),
            ),
            Measure(
                "height",
                "-",
                lambda history: float(history["top"][-1]) / L0,
                reference=replace(reference("g05_column_collapse", "height"), lower=flat, upper=steep),
            ),
        ),
        dynamic=True,
        t_end=4 * duration,
        walls=(Wall("floor", at_most(1, 0.0), (0.0, 1.0), friction),),
        room=Box((0.0, 0.0), ((2 + 2 * high) * L0, tall + 0.5 * L0)),
        at=lambda t: {"T": t / duration},
        savings={"symmetry": 0.5},
        knobs={"a": a, "law": law, "friction": friction},
    )
