"""Axial vibration of a bar in its first mode: who keeps the period and the energy over ten periods.

Set-up. A bar of 25 m, fixed at x <= 0 and free at the other end, rollers above and below, neo-Hookean, E = 100 Pa, nu =
0, density 1 kg/m3 (after Bardenhagen and Kober 2004); it starts straight with the velocity v0 sin(pi x / 2L) and swings
for 100 s.

Measured. `period` (s), from the zero crossings of the velocity of the centre of mass over the whole record; the drift
of the energy is among the checks of every run.

Reference. Exact for small amplitude: 4 L sqrt(rho / E) = 10 s. The neo-Hookean law shortens the period by less than
1e-5 at v0 = 0.1 m/s and by 4e-4 at 0.75 m/s (computed in the tests).

What must fail. At v0 = 0.1 m/s material points stay within their cells and nobody may. At 0.75 m/s they cross cells:
with linear shape functions the energy grows or the particles ring; PIC loses energy at any amplitude. Methods that
transfer the velocity to a new mesh (ALE, PFEM) diffuse it.

Length. The bar's, 25 m: 16, 32, 64 ... cells along it make square ones.
"""

from __future__ import annotations

import numpy as np

from geofem.reference import reference
from geofem.scene import Array, Box, History, Material, Measure, Probe, Region, Scene, Support
from geofem.scenes import _waves
from geofem.scenes._parts import any_of, at_least, at_most, check_number

LENGTH, HEIGHT = 25.0, 25.0 / 16
PERIODS = 10


def period(history: History) -> float:
    """Of the velocity of the centre of mass (s); nan for a record of less than half a period."""
    return _waves.period(np.asarray(history["t"]), np.asarray(history["mean_velocity"]))


def scene(*, v0: float = 0.1) -> Scene:
    """Knobs

    v0 : largest initial velocity, that of the free end (m/s); default 0.1.
    """
    check_number("axial", "v0", v0, 1e-6, 2.0)

    def initial_velocity(x: Array) -> Array:
        return np.array([v0 * np.sin(0.5 * np.pi * x[0] / LENGTH), 0 * x[0]])

    exact = reference("v04_axial", "period")
    assert exact.value is not None
    return Scene(
        name="axial",
        regions=(Region("bar", Box((0.0, 0.0), (LENGTH, HEIGHT)), Material("neo_hooke", 1.0, {"E": 100.0, "nu": 0.0})),),
        length=LENGTH,
        supports=(
            Support("wall", at_most(0, 0.0), (0,)),
            Support("rollers", any_of(at_most(1, 0.0), at_least(1, HEIGHT)), (1,)),
        ),
        probes=(Probe("mean_velocity", "mean_velocity", component=0),),
        measures=(Measure("period", "s", period, reference=exact),),
        dynamic=True,
        t_end=PERIODS * exact.value,
        period=exact.value,
        initial_velocity=initial_velocity,
        room=Box((0.0, 0.0), (LENGTH + 4 * HEIGHT, HEIGHT)),
        knobs={"v0": v0},
    )
