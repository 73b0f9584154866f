"""The weak balance of momentum on a mesh, at rest or in motion: forces, tangent, and the step that brings them to zero.

This is the step that every mesh-based method makes; what becomes of the mesh before and after it is the method's affair.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from dolfinx import fem, la
from mpi4py import MPI

from geofem.core.conditions import Condition, DisplacementDofs, Loads, follower_facets
from geofem.core.forms import Forms, Template
from geofem.core.mesh import Body
from geofem.core.newton import Newton, Residual
from geofem.core.solvers import LinearSolver, Matrix
from geofem.core.state import PointState
from geofem.core.time import GeneralisedAlpha
from geofem.cost import phase
from geofem.scene import Scene


class MomentumBalance:
    """Internal, external and inertial forces of a scene, and the state in which they balance.

    The unknown counts from the mesh: it is the displacement (total frame), or its increment (updated frame, where the mesh
    moves after every step). ``displacement`` is the whole one, ``v`` and ``a`` its time derivatives; all three are local
    arrays over the dofs of the unknown (the pressure of the mixed form, which has no inertia, comes with them), as are
    ``internal``, ``external`` and ``reaction``, the forces of the converged state (N), valid at owned dofs.

    Parameters
    ----------
    plastic : True if Newton is to guard against the kinks of yield surfaces.
    rho_inf, tolerance : see ``Fem.build``.
    """

    def __init__(self, scene: Scene, template: Template, body: Body, rho_inf: float, tolerance: float, plastic: bool):
        self.scene, self.template = scene, template
        self.comm = body.mesh.comm
        self.scheme = GeneralisedAlpha(rho_inf)
        self.forms = forms = Forms(body.mesh, template, body.regions, follower_facets(scene, body))
        forms.set_parameters([region.material for region in scene.regions])
        self.dofs = DisplacementDofs(forms)
        self.conditions = [Condition(forms, self.dofs, body, s, c) for s in scene.supports for c in s.components]
        self.bcs = [condition.bc for condition in self.conditions]
        self.held = np.unique(np.concatenate([c.dofs for c in self.conditions] or [np.empty(0, np.int32)]))
        self._load_driven = not scene.dynamic and bool(scene.loads) and not any(s.value for s in scene.supports)
        self.loads = Loads(scene, forms, body)
        self.points = PointState(scene, forms) if template.laws[0] == "points" else None
        self._scalars: dict[str, fem.Form] = {}
        self._residual = forms.form("residual")
        self._matrix = Matrix(forms.form("tangent"))
        definite = not plastic and not template.mixed and not template.followers
        self.solver = LinearSolver(self._matrix, forms.space, definite)
        stabilise = self._stabilise if plastic else None
        self.newton = Newton(
            forms.unknown, self.bcs, self.solver, self._evaluate, self._linearise, self._lift, tolerance, stabilise
        )
        self.owned = self.newton.owned
        self.displacement, self.v, self.a = (np.zeros_like(forms.unknown.x.array) for _ in range(3))
        self.external = self.loads.external(0.0)
        self.loads.set_followers(0.0)
        self._update_points()
        self.internal = self._internal_force()
        self.reaction = np.zeros_like(self.internal)
        self._converged = forms.unknown.x.array.copy()
        if template.updated:
            # before the mesh moves: the mass form knows densities of the reference configuration
            _ = self.mass
        if scene.dynamic:
            self._start_moving()

    def _start_moving(self) -> None:
        """Mass matrices, the initial velocity, and the acceleration that balances the forces at t = 0."""
        form = self.forms.form("mass")
        self._free_mass, first = Matrix(form), Matrix(form)
        self._free_mass.assemble(self.bcs, diagonal=0.0)
        if self.scene.initial_velocity is not None:
            self.v[self.dofs.index] = self.scene.initial_velocity(self.dofs.X.T).T.ravel()
        first.assemble(self.bcs)
        diagonal = first.mat.getDiagonal()
        # the pressure has no mass: give its rows a diagonal, so that its acceleration is zero
        diagonal.array[diagonal.array == 0.0] = 1.0
        first.mat.setDiagonal(diagonal)
        force = (self.external - self.internal)[: self.owned]
        force[self.held] = 0.0
        self.a[: self.owned] = LinearSolver(first, self.forms.space, definite=False).solve(force)
        vector = self._vector()
        vector.array[:] = self.a
        vector.scatter_forward()
        self.a[:] = vector.array

    # --- forces ---------------------------------------------------------------------------------------------------
    def _vector(self) -> la.Vector:
        space = self.forms.space
        return la.vector(space.dofmap.index_map, space.dofmap.index_map_bs)

    def norm(self, array: np.ndarray) -> float:
        """Euclidean norm of an array like the unknown, over all ranks."""
        owned = array[: self.owned]
        return float(np.sqrt(self.comm.allreduce(float(owned @ owned), op=MPI.SUM)))

    def total(self, kind: str) -> float:
        """The integral of a scalar form: ``energy`` (J), ``weight`` (mass, kg) or ``volume`` (m3)."""
        if kind not in self._scalars:
            self._scalars[kind] = self.forms.form(kind)
        return float(self.comm.allreduce(fem.assemble_scalar(self._scalars[kind]), op=MPI.SUM))

    @cached_property
    def mass(self) -> Matrix:
        """The mass matrix (kg)."""
        matrix = Matrix(self.forms.form("mass"))
        matrix.assemble()
        return matrix

    def inertia(self, acceleration: np.ndarray) -> np.ndarray:
        """M a, valid at owned dofs."""
        x, y = self.mass.mat.createVecs()
        x.array[:] = acceleration[: self.owned]
        self.mass.mat.mult(x, y)
        out = np.zeros_like(acceleration)
        out[: self.owned] = y.array
        return out

    def kinetic(self) -> float:
        """Kinetic energy (J)."""
        return 0.5 * float(self.comm.allreduce(self.v[: self.owned] @ self.inertia(self.v)[: self.owned], op=MPI.SUM))

    def _internal_force(self) -> np.ndarray:
        """Internal forces less the following pressures at the current unknown, summed into their owners."""
        with phase("assemble"):
            vector = self._vector()
            fem.assemble_vector(vector.array, self._residual)
            vector.scatter_reverse(la.InsertMode.add)
            return vector.array

    def _update_points(self) -> bool:
        return self.points.update() if self.points else True

    def _increment(self) -> np.ndarray:
        """Displacement since the last converged state."""
        return self.forms.unknown.x.array - (0.0 if self.template.updated else self.displacement)

    # --- what Newton asks -----------------------------------------------------------------------------------------
    def _evaluate(self) -> Residual:
        valid = self._update_points()
        internal = self._new_internal = self._internal_force()
        force = internal - self._new_external
        scale = self.norm(self._new_external)
        if not self._load_driven:
            # under loads alone the loads are the measure: internal forces grow without bound where a body flows away
            scale += self.norm(internal)
        if self.scene.dynamic:
            new = self.scheme.acceleration(self._increment(), self.v, self.a, self._dt)
            inertia = self.inertia((1.0 - self.scheme.alpha_m) * new + self.scheme.alpha_m * self.a)
            last = self.internal - self.external
            force = inertia + (1.0 - self.scheme.alpha_f) * force + self.scheme.alpha_f * last
            scale += self.norm(inertia)
        return Residual(force, scale, valid)

    @property
    def _stiffness_factor(self) -> float:
        return 1.0 - self.scheme.alpha_f if self.scene.dynamic else 1.0

    def _linearise(self) -> None:
        self._matrix.assemble(self.bcs, diagonal=1.0 / self._stiffness_factor)
        if self.scene.dynamic:
            self._matrix.combine(self._stiffness_factor, self._free_mass, self.scheme.mass_factor(self._dt))

    def _lift(self, b: np.ndarray) -> None:
        x0 = [self.forms.unknown.x.array]
        fem.apply_lifting(b, [self._matrix.form], [self.bcs], x0=x0, alpha=self._stiffness_factor)
        if self.scene.dynamic:
            fem.apply_lifting(b, [self._free_mass.form], [self.bcs], x0=x0, alpha=self.scheme.mass_factor(self._dt))

    def _stabilise(self, share: float) -> None:
        assert self.points is not None
        if share != self.points.elastic_share:
            self.points.elastic_share = share
            self._update_points()

    # --- the step -------------------------------------------------------------------------------------------------
    def _set_time(self, t: float, dt: float) -> None:
        self._dt = dt
        moved = self.displacement if self.template.updated else None
        for condition in self.conditions:
            condition.set(t, moved)
        if self.points:
            self.points.set_time(t, dt)
        self.loads.set_followers(t)

    def solve(self, t: float, dt: float) -> None:
        """Bring the forces of time t, dt after the converged state, to balance. Raises ``Breakdown``: then call ``revert``."""
        self._set_time(t, dt)
        self._new_external = self.loads.external(t)
        self.newton.solve()

    def revert(self, t: float) -> None:
        """Go back to the converged state, that of time t."""
        unknown = self.forms.unknown.x.array
        unknown[:] = self._converged
        if self.template.updated:
            unknown[self.dofs.index] = 0.0
        self._set_time(t, self._dt)
        self._update_points()

    def accept(self) -> tuple[np.ndarray, float, float, float]:
        """Make the balanced state the converged one.

        Returns the displacement increment, the work of internal forces and of loads and supports over the step (J, by the
        trapezoidal rule: exact for dead loads and linear springs), and the norm of the force left out of balance (N).
        """
        # Newton's last evaluation was of this very state
        internal, du = self._new_internal, self._increment()
        out_of_balance = internal - self._new_external
        if self.scene.dynamic:
            a = self.scheme.acceleration(du, self.v, self.a, self._dt)
            self.v, self.a = self.scheme.velocity(self.v, self.a, a, self._dt), a
            out_of_balance += self.inertia(a)
        reaction = np.zeros_like(du)
        reaction[self.held] = out_of_balance[self.held]
        forces = np.stack([self.internal + internal, self.external + self._new_external + self.reaction + reaction])
        inner, outer = self.comm.allreduce(0.5 * forces[:, : self.owned] @ du[: self.owned], op=MPI.SUM)
        self.internal, self.external, self.reaction = internal, self._new_external, reaction
        self.displacement = self.displacement + du
        self._converged = self.forms.unknown.x.array.copy()
        if self.points:
            self.points.commit()
        return du, float(inner), float(outer), self.norm(out_of_balance - reaction)

    def restored(self, t: float, dt: float) -> None:
        """Bring everything that follows from the restored arrays up to date."""
        self._converged = self.forms.unknown.x.array.copy()
        self._set_time(t, dt)
        self._update_points()
