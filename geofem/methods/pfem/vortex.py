"""What a field on cells loses on its way from one tessellation to the next, as numbers for a map: carried round by a vortex."""

from __future__ import annotations

import math

import numpy as np

from geofem.methods.pfem.tessellation import simplices
from geofem.methods.pfem.tessellation.backends import delaunay
from geofem.methods.pfem.transfer import averaged, copied
from geofem.scene import Array

TURN = 2.0
"""The time of one turn about the middle of the box, in which the velocity's gradient is pi."""
COURANT = 0.4
"""Spacings of nodes that the fastest node goes in a step."""
SPOT, RADIUS = (0.5, 0.3), 0.1
"""Where the field starts as a Gaussian bell, and its radius."""


def velocity(x: Array) -> Array:
    """Of a steady vortex in the unit box, without divergence, along its sides (n, 2)."""
    (sx, sy), (cx, cy) = np.sin(np.pi * x).T, np.cos(np.pi * x).T
    return np.column_stack([sx * cy, -cx * sy])


def cloud(n: int) -> Array:
    """Nodes of a lattice of n cells a side, those inside shaken."""
    x = np.stack(np.meshgrid(*2 * [np.linspace(0, 1, n + 1)]), axis=-1).reshape(-1, 2)
    inside = np.all((x > 0) & (x < 1), axis=1)
    x[inside] += np.random.default_rng(0).uniform(-0.2, 0.2, (inside.sum(), 2)) / n
    return x


def moved(x: Array, dt: float) -> Array:
    """A step along the velocity by the midpoint rule."""
    return x + dt * velocity(x + 0.5 * dt * velocity(x))


def turned(method: str, *, turns: float, way: str = "copied", n: int = 40) -> dict[str, float]:
    """By which part the ``peak`` of the field is off, its relative root mean square ``error``, part of cells ``changed`` in a step.

    way : ``copied`` or ``averaged``. n : cells along a side of the box; all nodes are tessellated anew in each step.
    """
    steps = max(1, math.ceil(turns * TURN * n / COURANT))
    dt = turns * TURN / steps
    x = cloud(n)
    bell = np.exp(-np.sum((x - SPOT) ** 2, axis=1) / RADIUS**2)
    cells = delaunay(x)
    values, changed = bell[cells].mean(axis=1), 0.0
    for _ in range(steps):
        x = moved(x, dt)
        new = delaunay(x)
        parents = simplices.parents(new, cells)
        if way == "copied":
            values = copied(values, parents, x[cells].mean(axis=1), x[new].mean(axis=1))
        else:
            values = averaged(values, cells, np.abs(simplices.volumes(x, cells)), new, len(x))
        changed += float(np.mean(parents < 0)) / steps
        cells = new
    exact = bell[cells].mean(axis=1)
    return {
        "peak": abs(1.0 - float(values.max() / exact.max())),
        "error": float(np.linalg.norm(values - exact) / np.linalg.norm(exact)),
        "changed": changed,
    }
