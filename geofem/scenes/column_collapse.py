"""Collapse of a granular column: how far a heap of grains runs when its wall is taken away.

Set-up. A column of width L0 = 0.1 m and height `a` L0 in plane strain, against a smooth wall at x <= 0 (the plane of
symmetry of a column twice as wide), on a horizontal floor. At t = 0 the other wall is gone and gravity acts. E = 1.98 MPa,
nu = 0.23, density 1800 kg/m3. `setup`: `kumar`, phi = 23.2 degrees, no cohesion, no dilation, floor friction 0.466 (Kumar 2015);
laws `mohr_coulomb`, `drucker_prager`, or `mu_i`, whose friction grows with the rate of flow (Jop, Forterre and Pouliquen 2006) from
the same strength at rest; to t = 4 sqrt(H0 / g). `lagree`, a rough floor and `mu_i` only, mu_s = 0.32, mu_2 = 0.60, I_0 = 0.4, grains
of H0 / 65 (Lagree, Staron and Popinet 2011); to t = 6 sqrt(H0 / g), when all has come to rest.

Measured. `run_out`: (Lf - L0) / L0; `height`: Hf / L0. Lf and Hf are the coordinates below which 99.8 % of the mass lie,
so that single grains ahead of the front do not count; that is 0.1 to 0.3 L0 short of the very toe. Of `lagree` Lf is the toe.

Reference. Of `kumar` a band, not a value. Below: experiments between side walls (Lube and others 2005), 1.2 a to a = 1.8 and
1.9 a**(2/3) from 2.8, whatever the grains, less a tenth for their scatter and a tenth for the toe that is not counted.
Above: simulations of grains in two dimensions (Kumar 2015), 1.67 a and 2.5 a**(2/3), plus a tenth. Where the laws leave a
gap, between a = 1.8 and 2.8, the lower and the higher of the two bound the band. The height: a to a = 1.15 and a**(2/5)
above (Lube and others 2005), with the same margins below and above. Of `lagree` the law of another solver of the same equations, with
volumes of fluid on a fixed grid: 2.2 a to a = 7, 3.9 a**0.7 above; height 0.65 a**0.35.

What must fail. No continuum of this friction stays in the band at a = 1; what keeps a method there is its numerical friction. At
t = 4 sqrt(H0 / g) nodal solids with Mohr-Coulomb have run 2.41 and 2.57 with 10 and 20 cells, mu(I) as a fluid 2.09 and 2.18; affine
material points 1.2, 1.7 and 2.1 with 10, 20 and 40, and flip = 0.998 holds them in the band at 10. Nothing has come to rest then: that
takes 6 sqrt(H0 / g), in which the solid reaches 2.56 and 2.75. A fluid without change of volume whose friction is the same constant
sin(phi), which shares nothing with it but the nodes, agrees by then where the heap is: 90 and 95 % of the mass lie within 1.20 and 1.64,
against 1.16 and 1.58 of the solid (20 cells); the last hundredth runs on as a layer one cell thick, whose length is known to a fifth only.
With the friction of `lagree` the same fluid has its toe at 1.07, 2.24 and 3.20 for a = 0.5, 1 and 1.42 with 20 cells, where the
law says 1.10, 2.20 and 3.12; tall columns want more cells (a = 4: 7.6 and 8.0 with 10 and 20, for 8.8). Simulations of grains reach 2.5 a
too (Staron and Hinch 2005, as quoted by others). So the equations are solved, and what misses the band is the model: it lacks the
side walls of those experiments, and what the grains of Kumar lose beside friction.

A mesh that follows the material tangles at once. Pure flip errs the other way: its noise takes a seventh off the friction of sheared
layers. Domains that follow the flow (CPDI) become needles and break down, unless they are cut anew (split = 1). A method that smears
the front (CEL) or loses points to empty cells shows it here.

Length. The width of the column, L0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from geofem import materials
from geofem.mistake import Mistake
from geofem.reference import reference
from geofem.scene import Box, Load, Material, Measure, Probe, Reference, Region, Scene, Support, Wall
from geofem.scenes._parts import at_most, check_choice, check_number

L0, G = 0.1, 9.81
SHARE = 0.998
"""Share of the mass behind the front of grains, and below the top."""
ELASTIC = {"E": 1.98e6, "nu": 0.23}
PHI = 23.2
CONE = ELASTIC | {"c": 0.0, "phi": PHI, "psi": 0.0, "gap": 1.0}
GRAINS = ELASTIC | {"mu_s": math.sin(math.radians(PHI)), "mu_2": math.sin(math.radians(PHI)) + 0.26, "I_0": 0.279, "d": 1.15e-3}
"""At rest mu_s bears as much shear in plane strain as phi does; mu_2 - mu_s and I_0 of glass beads (Jop and others 2006)."""
LAWS = {"mohr_coulomb": CONE, "drucker_prager": CONE, "mu_i": GRAINS}
FINE = 65
"""Grains across the height of the column in the set-up of Lagree and others."""


@dataclass(frozen=True)
class Setup:
    """laws : that it knows, its own first. friction : of the floor. end : of the run, over sqrt(H0 / g). share : of the mass behind
    the front."""

    laws: tuple[str, ...]
    friction: float
    end: float
    share: float


SETUPS = {"kumar": Setup(tuple(LAWS), 0.466, 4.0, SHARE), "lagree": Setup(("mu_i",), math.inf, 6.0, 1.0)}
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


def continuum(a: float) -> tuple[float, float]:
    """Run-out and height over L0 that mu(I) on a fixed grid gives (Lagree and others 2011)."""
    return (2.2 * a if a <= 7.0 else 3.9 * a**0.7), 0.65 * a**0.35


def references(setup: str, a: float) -> tuple[Reference, Reference]:
    """Of the run-out and of the height."""
    suffix = "" if setup == "kumar" else f"_{setup}"
    run_out, height = (reference("g05_column_collapse", name + suffix) for name in ("run_out", "height"))
    if setup == "lagree":
        far, high = continuum(a)
        return replace(run_out, value=far), replace(height, value=high)
    (low, up), (flat, steep) = band(a), height_band(a)
    return replace(run_out, lower=low, upper=up), replace(height, lower=flat, upper=steep)


def scene(*, a: float = 1.0, setup: str = "kumar", law: str | None = None, friction: float | None = None) -> Scene:
    """Knobs

    a : aspect ratio H0 / L0, dimensionless; default 1.
    setup : ``kumar`` or ``lagree``; default ``kumar``.
    law : ``mohr_coulomb`` (the default of kumar), ``drucker_prager`` or ``mu_i`` (the only one of lagree).
    friction : Coulomb's coefficient of the floor, dimensionless; by default that of the set-up, 0.466 or rough.
    """
    check_number("column_collapse", "a", a, 0.1, 20.0)
    check_choice("column_collapse", "setup", setup, SETUPS)
    its, knobs = SETUPS[setup], {"a": a, "setup": setup, "law": law, "friction": friction}
    law = its.laws[0] if law is None else law
    check_choice("column_collapse", "law", law, its.laws)
    if friction is None:
        friction = its.friction
    else:
        check_number("column_collapse", "friction", friction, 0.0, 1e6)
    if law not in materials.LAWS:
        raise Mistake(f"scene column_collapse: law {law} is not among the materials here; see geofem list materials")
    tall = a * L0
    duration = math.sqrt(tall / G)
    run_out, height = references(setup, a)
    furthest = run_out.upper if run_out.value is None else 1.2 * run_out.value
    assert furthest is not None
    parameters = LAWS[law] if setup == "kumar" else ELASTIC | {"mu_s": 0.32, "mu_2": 0.6, "I_0": 0.4, "d": tall / FINE}
    return Scene(
        name="column_collapse",
        regions=(Region("column", Box((0.0, 0.0), (L0, tall)), Material(law, 1800.0, parameters)),),
        length=L0,
        supports=(Support("symmetry", at_most(0, 0.0), (0,)),),
        loads=(Load("gravity", (0.0, -G)),),
        probes=(
            Probe("front", "quantile", component=0, share=its.share),
            Probe("top", "quantile", component=1, share=SHARE),
            Probe("mean_velocity", "mean_velocity", component=0),
        ),
        measures=(
            Measure("run_out", "-", lambda history: float(history["front"][-1]) / L0 - 1, reference=run_out),
            Measure("height", "-", lambda history: float(history["top"][-1]) / L0, reference=height),
        ),
        dynamic=True,
        t_end=its.end * duration,
        walls=(Wall("floor", at_most(1, 0.0), (0.0, 1.0), friction),),
        room=Box((0.0, 0.0), ((2 + 2 * furthest) * L0, tall + 0.5 * L0)),
        at=lambda t: {"T": t / duration},
        savings={"symmetry": 0.5},
        knobs=knobs,
    )
