"""One step of flow on one mesh: the equations are assembled and factorised once, and the configuration moves as they are solved."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from dolfinx import fem, la
from mpi4py import MPI
from petsc4py import PETSc

from geofem.core.solvers import Matrix
from geofem.cost import phase
from geofem.methods.pfem.domain import make_mesh
from geofem.methods.pfem.flow_solver import FlowSolver
from geofem.methods.pfem.fluid_forms import CONSTANTS, FlowForms
from geofem.methods.pfem.tessellation import Tessellation
from geofem.mistake import Breakdown
from geofem.scene import Array

MAX_ITERATIONS = 40
SLOW = 0.3
"""Where an iteration lowers the change by less than this factor, the matrix is factorised anew."""
Adjust = Callable[[Array, Array, Array], tuple[Array, Array, Array]]


class FluidSystem:
    """Mesh, spaces and matrix of one tessellation, on any number of ranks; what goes in and out are arrays of all nodes.

    Parameters
    ----------
    x : (n, gdim) nodes of the cloud. tessellation : on rank 0.
    """

    def __init__(
        self, comm: MPI.Intracomm, forms: FlowForms, x: Array, tessellation: Tessellation | None, values: dict[str, float]
    ):
        self.comm, self.forms = comm, forms
        gdim = self.gdim = x.shape[1]
        with phase("mesh"):
            self.mesh, at = make_mesh(comm, forms.domain, x, tessellation)
        with phase("spaces"):
            self.space = fem.functionspace(self.mesh, forms.element)
            self._number(at)
            self.w, self.w0 = fem.Function(self.space), fem.Function(self.space)
            functions = {"w": self.w, "w0": self.w0}
            if forms.springs:
                self.spring = fem.Function(fem.functionspace(self.mesh, ("Lagrange", 1, (gdim, gdim))))
                self.pull = fem.Function(fem.functionspace(self.mesh, ("Lagrange", 1, (gdim,))))
                functions |= {"spring": self.spring, "pull": self.pull}
            self._functions = functions
            self._scales_form: fem.Form | None = None
            scalar = PETSc.ScalarType
            self.constants = {name: fem.Constant(self.mesh, scalar(values.get(name, 0.0))) for name in CONSTANTS}
            self.constants["gravity"] = fem.Constant(self.mesh, np.zeros(gdim, scalar))
            self._residual_form = forms.bind(forms.residual, self.space, functions, self.constants, 1)
            self._power_form = forms.bind(forms.power, self.space, functions, self.constants, 0)
            matrix_form = forms.bind(forms.matrix, self.space, functions, self.constants, 2)
        with phase("sparsity"):
            self.matrix = Matrix(matrix_form)
        self.solver = FlowSolver(self.matrix, gdim, self.pressure_dofs[self.own], self.scales, comm)
        self.factorisations = self.iterations = 0

    def _number(self, at: Array) -> None:
        """Which dofs belong to which node of the cloud."""
        gdim, space = self.gdim, self.space
        index_map, bs = space.dofmap.index_map, space.dofmap.index_map_bs
        self.owned_dofs = index_map.size_local * bs
        geometry = self.mesh.geometry.dofmaps[0]
        if space.num_sub_spaces == gdim + 1:
            node = np.empty(index_map.size_local + index_map.num_ghosts, np.int64)
            node[space.dofmap.list.ravel()] = geometry.ravel()
            start = bs * np.arange(len(node))
            self.velocity_dofs = start[:, None] + np.arange(gdim)
            self.pressure_dofs = start + gdim
            self.scalar_nodes = np.arange(len(node))
        else:
            velocity, pressure = space.sub(0).dofmap.list, space.sub(1).dofmap.list
            node = np.arange(self.mesh.geometry.x.shape[0])
            self.velocity_dofs = np.empty((len(node), gdim), np.int64)
            self.pressure_dofs = np.empty(len(node), np.int64)
            corners = gdim + 1
            self.velocity_dofs[geometry] = velocity[:, : corners * gdim].reshape(-1, corners, gdim)
            self.pressure_dofs[geometry] = pressure
            self.scalar_nodes = np.empty(len(node), np.int64)
            self.scalar_nodes[geometry] = fem.functionspace(self.mesh, ("Lagrange", 1)).dofmap.list
        self.geometry_nodes = node
        self.nodes = at[node]
        """The node of the cloud of each local node, ghosts included."""
        self.own = self.pressure_dofs < self.owned_dofs

    # --- what goes in and out -------------------------------------------------------------------------------------
    def set_start(self, x: Array, v: Array, p: Array, theta: float) -> None:
        """Take the state of all nodes at the beginning of the step; the first guess is that nothing changes.

        Bubbles of MINI elements go on from the step before on this mesh, theta that of the scheme.
        """
        self.start, self.count = x[self.nodes], len(x)
        self.w0.x.array[:] += (self.w.x.array - self.w0.x.array) / theta
        self.w0.x.array[self.velocity_dofs] = v[self.nodes]
        self.w0.x.array[self.pressure_dofs] = p[self.nodes]
        self.w.x.array[:] = self.w0.x.array

    def _tie(self, adjust: Adjust, way: float, force: Array) -> None:
        """Springs and forces of nodes in the present configuration. Collective."""
        gdim = self.gdim
        local = np.column_stack([self.start + way * self.velocity(), self.velocity(), force[self.velocity_dofs]])
        x, u, out = np.split(self.everywhere(self.count, local), 3, axis=1)
        spring, pull, volume = adjust(x, u, out)
        share = volume[self.nodes, None]
        self.spring.x.array.reshape(-1, gdim * gdim)[self.scalar_nodes] = spring[self.nodes].reshape(-1, gdim * gdim) / share
        self.pull.x.array.reshape(-1, gdim)[self.scalar_nodes] = pull[self.nodes] / share

    def everywhere(self, count: int, local: Array) -> Array:
        """Values (local nodes, ...) of owned nodes as an array (count, ...) of all nodes on every rank. Collective."""
        whole = np.zeros((count, *local.shape[1:]))
        if self.comm.size == 1:
            whole[self.nodes] = local
            return whole
        for nodes, values in self.comm.allgather((self.nodes[self.own], local[self.own])):
            whole[nodes] = values
        return whole

    def velocity(self) -> Array:
        return self.w.x.array[self.velocity_dofs]

    def pressure(self) -> Array:
        return self.w.x.array[self.pressure_dofs]

    def place(self, way: float) -> None:
        """Put the nodes of the mesh ``way`` (s) along their velocity from the start of the step."""
        x = self.start + way * self.velocity()
        self.mesh.geometry.x[self.geometry_nodes, : self.gdim] = x

    # --- the step -------------------------------------------------------------------------------------------------
    def residual(self) -> Array:
        """Forces out of balance of all local dofs, valid at owned ones."""
        return self._assembled(self._residual_form)

    def scales(self) -> Array:
        """``FlowForms.scales`` of the owned dofs. Collective."""
        if self._scales_form is None:  # few meshes need it
            self._scales_form = self.forms.bind(self.forms.scales, self.space, self._functions, self.constants, 1)
        return self._assembled(self._scales_form)[: self.owned_dofs]

    def _assembled(self, form: fem.Form) -> Array:
        vector = la.vector(self.space.dofmap.index_map, self.space.dofmap.index_map_bs)
        fem.assemble_vector(vector.array, form)
        vector.scatter_reverse(la.InsertMode.add)
        return vector.array

    def solve(self, dt: float, theta: float, way: float, held: Array, given: Array, tolerance: float, still: float,
              adjust: Adjust | None = None) -> None:  # fmt: skip
        """Find w: the velocity and pressure at t + theta dt, on the configuration at t + way dt.

        held : (n, gdim) bool, velocity components of the cloud's nodes that are given, by ``given`` (n, gdim) (m/s). tolerance,
        still : the last change of the velocity may be so much of the largest one, or of what gravity gives in the step.
        adjust : (places, velocities, forces out of balance of all nodes) -> springs (N s/m), forces (N) and volumes (m2 or m3) of
        all nodes in the present iteration.
        Raises ``Breakdown`` (newton).
        """
        self.constants["dt"].value = theta * dt
        fixed = self.velocity_dofs[held[self.nodes]]
        self.w.x.array[fixed] = given[self.nodes][held[self.nodes]]
        rows = fixed[fixed < self.owned_dofs]
        bcs = self._conditions(held[self.nodes])
        least = still * dt * float(np.linalg.norm(self.constants["gravity"].value))
        last, refactor = np.inf, True
        rest = np.zeros(self.w.x.array.size)
        for _ in range(MAX_ITERATIONS):
            self.place(way * dt)
            if adjust is not None:
                self._tie(adjust, way * dt, rest)
            with phase("assemble"):
                rest = self.residual()
                unbalanced = rest[: self.owned_dofs].copy()
                unbalanced[rows] = 0.0
                if refactor:
                    self.matrix.assemble(bcs)
            change = self.solver.solve(-unbalanced, refactor)
            self.factorisations += refactor
            self.iterations += 1
            self.w.x.array[: self.owned_dofs] += change
            self.w.x.scatter_forward()
            moved, speed = self._largest(change)
            if not np.isfinite(moved):
                raise Breakdown("newton", "the flow solver met numbers that are none")
            if moved <= max(tolerance * speed, least):
                self.place(way * dt)
                return
            refactor = moved > SLOW * last
            last = moved
        raise Breakdown(
            "newton", f"the configuration did not settle in {MAX_ITERATIONS} iterations: change {moved:.1e} m/s of {speed:.1e}"
        )

    def _conditions(self, held: Array) -> list[fem.DirichletBC]:
        """Velocity components that do not change in an iteration, held (local nodes, gdim)."""
        zero = fem.Constant(self.mesh, PETSc.ScalarType(0.0))
        velocity = self.space if self.space.num_sub_spaces == self.gdim + 1 else self.space.sub(0)
        dofs = [np.sort(self.velocity_dofs[held[:, i], i]).astype(np.int32) for i in range(self.gdim)]
        return [fem.dirichletbc(zero, dofs[i], velocity.sub(i)) for i in range(self.gdim)]

    def _largest(self, change: Array) -> tuple[float, float]:
        """The largest change of a velocity component in an iteration, and the largest component (m/s)."""
        dofs = self.velocity_dofs[self.own]
        local = np.array([np.abs(change[dofs]).max(initial=0.0), np.abs(self.w.x.array[dofs]).max(initial=0.0)])
        if not np.all(np.isfinite(local)):
            local[:] = np.inf
        if self.comm.size > 1:
            self.comm.Allreduce(MPI.IN_PLACE, local, op=MPI.MAX)
        return float(local[0]), float(local[1])

    def power(self) -> float:
        """Dissipation by viscosity and by the stabilisation (W) at the present w. Collective."""
        local = float(fem.assemble_scalar(self._power_form))
        return self.comm.allreduce(local) if self.comm.size > 1 else local

    def destroy(self) -> None:
        """Free what PETSc holds. Collective."""
        self.solver.destroy()
        self.matrix.mat.destroy()
