"""The equations of one load step on the active cells of the background grid: unknowns, forces, tangent, and their solution."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from dolfinx import fem, la
from mpi4py import MPI
from numba import njit
from petsc4py import PETSc

from geofem.core.newton import Newton, Residual
from geofem.core.solvers import LinearSolver
from geofem.cost import phase
from geofem.methods.mpm import ghost, tangent
from geofem.methods.mpm.background import Background, nodes_of
from geofem.methods.mpm.grid import OPTIONS
from geofem.methods.mpm.kind import Kind
from geofem.methods.mpm.nullspace import Watched
from geofem.methods.mpm.points import Body
from geofem.methods.mpm.response import Response
from geofem.methods.mpm.table import group, tabulate
from geofem.scene import Array


class CooMatrix:
    """A PETSc matrix filled from entries (row, column, value) that may name a place more than once, on any rank."""

    def __init__(self, rows: Array, columns: Array, owned: int, comm: Any):
        self.mat = PETSc.Mat().create(comm)
        self.mat.setSizes(((owned, PETSc.DETERMINE), (owned, PETSc.DETERMINE)))
        self.mat.setType("aij")
        self.mat.setPreallocationCOO(rows.astype(PETSc.IntType), columns.astype(PETSc.IntType))

    def fill(self, values: Array) -> None:
        self.mat.setValuesCOO(values, addv=PETSc.InsertMode.INSERT_VALUES)


class System:
    """Balance of forces for the displacement increments of the nodes that points reach, from the start of a step.

    unknown : the increments (m) on the mesh of the active cells. dof_of_node : (window's nodes,) local dof block, or -1.
    internal, external, force : (blocks, d) nodal forces of the last evaluation (N), summed over the ranks; force is what is out of
    balance, the penalty on jumps included. load : (N, d) force on each point (N). touch : what rigid bodies do to the points:
    (u (N, d)) -> force (N, d), spring (N, d, d); None where there are none.
    """

    def __init__(
        self,
        background: Background,
        bodies: list[Body],
        kind: Kind,
        extent: float,
        cells: Array,
        penalty: float,
        definite: bool,
    ):
        self.background, self.kind, self.bodies = background, kind, bodies
        grid, self.dim = background.grid, kind.dim
        self.comm = background.comm
        with phase("assemble"):
            self.table = table = tabulate(bodies, kind, grid.lattice, extent)
            there = np.arange(table.node.shape[1]) < table.count[:, None]
            touched = np.zeros(len(grid.nodes))
            touched[table.node[there]] = 1.0
            self.reached = background.shared(touched) > 0.0
            active = background.active_cells(self.reached)
            self.mesh = background.active_mesh(active)
            self.space = fem.functionspace(self.mesh, ("Lagrange", 1, (self.dim,)))
            node = nodes_of(self.space, grid)
            self.blocks, self.node_of_dof = len(node), node
            self.dof_of_node = np.full(len(grid.nodes), -1, np.int64)
            self.dof_of_node[node] = np.arange(self.blocks)
            self.dof = np.where(there, self.dof_of_node[table.node], 0)
            self.groups = group(table, cells, self.dof_of_node)
            self.response = Response(bodies, kind, self.groups)
            self.at = np.concatenate([body.cloud.at[: body.n] for body in bodies])
            self.radius = np.ascontiguousarray(self.at[:, 0])
            self.unknown = fem.Function(self.space)
            self._vector = fem.Function(self.space)
            self._share_penalty(active, there, penalty)
            self._make_matrix(definite)
        self.load = np.zeros((len(self.radius), self.dim))
        self.touch: Callable[[Array], tuple[Array, Array]] | None = None
        self.contact, self.spring = np.zeros_like(self.load), np.zeros((0, self.dim, self.dim))
        self.nodal = np.zeros((self.blocks, self.dim))
        self.dt = 1.0
        self.newton_iterations = self.linear_iterations = 0

    # --- set-up -------------------------------------------------------------------------------------------------------
    def _share_penalty(self, active: Array, there: Array, penalty: float) -> None:
        """Faces of the penalty; a node's cover is its share of the volume of the bodies, by that of a cell."""
        grid = self.background.grid
        table, volume = self.table, self.response.volume
        if self.kind.axial:
            volume = volume / self.radius
        cover = np.zeros(len(grid.nodes))
        np.add.at(cover, table.node[there], (table.weight * volume[:, None])[there])
        cover = self.background.shared(cover) / grid.h**self.dim
        shape = (-1, *grid.shape[1:])
        window = lambda values: values.reshape(shape)  # noqa: E731
        flags = window(self.background.cell_flags(active))
        low, high = (row - grid.first for row in grid.own)
        faces = ghost.light_faces(window(cover), flags, low, high) if penalty > 0.0 else []
        radius = grid.low[0] + grid.h * (grid.first + np.arange(flags.shape[0])) if self.kind.axial else None
        self._penalty = ghost.ghost_stiffness(faces, window(self.dof_of_node), self.dim, penalty, grid.h, radius)
        self._ghost = ghost.as_matrix(*self._penalty, self.blocks)

    def _make_matrix(self, definite: bool) -> None:
        groups, dim = self.groups, self.dim
        sizes = (np.diff(groups.first) * dim) ** 2
        self._inner = int(sizes.sum())
        rows, columns = np.empty(self._inner, np.int64), np.empty(self._inner, np.int64)
        pattern(groups.first, groups.nodes, dim, rows, columns)
        light_rows, light_columns, light = self._penalty
        each = np.arange(dim)
        diagonal = np.arange(self.owned)
        self._rows = np.concatenate([rows, (light_rows[:, None] * dim + each).ravel(), diagonal])
        self._columns = np.concatenate([columns, (light_columns[:, None] * dim + each).ravel(), diagonal])
        self._values = np.zeros(len(self._rows))
        self._fixed = slice(self._inner, self._inner + dim * len(light))
        self._values[self._fixed] = np.repeat(light, dim)
        map_ = self.space.dofmap.index_map
        number = map_.local_to_global(np.arange(self.blocks, dtype=np.int32)).astype(np.int64)
        number = (number[:, None] * dim + each).ravel()
        self.matrix = CooMatrix(number[self._rows], number[self._columns], self.owned, self.comm)
        # the same start on any number of ranks
        grid = self.background.grid
        place = self.node_of_dof[: map_.size_local] + grid.first * int(np.prod(grid.shape[1:]))
        start = np.sin(12.9898 * (place[:, None] * dim + each) + 1.0).ravel()
        self.solver = Watched(LinearSolver(self.matrix, self.space, definite), start)

    @property
    def owned(self) -> int:
        return self.space.dofmap.index_map.size_local * self.dim

    @property
    def dofs(self) -> int:
        return self.space.dofmap.index_map.size_global * self.dim

    @property
    def cells(self) -> int:
        return int(self.mesh.topology.index_map(self.dim).size_global)

    # --- forces and tangent ---------------------------------------------------------------------------------------------
    def _summed(self, values: Array) -> Array:
        """Nodal values (blocks, d) summed over the ranks, ghosts included. Collective."""
        if self.comm.size == 1:
            return values
        self._vector.x.array[:] = values.ravel()
        self._vector.x.scatter_reverse(la.InsertMode.add)
        self._vector.x.scatter_forward()
        return self._vector.x.array.reshape(values.shape).copy()

    def increments(self, du: Array) -> tuple[Array, Array]:
        """Displacement gradients (N, g) and displacements (N, d) of the points."""
        N, table = len(self.radius), self.table
        G, u = np.empty((N, self.response.g)), np.empty((N, self.dim))
        tangent.make_increments(self.dim, self.kind.axial)(
            table.count, self.dof, table.weight, table.gradient, self.radius, du, G, u
        )
        return G, u

    def _spread(self, stress: Array, load: Array) -> Array:
        """Nodal forces of stresses (N, g) and against forces (N, d) of the points, of all ranks. Collective."""
        table, out = self.table, np.zeros((self.blocks, self.dim))
        stress = stress * self.response.volume[:, None]
        tangent.make_forces(self.dim, self.kind.axial)(
            table.count, self.dof, table.weight, table.gradient, self.radius, stress, load, out
        )
        return self._summed(out)

    def evaluate(self) -> Residual:
        """Forces at the present unknown. Collective."""
        with phase("assemble"):
            du = self.unknown.x.array.reshape(self.blocks, self.dim)
            G, u = self.increments(du)
            valid = self.response.update(G, self.dt)
            if self.touch:
                self.contact, self.spring = self.touch(u)
            self.internal = self._spread(self.response.stress if valid else np.zeros_like(G), np.zeros_like(u))
            self.external = -self._spread(np.zeros_like(G), self.load + self.contact) + self.nodal
            held = self._ghost @ du
            self.force = self.internal - self.external + self._summed(held)
        scale = self.norm(self.external) + self.norm(self.internal)
        return Residual(self.force.ravel(), scale, valid)

    def norm(self, values: Array) -> float:
        own = values.ravel()[: self.owned]
        return float(np.sqrt(self.comm.allreduce(float(own @ own))))

    def linearise(self) -> None:
        table, groups, response = self.table, self.groups, self.response
        values = self._values
        tangent.make_stiffness(self.dim, self.kind.axial, self.kind.cure)(
            groups.points, groups.start, groups.first, groups.slot, table.count, table.weight, table.gradient, self.radius,
            response.volume, response.linearise(), response.D, self.spring, values[: self._inner],
        )  # fmt: skip
        masked = np.where(self._blocked, 0.0, values)
        masked[len(masked) - self.owned :] = self._diagonal
        self.matrix.fill(masked)

    def _lift(self, b: Array) -> None:
        """Subtract the tangent times what the conditions still ask for."""
        gap = np.zeros(self.blocks * self.dim)
        gap[self.held] = self._prescribed - self.unknown.x.array[self.held]
        across = self._across
        b -= np.bincount(self._rows[across], self._values[across] * gap[self._columns[across]], minlength=len(b))

    # --- the solution ---------------------------------------------------------------------------------------------------
    def hold(self, dofs: Array, values: Array) -> None:
        """Prescribe the increments of some local dofs (ghosts included); those that no point reaches are held as well."""
        size = self.blocks * self.dim
        prescribed = np.full(size, np.nan)
        prescribed[np.repeat(~self.reached[self.node_of_dof], self.dim)] = 0.0
        prescribed[dofs] = values
        held = ~np.isnan(prescribed)
        self.held = np.flatnonzero(held)
        self._prescribed = prescribed[held]
        entries = slice(0, len(self._rows) - self.owned)
        self._blocked = np.zeros(len(self._rows), bool)
        self._blocked[entries] = held[self._rows[entries]] | held[self._columns[entries]]
        self._across = np.flatnonzero(held[self._columns] & ~held[self._rows])
        self._diagonal = held[: self.owned].astype(float)

    def begin(self, increments: Array) -> None:
        """Start from increments (window's nodes, d) and what is prescribed, where that is nearer to balance than rest is. Collective."""
        rest, x = self.unknown.x.array.copy(), self.unknown.x.array
        pending = self.comm.allreduce(bool(np.any(x[self.held] != self._prescribed)), op=MPI.LOR)
        found = [self._out_of_balance()]
        x[:] = increments[self.node_of_dof].ravel()
        self.unknown.x.scatter_forward()
        x[self.held] = self._prescribed
        found.append(self._out_of_balance())
        # what is prescribed puts rest out of balance by design
        if not (np.isfinite(found[1]) and (pending or found[1] < found[0])):
            x[:] = rest

    def _out_of_balance(self) -> float:
        """Norm of the forces that nothing holds, infinite in an inadmissible state. Collective."""
        now = self.evaluate()
        free = now.force.copy()
        free[self.held] = 0.0
        bad = self.comm.allreduce(not now.valid, op=MPI.LOR)
        return np.inf if bad else self.norm(free)

    def solve(self, tolerance: float, plastic: bool) -> None:
        """Newton's iteration from the present unknown, under the conditions of the last ``hold``."""
        value = fem.Function(self.space)
        value.x.array[self.held] = self._prescribed
        dofs = self.held.astype(np.int32)
        bcs = [fem.dirichletbc(value, [dofs, dofs], self.space.sub(0))]
        # asks for lower forces at every iteration; these laws offer no elastic tangent to mix in at finite strain
        stabilise = (lambda share: None) if plastic else None
        newton = Newton(self.unknown, bcs, self.solver, self.evaluate, self.linearise, self._lift, tolerance, stabilise)
        try:
            newton.solve()
        finally:
            self.newton_iterations += newton.iterations
            self.scale = newton.scale


@njit(**OPTIONS)
def pattern(first: Any, nodes: Any, dim: int, rows: Any, columns: Any) -> None:
    """Rows and columns, local dofs, of the dense blocks of all groups."""
    at = 0
    for e in range(len(first) - 1):
        for i in range(first[e], first[e + 1]):
            for r in range(dim):
                for k in range(first[e], first[e + 1]):
                    for c in range(dim):
                        rows[at], columns[at] = nodes[i] * dim + r, nodes[k] * dim + c
                        at += 1
