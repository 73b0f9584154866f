"""Plate in tension with a crack from its side: the stress intensity of the textbook, and its factor F.

Set-up. A plate 1 x H, dimensionless, E = 1, nu = 0.3, plane strain, small strain. A straight crack runs from the left side
at mid height to a depth a. A unit tension pulls at both ends, which may turn freely: the plate is held along short pieces
of its sides at the lower right corner only, where uniform tension moves all points alike.

Measured. The stress intensity factor `KI` and `F` = KI / sqrt(pi a).

Reference. Overkill: own finite elements of third order, strongly refined, for a = 0.3 and 0.5 and H = 2 and 4. The
polynomials of the handbooks are good to half a percent.

What must fail. Finite elements of any order on a uniform mesh that follows the crack: their error falls like the size of
the cells. Jumps without functions of the tip: several percent at 80 cells.

Length. The width of the plate, 1; cells may shrink towards the tip.
"""

from __future__ import annotations

import math

from geofem.reference import reference, table
from geofem.scene import Crack, Load, Material, Measure, Polygon, Probe, Reference, Region, Scene, Support
from geofem.scenes._parts import all_of, at_least, at_most, check_number

E, NU = 1.0, 0.3
PIECE = 0.25
"""Length of the sides that are held at the corner."""


def scene(*, a: float = 0.5, H: float = 2.0) -> Scene:
    """Knobs

    a : depth of the crack, 0.1 to 0.9; default 0.5.
    H : height of the plate, 1 to 10; default 2.
    """
    check_number("edge_crack", "a", a, 0.1, 0.9)
    check_number("edge_crack", "H", H, 1.0, 10.0)
    name = f"a{a:g}_H{H:g}"
    scale = math.sqrt(math.pi * a)
    known = reference("c01_edge_crack", name) if name in table("c01_edge_crack") else None
    intensity = None
    if known is not None and known.value is not None:
        intensity = Reference(known.kind, known.source, known.value * scale)
    low, high = -0.5 * H, 0.5 * H
    # the held pieces end at corners, so that a mesh has sides there
    corners = ((0.0, low), (1.0 - PIECE, low), (1.0, low), (1.0, low + PIECE), (1.0, high), (0.0, high))
    bottom, top, right = at_most(1, low), at_least(1, high), at_least(0, 1.0)
    return Scene(
        name="edge_crack",
        regions=(Region("plate", Polygon(corners), Material("linear_elastic", 1.0, {"E": E, "nu": NU})),),
        length=1.0,
        supports=(
            Support("corner_x", all_of(right, at_most(1, low + PIECE)), (0,)),
            Support("corner_y", all_of(bottom, at_least(0, 1.0 - PIECE)), (1,)),
        ),
        loads=(Load("traction", (0.0, 1.0), where=top), Load("traction", (0.0, -1.0), where=bottom)),
        cracks=(Crack(((-0.1, 0.0), (a, 0.0))),),
        probes=(Probe("KI", "KI", at=(a, 0.0)),),
        measures=(
            Measure("KI", "-", lambda h: float(h["KI"][-1]), reference=intensity),
            Measure("F", "-", lambda h: float(h["KI"][-1]) / scale, reference=known),
        ),
        strain="small",
        singular=((a, 0.0),),
        dimensionless=True,
        knobs={"a": a, "H": H},
    )
