"""The whole of a distributed field on rank 0: for pictures, and for checkpoints that any number of ranks can take up."""

from __future__ import annotations

from typing import Any

import numpy as np
from dolfinx import fem, plot
from mpi4py import MPI
from scipy.spatial import cKDTree

from geofem.mistake import Mistake

CELLS = {5: "triangle", 22: "triangle6", 69: "triangle", 9: "quad", 70: "quad", 23: "quad8", 28: "quad9", 10: "tetra", 24: "tetra10",
         71: "tetra", 12: "hexahedron", 29: "hexahedron27", 72: "hexahedron"}  # fmt: skip
"""VTK's number of a cell shape -> meshio's name; Lagrange cells of higher order are drawn by their corners."""
CORNERS = {69: 3, 70: 4, 71: 4, 72: 8}


def picture(
    space: fem.FunctionSpace, X: np.ndarray, displacement: np.ndarray, cell_data: dict[str, np.ndarray]
) -> dict[str, Any]:
    """Deformed nodes, cells, displacement and cell data of all ranks on rank 0 ({} elsewhere).

    X : (nodes, gdim) reference positions and displacement : (nodes, gdim), local, ghosts included.
    cell_data : (local cells, ...) each.
    """
    comm = space.mesh.comm
    topology, kinds, _ = plot.vtk_mesh(space)
    kind = int(kinds[0]) if len(kinds) else -1
    cells = topology.reshape(-1, topology[0] + 1)[:, 1:] if len(topology) else np.empty((0, 0), int)
    order = space.ufl_element().degree
    if order == 2 and kind in CORNERS:
        # VTK's Lagrange cells of order 2 list their nodes as its quadratic cells do
        name = {69: "triangle6", 70: "quad9", 71: "tetra10", 72: "hexahedron27"}[kind]
    else:
        name = CELLS[kind]
        cells = cells[:, : CORNERS.get(kind, cells.shape[1])]
    parts = comm.gather((cells, X, displacement, cell_data))
    if parts is None:
        return {}
    gdim = X.shape[1]
    offsets = np.cumsum([0] + [len(part[1]) for part in parts])
    u = np.concatenate([part[2] for part in parts])
    points = np.zeros((len(u), 3))
    points[:, :gdim] = np.concatenate([part[1] for part in parts]) + u
    out: dict[str, Any] = {
        "points": points,
        "cells": np.concatenate([part[0] + offset for part, offset in zip(parts, offsets)]),
        "cell": name,
        "displacement": u,
    }
    for field in cell_data:
        out[field] = np.concatenate([part[3][field] for part in parts])
    return out


def gather_nodes(comm: MPI.Intracomm, x: np.ndarray, values: np.ndarray) -> np.ndarray | None:
    """Owned nodes' reference positions (n, gdim) and values (n, k) of all ranks on rank 0, side by side: (N, gdim + k)."""
    parts = comm.gather(np.hstack([x, values]))
    return None if parts is None else np.concatenate(parts)


def scatter_nodes(table: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Values (n, k) at the positions x (n, gdim) of this rank, ghosts included, from a table of ``gather_nodes``.

    Raises ``Mistake`` if a position is not in the table: the checkpoint is of another mesh.
    """
    gdim = x.shape[1]
    size = np.ptp(table[:, :gdim], axis=0).max()
    distance, row = cKDTree(table[:, :gdim]).query(x)
    if distance.max(initial=0.0) > 1e-9 * size:
        raise Mistake("the checkpoint is of another mesh: resume with the knobs it was made with, or remove it")
    return table[row, gdim:]
