"""The tessellated nodes as a dolfinx mesh: made from the arrays of rank 0, by a cut across the longest side, without a graph."""

from __future__ import annotations

from typing import Any

import numpy as np
from dolfinx import graph, mesh
from mpi4py import MPI

from geofem.methods.pfem.tessellation import Tessellation
from geofem.scene import Array


def sliced(cells: Array, x: Array) -> Any:
    """A partitioner that cuts the cells into parts of equal number along the longest side of the cloud.

    cells, x : on rank 0, empty elsewhere. A quarter to a third cheaper than a partition of the graph, on one rank too.
    """
    centre = x[cells].mean(axis=1) if len(cells) else np.empty((0, 1))
    along = centre[:, np.argmax(np.ptp(centre, axis=0))] if len(cells) else np.empty(0)
    place = np.empty(len(cells), np.int64)
    place[np.argsort(along, kind="stable")] = np.arange(len(cells))

    def partition(comm: MPI.Intracomm, parts: int, kinds: list, vertices: list) -> Any:
        destination = (place * parts // max(len(cells), 1)).astype(np.int32)
        return graph.adjacencylist(destination, np.arange(len(cells) + 1, dtype=np.int32))._cpp_object

    return partition


def make_mesh(comm: MPI.Intracomm, domain: Any, x: Array, tessellation: Tessellation | None) -> tuple[mesh.Mesh, Array]:
    """The mesh, and the node of the cloud at each of its local geometry nodes. Collective.

    x : (n, gdim) nodes. tessellation : on rank 0, None elsewhere. Nodes of no cell are left out.
    """
    if tessellation is not None:
        used, inverse = np.unique(tessellation.cells, return_inverse=True)
        cells, points = inverse.reshape(tessellation.cells.shape), x[used]
    else:
        used, cells, points = np.empty(0, np.int64), np.empty((0, x.shape[1] + 1), np.int64), np.empty((0, x.shape[1]))
    made = mesh.create_mesh(comm, cells, domain, points, sliced(cells, points))
    if comm.size > 1:
        used = comm.bcast(used)
    return made, used[made.geometry.input_global_indices]
