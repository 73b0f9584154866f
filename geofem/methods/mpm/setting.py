"""How a scene becomes bodies on a grid, which cells their points are in, and how the ranks divide, gather and scatter them."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from geofem import materials
from geofem.methods.mpm import grid as g
from geofem.methods.mpm import parallel
from geofem.methods.mpm.kind import Kind
from geofem.methods.mpm.points import KEPT, Body
from geofem.methods.mpm.seed import Seeds, fill_all
from geofem.methods.mpm.shapes import SHAPES
from geofem.scene import Array, Scene

Bounds = list[tuple[Array, Array]]


def make_bodies(scene: Scene, kind: Kind, h: float, ppc: int) -> tuple[g.Grid, list[Body], list[Seeds], Bounds]:
    """The grid of a scene, without its nodes' values, and the points of every region, all of them on every rank."""
    shape = SHAPES[kind.shape]
    seeds = fill_all(scene, h / ppc, kind.axial)
    bounds = g.shape_bounds(scene) or [s.bounds for s in seeds]
    grid = g.make_grid(scene, h, shape, bounds)
    bodies = []
    for region, filled in zip(scene.regions, seeds, strict=True):
        law = materials.get(region.material.law)
        par = law.parameters(region.material, scene.weakening(0.0) if scene.weakening is not None else 1.0)
        bodies.append(Body(filled, region.material, par, kind, shape.domain, h, len(scene.rigids)))
    return grid, bodies, seeds, bounds


def rows_of(body: Body, grid: g.Grid) -> Array:
    """The cell along x of each own point."""
    at = body.own("X" if body.kind.small else "x")
    return ((at[:, 0] - grid.low[0]) * (1.0 / grid.h)).astype(np.int64)


def cells_of(body: Body, grid: g.Grid) -> Array:
    """The number of the cell of each own point: that of its low node on the whole lattice."""
    at = body.own("X" if body.kind.small else "x")
    number = np.zeros(body.n, np.int64)
    for c, count in enumerate(grid.shape):
        number = number * count + ((at[:, c] - grid.low[c]) * (1.0 / grid.h)).astype(np.int64)
    return number


def divide(comm: MPI.Intracomm, grid: g.Grid, bodies: list[Body], halo: int) -> tuple[parallel.Slabs, int]:
    """Cut the grid into slabs of as many points each, and keep the points of this rank's; returns where its window ends."""
    for body in bodies:
        body.sort(cells_of(body, grid))
    rows = [rows_of(body, grid) for body in bodies]
    slabs = parallel.make_slabs(comm, np.concatenate(rows), grid.shape[0] - 1, halo)
    if comm.size == 1:
        return slabs, grid.shape[0]
    for body, row in zip(bodies, rows):
        body.remove(slabs.owner(row) != comm.rank)
    grid.first, last = slabs.window(grid.shape[0])
    low, high = slabs.own
    grid.own = low, high if comm.rank < comm.size - 1 else high + 1
    return slabs, last


def gather(comm: MPI.Intracomm, bodies: list[Body]) -> dict[str, Array]:
    """All points of all bodies for a checkpoint; empty but on rank 0. Collective."""
    out: dict[str, Array] = {}
    for k, body in enumerate(bodies):
        fields = parallel.gathered(comm, body)
        if fields is not None:
            out |= {f"{name}_{k}": values for name, values in fields.items()}
    return out


def scatter(state: dict[str, Array], bodies: list[Body], grid: g.Grid, slabs: parallel.Slabs) -> None:
    """Take up what ``gather`` gave, each rank its own points."""
    for k, body in enumerate(bodies):
        body.n = body.N = 0
        body.add({name: state[f"{name}_{k}"] for name in KEPT}, own=True)
        if slabs.comm.size > 1:
            body.remove(slabs.owner(rows_of(body, grid)) != slabs.comm.rank)
        order = np.argsort(body.own("key"), kind="stable")
        for name in KEPT:
            body.own(name)[:] = body.own(name)[order]
        body.make_room(body.N)
        body.settle()
