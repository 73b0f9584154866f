"""What the tests of scenes share: a scene by its name, one of its measures, and points of its shapes."""

from __future__ import annotations

from typing import Any

import numpy as np

from geofem import scenes
from geofem.scene import Array, Measure, Scene


def made(name: str, **knobs: Any) -> Scene:
    return scenes.get(name)(**knobs)


def measure(scene: Scene, name: str) -> Measure:
    return next(one for one in scene.measures if one.name == name)


def inside(shape: Any, count: int = 2000) -> Array:
    """Random points of a shape, (gdim, n)."""
    low, high = np.array(shape.bounds)
    x = np.random.default_rng(1).uniform(low, high, (count, len(low))).T
    return x[:, shape.contains(x)]
