"""A body with cracks on a mesh that conforms to them: the balance of momentum, and what is measured at tips."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from mpi4py import MPI

from geofem.core import intensity as sif
from geofem.core.forms import Template
from geofem.core.neartip import kolosov
from geofem.cost import phase
from geofem.methods.conforming.fields import Fields, Points, modes_at
from geofem.methods.conforming.mesh import Meshed
from geofem.methods.lagrangian_model import LagrangianModel
from geofem.scene import Array, Probe, Scene

OUTER, INNER = 0.8, 0.4
"""Radii to which q falls, as parts of what is clear around a tip: where K is taken, and the one it is compared with."""
PLATEAU = 0.5
"""The part of that radius within which q is 1: rings that are wide beside the cells keep the full order of the solution."""
FINE = 10
"""Degree of the rule with which errors and intensity factors are integrated."""
INWARD = 1e-10
"""Prescribed displacements are asked for this part of the way from a node into its cells: both faces of a crack lie in one place."""


class CrackedBody(LagrangianModel):
    """A linear elastic body with the cracks of a scene, each parted by its mesh; for every other place of the cracks one is made.

    steps : of the load.
    """

    def __init__(self, scene: Scene, template: Template, meshed: Meshed, steps: int):
        super().__init__(scene, template, meshed.body, steps, rho_inf=1.0, tolerance=1e-9, plastic=False)
        self.tips, self.walls = meshed.tips, meshed.walls
        self.fields = Fields(self.dofs.space, self.tips)
        constants = [self.forms.constants[f"{name}{i}"].value for name in ("lam", "mu") for i in range(len(scene.regions))]
        self.lam, self.mu = np.array(constants, float).reshape(2, -1)[:, self.body.regions]
        for condition in self.balance.conditions:
            condition.move_inward(INWARD)

    def balance_at(self, t: float) -> None:
        """Solve for the state at t. Raises ``Breakdown`` if the matrix is singular."""
        self.balance.solve(t, self._dt)
        self._accept()
        self.t = t

    def load_work(self) -> float:
        """The work (J) that the present loads would do on the present displacement. Collective."""
        owned = self.balance.owned
        work = self.balance.external[:owned] @ self.balance.displacement[:owned]
        return float(self.comm.allreduce(float(work), op=MPI.SUM))

    def probe(self, probe: Probe) -> float:
        """The sampled number of a probe; see ``Probe`` for the quantities."""
        return self._error(probe) if probe.quantity in ("displacement_error", "energy_error") else super().probe(probe)

    def checks(self) -> dict[str, float | None]:
        """As for bodies without cracks, and how far K differs between two rings: ``path``, the worst of all tips."""
        path = None
        if self.tips:
            outer, inner = ([self.intensity(tip, part) for tip in range(len(self.tips))] for part in (OUTER, INNER))
            path = max(float(np.hypot(*(a - b)) / (np.hypot(*a) or 1.0)) for a, b in zip(outer, inner))
        return super().checks() | {"path": path}

    # --- what is measured at tips and against exact fields --------------------------------------------------------
    def factors(self) -> tuple[Array, Array]:
        """K_I and K_II (tips, 2), Pa sqrt(m), and J (tips,), J/m2, of all tips. Collective."""
        tips = range(len(self.tips))
        return np.array([self.intensity(tip) for tip in tips]).reshape(-1, 2), np.array([self.release(tip) for tip in tips])

    def intensity(self, tip: int, part: float = OUTER) -> Array:
        """K_I and K_II (2,) of a tip (Pa sqrt(m)), by a ring up to that part of what is clear around it. Collective."""
        ring, forces, x, there = self._ring(tip, part)
        at, axis, kappa = self.tips[tip].at, self.tips[tip].axis, self._kappa[tip]
        return sif.intensity(ring, modes_at(x, at, axis, kappa), kappa, forces, modes_at(there, at, axis, kappa))

    def release(self, tip: int, part: float = OUTER) -> float:
        """The energy that is released per area of new crack, straight ahead of a tip (J/m2). Collective."""
        return sif.release(*self._ring(tip, part)[:2])

    def _ring(self, tip: int, part: float) -> tuple[sif.Ring, sif.Forces, Array, Array]:
        """The solution where q falls from 1 to 0 around a tip, the forces of mass inside, and the points (n, 2) of both."""
        with phase("intensity"):
            X, at, radius = self.fields.X, self.tips[tip].at, part * self.tips[tip].clear
            r = np.hypot(*(X - at).T).T
            q = np.where(r == 0.0, 1.0, np.clip((radius - r) / ((1.0 - PLATEAU) * radius), 0.0, 1.0))
            b, c = X[:, 1] - X[:, 0], X[:, 2] - X[:, 0]
            db, dc = q[:, 1] - q[:, 0], q[:, 2] - q[:, 0]
            double = b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0]
            slope = np.stack([db * c[:, 1] - dc * b[:, 1], dc * b[:, 0] - db * c[:, 0]], axis=1) / double[:, None]
            points = self._at_points(np.flatnonzero(np.ptp(q, axis=1) > 0.0))
            lam, mu = self.lam[points.cell], self.mu[points.cell]
            ring = sif.Ring(self.comm, points.w, slope[points.cell], points.g, self.tips[tip].axis, lam, mu)
            masses = [load for load in self.scene.loads if load.kind in ("gravity", "body")]
            if not masses:
                return ring, sif.NONE, points.x, np.empty((0, 2))
            inside = self._at_points(np.flatnonzero(q.max(axis=1) > 0.0))
            cell, x = inside.cell, inside.x
            density = np.array([region.material.density for region in self.scene.regions])[self.body.regions[cell]]
            f = np.zeros_like(x)
            for load in masses:
                value = load.value(x.T, self.t).T if load.kind == "body" else np.asarray(load.value, float)[:2]
                f += self.scene.amplitude(load, self.t) * density[:, None] * value
            height = q[cell, 0] + ((x - X[cell, 0]) * slope[cell]).sum(axis=1)
            return ring, sif.Forces(inside.w * height, f, inside.g), points.x, x

    @cached_property
    def _kappa(self) -> list[float]:
        """Kolosov's constant of the region around each tip. Collective."""
        regions = self.scene.regions
        of = np.array([kolosov(region.material.parameters["nu"], self.scene.plane) for region in regions])
        mine = [
            self.body.regions[np.hypot(*(self.fields.X - tip.at).T).min(axis=0) == 0.0].max(initial=-1) for tip in self.tips
        ]
        return [float(of[self.comm.allreduce(int(region), op=MPI.MAX)]) for region in mine]

    def _at_points(self, cells: Array) -> Points:
        return self.fields.at_points(cells, self._displacement(), FINE)

    def _error(self, probe: Probe) -> float:
        """See ``displacement_error`` and ``energy_error`` of ``Probe``. Collective."""
        assert probe.exact is not None
        if self.t == 0.0:
            return 0.0
        with phase("errors"):
            points = self._at_points(np.arange(len(self.fields.X)))
            if probe.quantity == "displacement_error":
                square = ((points.u - probe.exact(points.x.T, self.t).T) ** 2).sum(axis=1)
                total, area = self.comm.allreduce(np.array([points.w @ square, points.w.sum()]), op=MPI.SUM)
                return float(np.sqrt(total / area))
            d = points.g - np.moveaxis(probe.exact(points.x.T, self.t), 2, 0)
            stress = sif.stress(d, self.lam[points.cell], self.mu[points.cell])
            density = 0.5 * np.einsum("nij,nij->n", stress, d)
            return float(np.sqrt(self.comm.allreduce(float(points.w @ density), op=MPI.SUM)))
