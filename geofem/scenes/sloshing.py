"""Sloshing: the first standing wave in a tank, who keeps its period and its height over four periods.

Set-up. A tank L = 1 m wide with smooth walls, water h = 0.5 m deep, density 1000 kg/m3, gravity 9.81 m/s2. At t = 0 the
surface is level and the water moves as in the first mode of linear theory, without divergence or rotation, so that the surface
will be A sin(omega t) cos(pi x / L). Kinematic viscosity `nu`. Sound, for methods that need it, is 20 times faster than
sqrt(g h). The run lasts four periods.

Measured. `period` (s): from the zero crossings of the horizontal velocity of the centre of mass, to which the second harmonic of
the wave, about pi A / L of it, adds nothing. `damping`: the part of the amplitude that is lost in one period, from the peaks of the
same velocity; its error is absolute, so that 0.01 is a hundredth of the amplitude a period. The drift of the volume is
among the checks of every run. `wall` in the history is the rise (m) of the surface at the left wall.

Reference. Exact for small amplitude (Lamb 1932): omega**2 = g k tanh(k h) with k = pi / L, a period of 1.1818 s; the amplitude
falls like exp(-2 nu k**2 t) for small viscosity. Finite amplitude changes the period by a part of the order of (pi A / L)**2,
2.5e-4 for A = 5 mm.

What must fail. Backward Euler loses 7 % of the amplitude a period at 120 steps a period, half as much at 240. A mesh whose volume
drifts moves the level. A boundary search that changes its mind about flat cells at the surface makes waves of its own. Material
points lose the amplitude by their transfers, see rough surfaces, and ring with sound, for the water starts without its pressure.

Length. The width of the tank, L.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from geofem.reference import reference
from geofem.scene import Array, Box, History, Load, Material, Measure, Probe, Region, Scene, Wall
from geofem.scenes import _waves
from geofem.scenes._parts import at_least, at_most, check_number

WIDTH, DEPTH, G, DENSITY = 1.0, 0.5, 9.81, 1000.0
K = math.pi / WIDTH
"""Wave number (1/m)."""
OMEGA = math.sqrt(G * K * math.tanh(K * DEPTH))
SOUND = 20 * math.sqrt(G * DEPTH)
PERIODS = 4


def period(history: History) -> float:
    """Of the horizontal velocity of the centre of mass (s)."""
    return _waves.period(np.asarray(history["t"]), np.asarray(history["mean_velocity"]))


def damping(history: History) -> float:
    """The part of the amplitude that is lost in a period."""
    rate = _waves.decay(np.asarray(history["t"]), np.asarray(history["mean_velocity"]))
    return 1.0 - math.exp(-rate * 2 * math.pi / OMEGA)


def scene(*, A: float = 0.005, nu: float = 1e-6) -> Scene:
    """Knobs

    A : amplitude of the wave at the walls (m); default 0.005.
    nu : kinematic viscosity (m2/s); default 1e-6.
    """
    check_number("sloshing", "A", A, 1e-6, 0.02)
    check_number("sloshing", "nu", nu, 0.0, 0.01)
    exact = reference("f01_sloshing", "period")
    assert exact.value is not None
    lost = 1.0 - math.exp(-2 * nu * K**2 * exact.value)

    def initial_velocity(x: Array) -> Array:
        speed = A * OMEGA / math.sinh(K * DEPTH)
        return speed * np.array([-np.cosh(K * x[1]) * np.sin(K * x[0]), np.sinh(K * x[1]) * np.cos(K * x[0])])

    return Scene(
        name="sloshing",
        regions=(
            Region(
                "water",
                Box((0.0, 0.0), (WIDTH, DEPTH)),
                Material("newtonian", DENSITY, {"mu": nu * DENSITY, "K": DENSITY * SOUND**2}),
            ),
        ),
        length=WIDTH,
        supports=(),
        loads=(Load("gravity", (0.0, -G)),),
        probes=(
            Probe("mean_velocity", "mean_velocity", component=0),
            Probe("wall", "displacement", at=(0.0, DEPTH), component=1),
        ),
        measures=(
            Measure("period", "s", period, reference=exact),
            Measure(
                "damping",
                "-",
                damping,
                error=lambda history: abs(damping(history) - lost),
                reference=replace(reference("f01_sloshing", "damping"), value=lost),
            ),
        ),
        dynamic=True,
        t_end=PERIODS * exact.value,
        period=exact.value,
        initial_velocity=initial_velocity,
        walls=(
            Wall("floor", at_most(1, 0.0), (0.0, 1.0)),
            Wall("left", at_most(0, 0.0), (1.0, 0.0)),
            Wall("right", at_least(0, WIDTH), (-1.0, 0.0)),
        ),
        room=Box((0.0, 0.0), (WIDTH, 1.2 * DEPTH)),
        knobs={"A": A, "nu": nu},
    )
