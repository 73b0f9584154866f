"""Material points on several ranks: slabs of the grid along x, points that migrate, and copies of those near a slab's borders.

Every rank steps its own points and copies of all others that can bear on them within one step, without a word to the other ranks
in between, and adds them to the grid in an order that all ranks share. What it computes for its own points is therefore what one
rank alone would compute, to the last bit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI
from numba import njit

from geofem.methods.mpm.points import KEPT, Body
from geofem.mistake import Mistake
from geofem.scene import Array


@dataclass(frozen=True)
class Slabs:
    """Which rank has which cells: rank r those with bounds[r] <= i < bounds[r + 1] along x, and copies from ``halo`` cells around."""

    comm: MPI.Intracomm
    bounds: Array
    halo: int

    def owner(self, i: Array) -> Array:
        return np.searchsorted(self.bounds[1:-1], i, side="right")

    @property
    def own(self) -> tuple[int, int]:
        return int(self.bounds[self.comm.rank]), int(self.bounds[self.comm.rank + 1])

    def window(self, last: int) -> tuple[int, int]:
        """Rows of nodes, first and end, that the rank's points and copies can reach: no farther than half the halo."""
        low, high = self.own
        reach = max(3, self.halo // 2 + 1)
        return max(0, low - self.halo - reach), min(last, high + self.halo + reach + 1)


def make_slabs(comm: MPI.Intracomm, cells: Array, rows: int, halo: int) -> Slabs:
    """Slabs that hold about the same number of points each; cells : (N,) place of every point along x, rows : cells along x."""
    if comm.size > rows:
        raise Mistake(f"the grid has {rows} rows of cells along x, too few for {comm.size} ranks; start fewer, or raise n")
    inner = np.quantile(cells, np.arange(1, comm.size) / comm.size, method="nearest").astype(int) if comm.size > 1 else []
    bounds = np.concatenate([[0], inner, [rows]]).astype(int)
    # every rank has at least one row, so that the slabs are in order
    for r in range(1, len(bounds) - 1):
        bounds[r] = min(max(bounds[r], bounds[r - 1] + 1), rows - (len(bounds) - 1 - r))
    return Slabs(comm, bounds, halo)


def exchange(body: Body, row: Array, slabs: Slabs) -> None:
    """Hand points over to the ranks whose cells they have come to, and copies to those they can bear on. Collective.

    row : (n,) the cell along x of each of the rank's own points.
    """
    comm, rank = slabs.comm, slabs.comm.rank
    body.N = body.n
    wanted, counts, gone = sort_out(row, slabs.bounds, slabs.halo, rank)
    received = alltoall(comm, pack(body, wanted, row), counts)
    drop(body, gone)
    ours = slabs.owner(np.ascontiguousarray(received[:, 0]).view(np.int64)) == rank
    unpack(body, received, np.concatenate([np.flatnonzero(ours), np.flatnonzero(~ours)]))
    body.n = body.N - int((~ours).sum())
    body.settle()
    body.reorder()


@njit(cache=True)
def sort_out(row: Any, bounds: Any, halo: int, rank: int) -> Any:
    """Which points each rank must have, its own apart: their numbers, rank after rank, how many for each, and the ``gone`` (n,) that
    have left this rank's cells. A rank keeps copies of those of its own that have left and still bear on its points."""
    size = len(bounds) - 1
    low = bounds[rank] if rank > 0 else -(1 << 62)
    high = bounds[rank + 1] if rank < size - 1 else 1 << 62
    counts, gone = np.zeros(size, np.int64), np.zeros(len(row), np.bool_)
    wanted, fill = np.empty(0, np.int64), np.zeros(size, np.int64)
    for sweep in range(2):
        if sweep == 1:
            wanted = np.empty(counts.sum(), np.int64)
            fill[1:] = np.cumsum(counts)[:-1]
        for p in range(len(row)):
            i = row[p]
            if low + halo <= i < high - halo:
                continue  # nobody else's
            gone[p] = not low <= i < high
            for r in range(size):
                if bounds[r] - halo <= i < bounds[r + 1] + halo and (r != rank or gone[p]):
                    if sweep == 0:
                        counts[r] += 1
                    else:
                        wanted[fill[r]] = p
                        fill[r] += 1
    return wanted, counts, gone


def drop(body: Body, which: Array) -> None:
    """Remove own points, filling their places from the end."""
    stay = int((~which).sum())
    holes = np.flatnonzero(which[:stay])
    if stay < body.n:
        fill = stay + np.flatnonzero(~which[stay:])
        for name in KEPT:
            array = body.arrays[name]
            array[holes] = array[fill]
    body.n = body.N = stay


def columns(body: Body) -> list[tuple[Array, int, int]]:
    """Each array that a point takes along, as rows of numbers (integers keep their bits), and its columns in a table of points."""
    out, first = [], 1
    for name in KEPT:
        array = body.arrays[name]
        width = int(np.prod(array.shape[1:]))
        rows = (array.view(np.float64) if array.dtype == np.int64 else array).reshape(len(array), width)
        out.append((rows, first, first + width))
        first += width
    return out


def pack(body: Body, which: Array, row: Array) -> Array:
    """Points as rows of numbers, the first of which is the cell along x."""
    found = columns(body)
    table = np.empty((len(which), found[-1][2]))
    table[:, 0] = row[which].view(np.float64)
    for rows, first, _ in found:
        copy_rows(rows, which, 0, table, first, 0, rows.shape[1])
    return table


def unpack(body: Body, table: Array, which: Array) -> None:
    """Append the points ``which`` of a table to the body's."""
    body.make_room(body.N + len(which))
    for rows, first, end in columns(body):
        copy_rows(table, which, first, rows, 0, body.N, end - first)
    body.N += len(which)


@njit(cache=True)
def copy_rows(source: Any, which: Any, first: int, target: Any, to: int, row: int, width: int) -> None:
    """Copy ``width`` columns of some rows of an array into the rows of another from ``row`` on."""
    for k in range(len(which)):
        for c in range(width):
            target[row + k, to + c] = source[which[k], first + c]


def alltoall(comm: MPI.Intracomm, table: Array, counts: Array) -> Array:
    """Rows for each rank, ``counts`` of them, rank after rank -> the rows received, in the order of the ranks."""
    width = table.shape[1]
    arriving = np.empty_like(counts)
    comm.Alltoall(counts, arriving)
    out = np.empty((int(arriving.sum()), width))
    comm.Alltoallv([table, counts * width, MPI.DOUBLE], [out, arriving * width, MPI.DOUBLE])
    return out


def gathered(comm: MPI.Intracomm, body: Body) -> dict[str, Array] | None:
    """All points of a body on rank 0 in the order of their numbers; None elsewhere."""
    fields = {name: body.own(name) for name in KEPT}
    parts = comm.gather(fields) if comm.size > 1 else [fields]
    if parts is None:
        return None
    whole = {name: np.concatenate([part[name] for part in parts]) for name in KEPT}
    order = np.argsort(whole["id"], kind="stable")
    return {name: values[order] for name, values in whole.items()}
