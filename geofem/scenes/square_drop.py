"""A drop that surface tension makes round: it swings through the circle and back.

Set-up. A long liquid cylinder without weight, its section a `square`, at rest at t = 0, or a `disc` of radius R = 1 cm that starts
with the velocity c (x, -y), so that it becomes an ellipse, R (1 + `amplitude` sin(omega t) cos(2 phi)) at small amplitude. The square
has the area of the disc. Density 1000 kg/m3, surface tension 0.07 N/m, viscosity 1 mPa s. Sound, for methods that need it, is 20
times faster than sqrt(sigma / rho R). The run lasts four periods of the main mode.

Measured. `frequency` (Hz): of the disc, from the zero crossings of the horizontal velocity of the material point that starts half a radius
to the right of the middle; of the square, whose ripples cross zero more often than it does, the strongest of the width's record
within a factor of two. `damping` of the disc: the part of the amplitude that is lost in a period; its error is absolute. The
drift of the volume is among the checks of every run.

Reference. Exact for small amplitude (Rayleigh 1879): omega**2 = k (k**2 - 1) sigma / (rho R**3), with k = 2 for the disc, which is the
clean test, and k = 4 for the square, whose amplitude is a tenth of R and not small: it swings about 6 % slower. The amplitude falls
like exp(-2 k (k - 1) nu t / R**2) while it is small and the viscosity too.

What must fail. Surface tension on a polygon acts at its corners: nodes that run together along the surface, or a surface that is found
anew in each step, feed currents that nothing physical drives. A time step longer than the time of the shortest ripple, (rho h**3 / 2 pi
sigma)**(1/2), is unstable if surface tension is taken from the start of the step. Methods without a surface refuse.

Length. The radius of the disc, R.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from geofem.reference import reference
from geofem.scene import Array, Box, Disc, History, Material, Measure, Probe, Region, Scene
from geofem.scenes import _waves
from geofem.scenes._parts import check_choice, check_number

RADIUS, DENSITY, TENSION, VISCOSITY = 0.01, 1000.0, 0.07, 1e-3
SOUND = 20 * math.sqrt(TENSION / (DENSITY * RADIUS))
PERIODS = 4
MODES = {"square": 4, "disc": 2}


def omega(mode: int) -> float:
    """Rayleigh's angular frequency (1/s)."""
    return math.sqrt(mode * (mode**2 - 1) * TENSION / (DENSITY * RADIUS**3))


def frequency(history: History, shape: str) -> float:
    """Of the disc's material point, or the strongest of the square's width (Hz)."""
    t = np.asarray(history["t"])
    if shape == "disc":
        return 1.0 / _waves.period(t, np.asarray(history["velocity"]))
    f = omega(MODES[shape]) / (2 * math.pi)
    return _waves.strongest(t, np.asarray(history["width"]), 0.5 * f, 2 * f)


def scene(*, shape: str = "square", amplitude: float = 0.03) -> Scene:
    """Knobs

    shape : ``square`` or ``disc``; default ``square``.
    amplitude : of the radius of the disc, over R, dimensionless; the square does not ask for it; default 0.03.
    """
    check_choice("square_drop", "shape", shape, MODES)
    check_number("square_drop", "amplitude", amplitude, 1e-4, 0.3)
    mode = MODES[shape]
    w = omega(mode)
    T = 2 * math.pi / w
    half = 0.5 * math.sqrt(math.pi) * RADIUS
    lost = 1.0 - math.exp(-2 * mode * (mode - 1) * VISCOSITY / DENSITY / RADIUS**2 * T)

    def damping(history: History) -> float:
        rate = _waves.decay(np.asarray(history["t"]), np.asarray(history["velocity"]))
        return 1.0 - math.exp(-rate * T)

    def initial_velocity(x: Array) -> Array:
        return amplitude * w * np.array([x[0], -x[1]])

    measures = [
        Measure(
            "frequency",
            "Hz",
            lambda history: frequency(history, shape),
            reference=replace(reference("f06_square_drop", "frequency"), value=w / (2 * math.pi)),
        )
    ]
    if shape == "disc":
        measures.append(
            Measure(
                "damping",
                "-",
                damping,
                error=lambda history: abs(damping(history) - lost),
                reference=replace(reference("f06_square_drop", "damping"), value=lost),
            )
        )
    liquid = Material("newtonian", DENSITY, {"mu": VISCOSITY, "K": DENSITY * SOUND**2, "surface_tension": TENSION})
    body = Disc((0.0, 0.0), RADIUS) if shape == "disc" else Box((-half, -half), (half, half))
    return Scene(
        name="square_drop",
        regions=(Region("drop", body, liquid),),
        length=RADIUS,
        supports=(),
        probes=(
            Probe("velocity", "velocity", at=(0.5 * RADIUS, 0.0), component=0),
            Probe("width", "quantile", component=0, share=1.0),
        ),
        measures=tuple(measures),
        dynamic=True,
        t_end=PERIODS * T,
        period=T,
        initial_velocity=initial_velocity if shape == "disc" else None,
        room=Box((-2 * RADIUS, -2 * RADIUS), (2 * RADIUS, 2 * RADIUS)),
        knobs={"shape": shape, "amplitude": amplitude},
    )
