"""Space: the cells that lie in the old body, as it has moved; also in the plane, as the check of ``Constrained``."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numba import njit

from geofem.methods.pfem.tessellation import Tessellation, simplices, slivers
from geofem.methods.pfem.tessellation.alpha import AlphaShape
from geofem.methods.pfem.tessellation.backends import delaunay
from geofem.methods.pfem.tessellation.common import FLAT, finished, mean_size
from geofem.methods.pfem.tessellation.winding import enclosed_volume, winding
from geofem.scene import Array

TOWARDS_VERTEX = 0.6
"""Where the sample points of a cell lie, from its centroid (0) to its vertices (1)."""
REGULAR = 1 / (6 * np.sqrt(2))
"""The volume of a regular tetrahedron of unit edges."""


@dataclass(frozen=True)
class InsideBody:
    """The Delaunay cells that are in the old body by most of their sample points, filled up to its volume.

    A cell of old nodes stays; cells of interior nodes only are in the body. Of the others some lie in part in it, since
    facets of the old boundary are gone: they are taken, those that lie most in it first, until each old node has a cell and
    the volume is the old one.
    So the volume is kept to half a cell at the boundary, where an alpha shape drifts. As the level set of the old body of
    Fernandez and Ponthot (2024), but with cells that are there or not.

    alpha : the alpha shape that makes the first body, where there is none yet.
    part : cells whose circumradius is above that many sizes go, layer by layer from the boundary: a body that is torn comes
        apart, and what it loses by that is lost; infinite for none. Fronts join once they overlap, since what lies between is
        then in the old body. So no cell joins and parts by turns.
    sliver : ``simplices.quality`` below which a tetrahedron is taken apart inside and dropped at the boundary.
    backend : see ``backends.delaunay``.
    seen : ``slivers`` found, ``left`` of them in the end, ``holes`` filled (cells inside that were in no old one), ``parted``
        cells, and nodes of old cells that are in no new one (``loose``).
    """

    alpha: float = 1.2
    part: float = np.inf
    sliver: float = 0.1
    backend: str = "auto"
    seen: Counter[str] = field(default_factory=Counter, compare=False)

    def __call__(self, x: Array, size: Array, old: Tessellation | None) -> Tessellation:
        """See ``Tessellator``."""
        x = np.ascontiguousarray(x, float)
        if old is None or len(old.cells) == 0:
            first = AlphaShape(self.alpha, backend=self.backend)(x, size, old).cells
            return finished(self.mended(x, size, first), old)
        cells = delaunay(x, self.backend)
        across = simplices.neighbours(cells)
        volumes = simplices.volumes(x, cells)
        spacing = mean_size(size, cells)
        share = share_inside(x, cells, old)
        share[volumes <= FLAT * spacing ** x.shape[1]] = 0.0
        inside = share == 1.0
        known = np.zeros(len(x), bool)
        known[old.cells] = True
        known[old.facets] = True  # also nodes that have just been put on the boundary
        doubtful = np.flatnonzero((share > 0) & (share < 1))
        doubtful = doubtful[np.argsort(-share[doubtful], kind="stable")]
        fill(cells, volumes, inside, doubtful, known, enclosed_volume(x, old.facets))
        holes = enclosed(across, inside, volumes, spacing ** x.shape[1])
        inside |= holes
        outer = (across < 0) | ~inside[across]
        torn = inside & outer.any(axis=1) & (simplices.circumradii(x, cells) > self.part * spacing)
        inside &= ~torn
        self.seen.update(holes=int(holes.sum()), parted=int(torn.sum()))
        mended = self.mended(x, size, cells[inside])
        known[mended] = False
        self.seen.update(loose=int(known.sum()))
        return finished(mended, old)

    def mended(self, x: Array, size: Array, cells: Array) -> Array:
        """The cells without slivers, as far as that can be."""
        if cells.shape[1] == 3:
            return cells
        found = int((simplices.quality(x, cells) < self.sliver).sum())
        if found:
            cells = slivers.swapped(x, cells, self.sliver)
            bad = simplices.quality(x, cells) < self.sliver
            # what is stretched is no sliver: it has a volume, which is not to be lost
            small = simplices.volumes(x, cells) < self.sliver * REGULAR * mean_size(size, cells) ** 3
            kept = np.ones(len(cells), bool)
            slivers.drop_outer(cells, simplices.neighbours(cells), bad & small, kept, len(x))
            cells = cells[kept]
            self.seen.update(slivers=found, left=int((bad & kept).sum()))
        return cells


def share_inside(x: Array, cells: Array, old: Tessellation) -> Array:
    """The share of each cell's sample points that lie in the old body, (m,): old cells and those of interior nodes have all.

    The sample points are the centroid and one towards each vertex; the old boundary tells, since of the old cells some may be
    missing, where nodes were removed.
    """
    share = np.zeros(len(cells))
    known = np.zeros(len(x), bool)
    known[old.cells] = True
    surface = np.zeros(len(x), bool)
    surface[old.facets] = True
    interior = known & ~surface
    share[interior[cells].all(axis=1) | (simplices.parents(cells, old.cells) >= 0)] = 1.0
    asked = np.flatnonzero(share == 0.0)
    corners = x[cells[asked]]
    centre = corners.mean(axis=1, keepdims=True)
    samples = np.concatenate([centre, centre + TOWARDS_VERTEX * (corners - centre)], axis=1)
    turns = winding(x, old.facets, samples.reshape(-1, x.shape[1]))
    share[asked] = (turns.reshape(samples.shape[:2]) > 0).mean(axis=1)
    return share


@njit(cache=True, error_model="numpy")
def fill(cells: Array, volumes: Array, inside: Array, doubtful: Array, lonely: Array, target: float) -> None:
    """Take doubtful cells, in their order: first those that have a lonely node, then any while the volume is short of the target.

    lonely : (n,) the nodes that ought to have a cell; those that have one already are taken off here.
    """
    lonely = lonely.copy()
    total = 0.0
    for c in range(len(cells)):
        if inside[c]:
            total += volumes[c]
            for k in range(cells.shape[1]):
                lonely[cells[c, k]] = False
    for c in doubtful:
        for k in range(cells.shape[1]):
            inside[c] |= lonely[cells[c, k]]
        if inside[c]:
            total += volumes[c]
            for k in range(cells.shape[1]):
                lonely[cells[c, k]] = False
    for c in doubtful:
        if not inside[c] and total + volumes[c] / 2 <= target:
            inside[c] = True
            total += volumes[c]


@njit(cache=True, error_model="numpy")
def enclosed(across: Array, inside: Array, volumes: Array, room: Array) -> Array:
    """Cells outside that the body encloses, in cavities smaller than one node's cell: holes, not bubbles."""
    out = np.zeros(len(inside), np.bool_)
    seen = inside.copy()
    queue = np.empty(len(inside), np.int64)
    for seed in range(len(inside)):
        if seen[seed]:
            continue
        seen[seed] = True
        queue[0] = seed
        n, done = 1, 0
        volume, largest, closed = 0.0, 0.0, True
        while done < n:
            c = queue[done]
            done += 1
            volume += volumes[c]
            largest = max(largest, room[c])
            for k in range(across.shape[1]):
                u = across[c, k]
                if u < 0:
                    closed = False
                elif not seen[u]:
                    seen[u] = True
                    queue[n] = u
                    n += 1
        if closed and volume < largest:
            for i in range(n):
                out[queue[i]] = True
    return out
