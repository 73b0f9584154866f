"""Where the tension in a body is largest, away from its cracks."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from geofem.core.propagation import Peak
from geofem.methods.xfem.cracked import Cracked

EQUAL = 1e-9
"""Tensions that differ by less than this part are equal: rounding must not choose among them."""


def peak(body: Cracked, away: float) -> Peak | None:
    """The largest principal stress, averaged over the cells at a node, of nodes farther than ``away`` (m) from all cracks. Collective.

    Cells with enriched nodes are left out: their stress varies. None if no node is left.
    """
    grid = body.grid
    plain = np.flatnonzero(~(np.diff(body.enrichment.entries.start) > 0)[grid.T].any(axis=1))
    u, nodes = body.nodal(), grid.T[plain].ravel()
    g = np.stack([grid.slope(u[:, i], plain) for i in range(2)], axis=1)
    sigma = body.stress(g, plain)[:, [0, 1, 3]] * grid.area[plain, None]
    area = grid.sum_to_nodes(nodes, np.repeat(grid.area[plain], 3))
    xx, yy, xy = (grid.sum_to_nodes(nodes, np.repeat(part, 3)) for part in sigma.T)
    # the integral of a hat function's gradient is zero inside, and points outward on the boundary
    corners = grid.X[grid.T]
    opposite = 0.5 * (np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)).reshape(-1, 2)
    outward = np.stack([grid.sum_to_nodes(grid.T.ravel(), part) for part in (-opposite[:, 1], opposite[:, 0])], axis=1)
    free = (area > 0.0) & (np.arange(len(area)) < grid.owned)
    lines = body.lines
    inner = np.setdiff1d(np.arange(len(lines.points)), lines.start[1:] - 1)
    for a, b in zip(lines.points[inner], lines.points[inner + 1]):
        t = np.clip((grid.X - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        free &= np.hypot(*(grid.X - a - t[:, None] * (b - a)).T) > away
    chosen = np.flatnonzero(free)
    xx, yy, xy = (part[chosen] / area[chosen] for part in (xx, yy, xy))
    tension = 0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy)
    largest = grid.comm.allreduce(float(tension.max(initial=-np.inf)), op=MPI.MAX)
    if not np.isfinite(largest):
        return None
    equal = np.flatnonzero(tension >= largest - EQUAL * abs(largest))
    angle = 0.5 * np.arctan2(2.0 * xy[equal], xx[equal] - yy[equal])
    rim = np.hypot(*outward[chosen[equal]].T) > 1e-6 * np.sqrt(grid.support[chosen[equal]])
    mine = zip(grid.X[chosen[equal]].tolist(), angle.tolist(), outward[chosen[equal]].tolist(), rim.tolist())
    at, turned, normal, on_rim = min(found for part in grid.comm.allgather(list(mine)) for found in part)
    unit = np.array(normal) / (np.hypot(*normal) or 1.0)
    return Peak(largest, np.array(at), np.array([np.cos(turned), np.sin(turned)]), unit if on_rim else None)
