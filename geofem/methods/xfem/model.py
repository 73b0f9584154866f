"""The model behind method ``xfem``: a scene with cracks, as the runner sees it."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from geofem.core import intensity as sif
from geofem.core.conditions import Loads
from geofem.core.propagation import PROBED, End, Peak, Propagation
from geofem.cost import phase
from geofem.methods.xfem.basis import fields_at
from geofem.methods.xfem.cracked import INNER, INNER_CELLS, Cracked
from geofem.methods.xfem.enrichment import TipChoice
from geofem.methods.xfem.geometry import Lines, cracks_of, lines_of, polylines
from geofem.methods.xfem.intact import Intact
from geofem.methods.xfem.peak import peak
from geofem.mistake import Breakdown, Mistake
from geofem.scene import Array, Growth, Probe, Scene


class XfemModel:
    """A scene with cracks: the body with the present ones, and what was counted on the way to its state.

    Parameters
    ----------
    choice : how tips are enriched, None for jumps only. radius : of the enrichment around a tip (m). dt : step of the load, or way
        of the fastest tip in a step (m) where cracks grow.
    """

    def __init__(self, scene: Scene, intact: Intact, choice: TipChoice | None, radius: float, dt: float):
        self.scene, self.intact, self.choice, self.radius = scene, intact, choice, radius
        self.comm = intact.comm
        self.t, self._dt = 0.0, dt
        self.work = {"steps": 0}
        self.loads = Loads(scene, intact.forms, intact.body)
        self.cracked = self._with(polylines(scene.cracks))
        self._energy = {"kinetic": 0.0, "internal": 0.0, "external": 0.0}
        self._imbalance = 0.0
        self.propagation = Propagation(scene.growth or Growth(length=scene.length), self)
        if scene.growth is not None:
            self._balance(0.0)

    def _with(self, lines: Lines) -> Cracked:
        """The body with cracks there. Collective."""
        return Cracked(self.intact, self.scene, self.loads, lines, self.choice, self.radius)

    # --- cracks that grow, see ``geofem.core.propagation.Cracks`` ----------------------------------------------------
    def paths(self) -> list[Array]:
        return [path.copy() for path in cracks_of(self.cracked.lines)]

    def ends(self) -> list[End]:
        tips = self.cracked.tips
        return [End(int(c), turn > 0, at, axis) for c, turn, at, axis in zip(tips.crack, tips.turn, tips.at, tips.axis)]

    def factors(self) -> tuple[Array, Array]:
        return self.cracked.factors

    def recut(self, paths: list[Array]) -> None:
        """Put cracks in the place of the present ones, and balance the load anew; these stay if that fails. Collective.

        External work is counted for loads on uncracked boundary.
        """
        before, nodes, owned = self.cracked, 2 * len(self.intact.grid.X), 2 * self.intact.grid.owned
        self.cracked = self._with(lines_of(paths))
        self.cracked.x[:nodes], self.cracked.external[:owned] = before.x[:nodes], before.external[:owned]
        try:
            self._balance(self.t)
        except Breakdown:
            before, self.cracked = self.cracked, before
            raise
        finally:
            before.destroy()

    def walls(self) -> Array:
        return self.intact.walls

    def peak(self, away: float) -> Peak | None:
        return peak(self.cracked, away)

    # --- the step -------------------------------------------------------------------------------------------------
    def dt(self) -> float:
        return self._dt

    def step(self, dt: float) -> None:
        """Advance by dt. Raises ``Breakdown`` if the matrix is singular, or (arrest) where no crack grows any more."""
        if self.scene.growth is None:
            self._balance(self.t + dt)
            self.t += dt
        else:
            self.t += self.propagation.step(dt)
        self.work["steps"] += 1

    def _balance(self, t: float) -> None:
        """Solve for the state at t, and count the work done on the way to it."""
        body = self.cracked
        x, external = body.x, body.external
        body.solve(t)
        change = (body.x - x)[body.numbering.local_owned]
        self._energy["external"] += 0.5 * body.system.dot(body.external + external, change)
        self._energy["internal"] = body.strain_energy()
        self._imbalance = max(self._imbalance, body.imbalance)

    # --- what the runner asks -------------------------------------------------------------------------------------
    def probe(self, probe: Probe) -> float:
        """The sampled number of a probe; see ``Probe`` for the quantities."""
        if probe.quantity in PROBED:
            return self.propagation.probe(probe)
        if probe.quantity == "T":
            tip = self.propagation.tip(probe)
            return 0.0 if tip is None else self.cracked.tension(tip)
        if probe.quantity in ("displacement_error", "energy_error"):
            return self._error(probe)
        if probe.quantity == "opening":
            assert probe.at is not None
            return self.cracked.opening(np.array(probe.at, float))
        if probe.quantity == "opening_error":
            return self._opening_error(probe)
        if probe.quantity == "displacement":
            assert probe.at is not None
            return float(self.cracked.at(np.array(probe.at, float))[0][probe.component])
        if probe.quantity == "stress":
            assert probe.at is not None
            return float(self.cracked.at(np.array(probe.at, float))[1][probe.component])
        if probe.quantity == "reaction":
            support = next(s for s in self.scene.supports if s.name == probe.of)
            dofs = self.cracked.supports.owned_of(support, probe.component)
            reaction = (self.cracked.internal - self.cracked.force(self.t))[dofs].sum()
            return float(self.comm.allreduce(reaction, op=MPI.SUM))
        raise Mistake(f"probe {probe.name!r}: xfem does not measure {probe.quantity!r}")

    def _error(self, probe: Probe) -> float:
        """See ``displacement_error`` and ``energy_error`` of ``Probe``. Collective."""
        assert probe.exact is not None
        if self.t == 0.0:
            return 0.0
        with phase("errors"):
            rule, acting = self.cracked.whole
            u, g = fields_at(rule, acting, self.cracked.world, self.cracked.x)
            if probe.quantity == "displacement_error":
                square = ((u - probe.exact(rule.x.T, self.t).T) ** 2).sum(axis=1)
                total, area = self.comm.allreduce(np.array([rule.w @ square, rule.w.sum()]), op=MPI.SUM)
                return float(np.sqrt(total / area))
            cell = np.repeat(rule.cells, np.diff(rule.start))
            d = g - np.moveaxis(probe.exact(rule.x.T, self.t), 2, 0)
            density = 0.5 * np.einsum("nij,nij->n", sif.stress(d, self.intact.lam[cell], self.intact.mu[cell]), d)
            return float(np.sqrt(self.comm.allreduce(rule.w @ density, op=MPI.SUM)))

    def _opening_error(self, probe: Probe) -> float:
        """See ``opening_error`` of ``Probe``. Collective."""
        assert probe.exact is not None
        faces = self.cracked.faces
        square = (faces.jumps(self.cracked.x)[:, 0] - probe.exact(faces.rule.x.T, self.t)) ** 2
        total, length = self.comm.allreduce(np.array([faces.rule.w @ square, faces.rule.w.sum()]), op=MPI.SUM)
        return float(np.sqrt(total / length))

    def energy(self) -> dict[str, float]:
        return dict(self._energy)

    def checks(self) -> dict[str, float | None]:
        """The largest force out of balance, relative; how far K differs between two rings: ``path``, the worst of all tips; and
        how far faces overlap as a part of their crack's length: ``overlap``."""
        body, path = self.cracked, None
        overlap = body.overlap() if len(body.lines.start) > 1 else None
        if len(body.tips.at):
            tips = range(len(body.tips.at))
            outer = [body.intensity(tip) for tip in tips]
            inner = [body.intensity(t, max(INNER * body.ring_radius(t), INNER_CELLS * body.cell[t])) for t in tips]
            path = max(float(np.hypot(*(a - b)) / (np.hypot(*a) or 1.0)) for a, b in zip(outer, inner))
        return {"mass": None, "momentum": self._imbalance, "volume": None, "path": path, "overlap": overlap}

    def size(self) -> dict[str, int]:
        cells = self.comm.allreduce(len(self.intact.grid.T), op=MPI.SUM)
        points = self.comm.allreduce(len(self.cracked.rule.w), op=MPI.SUM)
        return {"dofs": self.cracked.numbering.total, "cells": cells, "points": points}

    def savings(self) -> dict[str, float]:
        return {}

    def snapshot(self) -> dict[str, Any]:
        return self.cracked.snapshot()

    def functions(self) -> list[fem.Function]:
        self._function.x.array[:] = self.cracked.nodal().ravel()
        return [self._function]

    @cached_property
    def _function(self) -> fem.Function:
        return fem.Function(self.intact.space, name="displacement")

    def state(self) -> dict[str, np.ndarray]:
        """The time, the work done, the cracks and what their faces remember: the body is solved anew when a run is resumed."""
        lines = self.cracked.lines
        numbers = [self.t, self._energy["external"], self._imbalance, self.work["steps"], self.propagation.cycles]
        contact = self.cracked.contact
        faces = contact.state() if contact else np.empty((0, 4))
        return {"numbers": np.array(numbers), "points": lines.points, "start": lines.start, "faces": faces}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        self.t, external, self._imbalance, steps, self.propagation.cycles = state["numbers"].tolist()
        self.cracked.destroy()
        self.cracked = self._with(Lines(state["points"], state["start"]))
        if self.cracked.contact:
            self.cracked.contact.restore(state["faces"])
        self._balance(self.t)
        self._energy["external"], self.work["steps"] = external, int(steps)
