"""The background grid: a lattice of square or cubic cells, and what happens on its nodes in a step.

A rank keeps the nodes of its own cells and of a halo around them, in rows along the last axis. In the loops below a lattice in
the plane is one in space whose middle axis has a single node.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from geofem.materials.kinematics import FLAGS
from geofem.methods.mpm.deeds import MASS, VELOCITY
from geofem.methods.mpm.shapes import Shape
from geofem.mistake import Mistake
from geofem.scene import Array, MeshFile, Scene

OPTIONS = {"nogil": True, "cache": True, **FLAGS}


COLUMNS = {2: 8, 3: 12}
"""Columns per node: a cache line in the plane."""

# Sums over one step: kinetic energy and largest squared speed of the points after it; work (without that of the stresses), work
# of the stresses; absolute nodal forces out of balance, and absolute reactions (N); impulse (N s).
KINETIC, SPEED2, WORK, STRAIN_WORK, UNBALANCE, REACTIONS, IMPULSE, SUMS = 0, 1, 2, 3, 4, 5, 6, 9
# Marks of one step: a fault and the point that has it; the box of nodes that the points reach, first and last of each axis.
FAULT, POINT, BOX, MARKS = 0, 1, 2, 8
TANGLED, ESCAPED, FOLDED = 1, 2, 3
FAR = 1 << 40
ALIKE = 1.0 + 1e-9
"""Masses nearer to each other than this are equal, so that rounding, and with it the number of threads, decides on nothing."""


@dataclass
class Grid:
    """Lattice of ``shape`` nodes, spacing ``h`` (m), from ``low`` (m), with ``pad`` nodes beyond the room on every side.

    nodes : (n, columns) of the window of rows ``first`` ... ``last`` (exclusive) along x, made anew every step.
    own : rows whose nodes this rank counts in sums.
    """

    low: Array
    h: float
    shape: tuple[int, ...]
    pad: int
    nodes: Array
    first: int
    own: tuple[int, int]

    @property
    def dim(self) -> int:
        return len(self.shape)

    @property
    def lattice(self) -> tuple[float, float, float, float, int, int, int, int, int]:
        """What the loops of a shape need: the low corner, cells per metre, nodes along each axis, first row's number, pad."""
        low, shape = [*self.low, 0.0][:3], [*self.shape, 1][:3]
        return (*map(float, low), 1.0 / self.h, *shape, self.first * int(np.prod(self.shape[1:])), self.pad)  # type: ignore[return-value]

    @property
    def rows(self) -> tuple[int, int, int]:
        """Nodes along the middle and the last axis, and the number of the window's first node."""
        middle, last = (1, self.shape[1]) if self.dim == 2 else self.shape[1:]
        return middle, last, self.first * middle * last

    def box(self, marks: Array) -> tuple[int, int, int, int, int, int]:
        """The nodes that the points reach: first and end of the three axes of a loop."""
        i0, i1, j0, j1, k0, k1 = (int(value) for value in marks[BOX : BOX + 6])
        if self.dim == 2:
            return i0, i1 + 1, 0, 1, j0, j1 + 1
        return i0, i1 + 1, j0, j1 + 1, k0, k1 + 1

    def coordinates(self) -> Array:
        """Positions (dim, n) of the nodes of the window."""
        last = self.first + len(self.nodes) // int(np.prod(self.shape[1:]))
        axes = [self.low[c] + self.h * np.arange(self.shape[c]) for c in range(self.dim)]
        axes[0] = axes[0][self.first : last]
        return np.stack(np.meshgrid(*axes, indexing="ij")).reshape(self.dim, -1)


def bodies(scene: Scene, bounds: list[tuple[Array, Array]]) -> tuple[Array, Array]:
    """The box around all bodies; bounds : of each region."""
    low, high = (np.min([b[0] for b in bounds], axis=0), np.max([b[1] for b in bounds], axis=0))
    return low, high


def make_grid(scene: Scene, h: float, shape: Shape, bounds: list[tuple[Array, Array]]) -> Grid:
    """The whole grid of a scene, without its nodes' values, with the low corner of the bodies on a node.

    It covers the room of the scene, or the bodies and two cells around them. Raises ``Mistake`` where a body leaves the room.
    """
    low, high = bodies(scene, bounds)
    room = (np.array(scene.room.low), np.array(scene.room.high)) if scene.room else (low - 2 * h, high + 2 * h)
    if np.any(low < room[0] - 1e-9 * h) or np.any(high > room[1] + 1e-9 * h):
        raise Mistake(f"scene {scene.name}: its bodies reach beyond its room, {scene.room}; enlarge the room")
    pad = shape.pad
    below = np.ceil((low - room[0]) / h - 1e-9).astype(int) + pad
    above = np.ceil((room[1] - low) / h - 1e-9).astype(int) + pad
    counts = tuple(int(n) for n in below + above + 1)
    return Grid(low - below * h, h, counts, pad, np.empty((0, 0)), 0, (0, counts[0]))


def on_edges(coordinates: Array, bounds: list[tuple[Array, Array]], h: float) -> Array:
    """Coordinates within rounding of a body's bounds put on them, so that a support's ``x[0] >= 4`` finds the nodes there."""
    for edges in bounds:
        for edge in edges:
            for x, value in zip(coordinates, edge):
                x[np.abs(x - value) < 1e-9 * h] = value
    return coordinates


def shape_bounds(scene: Scene) -> list[tuple[Array, Array]] | None:
    """Bounds of the regions' shapes; None where a mesh file has yet to be read."""
    if any(isinstance(region.shape, MeshFile) for region in scene.regions):
        return None
    return [tuple(np.array(corner) for corner in region.shape.bounds) for region in scene.regions]  # type: ignore[union-attr,misc]


# --- loops over the nodes of a box ------------------------------------------------------------------------------------------
@njit(**OPTIONS)
def clear(nodes: Any, first: int, end: int, box: Any, rows: Any) -> None:
    middle, last, base = rows
    for i in range(box[0], box[1]):
        for j in range(box[2], box[3]):
            start = (i * middle + j) * last - base
            for n in range(start + box[4], start + box[5]):
                for c in range(first, end):
                    nodes[n, c] = 0.0


@njit(**OPTIONS)
def add_grid(nodes: Any, others: Any, box: Any, rows: Any, first: int, end: int) -> None:
    """Add the columns first ... end of another grid; that one is cleared."""
    middle, last, base = rows
    for i in range(box[0], box[1]):
        for j in range(box[2], box[3]):
            start = (i * middle + j) * last - base
            for n in range(start + box[4], start + box[5]):
                for k in range(first, end):
                    nodes[n, k] += others[n, k]
                    others[n, k] = 0.0


@njit(**OPTIONS)
def to_velocity(nodes: Any, momentum: int, velocity: int, dim: int, box: Any, rows: Any, least_mass: float) -> None:
    """Divide the momentum by the mass; both arguments name the first of the columns."""
    middle, last, base = rows
    for i in range(box[0], box[1]):
        for j in range(box[2], box[3]):
            start = (i * middle + j) * last - base
            for n in range(start + box[4], start + box[5]):
                m = nodes[n, MASS]
                per_m = 1.0 / m if m > least_mass else 0.0
                for c in range(dim):
                    nodes[n, velocity + c] = per_m * nodes[n, momentum + c]


@njit(**OPTIONS)
def accelerate(
    nodes: Any, dim: int, box: Any, rows: Any, own: Any, least_mass: float, dt: float, ratio: float, gravity: Any, damping: float,
    sums: Any,
) -> None:  # fmt: skip
    """Forces to accelerations a, momenta to velocities v + dt a; sums over the nodes of the rank's own rows.

    ratio : of the time from the middle of the last step to that of this one, for which the forces act, to dt; a is scaled by it.
    damping : share of the out-of-balance force that acts against the velocity (local damping, Cundall 1987).
    """
    middle, last, base = rows
    for i in range(box[0], box[1]):
        mine = own[0] <= i < own[1]
        work, unbalance = 0.0, 0.0
        for j in range(box[2], box[3]):
            start = (i * middle + j) * last - base
            for n in range(start + box[4], start + box[5]):
                m = nodes[n, MASS]
                if m > least_mass:
                    per_m = 1.0 / m
                    for c in range(dim):
                        v = per_m * nodes[n, VELOCITY + c]
                        a = ratio * (per_m * nodes[n, VELOCITY + dim + c] + gravity[c])
                        unbalance += m * abs(a)
                        if damping > 0.0:
                            drag = damping * abs(a) * np.sign(v)
                            a -= drag
                            if mine:
                                sums[IMPULSE + c] -= dt * m * drag
                        v += dt * a
                        nodes[n, VELOCITY + c], nodes[n, VELOCITY + dim + c] = v, a
                        work += m * gravity[c] * v
                        if mine:
                            sums[IMPULSE + c] += ratio * dt * m * gravity[c]
                else:
                    for c in range(2 * dim):
                        nodes[n, VELOCITY + c] = 0.0
        if mine:
            sums[WORK] += dt * work
            sums[UNBALANCE] += unbalance


@njit(**OPTIONS)
def merge_small(nodes: Any, dim: int, box: Any, rows: Any, small: float, partner: Any, lent: Any) -> int:
    """Lend mass, momentum and force of nodes lighter than ``small`` to their heaviest neighbour; returns how many.

    What such a node is given its share of the body does not carry: its acceleration would be without bound, and to cut it off
    would lose momentum. Joined to a neighbour both move as one (cell aggregation; Badia, Verdugo & Martin 2018 for cut cells).
    partner (n, 2) : the pairs; lent (n,) : their masses.
    """
    middle, last, base = rows
    count = 0
    for i in range(box[0], box[1]):
        for j in range(box[2], box[3]):
            for k in range(box[4], box[5]):
                n = (i * middle + j) * last + k - base
                m = nodes[n, MASS]
                if 0.0 < m < small:
                    best, most = n, m
                    for a in range(max(i - 1, box[0]), min(i + 2, box[1])):
                        for b in range(max(j - 1, box[2]), min(j + 2, box[3])):
                            for c in range(max(k - 1, box[4]), min(k + 2, box[5])):
                                other = (a * middle + b) * last + c - base
                                if nodes[other, MASS] > ALIKE * most:
                                    best, most = other, nodes[other, MASS]
                    if most >= small and count < partner.shape[0]:
                        partner[count, 0], partner[count, 1] = n, best
                        count += 1
    for q in range(count):
        n, best = partner[q, 0], partner[q, 1]
        lent[q] = nodes[n, MASS]
        for c in range(1 + 2 * dim):
            nodes[best, c] += nodes[n, c]
            nodes[n, c] = 0.0
    return count


@njit(**OPTIONS)
def part_again(nodes: Any, dim: int, partner: Any, lent: Any, count: int) -> None:
    """Give the light nodes their mass back, and the velocity and acceleration that they have together with their neighbour."""
    for q in range(count):
        n, best = partner[q, 0], partner[q, 1]
        nodes[n, MASS] = lent[q]
        nodes[best, MASS] -= lent[q]
        for c in range(VELOCITY, VELOCITY + 2 * dim):
            nodes[n, c] = nodes[best, c]


@njit(**OPTIONS)
def gained(nodes: Any, dim: int, box: Any, rows: Any, own: Any, dt: float) -> float:
    """What the kinetic energy of the nodes of the rank's own rows gained in the last step, of dt (J)."""
    middle, last, base = rows
    total = 0.0
    for i in range(max(box[0], own[0]), min(box[1], own[1])):
        for j in range(box[2], box[3]):
            start = (i * middle + j) * last - base
            for n in range(start + box[4], start + box[5]):
                for c in range(dim):
                    a = nodes[n, VELOCITY + dim + c]
                    total += nodes[n, MASS] * a * dt * (nodes[n, VELOCITY + c] - 0.5 * dt * a)
    return total
