"""The forces of loads on enriched dofs, and of pressures; else those on standard dofs are the ones of a mesh without cracks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from geofem.core.mesh import Body, facets
from geofem.materials.kinematics import kernel
from geofem.methods.xfem.basis import World, dofs_of, enriched, hat_gradients, hats, scratch, widest_of
from geofem.methods.xfem.enrichment import CellEntries
from geofem.methods.xfem.geometry import cracks_of
from geofem.methods.xfem.grid import Grid, boundary_edges
from geofem.methods.xfem.rules import Rule
from geofem.methods.xfem.supports import crossings
from geofem.scene import Array, Load, Scene

POINTS = 8
"""Gauss points on each part of a loaded edge: functions of a tip are no polynomials."""


class Acting(NamedTuple):
    """A load on enriched dofs: where it is integrated, the entries there, and for dead loads the forces themselves."""

    load: Load
    rule: Rule
    acting: CellEntries
    density: Array
    dead: Array | None


class EnrichedLoads:
    """The loads of a scene on the enriched dofs of this rank's cells, and pressures on the standard ones too.

    rule, acting : over the enriched cells. body : for the facets of tractions. local : number of local dofs.
    density : (cells,) kg/m3.
    """

    def __init__(self, scene: Scene, grid: Grid, body: Body, world: World, rule: Rule, acting: CellEntries, local: int):
        self.scene, self.world, self.local = scene, world, local
        self.density = np.array([region.material.density for region in scene.regions])[grid.region]
        inside = np.repeat(self.density[rule.cells], np.diff(rule.start))
        self._parts: list[Acting] = []
        place = np.full(len(grid.T), -1, np.int64)
        place[rule.cells] = np.arange(len(rule.cells))
        for load in scene.loads:
            if load.kind == "body":
                self._parts.append(Acting(load, rule, acting, inside, None))
            elif load.kind == "gravity":
                value = np.asarray(load.value, float)[:2] * inside[:, None]
                self._parts.append(Acting(load, rule, acting, inside, forces(rule, acting, world, value, local)))
            elif load.where is not None:
                found = facets(body, load.where, load.kind)
                edges, cells = boundary_edges(grid, found), grid.cells_of_facets(found)
                chosen = place[cells] >= 0
                along = edge_rule(edges[chosen], cells[chosen], world)
                here = rows_of(acting, place[cells[chosen]])
                if load.kind == "pressure":
                    out, length = outward(edges, cells, grid)
                    density = -load.value * out
                else:
                    density = np.tile(np.asarray(load.value, float)[:2], (len(edges), 1))
                dead = forces(along, here, world, np.repeat(density[chosen], np.diff(along.start), axis=0), local)
                if load.kind == "pressure":
                    for end in edges.T:
                        np.add.at(dead[: 2 * len(grid.X)].reshape(-1, 2), end, 0.5 * length[:, None] * density)
                self._parts.append(Acting(load, along, here, np.ones(0), dead))

    def external(self, t: float) -> Array:
        """Forces at all local dofs, not yet summed over ranks; at standard ones only those of pressures."""
        total = np.zeros(self.local)
        for part in self._parts:
            factor = self.scene.amplitude(part.load, t)
            if part.dead is not None:
                total += factor * part.dead
            else:
                value = np.asarray(part.load.value(part.rule.x.T, t)).T * part.density[:, None]
                total += factor * forces(part.rule, part.acting, self.world, value, self.local)
        return total


def body_force(scene: Scene, density: Array, x: Array, t: float) -> Array:
    """The force of mass (n, 2), N/m3, of all loads at points x (n, 2) of the given density (n,), kg/m3."""
    total = np.zeros((len(x), 2))
    for load in scene.loads:
        if load.kind == "gravity":
            total += scene.amplitude(load, t) * np.asarray(load.value, float)[:2]
        elif load.kind == "body":
            total += scene.amplitude(load, t) * np.asarray(load.value(x.T, t)).T
    return total * density[:, None]


def rows_of(acting: CellEntries, rows: Array) -> CellEntries:
    """The entries of some of the cells, in the given order."""
    pieces = [np.arange(acting.start[k], acting.start[k + 1]) for k in rows]
    index = np.concatenate([np.empty(0, np.int64), *pieces])
    start = np.concatenate([[0], np.cumsum([len(piece) for piece in pieces], dtype=np.int64)])
    return CellEntries(start, acting.vertex[index], acting.entry[index])


def outward(edges: Array, cells: Array, grid: Grid) -> tuple[Array, Array]:
    """The unit normals (k, 2) of boundary edges (k, 2), out of their cells (k,), and their lengths (k,), m."""
    along = grid.X[edges[:, 1]] - grid.X[edges[:, 0]]
    length = np.hypot(*along.T)
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1) / length[:, None]
    inward = grid.X[grid.T[cells]].mean(axis=1) - grid.X[edges[:, 0]]
    return np.where(np.einsum("ki,ki->k", normal, inward)[:, None] > 0.0, -normal, normal), length


def edge_rule(edges: Array, cells: Array, world: World) -> Rule:
    """A rule along edges (k, 2) of the cells (k,), in parts between the cracks that cut them; weights are lengths (m)."""
    gauss, weight = np.polynomial.legendre.leggauss(POINTS)
    start, x, w = [0], [np.empty((0, 2))], [np.empty(0)]
    cracks = cracks_of(world.lines)
    for i, j in edges.tolist():
        a, b = world.X[i], world.X[j]
        cuts = [0.0, 1.0]
        for crack in cracks:
            cuts += crossings(a, b, crack)
        ends = np.unique(cuts)
        t = (0.5 * (ends[1:] + ends[:-1])[:, None] + 0.5 * np.diff(ends)[:, None] * gauss).ravel()
        x.append(a + t[:, None] * (b - a))
        w.append((0.5 * np.diff(ends)[:, None] * weight).ravel() * np.hypot(*(b - a)))
        start.append(start[-1] + len(t))
    return Rule(cells, np.array(start, np.int64), np.concatenate(x), np.concatenate(w))


@kernel
def forces(rule: Rule, acting: CellEntries, world: World, f: Array, local: int) -> Array:
    """The integral of f (points, 2) times the enriched basis functions, at all local dofs."""
    out = np.zeros(local)
    widest = widest_of(acting, world)
    V, G = np.empty((widest, 2)), np.empty((widest, 2, 2))
    dofs = np.empty(widest + 6, np.int64)
    s = scratch()
    for k in range(rule.cells.shape[0]):
        cell = rule.cells[k]
        n = dofs_of(k, cell, acting, world, dofs)
        hat_gradients(cell, world, s.dN)
        for q in range(rule.start[k], rule.start[k + 1]):
            hats(rule.x[q, 0], rule.x[q, 1], cell, world, s)
            enriched(rule.x[q, 0], rule.x[q, 1], k, acting, world, s, V, G)
            for a in range(6, n):
                out[dofs[a]] += rule.w[q] * (V[a - 6, 0] * f[q, 0] + V[a - 6, 1] * f[q, 1])
    return out
