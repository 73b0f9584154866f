"""A linear elastic body with cracks at given places, solved on a mesh that knows nothing of them."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from mpi4py import MPI

from geofem.core import intensity as sif
from geofem.core.conditions import Loads
from geofem.core.neartip import point_force
from geofem.cost import phase
from geofem.methods.xfem.basis import World, blocks, fields_at
from geofem.methods.xfem.contact import Contact
from geofem.methods.xfem.enrichment import JUMP, CellEntries, Enrichment, TipChoice, entries_of
from geofem.methods.xfem.faces import faces_of, pieces
from geofem.methods.xfem.fields import modes_at
from geofem.methods.xfem.geometry import Lines, Tips, cells_at, distance_to, find_tips, touching
from geofem.methods.xfem.intact import Intact
from geofem.methods.xfem.junctions import network, sectors_of
from geofem.methods.xfem.loads import EnrichedLoads, body_force
from geofem.methods.xfem.picture import picture
from geofem.methods.xfem.rules import Cutter, Degrees, Rule
from geofem.methods.xfem.supports import Supports
from geofem.methods.xfem.system import Numbering, System
from geofem.mistake import Mistake
from geofem.scene import Array, Scene

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


class Cracked:
    """A body with its cracks: cut cells, enriched nodes, dofs, the matrix, and the solution under the loads of a time. Made collectively.

    Parameters
    ----------
    scene : for its supports and loads. loads : on the standard dofs. choice : how tips are enriched, None for jumps only.
    radius : of the enrichment around a tip (m).
    """

    def __init__(self, intact: Intact, scene: Scene, loads: Loads, lines: Lines, choice: TipChoice | None, radius: float):
        self.intact, self.scene, self.loads, self.radius = intact, scene, loads, radius
        self.comm, self.grid, self.lam, self.mu = intact.comm, intact.grid, intact.lam, intact.mu
        with phase("cut"):
            self.lines = lines = network(lines)
            self.sectors = sectors_of(lines)
            self.tips = find_tips(self.grid, lines, self.sectors.joined, intact.boundary)
            self.kappa = self._kappa_at(self.tips)
            touch = touching(self.grid, lines, self.tips)
            self.cutter = Cutter(self.grid, lines, touch, self.tips.at)
            self.radii = self._radii()
            self.enrichment = Enrichment(self.grid, self.sectors, self.tips, self.cutter, choice, self.radii, self.kappa)
            entries, functions = self.enrichment.entries, self.enrichment.functions
            self.world = World(self.grid.X, self.grid.T, entries, functions, lines, self.sectors, self.tips)
            count = np.diff(entries.start)
            cells = np.flatnonzero(count[self.grid.T].any(axis=1))
            acting = self.acting(cells)
            active = np.diff(acting.start) > 0
            cells = cells[active]
            acting = self.acting(cells)
            self.rule = self.cutter.rule(cells, self._has_tip_functions(acting))
            self.numbering = Numbering(self.grid, self.enrichment)
            along, segment = pieces(lines, self.tips.point, touch, self.grid.X, self.grid.T)
            self.faces = faces_of(along, segment, self.acting(along.cells), self.world, len(self.numbering.to_global))
            self.supports = Supports(scene, intact.body, self.grid, self.enrichment, self.world, self.numbering)
        with phase("assembly"):
            enriched = blocks(self.rule, acting, self.world, self.lam, self.mu)
            self.enriched_loads = EnrichedLoads(
                scene, self.grid, intact.body, self.world, self.rule, acting, len(self.numbering.to_global)
            )
            self.contact = self._contact()
        springs = self.contact.springs() if self.contact else None
        self.system = System(self.numbering, intact.standard, enriched, self.supports.dofs, intact.space, springs)
        if self.contact:
            with phase("contact"):
                self.contact.prepare(self.system, len(self.supports.dofs))
        self.x = np.zeros(len(self.numbering.to_global))
        self.internal, self.external = np.zeros(self.numbering.owned), np.zeros(self.numbering.owned)
        self.imbalance, self._strain_energy, self._size = 0.0, 0.0, 0.0
        self.t: float | None = None  # no solution yet
        self.traction = np.zeros((len(self.faces.crack), 2))

    def destroy(self) -> None:
        """Free the matrices and communicators. Collective."""
        self.system.destroy()

    def _contact(self) -> Contact | None:
        """The tractions between faces that feel each other, if there are any in the body. Collective."""
        cracks = {c: crack for c, crack in enumerate(self.scene.cracks) if crack.friction is not None or crack.cohesion}
        here = float(np.isin(self.faces.crack, list(cracks)).any())
        if not self._largest(np.array([here])):
            return None
        # E' = 8 mu / (kappa + 1)
        modulus = 8.0 * self._largest(self.mu) / (float(self.intact.kappas.min()) + 1.0)
        return Contact(self.faces, cracks, self.grid.size, modulus, self.numbering, self.comm)

    def acting(self, cells: Array) -> CellEntries:
        """The entries that act in the given cells."""
        return entries_of(
            cells, self.grid.T, self.enrichment.entries, self.enrichment.functions, self.cutter.place, self.enrichment.parted
        )

    def _has_tip_functions(self, acting: CellEntries) -> Array:
        """Which of the cells have functions of a tip."""
        is_tip = self.enrichment.functions.kind[self.enrichment.entries.function[acting.entry]] != JUMP
        owner = np.repeat(np.arange(len(acting.start) - 1), np.diff(acting.start))
        return np.bincount(owner[is_tip], minlength=len(acting.start) - 1) > 0

    def _kappa_at(self, tips: Tips) -> Array:
        """Kolosov's constant of the region around each tip, the same on every rank. Collective."""
        mine = [int(self.grid.region[cells_at(self.grid, at)].max(initial=-1)) for at in tips.at]
        return np.array([self.intact.kappas[self.comm.allreduce(region, op=MPI.MAX)] for region in mine])

    def _radii(self) -> Array:
        """The radius of the enrichment of each tip, which stays off other ends, cracks and the boundary. Collective."""
        lines, out = self.lines, []
        self.cell = np.array([self._largest(self.grid.size[cells_at(self.grid, at)]) for at in self.tips.at])
        for tip, (c, at) in enumerate(zip(self.tips.crack, self.tips.at)):
            first, last = lines.start[c], lines.start[c + 1] - 1
            own = float(np.hypot(*(lines.points[last] - lines.points[first])))
            segments = [s for k in range(len(lines.start) - 1) if k != c for s in range(lines.start[k], lines.start[k + 1] - 1)]
            other = distance_to(at, np.stack([lines.points[segments], lines.points[np.array(segments, int) + 1]], axis=1))
            boundary = self.comm.allreduce(distance_to(at, self.grid.X[self.intact.boundary]), op=MPI.MIN)
            wish = max(self.radius, LEAST_CELLS * self.cell[tip])
            out.append(min(wish, FROM_END * own, FROM_END * other, FROM_BOUNDARY * boundary))
        return np.array(out)

    def _largest(self, values: Array) -> float:
        """The largest value on any rank, 0 without one. Collective."""
        return float(self.comm.allreduce(float(values.max(initial=0.0)), op=MPI.MAX))

    # --- the solution ---------------------------------------------------------------------------------------------
    def force(self, t: float) -> Array:
        """The external forces at the owned dofs, in global order."""
        with phase("loads"):
            local = self.enriched_loads.external(t) + self.faces.force(self.pressure(t))
            force = self.system.sum_to_owned(local)
        force[: 2 * self.grid.owned] += self.loads.external(t)[: 2 * self.grid.owned]
        return force

    def pressure(self, t: float) -> Array:
        """The traction of fluids on the + faces, normal and along (n, 2), Pa."""
        out = np.zeros((len(self.faces.crack), 2))
        for c, crack in enumerate(self.scene.cracks):
            if crack.pressure is not None:
                here = self.faces.crack == c
                out[here, 0] = crack.pressure(self.faces.rule.x[here].T, t)
        return out

    def solve(self, t: float) -> None:
        """Balance the loads and supports of time t. Raises ``Breakdown`` if the matrix is singular. Collective.

        x : local dofs. internal, external : forces at owned dofs; external ones are loads, and reactions where the
        displacement is prescribed. imbalance : their difference relative to the
        largest so far. traction : on the + faces (n, 2), Pa. Raises also
        where the faces of cracks find no balance.
        """
        self.__dict__.pop("factors", None)
        force = self.force(t)
        self.t, self.traction = t, self.pressure(t)
        with phase("supports"):
            values = self.supports.values(t)
        owned = self.numbering.local_owned
        if self.contact:
            with phase("contact"):
                self.x = self.contact.solve(self.system, force, values)
                held = self.contact.force(self.contact.traction)
                elastic = self.system.internal_force(self.x) - self.contact.spring_force(self.x[owned])
            self.traction -= self.contact.at_points()
            self.internal = elastic + held
        else:
            self.x = self.system.solve(force, values)
            self.internal = elastic = self.system.internal_force(self.x)
        self._strain_energy = 0.5 * self.system.dot(elastic, self.x[owned])
        self.external = force
        self.external[self.system.held_places] = self.internal[self.system.held_places]
        left = self.internal - self.external
        # a body that has come apart bears nothing any more
        self._size = max(self._size, float(np.sqrt(self.system.dot(self.internal, self.internal))))
        self.imbalance = float(np.sqrt(self.system.dot(left, left))) / (self._size or 1.0)

    def strain_energy(self) -> float:
        """Strain energy (J)."""
        return self._strain_energy

    @cached_property
    def factors(self) -> tuple[Array, Array]:
        """K_I and K_II (tips, 2), Pa sqrt(m), and J (tips,), J/m2, of all tips, once a solution. Collective."""
        tips = range(len(self.tips.at))
        K = np.array([self.intensity(tip) for tip in tips]).reshape(-1, 2)
        return K, np.array([self.release(tip) for tip in tips])

    def intensity(self, tip: int, radius: float | None = None) -> Array:
        """K_I and K_II (2,) of a tip (Pa sqrt(m)), by a ring of the given radius (m). Collective."""
        ring, x, q = self._ring(tip, radius)
        forces, there = self._forces(q)
        kappa = self.kappa[tip]
        modes, others = (modes_at(points, self.lines, self.tips, tip, kappa)[1] for points in (x, there))
        return sif.intensity(ring, modes, kappa, forces, others)

    def release(self, tip: int, radius: float | None = None) -> float:
        """The energy that is released per area of new crack, straight ahead of a tip (J/m2), by a ring. Collective."""
        ring, _, q = self._ring(tip, radius)
        return sif.release(ring, self._forces(q)[0])

    def tension(self, tip: int, radius: float | None = None) -> float:
        """The regular stress along the axis at a tip, T (Pa), by a ring. Collective."""
        ring, x, q = self._ring(tip, radius)
        forces, there = self._forces(q)
        at, axis, kappa = self.tips.at[tip], self.tips.axis[tip], self.kappa[tip]
        point, other = (point_force(points, at, axis, kappa) for points in (x, there))
        return sif.tension(ring, point, kappa, forces, other, self._nearest(at, self.traction[:, 0]))

    def opening(self, x: Array) -> float:
        """The opening (m) of the crack at the point of its rule nearest to a point (2,). Collective."""
        return self._nearest(x, self.faces.jumps(self.x)[:, 0])

    def overlap(self) -> float:
        """The largest overlap of faces as a part of the length of their crack within the body. Collective."""
        faces, worst = self.faces, 0.0
        opening = faces.jumps(self.x)[:, 0]
        for c in range(len(self.lines.start) - 1):
            here = faces.crack == c
            length = self.comm.allreduce(float(faces.rule.w[here].sum()), op=MPI.SUM)
            worst = max(worst, self._largest(-opening[here]) / (length or 1.0))
        return worst

    def _nearest(self, x: Array, values: Array) -> float:
        """Of values (n,) at the points of the faces of all ranks, the one nearest to x (2,); 0 without any. Collective."""
        distance = np.hypot(*(self.faces.rule.x - x).T)
        k = int(distance.argmin()) if len(distance) else -1
        mine = (float(distance[k]), float(values[k])) if k >= 0 else (np.inf, 0.0)
        return min(self.comm.allgather(mine))[1]

    def _forces(self, q: Array) -> tuple[sif.Forces, Array]:
        """What acts on the body inside a ring, on the faces and by mass, and at which points (n, 2); q : nodal weights."""
        faces, grid = self.faces, self.grid
        parts = [(*sif.NONE, np.empty((0, 2)))]
        for sign in (1.0, -1.0) if self.traction.any() else ():
            rule = faces.on_side(sign, grid.size)
            g = fields_at(rule, self.acting(rule.cells), self.world, self.x)[1]
            inside = grid.linear(q, np.repeat(rule.cells, np.diff(rule.start)), rule.x)
            inside[~self.traction.any(axis=1)] = 0.0
            parts.append((rule.w * inside, sign * faces.vectors(self.traction), g, rule.x))
        if self.t is not None and any(load.kind in ("gravity", "body") for load in self.scene.loads):
            cells = np.flatnonzero(q[grid.T].any(axis=1))
            rule, acting = self.cutter.rule(cells, degrees=FINE), self.acting(cells)
            g = fields_at(rule, acting, self.world, self.x)[1]
            cells = np.repeat(cells, np.diff(rule.start))
            f = body_force(self.scene, self.enriched_loads.density[cells], rule.x, self.t)
            parts.append((rule.w * grid.linear(q, cells, rule.x), f, g, rule.x))
        w, f, g, x = (np.concatenate(part) for part in zip(*parts))
        acts = w != 0.0
        return sif.Forces(w[acts], f[acts], g[acts]), x[acts]

    def _ring(self, tip: int, radius: float | None) -> tuple[sif.Ring, Array, Array]:
        """The solution on a ring around a tip, by default the largest that suits it, its points (n, 2) and nodal weights. Collective.

        Raises ``Mistake`` if the ring is finer than the mesh.
        """
        radius = self.ring_radius(tip) if radius is None else radius
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
            return sif.Ring(self.comm, rule.w, slope, g, self.tips.axis[tip], lam, mu), rule.x, q

    def ring_radius(self, tip: int) -> float:
        """The radius (m) of the ring where K is taken: its cells pass no kink of the crack, where the mesh allows that."""
        back = straight_part(self.lines, self.tips, tip) - self.cell[tip]
        return max(min(RING * self.radii[tip], back), RING_CELLS * self.cell[tip])

    @cached_property
    def whole(self) -> tuple[Rule, CellEntries]:
        """A fine rule over all cells."""
        cells = np.arange(len(self.grid.T))
        return self.cutter.rule(cells, degrees=FINE), self.acting(cells)

    def at(self, x: Array) -> tuple[Array, Array]:
        """Displacement (2,) and stress (4,), as in snapshots, at a point; the + side of a crack it lies on. Collective.

        Raises ``Mistake`` if the point is in no cell.
        """
        cells = cells_at(self.grid, x)[:1]
        found = None
        if len(cells):
            rule = Rule(cells, np.array([0, 1]), x[None], np.ones(1))
            u, g = fields_at(rule, self.acting(cells), self.world, self.x)
            found = u[0], self.stress(g, cells)[0]
        for answer in self.comm.allgather(found):
            if answer is not None:
                return answer
        raise Mistake(f"the point {tuple(x.tolist())} lies outside the mesh; give a point of the body")

    def stress(self, g: Array, cell: Array) -> Array:
        """Stress (n, 4): xx, yy, zz, xy (Pa) of displacement gradients g (n, 2, 2) in the cells (n,)."""
        sigma = sif.stress(g, self.lam[cell], self.mu[cell])
        across = self.lam[cell] * (g[:, 0, 0] + g[:, 1, 1]) * (self.intact.plane != "plane_stress")
        return np.stack([sigma[:, 0, 0], sigma[:, 1, 1], across, sigma[:, 0, 1]], axis=1)

    def nodal(self) -> Array:
        """The displacement of the nodes (nodes, 2), m; those on a crack move with its + side."""
        return self.x[: 2 * len(self.grid.X)].reshape(-1, 2)

    def snapshot(self) -> dict[str, Any]:
        """See ``geofem.methods.Model.snapshot``. Collective."""
        return picture(self.grid, self.cutter, self.world, self.x, self.acting, self.stress)


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
