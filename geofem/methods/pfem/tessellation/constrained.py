"""The plane: the boundary that the body had is in the new triangulation, so its area is what it was, to rounding."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from geofem.core.locate import Locator
from geofem.methods.pfem.tessellation import Tessellation, simplices
from geofem.methods.pfem.tessellation.alpha import AlphaShape
from geofem.methods.pfem.tessellation.backends import constrained
from geofem.methods.pfem.tessellation.common import FLAT, finished, mean_size
from geofem.scene import Array


@dataclass(frozen=True)
class Constrained:
    """Delaunay triangles among the moved boundary edges of the body, which stay; what is to their left is the body.

    alpha : the alpha shape that makes the first boundary, where there is none yet.
    backend : see ``backends.delaunay``.
    seen : how often there was what ought to be rare: boundary edges that cross others and were given up (``crossed``),
        triangles that were told from the outside by the old body's cells instead (``doubtful``), flat ones at the boundary
        that were left out (``flat``), and nodes that had slipped out of the body and were kept in it (``caught``).
    """

    alpha: float = 1.2
    backend: str = "auto"
    seen: Counter[str] = field(default_factory=Counter, compare=False)

    def __call__(self, x: Array, size: Array, old: Tessellation | None) -> Tessellation:
        """See ``Tessellator``."""
        if old is None or len(old.cells) == 0:
            return AlphaShape(self.alpha, backend=self.backend)(x, size, old)
        cells, sides, refused = constrained(x, old.facets, self.backend)
        self.seen["crossed"] += int(refused.sum())
        inside = sides > 0
        doubtful = np.flatnonzero(sides == 0)
        if len(doubtful):
            self.seen["doubtful"] += len(doubtful)
            inside[doubtful] = in_old_body(x, old.cells, x[cells[doubtful]].mean(axis=1))
        areas = simplices.volumes(x, cells)
        flat = areas <= FLAT * mean_size(size, cells) ** 2
        self.seen["flat"] += int((inside & flat).sum())
        inside &= ~flat
        return finished(cells[inside], old)


def in_old_body(x: Array, cells: Array, points: Array) -> Array:
    """Which points lie in the old cells, as they have moved; those turned inside out hold nothing."""
    upright = cells[simplices.volumes(x, cells) > 0]
    if len(upright) == 0:
        return np.zeros(len(points), bool)
    return Locator(x, upright, simplices.neighbours(upright)).find(points) >= 0
