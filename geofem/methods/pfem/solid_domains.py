"""Smoothing domains: over each the gradient of the displacement is one average, and there the material answers.

A domain lists nodes a, the weights g_a of its gradient, sum of u_a (x) g_a, and its volume. Two kinds serve the solids. Around a
*node*: a third of every triangle that meets there (node-based smoothing, Liu and others 2009, Computers and Structures 87:14-26), so
that there are about as many domains as displacement vectors and plastic flow without change of volume does not lock. Or the *triangles*
themselves, which lock, unless the volume change is the mean of those around their three nodes (average nodal pressure; Bonet
and Burton 1998): then the weights b_a add sum of (b_a . u_a) I to the gradient.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from geofem.scene import Array

OPTIONS: dict[str, Any] = {"cache": True, "error_model": "numpy"}


@dataclass(frozen=True)
class Domains:
    """Smoothing domains in compressed rows.

    first : (d + 1,) where each domain's entries begin. node : (k,) nodes. gradient, bulk : (k, 2) weights g and b (1/m).
    volume : (d,) areas (m2).
    """

    first: Array
    node: Array
    gradient: Array
    bulk: Array
    volume: Array

    @property
    def n(self) -> int:
        return len(self.volume)


def of_nodes(x: Array, cells: Array) -> Domains:
    """One domain around each of the nodes x (n, 2), of no volume where no cell (m, 3) meets."""
    first, node, gradient, volume = around_nodes(x, cells, *cells_of_nodes(len(x), cells))
    return Domains(first, node, gradient, np.zeros_like(gradient), volume)


def of_cells(x: Array, cells: Array, cured: bool) -> Domains:
    """One domain to each cell (m, 3); cured: with the volume change averaged around its nodes."""
    gradient, volume = gradients(x, cells)
    if not cured:
        flat = gradient.reshape(-1, 2)
        return Domains(3 * np.arange(len(cells) + 1), cells.ravel().copy(), flat, np.zeros_like(flat), volume)
    nodal = of_nodes(x, cells)
    first, node, flat, bulk = averaged(cells, gradient, nodal.first, nodal.node, nodal.gradient, len(x))
    return Domains(first, node, flat, bulk, volume)


@njit(**OPTIONS)
def gradients(x: Array, cells: Array) -> tuple[Array, Array]:
    """Gradients of the hat functions (m, 3, 2) and areas (m,) of triangles."""
    m = len(cells)
    gradient, area = np.empty((m, 3, 2)), np.empty(m)
    for c in range(m):
        a, b, d = cells[c, 0], cells[c, 1], cells[c, 2]
        twice = (x[b, 0] - x[a, 0]) * (x[d, 1] - x[a, 1]) - (x[d, 0] - x[a, 0]) * (x[b, 1] - x[a, 1])
        area[c] = 0.5 * twice
        for k in range(3):
            i, j = cells[c, (k + 1) % 3], cells[c, (k + 2) % 3]
            gradient[c, k, 0] = (x[i, 1] - x[j, 1]) / twice
            gradient[c, k, 1] = (x[j, 0] - x[i, 0]) / twice
    return gradient, area


@njit(**OPTIONS)
def cells_of_nodes(n: int, cells: Array) -> tuple[Array, Array]:
    """Compressed rows: the cells that meet at each node."""
    start = np.zeros(n + 1, np.int64)
    for c in range(len(cells)):
        for k in range(cells.shape[1]):
            start[cells[c, k] + 1] += 1
    for a in range(n):
        start[a + 1] += start[a]
    fill, which = start[:-1].copy(), np.empty(start[n], np.int64)
    for c in range(len(cells)):
        for k in range(cells.shape[1]):
            a = cells[c, k]
            which[fill[a]] = c
            fill[a] += 1
    return start, which


@njit(**OPTIONS)
def around_nodes(x: Array, cells: Array, start: Array, which: Array) -> tuple[Array, Array, Array, Array]:
    """Rows, nodes, weights and volumes of the domains around nodes."""
    n = len(x)
    gradient, area = gradients(x, cells)
    place = np.full(n, -1, np.int64)
    first, volume = np.zeros(n + 1, np.int64), np.zeros(n)
    node, weight = np.empty(3 * len(which), np.int64), np.zeros((3 * len(which), 2))
    k = 0
    for a in range(n):
        first[a] = k
        for s in range(start[a], start[a + 1]):
            volume[a] += area[which[s]] / 3.0
        for s in range(start[a], start[a + 1]):
            c = which[s]
            for i in range(3):
                b = cells[c, i]
                if place[b] < first[a]:
                    place[b] = k
                    node[k] = b
                    k += 1
                share = area[c] / (3.0 * volume[a])
                weight[place[b], 0] += share * gradient[c, i, 0]
                weight[place[b], 1] += share * gradient[c, i, 1]
    first[n] = k
    return first, node[:k].copy(), weight[:k].copy(), volume


@njit(**OPTIONS)
def averaged(
    cells: Array, gradient: Array, first: Array, node: Array, weight: Array, n: int
) -> tuple[Array, Array, Array, Array]:
    """Cells with the nodes around theirs: rows, nodes, weights of the gradient, and half the excess of the mean of the weights of
    the three nodal domains (``first``, ``node``, ``weight``) over them."""
    m = len(cells)
    rows, size = np.zeros(m + 1, np.int64), 0
    for c in range(m):
        for i in range(3):
            size += first[cells[c, i] + 1] - first[cells[c, i]]
    nodes, own, bulk = np.empty(size, np.int64), np.zeros((size, 2)), np.zeros((size, 2))
    place = np.full(n, -1, np.int64)
    k = 0
    for c in range(m):
        rows[c] = k
        for i in range(3):
            a = cells[c, i]
            for s in range(first[a], first[a + 1]):
                b = node[s]
                if place[b] < rows[c]:
                    place[b] = k
                    nodes[k] = b
                    k += 1
                bulk[place[b]] += weight[s] / 6.0
        for i in range(3):
            own[place[cells[c, i]]] += gradient[c, i]
            bulk[place[cells[c, i]]] -= 0.5 * gradient[c, i]
    rows[m] = k
    return rows, nodes[:k].copy(), own[:k].copy(), bulk[:k].copy()


@njit(**OPTIONS, inline="always")
def gradient_of(
    first: Array, node: Array, gradient: Array, bulk: Array, u: Array, d: int, start: float
) -> tuple[float, float, float, float]:
    """``start`` times the identity and the gradient of u (n, 2) over one domain: xx, xy, yx, yy."""
    xx, xy, yx, yy = start, 0.0, 0.0, start
    for s in range(first[d], first[d + 1]):
        a = node[s]
        ux, uy = u[a, 0], u[a, 1]
        more = ux * bulk[s, 0] + uy * bulk[s, 1]
        xx += ux * gradient[s, 0] + more
        xy += ux * gradient[s, 1]
        yx += uy * gradient[s, 0]
        yy += uy * gradient[s, 1] + more
    return xx, xy, yx, yy


@njit(**OPTIONS)
def strain(first: Array, node: Array, gradient: Array, bulk: Array, u: Array, lo: int, hi: int, out: Array) -> None:
    """Gradients of u (n, 2) over the domains lo to hi, into out (d, 4): xx, xy, yx, yy."""
    for d in range(lo, hi):
        out[d, 0], out[d, 1], out[d, 2], out[d, 3] = gradient_of(first, node, gradient, bulk, u, d, 0.0)


@njit(**OPTIONS)
def add_forces(first: Array, node: Array, gradient: Array, bulk: Array, volume: Array, P: Array, force: Array) -> None:
    """Add the nodal forces (n, 2) of the stresses P (d, 4)."""
    for d in range(len(volume)):
        V = volume[d]
        xx, xy, yx, yy = V * P[d, 0], V * P[d, 1], V * P[d, 2], V * P[d, 3]
        trace = xx + yy
        for s in range(first[d], first[d + 1]):
            a = node[s]
            force[a, 0] += xx * gradient[s, 0] + xy * gradient[s, 1] + trace * bulk[s, 0]
            force[a, 1] += yx * gradient[s, 0] + yy * gradient[s, 1] + trace * bulk[s, 1]
