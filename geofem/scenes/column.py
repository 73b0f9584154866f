"""A column settles under its own weight by half its height: what large strain means, and what linear theory makes of it.

Set-up. A column 50 m high, rollers at the sides and at the base, E = 10 kPa, nu = 0, density 80 kg/m3 before loading
(after Charlton, Coombs and Augarde 2017); gravity of 10 m/s2 grows slowly. As nu = 0, every horizontal strip carries
the same stress. Three laws: Hencky, neo-Hookean, and linear elasticity at small strain. The width, an eighth of the
height, plays no role.

Measured. `settlement` (m): the downward displacement of the top. `base_stress` (Pa): the vertical stress at the base.

Reference. Exact. Statics gives the stress, -rho0 g (H - X) at the height X before loading, for any law; the settlement
is the integral of the strain that the law makes of it, by quadrature.

What must fail. Linear theory: it says 100 m of 50 m. Material points with linear shape functions: their stress
oscillates as they cross cells, and does not converge with the cells at a fixed number of points per cell. Explicit
dynamics overshoots to about twice the settlement unless damped.

Length. The height, 50 m: 8, 16, 32 ... cells over it make square ones.
"""

from __future__ import annotations

from geofem.reference import reference
from geofem.scene import Box, Load, Material, Measure, Probe, Region, Scene, Support
from geofem.scenes._parts import any_of, at_least, at_most, check_choice

HEIGHT, WIDTH = 50.0, 6.25
LAWS = {"hencky": "hencky", "neo_hooke": "neo_hooke", "linear": "linear_elastic"}


def scene(*, law: str = "hencky") -> Scene:
    """Knobs

    law : ``hencky``, ``neo_hooke`` (both at finite strain) or ``linear`` (at small strain); default ``hencky``.
    """
    check_choice("column", "law", law, LAWS)
    return Scene(
        name="column",
        regions=(Region("column", Box((0.0, 0.0), (WIDTH, HEIGHT)), Material(LAWS[law], 80.0, {"E": 1e4, "nu": 0.0})),),
        length=HEIGHT,
        supports=(
            Support("base", at_most(1, 0.0), (1,)),
            Support("sides", any_of(at_most(0, 0.0), at_least(0, WIDTH)), (0,)),
        ),
        loads=(Load("gravity", (0.0, -10.0)),),
        probes=(
            Probe("top_uy", "displacement", at=(0.5 * WIDTH, HEIGHT), component=1),
            Probe("base_stress", "stress", at=(0.5 * WIDTH, 0.0), component=1),
        ),
        measures=(
            Measure(
                "settlement",
                "m",
                lambda history: -float(history["top_uy"][-1]),
                reference=reference("v03_column", f"settlement[law={law}]"),
            ),
            Measure(
                "base_stress",
                "Pa",
                lambda history: float(history["base_stress"][-1]),
                reference=reference("v03_column", "base_stress"),
            ),
        ),
        strain="small" if law == "linear" else "finite",
        knobs={"law": law},
    )
