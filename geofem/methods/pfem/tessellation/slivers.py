"""Slivers: tetrahedra of four nodes almost on one circle, which a Delaunay triangulation of space keeps; numba, serial.

Inside the body an edge of the sliver is taken out, and the hole around it filled from one of the nodes of its ring (Freitag and
Ollivier-Gooch 1997); at the boundary the sliver is left out. Nothing is moved.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from geofem.methods.pfem.tessellation import simplices
from geofem.scene import Array

RING = 7
"""Cells around an edge beyond which it is not worth while to take it out: ever fewer of the new cells would be good."""
ROUNDS = 4
EDGES = np.array([[0, 1, 2, 3], [0, 2, 3, 1], [0, 3, 1, 2], [1, 2, 0, 3], [1, 3, 2, 0], [2, 3, 0, 1]])
"""The edges of a tetrahedron, and its other two vertices, turned so that the four have a positive volume."""


def swapped(x: Array, cells: Array, worst: float) -> Array:
    """The cells, in their order, without those inside of a ``simplices.quality`` below ``worst``, as far as that can be.

    The union of the cells stays what it is, to rounding.
    """
    for _ in range(ROUNDS):
        shape = simplices.quality(x, cells)
        bad = np.flatnonzero(shape < worst)
        if len(bad) == 0:
            break
        bad = bad[np.argsort(shape[bad], kind="stable")]
        kept, new = swap(x, cells, simplices.neighbours(cells), shape, bad)
        if len(new) == 0:
            break
        cells = simplices.ordered(np.concatenate([cells[kept], new]))[0]
    return cells


@njit(cache=True, error_model="numpy")
def shape_of(x: Array, a: int, b: int, c: int, d: int) -> float:
    """``simplices.quality`` of one tetrahedron."""
    total = 0.0
    for p, q in ((a, b), (a, c), (a, d), (b, c), (b, d), (c, d)):
        total += simplices.squared(x, p, q)
    return np.sqrt(2.0) * simplices.six_volumes(x, a, b, c, d) / (total / 6.0) ** 1.5


@njit(cache=True, error_model="numpy")
def swap(x: Array, cells: Array, across: Array, shape: Array, bad: Array) -> tuple[Array, Array]:
    """Take out the best edge of each bad cell, the worst cell first, no cell being touched twice.

    Returns which cells stay (m,) and the new ones, each at least as good as the worst that it replaces.
    """
    kept = np.ones(len(cells), np.bool_)
    new = np.empty((2 * RING * len(bad), 4), np.int64)
    n = 0
    touched = np.zeros(len(cells), np.bool_)
    ring, around = np.empty(RING, np.int64), np.empty(RING, np.int64)
    best_ring, best_around = np.empty(RING, np.int64), np.empty(RING, np.int64)
    for c in bad:
        gain, count, apex, bottom, end = shape[c], 0, 0, 0, 0
        for e in range(6):
            a, b = cells[c, EDGES[e, 0]], cells[c, EDGES[e, 1]]
            size = walk(cells, across, c, a, b, cells[c, EDGES[e, 2]], cells[c, EDGES[e, 3]], ring, around)
            least = shape[c]
            for i in range(size):
                least = min(least, shape[around[i]])
                if touched[around[i]]:
                    size = 0
            for i in range(size):
                low = np.inf
                for j in range(1, size - 1):
                    p, q, r = ring[i], ring[(i + j) % size], ring[(i + j + 1) % size]
                    low = min(low, shape_of(x, a, p, q, r), shape_of(x, p, q, r, b))
                if low > gain and low > least:
                    gain, count, apex, bottom, end = low, size, i, a, b
                    for j in range(size):
                        best_ring[j], best_around[j] = ring[j], around[j]
        for j in range(1, count - 1):
            p, q, r = best_ring[apex], best_ring[(apex + j) % count], best_ring[(apex + j + 1) % count]
            new[n, 0], new[n, 1], new[n, 2], new[n, 3] = bottom, p, q, r
            new[n + 1, 0], new[n + 1, 1], new[n + 1, 2], new[n + 1, 3] = p, q, r, end
            n += 2
        for j in range(count):
            kept[best_around[j]] = False
            touched[best_around[j]] = True
    return kept, new[:n]


@njit(cache=True, error_model="numpy")
def walk(cells: Array, across: Array, c: int, a: int, b: int, p: int, q: int, ring: Array, around: Array) -> int:
    """The nodes and the cells around the edge from a to b, from cell c = (a, b, p, q) on; 0 if it is at the boundary."""
    first = c
    for n in range(RING):
        ring[n], around[n] = p, c
        k = 0
        while cells[c, k] != p:
            k += 1
        c = across[c, k]
        if c < 0:
            return 0
        if c == first:
            return n + 1
        j = 0
        while cells[c, j] == a or cells[c, j] == b or cells[c, j] == q:
            j += 1
        p, q = q, cells[c, j]
    return 0


@njit(cache=True, error_model="numpy")
def drop_outer(cells: Array, across: Array, bad: Array, inside: Array, nodes: int) -> int:
    """Leave out bad cells that have one or two facets at the boundary, until there are none; returns how many.

    A cell that is the only one of a node stays.
    """
    uses = np.zeros(nodes, np.int64)
    for c in range(len(cells)):
        for k in range(4):
            uses[cells[c, k]] += inside[c]
    dropped, before = 0, -1
    while dropped != before:
        before = dropped
        for c in range(len(cells)):
            if not (inside[c] and bad[c]):
                continue
            outer, needed = 0, False
            for k in range(4):
                outer += across[c, k] < 0 or not inside[across[c, k]]
                needed |= uses[cells[c, k]] == 1
            if 1 <= outer <= 2 and not needed:
                inside[c] = False
                dropped += 1
                for k in range(4):
                    uses[cells[c, k]] -= 1
    return dropped
