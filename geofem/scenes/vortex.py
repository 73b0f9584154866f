"""Generalised vortex: a ring sheared back and forth by a body force whose exact motion is known in space and time.

Set-up. A ring 0.75 m <= R <= 1.25 m in plane strain, neo-Hookean, E = 1 kPa, nu = 0.3, density 1000 kg/m3, both circles
held. The motion is manufactured (Kamojjala, Brannon, Sadeghirad and Guilkey 2015): a point at the angle Theta turns to
Theta + alpha(R, t) with alpha = A (1 - cos 2 pi t) / 2 * h(R) and h = 1 - 32 (R - 1)**2 + 256 (R - 1)**4; it keeps its
radius and the volume. The body force that drives it follows from the balance of momentum. The run lasts one cycle, 1 s.

Measured. Error `displacement`: the root mean square over the body of |u - exact|, largest over time, divided by A times
1 m, the arc that the middle of the ring goes at most.

Reference. Exact; no load or support moves, so that nothing but the method makes an error.

What must fail. At A = 1 the largest stretch is 7.2: linear elements carried with the material invert, the
parallelograms of CPDI overlap, material points with linear shape functions cross cells and are lost. A mesh that stays
behind (ALE, CEL) advects the deformation gradient instead and smears it. At A = 0.1 every method converges at its own
order.

Length. The thickness of the ring, 0.5 m.
"""

from __future__ import annotations

import numpy as np

from geofem.reference import reference
from geofem.scene import Array, History, Load, Material, Measure, Probe, Region, Ring, Scene, Support
from geofem.scenes._parts import ROUNDING, check_number

INNER, OUTER = 0.75, 1.25
E, NU, DENSITY = 1000.0, 0.3, 1000.0


def profile(R: Array) -> tuple[Array, Array, Array]:
    """h(R) of the motion and its first and second derivative (1, 1/m, 1/m2); h = h' = 0 on both circles."""
    s = R - 1
    return 1 - 32 * s**2 + 256 * s**4, -64 * s + 1024 * s**3, -64 + 3072 * s**2


def exact_displacement(A: float, x: Array, t: float) -> Array:
    """Displacement (2, n) of the points x (2, n) at the time t (m)."""
    alpha = 0.5 * A * (1 - np.cos(2 * np.pi * t)) * profile(np.hypot(*x))[0]
    c, s = np.cos(alpha), np.sin(alpha)
    return np.array([c * x[0] - s * x[1], s * x[0] + c * x[1]]) - x


def body_force(A: float, x: Array, t: float) -> Array:
    """Body force per mass (2, n) at the points x (2, n) and the time t (m/s2).

    In the polar frame of the current position, with alpha' = d alpha / dR: radially -R alpha_t**2 + mu/rho0 R alpha'**2,
    tangentially R alpha_tt - mu/rho0 (3 alpha' + R alpha''), from rho0 a = Div P + rho0 b with P = mu (F - F^-T), J = 1.
    """
    mu_rho = E / (2 * (1 + NU)) / DENSITY
    R = np.hypot(*x)
    h, h1, h2 = profile(R)
    g = 0.5 * A * (1 - np.cos(2 * np.pi * t))
    speed = np.pi * A * np.sin(2 * np.pi * t) * h
    acceleration = 2 * np.pi**2 * A * np.cos(2 * np.pi * t) * h
    radial = -R * speed**2 + mu_rho * R * (g * h1) ** 2
    tangential = R * acceleration - mu_rho * g * (3 * h1 + R * h2)
    ex, ey = (x + exact_displacement(A, x, t)) / R
    return np.array([radial * ex - tangential * ey, radial * ey + tangential * ex])


def scene(*, A: float = 1.0) -> Scene:
    """Knobs

    A : amplitude, the largest angle of turn (rad); default 1.
    """
    check_number("vortex", "A", A, 1e-6, 3.0)

    def held(x: Array) -> Array:
        R = np.hypot(x[0], x[1])
        return (R <= INNER + ROUNDING) | (R >= OUTER - ROUNDING)

    def error(history: History) -> float:
        return float(np.max(history["displacement_error"])) / A

    return Scene(
        name="vortex",
        regions=(Region("ring", Ring((0.0, 0.0), INNER, OUTER), Material("neo_hooke", DENSITY, {"E": E, "nu": NU})),),
        length=OUTER - INNER,
        supports=(Support("circles", held, (0, 1)),),
        loads=(Load("body", lambda x, t: body_force(A, x, t)),),
        probes=(Probe("displacement_error", "displacement_error", exact=lambda x, t: exact_displacement(A, x, t)),),
        measures=(Measure("displacement", "-", error=error, reference=reference("v05_vortex", "displacement")),),
        dynamic=True,
        t_end=1.0,
        at=lambda t: {"turn": 0.5 * A * (1 - np.cos(2 * np.pi * t))},
        knobs={"A": A},
    )
