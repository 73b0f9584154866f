"""A beam let go under gravity: large rotations in time, where classical material points fail and smooth ones converge.

Set-up. A beam of 4 m x 1 m, clamped at x <= 0, neo-Hookean, E = 4 MPa times `stiffness`, nu = 0.3, density 1000 kg/m3,
plane strain. Gravity of 10 m/s2 is switched on at t = 0; the run lasts about one period, 1.5 s divided by the root of
`stiffness`. With `stiffness` 100 the same beam moves a hundredth as far: small strain and hardly any rotation.

Measured. `tip`: the largest error over time of the vertical displacement of the middle of the free end, divided by the
largest displacement of the reference. `tip_min`: the lowest point of that displacement (m), about -1.74 m.

Reference. Overkill: a finite element run with finer cells and steps, stored as a curve with its source.

What must fail. Material points with linear shape functions and the large rotation: they cross cells, and the error
grows as the cells become smaller, or a point inverts. With `stiffness` 100 the same code converges: the failure is that
of the method and not of the program. Smooth shape functions (GIMP, B-splines) converge at about first order in both.

Length. The thickness, 1 m.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from geofem.reference import series
from geofem.scene import Box, History, Load, Material, Measure, Probe, Reference, Region, Scene, Support
from geofem.scenes._parts import at_most, check_choice

CURVES = {1: "tip", 100: "tip_stiff100"}
"""Columns of the reference by stiffness; its column t is the time multiplied by the root of the stiffness (s)."""


def scene(*, stiffness: int = 1) -> Scene:
    """Knobs

    stiffness : factor of Young's modulus, 1 (large rotation) or 100 (small strain), dimensionless; default 1.
    """
    check_choice("beam_drop", "stiffness", stiffness, CURVES)
    source, columns = series("beam_drop")
    t, tip = columns["t"] / math.sqrt(stiffness), columns[CURVES[stiffness]]
    amplitude = float(np.abs(tip).max())

    def tip_error(history: History) -> float:
        return float(np.abs(np.interp(t, history["t"], history["tip"]) - tip).max()) / amplitude

    return replace(
        beam(stiffness),
        measures=(
            Measure("tip", "-", error=tip_error, reference=Reference("overkill", source)),
            Measure(
                "tip_min",
                "m",
                lambda history: float(history["tip"].min()),
                reference=Reference("overkill", source, float(tip.min())),
            ),
        ),
    )


def beam(stiffness: float) -> Scene:
    """The problem without its reference, which ``benchmarks/beam_drop_reference.py`` makes from it."""
    return Scene(
        name="beam_drop",
        regions=(
            Region("beam", Box((0.0, 0.0), (4.0, 1.0)), Material("neo_hooke", 1000.0, {"E": 4e6 * stiffness, "nu": 0.3})),
        ),
        length=1.0,
        supports=(Support("clamp", at_most(0, 0.0), (0, 1)),),
        loads=(Load("gravity", (0.0, -10.0)),),
        probes=(Probe("tip", "displacement", at=(4.0, 0.5), component=1),),
        singular=((0.0, 0.0), (0.0, 1.0)),
        dynamic=True,
        t_end=1.5 / math.sqrt(stiffness),
        room=Box((0.0, -4.0), (5.0, 2.0)),
        knobs={"stiffness": stiffness},
    )
