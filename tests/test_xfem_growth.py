"""Cracks that grow: the laws, the energy that is released, loads, cycles, births and ends, and the same path on any ranks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import geofem
from geofem import methods, scenes
from geofem.core import growth
from geofem.core.propagation import reached
from geofem.mistake import Mistake
from geofem.result import Result
from geofem.runner import Run
from geofem.scene import Crack, Disc, Growth, Load, Polygon, Scene, Support


def growing(name, law, **knobs):
    return replace(scenes.get(name)(**knobs), growth=law)


# --- laws -------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("criterion", "KI", "KII", "angle"),
    [
        ("hoop", 1.0, 1.0, -53.130),  # tan(theta / 2) = -1/2
        ("hoop", 0.0, 1.0, -70.529),  # cos(theta) = 1/3
        ("hoop", 1.0, 0.0, 0.0),
        ("energy", 1.0, 0.0, 0.0),
        ("symmetry", 1.0, 0.0, 0.0),
    ],
)
def test_kinks_of_the_criteria(criterion, KI, KII, angle):
    assert np.degrees(growth.kink(criterion, KI, KII)[0]) == pytest.approx(angle, abs=0.001)
    assert growth.kink(criterion, KI, -KII)[0] == -growth.kink(criterion, KI, KII)[0]


@pytest.mark.parametrize(("criterion", "angle", "tolerance"), [("energy", -75.76, 0.01), ("symmetry", -77.33, 0.01)])
def test_kinks_in_pure_shear(criterion, angle, tolerance):
    assert np.degrees(growth.kink(criterion, 0.0, 1.0)[0]) == pytest.approx(angle, abs=tolerance)


@pytest.mark.parametrize("KII", [0.05, 0.3, 1.0, 20.0])
def test_the_kink_is_where_its_criterion_says(KII):
    """Against all angles between -100 and 0 degrees."""
    m = np.linspace(-0.55, 0.0, 200_001)
    k1, k2 = growth.kinked(1.0, KII)
    most = m[(k1(m) ** 2 + k2(m) ** 2).argmax()]
    none = m[np.abs(np.where(m < -0.01 * KII / (1 + KII), k2(m), np.inf)).argmin()]
    assert growth.kink("energy", 1.0, KII)[0] == pytest.approx(np.pi * most, abs=1e-4)
    assert growth.kink("symmetry", 1.0, KII)[0] == pytest.approx(np.pi * none, abs=1e-4)
    theta = np.pi * m
    hoop = np.cos(theta / 2) ** 3 - 1.5 * KII * np.cos(theta / 2) * np.sin(theta)
    assert growth.kink("hoop", 1.0, KII) == pytest.approx((theta[hoop.argmax()], hoop.max()), abs=1e-4)


def test_speeds_of_tips():
    K = np.array([1.0, 2.0, 1.99, -1.0])
    assert growth.speeds(Growth(1.0), K).tolist() == [1.0, 1.0, 1.0, 0.0]
    assert growth.speeds(Growth(1.0, threshold=1.5), K).tolist() == [0.0, 1.0, 1.0, 0.0]
    assert growth.speeds(Growth(1.0, toughness=5.0), K).tolist() == [0.0, 1.0, 1.0, 0.0]
    assert growth.speeds(Growth(1.0, paris=(1e-10, 3.0)), K) == pytest.approx([0.125, 1.0, 0.995**3, 0.0])
    assert not growth.speeds(Growth(1.0, threshold=3.0), K).any()


@pytest.mark.parametrize(("KII", "angle"), [(0.0, -40.0), (1.0, -70.0)])
def test_factors_of_a_short_kink(KII, angle):
    """Amestoy and Leblond's F against a kink of a hundredth of the crack, solved in the field of a straight one."""
    tip = np.array([0.5, 0.5])
    turn = np.radians(angle)
    end = tip + 0.005 * np.array([np.cos(turn), np.sin(turn)])
    scene = scenes.get("williams")(tip=tuple(tip), KII=KII)
    cracks = (Crack((*scene.cracks[0].points, tuple(end))),)
    model = methods.get("xfem").build(replace(scene, cracks=cracks, singular=(tuple(end),)), n=60, grading=3.0, radius=0.002)
    model.step(1.0)
    exact = [float(k(turn / np.pi)) for k in growth.kinked(1.0, KII)]
    # the boundary, a hundred kinks away, is held where it would be without the kink
    assert model.factors()[0][0] == pytest.approx(exact, abs=0.015)


# --- growth -----------------------------------------------------------------------------------------------------------
def test_a_crack_in_tension_grows_straight_and_releases_what_J_says():
    steps = list(geofem.grow("edge_crack", a=0.3, n=30, da=0.04, until=0.2))
    assert [step.advance for step in steps] == pytest.approx(np.arange(6) * 0.04)
    for before, after in zip(steps, steps[1:]):
        work, stored = (after.energy[name] - before.energy[name] for name in ("external", "internal"))
        assert work - stored == pytest.approx(0.5 * (before.G[0] + after.G[0]) * 0.04, rel=0.03)
    assert steps[-1].tips[0] == pytest.approx((0.5, 0.0), abs=2e-3)
    assert steps[-1].K[0, 0] == pytest.approx(2.82545 * np.sqrt(np.pi * 0.5), rel=0.012)
    with pytest.raises(Mistake, match="have gone on"):
        steps[0].snapshot()
    assert "stress" in steps[-1].snapshot()


def test_an_inclined_crack_turns_across_the_tension():
    steps = list(geofem.grow("inclined_crack", beta=45.0, n=40, da=0.2, until=lambda step: step.advance > 0.7))
    infinite = -53.13  # K_I = K_II in a large plate
    np.testing.assert_allclose(np.degrees(steps[0].angles), infinite, atol=0.5)
    assert np.abs(steps[-1].angles).max() < 0.12 and len(steps) == 5
    np.testing.assert_allclose(steps[-1].tips[0], -steps[-1].tips[1], atol=5e-3)


def test_load_control_keeps_the_energy_rate_of_the_toughness():
    law = Growth(0.2, toughness=2.0)
    for step in geofem.grow(growing("edge_crack", law, a=0.3), n=30, da=0.05):
        assert step.load * step.K[0, 0] == pytest.approx(2.0, rel=1e-4)
        assert step.load**2 * step.G[0] == pytest.approx(2.0**2 * (1 - 0.3**2), rel=0.01)


def test_a_sweep_meshes_the_body_once():
    bodies = []
    for beta, step in geofem.vary("inclined_crack", "beta", (0.0, 40.0), n=20):
        bodies.append(step.model.intact)
        exact = np.sqrt(np.pi) * np.cos(np.radians(beta)) * np.array([np.cos(np.radians(beta)), np.sin(np.radians(beta))])
        assert step.K == pytest.approx(np.array([exact, exact]), abs=0.03)
    assert bodies[0] is bodies[1]


def test_no_compiler_in_growth(compilations):
    """No file is added where FFCx and numba keep what they compiled, once the first step is made."""
    seen = [compilations() for _ in geofem.grow("inclined_crack", n=20, da=0.2, until=0.8)]
    assert len(seen) > 2 and set(seen) == {seen[0]}


# --- ends and births --------------------------------------------------------------------------------------------------
def test_a_tip_breaks_through_where_little_is_left():
    edges = np.array([[[1.0, -1.0], [1.0, 1.0]], [[2.0, -1.0], [2.0, 1.0]]])
    start = np.array([0.0, 0.0])
    assert reached(start, np.array([0.5, 0.0]), edges).tolist() == [0.5, 0.0]
    assert reached(start, np.array([0.8, 0.4]), edges) == pytest.approx((1.0, 0.5))
    assert reached(start, np.array([1.5, 0.0]), edges) == pytest.approx((1.0, 0.0))


def test_a_crack_that_would_part_the_body_comes_to_rest():
    scene = growing("inclined_crack", Growth(20.0), beta=0.0)
    result = geofem.run(scene, "xfem", n=20, grading=1.0, da=3.0)
    assert result.status == "ok" and "no longer held" in result.message
    assert result.history["t"][-1] == 6.0 and result.qoi["KI"] > 6.0


def test_a_crack_that_reaches_the_side_has_no_tip_any_more():
    """In a plate whose ends are held and pulled apart, so that its halves stand alone."""
    scene = growing("inclined_crack", Growth(20.0), beta=0.0)
    top, bottom = (load.where for load in scene.loads)
    held = [Support(f"bottom{i}", bottom, (i,)) for i in (0, 1)] + [Support("top0", top, (0,))]
    pulled = Support("top1", top, (1,), lambda x, t: np.full(x.shape[1], 0.1))
    scene = replace(scene, supports=(*held, pulled), loads=())
    result = geofem.run(scene, "xfem", n=20, grading=1.0, da=3.0)
    assert result.status == "ok" and "no crack has a tip" in result.message and result.qoi["KI"] == 0.0
    assert result.history["t"][-1] < 12.0


def test_nothing_grows_below_the_threshold():
    result = geofem.run(growing("edge_crack", Growth(0.2, threshold=10.0)), "xfem", n=20)
    assert result.status == "ok" and "threshold" not in result.message and "up to 10" in result.message
    assert result.history["t"].tolist() == [0.0]


def test_a_growing_run_goes_on_from_its_state():
    scene = growing("inclined_crack", Growth(0.8, paris=(1e-3, 3.0)), beta=30.0)
    first, second = (methods.get("xfem").build(scene, n=20, da=0.2) for _ in range(2))
    first.step(0.2)
    second.restore(first.state())
    for model in (first, second):
        model.step(0.2)
    np.testing.assert_allclose(second.paths()[0], first.paths()[0], rtol=0, atol=1e-12)
    assert second.t == first.t and second.propagation.cycles == pytest.approx(first.propagation.cycles, rel=1e-10)
    assert second.energy() == pytest.approx(first.energy(), rel=1e-10)


def test_two_tips_that_meet_another_crack_stop_there():
    """A crack that grows into one across its way; that one goes on, and its other end too."""
    scene = scenes.get("inclined_crack")(beta=0.0)
    scene = replace(scene, cracks=(*scene.cracks, Crack(((2.0, -1.0), (2.05, 1.2)))), growth=Growth(1.0, threshold=1.0))
    *_, last = geofem.grow(scene, n=40, da=0.4)
    met = last.path[0][-1]
    assert 1.9 < met[0] < 2.1 and len(last.tips) < 4
    a, b = np.array([2.0, -1.0]), np.array([2.05, 1.2])
    assert abs(np.linalg.det([b - a, met - a])) < 1e-9


def test_a_run_that_was_stopped_goes_on(tmp_path):
    scene = growing("edge_crack", Growth(0.1, paris=(1e-3, 3.0)), a=0.3)
    whole = geofem.run(scene, "xfem", n=20, da=0.025)
    model = methods.get("xfem").build(scene, n=20, da=0.025)
    run = Run(scene, model, Result("edge_crack", "xfem", knobs={**scene.knobs, "n": 20, "da": 0.025}), tmp_path, False, 0)
    run.sample()
    for _ in range(2):
        model.step(0.025)
        run.sample()
    run.checkpoint()
    rest = geofem.run(scene, "xfem", n=20, da=0.025, out=tmp_path, resume=True)
    for name in whole.history:
        np.testing.assert_allclose(rest.history[name], whole.history[name], rtol=1e-9, atol=1e-12)


def test_what_cannot_grow_is_said():
    for law in (
        {"length": 0.0}, {"length": 1.0, "criterion": "any"}, {"length": 1.0, "toughness": 1.0, "paris": (1.0, 3.0)},
        {"length": 1.0, "paris": (0.0, 3.0)}, {"length": 1.0, "threshold": -1.0}, {"length": 1.0, "strength": 1.0},
    ):  # fmt: skip
        with pytest.raises(Mistake, match="Growth"):
            Growth(**law)
    with pytest.raises(Mistake, match="no crack"):
        growing("cook", Growth(1.0))
    born = growing("cook", Growth(1.0, strength=1.0, germ=1.0))
    assert "new cracks" in methods.get("fem").refuses(born)
    plain = replace(born, plane="plane_strain", loads=())
    assert "no cracks" in methods.get("mpm-gimp").refuses(plain)
    with pytest.raises(Mistake, match="until"):
        next(geofem.grow("edge_crack"))
    with pytest.raises(Mistake, match="mpm-linear"):
        next(geofem.grow("edge_crack", "mpm-linear", until=1.0))
    with pytest.raises(Mistake, match="da"):
        geofem.run("edge_crack", "xfem", da=0.1)
    with pytest.raises(Mistake, match="steps"):
        geofem.run(growing("edge_crack", Growth(0.1)), "xfem", steps=3)


# --- births -----------------------------------------------------------------------------------------------------------
def plate_with_a_hole(law):
    """A square of 10 with a hole of radius 1 in its middle, pulled by 1 at its top and bottom."""
    scene = scenes.get("inclined_crack")()
    shape = Polygon(((-5.0, -5.0), (4.0, -5.0), (5.0, -5.0), (5.0, -4.0), (5.0, 5.0), (-5.0, 5.0)), (Disc((0.0, 0.0), 1.0),))
    ends = [lambda x: x[1] > 5.0 - 1e-9, lambda x: x[1] < -5.0 + 1e-9]
    held = [lambda x: (x[0] > 5.0 - 1e-9) & (x[1] < -4.0 + 1e-9), lambda x: (x[1] < -5.0 + 1e-9) & (x[0] > 4.0 - 1e-9)]
    return Scene(
        name="hole",
        regions=(replace(scene.regions[0], shape=shape),),
        length=10.0,
        supports=tuple(Support(f"u{i}", where, (i,)) for i, where in enumerate(held)),
        loads=tuple(Load("traction", (0.0, sign), where=where) for sign, where in zip((1.0, -1.0), ends)),
        growth=law,
        strain="small",
    )


def test_a_crack_is_born_where_the_rim_of_a_hole_is_pulled_most():
    """On the horizontal diameter, where the stress is three times the load, and a little more in a finite plate (Kirsch 1898)."""
    steps = list(geofem.grow(plate_with_a_hole(Growth(0.5, strength=2.5, germ=0.6)), n=40, da=0.25))
    assert steps[0].path == [] and not len(steps[0].K)
    first, last = steps[1].path[0], steps[-1].path[0]
    # one of the two ends of the diameter, which are alike
    assert np.hypot(*first[0]) == pytest.approx(1.0, abs=1e-9) and abs(first[0, 1]) < 0.3
    assert np.hypot(*(first[1] - first[0])) == pytest.approx(0.6) and abs(first[1, 1] - first[0, 1]) < 0.12
    assert abs(last[-1, 0]) > 2.0 and abs(last[-1, 1]) < 0.4


def test_nothing_is_born_below_the_strength():
    steps = list(geofem.grow(plate_with_a_hole(Growth(0.5, strength=4.0, germ=0.6)), n=20, da=0.25))
    assert len(steps) == 1
    assert list(geofem.grow(plate_with_a_hole(Growth(0.5, strength=4.0, germ=0.6, toughness=1.0)), n=20, da=0.5))[0].load > 1.2


def test_a_crack_is_born_inside_across_the_tension():
    """Forces of mass pull a square apart from its middle line, where the stress is largest inside and on the rim alike."""
    square = Polygon(((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)))
    pull = Load("body", lambda x, t: np.array([np.sin(np.pi * x[1]) * (x[0] - 0.5), 0.0 * x[0]]))
    scene = plate_with_a_hole(Growth(0.2, strength=0.1, germ=0.2))
    held = (Support("x", lambda x: x[1] < 1e-9, (0,)), Support("y", lambda x: x[1] < 1e-9, (1,)))
    region = replace(scene.regions[0], shape=square)
    scene = replace(scene, regions=(region,), length=1.0, supports=held, loads=(pull,))
    *_, last = geofem.grow(scene, n=20, da=0.1)
    path = last.path[0]
    assert np.abs(path[:, 0] - 0.5).max() < 0.1 and 0.3 < path[:, 1].mean() < 0.9
    assert len(last.tips) == 2 and np.ptp(path[:, 1]) == pytest.approx(0.2 + 2 * 0.2, abs=1e-3)


# --- scenes -----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("a", "b"), [(1.5, 5.0), (1.0, 6.0)])
def test_three_holes_are_passed_in_their_order(a, b):
    result = geofem.run("three_holes", "xfem", a=a, b=b, n=30, da=0.15)
    x, y = result.history["x"], result.history["y"]
    assert result.status == "ok"
    if b == 5.0:  # right of the lower hole once past it, and right of the middle one
        assert 0.05 < result.qoi["lower"] < 0.2 and 0.03 < result.qoi["middle"] < 0.2
        assert np.interp(-0.5, y, x) > -4.2 and np.interp(0.75, y, x) > -3.75
    else:  # far left of the lower one, into the middle one from the left
        assert result.error["lower"] < 0.02 and result.qoi["middle"] == 0.0 and "tip" in result.message
        assert (x[-1], y[-1]) == pytest.approx((-4.212, 0.621), abs=0.05)


def test_shear_turns_the_notch_by_the_angle_of_the_criterion():
    for criterion in ("hoop", "symmetry"):
        result = geofem.run("sen_shear", "xfem", criterion=criterion, n=20, da=0.03)
        assert result.error["kink"] < 1e-4 and result.error["KI"] < 1e-3
        assert result.qoi["chord"] == pytest.approx(66.7, abs=0.7)


def test_cycles_of_paris_law():
    result = geofem.run("fatigue_plate", "xfem", n=40, da=0.0025)
    assert result.error["cycles"] < 0.015 and result.error["KI"] < 0.006


def test_two_cracks_mirror_each_other():
    result = geofem.run("bouchard_double_edge", "xfem", n=30, da=0.1)
    assert result.error["skew"] < 0.02 and result.error["KI"] < 0.015
    assert max(result.error["x"], result.error["y"]) < 0.06
