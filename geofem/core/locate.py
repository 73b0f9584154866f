"""Which cell holds a point, and where in it: uniform bins, or a walk from the last cell; on one process, in numba.

Straight simplices, bilinear quadrilaterals and trilinear hexahedra. Local coordinates are dolfinx's: the unit simplex or the
unit cube, vertices in its order.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from geofem.core.meshing import facet_vertices, paired_facets
from geofem.scene import Array

KINDS = {(2, 3): "triangle", (2, 4): "quadrilateral", (3, 4): "tetrahedron", (3, 8): "hexahedron"}
TOLERANCE = 1e-10
"""How far outside, in local coordinates, a point still counts as inside: rounding puts points of a facet on either side."""
MAX_WALK = 64
"""Cells that a walk may cross before the bins are asked: a walk past a re-entrant corner can go in circles."""
MAX_NEWTON = 20


class Locator:
    """The cells of one mesh, ready to be searched; a mesh that moves needs a new one.

    Parameters
    ----------
    points : (n, gdim) nodes. cells : (m, vertices) their vertices, in dolfinx's order.
    neighbours : (m, facets) the cell across each facet, -1 outside; made from the cells if None. A simplex's facet k is
        opposite to its vertex k, a square's or cube's facets 2 a and 2 a + 1 are the two ends of its axis a.
    """

    def __init__(self, points: Array, cells: Array, neighbours: Array | None = None):
        gdim, corners = points.shape[1], cells.shape[1]
        self.kind = KINDS[gdim, corners]
        self.neighbours = across(cells, self.kind) if neighbours is None else np.ascontiguousarray(neighbours, np.int32)
        self._x = np.ascontiguousarray(points[cells])
        if corners == gdim + 1:
            self._origin = self._x[:, 0].copy()
            jacobian = np.transpose(self._x[:, 1:] - self._x[:, :1], (0, 2, 1))
        else:
            vertex = (np.arange(corners)[:, None] >> np.arange(gdim)) & 1
            jacobian = np.einsum("cvi,va->cia", self._x, (2.0 * vertex - 1.0) * 2.0 ** (1 - gdim))
            self._origin = self._x.mean(axis=1) - 0.5 * jacobian.sum(axis=2)
        determinant = np.linalg.det(jacobian)
        # a flat cell holds no point: local coordinates that are nan are inside nothing
        self._inverse = np.full_like(jacobian, np.nan)
        sound = determinant != 0
        self._inverse[sound] = np.linalg.inv(jacobian[sound])
        low, high = self._x.min(axis=1), self._x.max(axis=1)
        self._low = low.min(axis=0)
        spans = high.max(axis=0) - self._low
        self._width = 1.3 * (np.prod(spans) / len(cells)) ** (1 / gdim)
        self._counts = np.maximum(1, (spans / self._width).astype(np.int64) + 1)
        self._starts, self._members = fill_bins(low, high, self._low, self._width, self._counts)

    def find(self, x: Array, guess: Array | None = None) -> Array:
        """The cell of each point x (k, gdim), -1 if it is outside all.

        guess : (k,) cells to walk from, the last ones of moving points, say; -1 or None for no guess. A point on a facet is
        in either of its cells.
        """
        x = np.ascontiguousarray(x, float)
        start = np.full(len(x), -1, np.int32) if guess is None else np.ascontiguousarray(guess, np.int32)
        return find_cells(
            x, start, self._x, self._origin, self._inverse, self.neighbours,
            self._low, self._width, self._counts, self._starts, self._members,
        )  # fmt: skip

    def reference(self, x: Array, cells: Array) -> Array:
        """Local coordinates (k, gdim) of the points x (k, gdim) in the given cells (k,); nan where the cell is -1."""
        cells = np.ascontiguousarray(cells, np.int32)
        return local_coordinates(np.ascontiguousarray(x, float), cells, self._x, self._origin, self._inverse)


def across(cells: Array, kind: str) -> Array:
    """The cell across each facet of each cell, (m, facets), -1 on the boundary."""
    table = facet_vertices(kind)
    first, second = paired_facets(cells[:, table].reshape(-1, table.shape[1])).T
    neighbours = np.full(len(cells) * len(table), -1, np.int32)
    neighbours[first], neighbours[second] = second // len(table), first // len(table)
    return neighbours.reshape(len(cells), -1)


@njit(cache=True, error_model="numpy")
def fill_bins(low: Array, high: Array, corner: Array, width: float, counts: Array) -> tuple[Array, Array]:
    """Cells whose bounding boxes low ... high (m, gdim) touch each bin: bin b holds members[starts[b]:starts[b + 1]]."""
    gdim = low.shape[1]
    total = 1
    for d in range(gdim):
        total *= counts[d]
    starts = np.zeros(total + 1, np.int64)
    members = np.empty(0, np.int32)
    fill = np.empty(0, np.int64)
    first, last = np.zeros(3, np.int64), np.zeros(3, np.int64)
    for sweep in range(2):
        if sweep == 1:
            for b in range(total):
                starts[b + 1] += starts[b]
            members = np.empty(starts[total], np.int32)
            fill = starts[:-1].copy()
        for c in range(low.shape[0]):
            for d in range(gdim):
                # a little more than the box, so that a point on its side finds the cell from the next bin too
                first[d] = max(int((low[c, d] - corner[d]) / width - 1e-9), 0)
                last[d] = min(int((high[c, d] - corner[d]) / width + 1e-9), counts[d] - 1)
            for i in range(first[0], last[0] + 1):
                for j in range(first[1], last[1] + 1):
                    for k in range(first[2], last[2] + 1):
                        b = i * counts[1] + j
                        if gdim == 3:
                            b = b * counts[2] + k
                        if sweep == 0:
                            starts[b + 1] += 1
                        else:
                            members[fill[b]] = c
                            fill[b] += 1
    return starts, members


@njit(cache=True, error_model="numpy")
def invert(x: Array, vertices: Array, origin: Array, inverse: Array, xi: Array) -> bool:
    """Local coordinates xi of x in a cell; False if Newton's method does not find them, then xi is the affine estimate."""
    gdim = x.shape[0]
    for a in range(gdim):
        xi[a] = 0.0
        for i in range(gdim):
            xi[a] += inverse[a, i] * (x[i] - origin[i])
    corners = vertices.shape[0]
    if corners == gdim + 1:
        return True
    estimate = xi.copy()
    jacobian = np.empty((gdim, gdim))
    rest = np.empty(gdim)
    for _ in range(MAX_NEWTON):
        jacobian[:] = 0.0
        for i in range(gdim):
            rest[i] = x[i]
        for v in range(corners):
            shape = 1.0
            for a in range(gdim):
                shape *= xi[a] if (v >> a) & 1 else 1.0 - xi[a]
            for i in range(gdim):
                rest[i] -= shape * vertices[v, i]
            for a in range(gdim):
                slope = 1.0 if (v >> a) & 1 else -1.0
                for b in range(gdim):
                    if b != a:
                        slope *= xi[b] if (v >> b) & 1 else 1.0 - xi[b]
                for i in range(gdim):
                    jacobian[i, a] += slope * vertices[v, i]
        change = solve(jacobian, rest)
        size = 0.0
        for a in range(gdim):
            xi[a] += change[a]
            size = max(size, abs(change[a]))
        if not size < 10.0:
            break
        if size < 1e-13:
            return True
    for a in range(gdim):
        xi[a] = estimate[a]
    return False


@njit(cache=True, error_model="numpy")
def solve(m: Array, r: Array) -> Array:
    """m^-1 r for 2 x 2 and 3 x 3 matrices by Cramer's rule."""
    out = np.empty(r.shape[0])
    if r.shape[0] == 2:
        det = m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]
        out[0] = (r[0] * m[1, 1] - m[0, 1] * r[1]) / det
        out[1] = (m[0, 0] * r[1] - r[0] * m[1, 0]) / det
        return out
    for k in range(3):
        # the cofactors of row k of the inverse
        i, j = (k + 1) % 3, (k + 2) % 3
        out[k] = (
            r[0] * (m[1, i] * m[2, j] - m[2, i] * m[1, j])
            + r[1] * (m[2, i] * m[0, j] - m[0, i] * m[2, j])
            + r[2] * (m[0, i] * m[1, j] - m[1, i] * m[0, j])
        )
    det = m[0, 0] * (m[1, 1] * m[2, 2] - m[2, 1] * m[1, 2])
    det += m[1, 0] * (m[2, 1] * m[0, 2] - m[0, 1] * m[2, 2])
    det += m[2, 0] * (m[0, 1] * m[1, 2] - m[1, 1] * m[0, 2])
    for k in range(3):
        out[k] /= det
    return out


@njit(cache=True, error_model="numpy")
def farthest_facet(xi: Array, simplex: bool) -> tuple[int, float]:
    """The facet that a point lies farthest beyond, and how far, in local coordinates: negative inside, nan in a flat cell."""
    facet, excess = 0, -np.inf
    total = 1.0
    for a in range(xi.shape[0]):
        total -= xi[a]
        # the end xi = 0 is a simplex's facet a + 1 and a cube's facet 2 a
        if -xi[a] > excess:
            facet, excess = (a + 1 if simplex else 2 * a), -xi[a]
        if not simplex and xi[a] - 1.0 > excess:
            facet, excess = 2 * a + 1, xi[a] - 1.0
    if simplex and -total > excess:
        facet, excess = 0, -total
    return facet, excess + 0.0 * total


@njit(cache=True, error_model="numpy")
def find_cells(
    x: Array, guess: Array, vertices: Array, origin: Array, inverse: Array, neighbours: Array,
    low: Array, width: float, counts: Array, starts: Array, members: Array,
) -> Array:  # fmt: skip
    """See ``Locator.find``."""
    gdim = x.shape[1]
    simplex = vertices.shape[1] == gdim + 1
    found = np.full(x.shape[0], -1, np.int32)
    xi = np.empty(gdim)
    for p in range(x.shape[0]):
        cell = guess[p]
        for _ in range(MAX_WALK):
            if cell < 0:
                break
            converged = invert(x[p], vertices[cell], origin[cell], inverse[cell], xi)
            facet, excess = farthest_facet(xi, simplex)
            if converged and excess <= TOLERANCE:
                found[p] = cell
                break
            cell = neighbours[cell, facet]
        if found[p] >= 0:
            continue
        place = 0
        beyond = False
        for d in range(gdim):
            k = int(np.floor((x[p, d] - low[d]) / width + 1e-9))
            beyond |= k < 0 or k > counts[d]
            place = place * counts[d] + min(max(k, 0), counts[d] - 1)
        if beyond:
            continue
        least = TOLERANCE
        for m in range(starts[place], starts[place + 1]):
            cell = members[m]
            converged = invert(x[p], vertices[cell], origin[cell], inverse[cell], xi)
            excess = farthest_facet(xi, simplex)[1]
            if converged and excess <= least:
                found[p], least = cell, excess
                if excess < 0.0:
                    break
    return found


@njit(cache=True, error_model="numpy")
def local_coordinates(x: Array, cells: Array, vertices: Array, origin: Array, inverse: Array) -> Array:
    """See ``Locator.reference``."""
    out = np.full(x.shape, np.nan)
    for p in range(x.shape[0]):
        if cells[p] >= 0:
            invert(x[p], vertices[cells[p]], origin[cells[p]], inverse[cells[p]], out[p])
    return out
