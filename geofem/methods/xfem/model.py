"""The model behind method ``xfem``: a linear elastic body with cracks, solved on a mesh that knows nothing of them."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from dolfinx import fem, mesh
from mpi4py import MPI

from geofem.core import intensity as sif
from geofem.core.conditions import Loads
from geofem.core.forms import Forms, Template
from geofem.core.mesh import Body
from geofem.core.neartip import kolosov
from geofem.cost import phase
from geofem.methods.xfem.basis import World, blocks, fields_at
from geofem.methods.xfem.enrichment import JUMP, CellEntries, Enrichment, TipChoice, entries_of, sides_of
from geofem.methods.xfem.fields import modes_at
from geofem.methods.xfem.geometry import Lines, Tips, cells_at, distance_to, extended, find_tips, polylines, touching
from geofem.methods.xfem.grid import Grid, boundary_edges
from geofem.methods.xfem.loads import EnrichedLoads
from geofem.methods.xfem.picture import picture
from geofem.methods.xfem.rules import Cutter, Degrees, Rule
from geofem.methods.xfem.supports import Supports
from geofem.methods.xfem.system import Numbering, StandardBlock, System
from geofem.mistake import Mistake
from geofem.scene import Array, Probe, Scene

FINE = Degrees(near=14, far=8, polar=16)
"""Rules with which errors and intensity factors are integrated."""
FROM_END, FROM_BOUNDARY = 0.45, 0.7
"""The radius around a tip is at most this part of the distance to the crack's other end and other cracks, and to the boundary."""
LEAST_CELLS = 2.5
"""It is at least so many cells where there is room: nodes next to the tip carry no jump, and where the ramp falls from them
already, the crack is held shut in part. With one layer of nodes, modes do not converge."""
RING, INNER = 1.25, 0.64
"""Radius of the ring where K is taken as a multiple of that of the enrichment, and of the one that it is compared with as a
multiple of the first."""
RING_CELLS, INNER_CELLS = 2.0, 1.5
"""They are at least so many cells wide."""
STRAIGHT = 1e-3
"""Sine of the angle up to which a crack behind its tip counts as straight."""


class XfemModel:
    """A scene with cracks: the system of the present cracks, and its solution step after step.

    Parameters
    ----------
    choice : how tips are enriched, None for jumps only. radius : of the enrichment around a tip (m). steps : of the load.
    """

    def __init__(self, scene: Scene, template: Template, body: Body, choice: TipChoice | None, radius: float, steps: int):
        self.scene, self.body, self.choice, self.radius = scene, body, choice, radius
        self.comm = body.mesh.comm
        self.t, self._dt = 0.0, scene.t_end / steps
        self.work = {"steps": 0}
        self.forms = Forms(body.mesh, template, body.regions)
        self.forms.set_parameters([region.material for region in scene.regions])
        self.space = self.forms.space
        self.grid = Grid(self.space, body.regions)
        constants = [self.forms.constants[f"{name}{i}"].value for name in ("lam", "mu") for i in range(len(scene.regions))]
        self.lam, self.mu = np.array(constants, float).reshape(2, -1)[:, self.grid.region]
        self._kappas = np.array([kolosov(r.material.parameters["nu"], scene.plane) for r in scene.regions])
        with phase("assembly"):
            self.standard = StandardBlock(self.forms.form("tangent"), self.grid)
        self.loads = Loads(scene, self.forms, body)
        self.boundary = boundary_edges(self.grid, mesh.exterior_facet_indices(body.mesh.topology))
        self.lines = polylines(scene.cracks)
        self.build()
        self.x = np.zeros(len(self.numbering.to_global))
        self._internal, self._external = np.zeros(self.numbering.owned), np.zeros(self.numbering.owned)
        self._energy = {"kinetic": 0.0, "internal": 0.0, "external": 0.0}
        self._imbalance = 0.0

    def build(self) -> None:
        """All that depends on where the cracks are: cut cells, enriched nodes, dofs, the matrix. Collective."""
        self.__dict__.pop("_whole", None)
        with phase("cut"):
            lines = self.lines
            self.tips = find_tips(self.grid, lines, self.boundary)
            self.kappa = self._kappa_at(self.tips)
            touch = touching(self.grid, lines, self.tips)
            self.cutter = Cutter(self.grid, lines, touch, self.tips.at)
            self.radii = self._radii()
            self.enrichment = Enrichment(self.grid, lines, self.tips, self.cutter, self.choice, self.radii, self.kappa)
            self._parted = sides_of(self.cutter, len(lines.start) - 1)
            entries, functions = self.enrichment.entries, self.enrichment.functions
            self.world = World(self.grid.X, self.grid.T, entries, functions, lines, self.tips)
            count = np.diff(entries.start)
            cells = np.flatnonzero(count[self.grid.T].any(axis=1))
            acting = self.acting(cells)
            active = np.diff(acting.start) > 0
            self.cells = cells[active]
            self.acting_here = self.acting(self.cells)
            self.rule = self.cutter.rule(self.cells, self._has_tip_functions(self.acting_here))
            self.numbering = Numbering(self.grid, self.enrichment)
            self.supports = Supports(self.scene, self.body, self.grid, self.enrichment, self.world, self.numbering)
        with phase("assembly"):
            enriched = blocks(self.rule, self.acting_here, self.world, self.lam, self.mu)
            self.enriched_loads = EnrichedLoads(
                self.scene, self.grid, self.body, self.world, self.rule, self.acting_here, len(self.numbering.to_global)
            )
        self.system = System(self.numbering, self.standard, enriched, self.supports.dofs, self.space)

    def acting(self, cells: Array) -> CellEntries:
        """The entries that act in the given cells."""
        return entries_of(
            cells, self.grid.T, self.enrichment.entries, self.enrichment.functions, self.cutter.place, self._parted
        )

    def _has_tip_functions(self, acting: CellEntries) -> Array:
        """Which of the cells have functions of a tip."""
        is_tip = self.enrichment.functions.kind[self.enrichment.entries.function[acting.entry]] != JUMP
        owner = np.repeat(np.arange(len(acting.start) - 1), np.diff(acting.start))
        return np.bincount(owner[is_tip], minlength=len(acting.start) - 1) > 0

    def _kappa_at(self, tips: Tips) -> Array:
        """Kolosov's constant of the region around each tip, the same on every rank. Collective."""
        mine = [int(self.grid.region[cells_at(self.grid, at)].max(initial=-1)) for at in tips.at]
        return np.array([self._kappas[self.comm.allreduce(region, op=MPI.MAX)] for region in mine])

    def _radii(self) -> Array:
        """The radius of the enrichment of each tip, which stays off other ends, cracks and the boundary. Collective."""
        lines, out = self.lines, []
        self._cell = np.array([self._largest(self.grid.size[cells_at(self.grid, at)]) for at in self.tips.at])
        for tip, (c, at) in enumerate(zip(self.tips.crack, self.tips.at)):
            first, last = lines.start[c], lines.start[c + 1] - 1
            own = float(np.hypot(*(lines.points[last] - lines.points[first])))
            segments = [s for k in range(len(lines.start) - 1) if k != c for s in range(lines.start[k], lines.start[k + 1] - 1)]
            other = distance_to(at, np.stack([lines.points[segments], lines.points[np.array(segments, int) + 1]], axis=1))
            boundary = self.comm.allreduce(distance_to(at, self.grid.X[self.boundary]), op=MPI.MIN)
            wish = max(self.radius, LEAST_CELLS * self._cell[tip])
            out.append(min(wish, FROM_END * own, FROM_END * other, FROM_BOUNDARY * boundary))
        return np.array(out)

    def _largest(self, values: Array) -> float:
        """The largest value on any rank, 0 without one. Collective."""
        return float(self.comm.allreduce(float(values.max(initial=0.0)), op=MPI.MAX))

    # --- the step -------------------------------------------------------------------------------------------------
    def dt(self) -> float:
        return self._dt

    def step(self, dt: float) -> None:
        """Advance by dt. Raises ``Breakdown`` if the matrix is singular."""
        self._balance(self.t + dt)
        self.t += dt
        self.work["steps"] += 1

    def _force(self, t: float) -> Array:
        """The external forces at the owned dofs, in global order."""
        with phase("loads"):
            force = self.system.sum_to_owned(self.enriched_loads.external(t))
        force[: 2 * self.grid.owned] = self.loads.external(t)[: 2 * self.grid.owned]
        return force

    def _balance(self, t: float) -> None:
        """Solve for the state at t, and count the work done on the way to it."""
        force = self._force(t)
        with phase("supports"):
            values = self.supports.values(t)
        x = self.system.solve(force, values)
        internal = self.system.internal_force(x)
        owned = self.numbering.local_owned
        change = x[owned] - self.x[owned]
        # loads, and reactions where the displacement is prescribed
        external = force.copy()
        external[self.system.held_places] = internal[self.system.held_places]
        self._energy["external"] += 0.5 * self.system.dot(external + self._external, change)
        self._energy["internal"] = 0.5 * self.system.dot(internal, x[owned])
        left = internal - external
        size = np.sqrt(self.system.dot(internal, internal)) or 1.0
        self._imbalance = max(self._imbalance, float(np.sqrt(self.system.dot(left, left)) / size))
        self.x, self._internal, self._external = x, internal, external

    def grow(self, step: float) -> Array:
        """Let each tip advance by a step (m) to where the hoop stress is largest, and balance the present load anew. Collective.

        Returns the angles (tips,) to the former axes (radian). External work is counted for loads on uncracked boundary.
        """
        angles = np.array([sif.kink(*self.intensity(tip)) for tip in range(len(self.tips.at))])
        c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
        ahead = self.tips.axis
        ends = self.tips.at + step * (c * ahead + s * np.stack([-ahead[:, 1], ahead[:, 0]], axis=1))
        nodes, owned = 2 * len(self.grid.X), 2 * self.grid.owned
        u, external = self.x[:nodes], self._external[:owned]
        self.lines = extended(self.lines, self.tips, ends)
        self.build()
        self.x = np.concatenate([u, np.zeros(len(self.numbering.to_global) - nodes)])
        self._external = np.concatenate([external, np.zeros(self.numbering.owned - owned)])
        self._balance(self.t)
        return angles

    # --- what the runner asks -------------------------------------------------------------------------------------
    def probe(self, probe: Probe) -> float:
        """The sampled number of a probe; see ``Probe`` for the quantities."""
        if probe.quantity in ("KI", "KII"):
            assert probe.at is not None
            if not len(self.tips.at):
                raise Mistake(f"probe {probe.name!r}: no crack of scene {self.scene.name} ends inside a body; there is no tip")
            tip = int(np.hypot(*(self.tips.at - np.array(probe.at)).T).argmin())
            return float(self.intensity(tip)[0 if probe.quantity == "KI" else 1])
        if probe.quantity in ("displacement_error", "energy_error"):
            return self._error(probe)
        if probe.quantity == "displacement":
            assert probe.at is not None
            return float(self._at(np.array(probe.at, float))[0][probe.component])
        if probe.quantity == "stress":
            assert probe.at is not None
            return float(self._at(np.array(probe.at, float))[1][probe.component])
        if probe.quantity == "reaction":
            support = next(s for s in self.scene.supports if s.name == probe.of)
            dofs = self.supports.owned_of(support, probe.component)
            reaction = (self._internal - self._force(self.t))[dofs].sum()
            return float(self.comm.allreduce(reaction, op=MPI.SUM))
        raise Mistake(f"probe {probe.name!r}: xfem does not measure {probe.quantity!r}")

    def intensity(self, tip: int, radius: float | None = None) -> Array:
        """K_I and K_II (2,) of a tip (Pa sqrt(m)), by a ring of the given radius (m). Collective."""
        if self.t == 0.0:
            return np.zeros(2)
        ring, x = self._ring(tip, radius)
        return sif.intensity(ring, modes_at(x, self.lines, self.tips, tip, self.kappa[tip])[1], self.kappa[tip])

    def release(self, tip: int, radius: float | None = None) -> float:
        """The energy that is released per area of new crack, straight ahead of a tip (J/m2), by a ring. Collective."""
        return sif.release(self._ring(tip, radius)[0]) if self.t else 0.0

    def _ring(self, tip: int, radius: float | None) -> tuple[sif.Ring, Array]:
        """The solution on a ring around a tip, by default the largest that suits it, and the points (n, 2). Collective.

        Raises ``Mistake`` if the ring is finer than the mesh.
        """
        radius = self._ring_radius(tip) if radius is None else radius
        with phase("intensity"):
            cells, q = self.grid.around(self.tips.at[tip], radius)
            if not self._largest(q):
                raise Mistake(f"there is no node within {radius:g} m of a crack tip, where K is taken; refine the mesh")
            rule, acting = self.cutter.rule(cells, degrees=FINE), self.acting(cells)
            g = fields_at(rule, acting, self.world, self.x)[1]
            points = np.diff(rule.start)
            slope, lam, mu = (
                np.repeat(of, points, axis=0) for of in (self.grid.slope(q, cells), self.lam[cells], self.mu[cells])
            )
            return sif.Ring(self.comm, rule.w, slope, g, self.tips.axis[tip], lam, mu), rule.x

    def _ring_radius(self, tip: int) -> float:
        """The radius (m) of the ring where K is taken: its cells pass no kink of the crack, where the mesh allows that."""
        back = straight_part(self.lines, self.tips, tip) - self._cell[tip]
        return max(min(RING * self.radii[tip], back), RING_CELLS * self._cell[tip])

    @cached_property
    def _whole(self) -> tuple[Rule, CellEntries]:
        """A fine rule over all cells."""
        cells = np.arange(len(self.grid.T))
        return self.cutter.rule(cells, degrees=FINE), self.acting(cells)

    def _error(self, probe: Probe) -> float:
        """See ``displacement_error`` and ``energy_error`` of ``Probe``. Collective."""
        assert probe.exact is not None
        if self.t == 0.0:
            return 0.0
        with phase("errors"):
            rule, acting = self._whole
            u, g = fields_at(rule, acting, self.world, self.x)
            if probe.quantity == "displacement_error":
                square = ((u - probe.exact(rule.x.T, self.t).T) ** 2).sum(axis=1)
                total, area = self.comm.allreduce(np.array([rule.w @ square, rule.w.sum()]), op=MPI.SUM)
                return float(np.sqrt(total / area))
            cell = np.repeat(rule.cells, np.diff(rule.start))
            d = g - np.moveaxis(probe.exact(rule.x.T, self.t), 2, 0)
            density = 0.5 * np.einsum("nij,nij->n", sif.stress(d, self.lam[cell], self.mu[cell]), d)
            return float(np.sqrt(self.comm.allreduce(rule.w @ density, op=MPI.SUM)))

    def _at(self, x: Array) -> tuple[Array, Array]:
        """Displacement (2,) and stress (4,), as in snapshots, at a point; the + side of a crack it lies on. Collective.

        Raises ``Mistake`` if the point is in no cell.
        """
        cells = cells_at(self.grid, x)[:1]
        found = None
        if len(cells):
            rule = Rule(cells, np.array([0, 1]), x[None], np.ones(1))
            u, g = fields_at(rule, self.acting(cells), self.world, self.x)
            found = u[0], self._stress(g, cells)[0]
        for answer in self.comm.allgather(found):
            if answer is not None:
                return answer
        raise Mistake(f"the point {tuple(x.tolist())} lies outside the mesh; give a point of the body")

    def energy(self) -> dict[str, float]:
        return dict(self._energy)

    def checks(self) -> dict[str, float | None]:
        """The largest force out of balance, relative, and how far K differs between two rings: ``path``, the worst of all tips."""
        path = None
        if len(self.tips.at) and self.t:
            outer = [self.intensity(tip) for tip in range(len(self.tips.at))]
            radii = [max(INNER * self._ring_radius(t), INNER_CELLS * self._cell[t]) for t in range(len(self.tips.at))]
            inner = [self.intensity(tip, radius) for tip, radius in enumerate(radii)]
            path = max(float(np.hypot(*(a - b)) / (np.hypot(*a) or 1.0)) for a, b in zip(outer, inner))
        return {"mass": None, "momentum": self._imbalance, "volume": None, "path": path}

    def size(self) -> dict[str, int]:
        cells = self.comm.allreduce(len(self.grid.T), op=MPI.SUM)
        points = self.comm.allreduce(len(self.rule.w), op=MPI.SUM)
        return {"dofs": self.numbering.total, "cells": cells, "points": points}

    def savings(self) -> dict[str, float]:
        return {}

    def _stress(self, g: Array, cell: Array) -> Array:
        """Stress (n, 4): xx, yy, zz, xy (Pa) of displacement gradients g (n, 2, 2) in the cells (n,)."""
        sigma = sif.stress(g, self.lam[cell], self.mu[cell])
        across = self.lam[cell] * (g[:, 0, 0] + g[:, 1, 1]) * (self.scene.plane != "plane_stress")
        return np.stack([sigma[:, 0, 0], sigma[:, 1, 1], across, sigma[:, 0, 1]], axis=1)

    def _nodal(self) -> Array:
        return self.x[: 2 * len(self.grid.X)].reshape(-1, 2)

    def snapshot(self) -> dict[str, Any]:
        return picture(self.grid, self.cutter, self.world, self.x, self.acting, self._stress)

    def functions(self) -> list[fem.Function]:
        self._function.x.array[:] = self._nodal().ravel()
        return [self._function]

    @cached_property
    def _function(self) -> fem.Function:
        return fem.Function(self.space, name="displacement")

    def state(self) -> dict[str, np.ndarray]:
        """The time and the work done: a linear body without memory is solved anew when a run is resumed."""
        return {"numbers": np.array([self.t, self._energy["external"], self._imbalance, self.work["steps"]])}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        self.t, external, self._imbalance, steps = state["numbers"].tolist()
        self._balance(self.t)
        self._energy["external"], self.work["steps"] = external, int(steps)


def straight_part(lines: Lines, tips: Tips, tip: int) -> float:
    """Length (m) of the crack behind a tip up to its first kink."""
    first, last = lines.start[tips.crack[tip]], lines.start[tips.crack[tip] + 1] - 1
    points = lines.points[first : last + 1]
    if tips.point[tip] == last:
        points = points[::-1]
    behind = points[0] - points
    off = np.abs(behind[:, 0] * tips.axis[tip, 1] - behind[:, 1] * tips.axis[tip, 0])
    length = np.hypot(*behind.T)
    bent = np.flatnonzero(off > STRAIGHT * length)
    return float(length[bent[0] - 1] if len(bent) else length[-1])
