"""A bar pulled out to several times its length shows at which stretch material points fall apart, and that a mesh does not.

Set-up. A bar of 4 m x 1 m in plane strain, neo-Hookean, E = 10 Pa, nu = 0, density 1000 kg/m3, held at x <= 0 in the
x direction. A body force on its last quarter pulls it out: every point moves at a constant velocity from the start, so
that the first three quarters are stretched evenly by 1 + t / s, until that is `stretch`; the force follows from the
balance of momentum. Over the last quarter the stretch falls to 1 at the free end. As nu = 0 the bar keeps its thickness.
The law is neo-Hooke and not Hencky, whose bar softens beyond a stretch of e.

Measured. `stretch`: the stretch at which the run ended. `stress` (Pa): of four points of the even part, at the end, the
one furthest from the exact stress. Error `displacement`: the root mean square over the body of |u - exact|, largest over
time, divided by the displacement that the end of the even part is meant to reach.

Reference. Exact: a bar that holds together reaches the stretch asked for; its stress is E/2 (stretch - 1/stretch).

What must fail. Material points whose neighbours no longer share a node of the grid: with ppc points per cell and
direction, linear shape functions part from a stretch of ppc on, GIMP from ppc + 1, quadratic B-splines from 2 ppc, as
long as the points are spread evenly. By default the bar is so soft that its waves, 0.1 m/s, are slower than the pull,
and with affine velocities (`transfer=apic`) inertia keeps the points evenly spread: methods part there. Without them
the points drift, and GIMP parts at 2.6, contiguous domains at 6. In a stiff bar (`E` = 1e5) the noise of cell crossing
moves the points as well, and all kernels but CPDI2 part, or ring, early. Domains that stretch with the material and keep
touching (contiguous GIMP, CPDI, CPDI2) hold in the soft bar, and a mesh does in both.

Length. The height of the bar, 1 m.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from geofem.reference import reference
from geofem.scene import Array, Box, History, Load, Material, Measure, Probe, Region, Scene, Support
from geofem.scenes._parts import at_most, check_number

LENGTH, HEIGHT, RATE = 4.0, 1.0, 1.0
"""Size of the bar (m), and the rate at which its stretch grows (1/s)."""
DENSITY = 1000.0
EVEN, FADING = 0.75 * LENGTH, 0.25 * LENGTH
"""The part that is stretched evenly, and the rest, where the force acts (m)."""
PLACES = (0.1, 0.3, 0.5, 0.7)
"""Where the stress is read, as fractions of the bar."""


def profile(X: Array) -> tuple[Array, Array, Array]:
    """g(X) of the motion u = rate t g(X), and its first and second derivative (m, 1, 1/m)."""
    s = np.pi * np.clip((X - EVEN) / FADING, 0.0, 1.0)
    g = np.minimum(X, EVEN) + FADING * (s + np.sin(s)) / (2 * np.pi)
    return g, 0.5 * (1 + np.cos(s)), -0.5 * np.pi / FADING * np.sin(s)


def exact_displacement(x: Array, t: float) -> Array:
    """Displacement (2, n) of the points x (2, n) at the time t (m)."""
    return np.array([RATE * t * profile(x[0])[0], 0 * x[0]])


def body_force(E: float, x: Array, t: float) -> Array:
    """Body force per mass (2, n), m/s2: -dP/dX / rho0 with P = E/2 (F - 1/F) and F = 1 + rate t g'; nothing accelerates."""
    _, g1, g2 = profile(x[0])
    F = 1 + RATE * t * g1
    return np.array([-0.5 * E / DENSITY * (1 + F**-2) * RATE * t * g2, 0 * x[0]])


def exact_stress(E: float, stretch: float) -> float:
    """Cauchy stress along the even part (Pa)."""
    return 0.5 * E * (stretch - 1 / stretch)


def reached(history: History) -> float:
    """The stretch at the last sample."""
    return 1 + RATE * float(history["t"][-1])


def worst_stress(E: float, history: History) -> float:
    """The stress that is furthest from the exact one at the last sample (Pa)."""
    found = np.array([history[f"stress_{k}"][-1] for k in range(len(PLACES))])
    return float(found[np.abs(found - exact_stress(E, reached(history))).argmax()])


def stress_error(E: float, history: History) -> float:
    """Its deviation, relative; nan if the bar was not stretched at all."""
    exact = exact_stress(E, reached(history))
    return abs(worst_stress(E, history) - exact) / exact if exact else float("nan")


def scene(*, stretch: float = 4.0, E: float = 10.0) -> Scene:
    """Knobs

    stretch : stretch of the bar at the end, dimensionless; default 4.
    E : Young's modulus (Pa); default 10. At 1e5 waves pass the bar at 10 m/s, ten heights while the stretch grows by 1.
    """
    check_number("stretch", "stretch", stretch, 1.01, 20.0)
    check_number("stretch", "E", E, 1e-3, 1e9)
    middle = 0.5 * HEIGHT

    def displacement_error(history: History) -> float:
        return float(np.max(history["displacement_error"])) / (EVEN * (stretch - 1))

    return Scene(
        name="stretch",
        regions=(Region("bar", Box((0.0, 0.0), (LENGTH, HEIGHT)), Material("neo_hooke", DENSITY, {"E": E, "nu": 0.0})),),
        length=HEIGHT,
        supports=(Support("symmetry", at_most(0, 0.0), (0,)),),
        loads=(Load("body", lambda x, t: body_force(E, x, t)),),
        probes=(
            Probe("end_ux", "displacement", at=(LENGTH, middle), component=0),
            *(Probe(f"stress_{k}", "stress", at=(place * LENGTH, middle)) for k, place in enumerate(PLACES)),
            Probe("displacement_error", "displacement_error", exact=exact_displacement),
        ),
        measures=(
            Measure("stretch", "-", reached, reference=replace(reference("v10_stretch", "stretch"), value=stretch)),
            Measure(
                "stress",
                "Pa",
                lambda history: worst_stress(E, history),
                error=lambda history: stress_error(E, history),
                reference=replace(reference("v10_stretch", "stress"), value=exact_stress(E, stretch)),
            ),
            Measure("displacement", "-", error=displacement_error, reference=reference("v10_stretch", "displacement")),
        ),
        dynamic=True,
        t_end=(stretch - 1) / RATE,
        initial_velocity=lambda x: exact_displacement(x, 1.0),
        room=Box((0.0, -HEIGHT), (LENGTH * stretch + HEIGHT, 2 * HEIGHT)),
        intact=True,
        at=lambda t: {"stretch": 1 + RATE * t},
        savings={"symmetry": 0.5},
        knobs={"stretch": stretch, "E": E},
    )
