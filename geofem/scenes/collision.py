"""Two elastic discs collide and part again: contact without a contact law, and who keeps momentum and energy through it.

Set-up. Two discs of radius 0.2 m at (0.2, 0.2) and (0.8, 0.8) m in plane strain, neo-Hookean, E = 1 kPa, nu = 0.3,
density 1000 kg/m3, fly at each other along the diagonal with (0.1, 0.1) and (-0.1, -0.1) m/s (Sulsky, Chen and Schreyer
1994). No load, no support. They touch at t = 3 - sqrt(2) = 1.586 s, are pressed together for about a second, and part
well before the end at 3.6 s.

Measured. `restitution`: the kinetic energy at the end by that at the start; what is missing is left in the discs as
vibration or was lost by the method. `contact_time` (s): when the stored energy first passes a thousandth of the kinetic
one, within 0.02 s of the touch. Error `energy`: the largest deviation of kinetic plus stored energy from its start,
relative.

Reference. Exact for the energy (none is lost) and the time of contact (geometry); none for the restitution.

What must fail. Material points with a single velocity field feel each other one or two cells before they touch: the
contact comes early by the size of those cells over the closing speed, and the discs rebound across a gap. PIC loses the
energy of the vibration and part of that of the rebound. A mesh that follows each disc needs a contact search: without
one the discs pass through each other.

Length. The side of the square that holds them, 1 m.
"""

from __future__ import annotations

import numpy as np

from geofem.reference import reference
from geofem.scene import Array, Box, Disc, History, Material, Measure, Probe, Region, Scene

RADIUS, SPEED = 0.2, 0.1
"""Radius of the discs (m), and the size of each component of their velocities (m/s)."""
LOW, HIGH = (0.2, 0.2), (0.8, 0.8)
FELT = 1e-3
"""Share of the kinetic energy that must be stored before a contact counts."""


def restitution(history: History) -> float:
    """Kinetic energy at the end by that at the start."""
    return float(history["kinetic"][-1] / history["kinetic"][0])


def contact_time(history: History) -> float:
    """The time at which the stored energy passes ``FELT`` times the first kinetic energy (s); nan if it never does."""
    t, stored = history["t"], history["internal"] / (FELT * history["kinetic"][0])
    k = int(np.argmax(stored >= 1))
    if stored[k] < 1:
        return float("nan")
    return float(t[0] if k == 0 else np.interp(1.0, stored[k - 1 : k + 1], t[k - 1 : k + 1]))


def energy_error(history: History) -> float:
    """Largest deviation of the total energy from its start, relative."""
    total = history["kinetic"] + history["internal"] - history["external"]
    return float(np.abs(total - total[0]).max() / abs(total[0]))


def scene() -> Scene:
    """Knobs

    None.
    """
    rubber = Material("neo_hooke", 1000.0, {"E": 1000.0, "nu": 0.3})

    def initial_velocity(x: Array) -> Array:
        towards = np.where(x[0] + x[1] < 1.0, SPEED, -SPEED)
        return np.array([towards, towards])

    return Scene(
        name="collision",
        regions=(Region("lower", Disc(LOW, RADIUS), rubber), Region("upper", Disc(HIGH, RADIUS), rubber)),
        length=1.0,
        supports=(),
        probes=(
            Probe("lower_ux", "displacement", at=LOW, component=0),
            Probe("upper_ux", "displacement", at=HIGH, component=0),
            Probe("lower_vx", "velocity", at=LOW, component=0),
            Probe("upper_vx", "velocity", at=HIGH, component=0),
            Probe("mean_velocity", "mean_velocity", component=0),
        ),
        measures=(
            Measure("restitution", "-", restitution),
            Measure("contact_time", "s", contact_time, reference=reference("v08_collision", "contact_time")),
            Measure("energy", "-", error=energy_error, reference=reference("v08_collision", "energy")),
        ),
        dynamic=True,
        t_end=3.6,
        initial_velocity=initial_velocity,
        room=Box((-0.25, -0.25), (1.25, 1.25)),
    )
