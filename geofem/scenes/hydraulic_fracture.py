"""Crack under the pressure of a fluid in an infinite body: Sneddon's opening, and the stress intensity of the textbook.

Set-up. A square 6 x 6 of an infinite body, dimensionless, E = 1, nu = 0.3, plane strain, small strain; a straight crack of
half length 1 in its middle, turned by an angle from the x axis, so that it lies on no line of a regular mesh. A unit pressure
pushes its faces apart; all around, the displacement of the exact solution is prescribed. By superposition, a tension of 1
across a crack without pressure gives the same stress intensity, and the same opening: knob `by`.

Measured. The stress intensity factors `KI` and `KII` and the stress along the axis `T` at the right tip, and the errors
relative to the exact solution: `opening` of its profile along the crack (mean square), `L2` and `energy` of the whole
displacement field.

Reference. Exact (Westergaard 1939; Sneddon 1946): K_I = p sqrt(pi a), opening 4 (1 - nu^2) p sqrt(a^2 - x^2) / E, T = -p under
pressure, and -p as well under a tension in one direction.

What must fail. The interaction integral without the term of tractions on the faces: K_I depends on the ring, and is wrong on
all of them.

Length. The side of the square, 6; cells shrink towards the tips, which are marked as singular.
"""

from __future__ import annotations

import math

import numpy as np

from geofem.scene import Array, Box, Crack, Material, Measure, Probe, Reference, Region, Scene, Support
from geofem.scenes._parts import any_of, at_least, at_most, check_choice, check_number
from geofem.scenes._pressure import PressurisedCrack

E, NU = 1.0, 0.3
SIDE = 6.0
SQUARE = Box((-0.5 * SIDE, -0.5 * SIDE), (0.5 * SIDE, 0.5 * SIDE))
SOURCE = "Sneddon 1946"


def scene(*, angle: float = 20.0, by: str = "pressure") -> Scene:
    """Knobs

    angle : of the crack to the x axis, -90 to 90 degrees; default 20.
    by : what opens the crack, pressure (default) or tension.
    """
    check_number("hydraulic_fracture", "angle", angle, -90.0, 90.0)
    check_choice("hydraulic_fracture", "by", by, ("pressure", "tension"))
    field = PressurisedCrack(math.radians(angle), E / (2 * (1 + NU)), NU, 1.0 if by == "tension" else 0.0)
    tip = (math.cos(field.angle), math.sin(field.angle))
    boundary = any_of(*(at_most(i, -0.5 * SIDE) for i in range(2)), *(at_least(i, 0.5 * SIDE) for i in range(2)))
    energy, square, opening = field.norms(SQUARE)

    def component(i: int, x: Array, t: float) -> Array:
        return t * field.displacement(x)[i]

    return Scene(
        name="hydraulic_fracture",
        regions=(Region("rock", SQUARE, Material("linear_elastic", 1.0, {"E": E, "nu": NU})),),
        length=SIDE,
        supports=(
            Support("boundary_x", boundary, (0,), lambda x, t: component(0, x, t)),
            Support("boundary_y", boundary, (1,), lambda x, t: component(1, x, t)),
        ),
        cracks=(Crack(((-tip[0], -tip[1]), tip), (lambda x, t: np.full(x.shape[1], t)) if by == "pressure" else None),),
        probes=(
            Probe("KI", "KI", at=tip),
            Probe("KII", "KII", at=tip),
            Probe("T", "T", at=tip),
            Probe("opening", "opening_error", exact=lambda x, t: t * field.opening(x)),
            Probe("energy", "energy_error", exact=lambda x, t: t * field.gradient(x)),
            Probe("L2", "displacement_error", exact=lambda x, t: t * field.displacement(x)),
        ),
        measures=(
            Measure("KI", "-", lambda h: float(h["KI"][-1]), reference=Reference("exact", SOURCE, math.sqrt(math.pi))),
            Measure("KII", "-", lambda h: float(h["KII"][-1]), reference=Reference("exact", "symmetry", 0.0)),
            Measure("T", "-", lambda h: float(h["T"][-1]), reference=Reference("exact", "Westergaard 1939", -1.0)),
            Measure("opening", "-", error=lambda h: float(h["opening"][-1]) / (h["t"][-1] * opening)),
            Measure("energy", "-", error=lambda h: float(h["energy"][-1]) / (h["t"][-1] * energy)),
            Measure("L2", "-", error=lambda h: float(h["L2"][-1]) / (h["t"][-1] * square)),
        ),
        strain="small",
        singular=(tip, (-tip[0], -tip[1])),
        dimensionless=True,
        knobs={"angle": angle, "by": by},
    )
