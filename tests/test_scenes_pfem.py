"""Scenes made for a method whose nodes are the material: fluids at rest, in waves, with surface tension and with a yield stress."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest

from geofem import materials, scenes
from geofem.mistake import Mistake
from geofem.scene import Array, Measure, Scene
from geofem.scenes import hydrostatic, sloshing

CASES: list[tuple[str, dict[str, Any]]] = [
    *[("hydrostatic", knobs) for knobs in ({}, {"dim": 3})],
    *[("sloshing", knobs) for knobs in ({}, {"A": 0.001, "nu": 0.0}, {"nu": 0.01})],
]


def made(name: str, **knobs: Any) -> Scene:
    return scenes.get(name)(**knobs)


def measure(scene: Scene, name: str) -> Measure:
    return next(one for one in scene.measures if one.name == name)


def inside(shape: Any, count: int = 2000) -> Array:
    """Random points of a shape, (gdim, n)."""
    low, high = np.array(shape.bounds)
    x = np.random.default_rng(1).uniform(low, high, (count, len(low))).T
    return x[:, shape.contains(x)]


# --- every scene ------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name, knobs", CASES)
def test_scene_is_sound(name: str, knobs: dict[str, Any]) -> None:
    scene = made(name, **knobs)
    assert scene.name == name and scene.dynamic and scene.strain == "finite"
    assert scene.knobs == {**(scenes.get(name).__kwdefaults__ or {}), **knobs}, "a scene records all its knobs"
    assert all(math.isfinite(value) for value in (scene.at(0.5 * scene.t_end) if scene.at else {}).values())
    assert scene.room is not None
    for region in scene.regions:
        materials.check(region.material, f"{name} {knobs}")
        low, high = (np.array(b) for b in region.shape.bounds)
        assert len(low) == scene.gdim
        assert np.all(low >= np.array(scene.room.low) - 1e-12) and np.all(high <= np.array(scene.room.high) + 1e-12)
        x = inside(region.shape)
        for wall in scene.walls:
            assert len(wall.normal) == scene.gdim
            assert not wall.where(x).any(), f"wall {wall.name} is inside the body"
            assert wall.where(x - 100 * np.array(wall.normal)[:, None]).all(), f"wall {wall.name} has an end"
        for rigid in scene.rigids:
            assert not rigid.shape.contains(x).any(), f"{rigid.name} starts inside the body"
        if scene.initial_velocity is not None:
            assert scene.initial_velocity(x).shape == x.shape
    for one in scene.measures:
        assert one.value is not None or one.error is not None
        if one.reference is not None:
            assert one.reference.source and not re.search(r"memory|prototype|\.py", one.reference.source)
            assert one.reference.known or one.error is not None or one.reference.kind == "cross-method"
    assert len({one.reference.kind for one in scene.measures if one.reference}) == 1, "the table of scenes names one kind"


@pytest.mark.parametrize(
    "name, knobs",
    [("hydrostatic", {"dim": 1}), ("sloshing", {"A": 0.1}), ("sloshing", {"nu": -1e-6}), ("sloshing", {"A": math.nan})],
)
def test_wrong_knob_is_a_mistake_that_names_scene_and_knob(name: str, knobs: dict[str, Any]) -> None:
    with pytest.raises(Mistake, match=f"scene {name}.*{next(iter(knobs))}"):
        made(name, **knobs)


# --- water at rest ----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("dim", [2, 3])
def test_hydrostatic_pressure_balances_gravity(dim: int) -> None:
    """grad p = rho g, and no pressure at the surface."""
    scene = made("hydrostatic", dim=dim)
    exact = next(probe.exact for probe in scene.probes if probe.quantity == "pressure_error")
    assert exact is not None
    x = np.random.default_rng(0).uniform(0, 1, (dim, 50))
    g = np.array(scene.loads[0].value)
    for axis in range(dim):
        step = 1e-3 * np.eye(dim)[:, [axis]]
        slope = (exact(x + step, 0.0) - exact(x - step, 0.0)) / 2e-3
        assert np.allclose(slope, scene.regions[0].material.density * g[axis], rtol=1e-9, atol=1e-6)
    x[-1] = hydrostatic.A
    assert np.allclose(exact(x, 0.0), 0.0)


# --- waves ------------------------------------------------------------------------------------------------------------
def test_sloshing_starts_without_divergence_or_rotation_and_along_its_walls() -> None:
    scene = made("sloshing")
    v = scene.initial_velocity
    assert v is not None
    x = inside(scene.regions[0].shape, 200)
    h = 1e-4
    gradient = np.array([(v(x + h * e) - v(x - h * e)) / (2 * h) for e in (np.array([[1.0], [0]]), np.array([[0.0], [1]]))])
    size = np.abs(gradient).max()
    assert np.abs(gradient[0, 0] + gradient[1, 1]).max() < 1e-6 * size
    assert np.abs(gradient[0, 1] - gradient[1, 0]).max() < 1e-6 * size
    s = np.linspace(0, 1, 20)
    assert np.abs(v(np.array([s, 0 * s]))[1]).max() == 0.0
    assert np.abs(v(np.array([[0.0, 1.0], [0.3, 0.3]]))[0]).max() < 1e-15
    surface = v(np.array([s, 0 * s + sloshing.DEPTH]))[1]
    assert np.allclose(surface, 0.005 * sloshing.OMEGA * np.cos(np.pi * s), atol=1e-15)


def wave(nu: float, steps: int = 100) -> dict[str, Array]:
    """The history of linear theory, with so many samples a period."""
    T = 2 * np.pi / sloshing.OMEGA
    t = np.arange(4 * steps + 1) / steps * T
    return {"t": t, "mean_velocity": -0.01 * np.exp(-2 * nu * sloshing.K**2 * t) * np.cos(sloshing.OMEGA * t)}


@pytest.mark.parametrize("nu", [0.0, 1e-6, 1e-3, 0.01])
def test_sloshing_finds_the_period_and_the_damping_of_linear_theory(nu: float) -> None:
    """A parabola through three samples tells the peak to 1e-5 with 100 samples a period and to 1e-3 with 24."""
    scene = made("sloshing", nu=nu)
    period, damping = measure(scene, "period"), measure(scene, "damping")
    assert period.value is not None and period.reference is not None and damping.error is not None
    assert period.reference.error(period.value(wave(nu))) < 2e-4
    assert damping.error(wave(nu)) < 1e-5
    assert damping.error(wave(nu, steps=24)) < 1e-3


def test_sloshing_period_of_a_run_without_a_wave_is_unknown() -> None:
    history = {"t": np.linspace(0, 1, 5), "mean_velocity": -np.ones(5)}
    assert math.isnan(sloshing.period(history)) and math.isnan(sloshing.damping(history))


def test_omega_of_sloshing_is_that_of_the_table() -> None:
    period = measure(made("sloshing"), "period").reference
    assert period is not None and period.value == pytest.approx(2 * math.pi / sloshing.OMEGA, rel=1e-14)
