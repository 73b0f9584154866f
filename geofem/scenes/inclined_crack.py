"""Inclined crack in the middle of a large plate in tension: any angle on one and the same mesh.

Set-up. A plate 20 x 40, dimensionless, E = 1, nu = 0.3, plane strain, small strain; a straight crack of half length 1 in
its middle, turned by the angle beta from the x axis. A unit tension pulls at both ends in y; the plate is held along short
pieces of its sides at the lower right corner, where uniform tension moves all points alike.

Measured. The stress intensity factors `KI` and `KII` at the right tip.

Reference. Overkill: own finite elements of third order, strongly refined, at 0, 15, 30, 45 and 60 degrees. In an infinite
plate K_I = sqrt(pi) cos^2 beta and K_II = sqrt(pi) sin beta cos beta, 0.2 to 1 % off.

What must fail. A mesh that follows the crack must be made anew for each angle. A mesh that does not meets cells that the
crack hardly cuts: without care their equations are all but singular, and the factors scatter as beta sweeps.

Length. The width of the plate, 20; cells shrink towards its middle, which is marked as singular.
"""

from __future__ import annotations

import math

from geofem.reference import reference, table
from geofem.scene import Crack, Load, Material, Measure, Polygon, Probe, Reference, Region, Scene, Support
from geofem.scenes._parts import all_of, at_least, at_most, check_number

E, NU = 1.0, 0.3
WIDTH, HEIGHT = 20.0, 40.0
PIECE = 5.0
"""Length of the sides that are held at the corner."""
CORNERS = ((-10.0, -20.0), (10.0 - PIECE, -20.0), (10.0, -20.0), (10.0, -20.0 + PIECE), (10.0, 20.0), (-10.0, 20.0))
"""The held pieces end at corners, so that a mesh has sides there."""


def known(name: str, beta: float) -> Reference | None:
    """The reference value at that angle, if there is one."""
    key = f"beta{beta:g}_{name}"
    return reference("c03_inclined_crack", key) if key in table("c03_inclined_crack") else None


def scene(*, beta: float = 30.0) -> Scene:
    """Knobs

    beta : angle of the crack to the x axis, -90 to 90 degrees; default 30.
    """
    check_number("inclined_crack", "beta", beta, -90.0, 90.0)
    angle = math.radians(beta)
    tip = (math.cos(angle), math.sin(angle))
    bottom, top, right = at_most(1, -0.5 * HEIGHT), at_least(1, 0.5 * HEIGHT), at_least(0, 0.5 * WIDTH)
    return Scene(
        name="inclined_crack",
        regions=(Region("plate", Polygon(CORNERS), Material("linear_elastic", 1.0, {"E": E, "nu": NU})),),
        length=WIDTH,
        supports=(
            Support("corner_x", all_of(right, at_most(1, -0.5 * HEIGHT + PIECE)), (0,)),
            Support("corner_y", all_of(bottom, at_least(0, 0.5 * WIDTH - PIECE)), (1,)),
        ),
        loads=(Load("traction", (0.0, 1.0), where=top), Load("traction", (0.0, -1.0), where=bottom)),
        cracks=(Crack(((-tip[0], -tip[1]), tip)),),
        probes=(Probe("KI", "KI", at=tip), Probe("KII", "KII", at=tip)),
        measures=(
            Measure("KI", "-", lambda h: float(h["KI"][-1]), reference=known("KI", beta)),
            Measure("KII", "-", lambda h: float(h["KII"][-1]), reference=known("KII", beta)),
        ),
        strain="small",
        singular=((0.0, 0.0),),
        dimensionless=True,
        knobs={"beta": beta},
    )
