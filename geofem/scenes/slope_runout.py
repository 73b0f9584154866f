"""A slope that fails, and how far it slides: from rest, through loss of strength, to rest again.

Set-up. The slope of `slope`, case ex1, with real measures and mirrored: H = 5 m high, 2:1, c = 0.05 gamma H, phi = 20
degrees, no dilation, E = 500 gamma H, nu = 0.3, density 2000 kg/m3, plane strain, on a rough firm base that goes on
in front of the toe; 1.2 H of ground behind the crest, on rollers. In units of sqrt(H / g): up to 4 gravity is turned on
smoothly, at full strength; within 0.5 the strength, c and tan(phi), is divided by 1.387 / `f`, so that the factor of
safety falls from 1.387 to `f`; the run lasts until 14.

Measured. `run_out` (m): how far the front advances after the strength is lost. `drop` (m): how far the top comes down.
`rest`: the kinetic energy at the end by the largest of the run. Front and top are the coordinates below which 99.5 %
of the mass lie.

Reference. None: methods are compared with one another. Two statements check a run: with `f` above 1.02 the slope must
stand (bracket of limit analysis, 1.375 to 1.398), and at the end it must be nearly at rest.

What must fail. A mesh that follows the ground tangles soon after the onset. Flow without dilation locks: material
points that do not share the change of volume of a cell (cure = cell) run a fifteenth as far with 6 cells, and half as
far with 12. A method whose points stick to the base leaves a film behind. With linear shape functions the stress of
material points, and with it their strength, is noisy where they cross cells. Softening by strain, which would
localise and depend on the cells, is left out.

Length. The height of the slope, 5 m.
"""

from __future__ import annotations

import math

import numpy as np

from geofem.reference import reference
from geofem.scene import Box, History, Load, Material, Measure, Polygon, Probe, Region, Scene, Support, Wall
from geofem.scenes._parts import at_most, check_number

H, G, DENSITY = 5.0, 9.81, 2000.0
UNIT = math.sqrt(H / G)
"""The time (s) that the steps of the scene are multiples of."""
STEADY, LOST, END = 4 * UNIT, 4.5 * UNIT, 14 * UNIT
"""When gravity is all there, when the strength is lost, and when the run ends (s)."""
FOS = 1.387
"""Factor of safety at full strength: middle of the bracket of ``slope``, case ex1."""
CREST, TOE = 1.2 * H, 3.2 * H
SHARE = 0.995


def smooth(s: float) -> float:
    """From 0 to 1 while s does, level at both ends."""
    s = min(max(s, 0.0), 1.0)
    return s * s * (3 - 2 * s)


def advance(history: History, name: str) -> float:
    """How far the quantile ``name`` goes from the time when gravity is all there to the end (m)."""
    return float(history[name][-1] - np.interp(STEADY, history["t"], history[name]))


def rest(history: History) -> float:
    """Kinetic energy at the end by the largest one; 0 if nothing ever moved."""
    most = float(np.max(history["kinetic"]))
    return float(history["kinetic"][-1]) / most if most > 0 else 0.0


def scene(*, f: float = 0.7) -> Scene:
    """Knobs

    f : factor of safety that is left when the strength is lost, dimensionless; default 0.7.
    """
    check_number("slope_runout", "f", f, 0.4, FOS)
    weight = DENSITY * G * H
    soil = {"E": 500 * weight, "nu": 0.3, "c": 0.05 * weight, "phi": 20.0, "psi": 0.0}
    ground = Polygon(((0.0, 0.0), (TOE, 0.0), (CREST, H), (0.0, H)))

    def weakening(t: float) -> float:
        return 1 + (FOS / f - 1) * smooth((t - STEADY) / (LOST - STEADY))

    return Scene(
        name="slope_runout",
        regions=(Region("ground", ground, Material("mohr_coulomb", DENSITY, soil)),),
        length=H,
        supports=(Support("back", at_most(0, 0.0), (0,)),),
        loads=(Load("gravity", (0.0, -G), amplitude=lambda t: smooth(t / STEADY)),),
        probes=(
            Probe("front", "quantile", component=0, share=SHARE),
            Probe("top", "quantile", component=1, share=SHARE),
            Probe("crest_uy", "displacement", at=(CREST, H), component=1),
            Probe("mean_velocity", "mean_velocity", component=0),
        ),
        measures=(
            Measure(
                "run_out", "m", lambda history: advance(history, "front"), reference=reference("g07_slope_runout", "run_out")
            ),
            Measure("drop", "m", lambda history: -advance(history, "top")),
            Measure("rest", "-", rest),
        ),
        dynamic=True,
        t_end=END,
        walls=(Wall("base", at_most(1, 0.0), (0.0, 1.0), math.inf),),
        singular=((TOE, 0.0),),
        room=Box((0.0, 0.0), (TOE + 8 * H, 1.2 * H)),
        weakening=weakening,
        at=lambda t: {"factor": FOS / weakening(t)},
        knobs={"f": f},
    )
