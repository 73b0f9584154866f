"""Material points on several ranks: slabs of the grid along x, points that migrate, and copies of those near a slab's borders.

Every rank steps its own points and copies of all others that can bear on them within one step, without a word to the other ranks
in between, and adds them to the grid in an order that all ranks share. What it computes for its own points is therefore what one
rank alone would compute, to the last bit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

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
    comm, size, rank = slabs.comm, slabs.comm.size, slabs.comm.rank
    body.N = body.n
    owner = slabs.owner(row)
    packets = []
    for r in range(size):
        low, high = slabs.bounds[r] - slabs.halo, slabs.bounds[r + 1] + slabs.halo
        wanted = (
            np.flatnonzero((row >= low) & (row < high))
            if r != rank
            else np.flatnonzero((owner != rank) & (row >= low) & (row < high))
        )
        packets.append(pack(body.pick(wanted), row[wanted]))
    kept = packets[rank]
    packets[rank] = kept[:0]
    received = alltoall(comm, packets)
    received = np.concatenate([received, kept])
    drop(body, owner != rank)
    rows, fields = unpack(received, body)
    ours = slabs.owner(rows) == rank
    body.add({name: values[ours] for name, values in fields.items()}, own=True)
    body.add({name: values[~ours] for name, values in fields.items()}, own=False)
    body.settle()
    body.reorder()


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


def pack(fields: dict[str, Array], row: Array) -> Array:
    """Points as rows of numbers; integers keep their bits."""
    columns = [row.astype(np.int64).view(np.float64)[:, None]]
    for name in KEPT:
        values = np.ascontiguousarray(fields[name])
        width = int(np.prod(values.shape[1:]))
        columns.append((values.view(np.float64) if values.dtype == np.int64 else values).reshape(len(row), width))
    return np.hstack(columns)


def unpack(table: Array, like: Body) -> tuple[Array, dict[str, Array]]:
    """What ``pack`` packed."""
    row = np.ascontiguousarray(table[:, 0]).view(np.int64)
    fields, at = {}, 1
    for name in KEPT:
        array = like.arrays[name]
        width = int(np.prod(array.shape[1:]))
        values = np.ascontiguousarray(table[:, at : at + width])
        at += width
        fields[name] = (
            values.view(np.int64).ravel() if array.dtype == np.int64 else values.reshape(len(table), *array.shape[1:])
        )
    return row, fields


def alltoall(comm: MPI.Intracomm, packets: list[Array]) -> Array:
    """Rows sent to each rank -> the rows received, in the order of the ranks."""
    width = packets[0].shape[1]
    counts = np.array([len(packet) for packet in packets], np.int64)
    arriving = np.empty_like(counts)
    comm.Alltoall(counts, arriving)
    out = np.empty((int(arriving.sum()), width))
    comm.Alltoallv([np.concatenate(packets), counts * width, MPI.DOUBLE], [out, arriving * width, MPI.DOUBLE])
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
