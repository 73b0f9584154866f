"""What stops the nodes of the grid: supports, which prescribe velocities, and walls, which only stop and rub."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from geofem.methods.mpm import grid as g
from geofem.methods.mpm.deeds import MASS, VELOCITY
from geofem.methods.mpm.grid import OPTIONS
from geofem.scene import Array, Scene, Support


class Held:
    """The nodal components that the supports prescribe, one after the other.

    arrays : nodes, components (k,), their velocity (m/s), the force (N) on the body that this took in the last step, and whether the
    node is of this rank's own rows.
    """

    def __init__(self, scene: Scene, coordinates: Array, mine: Array):
        nodes, components = [np.empty(0, int)], [np.empty(0, int)]
        self.parts: list[tuple[Support, slice, Array]] = []
        start = 0
        for support in scene.supports:
            assert callable(support.where)
            found = np.flatnonzero(support.where(coordinates))
            for c in support.components:
                nodes.append(found)
                components.append(np.full(len(found), c))
                self.parts.append((support, slice(start, start + len(found)), coordinates[:, found]))
                start += len(found)
        held = np.concatenate(nodes)
        self.arrays = held, np.concatenate(components), np.zeros(start), np.zeros(start), mine[held]

    def follow(self, t0: float, t1: float, dt: float) -> None:
        """The velocity that takes the supports in dt (s) to their place at the scene's time t1 from that at t0."""
        for support, part, x in self.parts:
            if support.value is not None:
                self.arrays[2][part] = (support.value(x, t1) - support.value(x, t0)) / dt

    def reaction(self, name: str, component: int) -> float:
        """The force (N) that a support exerted on the body in the last step, at this rank's own nodes."""
        nodes, components, _, reaction, mine = self.arrays
        found = (part for support, part, _ in self.parts if support.name == name)
        return float(sum(np.sum((reaction * mine)[part][components[part] == component]) for part in found))


class Walls:
    """The nodes of the walls, one wall after the other.

    arrays : nodes (k,), axis of the normal (k,), its sign (k,), friction (k,), the force (N) on the body in the last step (k, d), and
    whether the node is of this rank's own rows.
    """

    def __init__(self, scene: Scene, coordinates: Array, mine: Array):
        self.names = [wall.name for wall in scene.walls]
        nodes = [np.flatnonzero(wall.where(coordinates)) for wall in scene.walls]
        counts = [len(found) for found in nodes]
        self.first = np.concatenate([[0], np.cumsum(counts)]).astype(int)
        axis = [int(np.argmax(np.abs(wall.normal))) for wall in scene.walls]
        sign = [float(sum(wall.normal)) for wall in scene.walls]
        friction = [min(wall.friction, 1e300) for wall in scene.walls]
        found = np.concatenate(nodes) if nodes else np.empty(0, int)
        self.arrays = (found, np.repeat(axis, counts).astype(int), np.repeat(sign, counts).astype(float),
                       np.repeat(friction, counts).astype(float), np.zeros((len(found), scene.gdim)), mine[found])  # fmt: skip

    def reaction(self, name: str, component: int) -> float:
        """The force (N) that a wall exerted on the bodies in the last step, at this rank's own nodes."""
        if name not in self.names:
            return 0.0
        k = self.names.index(name)
        part = slice(self.first[k], self.first[k + 1])
        return float(np.sum(self.arrays[4][part, component] * self.arrays[5][part]))


@njit(**OPTIONS)
def hold(
    nodes: Any, dim: int, held: Any, least_mass: float, dt: float, ratio: float, gravity: Any, damping: float, sums: Any
) -> None:
    """Give the held nodes their velocity after ``accelerate``; the reaction is the force that this takes without damping."""
    places, components, velocity, reaction, mine = held
    for k in range(len(places)):
        n, c = places[k], components[k]
        m = nodes[n, MASS]
        reaction[k] = 0.0
        a, free = nodes[n, VELOCITY + dim + c], nodes[n, VELOCITY + c]
        v = free - dt * a
        nodes[n, VELOCITY + c] = velocity[k]
        nodes[n, VELOCITY + dim + c] = (velocity[k] - v) / dt if m > least_mass else 0.0
        if m > least_mass:
            undamped = a / (1.0 - damping * np.sign(a) * np.sign(v))
            reaction[k] = m * ((velocity[k] - v) / dt - undamped) / ratio
            if mine[k]:
                sums[g.UNBALANCE] -= m * abs(undamped)
                sums[g.REACTIONS] += abs(reaction[k])
                sums[g.WORK] += dt * (reaction[k] * velocity[k] + m * gravity[c] * (velocity[k] - free))
                sums[g.IMPULSE + c] += m * (velocity[k] - free)


@njit(**OPTIONS)
def stop(nodes: Any, dim: int, walls: Any, least_mass: float, dt: float, ratio: float, gravity: Any, sums: Any) -> None:
    """Take from the nodes of walls the velocity into the wall, and by Coulomb's law some of that along it, after ``accelerate``.

    All work is that of forces on the velocity after the step, as that of the stresses is: a node that rests on a wall takes none.
    """
    places, axes, signs, friction, reaction, mine = walls
    for k in range(len(places)):
        n, axis = places[k], axes[k]
        m = nodes[n, MASS]
        reaction[k, :] = 0.0
        into = -signs[k] * nodes[n, VELOCITY + axis]
        if m > least_mass and into > 0.0:
            square = 0.0
            for c in range(dim):
                if c != axis:
                    square += nodes[n, VELOCITY + c] ** 2
            along = math.sqrt(square)
            kept = max(0.0, 1.0 - friction[k] * into / along) if along > 0.0 else 0.0
            for c in range(dim):
                old = nodes[n, VELOCITY + c]
                new = 0.0 if c == axis else kept * old
                change = new - old
                nodes[n, VELOCITY + c] = new
                nodes[n, VELOCITY + dim + c] += change / dt
                reaction[k, c] = m * change / (ratio * dt)
                if mine[k]:
                    sums[g.IMPULSE + c] += m * change
                    sums[g.REACTIONS] += abs(reaction[k, c])
                    sums[g.UNBALANCE] -= abs(reaction[k, c])
                    sums[g.WORK] += m * change * (new / ratio + dt * gravity[c])


@njit(**OPTIONS)
def set_velocity(nodes: Any, first: int, held: Any, walls: Any, dim: int) -> None:
    """What supports and walls make of velocities in the columns from ``first`` on that no force belongs to."""
    places, components, velocity, _, _ = held
    for k in range(len(places)):
        nodes[places[k], first + components[k]] = velocity[k]
    places, axes, signs, friction, _, _ = walls
    for k in range(len(places)):
        n, axis = places[k], axes[k]
        if signs[k] * nodes[n, first + axis] < 0.0:
            nodes[n, first + axis] = 0.0
            if friction[k] >= 1e300:
                for c in range(dim):
                    nodes[n, first + c] = 0.0
