"""The body as it is drawn: cells that a crack touches in the triangles they are cut into, so that the crack is seen open."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from geofem.methods.xfem.basis import World, fields_at
from geofem.methods.xfem.enrichment import CellEntries
from geofem.methods.xfem.grid import Grid
from geofem.methods.xfem.rules import FAR, Cutter, Rule
from geofem.scene import Array

PULL = 1e-6
"""Corners of triangles are asked for their displacement this part of the way to the middle, on their own side of the crack."""


def picture(
    grid: Grid, cutter: Cutter, world: World, x: Array,
    acting: Callable[[Array], CellEntries], stress: Callable[[Array, Array], Array],
) -> dict[str, Any]:  # fmt: skip
    """Deformed ``points``, ``cells``, ``cell``, ``displacement`` and ``stress`` of all ranks on rank 0, {} elsewhere. Collective.

    x : local dofs. acting : cells -> the entries that act in them. stress : gradients (n, 2, 2) and their cells -> (n, 4), Pa.
    """
    touched = cutter.touch.cells
    whole = np.setdiff1d(np.arange(len(grid.T)), touched)
    middle = Rule(whole, np.arange(len(whole) + 1), grid.X[grid.T[whole]].mean(axis=1), grid.area[whole])
    sigma = [stress(fields_at(middle, acting(whole), world, x)[1], whole)]
    triangles = cutter.triangles(touched, np.full(len(touched), FAR))
    owner = np.repeat(touched, np.diff(triangles.start))
    centre = triangles.corners.mean(axis=1)
    here = acting(touched)
    sigma.append(stress(fields_at(Rule(touched, triangles.start, centre, np.ones(len(centre))), here, world, x)[1], owner))
    corners = triangles.corners.reshape(-1, 2)
    asked = corners + PULL * (np.repeat(centre, 3, axis=0) - corners)
    moved = fields_at(Rule(touched, 3 * triangles.start, asked, np.ones(len(asked))), here, world, x)[0]
    nodes = len(grid.X)
    u = np.concatenate([x[: 2 * nodes].reshape(-1, 2), moved])
    cells = np.concatenate([grid.T[whole], nodes + np.arange(len(corners)).reshape(-1, 3)])
    parts = grid.comm.gather((np.concatenate([grid.X, corners]), u, cells, np.concatenate(sigma)))
    if parts is None:
        return {}
    offsets = np.cumsum([0] + [len(part[0]) for part in parts])
    displacement = np.concatenate([part[1] for part in parts])
    points = np.zeros((len(displacement), 3))
    points[:, :2] = np.concatenate([part[0] for part in parts]) + displacement
    return {
        "points": points,
        "cells": np.concatenate([part[2] + offset for part, offset in zip(parts, offsets)]),
        "cell": "triangle",
        "displacement": displacement,
        "stress": np.concatenate([part[3] for part in parts]),
    }
