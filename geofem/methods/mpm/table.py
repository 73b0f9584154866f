"""Shape functions of all points in arrays, for solvers that come back to them again and again, and points grouped by their cells."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numba import njit
from numba.extending import register_jitable

from geofem.materials.kinematics import FLAGS
from geofem.methods.mpm.deeds import inlined, putting
from geofem.methods.mpm.grid import OPTIONS
from geofem.methods.mpm.kind import Kind
from geofem.methods.mpm.shapes import SHAPES
from geofem.scene import Array

NOTHING = 1e-13
"""Weights and gradients (per cell) below this are rounding."""


@dataclass(frozen=True)
class Table:
    """What N points know of the grid; row p of the arrays (N, most) is filled up to ``count[p]``.

    node : nodes of the grid's window. weight : S_np. gradient : (N, most, d) grad S_np (1/m).
    """

    count: Array
    node: Array
    weight: Array
    gradient: Array


@dataclass(frozen=True)
class Groups:
    """Points that lie in the same cell of the grid, as the elements of a system.

    points : (N,) the points, one group after the other; start : (groups + 1,) where each group begins.
    nodes : (all,) the nodes that the points of a group reach together, local dof blocks; first : (groups + 1,) where those begin.
    slot : (N, most) the place of a point's nodes among those of its group.
    """

    points: Array
    start: Array
    nodes: Array
    first: Array
    slot: Array


@cache
def make_table(kind: Kind) -> Callable[..., None]:
    """(q, F, number, lattice, count, node, weight, gradient) -> None for the first ``number`` points; gradients per cell."""
    dim = kind.dim

    @inlined
    def give(w, gx, gy, gz, x, y, z, a):  # type: ignore[no-untyped-def]
        return w, gx, gy, gz, a

    # not inlined: numba 0.68 loses what follows a loop of unknown length in code that it inlines before it infers types
    @register_jitable(**FLAGS)
    def add(out, n, f, got):  # type: ignore[no-untyped-def]
        count, node, weight, gradient = out
        w, gx, gy, gz, p = got
        if abs(f * w) + abs(f * gx) + abs(f * gy) + abs(f * gz) <= NOTHING:
            return
        k = 0
        while k < count[p] and node[p, k] != n:
            k += 1
        if k == node.shape[1]:
            return
        if k == count[p]:
            node[p, k] = n
            count[p] = k + 1
        weight[p, k] += f * w
        gradient[p, k, 0] += f * gx
        gradient[p, k, 1] += f * gy
        if dim == 3:
            gradient[p, k, 2] += f * gz

    over = SHAPES[kind.shape].over(dim)(putting(give, add))

    @njit(**OPTIONS)
    def table(q, F, number, lattice, count, node, weight, gradient):  # type: ignore[no-untyped-def]
        for p in range(number):
            over((count, node, weight, gradient), lattice, q.at, q.domain, F, p, p)

    return table


def most_nodes(kind: Kind, extent: float) -> int:
    """Nodes that a point can reach at most; extent : half the largest extent of a domain along an axis (cells)."""
    shape = SHAPES[kind.shape]
    if shape.domain in ("edges", "corners"):
        return 4**kind.dim  # those of the cells around the corners
    reach = extent if shape.spread else shape.reach
    return int(math.ceil(2 * reach + (3 if shape.spread else 2))) ** kind.dim


def tabulate(bodies: list[Any], kind: Kind, lattice: Any, extent: float) -> Table:
    """The table of the rank's own points of all bodies, one body after the other."""
    most, dim, parts = most_nodes(kind, extent), kind.dim, []
    for body in bodies:
        n = body.n
        part = np.zeros(n, np.int64), np.zeros((n, most), np.int64), np.zeros((n, most)), np.zeros((n, most, dim))
        F = body.arrays["F"]
        if kind.small:
            F = np.tile([1.0, 0.0, 0.0, 1.0, 1.0] if dim == 2 else np.eye(3).ravel(), (n, 1))
        make_table(kind)(body.cloud, F, n, lattice, *part)
        parts.append(part)
    count, node, weight, gradient = (np.concatenate(arrays) for arrays in zip(*parts))
    gradient *= lattice[3]
    return Table(count, node, weight, gradient)


def group(table: Table, cell: Array, dof_of_node: Array) -> Groups:
    """Group points by the number of their cell (N,)."""
    points = np.argsort(cell, kind="stable")
    _, begin, of_sorted = np.unique(cell[points], return_index=True, return_inverse=True)
    groups = len(begin)
    of = np.empty(len(cell), np.int64)
    of[points] = of_sorted
    there = np.arange(table.node.shape[1]) < table.count[:, None]
    dofs = dof_of_node[table.node[there]]
    size = int(dofs.max(initial=0)) + 1
    keys, place = np.unique(np.repeat(of, table.count) * size + dofs, return_inverse=True)
    first = np.searchsorted(keys // size, np.arange(groups + 1))
    slot = np.zeros_like(table.node)
    slot[there] = place - first[np.repeat(of, table.count)]
    return Groups(points, np.append(begin, len(points)), keys % size, first, slot)
