"""The model behind method ``fem`` for bodies with cracks: the balance of momentum on a mesh that conforms to them."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from mpi4py import MPI

from geofem.core import intensity as sif
from geofem.core.forms import Template
from geofem.core.mesh import Body
from geofem.core.neartip import kolosov
from geofem.cost import phase
from geofem.methods.conforming.fields import Fields, Points, modes_at
from geofem.methods.conforming.mesh import Tip
from geofem.methods.lagrangian_model import LagrangianModel
from geofem.mistake import Mistake
from geofem.scene import Array, Probe, Scene

OUTER, INNER = 0.8, 0.4
"""Radii to which q falls, as parts of what is clear around a tip: where K is taken, and the one it is compared with."""
PLATEAU = 0.5
"""The part of that radius within which q is 1: rings that are wide beside the cells keep the full order of the solution."""
FINE = 10
"""Degree of the rule with which errors and intensity factors are integrated."""
INWARD = 1e-10
"""Prescribed displacements are asked for this part of the way from a node into its cells: both faces of a crack lie in one place."""


class ConformingModel(LagrangianModel):
    """A linear elastic body with cracks that its mesh is parted along.

    Parameters
    ----------
    tips : of the cracks. steps : of the load.
    """

    def __init__(self, scene: Scene, template: Template, body: Body, tips: tuple[Tip, ...], steps: int):
        super().__init__(scene, template, body, steps, rho_inf=1.0, tolerance=1e-9, plastic=False)
        self.tips = tips
        self.fields = Fields(self.dofs.space, tips)
        constants = [self.forms.constants[f"{name}{i}"].value for name in ("lam", "mu") for i in range(len(scene.regions))]
        self.lam, self.mu = np.array(constants, float).reshape(2, -1)[:, body.regions]
        for condition in self.balance.conditions:
            condition.move_inward(INWARD)

    def probe(self, probe: Probe) -> float:
        """The sampled number of a probe; see ``Probe`` for the quantities."""
        if probe.quantity in ("KI", "KII"):
            assert probe.at is not None
            if not self.tips:
                raise Mistake(f"probe {probe.name!r}: no crack of scene {self.scene.name} ends inside a body; there is no tip")
            tip = int(np.argmin([np.hypot(*(tip.at - np.array(probe.at))) for tip in self.tips]))
            return float(self.intensity(tip)[0 if probe.quantity == "KI" else 1])
        if probe.quantity in ("displacement_error", "energy_error"):
            return self._error(probe)
        return super().probe(probe)

    def checks(self) -> dict[str, float | None]:
        """As for bodies without cracks, and how far K differs between two rings: ``path``, the worst of all tips."""
        path = None
        if self.tips and self.t:
            outer, inner = ([self.intensity(tip, part) for tip in range(len(self.tips))] for part in (OUTER, INNER))
            path = max(float(np.hypot(*(a - b)) / (np.hypot(*a) or 1.0)) for a, b in zip(outer, inner))
        return super().checks() | {"path": path}

    def state(self) -> dict[str, np.ndarray]:
        """The time and the work done: a linear body without memory is solved anew when a run is resumed."""
        numbers = [self.t, self._dt, self._imbalance, self._energy["external"]]
        return {"numbers": np.array(numbers), "work": np.array(list(self.work.values()))}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        self.t, self._dt, self._imbalance, external = state["numbers"].tolist()
        self.balance.solve(self.t, self.t)
        self._accept()
        self._energy["external"] = external
        self.work = dict(zip(self.work, state["work"].tolist()))

    # --- what is measured at tips and against exact fields --------------------------------------------------------
    def intensity(self, tip: int, part: float = OUTER) -> Array:
        """K_I and K_II (2,) of a tip (Pa sqrt(m)), by a ring up to that part of what is clear around it. Collective."""
        if self.t == 0.0:
            return np.zeros(2)
        ring, x = self._ring(tip, part)
        kappa = self._kappa[tip]
        return sif.intensity(ring, modes_at(x, self.tips[tip].at, self.tips[tip].axis, kappa), kappa)

    def release(self, tip: int, part: float = OUTER) -> float:
        """The energy that is released per area of new crack, straight ahead of a tip (J/m2). Collective."""
        return sif.release(self._ring(tip, part)[0]) if self.t else 0.0

    def _ring(self, tip: int, part: float) -> tuple[sif.Ring, Array]:
        """The solution where q falls from 1 to 0 around a tip, and the points (n, 2)."""
        at, axis, _, _, clear = self.tips[tip]
        with phase("intensity"):
            radius = part * clear
            r = np.hypot(*(self.fields.X - at).T).T
            q = np.where(r == 0.0, 1.0, np.clip((radius - r) / ((1.0 - PLATEAU) * radius), 0.0, 1.0))
            cells = np.flatnonzero(np.ptp(q, axis=1) > 0.0)
            points = self._at_points(cells)
            b, c = (self.fields.X[cells, k] - self.fields.X[cells, 0] for k in (1, 2))
            db, dc = (q[cells, k] - q[cells, 0] for k in (1, 2))
            double = b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0]
            slope = np.zeros((len(r), 2))
            slope[cells] = np.stack([db * c[:, 1] - dc * b[:, 1], dc * b[:, 0] - db * c[:, 0]], axis=1) / double[:, None]
            lam, mu = self.lam[points.cell], self.mu[points.cell]
            return sif.Ring(self.comm, points.w, slope[points.cell], points.g, axis, lam, mu), points.x

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
