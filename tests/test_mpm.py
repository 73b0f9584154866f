"""Material point methods: known motions, the ways in which they are known to fail, and their bookkeeping."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from points import NOTHING, SOFT, TIP, beam, block, build, finish, run, spin, uniform

from geofem.methods.mpm import BsplineMpm, Cpdi2Mpm, GimpMpm, LinearMpm
from geofem.mistake import Breakdown, Mistake
from geofem.scene import Box, Crack, Disc, Load, Material, Polygon, Probe, Region, Rigid, Scene, Support

# smallest deflection (m) of the tips of ``beam()`` and ``beam(4e8)``: P2 triangles in a total Lagrangian formulation with
# Newmark's rule, 8 and 12 cells across, good to about .1 %
TIP_SOFT, TIP_STIFF = -1.7375, -0.018496


def bar(v0: float, n: int, periods: float) -> Scene:
    """A bar of 25 m, fixed at x = 0, that swings in its first axial mode with a period of 10 s for small v0 (m/s)."""
    w, k = 25.0 / n, np.pi / 50.0
    return Scene(
        name="bar",
        regions=(Region("bar", Box((0.0, 0.0), (25.0, w)), Material("neo_hooke", 1.0, {"E": 100.0, "nu": 0.0})),),
        length=25.0,
        supports=(
            Support("end", lambda x: x[0] <= 0, (0,)),
            Support("sides", lambda x: (x[1] <= 0) | (x[1] >= w), (1,)),
        ),
        loads=(NOTHING,),
        probes=(Probe("v", "mean_velocity"),),
        dynamic=True,
        t_end=10.0 * periods,
        initial_velocity=lambda x: np.stack([v0 * np.sin(k * x[0]), 0 * x[0]]),
        room=Box((-2 * w, -w), (25.0 + 4 * w, 2 * w)),
    )


def column(law: str, strain: str, n: int) -> Scene:
    """50 m of very soft ground under its own weight, one cell wide (set-up after Charlton, Coombs & Augarde 2017)."""
    w = 50.0 / n
    return Scene(
        name="column",
        regions=(Region("column", Box((0.0, 0.0), (w, 50.0)), Material(law, 80.0, {"E": 1e4, "nu": 0.0})),),
        length=50.0,
        supports=(
            Support("base", lambda x: x[1] <= 0, (1,)),
            Support("sides", lambda x: (x[0] <= 0) | (x[0] >= w), (0,)),
        ),
        loads=(Load("gravity", (0.0, -10.0)), *((NOTHING,) if strain == "finite" else ())),
        probes=(Probe("settlement", "displacement", (w / 2, 50.0), 1),),
        strain=strain,
    )


def test_probe_meets_a_linear_field_exactly() -> None:
    """The plane of least squares through points of a linear field is that field, also at a corner and after sorting."""
    model = build(block(None), n=6, ppc=3)
    body = model.bodies[0]
    X = body.own("X").copy()
    for turn in range(2):
        if turn:
            body.sort(np.argsort(X[:, 1]))
            assert not np.array_equal(body.own("X"), X)
        body.own("x")[:] = body.own("X") @ np.array([[1.1, 0.2], [-0.3, 0.9]]) + [0.5, 0.7]
        for at, ux, uy in (((0.0, 0.0), 0.5, 0.7), ((1.0, 1.0), 0.3, 0.8), ((0.31, 0.62), 0.345, 0.7)):
            assert model.probe(Probe("ux", "displacement", at, 0)) == pytest.approx(ux, abs=1e-12)
            assert model.probe(Probe("uy", "displacement", at, 1)) == pytest.approx(uy, abs=1e-12)


# --- accuracy ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("shape, scheme", [("hat", "musl"), ("gimp", "usl"), ("cpdi", "usl")])
def test_axial_vibration(shape: str, scheme: str) -> None:
    """Period 10 s, here to 0.3 %. FLIP keeps the energy over 5 periods within 1 %, PIC does not.

    The supports do no work, so that kinetic + internal energy is what there was.
    """
    knobs = {"n": 13, "scheme": scheme}
    model, t, v = run(bar(0.1, 13, 5.0), shape, **knobs)
    k = np.flatnonzero((v[:-1] > 0) & (v[1:] <= 0))
    zero = t[k] + (t[k + 1] - t[k]) * v[k] / (v[k] - v[k + 1])
    assert np.diff(zero) == pytest.approx(10.0, rel=3e-3)
    start = build(bar(0.1, 13, 5.0), shape, **knobs).energy()["kinetic"]
    energy = model.energy()
    assert energy["kinetic"] + energy["internal"] == pytest.approx(start, rel=0.01)
    damped = finish(build(bar(0.1, 13, 5.0), shape, flip=0.0, **knobs)).energy()
    assert damped["kinetic"] + damped["internal"] < 0.5 * start


def test_small_motions_of_a_beam_converge() -> None:
    """Where no point crosses a cell the error of the tip falls by 2 or more with h/2: 1.8 % at 4 cells across, 0.5 % at 8."""
    error = [abs(run(beam(4e8, 0.1), n=n)[2].min() / TIP_STIFF - 1) for n in (4, 8)]
    assert error[1] < 0.5 * error[0] < 0.012


def test_large_rotations_diverge_under_refinement() -> None:
    """Cell crossing: the error of the tip's largest deflection grows with refinement: about 6, 10 and 18 %."""
    error = [abs(run(beam(), n=n)[2].min() / TIP_SOFT - 1) for n in (4, 8, 16)]
    assert 0.03 < error[0] < error[1] < error[2]
    assert error[2] > 0.12


def test_energy_balance() -> None:
    """Work of gravity = kinetic energy + work of the stresses, to the step's first order: 1 % of the work at 1/8 of a swing."""
    model, _, _ = run(beam(4e8, 0.02), n=8)
    energy = model.energy()
    assert energy["kinetic"] + energy["internal"] == pytest.approx(energy["external"], rel=0.03)


@pytest.mark.parametrize("shape", ["hat", "cpdi", "cpdi2"])
def test_column_at_small_strain(shape: str) -> None:
    """Settlement rho g H^2 / 2E = 100 m, twice the column's height, is what small-strain theory says; base force = weight.

    Domains stay where they began, however large the displacements are.
    """
    n = 16 if shape == "hat" else 8
    model, _, u = run(column("linear_elastic", "small", n), shape, n=n, tolerance=1e-7)
    assert u[-1] == pytest.approx(-100.0, rel=0.01 if shape == "hat" else 0.03)
    weight = 80.0 * 10.0 * 50.0 * 50.0 / n
    assert model.probe(Probe("base", "reaction", of="base", component=1)) == pytest.approx(weight, rel=0.01)


def test_column_at_finite_strain() -> None:
    """Settlement 25.94 m of 50 m (Hencky, by quadrature); cells are crossed on the way, hence a tenth. Base force = weight."""
    model, _, u = run(column("hencky", "finite", 8), n=8)
    assert model.t == 1.0 and u[-1] == pytest.approx(-25.940354, rel=0.1)
    weight = 80.0 * 10.0 * 50.0 * 50.0 / 8
    assert model.probe(Probe("base", "reaction", of="base", component=1)) == pytest.approx(weight, rel=0.01)


def test_pulled_bar_takes_the_exact_stress() -> None:
    """Patch test: a bar pulled to a strain of 1e-3 has the stress 1e-3 E/(1 - nu^2) (relaxed to 1 %)."""
    pull = Support("pull", lambda x: x[0] >= 2, (0,), lambda x, t: 2e-3 * t + 0 * x[0])
    scene = Scene(
        name="pull",
        regions=(Region("bar", Box((0.0, 0.0), (2.0, 1.0)), Material("linear_elastic", 1000.0, {"E": 1e6, "nu": 0.25})),),
        length=1.0,
        supports=(Support("end", lambda x: x[0] <= 0, (0,)), Support("bottom", lambda x: x[1] <= 0, (1,)), pull),
        strain="small",
    )
    model, _, _ = run(scene, n=4, tolerance=1e-8)
    exact = 1e3 / (1 - 0.25**2)
    assert model.probe(Probe("s", "stress", (1.0, 0.5), 0)) == pytest.approx(exact, rel=0.01)
    assert model.probe(Probe("zz", "stress", (1.0, 0.5), 2)) == pytest.approx(0.25 * exact, rel=0.01)
    assert model.probe(Probe("R", "reaction", of="pull", component=0)) == pytest.approx(exact, rel=0.01)
    assert model.energy()["internal"] == pytest.approx(0.5 * exact * 1e-3 * 2.0, rel=0.01)


# --- failures ---------------------------------------------------------------------------------------------------------
def fails(scene: Scene, shape: str = "hat", **knobs: Any) -> tuple[str, float, str]:
    model = build(scene, shape, **knobs)
    with pytest.raises(Breakdown) as caught:
        while model.t < scene.t_end:
            model.step(min(model.dt(), scene.t_end - model.t))
    assert "\n" not in str(caught.value) and np.isfinite(model.probe(TIP))
    return caught.value.cause, model.t, str(caught.value)


def test_crushing_turns_a_point_inside_out() -> None:
    """Closing in at a rate of -600 /s over a first step of 3.3 ms takes F_xx to 1 - 2; where and when is told."""
    crush = block(lambda x: np.stack([-600.0 * (x[0] - 0.5), 0 * x[0]]))
    cause, t, message = fails(crush, n=8, cfl=10.0)
    assert cause == "tangle" and "det F" in message and "m, now at (" in message and t == 0.0


def test_update_stress_last_ends_hats_in_large_rotations() -> None:
    """With usl hats draw energy from nodes of little mass until a point is turned inside out; the finer the grid the earlier."""
    (cause, coarse, _), (_, fine, _) = (fails(beam(), n=n, scheme="usl") for n in (8, 16))
    assert cause in ("energy", "tangle") and fine < coarse < 0.5


def test_a_point_that_leaves_the_grid_ends_the_run() -> None:
    """At 100 m/s to the right the first points leave the room, 2 m away, at t = .02 s; where and when is told."""
    cause, t, message = fails(block(uniform(100.0, 0.0)), n=8)
    assert cause == "volume" and t == pytest.approx(0.02, rel=0.05)
    x = float(message.split("now at (")[1].split(",")[0])
    assert x == pytest.approx(3.0, abs=0.1) and "left the background grid at t = 0.0" in message


def test_a_runaway_velocity_is_named() -> None:
    """A step of 20 times what the grid bears: speeds grow in one step beyond ten times that of waves and that of the start."""
    linear = Region("block", Box((0.0, 0.0), (1.0, 1.0)), Material("linear_elastic", 1000.0, {"E": 4e6, "nu": 0.3}))
    swing = block(lambda x: np.stack([20.0 * (x[0] - 0.5), 0 * x[0]]), t_end=10.0, regions=(linear,), loads=(), strain="small")
    cause, _, message = fails(swing, n=8, cfl=20.0)
    assert cause == "cfl" and "faster than" in message


def test_no_rest_without_damping() -> None:
    """FLIP without damping swings for ever under a load that came on in a finite time."""
    cause, _, message = fails(column("linear_elastic", "small", 4), n=4, flip=1.0, damping=0.0)
    assert cause == "newton" and "no rest" in message


def test_a_body_held_by_noise_is_not_at_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    """A strip of 100 : 1 stops bending where its points cross cells, held by damping alone: told, not taken for rest."""
    monkeypatch.setattr("geofem.methods.mpm.model.PATIENCE", 70)
    strip = Region("strip", Box((0.0, -0.005), (1.0, 0.005)), Material("neo_hooke", 100.0, {"E": 1.2e7, "nu": 0.0}))
    scene = replace(
        beam(), regions=(strip,), loads=(Load("gravity", (0.0, -1.0)), NOTHING), length=0.01, dynamic=False, t_end=1.0
    )
    cause, t, _ = fails(replace(scene, room=Box((-0.1, -1.0), (1.1, 0.1)), probes=()), n=1)
    assert cause == "newton" and t == 0.0


def test_a_body_that_falls_apart_is_noticed_where_it_must_not() -> None:
    """Halves flying apart at 20 m/s share no node once two cells of 1/6 m lie between them: after about .02 s."""
    apart = block(lambda x: np.stack([np.where(x[0] < 0.5, -10.0, 10.0), 0 * x[1]]), intact=True)
    soft = Region("block", Box((0.0, 0.0), (1.0, 1.0)), replace(SOFT, parameters={"E": 4e3, "nu": 0.3}))
    cause, t, message = fails(replace(apart, regions=(soft,)), n=6)
    assert cause == "fracture" and "2 pieces" in message and 0.005 < t < 0.05


# --- bookkeeping ------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("shape, scheme, split", [("hat", "musl", 0.0), ("cpdi", "usl", 0.51)])
def test_a_restored_run_goes_on_bitwise(shape: str, scheme: str, split: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """A checkpoint holds all: the run that took it and another that takes it up agree to the last bit."""
    monkeypatch.setattr("geofem.methods.mpm.model.WORTH_SORTING", 0)
    pull = block(lambda x: np.stack([20.0 * (x[0] - 0.5), 0 * x[1]]), t_end=0.3, intact=True)
    scene = beam(t_end=0.3) if shape == "hat" else pull
    one, other = (build(scene, shape, n=4, scheme=scheme, sort_after=0.1, split=split) for _ in range(2))
    for _ in range(20):
        one.step(one.dt())
    state = one.state()
    other.restore({name: values.copy() for name, values in state.items()})
    for model in (one, other):
        for _ in range(20):
            model.step(model.dt())
    assert one.work == other.work and one.energy() == other.energy() and one.t == other.t
    assert not split or len(state["id_0"]) < one.bodies[0].n
    for name, array in one.state().items():
        assert np.array_equal(array, other.state()[name]), name


def test_a_load_step_can_be_taken_up_in_its_middle(monkeypatch: pytest.MonkeyPatch) -> None:
    """Turns of a few steps, each with a checkpoint, end bitwise where one long relaxation does; t waits for the rest."""
    scene = column("hencky", "finite", 8)
    whole, _, _ = run(scene, n=8)
    monkeypatch.setattr("geofem.methods.mpm.model.TURN", 100 * 32)
    model, turns = build(scene, n=8), 0
    while model.t < 1.0:
        assert model.t == 0.0
        model.step(1.0)
        state, model, turns = model.state(), build(scene, n=8), turns + 1
        model.restore(state)
    assert turns > 2 and model.work == whole.work
    assert np.array_equal(model.bodies[0].own("x"), whole.bodies[0].own("x"))


def test_sorting_changes_nothing_but_rounding(monkeypatch: pytest.MonkeyPatch) -> None:
    """The order of the points is only the order of sums; it is one of cells when sorting is asked for."""
    monkeypatch.setattr("geofem.methods.mpm.model.WORTH_SORTING", 0)
    scene = block(spin, t_end=0.02, probes=(Probe("u", "displacement", (1.0, 1.0), 0),))
    (sorted_, _, u), (unsorted, _, w) = (run(scene, n=8, sort_after=s) for s in (0.05, np.inf))
    ids = [model.bodies[0].own("id") for model in (sorted_, unsorted)]
    assert not np.array_equal(*ids)
    assert u == pytest.approx(w, rel=1e-12, abs=1e-12)
    a, b = sorted_.snapshot(), unsorted.snapshot()
    assert a["points"] == pytest.approx(b["points"], rel=1e-12, abs=1e-12)
    assert a["stress"] == pytest.approx(b["stress"], abs=1e-10 * np.abs(b["stress"]).max())


def test_work_and_size() -> None:
    """8 x 8 full cells of 4 points have 9 x 9 nodes; each step works on each point once. GIMP reaches one row of nodes more."""
    model = build(block(uniform(0.0, 0.0)), n=8)
    assert model.size()["points"] == 256 and model.size()["cells"] == 64
    for _ in range(3):
        model.step(model.dt())
    assert model.size() == {"dofs": 162, "cells": 64, "points": 256}
    assert model.savings() == {"active_grid": 81 / 41**2}
    assert model.work["steps"] == 3 and model.work["point_steps"] == 768
    model = build(block(uniform(0.0, 0.0)), "gimp", n=8, scheme="usl")
    model.step(model.dt())
    assert model.size()["cells"] == 64 and model.size()["dofs"] in (162, 2 * 121)


def test_the_grid_is_a_mesh_of_dolfinx_with_the_velocity_of_the_points() -> None:
    model = build(block(uniform(0.5, -0.25)), n=8)
    for _ in range(2):
        (velocity,) = model.functions()
        values = velocity.x.array.reshape(-1, 2)
        reached = np.linalg.norm(values, axis=1) > 0
        assert velocity.function_space.mesh.topology.index_map(2).size_global == 40**2
        assert reached.sum() == model.size()["dofs"] // 2 or model.work["steps"] == 0
        assert values[reached] == pytest.approx(np.tile([0.5, -0.25], (reached.sum(), 1)), rel=1e-12)
        model.step(model.dt())


def test_courant_step() -> None:
    """dt = cfl h / (c + v), c^2 = (lambda + 2 mu) / rho."""
    c = np.sqrt(4e6 * 0.7 / (1.3 * 0.4) / 1000.0)
    assert build(block(uniform(3.0, 4.0)), n=8, cfl=0.5).dt() == pytest.approx(0.5 / 8 / (c + 5.0), rel=1e-12)


# --- bad input --------------------------------------------------------------------------------------------------------
def test_refusals_say_why() -> None:
    scene = block(None)
    method = LinearMpm()
    assert method.refuses(scene) is None
    triangle = Rigid("wedge", Polygon(((0.0, 1.0), (1.0, 1.0), (0.0, 2.0))))
    refused = {
        "plane strain": replace(scene, plane="plane_stress"),
        "traction": replace(scene, loads=(Load("pressure", 1.0, lambda x: x[0] <= 0),)),
        "cracks": replace(scene, cracks=(Crack(((0.0, 0.5), (0.5, 0.5))),)),
        "collapse": replace(scene, dynamic=False, collapse=True),
        "density": replace(scene, regions=(Region("b", Box((0.0, 0.0), (1.0, 1.0)), replace(SOFT, density=0.0)),)),
        "groups": replace(scene, supports=(Support("base", "base", (0,)),)),
        "rigid": replace(scene, plane="axisymmetric", rigids=(triangle,)),
    }
    for word, case in refused.items():
        assert word in (method.refuses(case) or "")
    solid = replace(scene, plane="solid", regions=(Region("b", Box((0.0,) * 3, (1.0,) * 3), SOFT),))
    assert "hexahedra" in (Cpdi2Mpm().refuses(solid) or "") and method.refuses(solid) is None


@pytest.mark.parametrize(
    "knobs, words",
    [
        ({"scheme": "mulsl"}, "'musl'"), ({"transfer": "flp"}, "'flip'"), ({"kernel": "linaer"}, "'linear'"),
        ({"cure": "cel"}, "'cell'"), ({"n": 0}, "n = 0"), ({"n": 2.5}, "n = 2.5"), ({"ppc": 0}, "ppc = 0"),
        ({"xpic": 0}, "xpic = 0"), ({"threads": 0}, "threads = 0"), ({"load_steps": 0}, "load_steps = 0"),
        ({"flip": 2.0}, "flip = 2"), ({"cfl": -1.0}, "cfl"), ({"tolerance": 0.0}, "tolerance"), ({"sort_after": 0.0}, "sort_after"),
        ({"damping": 1.0}, "damping = 1"), ({"small_mass": 0.6}, "small_mass = 0.6"), ({"split": 0.3}, "split = 0.3"),
        ({"split": -1.0}, "split = -1"), ({"passages": 0.0}, "passages = 0"), ({"n": "many"}, "n = 'many'"),
        ({"cfl": float("nan")}, "cfl"), ({"flip": float("nan")}, "flip"),
    ],
)  # fmt: skip
def test_a_bad_knob_is_named_in_one_line(knobs: dict[str, Any], words: str) -> None:
    with pytest.raises(Mistake, match=words) as caught:
        LinearMpm().build(block(None), **knobs)
    assert "\n" not in str(caught.value)


def test_kernels_are_those_of_the_method() -> None:
    for method, kernel, words in (
        (GimpMpm, "contigous", "'contiguous'"),
        (BsplineMpm, "linear", "quadratic"),
        (BsplineMpm, "qubic", "'cubic'"),
    ):
        with pytest.raises(Mistake, match=words):
            method().build(block(None), kernel=kernel)


@pytest.mark.parametrize(
    "scene, words",
    [
        (block(None, room=Box((0.0, 0.0), (0.9, 2.0))), "enlarge the room"),
        (block(None, regions=(Region("d", Disc((0.5, 0.5), 3.0), SOFT),)), "enlarge the room"),
        (
            block(None, regions=(Region("d", Polygon(((0.0, 0.0), (1.0, 0.0), (1.0, 1e-3), (0.5, 2e-3), (0.0, 1e-3))), SOFT),)),
            None,
        ),
        (
            block(None, regions=(Region("b", Box((0.0, 0.0), (1.0, 1.0)), replace(SOFT, parameters={"E": -1.0, "nu": 0.3})),)),
            "E",
        ),
    ],
    ids=["room", "disc", "thin", "material"],
)
def test_a_bad_scene_is_a_mistake_in_one_line(scene: Scene, words: str | None) -> None:
    if words is None:
        assert build(scene, n=8).bodies[0].own("volume").sum() == pytest.approx(1.5e-3)
        return
    with pytest.raises(Mistake, match=words) as caught:
        build(scene, n=8)
    assert "\n" not in str(caught.value)
