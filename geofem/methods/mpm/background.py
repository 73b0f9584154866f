"""The background grid as a mesh of dolfinx: cells, spaces and dofs of the lattice, divided among the ranks as the points are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import basix.ufl
import numpy as np
from dolfinx import fem, graph, la, mesh
from mpi4py import MPI

from geofem.methods.mpm.grid import Grid
from geofem.methods.mpm.parallel import Slabs
from geofem.scene import Array

CELLS = {2: "quadrilateral", 3: "hexahedron"}


class Background:
    """The mesh of the whole lattice, each rank with the cells of its own slab and ``ghosts`` rows of cells beyond it.

    mesh : quadrilaterals or hexahedra. space : continuous linear functions with ``components`` values a node (1: scalars).
    node_of_dof : (blocks,) the node of the grid's window at which each local dof block sits.
    dof_of_node : (window's nodes,) the reverse; -1 where the rank's part of the mesh has no such node.
    """

    def __init__(self, grid: Grid, slabs: Slabs, comm: MPI.Intracomm, ghosts: int = 1):
        self.grid, self.comm = grid, comm
        element = basix.ufl.element("Lagrange", CELLS[grid.dim], 1, shape=(grid.dim,))
        bounds, per_row = np.asarray(slabs.bounds), int(np.prod(grid.shape[1:]))
        low, high = slabs.own
        last = high + (comm.rank == comm.size - 1)
        nodes = np.arange(low * per_row, last * per_row)
        x = np.stack(np.unravel_index(nodes, grid.shape), axis=1) * grid.h + grid.low
        self.cells = lattice_cells(grid.shape, low, high)

        def follow_slabs(comm: Any, parts: int, types: Any, cells: Sequence[Array]) -> Any:
            row = np.asarray(cells[0]).reshape(-1, 2**grid.dim)[:, 0] // per_row
            owner = slabs.owner(row)
            near = (row[:, None] >= bounds[:-1] - ghosts) & (row[:, None] < bounds[1:] + ghosts)
            near[np.arange(len(row)), owner] = False
            # the owner comes first
            others = [np.flatnonzero(line) for line in near]
            to = np.concatenate([np.concatenate([[o], line]) for o, line in zip(owner, others)] or [np.empty(0)])
            offsets = np.concatenate([[0], np.cumsum(1 + near.sum(axis=1))])
            return graph.adjacencylist(to.astype(np.int32), offsets.astype(np.int32))._cpp_object

        self.mesh = mesh.create_mesh(comm, self.cells, element, x, partitioner=follow_slabs)
        self.space = fem.functionspace(self.mesh, ("Lagrange", 1))
        self.node_of_dof = nodes_of(self.space, grid)
        self.dof_of_node = np.full(len(grid.nodes), -1, np.int64)
        self.dof_of_node[self.node_of_dof] = np.arange(len(self.node_of_dof))

    def fill(self, function: fem.Function, values: Array) -> None:
        """Give a linear function on the mesh the values (window's nodes,) or (window's nodes, c) of the grid."""
        values = values.reshape(len(self.grid.nodes), -1)
        function.x.array[:] = values[nodes_of(function.function_space, self.grid)].ravel()
        function.x.scatter_forward()

    def shared(self, values: Array) -> Array:
        """Sums over all ranks of what each has at a node, (window's nodes,); zero where the rank has no mesh. Collective."""
        function = fem.Function(self.space)
        function.x.array[:] = values[self.node_of_dof]
        function.x.scatter_reverse(la.InsertMode.add)
        function.x.scatter_forward()
        out = np.zeros(len(values))
        out[self.node_of_dof] = function.x.array
        return out

    def active_cells(self, reached: Array) -> Array:
        """Local cells, ghosts included, all of whose nodes are reached by a point of any rank. Collective.

        reached : (window's nodes,) bool, the nodes that points of any rank reach.
        """
        nodes = self.node_of_dof[self.space.dofmap.list]
        active = reached[nodes].all(axis=1)
        # a domain of several cells whose corners alone are told to the grid can leave a node on its own: take the cells around it
        covered = np.zeros(len(reached))
        covered[nodes[active].ravel()] = 1.0
        alone = reached & (self.shared(covered) == 0.0)
        return np.flatnonzero(active | alone[nodes].any(axis=1)).astype(np.int32)

    def active_mesh(self, cells: Array) -> mesh.Mesh:
        """The mesh of the active cells alone. Collective."""
        return mesh.create_submesh(self.mesh, self.mesh.topology.dim, cells)[0]

    def cell_flags(self, cells: Array) -> Array:
        """Flags (window's nodes,) of the low nodes of some local cells."""
        out = np.zeros(len(self.dof_of_node), bool)
        out[self.node_of_dof[self.space.dofmap.list[cells]].min(axis=1)] = True
        return out


def lattice_cells(shape: tuple[int, ...], first: int, end: int) -> Array:
    """Nodes (cells, 2^dim) of the cells of the rows first ... end of a lattice, the first axis running fastest in a cell."""
    dim = len(shape)
    axes = [np.arange(first, end), *(np.arange(n - 1) for n in shape[1:])]
    low = np.stack(np.meshgrid(*axes, indexing="ij")).reshape(dim, -1)
    corners = [np.array([(q >> c) & 1 for c in range(dim)]) for q in range(2**dim)]
    return np.stack([np.ravel_multi_index(tuple(low + corner[:, None]), shape) for corner in corners], axis=1).astype(np.int64)


def nodes_of(space: fem.FunctionSpace, grid: Grid) -> Array:
    """The node of the grid's window at which each local dof block of a linear space sits."""
    x = space.tabulate_dof_coordinates()[:, : grid.dim]
    number = np.rint((x - grid.low) / grid.h).astype(np.int64)
    return np.ravel_multi_index(tuple(number.T), grid.shape) - grid.first * int(np.prod(grid.shape[1:]))
