"""The classical wall: a row of particles that do not move, to which the fluid sticks; with the same interface as ``Obstacles``."""

from __future__ import annotations

import numpy as np

from geofem.methods.pfem.budget import Budget
from geofem.methods.pfem.cloud import Cloud
from geofem.methods.pfem.contact import Convex, Inflow, Outflow, Plane, Touch, planes_of
from geofem.methods.pfem.tessellation import Tessellation
from geofem.methods.pfem.tessellation.common import finished
from geofem.mistake import Mistake
from geofem.scene import Array, Scene

OFF = 0.05
"""Nearer to the wall than that, by its size, no node of the fluid comes."""
ON = 1e-6
"""Within that, by its size, a node lies on the wall."""


class WallParticles:
    """Walls of a plane scene as particles, ``fixed`` among the cloud's fields; nodes of the first mesh on a wall are such."""

    def __init__(self, scene: Scene, cloud: Cloud):
        openings = scene.inlets or scene.outlets
        if scene.gdim != 2 or scene.rigids or scene.supports or openings or not scene.walls or scene.room is None:
            raise Mistake(f"knob walls = 'fixed': scene {scene.name} must have walls only, in the plane, and a room; use slide")
        self.planes = planes_of(scene.walls, scene, cloud)
        self.rigids: list[Convex] = []
        self.inlets: list[Inflow] = []
        self.outlets: list[Outflow] = []
        self.names = [plane.name for plane in self.planes]
        near = np.zeros(cloud.n, bool)
        rows = []
        for plane in self.planes:
            near |= np.abs(plane.reach(cloud.x)[0]) < ON * cloud.size
            rows.append(self._row(scene, cloud, plane))
        cloud.fields["fixed"] = near.astype(float)
        where = np.concatenate(rows)
        for at in where:
            if np.linalg.norm(cloud.x - at, axis=1).min() > 0.5 * cloud.size[0]:
                new = cloud.add(np.zeros((1, 1), np.int64), np.ones((1, 1)))
                cloud.x[new], cloud.X[new], cloud.v[new], cloud.p[new] = at, at, 0.0, 0.0
                cloud.fields["fixed"][new] = 1.0

    def _row(self, scene: Scene, cloud: Cloud, plane: Plane) -> Array:
        """Places (k, 2) along one wall, as far as the room goes."""
        assert scene.room is not None
        axis, place = plane.axis, plane.place
        along = 1 - axis
        low, high = scene.room.low[along], scene.room.high[along]
        steps = max(round((high - low) / float(cloud.size[0])), 1)
        out = np.empty((steps + 1, 2))
        out[:, axis], out[:, along] = place, np.linspace(low, high, steps + 1)
        return out

    def follow(self, t: float, dt: float) -> None:
        """They do not move."""

    def held(self, cloud: Cloud) -> Array:
        """(n, 1) bool."""
        return (cloud.fields["fixed"] > 0.5)[:, None]

    def touch(self, cloud: Cloud, *, outlets: bool = False) -> Touch:
        """Particles of the wall are held in all directions, by the wall nearest; in a corner by both."""
        n, gdim = cloud.x.shape
        fixed = self.held(cloud)[:, 0]
        away = np.abs([plane.reach(cloud.x)[0] for plane in self.planes])
        nearest = away.argmin(axis=0)
        obstacle = np.where(fixed[:, None] & (np.arange(gdim) == 0), nearest[:, None], -1)
        normals = np.zeros((n, gdim, gdim))
        normals[:, 0] = np.array([plane.normal for plane in self.planes])[nearest]
        normals[:, 1] = normals[:, 0, ::-1] * [-1.0, 1.0]
        for o, plane in enumerate(self.planes):
            second = fixed & (nearest != o) & (away[o] < ON * cloud.size)
            obstacle[second, 1], normals[second, 1] = o, plane.normal
        normals[~fixed] = 0.0
        return Touch(normals, np.zeros((n, gdim)), np.zeros((n, gdim, gdim)), np.where(obstacle >= 0, np.inf, 0.0), obstacle)

    def clip(self, cloud: Cloud, cells: Array, budget: Budget) -> None:
        """Keep the fluid's nodes a little off the walls, and stop what moves into them; booked as ``wall``."""
        free = ~self.held(cloud)[:, 0]
        for plane in self.planes:
            distance, normals = plane.reach(cloud.x)
            near = free & (distance < OFF * cloud.size)
            cloud.x[near] += (OFF * cloud.size[near] - distance[near])[:, None] * normals[near]
            into = np.minimum(np.einsum("nd,nd->n", cloud.v[near], normals[near]), 0.0)
            cloud.v[near] -= into[:, None] * normals[near]
        budget.book("wall", budget.look(cloud, cells))

    def release(self, cloud: Cloud, force: Array, cells: Array, budget: Budget) -> None:
        """They never let go."""


def beside_walls(made: Tessellation, cloud: Cloud) -> Tessellation:
    """The tessellation without the cells that have particles of the wall only."""
    kept = ~(cloud.fields["fixed"] > 0.5)[made.cells].all(axis=1)
    return finished(made.cells[kept], None)
