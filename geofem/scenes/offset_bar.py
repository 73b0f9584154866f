"""Offset bar: a bar whose free end lies anywhere between two nodes of a background grid shows which time step is stable.

Set-up. A bar about 1 m long in plane strain, one cell high between rollers, held at x <= 0, neo-Hookean, E = 1 Pa, nu = 0,
density 1 kg/m3, so that waves run at 1 m/s. It is `offset` cells longer than `cells` cells: set `cells` to the method's n. It
starts straight with the velocity v0 sin(pi x / 2L), v0 = 1e-4 m/s, and swings for two periods, 8 L; no point leaves its cell.

Measured. Error `displacement`: the root mean square of |u - exact| over the body, largest over time, divided by the amplitude.

Reference. Exact for small amplitude: v0 / (k c) sin(k x) sin(k c t), k = pi / 2L.

What must fail. An explicit step longer than the grid bears: with linear shape functions 2 sqrt(xi) h/c, where the last point is xi
cells past a node, so that there is none that is safe for all offsets; with smooth ones .8 to 1 h/c. A run ends with the cause
`cfl` or `energy`. Joining light nodes to their neighbours (`small_mass`), or a step that follows them (`dt_control`), mends it.

Length. 1 m.
"""

from __future__ import annotations

import numpy as np

from geofem.mistake import Mistake
from geofem.reference import reference
from geofem.scene import Array, Box, History, Material, Measure, Probe, Region, Scene, Support
from geofem.scenes._parts import any_of, at_least, at_most, check_number

V0, PERIODS = 1e-4, 2
"""Largest initial velocity (m/s), and how long it swings."""


def scene(*, offset: float = 0.0, cells: int = 8) -> Scene:
    """Knobs

    offset : cells by which the bar is longer than ``cells`` cells, below 1; default 0.
    cells : a cell is 1 / cells wide (m); default 8. Take the method's n.
    """
    check_number("offset_bar", "offset", offset, 0.0, 1.0)
    check_number("offset_bar", "cells", cells, 2, 1e6)
    if cells != int(cells):
        raise Mistake(f"scene offset_bar: cells is a whole number, not {cells!r}")
    h = 1.0 / cells
    length = 1.0 + offset * h
    k = 0.5 * np.pi / length

    def exact(x: Array, t: float) -> Array:
        return np.array([V0 / k * np.sin(k * x[0]) * np.sin(k * t), 0 * x[0]])

    def error(history: History) -> float:
        return float(np.max(history["displacement_error"])) * k / V0

    return Scene(
        name="offset_bar",
        regions=(Region("bar", Box((0.0, 0.0), (length, h)), Material("neo_hooke", 1.0, {"E": 1.0, "nu": 0.0})),),
        length=1.0,
        supports=(
            Support("wall", at_most(0, 0.0), (0,)),
            Support("rollers", any_of(at_most(1, 0.0), at_least(1, h)), (1,)),
        ),
        probes=(Probe("displacement_error", "displacement_error", exact=exact),),
        measures=(Measure("displacement", "-", error=error, reference=reference("v11_offset_bar", "displacement")),),
        dynamic=True,
        t_end=PERIODS * 4 * length,
        period=4 * length,
        initial_velocity=lambda x: np.array([V0 * np.sin(k * x[0]), 0 * x[0]]),
        room=Box((0.0, 0.0), (1.0 + 4 * h, h)),
        knobs={"offset": offset, "cells": cells},
    )
