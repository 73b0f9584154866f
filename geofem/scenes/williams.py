"""The exact field of a crack tip in a square: how good a crack in a mesh is, by error norms and intensity factors.

Set-up. The unit square, dimensionless, E = 1, nu = 0.3, plane strain, small strain. A straight crack runs from the left
side to a tip inside, on no line of a regular mesh unless it is put there. All around, the displacement of the near field
of that tip is prescribed (Williams 1957), on both faces of the crack where it meets the side; that field solves the
problem inside.

Measured. The stress intensity factors `KI` and `KII`, and the errors of the whole displacement field relative to the
exact one: `energy` by the energy of the difference, `L2` by its mean square.

Reference. Exact.

What must fail. Without functions of the tip, the singular strain ruins the order: the energy error falls like the
square root of the cell size, as with any polynomial elements and with tip functions in the cell of the tip only. With
functions within a fixed radius it falls like the cell size.

Length. The side of the square, 1.
"""

from __future__ import annotations

import math

from geofem.mistake import Mistake
from geofem.scene import Array, Box, Crack, Material, Measure, Point, Probe, Reference, Region, Scene, Support
from geofem.scenes._parts import any_of, at_least, at_most, check_number
from geofem.scenes._tip import TipField

E, NU = 1.0, 0.3
SQUARE = Box((0.0, 0.0), (1.0, 1.0))
OUTSIDE = -0.1
"""Where the crack starts (x), so that it runs through the side."""


def point(tip: Point | str) -> Point:
    """The pair of numbers that a knob tells, also as text. Raises ``Mistake`` if it does not."""
    try:
        parts = tip.split(",") if isinstance(tip, str) else tip
        x, y = (float(part) for part in parts)
    except (TypeError, ValueError):
        raise Mistake(f"scene williams: tip is a pair of numbers like 0.5,0.5, not {tip!r}") from None
    return x, y


def scene(*, tip: Point | str = (0.5037, 0.5071), angle: float = 0.0, KI: float = 1.0, KII: float = 0.0) -> Scene:
    """Knobs

    tip : its place in the square, a pair or text like ``0.5,0.5``; default (0.5037, 0.5071).
    angle : of the crack to the x axis, -40 to 40 degrees, at which it still comes in from the left; default 0.
    KI : stress intensity factor of the opening mode, 0 to 1e6; default 1.
    KII : of the sliding mode, -1e6 to 1e6; default 0.
    """
    check_number("williams", "angle", angle, -40.0, 40.0)
    at = point(tip)
    for name, value, low, high in (("KI", KI, 0.0, 1e6), ("KII", KII, -1e6, 1e6), *(("tip", c, 0.05, 0.95) for c in at)):
        check_number("williams", name, value, low, high)
    if KI == 0 and KII == 0:
        raise Mistake("scene williams: KI and KII are both zero; give a load")
    field = TipField(at, math.radians(angle), KI, KII, E / (2 * (1 + NU)), NU)
    start = (OUTSIDE, at[1] - (at[0] - OUTSIDE) * math.tan(field.angle))
    if not 0.0 < at[1] - at[0] * math.tan(field.angle) < 1.0:
        raise Mistake("scene williams: the crack must enter through the left side; choose another tip or angle")
    energy, square = field.norms(SQUARE)
    boundary = any_of(at_most(0, 0.0), at_least(0, 1.0), at_most(1, 0.0), at_least(1, 1.0))

    def component(i: int, x: Array, t: float) -> Array:
        return t * field.displacement(x)[i]

    return Scene(
        name="williams",
        regions=(Region("square", SQUARE, Material("linear_elastic", 1.0, {"E": E, "nu": NU})),),
        length=1.0,
        supports=(
            Support("boundary_x", boundary, (0,), lambda x, t: component(0, x, t)),
            Support("boundary_y", boundary, (1,), lambda x, t: component(1, x, t)),
        ),
        cracks=(Crack((start, field.at)),),
        probes=(
            Probe("KI", "KI", at=field.at),
            Probe("KII", "KII", at=field.at),
            Probe("energy", "energy_error", exact=lambda x, t: t * field.gradient(x)),
            Probe("L2", "displacement_error", exact=lambda x, t: t * field.displacement(x)),
        ),
        measures=(
            Measure("KI", "-", lambda h: float(h["KI"][-1]), reference=Reference("exact", "Williams 1957", float(KI))),
            Measure("KII", "-", lambda h: float(h["KII"][-1]), reference=Reference("exact", "Williams 1957", float(KII))),
            Measure("energy", "-", error=lambda h: float(h["energy"][-1]) / (h["t"][-1] * energy)),
            Measure("L2", "-", error=lambda h: float(h["L2"][-1]) / (h["t"][-1] * square)),
        ),
        strain="small",
        dimensionless=True,
        knobs={"tip": tip, "angle": angle, "KI": KI, "KII": KII},
    )
