"""The enriched basis in a cell, and what is integrated with it: the blocks of the stiffness, fields and forces at points.

Local dofs: component c of node i is 2 i + c; the enriched dofs follow after all standard ones of this rank, ghosts included.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from geofem.core.neartip import branches, modes
from geofem.materials.kinematics import kernel
from geofem.methods.xfem.enrichment import JUMP, MODES, WIDTH, CellEntries, Entries, Functions
from geofem.methods.xfem.geometry import Lines, Tips, polar
from geofem.methods.xfem.junctions import Sectors, part
from geofem.methods.xfem.rules import Rule
from geofem.scene import Array


class World(NamedTuple):
    """All that the basis depends on: nodes X (n, 2), cells T (m, 3), entries, functions, the cracks and their sectors."""

    X: Array
    T: Array
    entries: Entries
    functions: Functions
    lines: Lines
    sectors: Sectors
    tips: Tips


class Scratch(NamedTuple):
    """Values N (3,) and gradients dN (3, 2) of the hat functions, and room for those of tips."""

    N: Array
    dN: Array
    u: Array
    gu: Array
    f: Array
    gf: Array


@kernel
def scratch() -> Scratch:
    return Scratch(np.empty(3), np.empty((3, 2)), np.empty((2, 2)), np.empty((2, 2, 2)), np.empty(4), np.empty((4, 2)))


@kernel
def hat_gradients(cell: int, world: World, dN: Array) -> None:
    """The gradients of the three hat functions of a cell."""
    a, b, c = world.X[world.T[cell, 0]], world.X[world.T[cell, 1]], world.X[world.T[cell, 2]]
    double = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    dN[0, 0], dN[0, 1] = (b[1] - c[1]) / double, (c[0] - b[0]) / double
    dN[1, 0], dN[1, 1] = (c[1] - a[1]) / double, (a[0] - c[0]) / double
    dN[2, 0], dN[2, 1] = (a[1] - b[1]) / double, (b[0] - a[0]) / double


@kernel
def hats(x: float, y: float, cell: int, world: World, s: Scratch) -> None:
    """The values of the three hat functions at a point; their gradients must be there."""
    a = world.X[world.T[cell, 0]]
    s.N[1] = s.dN[1, 0] * (x - a[0]) + s.dN[1, 1] * (y - a[1])
    s.N[2] = s.dN[2, 0] * (x - a[0]) + s.dN[2, 1] * (y - a[1])
    s.N[0] = 1.0 - s.N[1] - s.N[2]


@kernel
def width_of(k: int, acting: CellEntries, world: World) -> int:
    """Number of enriched dofs in the k-th cell."""
    width = 0
    for p in range(acting.start[k], acting.start[k + 1]):
        width += WIDTH[world.functions.kind[world.entries.function[acting.entry[p]]]]
    return width


@kernel
def widest_of(acting: CellEntries, world: World) -> int:
    """The largest number of enriched dofs in a cell."""
    widest = 0
    for k in range(acting.start.shape[0] - 1):
        widest = max(widest, width_of(k, acting, world))
    return widest


@kernel
def dofs_of(k: int, cell: int, acting: CellEntries, world: World, out: Array) -> int:
    """The local dofs of the k-th cell: six standard ones, then the enriched ones; returns how many."""
    for v in range(3):
        out[2 * v], out[2 * v + 1] = 2 * world.T[cell, v], 2 * world.T[cell, v] + 1
    n = 6
    for p in range(acting.start[k], acting.start[k + 1]):
        e = acting.entry[p]
        for j in range(WIDTH[world.functions.kind[world.entries.function[e]]]):
            out[n] = 2 * world.X.shape[0] + world.entries.dof[e] + j
            n += 1
    return n


@kernel
def enriched(x: float, y: float, k: int, acting: CellEntries, world: World, s: Scratch, V: Array, G: Array) -> None:
    """Values V (dofs, 2) and gradients G (dofs, 2, 2) of the enriched basis functions of the k-th cell at a point."""
    entries, functions = world.entries, world.functions
    V[:], G[:] = 0.0, 0.0
    n, present = 0, -1
    here, R, R0, R1 = 0.0, 1.0, 0.0, 0.0
    for p in range(acting.start[k], acting.start[k + 1]):
        v, e = acting.vertex[p], acting.entry[p]
        f = entries.function[e]
        kind, of = functions.kind[f], functions.of[f]
        if f != present:
            present = f
            if kind == JUMP:
                here = part(x, y, world.lines, world.sectors, of)
            else:
                r, theta = polar(x, y, world.lines, world.tips, of, 0.0)
                ax, ay = world.tips.axis[of]
                if kind == MODES:
                    modes(r, theta, ax, ay, functions.kappa[f], s.u, s.gu)
                else:
                    branches(r, theta, ax, ay, s.f, s.gf)
                R, R0, R1 = 1.0, 0.0, 0.0
                if functions.ramp[f]:
                    R = 0.0
                    for q in range(p, acting.start[k + 1]):
                        if entries.function[acting.entry[q]] == f:
                            at, ramp = acting.vertex[q], entries.ramp[acting.entry[q]]
                            R += s.N[at] * ramp
                            R0 += s.dN[at, 0] * ramp
                            R1 += s.dN[at, 1] * ramp
        if kind == JUMP:
            h = 0.5 * (here - entries.value[e, 0]) if here != 0.0 else 0.0
            for c in range(2):
                V[n, c] = s.N[v] * h
                G[n, c, 0], G[n, c, 1] = s.dN[v, 0] * h, s.dN[v, 1] * h
                n += 1
            continue
        weight = s.N[v] * R
        slope0, slope1 = s.dN[v, 0] * R + s.N[v] * R0, s.dN[v, 1] * R + s.N[v] * R1
        if kind == MODES:
            for m in range(2):
                for i in range(2):
                    rise = s.u[m, i] - entries.value[e, 2 * m + i]
                    V[n, i] = weight * rise
                    G[n, i, 0] = slope0 * rise + weight * s.gu[m, i, 0]
                    G[n, i, 1] = slope1 * rise + weight * s.gu[m, i, 1]
                n += 1
        else:
            for j in range(4):
                rise = s.f[j] - entries.value[e, j]
                for c in range(2):
                    V[n, c] = weight * rise
                    G[n, c, 0], G[n, c, 1] = slope0 * rise + weight * s.gf[j, 0], slope1 * rise + weight * s.gf[j, 1]
                    n += 1


@kernel
def blocks(rule: Rule, acting: CellEntries, world: World, lam: Array, mu: Array) -> tuple[Array, Array, Array]:
    """The blocks of the stiffness that enriched dofs have a part in, as rows, columns and values of local dofs.

    lam, mu : (all cells,) Lame constants (Pa) in the plane. The block of standard dofs is that of a mesh without cracks.
    """
    size, widest = 0, 0
    for k in range(rule.cells.shape[0]):
        width = width_of(k, acting, world)
        size += width * (width + 12)
        widest = max(widest, width)
    rows, columns, values = np.empty(size, np.int64), np.empty(size, np.int64), np.empty(size)
    V, G = np.empty((widest, 2)), np.empty((widest, 2, 2))
    # a row for each component, so that the innermost loop runs along it
    e = np.zeros((3, widest + 6))
    K = np.empty((widest + 6, widest + 6))
    dofs = np.empty(widest + 6, np.int64)
    s = scratch()
    filled = 0
    for k in range(rule.cells.shape[0]):
        cell = rule.cells[k]
        n = dofs_of(k, cell, acting, world, dofs)
        hat_gradients(cell, world, s.dN)
        K[:n, :n] = 0.0
        for v in range(3):
            e[0, 2 * v], e[2, 2 * v] = s.dN[v, 0], s.dN[v, 1]
            e[1, 2 * v + 1], e[2, 2 * v + 1] = s.dN[v, 1], s.dN[v, 0]
            e[1, 2 * v] = e[0, 2 * v + 1] = 0.0
        for q in range(rule.start[k], rule.start[k + 1]):
            hats(rule.x[q, 0], rule.x[q, 1], cell, world, s)
            enriched(rule.x[q, 0], rule.x[q, 1], k, acting, world, s, V, G)
            wl, wm = rule.w[q] * lam[cell], rule.w[q] * mu[cell]
            for a in range(6, n):
                g = G[a - 6]
                e[0, a], e[1, a], e[2, a] = g[0, 0], g[1, 1], g[0, 1] + g[1, 0]
            for a in range(6, n):
                t0 = (wl + 2.0 * wm) * e[0, a] + wl * e[1, a]
                t1 = wl * e[0, a] + (wl + 2.0 * wm) * e[1, a]
                t2 = wm * e[2, a]
                for b in range(a + 1):
                    K[a, b] += t0 * e[0, b] + t1 * e[1, b] + t2 * e[2, b]
        for a in range(6, n):
            for b in range(a + 1):
                rows[filled], columns[filled], values[filled] = dofs[a], dofs[b], K[a, b]
                filled += 1
                if b < a:
                    rows[filled], columns[filled], values[filled] = dofs[b], dofs[a], K[a, b]
                    filled += 1
    return rows[:filled], columns[:filled], values[:filled]


@kernel
def fields_at(rule: Rule, acting: CellEntries, world: World, x: Array) -> tuple[Array, Array]:
    """The displacement (n, 2) and its gradient (n, 2, 2) at the points of a rule; x : all local dofs."""
    widest = widest_of(acting, world)
    V, G = np.empty((widest, 2)), np.empty((widest, 2, 2))
    dofs = np.empty(widest + 6, np.int64)
    s = scratch()
    u, g = np.zeros((rule.w.shape[0], 2)), np.zeros((rule.w.shape[0], 2, 2))
    for k in range(rule.cells.shape[0]):
        cell = rule.cells[k]
        n = dofs_of(k, cell, acting, world, dofs)
        hat_gradients(cell, world, s.dN)
        for q in range(rule.start[k], rule.start[k + 1]):
            hats(rule.x[q, 0], rule.x[q, 1], cell, world, s)
            for v in range(3):
                for i in range(2):
                    nodal = x[dofs[2 * v + i]]
                    u[q, i] += s.N[v] * nodal
                    g[q, i, 0] += s.dN[v, 0] * nodal
                    g[q, i, 1] += s.dN[v, 1] * nodal
            if n > 6:
                enriched(rule.x[q, 0], rule.x[q, 1], k, acting, world, s, V, G)
                for a in range(6, n):
                    for i in range(2):
                        u[q, i] += V[a - 6, i] * x[dofs[a]]
                        g[q, i, 0] += G[a - 6, i, 0] * x[dofs[a]]
                        g[q, i, 1] += G[a - 6, i, 1] * x[dofs[a]]
    return u, g
