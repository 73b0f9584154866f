"""Dam break: a column of water collapses in a tank, and its front is timed against Martin and Moyce.

Set-up. A column of water, a = 0.05715 m (2.25 inches) wide and 2 a high, in the corner of a tank with smooth walls; at
t = 0 the gate is gone and gravity acts. Density 1000 kg/m3, viscosity 1 mPa s, weakly compressible: the bulk modulus
makes sound ten times faster than 2 sqrt(2 g a), the fastest that the water can fall. No surface tension. Water bears
the tension in which it is thinned, as a continuum does that is nearly incompressible; without `tension` it parts at zero
pressure instead, sprays, and the gaps count as volume. With `end` before_impact the run goes to T = t sqrt(2 g / a) = 6 in a tank
15 a long; with a time it goes on that long in a tank 4 a long, where the water strikes the far wall at T = 3 or so and
runs up it.

Measured. Error `front`: the front Z = x / a by T between 0.8 and 2.6 against the experiment, after one shift of time;
root mean square, relative. `shift`: that shift, in T. `front_speed`, before impact only: dZ/dT for T from 4 to 6. The front
is where 99.9 % of the mass lie behind. The drift of the volume is among the checks of a run.

Reference. Experiment (Martin and Moyce 1952, column of 2.25 inches). Every code runs ahead of it by a T of 0.28 to 0.31:
the gate takes time to open, and the record starts with it. A shift from 0 to 0.5 is therefore allowed, and 5 % after it;
the late speed, where floor friction and surface tension have their say, should be met within 10 %.

What must fail. A mesh that follows the water tangles within a T of 1 or so unless it is made anew; making it anew by alpha
shapes creates volume, 2 to 6 % here. Weakly compressible water rings with sound, for the column starts without
its pressure. Material points with linear shape functions are noisy in pressure and break down after the impact; domains
that follow the water (CPDI) become needles unless they are cut anew (split = 1).

Length. The width of the column, a.
"""

from __future__ import annotations

import math

import numpy as np

from geofem.mistake import Mistake
from geofem.reference import reference, series
from geofem.scene import Array, Box, History, Load, Material, Measure, Probe, Reference, Region, Scene, Wall
from geofem.scenes._parts import at_least, at_most, check_number

A, G, DENSITY, VISCOSITY = 0.05715, 9.81, 1000.0, 1e-3
UNIT = math.sqrt(A / (2 * G))
"""The time (s) of T = 1."""
FASTEST = 2 * math.sqrt(2 * G * A)
SOUND = 10 * FASTEST
SHARE = 0.999
WINDOW, LATE = (0.8, 2.6), (4.0, 6.0)
"""Ranges of T in which the front and its speed are compared."""
SHIFTS = np.linspace(0.0, 0.5, 501)


def front(history: History) -> tuple[Array, Array]:
    """T and Z of a run."""
    return np.asarray(history["t"]) / UNIT, np.asarray(history["front"]) / A


def compared(history: History, table: tuple[Array, Array]) -> tuple[float, float]:
    """The shift in T that fits best, and the root mean square of the relative deviation of Z that it leaves.

    The experiment at T is compared with the run at T - shift. Raises ``ValueError`` for a run that ended before the window.
    """
    T, Z = front(history)
    times, places = table
    inside = (WINDOW[0] <= times) & (times <= WINDOW[1])
    if T[-1] < times[inside].max():
        raise ValueError(f"the run ended at T = {T[-1]:.3g}, before {WINDOW[1]:g}")
    found = np.interp(times[inside] - SHIFTS[:, None], T, Z)
    left = np.sqrt(np.mean((found / places[inside] - 1) ** 2, axis=1))
    best = int(left.argmin())
    return float(SHIFTS[best]), float(left[best])


def front_speed(history: History) -> float:
    """dZ/dT by least squares over the late range; raises ``ValueError`` for a run that ended before it."""
    T, Z = front(history)
    late = (LATE[0] <= T) & (T <= LATE[1] + 1e-9)
    if T[-1] < LATE[1] - 1e-6 or late.sum() < 2:
        raise ValueError(f"the run ended at T = {T[-1]:.3g}, before {LATE[1]:g}")
    return float(np.polyfit(T[late], Z[late], 1)[0])


def scene(*, end: str | float = "before_impact", tension: bool = True) -> Scene:
    """Knobs

    end : ``before_impact``, or the time at which the run ends in a tank 4 a long (s); default ``before_impact``.
    tension : whether the pressure may fall below zero; default true.
    """
    if not isinstance(tension, bool):
        raise Mistake(f"scene dam_break: tension is true or false, not {tension!r}")
    whole = end == "before_impact"
    if not whole:
        if isinstance(end, str):
            raise Mistake(f"scene dam_break: end is before_impact or a time in seconds, not {end!r}")
        check_number("dam_break", "end", end, WINDOW[1] * UNIT, 10.0)
    t_end = LATE[1] * UNIT if whole else float(end)
    width, height = (15 * A, 3 * A) if whole else (4 * A, 20 * A)
    source, columns = series("dam_break")
    table = columns["T"], columns["Z"]
    late = (Measure("front_speed", "-", front_speed, reference=reference("g06_dam_break", "front_speed")),) if whole else ()
    water = Material(
        "newtonian", DENSITY, {"mu": VISCOSITY, "K": DENSITY * SOUND**2, **({} if tension else {"cavitation": 0.0})}
    )
    return Scene(
        name="dam_break",
        regions=(Region("water", Box((0.0, 0.0), (A, 2 * A)), water),),
        length=A,
        supports=(),
        loads=(Load("gravity", (0.0, -G)),),
        probes=(
            Probe("front", "quantile", component=0, share=SHARE),
            Probe("top", "quantile", component=1, share=SHARE),
        ),
        measures=(
            Measure(
                "front",
                "-",
                error=lambda history: compared(history, table)[1],
                reference=Reference("experiment", source),
            ),
            Measure("shift", "-", lambda history: compared(history, table)[0]),
            *late,
        ),
        dynamic=True,
        t_end=t_end,
        walls=(
            Wall("floor", at_most(1, 0.0), (0.0, 1.0)),
            Wall("back", at_most(0, 0.0), (1.0, 0.0)),
            Wall("far", at_least(0, width), (-1.0, 0.0)),
        ),
        room=Box((0.0, 0.0), (width, height)),
        at=lambda t: {"T": t / UNIT},
        knobs={"end": end, "tension": tension},
    )
