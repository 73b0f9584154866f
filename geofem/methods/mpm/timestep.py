"""A time step that knows of light nodes: the largest frequency that the points can drive the grid at, bounded node by node.

The stiffness that the points lend the nodes is, against any nodal motion u, at most sum_p m_p c_p**2 |sum_n u_n (x) g_np|**2 with
the speed c_p of compression waves in its body as it is now; by Cauchy and Schwarz and by Gershgorin's circles

    omega**2  <=  max_n R_n / m_n,    R_n = sum_p m_p c_p**2 |g_np| sum_m |g_mp|,    m_n = sum_p S_np m_p.

For one point in the middle of every cell that is exact in one dimension, where 2 / omega = h / c, and a factor of sqrt(2) on the
safe side in two. Where the last point of a body with hats has just passed a node, by xi cells, the bound falls like sqrt(xi), as the
critical step itself does. Nodes that move as one with their neighbour (``small_mass``) count as one.

What of it is stable depends on when the stress is updated. To the strain of a frozen mode, e' = e + dt (v + a dt) with a = -omega**2 e
in the scheme usl, the points add what they keep of its acceleration, v' = v + p a dt, where p <= 1 is what is left of the mode
once it went through the points: omega dt <= 2 for p = 1, but sqrt(2) for p = 0. In usf and musl, whose strains come from velocities
that went through the points, omega dt <= 2 / sqrt(p): light nodes do them no harm, as p is small for them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from mpi4py import MPI
from numba import njit

from geofem.methods.mpm import grid as g
from geofem.methods.mpm.deeds import MASS, inlined, putting
from geofem.methods.mpm.grid import OPTIONS
from geofem.methods.mpm.kind import Kind
from geofem.methods.mpm.shapes import SHAPES

EVERY = 4
"""Steps between two looks."""
SAFETY = {"usl": math.sqrt(2.0), "musl": 1.0, "usf": 1.0}
"""omega dt <= 2 over this, whatever the points keep."""
ROW_SUM = 1
"""The column of R, as that of the mass is ``MASS``."""


class NodalStep:
    """The bound of omega, looked at again every few steps."""

    def __init__(self, kind: Kind):
        self.kind = kind
        self._looked = -EVERY
        self._frequency = 0.0

    def frequency(self, model: Any) -> float:
        """2 over the largest step (1/s) that is stable in an ``ExplicitMpm``. Collective."""
        if model.work["steps"] >= self._looked + EVERY or model.work["steps"] < self._looked:
            self._looked = model.work["steps"]
            self._frequency = SAFETY[self.kind.scheme] * self._bound(model)
        return self._frequency

    def _bound(self, model: Any) -> float:
        """The bound of omega (1/s)."""
        grid = model.grid
        nodes = np.zeros_like(grid.nodes)
        gradients, seen, near = np.zeros((len(nodes), 3)), np.full(len(nodes), -1, np.int64), np.zeros(MOST, np.int64)
        rows = make_rows(self.kind)
        for body, speed in zip(model.bodies, model._sounds):
            seen[:] = -1
            rows(body.cloud, body.N, speed / grid.h, grid.lattice, nodes, gradients, seen, near)
        dim, per_row = grid.dim, int(np.prod(grid.shape[1:]))
        if model.stepper.small_mass > 0.0:
            end = grid.first + len(nodes) // per_row
            box = (grid.first, end, 0, 1 if dim == 2 else grid.shape[1], 0, grid.shape[-1])
            partner, lent = np.zeros_like(model.stepper.partner), np.zeros_like(model.stepper.lent)
            g.merge_small(nodes, dim, box, grid.rows, model.stepper.small_mass, partner, lent)
        low, high = (row * per_row - grid.first * per_row for row in grid.own)
        mass, row_sum = nodes[max(low, 0) : high, MASS], nodes[max(low, 0) : high, ROW_SUM]
        there = mass > model.stepper.least_mass
        largest = float(np.max(row_sum[there] / mass[there], initial=0.0))
        return math.sqrt(model.comm.allreduce(largest, op=MPI.MAX))


MOST = 4096
"""Nodes of one point at most."""


@cache
def make_rows(kind: Kind) -> Callable[..., None]:
    """Masses and the row sums R of the nodes from the first ``count`` points of a body.

    (q, count, speed (cells/s), lattice, nodes, gradients (n, 3) of zeros, seen (n,) of -1, near (most,)) -> None. The gradients of a
    point are gathered node by node first, as the sites of a domain may share nodes.
    """

    @inlined
    def give(w, gx, gy, gz, x, y, z, a):  # type: ignore[no-untyped-def]
        p, m = a
        return w * m, gx, gy, gz, p

    @inlined
    def add(grid, n, f, got):  # type: ignore[no-untyped-def]
        m, gx, gy, gz, p = got
        collect(grid, n, p, f * m, f * gx, f * gy, f * gz)

    over = SHAPES[kind.shape].over(kind.dim)(putting(give, add))

    @njit(**OPTIONS)
    def rows(q, number, speed, lattice, nodes, gradients, seen, near):  # type: ignore[no-untyped-def]
        count = np.zeros(1, np.int64)
        for p in range(number):
            count[0] = 0
            m = q.mass[p]
            over((nodes, gradients, seen, near, count), lattice, q.at, q.domain, q.stretch, p, (p, m))
            total = 0.0
            for k in range(count[0]):
                d = gradients[near[k]]
                d[0] = np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
                total += d[0]
            for k in range(count[0]):
                n = near[k]
                nodes[n, ROW_SUM] += m * speed * speed * gradients[n, 0] * total
                gradients[n, 0] = gradients[n, 1] = gradients[n, 2] = 0.0

    return rows


@njit(**OPTIONS)
def collect(grid, n, p, m, gx, gy, gz):  # type: ignore[no-untyped-def]
    """Add the mass and the gradient of point p at node n. A function of its own: numba 0.68 drops what is written into a tuple's
    arrays where it puts code in place."""
    nodes, gradients, seen, near, count = grid
    if seen[n] != p:
        seen[n] = p
        near[count[0]] = n
        count[0] += 1
    nodes[n, MASS] += m
    gradients[n, 0] += gx
    gradients[n, 1] += gy
    gradients[n, 2] += gz
