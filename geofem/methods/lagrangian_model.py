"""The model behind method ``fem``: one step of the momentum balance on a mesh that follows the material."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from dolfinx import fem, la
from mpi4py import MPI

from geofem.core import snapshot
from geofem.core.conditions import Condition, DisplacementDofs, Loads, follower_facets
from geofem.core.forms import Forms, Template
from geofem.core.mesh import Body
from geofem.core.mpi import gather_by_id
from geofem.core.newton import Balance, Newton
from geofem.core.sampling import MaterialPoint
from geofem.core.solvers import LinearSolver, Matrix
from geofem.core.state import PointState, compose, tensors
from geofem.core.time import GeneralisedAlpha
from geofem.cost import phase
from geofem.mistake import Breakdown
from geofem.scene import Probe, Scene

CRUSHED = 0.01
"""Where a step leaves less than this part of a volume, the mesh has tangled: laws of finite strain resist to the last."""
SMALLEST_STEP = 1e-3
"""A step is cut no further than this fraction of the first one."""


class LagrangianModel:
    """A scene on a Lagrangian mesh.

    The unknown counts from the mesh: it is the displacement (total frame), or its increment (updated frame, where the mesh
    moves after every step). ``displacement`` is the whole one, ``v`` and ``a`` its time derivatives; all three are local
    arrays over the dofs of the unknown (the pressure of the mixed form, which has no inertia, comes with them).
    """

    def __init__(
        self, scene: Scene, template: Template, body: Body, steps: int, rho_inf: float, tolerance: float, elastic: bool
    ):
        self.scene, self.template, self.body = scene, template, body
        self.comm = body.mesh.comm
        self.t = 0.0
        span = scene.period if scene.dynamic and scene.period else scene.t_end
        self._dt = self._first_dt = span / steps
        self.work = {"steps": 0, "newton": 0, "linear": 0, "cuts": 0}
        self.scheme = GeneralisedAlpha(rho_inf)
        followers = follower_facets(scene, body)
        self.forms = forms = Forms(body.mesh, template, body.regions, followers)
        self._set_constants()
        self.dofs = DisplacementDofs(forms)
        self.conditions = [Condition(forms, self.dofs, body, s, c) for s in scene.supports for c in s.components]
        self._load_driven = not scene.dynamic and bool(scene.loads) and not any(s.value for s in scene.supports)
        self._held = np.unique(np.concatenate([c.dofs for c in self.conditions] or [np.empty(0, np.int32)]))
        self.loads = Loads(scene, forms, body)
        self.points = PointState(scene, forms) if template.laws[0] == "points" else None
        self._residual = forms.form("residual")
        self._matrix = Matrix(forms.form("tangent"))
        self._solver = LinearSolver(self._matrix, forms.space, definite=elastic and not template.mixed and not followers)
        bcs = [condition.bc for condition in self.conditions]
        self._newton = Newton(
            forms.unknown,
            bcs,
            self._solver,
            self._balance,
            self._linearise,
            tolerance,
            self._stabilise if not elastic else None,
        )
        self.owned = self._newton.owned
        self.displacement, self.v, self.a = (np.zeros_like(forms.unknown.x.array) for _ in range(3))
        if template.updated:
            self._nodes = geometry_nodes(self.dofs.space)
        self._external = self.loads.external(0.0)
        self.loads.set_followers(0.0)
        self._update_points()
        self._internal = self._internal_force()
        self._reaction = np.zeros_like(self._internal)
        self._energy = {"kinetic": 0.0, "internal": 0.0, "external": 0.0}
        self._imbalance = 0.0
        self._start = {"mass": self._total("weight"), "volume": self._total("volume")}
        if scene.dynamic:
            self._start_moving(bcs)

    def _set_constants(self) -> None:
        for i, region in enumerate(self.scene.regions):
            constants = self.forms.constants
            constants[f"density{i}"].value = region.material.density
            if self.template.laws[i] == "points":
                continue
            E, nu = region.material.parameters["E"], region.material.parameters["nu"]
            mu = E / (2.0 * (1.0 + nu))
            inv_lam = (1.0 + nu) * (1.0 - 2.0 * nu) / (E * nu) if nu else np.inf
            lam = 1.0 / inv_lam if inv_lam else np.inf
            if self.scene.plane == "plane_stress":
                lam = 2.0 * lam * mu / (lam + 2.0 * mu)
            constants[f"mu{i}"].value = mu
            constants[f"inv_lam{i}"].value = inv_lam
            constants[f"lam{i}"].value = lam

    def _start_moving(self, bcs: list[fem.DirichletBC]) -> None:
        """Mass matrices, the initial velocity, and the acceleration that balances the forces at t = 0."""
        form = self.forms.form("mass")
        self._mass, self._free_mass, first = Matrix(form), Matrix(form), Matrix(form)
        self._mass.assemble()
        self._free_mass.assemble(bcs, diagonal=0.0)
        if self.scene.initial_velocity is not None:
            self.v[self.dofs.index] = self.scene.initial_velocity(self.dofs.X.T).T.ravel()
        first.assemble(bcs)
        diagonal = first.mat.getDiagonal()
        # the pressure has no mass: give its rows a diagonal, so that its acceleration is zero
        diagonal.array[diagonal.array == 0.0] = 1.0
        first.mat.setDiagonal(diagonal)
        force = (self._external - self._internal)[: self.owned]
        force[self._held] = 0.0
        self.a[: self.owned] = LinearSolver(first, self.forms.space, definite=False).solve(force)
        self._forward(self.a)
        self._energy["kinetic"] = self._kinetic()

    # --- the balance ----------------------------------------------------------------------------------------------
    def _vector(self) -> la.Vector:
        space = self.forms.space
        return la.vector(space.dofmap.index_map, space.dofmap.index_map_bs)

    def _forward(self, array: np.ndarray) -> None:
        """Give ghosts the values of their owners."""
        vector = self._vector()
        vector.array[:] = array
        vector.scatter_forward()
        array[:] = vector.array

    def _norm(self, array: np.ndarray) -> float:
        owned = array[: self.owned]
        return float(np.sqrt(self.comm.allreduce(float(owned @ owned), op=MPI.SUM)))

    def _update_points(self) -> bool:
        return self.points.update() if self.points else True

    def _internal_force(self) -> np.ndarray:
        """Internal forces less the following pressures at the current unknown, summed into their owners."""
        with phase("assemble"):
            vector = self._vector()
            fem.assemble_vector(vector.array, self._residual)
            vector.scatter_reverse(la.InsertMode.add)
            return vector.array

    def _inertia(self, acceleration: np.ndarray) -> np.ndarray:
        """M a, valid at owned dofs."""
        x, y = self._mass.mat.createVecs()
        x.array[:] = acceleration[: self.owned]
        self._mass.mat.mult(x, y)
        out = np.zeros_like(acceleration)
        out[: self.owned] = y.array
        return out

    def _increment(self) -> np.ndarray:
        """Displacement since the last converged state."""
        return self.forms.unknown.x.array - (0.0 if self.template.updated else self.displacement)

    def _balance(self) -> Balance:
        valid = self._update_points()
        internal = self._internal_force()
        force = self._vector()
        force.array[:] = internal - self._external
        scale = self._norm(self._external)
        if not self._load_driven:
            # under loads alone the loads are the measure: internal forces grow without bound where a body flows away
            scale += self._norm(internal)
        if self.scene.dynamic:
            new = self.scheme.acceleration(self._increment(), self.v, self.a, self._step)
            inertia = self._inertia((1.0 - self.scheme.alpha_m) * new + self.scheme.alpha_m * self.a)
            force.array[:] = inertia + (1.0 - self.scheme.alpha_f) * force.array + self.scheme.alpha_f * self._last_force
            scale += self._norm(inertia)
        return Balance(force, scale, valid)

    @property
    def _stiffness_factor(self) -> float:
        return 1.0 - self.scheme.alpha_f if self.scene.dynamic else 1.0

    def _linearise(self, bcs: list[fem.DirichletBC]) -> None:
        self._matrix.assemble(bcs, diagonal=1.0 / self._stiffness_factor)
        if self.scene.dynamic:
            self._matrix.combine(self._stiffness_factor, self._free_mass, self.scheme.mass_factor(self._step))

    def _stabilise(self, share: float) -> None:
        assert self.points is not None
        if share != self.points.elastic_share:
            self.points.elastic_share = share
            self._update_points()

    def _lift(self, b: np.ndarray, bcs: list[fem.DirichletBC]) -> None:
        x0 = [self.forms.unknown.x.array]
        fem.apply_lifting(b, [self._matrix.form], [bcs], x0=x0, alpha=self._stiffness_factor)
        if self.scene.dynamic:
            fem.apply_lifting(b, [self._mass.form], [bcs], x0=x0, alpha=self.scheme.mass_factor(self._step))

    # --- the step -------------------------------------------------------------------------------------------------
    def dt(self) -> float:
        return self._dt

    def step(self, dt: float) -> None:
        """Advance by dt, or by less where Newton asks for it. Raises ``Breakdown`` with the last good state restored."""
        start = self.forms.unknown.x.array.copy()
        external = self._external
        while True:
            try:
                self._attempt(dt)
                break
            except Breakdown as end:
                cause = "tangle" if self._crushed() else end.cause
                self.forms.unknown.x.array[:] = start
                self._external = external
                self._set_time(self.t, dt)
                self._update_points()
                self.work["cuts"] += 1
                dt *= 0.5
                if dt < SMALLEST_STEP * self._first_dt:
                    raise Breakdown(cause, f"{end}; at t = {self.t:.4g}, after cutting the step to {dt:.1e}") from None
                self._dt = dt
        self._accept(dt, external)
        if dt >= self._dt:
            self._dt = min(self._first_dt, 1.5 * self._dt)

    def _crushed(self) -> bool:
        """True if the state that Newton left has points on some rank whose volume is gone or turned inside out."""
        if self.scene.strain == "small":
            return False
        f = tensors(self.forms.evaluate(self._gradient()))
        return self.comm.allreduce(bool(np.any(~(np.linalg.det(f) > CRUSHED))), op=MPI.LOR)

    def _set_time(self, t: float, dt: float) -> None:
        moved = self.displacement if self.template.updated else None
        for condition in self.conditions:
            condition.set(t, moved)
        if self.points:
            self.points.set_time(t, dt)
        self.loads.set_followers(t)

    def _attempt(self, dt: float) -> None:
        self._step = dt
        self._last_force = self._internal - self._external
        self._set_time(self.t + dt, dt)
        self._external = self.loads.external(self.t + dt)
        before = self._newton.iterations
        try:
            self._newton.solve(self._lift)
        finally:
            self.work["newton"] += self._newton.iterations - before
            self.work["linear"] = self._solver.iterations

    def _accept(self, dt: float, external: np.ndarray) -> None:
        """Make the balanced state the converged one; ``external`` are the loads at the start of the step."""
        internal, du = self._internal_force(), self._increment()
        out_of_balance = internal - self._external
        if self.scene.dynamic:
            a = self.scheme.acceleration(du, self.v, self.a, dt)
            self.v, self.a = self.scheme.velocity(self.v, self.a, a, dt), a
            out_of_balance += self._inertia(a)
        reaction = np.zeros_like(du)
        reaction[self._held] = out_of_balance[self._held]
        # work by the trapezoidal rule: exact for dead loads and linear springs
        forces = np.stack([self._internal + internal, external + self._external + self._reaction + reaction])
        inner, outer = self.comm.allreduce(0.5 * forces[:, : self.owned] @ du[: self.owned], op=MPI.SUM)
        self._energy["internal"] = self._energy["internal"] + inner if self.points else self._total("energy")
        self._energy["external"] += outer
        self._imbalance = max(self._imbalance, self._norm(out_of_balance - reaction) / (self._newton.scale or 1.0))
        self._internal, self._reaction = internal, reaction
        self.displacement = self.displacement + du
        if self.points:
            self.points.commit()
        if self.scene.dynamic:
            self._energy["kinetic"] = self._kinetic()
        if self.template.updated:
            self._move_mesh()
        self.t += dt
        self.work["steps"] += 1

    def _move_mesh(self) -> None:
        """Carry the mesh with the material; F of the new configuration is the base, and the unknown starts from zero."""
        forms = self.forms
        base = forms.base.x.array.reshape(-1, 9 if self.scene.gdim == 3 else 5)
        base[:] = compose(forms.evaluate(self._gradient()), base)
        x = self.dofs.X + self.displacement[self.dofs.index].reshape(self.dofs.X.shape)
        forms.mesh.geometry.x[self._nodes, : self.scene.gdim] = x
        forms.unknown.x.array[self.dofs.index] = 0.0

    # --- what the runner asks -------------------------------------------------------------------------------------
    def _total(self, kind: str) -> float:
        if kind == "energy" and self.points:
            return 0.0
        return float(self.comm.allreduce(fem.assemble_scalar(self._scalar(kind)), op=MPI.SUM))

    @cache  # noqa: B019 - a model lives as long as its run
    def _scalar(self, kind: str) -> fem.Form:
        return self.forms.form(kind)

    def _kinetic(self) -> float:
        return 0.5 * float(self.comm.allreduce(self.v[: self.owned] @ self._inertia(self.v)[: self.owned], op=MPI.SUM))

    @cache  # noqa: B019
    def _material_point(self, at: tuple[float, ...], name: str) -> MaterialPoint:
        return MaterialPoint(self.forms, self.dofs, at, name)

    def probe(self, probe: Probe) -> float:
        """The sampled number of a probe; see ``Probe`` for the quantities."""
        if probe.quantity in ("displacement", "velocity"):
            assert probe.at is not None
            field = self.displacement if probe.quantity == "displacement" else self.v
            return self._material_point(probe.at, probe.name).vector(field[self.dofs.index], probe.component)
        if probe.quantity == "stress":
            assert probe.at is not None
            return self._material_point(probe.at, probe.name).from_quadrature(self._cauchy(), probe.component)
        if probe.quantity == "reaction":
            support = [c for c in self.conditions if c.support.name == probe.of and c.component == probe.component]
            return float(self.comm.allreduce(sum(self._reaction[c.dofs].sum() for c in support), op=MPI.SUM))
        if probe.quantity == "mean_velocity":
            momentum = self._inertia(self.v)[self.dofs.index][probe.component : self.dofs.owned : self.scene.gdim]
            return float(self.comm.allreduce(momentum.sum(), op=MPI.SUM)) / self._start["mass"]
        assert probe.quantity == "displacement_error" and probe.exact is not None
        error = self.displacement[self.dofs.index].reshape(self.dofs.X.shape) - probe.exact(self.dofs.X.T, self.t).T
        return self._root_mean_square(error)

    def _root_mean_square(self, values: np.ndarray) -> float:
        """Root mean square over the body of a nodal vector field (nodes, gdim)."""
        if "square" not in self.__dict__:
            self.square = Matrix(self.forms.form("mass"))
            self.square.assemble()
        x, y = self.square.mat.createVecs()
        full = np.zeros_like(self.displacement)
        full[self.dofs.index] = values.ravel()
        x.array[:] = full[: self.owned]
        self.square.mat.mult(x, y)
        return float(np.sqrt(max(x.dot(y), 0.0) / self._start["mass"]))

    def _cauchy(self) -> np.ndarray:
        """Cauchy stress at the quadrature points, (points, 4 or 6)."""
        return self.points.cauchy() if self.points else self.forms.evaluate(self._stress())

    @cache  # noqa: B019
    def _gradient(self) -> fem.Expression:
        return self.forms.strain()

    @cache  # noqa: B019
    def _stress(self) -> fem.Expression:
        return self.forms.cauchy()

    def energy(self) -> dict[str, float]:
        return dict(self._energy)

    def checks(self) -> dict[str, float | None]:
        """Drift of mass and volume (of incompressible bodies) and the largest force out of balance, relative."""
        mass = abs(self._total("weight") / self._start["mass"] - 1.0) if self._start["mass"] else None
        volume = self._total("volume") / self._start["volume"] - 1.0 if self.template.mixed else None
        return {"mass": mass, "momentum": None if self.scene.dynamic else self._imbalance, "volume": volume}

    def size(self) -> dict[str, int]:
        space = self.forms.space
        cells = self.comm.allreduce(self.forms.owned, op=MPI.SUM)
        return {"dofs": space.dofmap.index_map.size_global * space.dofmap.index_map_bs, "cells": cells,
                "points": cells * len(self.template.points)}  # fmt: skip

    def savings(self) -> dict[str, float]:
        return {}

    def snapshot(self) -> dict[str, Any]:
        u = self.displacement[self.dofs.index].reshape(self.dofs.X.shape)
        stress = self._cauchy().reshape(self.forms.owned, len(self.template.points), -1).mean(axis=1)
        return snapshot.picture(self.dofs.space, self.dofs.X, u, {"stress": stress})

    # --- checkpoints ----------------------------------------------------------------------------------------------
    def _nodal(self) -> dict[str, np.ndarray]:
        return {"displacement": self.displacement, "v": self.v, "a": self.a, "unknown": self.forms.unknown.x.array,
                "internal": self._internal, "external": self._external, "reaction": self._reaction}  # fmt: skip

    def _spaces(self) -> list[tuple[str, np.ndarray, np.ndarray]]:
        """The Lagrange spaces that the unknown consists of: name, reference positions of the nodes, dofs (nodes, components)."""
        out = [("u", self.dofs.X, self.dofs.index.reshape(self.dofs.X.shape))]
        if self.template.mixed:
            space, index = self.forms.space.sub(1).collapse()
            out.append(("p", space.tabulate_dof_coordinates()[:, : self.scene.gdim], np.asarray(index).ravel()[:, None]))
        return out

    def _per_cell(self) -> dict[str, np.ndarray]:
        """Arrays of quadrature points, region by region merged: (owned cells, ...)."""
        out = {"strain": self.points.strain, **self.points.merged_history()} if self.points else {}
        if self.template.updated:
            out["base"] = self.forms.base.x.array
        return {name: values.reshape(self.forms.owned, -1) for name, values in out.items()}

    def state(self) -> dict[str, np.ndarray]:
        """Nodal fields by reference position, point history by the number of the cell: the same on any number of ranks."""
        numbers = [self.t, self._dt, self._imbalance, *self._energy.values()]
        out: dict[str, Any] = {"numbers": np.array(numbers), "work": np.array(list(self.work.values()))}
        for name, x, index in self._spaces():
            owned = index.max(axis=1) < self.owned
            values = np.hstack([field[index[owned]] for field in self._nodal().values()])
            out[f"nodes_{name}"] = snapshot.gather_nodes(self.comm, x[owned], values)
        cells = self.size()["cells"]
        for name, values in self._per_cell().items():
            out[f"cells_{name}"] = gather_by_id(self.comm, self.body.original_cells, values, cells)
        return {name: value for name, value in out.items() if value is not None}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        self.t, self._dt, self._imbalance, *energies = state["numbers"].tolist()
        self._energy = dict(zip(self._energy, energies))
        self.work = dict(zip(self.work, state["work"].tolist()))
        self._solver.iterations = self.work["linear"]
        for name, x, index in self._spaces():
            values = snapshot.scatter_nodes(state[f"nodes_{name}"], x)
            for field, part in zip(self._nodal().values(), np.split(values, len(self._nodal()), axis=1)):
                field[index] = part
        for name, values in self._per_cell().items():
            stored = state[f"cells_{name}"][self.body.original_cells].reshape(values.shape)
            if name == "base":
                self.forms.base.x.array[:] = stored.ravel()
            elif self.points:
                self.points.take(name, stored)
        if self.template.updated:
            x = self.dofs.X + self.displacement[self.dofs.index].reshape(self.dofs.X.shape)
            self.forms.mesh.geometry.x[self._nodes, : self.scene.gdim] = x
        self._set_time(self.t, self._dt)
        self._update_points()


def geometry_nodes(space: fem.FunctionSpace) -> np.ndarray:
    """The node of the mesh's geometry at which each node of a Lagrange space of the same order sits."""
    nodes = np.empty(space.tabulate_dof_coordinates().shape[0], np.int32)
    nodes[space.dofmap.list] = space.mesh.geometry.dofmaps[0]
    return nodes
