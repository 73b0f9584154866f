"""What the tests of material points share: the family by shape, small scenes, and a run to the end."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from geofem import scenes
from geofem.methods.mpm import BsplineMpm, Cpdi2Mpm, CpdiMpm, GimpMpm, LinearMpm
from geofem.methods.mpm.model import ExplicitMpm
from geofem.scene import Box, Load, Material, Probe, Region, Scene, Support

Array = np.ndarray
FAMILY = {
    "hat": (LinearMpm, "linear"),
    "gimp": (GimpMpm, "uniform"),
    "cpgimp": (GimpMpm, "contiguous"),
    "cpdi": (CpdiMpm, "parallelogram"),
    "cpdi2": (Cpdi2Mpm, "quadrilateral"),
    "bspline2": (BsplineMpm, "quadratic"),
    "bspline3": (BsplineMpm, "cubic"),
}
SOFT = Material("neo_hooke", 1000.0, {"E": 4e6, "nu": 0.3})
TIP = Probe("tip", "displacement", (4.0, 0.5), 1)
NOTHING = Load("body", lambda x, t: 0.0 * x)
"""A force per mass of zero: scenes with loads on the points and without share their compiled kernels then."""


def loaded(name: str, **knobs: Any) -> Scene:
    """A scene of geofem with a force of zero on its points, for the same reason."""
    scene = scenes.get(name)(**knobs)
    return replace(scene, loads=(*scene.loads, NOTHING))


def build(scene: Scene, shape: str = "hat", **knobs: Any) -> ExplicitMpm:
    method, kernel = FAMILY[shape]
    assert method().refuses(scene) is None
    return method().build(scene, kernel=kernel, **knobs)


def finish(model: ExplicitMpm) -> ExplicitMpm:
    while model.t < model.scene.t_end * (1 - 1e-12):
        model.step(min(model.dt(), model.scene.t_end - model.t))
    return model


def run(scene: Scene, shape: str = "hat", **knobs: Any) -> tuple[ExplicitMpm, Array, Array]:
    """The model at the end, and the times and values of the scene's first probe after every step."""
    model = build(scene, shape, **knobs)
    history = []
    while model.t < scene.t_end * (1 - 1e-12):
        model.step(min(model.dt(), scene.t_end - model.t))
        history.append((model.t, model.probe(scene.probes[0]) if scene.probes else 0.0))
    t, values = np.array(history).T
    return model, t, values


def block(velocity: Any, t_end: float = 0.1, **changes: Any) -> Scene:
    """A free square of 1 m with an initial velocity."""
    keywords: dict[str, Any] = {
        "regions": (Region("block", Box((0.0, 0.0), (1.0, 1.0)), SOFT),),
        "supports": (),
        "loads": (NOTHING,),
        "room": Box((-2.0, -2.0), (3.0, 3.0)),
    }
    return Scene(name="block", length=1.0, dynamic=True, t_end=t_end, initial_velocity=velocity, **(keywords | changes))


def uniform(*v: float) -> Any:
    return lambda x: np.array(v)[:, None] * np.ones(x.shape[1])


def spin(x: Array) -> Array:
    """Rotation, stretching and drift at once (m/s)."""
    return np.stack([5.0 - 8.0 * x[1] + 3.0 * x[0], -2.0 + 8.0 * x[0] ** 2])


def beam(E: float = 4e6, t_end: float = 1.5) -> Scene:
    """A cantilever of 4 m x 1 m on which gravity is switched on."""
    material = Material("neo_hooke", 1000.0, {"E": E, "nu": 0.3})
    return Scene(
        name="beam",
        regions=(Region("beam", Box((0.0, 0.0), (4.0, 1.0)), material),),
        length=1.0,
        supports=(Support("clamp", lambda x: x[0] <= 0, (0, 1)),),
        loads=(Load("gravity", (0.0, -10.0)), NOTHING),
        probes=(TIP,),
        dynamic=True,
        t_end=t_end,
        room=Box((-1.0, -4.0), (5.0, 2.0)),
    )
