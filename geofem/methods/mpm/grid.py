"""The background grid: a lattice of square cells, its nodes in rows along y, and what happens on them in a step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from geofem.scene import Array, Scene, Support

FAST = {"fastmath": {"contract", "nsz", "arcp", "reassoc"}, "error_model": "numpy"}

# Columns of the grid; a node fills a cache line. V: momentum, then velocity; A: force, then acceleration; W: the
# velocity behind the strains where that is not V.
MASS, VX, VY, AX, AY, WX, WY, COLUMNS = 0, 1, 2, 3, 4, 5, 6, 8
# Sums over one step: kinetic energy and largest squared speed of the points after it; work and impulse of all that is
# not internal; work of the stresses; absolute nodal forces out of balance, and absolute reactions (N).
KINETIC, SPEED2, WORK, IMPULSE_X, IMPULSE_Y, STRAIN_WORK, UNBALANCE, REACTIONS, SUMS = 0, 1, 2, 3, 4, 5, 6, 7, 8
# Marks of one step: points that changed cell; the box of cells that hold points; a fault and the point that has it.
CROSSED, I0, I1, J0, J1, FAULT, POINT, MARKS = 0, 1, 2, 3, 4, 5, 6, 7
TANGLED, ESCAPED = 1, 2
FAR = 1 << 40


@dataclass
class Grid:
    """Lattice of ``shape`` nodes, spacing ``h`` (m), from ``low`` (m); ``nodes`` (n, COLUMNS) is made anew every step."""

    low: Array
    h: float
    shape: tuple[int, int]
    nodes: Array

    @property
    def lattice(self) -> tuple[float, float, float, int, int]:
        """What the kernels need: the low corner, cells per metre, nodes along x and along y."""
        return float(self.low[0]), float(self.low[1]), 1.0 / self.h, self.shape[0], self.shape[1]


class Held:
    """The nodal components that the supports prescribe, one after the other.

    arrays : nodes, components (k,), their velocity (m/s), and the force (N) on the body that this took in the last step.
    """

    def __init__(self, scene: Scene, coordinates: Array):
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
        self.arrays = np.concatenate(nodes), np.concatenate(components), np.zeros(start), np.zeros(start)

    def follow(self, t0: float, t1: float, dt: float) -> None:
        """The velocity that takes the supports in dt (s) to their place at the scene's time t1 from that at t0."""
        for support, part, x in self.parts:
            if support.value is not None:
                self.arrays[2][part] = (support.value(x, t1) - support.value(x, t0)) / dt

    def reaction(self, name: str, component: int) -> float:
        """The force (N) that a support exerted on the body in the last step."""
        found = (part for support, part, _ in self.parts if support.name == name)
        return float(sum(np.sum(self.arrays[3][part][self.arrays[1][part] == component]) for part in found))


def make_grid(scene: Scene, h: float) -> tuple[Grid, Array]:
    """The grid of a scene with the low corner of the bodies on a node, and its nodes' coordinates (2, n).

    It covers the room of the scene, or the bodies and two cells around them. Coordinates within rounding of a body's
    bounds are put on them, so that a support's ``x[0] >= 4`` finds the nodes there.
    """
    bounds = np.array([region.shape.bounds for region in scene.regions])  # type: ignore[union-attr]
    body = bounds[:, 0].min(0), bounds[:, 1].max(0)
    room = (np.array(scene.room.low), np.array(scene.room.high)) if scene.room else (body[0] - 2 * h, body[1] + 2 * h)
    below = np.ceil((body[0] - room[0]) / h - 1e-9).astype(int)
    above = np.ceil((room[1] - body[0]) / h - 1e-9).astype(int)
    axes = []
    for c in range(2):
        x = body[0][c] + h * np.arange(-below[c], above[c] + 1)
        for edge in bounds[:, :, c].ravel():
            x[np.abs(x - edge) < 1e-9 * h] = edge
        axes.append(x)
    shape = len(axes[0]), len(axes[1])
    coordinates = np.stack(np.meshgrid(*axes, indexing="ij")).reshape(2, -1)
    nodes = np.zeros((shape[0] * shape[1], COLUMNS))
    return Grid(body[0] - below * h, h, shape, nodes), coordinates


@njit(cache=True, **FAST)
def clear(grid: Any, box: Any, ny: int) -> None:
    for i in range(box[0], box[1]):
        for n in range(i * ny + box[2], i * ny + box[3]):
            for k in range(COLUMNS):
                grid[n, k] = 0.0


@njit(cache=True, **FAST)
def momentum_to_velocity(grid: Any, momentum: int, velocity: int, box: Any, ny: int, least_mass: float) -> None:
    """Divide the momentum by the mass; both arguments name the first of two columns."""
    for i in range(box[0], box[1]):
        for n in range(i * ny + box[2], i * ny + box[3]):
            m = grid[n, MASS]
            per_m = 1.0 / m if m > least_mass else 0.0
            grid[n, velocity] = per_m * grid[n, momentum]
            grid[n, velocity + 1] = per_m * grid[n, momentum + 1]


@njit(cache=True, **FAST)
def accelerate(grid: Any, box: Any, ny: int, least_mass: float, dt: float, gravity: Any, damping: float, sums: Any) -> None:
    """Forces to accelerations a, and velocities v to v + dt a.

    damping : share of the out-of-balance force that acts against the velocity (local damping, Cundall 1987).
    """
    work = impulse_x = impulse_y = unbalance = 0.0
    gx, gy = gravity
    for i in range(box[0], box[1]):
        for n in range(i * ny + box[2], i * ny + box[3]):
            m = grid[n, MASS]
            if m > least_mass:
                vx, vy = grid[n, VX], grid[n, VY]
                ax, ay = grid[n, AX] / m + gx, grid[n, AY] / m + gy
                unbalance += m * (abs(ax) + abs(ay))
                if damping > 0.0:
                    dx, dy = damping * abs(ax) * np.sign(vx), damping * abs(ay) * np.sign(vy)
                    ax -= dx
                    ay -= dy
                    impulse_x -= m * dx
                    impulse_y -= m * dy
                vx += dt * ax
                vy += dt * ay
                grid[n, VX], grid[n, VY], grid[n, AX], grid[n, AY] = vx, vy, ax, ay
                work += m * (gx * vx + gy * vy)
                impulse_x += m * gx
                impulse_y += m * gy
            else:
                grid[n, AX] = grid[n, AY] = 0.0
    sums[WORK] += dt * work
    sums[IMPULSE_X] += dt * impulse_x
    sums[IMPULSE_Y] += dt * impulse_y
    sums[UNBALANCE] = unbalance


@njit(cache=True, **FAST)
def hold(grid: Any, held: Any, least_mass: float, dt: float, gravity: Any, damping: float, sums: Any) -> None:
    """Give the held nodes their velocity after ``accelerate``; the reaction is the force that this takes without damping."""
    nodes, components, velocity, reaction = held
    for k in range(len(nodes)):
        n, c = nodes[k], components[k]
        m = grid[n, MASS]
        reaction[k] = 0.0
        if m > least_mass:
            a, free = grid[n, AX + c], grid[n, VX + c]
            v = free - dt * a
            undamped = a / (1.0 - damping * np.sign(a) * np.sign(v))
            grid[n, VX + c] = velocity[k]
            grid[n, AX + c] = (velocity[k] - v) / dt
            reaction[k] = m * ((velocity[k] - v) / dt - undamped)
            sums[UNBALANCE] -= m * abs(undamped)
            sums[REACTIONS] += abs(reaction[k])
            sums[WORK] += dt * (reaction[k] * velocity[k] + m * gravity[c] * (velocity[k] - free))
            sums[IMPULSE_X + c] += m * (velocity[k] - free)


@njit(cache=True, **FAST)
def set_velocity(grid: Any, first: int, held: Any) -> None:
    nodes, components, velocity, _ = held
    for k in range(len(nodes)):
        grid[nodes[k], first + components[k]] = velocity[k]
