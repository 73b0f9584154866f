"""Inlets and outlets of pfem: uniform flow to rounding, films with their exact profiles, jets, tanks that fill, clipped bodies."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import geofem
from geofem import Box, Inlet, Load, Material, Outlet, Probe, Region, Result, Scene, Wall
from geofem.methods.pfem.budget import Budget, volumes
from geofem.methods.pfem.cloud import Cloud
from geofem.methods.pfem.contact import Obstacles
from geofem.methods.pfem.openings import let_out, part_beyond
from geofem.methods.pfem.tessellation import Tessellation
from geofem.methods.pfem.tessellation.alpha import AlphaShape
from geofem.mistake import Mistake
from geofem.scene import Array
from geofem.scenes._parts import all_of, at_least, at_most

WIDE = 0.2
MUD = Material("newtonian", 1000.0, {"mu": 1.0, "K": 1e6})


def uniform(u: float, v: float = 0.0) -> Callable[..., Array]:
    return lambda x, t=0.0: np.array([np.full(x.shape[1], u), np.full(x.shape[1], v)])


def stream(speed: float, low: float, length: float, **parts: Any) -> Scene:
    """A stream of width 0.2 m that enters at x = 0, above the height ``low``, and is that long at the start."""
    door = all_of(at_most(0, 0.0), at_least(1, low), at_most(1, low + WIDE))
    given: dict[str, Any] = {
        "regions": (Region("water", Box((0.0, low), (length, low + WIDE)), MUD),),
        "inlets": (Inlet("door", door, (1.0, 0.0), uniform(speed)),),
        "initial_velocity": uniform(speed),
        "probes": (Probe("inflow", "inflow"), Probe("volume", "volume")),
        "room": Box((0.0, 0.0), (2.0, 1.5)),
    }
    return Scene(name="stream", length=WIDE, supports=(), dynamic=True, **given | parts)


def channel(**parts: Any) -> Scene:
    """A stream between smooth plates, 0.6 m long."""
    plates = (Wall("floor", at_most(1, 0.0), (0.0, 1.0)), Wall("roof", at_least(1, WIDE), (0.0, -1.0)))
    outlets = (Outlet("end", at_least(0, 0.6), (-1.0, 0.0)),)
    probes = tuple(Probe(name, name) for name in ("inflow", "outflow", "volume"))
    return stream(0.5, 0.0, 0.6, **{"walls": plates, "outlets": outlets, "probes": probes, "t_end": 0.5} | parts)


def run(scene: Scene | str, **knobs: Any) -> Result:
    result = geofem.run(scene, method="pfem", **knobs)
    assert result.status == "ok", (result.cause, result.message)
    return result


# --- flows ------------------------------------------------------------------------------------------------------------
def test_uniform_flow_passes_through_to_rounding() -> None:
    scene = channel(probes=(*channel().probes, Probe("error", "velocity_error", exact=uniform(0.5))))
    result = run(scene, n=4)
    history = result.history
    assert np.abs(history["inflow"] - 0.5 * WIDE * history["t"]).max() < 1e-13
    assert np.abs(history["outflow"] - history["inflow"]).max() < 1e-13
    assert np.abs(history["volume"] - 0.6 * WIDE).max() < 1e-13 and history["error"].max() < 1e-13
    assert result.checks["momentum"] < 1e-12 and result.checks["energy"] < 1e-12


def test_what_an_inlet_brings_may_change_with_time() -> None:
    def faster(x: Array, t: float) -> Array:
        return (1.0 + 2.0 * t) * uniform(0.5)(x)

    door = channel().inlets[0]
    scene = channel(
        inlets=(Inlet("door", door.where, door.normal, faster),),
        probes=(*channel().probes, Probe("push", "reaction", of="door")),
    )
    history = run(scene, n=3).history
    assert history["inflow"][-1] == pytest.approx(WIDE * 0.5 * (0.5 + 0.25), rel=1e-6)
    # the whole channel gains speed at 1 m/s2
    assert np.allclose(history["push"][5:], 1000.0 * 0.6 * WIDE * 1.0, rtol=0.02)


@pytest.mark.parametrize("law, velocity, pressure", [("newtonian", 0.02, 0.03), ("bingham", 0.03, 0.05), ("mu_i", 0.06, 0.2)])
def test_films_keep_the_profile_of_their_law(law: str, velocity: float, pressure: float) -> None:
    result = run("film", law=law, n=4)
    assert result.error["velocity"] < velocity and result.error["pressure"] < pressure
    assert result.error["discharge"] < 0.02 and result.error["depth"] < 0.01
    assert abs(result.checks["volume"]) < 1e-4 and result.checks["momentum"] < 1e-3


@pytest.mark.slow
def test_a_film_converges() -> None:
    coarse, fine = run("film", n=4).error, run("film", n=8).error
    assert fine["velocity"] < 0.4 * coarse["velocity"] and fine["discharge"] < 0.4 * coarse["discharge"]


def test_a_jet_falls_on_a_parabola_and_leaves_through_the_floor() -> None:
    gravity = (Load("gravity", (0.0, -9.81)),)
    floor = (Outlet("floor", at_most(1, 0.0), (0.0, 1.0)),)
    probes = tuple(Probe(name, name) for name in ("inflow", "outflow", "volume"))
    result = run(stream(2.0, 1.0, WIDE, loads=gravity, outlets=floor, probes=probes, t_end=0.7), n=4)
    history = result.history
    assert history["inflow"][-1] == pytest.approx(2.0 * WIDE * 0.7, rel=1e-12)
    assert history["volume"][-1] == pytest.approx(WIDE**2 + history["inflow"][-1] - history["outflow"][-1], rel=1e-9)
    assert result.checks["energy"] < 1e-3  # 4e-6: what leaves takes its own, and what the steps damp is booked
    late = history["t"] > 0.6
    rate = np.polyfit(history["t"][late], history["outflow"][late], 1)[0]
    assert rate == pytest.approx(2.0 * WIDE, rel=0.02)
    points = result.snapshot["points"]
    assert points[:, 1].min() >= 0.0
    hit = points[points[:, 1] < 1e-6, 0]
    assert 0.5 * (hit.min() + hit.max()) == pytest.approx(2.0 * np.sqrt(2 * (1.0 + 0.5 * WIDE) / 9.81), rel=0.05)


def test_a_tank_fills_by_what_comes_in() -> None:
    def beside(x: Array) -> Array:
        return (x[0] <= 1e-9) & ((x[1] < 0.5) | (x[1] > 0.5 + WIDE))

    walls = (
        Wall("floor", at_most(1, 0.0), (0.0, 1.0)),
        Wall("left", beside, (1.0, 0.0)),
        Wall("right", at_least(0, 1.0), (-1.0, 0.0)),
    )
    result = run(stream(1.0, 0.5, WIDE, loads=(Load("gravity", (0.0, -9.81)),), walls=walls, t_end=0.6), n=3)
    assert result.history["inflow"][-1] == pytest.approx(WIDE * 0.6, rel=1e-12)
    assert result.history["volume"][-1] == pytest.approx(WIDE**2 + WIDE * 0.6, rel=1e-5)


def test_when_all_has_left_the_run_ends_and_says_so() -> None:
    parts = {"inlets": (), "walls": (), "outlets": (Outlet("end", at_least(0, 0.25), (-1.0, 0.0)),), "probes": (), "t_end": 0.8}
    result = geofem.run(channel(**parts), method="pfem", n=2)
    assert result.status == "failed" and result.cause == "volume" and "left" in str(result.message)
    assert result.at["t"] == pytest.approx(0.5, rel=0.2)  # 0.25 m beyond, at 0.5 m/s


# --- the clip ---------------------------------------------------------------------------------------------------------
@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10**6))
def test_parts_of_cells_beyond_a_line_and_before_it_are_the_cells(seed: int) -> None:
    random = np.random.default_rng(seed)
    cloud = Cloud.at_rest(random.uniform(-1, 1, (30, 2)), np.ones(30))
    cloud.v[:] = random.normal(size=(30, 2))
    cells = random.integers(0, 30, (40, 3))
    cells = cells[volumes(cloud.x, cells) > 1e-6]
    height = cloud.x[:, 0] - random.uniform(-0.5, 0.5)
    both = [part_beyond(cloud, cells, side * height, np.zeros(2)) for side in (1, -1)]
    area = volumes(cloud.x, cells)
    assert all(np.all((part >= -1e-15) & (part <= area + 1e-15)) for part, _ in both)
    assert np.allclose(both[0][0] + both[1][0], area)
    assert np.allclose((both[0][1] + both[1][1])[:, :2], area[:, None] * cloud.v[cells].mean(axis=1))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6))
def test_a_clipped_body_has_lost_what_was_beyond(seed: int) -> None:
    """Any body, also with holes and in pieces: what is left and what was booked are what there was."""
    random = np.random.default_rng(seed)
    cloud = Cloud.at_rest(random.uniform(0, 1, (80, 2)), np.full(80, 0.12))
    mesh = AlphaShape(1.2)(cloud.x, cloud.size, None)
    cloud.v[:] = random.normal(size=(80, 2))
    scene = channel(
        outlets=(Outlet("end", at_least(0, float(random.uniform(0.3, 0.9))), (-1.0, 0.0)),), walls=(), inlets=(), probes=()
    )
    obstacles, budget = Obstacles(scene, cloud), Budget(np.zeros(2))
    before = float(volumes(cloud.x, mesh.cells).sum())
    facets, left, lost = let_out(cloud, mesh.cells, mesh.facets, obstacles, budget)
    a, b = cloud.x[facets[:, 0]], cloud.x[facets[:, 1]]
    rest = 0.5 * float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum())
    assert rest == pytest.approx(before + budget.of["outflow"].volume, abs=1e-9)
    assert np.allclose(lost.sum(axis=0), -budget.of["outflow"].momentum)
    assert not left[facets].any() and cloud.x[facets, 0].max(initial=0.0) <= obstacles.outlets[0].plane.place
    ends = np.sort(facets, axis=0)
    assert np.array_equal(ends[:, 0], ends[:, 1]), "closed loops"


def test_what_flies_leaves_too() -> None:
    cloud = Cloud.at_rest(np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.1], [2.0, 0.5]]), np.full(4, 0.1))
    cloud.carried[3], cloud.v[3] = 0.01, (3.0, 1.0)
    obstacles, budget = Obstacles(channel(inlets=(), walls=(), probes=()), cloud), Budget(np.zeros(2))
    mesh = Tessellation(np.array([[0, 1, 2]]), np.array([[0, 1], [1, 2], [2, 0]]), np.array([-1]))
    _, left, _ = let_out(cloud, mesh.cells, mesh.facets, obstacles, budget)
    assert left.tolist() == [False, False, False, True] and budget.of["outflow"].volume == pytest.approx(-0.01)
    assert np.allclose(budget.of["outflow"].momentum, [-0.03, -0.01])


# --- mistakes ---------------------------------------------------------------------------------------------------------
def test_mistakes_are_told_in_one_line() -> None:
    door = channel().inlets[0]
    wrong = [
        ("points out", {"inlets": (Inlet("door", door.where, door.normal, uniform(-0.5)),)}, {}),
        ("finite numbers", {"inlets": (Inlet("door", door.where, door.normal, lambda x, t: x[0]),)}, {}),
        ("begin there", {"regions": (Region("water", Box((0.1, 0.0), (0.6, WIDE)), MUD),)}, {}),
        ("walls = 'fixed'", {}, {"walls": "fixed"}),
        ("boundary", {}, {"tessellation": "alpha"}),
    ]
    for words, parts, knobs in wrong:
        with pytest.raises(Mistake, match=words) as told:
            geofem.run(channel(**parts), method="pfem", n=3, **knobs)
        assert "\n" not in str(told.value)
    with pytest.raises(Mistake, match="nothing is open"):
        channel(outlets=())
    with pytest.raises(Mistake, match="slope"):
        geofem.run("film", method="pfem", law="mu_i", slope=10.0)


@pytest.mark.parametrize("method", ["fem", "mpm-linear", "xfem"])
def test_other_methods_refuse_openings(method: str) -> None:
    result = geofem.run(channel(probes=()), method=method)
    assert result.status == "refused" and result.message
