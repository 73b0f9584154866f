"""Cantilever in large bending: a slender strip under a tip load or its own weight, against the elastica.

Set-up. A strip of length 1 and thickness 1/slenderness, dimensionless, clamped at x = 0; neo-Hookean, nu = 0, with E
such that E I = 1. The load grows slowly: a dead force on the end face, or gravity. Its measure is P = P L**2 / (E I)
for the tip load and P = q L**3 / (E I) for the weight q per length.

Measured. `tip`: the downward deflection of the middle of the end face, divided by L.

Reference. Exact solution of the inextensible elastica, by quadrature. A strip also stretches and shears, which adds to
the deflection by the order of its thickness squared: 0.7 % at slenderness 10, less than 1e-4 at 100.

What must fail. Linear triangles lock in shear: far too stiff unless the cells are much thinner than the strip. Material
points with linear shape functions cross cells as the strip turns, and it may tear. PFEM with linear triangles is as
stiff as they are, and an alpha shape that is too small cuts the strip. Explicit steps are limited by the thickness: the
cost grows with slenderness.

Length. The thickness.
"""

from __future__ import annotations

import math

from geofem.reference import reference, table
from geofem.scene import Box, History, Load, Material, Measure, Probe, Reference, Region, Scene, Support
from geofem.scenes._parts import at_least, at_most, check_choice, check_number


def elastica(load: str, P: float) -> float:
    """Tip deflection w/L of the inextensible elastica, by shooting from the tip; relative accuracy about 1e-9.

    With s from the tip, theta'' = -P cos(theta) for a tip load and -P s cos(theta) for self weight (Bisshopp and
    Drucker 1945; Frisch-Fay 1962), theta' = 0 at the tip, theta = 0 at the clamp, w' = sin(theta).
    """
    from scipy.integrate import solve_ivp
    from scipy.optimize import brentq

    def slope(s: float, y: tuple[float, float, float]) -> tuple[float, float, float]:
        theta, curvature, _ = y
        shear = P if load == "tip" else P * s
        return curvature, -shear * math.cos(theta), math.sin(theta)

    def at_clamp(tip_angle: float) -> tuple[float, float, float]:
        return solve_ivp(slope, (0.0, 1.0), (tip_angle, 0.0, 0.0), method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1]

    tip_angle = brentq(lambda angle: at_clamp(angle)[0], 0.0, 0.5 * math.pi, xtol=1e-13)
    return float(at_clamp(tip_angle)[2])


def exact_tip(load: str, P: float) -> Reference:
    """The tabulated reference, or for another P one by quadrature."""
    name = f"{load}[P={P:g}]"
    if name in table("v02_cantilever"):
        return reference("v02_cantilever", name)
    return Reference("exact", "quadrature of the elastica when the scene was built, relative accuracy 1e-9", elastica(load, P))


def scene(*, load: str = "tip", P: float = 1.0, slenderness: float = 100.0) -> Scene:
    """Knobs

    load : ``tip`` (dead force on the end face) or ``self_weight``; default ``tip``.
    P : P L**2 / (E I) or q L**3 / (E I), dimensionless; default 1.
    slenderness : length by thickness, dimensionless; default 100.
    """
    check_choice("cantilever", "load", load, ("tip", "self_weight"))
    check_number("cantilever", "P", P, 1e-3, 50.0)
    check_number("cantilever", "slenderness", slenderness, 5.0, 1000.0)
    thickness = 1.0 / slenderness

    def deflection(history: History) -> float:
        return -float(history["tip_uy"][-1])

    if load == "tip":
        loads = (Load("traction", (0.0, -P / thickness), where=at_least(0, 1.0)),)
    else:
        loads = (Load("gravity", (0.0, -P)),)  # the density makes a mass of 1 per length
    return Scene(
        name="cantilever",
        regions=(
            Region(
                "strip",
                Box((0.0, -0.5 * thickness), (1.0, 0.5 * thickness)),
                Material("neo_hooke", 1.0 / thickness, {"E": 12.0 / thickness**3, "nu": 0.0}),
            ),
        ),
        length=thickness,
        supports=(Support("clamp", at_most(0, 0.0), (0, 1)),),
        loads=loads,
        probes=(Probe("tip_uy", "displacement", at=(1.0, 0.0), component=1),),
        measures=(Measure("tip", "-", deflection, reference=exact_tip(load, P)),),
        room=Box((-0.1, -1.1), (1.1, 0.1)),
        at=lambda t: {"P": P * t},
        dimensionless=True,
        knobs={"load": load, "P": P, "slenderness": slenderness},
    )
