"""The material points: arrays of a scene's bodies, seeded from their shapes and kept in the order of the grid's cells."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numba import njit

from geofem.mistake import Mistake
from geofem.scene import Array, Box, Polygon, Ring, Scene, Shape

FIELDS = ("X", "x", "at", "v", "F", "tau", "state", "mass", "volume", "id")
NEIGHBOURS = 9


@dataclass
class Points:
    """N material points; those of a region lie together, from ``first[r]`` to ``first[r + 1]``.

    X, x, at, v : (N, 2) reference position, position, place on the grid (m), velocity (m/s).
    F : (N, 5) deformation gradient xx, xy, yx, yy, zz. tau : (N, 4) Kirchhoff stress xx, yy, zz, xy (Pa).
    state : (N, s) history of the material laws. mass (kg/m), volume (m2): (N,), in the reference configuration.
    id : (N,) the number that a point was born with; ``place[id]`` is where it is now.
    volume_error : relative error of the points' volume against that of the shapes.
    """

    X: Array
    x: Array
    at: Array
    v: Array
    F: Array
    tau: Array
    state: Array
    mass: Array
    volume: Array
    id: Array
    place: Array
    first: list[int]
    volume_error: float

    def sort(self, lattice: tuple[float, float, float, int, int]) -> None:
        """Put the points of every region in the order of their cells."""
        for a, b in pairwise(self.first):
            order = cell_order(self.at[a:b], lattice)
            for name in FIELDS:
                array = getattr(self, name)[a:b]
                permute(array.reshape(b - a, -1), order)
        self.place[self.id] = np.arange(len(self.id))

    def around(self, at: tuple[float, ...]) -> tuple[Array, Array]:
        """Numbers (k,) of the points nearest to a reference position and weights (k,) that extrapolate a field there.

        The weights belong to the plane that fits the nearest points of the region best (least squares), so that a linear
        field is met exactly; points as far off as the last one count too.
        """
        distance = np.linalg.norm(self.X - np.array(at), axis=1)
        r = int(np.searchsorted(self.first, np.argmin(distance), side="right")) - 1
        distance[: self.first[r]] = distance[self.first[r + 1] :] = np.inf
        reach = np.sort(distance)[min(NEIGHBOURS, self.first[r + 1] - self.first[r]) - 1]
        near = np.flatnonzero(distance <= reach * (1 + 1e-9))
        plane = np.column_stack([np.ones(len(near)), self.X[near] - np.array(at)])
        return self.id[near], np.linalg.pinv(plane, rcond=1e-9)[0]


def seed(scene: Scene, h: float, ppc: int, state: list[Array]) -> Points:
    """Material points at rest or with the scene's initial velocity, about ``ppc`` a cell in each direction.

    state : for each region the initial state (s,) of a point of its material.
    """
    parts = [fill(region.shape, h / ppc) for region in scene.regions]
    X = np.concatenate([x for x, _ in parts])
    volume = np.concatenate([v for _, v in parts])
    count = [len(v) for _, v in parts]
    N = len(X)
    history = np.zeros((N, max(len(s) for s in state)))
    first = np.concatenate([[0], np.cumsum(count)]).tolist()
    for (a, b), s in zip(pairwise(first), state, strict=True):
        history[a:b, : len(s)] = s
    v = np.zeros((N, 2)) if scene.initial_velocity is None else np.asarray(scene.initial_velocity(X.T), float).T
    exact = sum(area(region.shape) for region in scene.regions)
    return Points(
        X=X,
        x=X.copy(),
        at=X.copy(),
        v=np.array(np.broadcast_to(v, (N, 2)), order="C"),
        F=np.tile([1.0, 0.0, 0.0, 1.0, 1.0], (N, 1)),
        tau=np.zeros((N, 4)),
        state=history,
        mass=volume * np.repeat([region.material.density for region in scene.regions], count),
        volume=volume,
        id=np.arange(N),
        place=np.arange(N),
        first=first,
        volume_error=float(volume.sum() / exact - 1.0),
    )


def fill(shape: Shape, spacing: float) -> tuple[Array, Array]:
    """Points (n, 2) and their volumes (n,) that fill a shape at about a spacing (m).

    A box is divided evenly, and a ring into layers and these into sectors, so that the volumes add up to the shape's own; of
    a polygon those cells of a lattice are taken whose centre lies inside.
    """
    if isinstance(shape, Ring):
        layers = max(1, round((shape.outer - shape.inner) / spacing))
        places, volumes = [], []
        for a, b in pairwise(np.linspace(shape.inner, shape.outer, layers + 1)):
            sectors = max(3, round(np.pi * (a + b) / spacing))
            angle = 2 * np.pi * (np.arange(sectors) + 0.5) / sectors
            r = 2 / 3 * (b**3 - a**3) / (b**2 - a**2)  # the middle of the sector's mass
            places.append(np.array(shape.centre) + r * np.column_stack([np.cos(angle), np.sin(angle)]))
            volumes.append(np.full(sectors, np.pi * (b**2 - a**2) / sectors))
        return np.concatenate(places), np.concatenate(volumes)
    assert isinstance(shape, (Box, Polygon))
    low, high = np.array(shape.bounds)
    count = np.maximum(1, np.round((high - low) / spacing)).astype(int)
    size = (high - low) / count
    if isinstance(shape, Polygon):
        size = np.full(2, spacing)
        count = np.ceil((high - low) / spacing - 1e-9).astype(int)
    axes = [low[c] + size[c] * (np.arange(count[c]) + 0.5) for c in range(2)]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    if isinstance(shape, Polygon):
        x = x[shape.contains(x.T)]
        if not len(x):
            raise Mistake(
                f"Polygon at {shape.points[0]}: thinner than the spacing of the points, {spacing:g} m; raise n or ppc"
            )
    return x, np.full(len(x), size.prod())


def area(shape: Shape) -> float:
    """The area of a shape (m2)."""
    if isinstance(shape, Ring):
        return float(np.pi * (shape.outer**2 - shape.inner**2))
    if isinstance(shape, Polygon):
        x, y = np.array(shape.points).T
        return float(0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    low, high = np.array(shape.bounds)  # type: ignore[union-attr]
    return float(np.prod(high - low))


@njit(cache=True)
def cells(at: Any, lattice: Any) -> Any:
    """The cell (N,) of every point: the number of its low node."""
    x0, y0, per_h, _, ny = lattice
    cell = np.empty(len(at), np.int64)
    for p in range(len(at)):
        cell[p] = int((at[p, 0] - x0) * per_h) * ny + int((at[p, 1] - y0) * per_h)
    return cell


@njit(cache=True)
def cell_order(at: Any, lattice: Any) -> Any:
    """The order (N,) of the points by cell; points of one cell keep theirs (counting sort)."""
    cell = cells(at, lattice)
    start = np.zeros(lattice[3] * lattice[4] + 1, np.int64)
    for c in cell:
        start[c + 1] += 1
    start = np.cumsum(start)
    order = np.empty(len(cell), np.int64)
    for p in range(len(cell)):
        order[start[cell[p]]] = p
        start[cell[p]] += 1
    return order


@njit(cache=True)
def permute(rows: Any, order: Any) -> None:
    """Put the rows of an array in a new order, in place."""
    old = rows.copy()
    for p in range(len(order)):
        for k in range(rows.shape[1]):
            rows[p, k] = old[order[p], k]
