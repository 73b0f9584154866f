"""Axis-aligned displacement: a block that swells and shrinks in waves along its axes, with an exact motion in space and time.

Set-up. A unit square (m) in plane strain, neo-Hookean, density 1000 kg/m3, on rollers on all four sides. The motion is
manufactured (Sadeghirad, Brannon and Burghardt 2011): u_i = A sin(2 pi X_i) sin(w t + phi_i), with phases 0 and pi, so
that one direction is stretched where the other is squeezed; the body force that drives it follows from the balance of
momentum. It starts undeformed, with the exact velocity, and swings for one period, 2 pi / w. Two forms:
`dim` 2: E = 10 MPa, nu = 0.3, w = pi sqrt(E / density), period 0.02 s;
`dim` 1: u_x alone, E = 1 MPa, nu = 0.3, w = 2 pi times the speed of compression waves, in a strip 1 / `strip` high
between rollers. Set `strip` to the number of cells n along it, so that it is one cell high.

Measured. Error `displacement`: the root mean square of |u - exact| over the body and over time, divided by A.

Reference. Exact; the supports hold where nothing moves, so that nothing but the method makes an error.

What must fail. Points that carry no domain, or one of fixed size, stop integrating well once they move by whole cells,
and the error then grows as the cells shrink: with linear shape functions as soon as points cross cells (A n of 0.5 or
so), with GIMP and quadratic B-splines from about A n = 3 on. Domains that follow the deformation (CPDI) stay at order 2.
Finite elements converge at their own order at any A below 1 / 2 pi.

Length. The side of the square, 1 m.
"""

from __future__ import annotations

import math

import numpy as np

from geofem.materials import lame
from geofem.mistake import Mistake
from geofem.reference import reference
from geofem.scene import Array, Box, History, Load, Material, Measure, Probe, Region, Scene, Support
from geofem.scenes._parts import any_of, at_least, at_most, check_choice, check_number

DENSITY, NU = 1000.0, 0.3
E = {1: 1e6, 2: 1e7}
"""Young's modulus (Pa) by ``dim``."""
PHASE = (0.0, math.pi)
K = 2 * math.pi
"""Wave number (1/m)."""


def frequency(dim: int) -> float:
    """Circular frequency w of the motion (1/s)."""
    lam, mu = lame(E[dim], NU)
    return K * math.sqrt((lam + 2 * mu) / DENSITY) if dim == 1 else math.pi * math.sqrt(E[dim] / DENSITY)


def swing(A: float, dim: int, t: float) -> tuple[float, ...]:
    """A sin(w t + phi_i) of each direction (m); none of the second if ``dim`` is 1."""
    w = frequency(dim)
    return tuple(A * math.sin(w * t + PHASE[i]) if i < dim else 0.0 for i in range(2))


def exact_displacement(A: float, dim: int, x: Array, t: float) -> Array:
    """Displacement (2, n) of the points x (2, n) at the time t (m)."""
    return np.array([a * np.sin(K * x[i]) for i, a in enumerate(swing(A, dim, t))])


def exact_velocity(A: float, dim: int, x: Array, t: float) -> Array:
    """Velocity (2, n) of the points x (2, n) at the time t (m/s)."""
    w = frequency(dim)
    return np.array([(A * w * math.cos(w * t + PHASE[i]) if i < dim else 0.0) * np.sin(K * x[i]) for i in range(2)])


def body_force(A: float, dim: int, x: Array, t: float) -> Array:
    """Body force per mass (2, n) at the points x (2, n) and the time t (m/s2).

    F is diagonal, and F_ii depends on X_i alone; from rho0 a = Div P + rho0 b with P = mu (F - F^-T) + lambda ln J F^-T:
    b_i = -w**2 u_i - (mu (1 + F_ii**-2) + lambda (1 - ln J) F_ii**-2) dF_ii/dX_i / rho0.
    """
    lam, mu = lame(E[dim], NU)
    amplitude = swing(A, dim, t)
    F = [1 + a * K * np.cos(K * x[i]) for i, a in enumerate(amplitude)]
    gradient = [-a * K**2 * np.sin(K * x[i]) for i, a in enumerate(amplitude)]
    log_J = np.log(F[0]) + np.log(F[1])
    divergence = [(mu * (1 + f**-2) + lam * (1 - log_J) * f**-2) * df for f, df in zip(F, gradient)]
    return -(frequency(dim) ** 2) * exact_displacement(A, dim, x, t) - np.array(divergence) / DENSITY


def scene(*, A: float = 0.05, dim: int = 2, strip: int = 256) -> Scene:
    """Knobs

    A : amplitude of the displacement (m); default 0.05. The largest stretch is 1 + 2 pi A.
    dim : 2 for the square, 1 for a strip that moves along x alone; default 2.
    strip : the strip is 1 / strip of its length high; default 256. With dim 1 take the method's n, with dim 2 leave it.
    """
    check_number("axis_aligned", "A", A, 1e-9, 0.15)
    check_choice("axis_aligned", "dim", dim, (1, 2))
    check_number("axis_aligned", "strip", strip, 1, 1e6)
    if strip != int(strip):
        raise Mistake(f"scene axis_aligned: strip is a whole number of cells, not {strip!r}")
    height = 1.0 if dim == 2 else 1.0 / strip
    block = Box((0.0, 0.0), (1.0, height))
    period = 2 * math.pi / frequency(dim)

    def error(history: History) -> float:
        t, e = np.asarray(history["t"]), np.asarray(history["displacement_error"])
        if len(t) < 2:
            return float("nan")
        return math.sqrt(np.trapezoid(e**2, t) / (t[-1] - t[0])) / A

    return Scene(
        name="axis_aligned",
        regions=(Region("block", block, Material("neo_hooke", DENSITY, {"E": E[dim], "nu": NU})),),
        length=1.0,
        supports=(
            Support("ends", any_of(at_most(0, 0.0), at_least(0, 1.0)), (0,)),
            Support("rollers", any_of(at_most(1, 0.0), at_least(1, height)), (1,)),
        ),
        loads=(Load("body", lambda x, t: body_force(A, dim, x, t)),),
        probes=(Probe("displacement_error", "displacement_error", exact=lambda x, t: exact_displacement(A, dim, x, t)),),
        measures=(Measure("displacement", "-", error=error, reference=reference("v09_axis_aligned", "displacement")),),
        dynamic=True,
        t_end=period,
        period=period,
        initial_velocity=lambda x: exact_velocity(A, dim, x, 0.0),
        room=block,
        at=lambda t: {"swing": math.sin(frequency(dim) * t)},
        knobs={"A": A, "dim": dim, "strip": strip},
    )
