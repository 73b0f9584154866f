"""The mesh of a scene as the arrays that kernels read, and sums over nodes that several ranks share."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
from dolfinx import fem, la

from geofem.core.locate import fill_bins
from geofem.scene import Array

TIE = 1e-9
"""Nodes of a regular mesh often lie on the very circle; rounding must not choose among them."""


class Bins(NamedTuple):
    """The cells whose bounding boxes touch each square of a uniform raster; see ``geofem.core.locate.fill_bins``."""

    low: Array
    width: float
    counts: Array
    starts: Array
    members: Array


class Grid:
    """Triangles with straight sides; a node is a block of dofs of a P1 space on them.

    X : (nodes, 2) positions (m), ghosts last. T : (cells, 3) the nodes of each cell, counter-clockwise. area : (cells,) m2.
    region : (cells,) number of the region. owned : number of nodes that this rank owns.
    """

    def __init__(self, space: fem.FunctionSpace, regions: Array):
        self.space, self.region = space, np.asarray(regions)
        self.comm = space.mesh.comm
        self.map = space.dofmap.index_map
        self.owned = self.map.size_local
        self.T = np.array(space.dofmap.list, np.int64)
        # not the positions that dolfinx pushes forward for its dofs: their rounding depends on the cell, and so on the ranks
        self.X = np.zeros((self.owned + self.map.num_ghosts, 2))
        self.X[self.T] = space.mesh.geometry.x[space.mesh.geometry.dofmaps[0]][:, :, :2]
        a, b, c = (self.X[self.T[:, k]] for k in range(3))
        double = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
        turned = double < 0
        self.T[turned] = self.T[turned][:, ::-1]
        self.area = 0.5 * np.abs(double)
        self.size = np.sqrt(2.0 * self.area)

    @cached_property
    def bins(self) -> Bins:
        corners = self.X[self.T]
        low, high = corners.min(axis=1), corners.max(axis=1)
        start = low.min(axis=0) if len(low) else np.zeros(2)
        spans = high.max(axis=0) - start if len(low) else np.zeros(2)
        width = max(1.3 * float(np.sqrt(np.prod(spans) / max(len(low), 1))), 1e-300)
        counts = np.maximum(1, (spans / width).astype(np.int64) + 1)
        return Bins(start, width, counts, *fill_bins(low, high, start, width, counts))

    @cached_property
    def support(self) -> Array:
        """Area (m2) of the cells around each node, (nodes,)."""
        return self.sum_to_nodes(self.T.ravel(), np.repeat(self.area, 3))

    def sum_to_nodes(self, nodes: Array, values: Array) -> Array:
        """Sums of the values of all ranks at the nodes (k,) that they belong to: (nodes,), the same on every rank. Collective."""
        vector = la.vector(self.map, 1)
        np.add.at(vector.array, nodes, values)
        vector.scatter_reverse(la.InsertMode.add)
        vector.scatter_forward()
        return vector.array.copy()

    def from_owners(self, values: Array) -> Array:
        """Values (nodes,) with those of ghosts replaced by their owner's. Collective."""
        vector = la.vector(self.map, 1)
        vector.array[:] = values
        vector.scatter_forward()
        return vector.array.copy()

    def around(self, at: Array, radius: float) -> tuple[Array, Array]:
        """The cells that the circle around a point passes, and the nodal weights q (nodes,): 1 inside of it, 0 outside."""
        q = (np.hypot(*(self.X - at).T) < (1.0 + TIE) * radius).astype(float)
        inside = q[self.T].sum(axis=1)
        return np.flatnonzero((inside > 0) & (inside < 3)), q

    def slope(self, nodal: Array, cells: Array) -> Array:
        """The gradient (m, 2) of linear nodal values (nodes,) in the cells (m,)."""
        corners, rise = self.X[self.T[cells]], nodal[self.T[cells]]
        b, c = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        db, dc = rise[:, 1] - rise[:, 0], rise[:, 2] - rise[:, 0]
        slope = np.stack([db * c[:, 1] - dc * b[:, 1], dc * b[:, 0] - db * c[:, 0]], axis=1)
        return slope / (2.0 * self.area[cells, None])

    def linear(self, nodal: Array, cells: Array, x: Array) -> Array:
        """Linear nodal values (nodes,) at points x (n, 2) of the cells (n,)."""
        first = self.T[cells, 0]
        return nodal[first] + np.einsum("ni,ni->n", self.slope(nodal, cells), x - self.X[first])

    def cells_of_facets(self, found: Array) -> Array:
        """The cell of this rank at each boundary facet."""
        topology = self.space.mesh.topology
        topology.create_connectivity(1, 2)
        connected = topology.connectivity(1, 2)
        return connected.array[connected.offsets[found]].astype(np.int64)


def boundary_edges(grid: Grid, found: Array) -> Array:
    """The nodes (k, 2) of facets of this rank."""
    topology = grid.space.mesh.topology
    topology.create_connectivity(1, 0)
    vertices = topology.connectivity(1, 0).array.reshape(-1, 2)[found]
    # P1 nodes and vertices are numbered apart
    node = np.empty(topology.index_map(0).size_local + topology.index_map(0).num_ghosts, np.int64)
    node[topology.connectivity(2, 0).array] = grid.space.dofmap.list.ravel()
    return node[vertices]
