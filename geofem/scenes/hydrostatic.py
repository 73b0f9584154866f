"""Water at rest in a box: it ought to stay at rest, with the pressure of its depth.

Set-up. A box of water, a = 1 m wide and deep (a cube with `dim` = 3), on a smooth floor between smooth walls that hold it
back but do not pull; gravity acts from t = 0 on. Density 1000 kg/m3, viscosity 1 mPa s; the run lasts 0.5 s. Methods
that need a bulk modulus get one by which sound is ten times faster than sqrt(2 g a).

Measured. `u_max` (m/s): the largest speed of any node or material point at any time. Error `pressure`: the root mean square of
p - rho g (a - y) over the body at the end, by rho g a.

Reference. Exact: nothing moves. As the solution is linear in y, a method whose pressure can be linear has no error of
discretisation, whatever its mesh: what is left is the solver's.

What must fail. A stabilisation of the pressure that leaves the weight out of its residual drives currents that never cease. Weakly
compressible water starts without its pressure, so that it falls by rho g a / 2 K of its depth and rings with sound. Hat functions of
material points sum up to more mass near some nodes than near others, and stir. Alpha shapes that lose a cell at the surface lose volume.

Length. The depth, a.
"""

from __future__ import annotations

import math

import numpy as np

from geofem.reference import reference
from geofem.scene import Array, Box, Load, Material, Measure, Probe, Region, Scene, Wall
from geofem.scenes._parts import at_least, at_most, check_choice

A, G, DENSITY, VISCOSITY = 1.0, 9.81, 1000.0, 1e-3
SOUND = 10 * math.sqrt(2 * G * A)
END = 0.5


def scene(*, dim: int = 2) -> Scene:
    """Knobs

    dim : 2 for a box in the plane, 3 for a cube; default 2.
    """
    check_choice("hydrostatic", "dim", dim, (2, 3))
    up = dim - 1

    def normal(axis: int, sign: float) -> tuple[float, ...]:
        return tuple(sign if i == axis else 0.0 for i in range(dim))

    def pressure(x: Array, t: float) -> Array:
        return DENSITY * G * (A - x[up])

    sides = ("x", "y")[:up]
    water = Material("newtonian", DENSITY, {"mu": VISCOSITY, "K": DENSITY * SOUND**2})
    return Scene(
        name="hydrostatic",
        regions=(Region("water", Box((0.0,) * dim, (A,) * dim), water),),
        length=A,
        supports=(),
        loads=(Load("gravity", tuple(-G if i == up else 0.0 for i in range(dim))),),
        probes=(
            Probe("speed", "largest_speed"),
            Probe("pressure_error", "pressure_error", exact=pressure),
        ),
        measures=(
            Measure(
                "u_max",
                "m/s",
                lambda history: float(np.max(history["speed"])),
                reference=reference("f05_hydrostatic", "u_max"),
            ),
            Measure(
                "pressure",
                "-",
                error=lambda history: float(history["pressure_error"][-1]) / (DENSITY * G * A),
                reference=reference("f05_hydrostatic", "pressure"),
            ),
        ),
        plane="plane_strain" if dim == 2 else "solid",
        dynamic=True,
        t_end=END,
        walls=(
            Wall("floor", at_most(up, 0.0), normal(up, 1.0)),
            *(Wall(f"low {name}", at_most(axis, 0.0), normal(axis, 1.0)) for axis, name in enumerate(sides)),
            *(Wall(f"high {name}", at_least(axis, A), normal(axis, -1.0)) for axis, name in enumerate(sides)),
        ),
        room=Box((0.0,) * dim, (*(A,) * up, 1.1 * A)),
        knobs={"dim": dim},
    )
