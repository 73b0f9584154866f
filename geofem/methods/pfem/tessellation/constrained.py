"""The plane: the boundary that the body had is in the new triangulation, so its area is what it was, to rounding."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numba import njit

from geofem.methods.pfem.tessellation import Tessellation, simplices
from geofem.methods.pfem.tessellation.alpha import AlphaShape
from geofem.methods.pfem.tessellation.backends import constrained
from geofem.methods.pfem.tessellation.common import FLAT, finished, mean_size
from geofem.methods.pfem.tessellation.winding import winding
from geofem.mistake import Mistake
from geofem.scene import Array

SLIPPED = 0.1
"""A node this far (in sizes) outside the boundary edge that it has crossed is still the body's: it slipped."""


@dataclass(frozen=True)
class Constrained:
    """Delaunay triangles among the moved boundary edges of the body, which stay; what is to their left is the body.

    alpha : the alpha shape that makes the first boundary, where there is none yet.
    backend : see ``backends.delaunay``.
    seen : how often there was what ought to be rare: boundary edges that cross others and were given up (``crossed``),
        triangles told from the outside by how often the boundary goes round them, as crossed edges did not (``doubtful``),
        flat ones that were left out (``flat``), nodes that had slipped out of the body and were kept in it by a triangle
        outside (``caught``), and nodes of the old cells that are in no new one (``loose``).
    """

    alpha: float = 1.2
    backend: str = "auto"
    seen: Counter[str] = field(default_factory=Counter, compare=False)

    def __call__(self, x: Array, size: Array, old: Tessellation | None) -> Tessellation:
        """See ``Tessellator``."""
        if x.shape[1] != 2:
            raise Mistake("pfem: a boundary is kept by constraints in the plane only; in 3D use InsideBody")
        if old is None or len(old.facets) == 0:
            return AlphaShape(self.alpha, backend=self.backend)(x, size, old)
        cells, sides, refused = constrained(x, old.facets, self.backend)
        inside = sides > 0
        doubtful = np.flatnonzero(sides == 0)
        if len(doubtful):
            inside[doubtful] = winding(x, old.facets, x[cells[doubtful]].mean(axis=1)) > 0
        areas = simplices.volumes(x, cells)
        flat = areas <= FLAT * mean_size(size, cells) ** 2
        self.seen.update(crossed=int(refused.sum()), doubtful=len(doubtful), flat=0, caught=0, loose=0)
        if (inside & flat).any():
            before = int(inside.sum())
            peel(x, cells, simplices.neighbours(cells), flat, inside)
            # what is flat and yet not at the boundary has two nodes almost at one place: a mesh can bear it while it has an area
            inside &= areas > 0
            self.seen["flat"] += before - int(inside.sum())
        loose = slipped(old.cells, cells[inside], len(x))
        if len(loose):
            caught = catching(x, size, cells, areas, inside, loose)
            inside[caught] = True
            self.seen.update(caught=len(caught), loose=len(loose) - len(caught))
        return finished(cells[inside], old)


def slipped(old: Array, new: Array, n: int) -> Array:
    """The nodes of old cells that are in no new one."""
    lost = np.zeros(n, bool)
    lost[old.ravel()] = True
    lost[new.ravel()] = False
    return np.flatnonzero(lost)


def catching(x: Array, size: Array, cells: Array, areas: Array, inside: Array, loose: Array) -> Array:
    """The outer cells that join a loose node to a boundary edge which it has only just crossed: one for each such node."""
    across = simplices.neighbours(cells)
    lost = np.zeros(len(x), bool)
    lost[loose] = True
    rows, k = np.nonzero(~inside[:, None] & lost[cells] & (across >= 0) & inside[across])
    edge = np.linalg.norm(x[cells[rows, (k + 1) % 3]] - x[cells[rows, (k + 2) % 3]], axis=1)
    nodes = cells[rows, k]
    fit = (2 * areas[rows] < SLIPPED * size[nodes] * edge) & (areas[rows] > FLAT * size[nodes] ** 2)
    _, first = np.unique(nodes[fit], return_index=True)
    return rows[fit][first]


@njit(cache=True, error_model="numpy")
def peel(x: Array, cells: Array, across: Array, flat: Array, inside: Array) -> None:
    """Leave out flat cells whose longest edge is at the boundary, and those whose longest edge so comes to be there.

    The boundary then takes the way round over the cell's third node, which lies on that edge.
    """
    waiting = np.empty(3 * len(cells), np.int64)
    n = 0
    for c in range(len(cells)):
        if inside[c] and flat[c]:
            waiting[n] = c
            n += 1
    while n > 0:
        n -= 1
        c = waiting[n]
        longest, length = 0, -1.0
        for k in range(3):
            i, j = cells[c, (k + 1) % 3], cells[c, (k + 2) % 3]
            edge = (x[i, 0] - x[j, 0]) ** 2 + (x[i, 1] - x[j, 1]) ** 2
            if edge > length:
                longest, length = k, edge
        beyond = across[c, longest]
        if not inside[c] or (beyond >= 0 and inside[beyond]):
            continue
        inside[c] = False
        for k in range(3):
            u = across[c, k]
            if u >= 0 and inside[u] and flat[u]:
                waiting[n] = u
                n += 1
