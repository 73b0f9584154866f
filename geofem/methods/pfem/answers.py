"""What a run asks of nodes: probes, pictures and checkpoints."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from geofem.core.sampling import quantile
from geofem.methods.pfem.budget import Amount, Budget
from geofem.methods.pfem.cloud import Cloud
from geofem.methods.pfem.contact import Touch
from geofem.mistake import Mistake
from geofem.scene import Array, Probe, Scene


class Places:
    """The material points that a scene's probes ask for: the nodes of the cell that held them at the start, and weights."""

    def __init__(self, scene: Scene, cloud: Cloud, cells: Array):
        self.at: dict[tuple[float, ...], tuple[Array, Array]] = {}
        for probe in scene.probes:
            if probe.at is not None and probe.at not in self.at:
                self.at[probe.at] = self._around(probe, cloud, cells)

    def _around(self, probe: Probe, cloud: Cloud, cells: Array) -> tuple[Array, Array]:
        corner = cloud.X[cells]
        edge = (corner[:, 1:] - corner[:, :1]).transpose(0, 2, 1)
        inner = np.linalg.solve(edge, (np.array(probe.at) - corner[:, 0])[:, :, None])[:, :, 0]
        weights = np.column_stack([1.0 - inner.sum(axis=1), inner])
        cell = int(np.argmax(weights.min(axis=1)))
        if weights[cell].min() < -1e-6:
            raise Mistake(f"probe {probe.name!r}: the point {probe.at} lies outside the mesh; give a point of the body")
        return cloud.id[cells[cell]], weights[cell]

    def value(self, at: tuple[float, ...], cloud: Cloud, field: Array) -> float:
        """A nodal field (n,) at a material point; where its nodes were removed, that of the node nearest in the reference."""
        ids, weights = self.at[at]
        order = np.argsort(cloud.id)
        place = order[np.minimum(np.searchsorted(cloud.id, ids, sorter=order), cloud.n - 1)]
        if np.array_equal(cloud.id[place], ids):
            return float(weights @ field[place])
        return float(field[np.argmin(np.linalg.norm(cloud.X - np.array(at), axis=1))])

    def probe(self, probe: Probe, cloud: Cloud, weight: Array, t: float, stress: Array) -> float:
        """The value of a probe that fluids and solids have; weight (n,): masses or volumes, stress (n, 6) at the nodes (Pa)."""
        c = probe.component
        if probe.quantity == "largest_speed":
            return float(np.linalg.norm(cloud.v, axis=1).max())
        if probe.quantity == "quantile":
            return quantile(cloud.x[:, c], weight, probe.share)
        if probe.quantity == "mean_velocity":
            return float(weight @ cloud.v[:, c] / weight.sum())
        if probe.quantity in ("displacement_error", "velocity_error"):
            assert probe.exact is not None
            moved = probe.quantity == "displacement_error"
            found, at = (cloud.x - cloud.X, cloud.X) if moved else (cloud.v, cloud.x)
            error = np.sum((found - probe.exact(at.T, t).T) ** 2, axis=1)
            return math.sqrt(weight @ error / weight.sum())
        assert probe.at is not None
        fields = {"displacement": cloud.x - cloud.X, "velocity": cloud.v, "stress": stress}
        return self.value(probe.at, cloud, fields[probe.quantity][:, c])


def reactions(touch: Touch, count: int, force: Array) -> Array:
    """Forces (count, gdim) that obstacles exert on the nodes (N); a node in a corner shares its force (n, gdim) by the normals."""
    total = np.zeros((count, force.shape[1]))
    for row in range(touch.obstacle.shape[1]):
        who = touch.obstacle[:, row] >= 0
        shared, normal = who & (touch.count > 1), touch.normals[:, row]
        part = np.where(shared[:, None], np.einsum("ni,ni->n", force, normal)[:, None] * normal, force)
        np.add.at(total, touch.obstacle[who, row], part[who])
    return total


def surface(x: Array, facets: Array) -> float:
    """Length (m) or area (m2) of all boundary facets."""
    a = x[facets[:, 1]] - x[facets[:, 0]]
    if x.shape[1] == 2:
        return float(np.linalg.norm(a, axis=1).sum())
    return 0.5 * float(np.linalg.norm(np.cross(a, x[facets[:, 2]] - x[facets[:, 0]]), axis=1).sum())


def snapshot(cloud: Cloud, cells: Array, outlines: list[Array]) -> dict[str, Any]:
    """Nodes and cells for pictures, and the outlines (k, 2) of rigid bodies."""
    n, gdim = cloud.x.shape
    points = np.zeros((n, 3))
    points[:, :gdim] = cloud.x
    out: dict[str, Any] = {
        "points": points, "cells": cells, "cell": "triangle" if gdim == 2 else "tetra", "displacement": cloud.x - cloud.X,
        "velocity": cloud.v,
    }  # fmt: skip
    if outlines:
        gap = np.full((1, 2), np.nan)
        out["rigid"] = np.concatenate([part for o in outlines for part in (o, o[:1], gap)][:-1])
    return out


# --- checkpoints ------------------------------------------------------------------------------------------------------
def cloud_state(cloud: Cloud) -> dict[str, Array]:
    """All that a cloud is."""
    out = {f"cloud_{name}": getattr(cloud, name) for name in Cloud.NAMES}
    return out | {f"field_{name}": values for name, values in cloud.fields.items()} | {"next_id": np.array(cloud.next_id)}


def restore_cloud(cloud: Cloud, state: dict[str, Array]) -> None:
    for name in Cloud.NAMES:
        setattr(cloud, name, state[f"cloud_{name}"].copy())
    cloud.fields = {name.removeprefix("field_"): values.copy() for name, values in state.items() if name.startswith("field_")}
    cloud.next_id = int(state["next_id"])


def budget_state(budget: Budget) -> dict[str, Array]:
    """All that a budget is."""
    rows = [[a.volume, *a.momentum, a.kinetic, a.potential] for a in budget.of.values()]
    return {"budget": np.array(rows), "owed": budget.owed, "jolted": np.array(budget.jolted)}


def restore_budget(budget: Budget, state: dict[str, Array]) -> None:
    for name, row in zip(budget.of, state["budget"]):
        budget.of[name] = Amount(float(row[0]), row[1:-2].copy(), float(row[-2]), float(row[-1]))
    budget.owed = state["owed"].copy()
    budget.jolted = bool(state["jolted"])
