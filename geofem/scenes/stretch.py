"""A bar that is pulled out to several times its length: at which stretch do material points fall apart?

Set-up. A bar of 4 m x 1 m in plane strain, neo-Hookean, E = 0.01 Pa, nu = 0, density 1000 kg/m3, held at x <= 0 in the
x direction. Each point starts with the velocity 1/s times its distance from there. The bar is so heavy and so soft that
its own stress hardly slows it: it flies apart evenly, x = X (1 + t / s), until its stretch is `stretch`. As nu = 0 it
keeps its thickness. Neo-Hooke and not Hencky, whose bar softens beyond a stretch of e.

Measured. `stretch`: the stretch at which the run ended. Error `stress`: the largest deviation of the stress along the
bar at the end from E/2 (stretch - 1/stretch), at four points.

Reference. Exact: a bar that holds together reaches the stretch that was asked for. From the free end, where the
stress is zero, a wave runs in at 3 mm/s; at a stretch of 4 it has drawn the end back by 11 mm of 12 m.

What must fail. Material points whose neighbours no longer share a node of the grid: with ppc points per cell and
direction, linear shape functions part from a stretch of ppc on, GIMP from ppc + 1, quadratic B-splines from 2 ppc
(measured in one dimension). Domains that stretch with the material (CPDI) hold, and so does a mesh.

Length. The height of the bar, 1 m.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from geofem.reference import reference
from geofem.scene import Array, Box, History, Material, Measure, Probe, Region, Scene, Support
from geofem.scenes._parts import at_most, check_number

LENGTH, HEIGHT, RATE = 4.0, 1.0, 1.0
"""Size of the bar (m), and the rate at which its stretch grows (1/s)."""
E, DENSITY = 0.01, 1000.0
PLACES = (0.15, 0.35, 0.55, 0.75)
"""Where the stress is read, as fractions of the bar."""


def exact_stress(stretch: float) -> float:
    """Cauchy stress along the bar (Pa)."""
    return 0.5 * E * (stretch - 1 / stretch)


def reached(history: History) -> float:
    """The stretch at the last sample."""
    return 1 + RATE * float(history["t"][-1])


def worst_stress(history: History) -> float:
    """The stress that is furthest from the exact one at the last sample (Pa)."""
    found = np.array([history[f"stress_{k}"][-1] for k in range(len(PLACES))])
    return float(found[np.abs(found - exact_stress(reached(history))).argmax()])


def stress_error(history: History) -> float:
    """Its deviation, relative; nan if the bar was not stretched at all."""
    exact = exact_stress(reached(history))
    return abs(worst_stress(history) - exact) / exact if exact else float("nan")


def scene(*, stretch: float = 4.0) -> Scene:
    """Knobs

    stretch : stretch of the bar at the end, dimensionless; default 4.
    """
    check_number("stretch", "stretch", stretch, 1.01, 20.0)

    def initial_velocity(x: Array) -> Array:
        return np.array([RATE * x[0], 0 * x[0]])

    return Scene(
        name="stretch",
        regions=(Region("bar", Box((0.0, 0.0), (LENGTH, HEIGHT)), Material("neo_hooke", DENSITY, {"E": E, "nu": 0.0})),),
        length=HEIGHT,
        supports=(Support("symmetry", at_most(0, 0.0), (0,)),),
        probes=(
            Probe("end_ux", "displacement", at=(LENGTH, 0.5 * HEIGHT), component=0),
            *(
                Probe(f"stress_{k}", "stress", at=(place * LENGTH, 0.5 * HEIGHT), component=0)
                for k, place in enumerate(PLACES)
            ),
        ),
        measures=(
            Measure("stretch", "-", reached, reference=replace(reference("v10_stretch", "stretch"), value=stretch)),
            Measure(
                "stress",
                "Pa",
                worst_stress,
                error=stress_error,
                reference=replace(reference("v10_stretch", "stress"), value=exact_stress(stretch)),
            ),
        ),
        dynamic=True,
        t_end=(stretch - 1) / RATE,
        initial_velocity=initial_velocity,
        room=Box((0.0, -HEIGHT), (stretch * LENGTH + HEIGHT, 2 * HEIGHT)),
        intact=True,
        at=lambda t: {"stretch": 1 + RATE * t},
        savings={"symmetry": 0.5},
        knobs={"stretch": stretch},
    )
