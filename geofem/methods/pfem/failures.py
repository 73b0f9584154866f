"""What goes wrong where the method is misused, as numbers for the maps."""

from __future__ import annotations

from typing import Any

import numpy as np

from geofem import methods, scenes
from geofem.methods.pfem.cloud import Cloud
from geofem.methods.pfem.fluid_model import FluidModel
from geofem.methods.pfem.tessellation import simplices, slivers
from geofem.methods.pfem.tessellation.alpha import AlphaShape
from geofem.methods.pfem.tessellation.inside import InsideBody
from geofem.scene import Array, Scene
from geofem.scenes import sloshing
from geofem.scenes.dam_break import SETUPS

FLAT = 0.1
"""A tetrahedron of a lower quality is a sliver."""
UPRIGHTS = (1.25, 1.5, 1.75)
"""Where the flow along the floor is looked at, in widths of the column."""


def built(scene: Scene, **knobs: Any) -> FluidModel:
    model = methods.get("pfem").build(scene, **knobs)
    assert isinstance(model, FluidModel)
    return model


def checkerboard(method: str, *, stabilisation: float = 1.0, element: str = "p1p1", n: int = 10) -> dict[str, float]:
    """``roughness`` of the pressure of a small wave after 20 steps: its largest jump from a node to the mean of a cell, less
    the hydrostatic part, by the pressure at the floor.

    stabilisation, element, n : see ``Pfem.build``.
    """
    model = built(scenes.get("sloshing")(), n=n, stabilisation=stabilisation, element=element)
    for _ in range(20):
        model.step(model.dt())
    weight = sloshing.DENSITY * sloshing.G
    p = (model.cloud.p - weight * (sloshing.DEPTH - model.cloud.x[:, 1]))[model.mesh.cells]
    return {"roughness": float(np.abs(p - p.mean(axis=1, keepdims=True)).max()) / (weight * sloshing.DEPTH)}


def sticking(method: str, *, n: int, T: float = 2.0, **knobs: Any) -> dict[str, float]:
    """``layer``: the displacement thickness of what the floor of a broken dam holds back, by the depth of the water.

    n : cells across the column. T : the time, in units of the scene. knobs : see ``Pfem.build``.
    """
    own = SETUPS["koshizuka"]
    model = built(scenes.get("dam_break")(setup="koshizuka"), n=n, **knobs)
    while model.t < T * own.unit:
        model.step(min(model.dt(), T * own.unit - model.t + 1e-12))
    lost = []
    for place in UPRIGHTS:
        u = along(model.cloud, model.mesh.cells, place * own.a, own.a)
        lost.append(1.0 - u.mean() / u.max())
    return {"layer": float(np.mean(lost))}


def along(cloud: Cloud, cells: Array, x: float, height: float) -> Array:
    """Horizontal velocities (k,) at even distances up the line at x, where it is in the water."""
    y = height * (np.arange(1000) + 0.5) / 1000
    corner = cloud.x[cells]
    met = (corner[:, :, 0].min(axis=1) <= x) & (corner[:, :, 0].max(axis=1) > x)
    corner, v = corner[met], cloud.v[cells[met], 0]
    edge = (corner[:, 1:] - corner[:, :1]).transpose(0, 2, 1)
    place = np.stack([np.full_like(y, x), y])
    inner = np.linalg.solve(edge, place - corner[:, 0, :, None])
    weights = np.concatenate([1.0 - inner.sum(axis=1, keepdims=True), inner], axis=1)
    within = weights.min(axis=1) >= 0.0
    cell = within.argmax(axis=0)[within.any(axis=0)]
    at = np.flatnonzero(within.any(axis=0))
    return np.einsum("kc,kc->k", weights[cell, :, at], v[cell])


def sliver_share(method: str, *, jitter: float, way: str = "delaunay", n: int = 10) -> dict[str, float]:
    """Share of ``slivers`` among the cells of a cube of nodes, found as an alpha shape.

    jitter : shift of the nodes at random, by the spacing. way : ``delaunay``, ``swapped`` (edges are taken out), or ``mended``
    (and slivers at the boundary left out, as the method does). n : cells along a side.
    """
    x = np.stack(np.meshgrid(*3 * [np.linspace(0, 1, n + 1)], indexing="ij"), axis=-1).reshape(-1, 3)
    x += np.random.default_rng(0).uniform(-jitter, jitter, x.shape) / n
    size = np.full(len(x), 1 / n)
    if way == "mended":
        cells = InsideBody(sliver=FLAT)(x, size, None).cells
    else:
        cells = AlphaShape()(x, size, None).cells
        cells = slivers.swapped(x, cells, FLAT) if way == "swapped" else cells
    return {"slivers": float(np.mean(simplices.quality(x, cells) < FLAT))}
