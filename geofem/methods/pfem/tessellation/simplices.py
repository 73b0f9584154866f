"""Triangles and tetrahedra as arrays: measures, neighbours, boundary, and which cells are still the same; numba, serial.

Cells (m, gdim + 1) are node numbers; facet k of a cell is opposite to its vertex k. All work takes a time in proportion to the
number of cells, whatever the nodes: a node that a thousand cells share is as good as any other.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from geofem.scene import Array

FACETS = {
    3: np.array([[1, 2], [2, 0], [0, 1]]),
    4: np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]),
}
"""Vertices of the facets of a cell of positive volume, turned so that the cell is to the left of an edge and behind a face."""


def volumes(x: Array, cells: Array) -> Array:
    """Signed areas (m2) or volumes (m3) of the cells, (m,)."""
    return volume_kernel(np.ascontiguousarray(x), cells)


def circumradii(x: Array, cells: Array) -> Array:
    """Radii of the circles or spheres through the vertices of each cell, (m,) m; infinite where a cell is flat."""
    return circumradius_kernel(np.ascontiguousarray(x), cells)


def quality(x: Array, cells: Array) -> Array:
    """Shape of each cell, (m,): 1 for a regular one, 0 for a flat one, negative for one turned inside out.

    Volume over the cube (area over the square) of the root mean square edge, as Parthasarathy, Graichen and Hathaway (1994)
    compare such measures; a sliver has small values although its edges and circumradius are as those of good cells.
    """
    return quality_kernel(np.ascontiguousarray(x), cells)


def neighbours(cells: Array) -> Array:
    """The cell across each facet of each cell, (m, gdim + 1), -1 on the boundary."""
    return neighbour_kernel(cells, FACETS[cells.shape[1]])


def boundary(cells: Array, across: Array) -> Array:
    """Facets (k, gdim) with no cell on their other side, oriented as a ``Tessellation``'s; cells of positive volume."""
    return boundary_kernel(cells, across, FACETS[cells.shape[1]])


def ordered(cells: Array) -> tuple[Array, Array]:
    """The same cells in an order that depends on them alone, and the old number of each.

    Vertices are turned, never mirrored, so that the smallest comes first (and the next smallest second, in space); cells
    then ascend.
    """
    return order_kernel(cells, cells.max() + 1 if len(cells) else 0)


def parents(cells: Array, old: Array) -> Array:
    """The row of ``old`` that has the same nodes as each cell, in any order; -1 if there is none."""
    return parent_kernel(cells, old)


# --- measures ---------------------------------------------------------------------------------------------------------
@njit(cache=True, error_model="numpy", inline="always")
def six_volumes(x: Array, a: int, b: int, c: int, d: int) -> float:
    """Six times the volume of a tetrahedron."""
    ux, uy, uz = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
    vx, vy, vz = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
    wx, wy, wz = x[d, 0] - x[a, 0], x[d, 1] - x[a, 1], x[d, 2] - x[a, 2]
    return ux * (vy * wz - vz * wy) + uy * (vz * wx - vx * wz) + uz * (vx * wy - vy * wx)


@njit(cache=True, error_model="numpy", inline="always")
def two_areas(x: Array, a: int, b: int, c: int) -> float:
    """Twice the area of a triangle."""
    return (x[b, 0] - x[a, 0]) * (x[c, 1] - x[a, 1]) - (x[b, 1] - x[a, 1]) * (x[c, 0] - x[a, 0])


@njit(cache=True, error_model="numpy", inline="always")
def squared(x: Array, a: int, b: int) -> float:
    """Squared distance of two nodes."""
    total = 0.0
    for d in range(x.shape[1]):
        total += (x[b, d] - x[a, d]) ** 2
    return total


@njit(cache=True, error_model="numpy")
def volume_kernel(x: Array, cells: Array) -> Array:
    out = np.empty(len(cells))
    for i in range(len(cells)):
        if cells.shape[1] == 3:
            out[i] = two_areas(x, cells[i, 0], cells[i, 1], cells[i, 2]) / 2.0
        else:
            out[i] = six_volumes(x, cells[i, 0], cells[i, 1], cells[i, 2], cells[i, 3]) / 6.0
    return out


@njit(cache=True, error_model="numpy")
def circumradius_kernel(x: Array, cells: Array) -> Array:
    out = np.empty(len(cells))
    for i in range(len(cells)):
        a, b, c = cells[i, 0], cells[i, 1], cells[i, 2]
        if cells.shape[1] == 3:
            edges = np.sqrt(squared(x, a, b) * squared(x, b, c) * squared(x, c, a))
            measure = 2.0 * abs(two_areas(x, a, b, c))
        else:
            # Crelle: with the products p, q, r of opposite edges, 24 R V is sqrt((p+q+r)(p+q-r)(p-q+r)(-p+q+r))
            d = cells[i, 3]
            p = np.sqrt(squared(x, a, b) * squared(x, c, d))
            q = np.sqrt(squared(x, a, c) * squared(x, b, d))
            r = np.sqrt(squared(x, a, d) * squared(x, b, c))
            edges = np.sqrt(max((p + q + r) * (p + q - r) * (p - q + r) * (q + r - p), 0.0))
            measure = 4.0 * abs(six_volumes(x, a, b, c, d))
        out[i] = edges / measure if measure > 0.0 else np.inf
    return out


@njit(cache=True, error_model="numpy")
def quality_kernel(x: Array, cells: Array) -> Array:
    out = np.empty(len(cells))
    corners = cells.shape[1]
    for i in range(len(cells)):
        total = 0.0
        for j in range(corners):
            for k in range(j):
                total += squared(x, cells[i, j], cells[i, k])
        if total == 0.0:
            out[i] = 0.0
        elif corners == 3:
            out[i] = 2.0 * np.sqrt(3.0) * two_areas(x, cells[i, 0], cells[i, 1], cells[i, 2]) / total
        else:
            volume = six_volumes(x, cells[i, 0], cells[i, 1], cells[i, 2], cells[i, 3])
            out[i] = np.sqrt(2.0) * volume / (total / 6.0) ** 1.5
    return out


# --- tables of facets and cells ---------------------------------------------------------------------------------------
@njit(cache=True, error_model="numpy")
def places(count: int) -> Array:
    """An empty table with room for so many keys: a power of two, less than half full."""
    size = 2
    while size < 2 * count + 1:
        size *= 2
    return np.full(size, -1, np.int32)


@njit(cache=True, error_model="numpy", inline="always")
def scrambled(key: Array, length: int) -> np.uint64:
    """A number that depends on the nodes of a key, not on their order."""
    total, product = np.uint64(0), np.uint64(1)
    for j in range(length):
        h = (np.uint64(key[j]) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
        h ^= h >> np.uint64(29)
        total += h
        product *= h | np.uint64(1)
    total ^= product
    total *= np.uint64(0xBF58476D1CE4E5B9)
    return total ^ (total >> np.uint64(32))


@njit(cache=True, error_model="numpy", inline="always")
def same(a: Array, b: Array, length: int) -> bool:
    """Have two keys the same nodes, in any order?"""
    for i in range(length):
        found = False
        for j in range(length):
            found |= a[i] == b[j]
        if not found:
            return False
    return True


@njit(cache=True, error_model="numpy")
def neighbour_kernel(cells: Array, facets: Array) -> Array:
    corners, width = facets.shape
    out = np.full((len(cells), corners), -1, np.int64)
    keys = np.empty((len(cells) * corners, width), np.int64)
    table = places(len(keys))
    mask = np.uint64(len(table) - 1)
    for f in range(len(keys)):
        c, k = divmod(f, corners)
        for j in range(width):
            keys[f, j] = cells[c, facets[k, j]]
        place = scrambled(keys[f], width) & mask
        while table[place] >= 0:
            other = table[place]
            if same(keys[f], keys[other], width):
                out[c, k], out[other // corners, other % corners] = other // corners, c
                break
            place = (place + np.uint64(1)) & mask
        if table[place] < 0:
            table[place] = f
    return out


@njit(cache=True, error_model="numpy")
def boundary_kernel(cells: Array, across: Array, facets: Array) -> Array:
    corners, width = facets.shape
    out = np.empty((np.sum(across < 0), width), np.int64)
    n = 0
    for c in range(len(cells)):
        for k in range(corners):
            if across[c, k] < 0:
                for j in range(width):
                    out[n, j] = cells[c, facets[k, j]]
                n += 1
    return out


@njit(cache=True, error_model="numpy")
def parent_kernel(cells: Array, old: Array) -> Array:
    corners = cells.shape[1]
    table = places(len(old))
    mask = np.uint64(len(table) - 1)
    for c in range(len(old)):
        place = scrambled(old[c], corners) & mask
        while table[place] >= 0:
            place = (place + np.uint64(1)) & mask
        table[place] = c
    out = np.full(len(cells), -1, np.int64)
    for c in range(len(cells)):
        place = scrambled(cells[c], corners) & mask
        while table[place] >= 0:
            if same(cells[c], old[table[place]], corners):
                out[c] = table[place]
                break
            place = (place + np.uint64(1)) & mask
    return out


@njit(cache=True, error_model="numpy")
def order_kernel(cells: Array, nodes: int) -> tuple[Array, Array]:
    m, corners = cells.shape
    turned = np.empty_like(cells)
    for c in range(m):
        first = 0
        for k in range(1, corners):
            if cells[c, k] < cells[c, first]:
                first = k
        # a cycle of three vertices is even in the plane; of four it is odd, so there two pairs are exchanged
        for k in range(corners):
            turned[c, k] = cells[c, (first + k) % corners] if corners == 3 else cells[c, k ^ first]
        if corners == 4:
            p, q, r = turned[c, 1], turned[c, 2], turned[c, 3]
            if q < p and q < r:
                p, q, r = q, r, p
            elif r < p and r < q:
                p, q, r = r, p, q
            turned[c, 1], turned[c, 2], turned[c, 3] = p, q, r
    # counting sorts, the last vertex first: each keeps the order that the ones before have made
    rows = np.arange(m)
    following = np.empty_like(rows)
    for k in range(corners - 1, -1, -1):
        starts = np.zeros(nodes + 1, np.int64)
        for c in range(m):
            starts[turned[c, k] + 1] += 1
        for v in range(nodes):
            starts[v + 1] += starts[v]
        for i in range(m):
            v = turned[rows[i], k]
            following[starts[v]] = rows[i]
            starts[v] += 1
        rows, following = following, rows
    return turned[rows], rows
