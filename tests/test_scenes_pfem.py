"""Scenes made for a method whose nodes are the material: fluids at rest, in waves, with surface tension and with a yield stress."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest
from made import inside, made, measure
from scipy.integrate import quad

from geofem import materials, scenes
from geofem.mistake import Mistake
from geofem.reference import series, table
from geofem.scene import Array
from geofem.scenes import bingham_slump, dam_break, hydrostatic, sloshing, square_drop

CASES: list[tuple[str, dict[str, Any]]] = [
    *[("hydrostatic", knobs) for knobs in ({}, {"dim": 3})],
    *[("dam_break", {"setup": setup}) for setup in ("martin_moyce", "koshizuka", "obstacle", "solid")],
    *[("dam_break", {"setup": setup, "end": 0.5}) for setup in ("koshizuka", "obstacle", "solid")],
    *[("square_drop", knobs) for knobs in ({}, {"shape": "disc"})],
    *[("bingham_slump", {"B": B}) for B in (0.05, 0.01, 0.1)],
    *[("film", {"law": law}) for law in ("newtonian", "bingham")],
    *[("sloshing", knobs) for knobs in ({}, {"A": 0.001, "nu": 0.0}, {"nu": 0.01})],
]


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
    [("hydrostatic", {"dim": 1}), ("sloshing", {"A": 0.1}), ("sloshing", {"nu": -1e-6}), ("sloshing", {"A": math.nan}),
     ("dam_break", {"setup": "moyce"}), ("dam_break", {"end": 0.01, "setup": "solid"}), ("square_drop", {"shape": "round"}),
     ("square_drop", {"amplitude": 0.0}), ("bingham_slump", {"B": 0.5}), ("bingham_slump", {"m": 0.0}),
     ("film", {"law": "water"}), ("film", {"slope": 90.0})],
)  # fmt: skip
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


# --- dam breaks -------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("setup", ["koshizuka", "obstacle"])
def test_koshizuka_front_is_compared_after_one_shift_of_time(setup: str) -> None:
    scene, own = made("dam_break", setup=setup), dam_break.SETUPS[setup]
    source, columns = series(own.table)
    assert "Koshizuka" in source and np.all(np.diff(columns["T"]) > 0)
    T = np.linspace(0, own.end, 2001)
    ahead = np.interp(T + 0.2, columns["T"], columns["Z"])
    history = {"t": T * own.unit, "front": ahead * own.a, "volume": 1.0 + 0.001 * np.sin(T)}
    shift, front, volume = (measure(scene, name) for name in ("shift", "front", "volume"))
    assert shift.value is not None and front.error is not None and volume.value is not None
    assert shift.value(history) == pytest.approx(0.2, abs=2e-3)
    assert front.error(history) < 2e-3 < 0.05 < front.error({**history, "front": own.a + 0.6 * (history["front"] - own.a)})
    assert volume.value(history) == pytest.approx(0.001, rel=1e-5)


def test_dam_break_tells_when_the_far_wall_is_reached() -> None:
    scene, own = made("dam_break", setup="obstacle", end=0.5), dam_break.SETUPS["obstacle"]
    reach = measure(scene, "reach").value
    assert reach is not None
    t = np.linspace(0, 0.5, 101)
    history = {"t": t, "front": own.a * (1 + 10 * t)}
    assert reach(history) == pytest.approx(0.28, rel=1e-6)
    assert math.isnan(reach({**history, "front": own.a * (1 + t)}))


def test_solid_dam_break_is_the_first_one_in_a_channel() -> None:
    flat, solid = made("dam_break"), made("dam_break", setup="solid")
    (low, high), (low3, high3) = flat.regions[0].shape.bounds, solid.regions[0].shape.bounds
    assert (low3[0], low3[2], high3[0], high3[2]) == (*low, *high)
    assert solid.t_end == flat.t_end and len(solid.walls) == len(flat.walls) + 2
    for wall in flat.walls:
        twin = next(w for w in solid.walls if w.name == wall.name)
        x = np.random.default_rng(2).uniform(-0.1, 1.0, (2, 100))
        assert np.array_equal(wall.where(x), twin.where(np.array([x[0], 0 * x[0], x[1]])))


# --- drops ------------------------------------------------------------------------------------------------------------
def test_drop_frequency_is_that_of_the_energies_of_its_mode() -> None:
    """r = R (1 + a cos k phi) at constant area: sigma times the length, against the kinetic energy of its potential flow."""
    R, sigma, rho = square_drop.RADIUS, square_drop.TENSION, square_drop.DENSITY
    phi = np.linspace(0, 2 * np.pi, 4001)[:-1]
    for k in (2, 4):

        def surface(a: float, k: int = k) -> float:
            r, slope = 1 + a * np.cos(k * phi), -a * k * np.sin(k * phi)
            r, slope = (q / math.sqrt(np.mean(r**2)) for q in (r, slope))
            return sigma * R * 2 * np.pi * float(np.mean(np.hypot(r, slope)))

        a = 1e-3
        stiffness = (surface(a) + surface(-a) - 2 * surface(0.0)) / a**2
        inertia = np.pi * rho * R**4 / k  # twice the kinetic energy for da/dt = 1
        assert math.sqrt(stiffness / inertia) == pytest.approx(square_drop.omega(k), rel=1e-4)


def test_square_and_disc_have_one_area_and_the_disc_starts_as_its_mode() -> None:
    square, disc = made("square_drop"), made("square_drop", shape="disc", amplitude=0.01)
    low, high = (np.array(b) for b in square.regions[0].shape.bounds)
    assert np.prod(high - low) == pytest.approx(math.pi * square_drop.RADIUS**2, rel=1e-14)
    phi = np.linspace(0, 2 * np.pi, 9)
    n = np.array([np.cos(phi), np.sin(phi)])
    assert disc.initial_velocity is not None and square.initial_velocity is None
    speed = np.sum(n * disc.initial_velocity(square_drop.RADIUS * n), axis=0)
    assert np.allclose(speed, 0.01 * square_drop.RADIUS * square_drop.omega(2) * np.cos(2 * phi), atol=1e-15)


@pytest.mark.parametrize("shape", ["square", "disc"])
def test_drop_finds_frequency_and_damping(shape: str) -> None:
    scene = made("square_drop", shape=shape)
    k = square_drop.MODES[shape]
    w, rate = square_drop.omega(k), 2 * k * (k - 1) * 1e-6 / square_drop.RADIUS**2
    t = np.linspace(0, scene.t_end, 401)
    history = {"t": t, "velocity": np.exp(-rate * t) * np.cos(w * t)}
    history["width"] = 0.01 + history["velocity"] + 0.2 * np.sin(3.1 * w * t)
    for one in scene.measures:
        found = one.error(history) if one.error else one.reference.error(one.value(history))  # type: ignore[union-attr, misc]
        assert found < 1e-3


# --- mud --------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("B", [0.01, 0.05, 0.1])
def test_shapes_of_a_slump_hold_the_column_and_stand_on_their_yield_stress(B: float) -> None:
    """Lengths over H. The pull of the layer less its weight changes along x by the yield stress of the floor: d(N)/dx = B."""
    far, flat = bingham_slump.thin(B)
    near, steep = bingham_slump.yielding(B)
    e = 0.5 * math.pi * B
    for x_f, top, pull in ((far, flat, 0.0), (near, steep, e)):

        def h(x: float, x_f: float = x_f, pull: float = pull) -> float:
            return pull + math.sqrt(pull**2 + 2 * B * (x_f - x))

        def force(x: float, pull: float = pull) -> float:
            return -0.5 * h(x) ** 2 + pull * h(x)

        assert h(0.0) == pytest.approx(top)
        assert quad(h, 0, x_f)[0] == pytest.approx(1.0, rel=1e-7)
        x, step = 0.4 * x_f, 1e-5
        assert (force(x + step) - force(x - step)) / (2 * step) == pytest.approx(B, rel=1e-6)
    assert near < far and steep > flat


def test_bounds_of_a_slump_at_its_default_are_those_of_the_table() -> None:
    for k, name in enumerate(("run_out", "height")):
        found = table("f07_bingham_slump")[name]
        ends = sorted(theory(0.05)[k] for theory in (bingham_slump.thin, bingham_slump.yielding))
        assert [found["lower"], found["upper"]] == pytest.approx(ends, rel=1e-12)
