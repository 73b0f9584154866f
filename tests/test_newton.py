"""Newton's method with backtracking and step cuts: what it must survive, what it counts, and how it reports the end.

A bar of Hencky's material has a largest dead load: its nominal stress E ln(l) / l is greatest at the stretch l = e, where it
is E / e (Considere). Beyond that load there is no equilibrium, which makes an exact breakdown.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from blocks import RUBBER, STEEL, block, last, solved

import geofem
from geofem import Load, Material, Scene
from geofem.core import newton
from geofem.methods import get
from geofem.mistake import Breakdown
from geofem.scenes._parts import at_least

BAR = Material("hencky", 1.0, {"E": 1000.0, "nu": 0.0})
GREATEST = 1000.0 / math.e


def pulled(load: float, **keywords: object) -> Scene:
    """A bar on rollers under a dead load (Pa) at its end that grows with t; it reports the stress."""
    loads = (Load("traction", (load, 0.0), where=at_least(0, 1.0)),)
    return replace(block(2, BAR, loads=loads, at=lambda t: {"stress": load * t}), **keywords)


def stretch(load: float) -> float:
    """The stretch of the bar in equilibrium with a load: E ln(l) / l = load, l < e."""
    l = 1.0
    for _ in range(200):
        l = math.exp(load * l / 1000.0)
    return l


def test_a_nonlinear_bar_is_solved_to_the_tolerance() -> None:
    for tolerance, error in ((1e-4, 1e-3), (1e-9, 1e-8)):
        result = solved(pulled(0.8 * GREATEST), n=1, order=1, tolerance=tolerance)
        assert last(result, "u0")[0] == pytest.approx(stretch(0.8 * GREATEST) - 1, rel=error)
        assert result.checks["momentum"] <= tolerance


def test_newton_converges_quadratically() -> None:
    # a consistent tangent doubles the digits: from 1e-3 to 1e-12 it takes two or three more iterations
    rough, fine = (solved(pulled(0.5 * GREATEST), n=1, order=1, steps=1, tolerance=t).work["newton"] for t in (1e-3, 1e-12))
    assert fine - rough <= 3


def test_linear_elasticity_takes_one_iteration() -> None:
    result = solved("cook", variant="A", n=4)
    assert (result.work["steps"], result.work["newton"], result.work["linear"], result.work["cuts"]) == (1, 1, 1, 0)


# --- cuts and recovery ------------------------------------------------------------------------------------------------
def test_a_step_that_is_too_large_is_cut_and_ends_where_small_ones_do() -> None:
    # in one step the tip of a strip under P = 20 would fly off by many times its length; from P = 50 it may come to rest folded,
    # which is a balance too, but another one
    bold, careful = (solved("cantilever", P=20, slenderness=20, n=1, steps=steps) for steps in (1, 32))
    assert bold.work["cuts"] > 0 and bold.work["steps"] > 1
    assert careful.work["cuts"] == 0 and careful.work["steps"] == 32
    # an elastic state does not depend on the path: whatever a failed attempt left behind would show
    assert bold.qoi["tip"] == pytest.approx(careful.qoi["tip"], rel=1e-7)


def test_a_failed_attempt_leaves_the_last_good_state() -> None:
    model = get("fem").build(pulled(2.0 * GREATEST), n=1, order=1, steps=8)
    for _ in range(3):
        model.step(0.125)
    good = {name: np.array(value) for name, value in model.state().items()}
    u0 = model.probe(pulled(1.0).probes[0])
    with pytest.raises(Breakdown):
        while True:
            model.step(model.dt())
            good = {name: np.array(value) for name, value in model.state().items()}
            u0 = model.probe(pulled(1.0).probes[0])
    after = model.state()
    for name in good:
        if name not in ("work", "numbers"):
            np.testing.assert_array_equal(after[name], good[name], err_msg=name)
    assert after["numbers"][0] == good["numbers"][0]  # t
    assert model.probe(pulled(1.0).probes[0]) == u0


def test_a_failed_attempt_is_no_part_of_the_history_of_plastic_points() -> None:
    # one step that must be cut and many small ones tell the same collapse load; trial history that was kept would harden or
    # soften nothing here but move the stress: within the tolerance of Newton
    loads = [solved("footing", n=2, steps=steps).qoi["Nc"] for steps in (1, 12)]
    assert loads[0] == pytest.approx(loads[1], rel=2e-3)


# --- breakdown --------------------------------------------------------------------------------------------------------
def test_beyond_the_greatest_load_the_run_ends_as_a_result_that_says_where() -> None:
    result = geofem.run(pulled(1.5 * GREATEST), "fem", n=1, order=1, steps=8)
    assert result.status == "failed" and result.cause == "newton"
    # steps are cut to a thousandth of an eighth: the load at the end is that close to the greatest one, from below
    assert GREATEST * (1 - 1e-3) < result.at["stress"] <= GREATEST * (1 + 1e-9)
    assert result.at["t"] == pytest.approx(result.at["stress"] / (1.5 * GREATEST))
    assert f"t = {result.at['t']:.4g}" in result.message
    assert result.history["t"][-1] == result.at["t"] and result.work["cuts"] >= 10
    # and what was reached is an equilibrium
    assert last(result, "u0")[0] == pytest.approx(stretch(result.at["stress"]) - 1, rel=1e-3)


def test_losing_equilibrium_is_what_a_collapse_scene_asks_for() -> None:
    result = solved(pulled(1.5 * GREATEST, collapse=True), n=1, order=1, steps=8)
    assert result.cause is None and result.at["stress"] == pytest.approx(GREATEST, rel=1e-3)


@pytest.mark.parametrize("strain", ["small", "finite"])
def test_a_body_that_nothing_holds_is_a_breakdown_and_no_answer(strain: str) -> None:
    # no equilibrium of a free body under a load: the tangent is singular, whatever the factorisation makes of it
    load = (Load("traction", (1.0, 0.0), where=at_least(0, 1.0)),)
    result = geofem.run(block(2, STEEL if strain == "small" else RUBBER, (), load), "fem", n=2)
    assert result.status == "failed" and result.cause == "newton"


def test_iterations_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(newton, "MAX_ITERATIONS", 1)
    result = geofem.run(pulled(0.9 * GREATEST), "fem", n=1, order=1, steps=1)
    # one iteration an attempt, about ten halvings of the step
    assert result.status == "failed" and result.work["newton"] == result.work["cuts"] <= 11
