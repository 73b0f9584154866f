"""A plate in tension with cracks: what such scenes have in common."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from geofem.reference import reference, table
from geofem.scene import Load, Material, Polygon, Reference, Region, Support
from geofem.scenes._parts import all_of, at_least, at_most

E, NU = 1.0, 0.3


def plate(width: float, height: float, tension: Sequence[float] = (0.0, 1.0)) -> dict[str, Any]:
    """Regions, supports and loads of a plate around the origin under tension in x and y (Pa), free to turn at its sides.

    It is held along short pieces of its sides at the lower right corner, where uniform tension in y alone moves all points alike.
    """
    x, y, piece = 0.5 * width, 0.5 * height, 0.1 * width
    # the held pieces end at corners, so that a mesh has sides there
    corners = ((-x, -y), (x - piece, -y), (x, -y), (x, -y + piece), (x, y), (-x, y))
    left, right, bottom, top = at_most(0, -x), at_least(0, x), at_most(1, -y), at_least(1, y)
    pulls = (((tension[0], 0.0), right), ((-tension[0], 0.0), left), ((0.0, tension[1]), top), ((0.0, -tension[1]), bottom))
    return {
        "regions": (Region("plate", Polygon(corners), Material("linear_elastic", 1.0, {"E": E, "nu": NU})),),
        "supports": (
            Support("corner_x", all_of(right, at_most(1, -y + piece)), (0,)),
            Support("corner_y", all_of(bottom, at_least(0, x - piece)), (1,)),
        ),
        "loads": tuple(Load("traction", pull, where=where) for pull, where in pulls if any(pull)),
        "strain": "small",
        "dimensionless": True,
    }


def known(name: str, key: str, scale: float = 1.0) -> Reference | None:
    """The reference value of that key times a scale, if there is one."""
    if key not in table(name):
        return None
    found = reference(name, key)
    return Reference(found.kind, found.source, found.value * scale) if found.value is not None else found
