"""The model behind method ``fem``: the momentum balance on a mesh that follows the material."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from geofem.core import snapshot
from geofem.core.balance import MomentumBalance
from geofem.core.forms import Template
from geofem.core.mesh import Body
from geofem.core.mpi import gather_by_id
from geofem.core.sampling import MaterialPoint
from geofem.core.state import compose, tensors
from geofem.mistake import Breakdown
from geofem.scene import Probe, Scene

CRUSHED = 0.01
"""Where a step leaves less than this part of a volume, the mesh has tangled: laws of finite strain resist to the last."""
SMALLEST_STEP = 1e-3
"""A step is cut no further than this fraction of the first one."""


class LagrangianModel:
    """A scene on a Lagrangian mesh: step after step of the momentum balance, cut where Newton fails."""

    def __init__(
        self, scene: Scene, template: Template, body: Body, steps: int, rho_inf: float, tolerance: float, plastic: bool
    ):
        self.scene, self.template, self.body = scene, template, body
        self.comm = body.mesh.comm
        self.t = 0.0
        span = scene.period if scene.dynamic and scene.period else scene.t_end
        self._dt = self._first_dt = span / steps
        self.work = {"steps": 0, "newton": 0, "linear": 0, "cuts": 0}
        self.balance = MomentumBalance(scene, template, body, rho_inf, tolerance, plastic)
        self.forms, self.dofs = self.balance.forms, self.balance.dofs
        if template.updated:
            self._nodes = geometry_nodes(self.dofs.space)
        self._energy = {"kinetic": self.balance.kinetic() if scene.dynamic else 0.0, "internal": 0.0, "external": 0.0}
        self._imbalance = 0.0
        self._known_stress = -1.0, np.empty((0, 0))
        # found now, on the reference mesh: that of a resumed run in the updated frame lies elsewhere
        self._places = {
            p.at: MaterialPoint(self.forms, self.dofs, p.at, p.name)
            for p in scene.probes
            if p.at is not None and p.quantity in ("displacement", "velocity", "stress")
        }
        self._start = {"mass": self.balance.total("weight"), "volume": self.balance.total("volume")}

    def dt(self) -> float:
        return self._dt

    def step(self, dt: float) -> None:
        """Advance by dt, or by less where Newton asks for it. Raises ``Breakdown`` with the last good state restored."""
        while True:
            before = self.balance.newton.iterations
            try:
                self.balance.solve(self.t + dt, dt)
                self._check_vertices()
                break
            except Breakdown as end:
                cause = "tangle" if self._crushed() else end.cause
                self.balance.revert(self.t)
                self.work["cuts"] += 1
                dt *= 0.5
                if dt < SMALLEST_STEP * self._first_dt:
                    raise Breakdown(cause, f"{end}; at t = {self.t:.4g}, after cutting the step to {dt:.1e}") from None
                self._dt = dt
            finally:
                self.work["newton"] += self.balance.newton.iterations - before
                self.work["linear"] = self.balance.solver.iterations
        self._accept()
        self.t += dt
        self.work["steps"] += 1
        if dt >= self._dt:
            self._dt = min(self._first_dt, 1.5 * self._dt)

    def _accept(self) -> None:
        """Make the balanced state the converged one, and carry the mesh along in the updated frame."""
        du, inner, outer, left = self.balance.accept()
        self._imbalance = max(self._imbalance, left / (self.balance.newton.scale or 1.0))
        self._energy["internal"] = self._energy["internal"] + inner if self.balance.points else self.balance.total("energy")
        self._energy["external"] += outer
        if self.scene.dynamic:
            self._energy["kinetic"] = self.balance.kinetic()
        if self.template.updated:
            base = self.forms.base.x.array.reshape(-1, 9 if self.scene.gdim == 3 else 5)
            base[:] = compose(self.forms.evaluate(self._gradient), base)
            self._place_mesh()
            self.forms.unknown.x.array[self.dofs.index] = 0.0

    def _place_mesh(self) -> None:
        """Put the nodes of the mesh where the material is."""
        x = self.dofs.X + self._displacement()
        self.forms.mesh.geometry.x[self._nodes, : self.scene.gdim] = x

    def _crushed(self) -> bool:
        """True if the state that Newton left has points on some rank whose volume is gone or turned inside out."""
        if self.scene.strain == "small":
            return False
        f = tensors(self.forms.evaluate(self._gradient))
        return self.comm.allreduce(bool(np.any(~(np.linalg.det(f) > CRUSHED))), op=MPI.LOR)

    def _check_vertices(self) -> None:
        """Raise ``Breakdown`` (tangle) if a cell has turned inside out at a corner, which its quadrature points do not see."""
        if self.scene.strain == "small":
            return
        least = np.linalg.det(tensors(self.forms.evaluate(self._gradient_at_vertices))).min(initial=np.inf)
        if not (least := self.comm.allreduce(float(least), op=MPI.MIN)) > 0.0:
            raise Breakdown("tangle", f"a cell is inside out at a corner (det F = {least:.2g})")

    @cached_property
    def _gradient_at_vertices(self) -> fem.Expression:
        return self.forms.strain_at_vertices()

    @cached_property
    def _gradient(self) -> fem.Expression:
        return self.forms.strain()

    def _displacement(self) -> np.ndarray:
        """The displacement, (nodes, gdim), ghosts included."""
        return self.balance.displacement[self.dofs.index].reshape(self.dofs.X.shape)

    # --- what the runner asks -------------------------------------------------------------------------------------
    def probe(self, probe: Probe) -> float:
        """The sampled number of a probe; see ``Probe`` for the quantities."""
        if probe.quantity in ("displacement", "velocity"):
            assert probe.at is not None
            field = self.balance.displacement if probe.quantity == "displacement" else self.balance.v
            return self._places[probe.at].vector(field[self.dofs.index], probe.component)
        if probe.quantity == "stress":
            assert probe.at is not None
            return self._places[probe.at].from_quadrature(self._cauchy(), probe.component)
        if probe.quantity == "reaction":
            support = [c for c in self.balance.conditions if c.support.name == probe.of and c.component == probe.component]
            return float(self.comm.allreduce(sum(self.balance.reaction[c.dofs].sum() for c in support), op=MPI.SUM))
        if probe.quantity == "mean_velocity":
            momentum = self.balance.inertia(self.balance.v)[self.dofs.index][
                probe.component : self.dofs.owned : self.scene.gdim
            ]
            return float(self.comm.allreduce(momentum.sum(), op=MPI.SUM)) / self._start["mass"]
        assert probe.quantity == "displacement_error" and probe.exact is not None
        error = self._displacement() - probe.exact(self.dofs.X.T, self.t).T
        return self._root_mean_square(error)

    def _root_mean_square(self, values: np.ndarray) -> float:
        """Root mean square over the body, weighted by mass, of a nodal vector field (nodes, gdim)."""
        full = np.zeros_like(self.balance.displacement)
        full[self.dofs.index] = values.ravel()
        square = full[: self.balance.owned] @ self.balance.inertia(full)[: self.balance.owned]
        return float(np.sqrt(max(self.comm.allreduce(square, op=MPI.SUM), 0.0) / self._start["mass"]))

    def _cauchy(self) -> np.ndarray:
        """Cauchy stress at the quadrature points, (points, 4 or 6), evaluated once per state."""
        if self._known_stress[0] != self.t:
            points = self.balance.points
            self._known_stress = self.t, points.cauchy() if points else self._cauchy_of_regions()
        return self._known_stress[1]

    def _cauchy_of_regions(self) -> np.ndarray:
        shape = self.forms.owned, len(self.template.points), -1
        first, *others = (self.forms.evaluate(stress).reshape(shape) for stress in self._stress)
        for cells, values in zip(self.forms.cells[1:], others):
            first[cells] = values[cells]
        return first.reshape(shape[0] * shape[1], -1)

    @cached_property
    def _stress(self) -> list[fem.Expression]:
        return self.forms.cauchy()

    def energy(self) -> dict[str, float]:
        return dict(self._energy)

    def checks(self) -> dict[str, float | None]:
        """Drift of mass and volume (of incompressible bodies) and the largest force out of balance, relative."""
        mass = abs(self.balance.total("weight") / self._start["mass"] - 1.0) if self._start["mass"] else None
        volume = self.balance.total("volume") / self._start["volume"] - 1.0 if self.template.mixed else None
        return {"mass": mass, "momentum": None if self.scene.dynamic else self._imbalance, "volume": volume}

    def size(self) -> dict[str, int]:
        space = self.forms.space
        cells = self.comm.allreduce(self.forms.owned, op=MPI.SUM)
        return {"dofs": space.dofmap.index_map.size_global * space.dofmap.index_map_bs, "cells": cells,
                "points": cells * len(self.template.points)}  # fmt: skip

    def savings(self) -> dict[str, float]:
        return {}

    def snapshot(self) -> dict[str, Any]:
        stress = self._cauchy().reshape(self.forms.owned, len(self.template.points), -1).mean(axis=1)
        return snapshot.picture(self.dofs.space, self.dofs.X, self._displacement(), {"stress": stress})

    def functions(self) -> list[fem.Function]:
        for name, function in self._functions.items():
            function.x.array[:] = getattr(self.balance, name)[self.dofs.index]
        return list(self._functions.values())

    @cached_property
    def _functions(self) -> dict[str, fem.Function]:
        names = {"displacement": "displacement", "v": "velocity"} if self.scene.dynamic else {"displacement": "displacement"}
        return {array: fem.Function(self.dofs.space, name=name) for array, name in names.items()}

    # --- checkpoints ----------------------------------------------------------------------------------------------
    def _nodal(self) -> dict[str, np.ndarray]:
        b = self.balance
        return {"displacement": b.displacement, "v": b.v, "a": b.a, "unknown": self.forms.unknown.x.array,
                "internal": b.internal, "external": b.external, "reaction": b.reaction}  # fmt: skip

    def _spaces(self) -> list[tuple[str, np.ndarray, np.ndarray]]:
        """The Lagrange spaces that the unknown consists of: name, reference positions of the nodes, dofs (nodes, components)."""
        out = [("u", self.dofs.X, self.dofs.index.reshape(self.dofs.X.shape))]
        if self.template.mixed:
            space, index = self.forms.space.sub(1).collapse()
            out.append(("p", space.tabulate_dof_coordinates()[:, : self.scene.gdim], np.asarray(index).ravel()[:, None]))
        return out

    def _per_cell(self) -> dict[str, np.ndarray]:
        """Arrays of quadrature points, region by region merged: (owned cells, ...)."""
        points = self.balance.points
        out = {"strain": points.strain, **points.merged_history()} if points else {}
        if self.template.updated:
            out["base"] = self.forms.base.x.array
        return {name: values.reshape(self.forms.owned, -1) for name, values in out.items()}

    def state(self) -> dict[str, np.ndarray]:
        """Nodal fields by reference position, point history by the number of the cell: the same on any number of ranks."""
        numbers = [self.t, self._dt, self._imbalance, *self._energy.values()]
        out: dict[str, Any] = {"numbers": np.array(numbers), "work": np.array(list(self.work.values()))}
        for name, x, index in self._spaces():
            owned = index.max(axis=1) < self.balance.owned
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
        self.balance.solver.iterations = self.work["linear"]
        for name, x, index in self._spaces():
            values = snapshot.scatter_nodes(state[f"nodes_{name}"], x)
            for field, part in zip(self._nodal().values(), np.split(values, len(self._nodal()), axis=1)):
                field[index] = part
        for name, values in self._per_cell().items():
            stored = state[f"cells_{name}"][self.body.original_cells].reshape(values.shape)
            if name == "base":
                self.forms.base.x.array[:] = stored.ravel()
            elif self.balance.points:
                self.balance.points.take(name, stored)
        if self.template.updated:
            self._place_mesh()
        self.balance.restored(self.t, self._dt)


def geometry_nodes(space: fem.FunctionSpace) -> np.ndarray:
    """The node of the mesh's geometry at which each node of a Lagrange space of the same order sits."""
    nodes = np.empty(space.tabulate_dof_coordinates().shape[0], np.int32)
    nodes[space.dofmap.list] = space.mesh.geometry.dofmaps[0]
    return nodes
