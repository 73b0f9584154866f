"""Elastodynamics by finite elements: periods, energies, orders of convergence in space and time, and where meshes tangle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from blocks import RUBBER, STEEL, block, last, solved

import geofem
from geofem import Box, Load, Material, Probe, Region, Scene, Support, scenes
from geofem.scenes._parts import at_most

LENGTH, E, DENSITY = 4.0, 100.0, 1.0


# --- scenes -----------------------------------------------------------------------------------------------------------
def test_bar_keeps_its_period_and_its_energy_over_ten_periods() -> None:
    result = solved("axial", n=16, steps=100)
    # the trapezoidal rule lengthens the period by (omega dt)**2 / 12 = 3.3e-4 (Hughes 1987, ch. 9)
    assert result.error["period"] < 1e-3
    assert result.checks["energy"] < 1e-3


def test_falling_beam_follows_its_reference() -> None:
    errors = [solved("beam_drop", n=n).error["tip"] for n in (2, 4)]
    # default steps: their error falls at order 2, and with it the whole
    assert errors[1] < 0.006 and errors[1] < errors[0] / 2.5


@pytest.mark.slow
@pytest.mark.parametrize("order, meshes, steps, least", [(1, (4, 8), (100, 200), 1.7), (2, (3, 6), (75, 150), 2.7)])
def test_vortex_converges_at_the_order_of_the_element(order: int, meshes: tuple, steps: tuple, least: float) -> None:
    errors = [solved("vortex", A=0.2, order=order, n=n, steps=s).error["displacement"] for n, s in zip(meshes, steps)]
    # order + 1 for displacements, the nominal order less .3 on meshes this coarse; halving the steps changes the finest error by a quarter
    assert np.log2(errors[0] / errors[1]) > least


def test_vortex_of_full_amplitude_tangles_bilinear_cells_at_their_corners_and_not_quadratic_triangles() -> None:
    coarse = geofem.run("vortex", "fem", A=1.0, n=4, order=1, cell="quadrilateral")
    assert (coarse.status, coarse.cause) == ("failed", "tangle")
    # the turn reached, of the 1.0 that the motion asks for: far from none and far from all
    assert 0.1 < coarse.at["turn"] < 0.9
    assert solved("vortex", A=1.0, n=4, order=2).error["displacement"] < 0.025  # 1.9 %


@pytest.mark.parametrize("frame", ["total", "updated"])
def test_vortex_tangles_coarse_linear_triangles(frame: str) -> None:
    result = geofem.run("vortex", "fem", A=1.5, n=4, order=1, frame=frame)
    assert (result.status, result.cause) == ("failed", "tangle")
    # det F > 0 fails on the way there, near the largest turn; quadratic elements come through
    assert 1.0 < result.at["turn"] <= 1.5 and 0.2 < result.at["t"] < 0.8
    assert len(result.history["t"]) > 10 and np.all(np.isfinite(result.history["displacement_error"]))
    assert result.work["cuts"] >= 10, "the step must have been cut to a thousandth first"


@pytest.mark.parametrize(
    "name, knobs",
    [
        ("beam_drop", {"n": 2}),
        ("beam_drop", {"n": 2, "order": 1}),
        ("beam_drop", {"n": 1, "cell": "quadrilateral"}),
        ("vortex", {"A": 0.5, "n": 2, "order": 1}),
    ],
)
def test_updated_is_total_lagrangian_in_time(name: str, knobs: dict) -> None:
    # the same equations of motion; curved cells of the updated frame would make another ring, so linear ones there
    total, updated = (solved(name, frame=frame, tolerance=1e-11, **knobs) for frame in ("total", "updated"))
    for probe in (set(total.history) - {"t"}) & {"tip", "displacement_error", "kinetic", "internal"}:
        scale = np.abs(total.history[probe]).max()
        np.testing.assert_allclose(updated.history[probe], total.history[probe], rtol=0, atol=1e-8 * scale, err_msg=probe)


# --- the time integration ---------------------------------------------------------------------------------------------
def bar(velocity: str = "smooth", t_end: float = 1.0) -> Scene:
    """A linear elastic bar that is fixed at one end and starts with a velocity: its first mode, or a jump that excites all."""
    shapes = {"smooth": lambda x: np.sin(0.5 * np.pi * x[0] / LENGTH), "jump": lambda x: (x[0] > 0.5 * LENGTH) * 1.0}

    def start(x: np.ndarray) -> np.ndarray:
        return np.array([shapes[velocity](x), 0 * x[0]])

    return Scene(
        name="bar",
        regions=(Region("bar", Box((0.0, 0.0), (LENGTH, 0.5)), Material("linear_elastic", DENSITY, {"E": E, "nu": 0.0})),),
        length=LENGTH,
        supports=(Support("wall", at_most(0, 0.0), (0,)), Support("floor", at_most(1, 0.0), (1,))),
        probes=(
            Probe("tip", "displacement", at=(LENGTH, 0.0), component=0),
            Probe("speed", "velocity", at=(LENGTH, 0.0), component=0),
        ),
        strain="small",
        dynamic=True,
        t_end=t_end,
        initial_velocity=start,
    )


@pytest.mark.parametrize("rho_inf", [1.0, 0.5, 0.0])
def test_generalised_alpha_is_of_second_order(rho_inf: float) -> None:
    found = [last(solved(bar(), n=4, steps=steps, rho_inf=rho_inf), "tip")[0] for steps in (20, 40, 80)]
    # Richardson: differences of successive halvings fall by 4; the next term is of relative size (omega dt)**2 = 4e-2
    order = np.log2(abs(found[0] - found[1]) / abs(found[1] - found[2]))
    assert order == pytest.approx(2.0, abs=0.15)


def test_trapezoidal_rule_meets_the_exact_first_mode() -> None:
    result = solved(bar(), n=8, steps=400)
    omega = 0.5 * np.pi / LENGTH * np.sqrt(E / DENSITY)
    # u = sin(omega t) / omega; dt**2 omega**2 / 12 = 8e-6 of the phase
    assert last(result, "tip")[0] == pytest.approx(np.sin(omega) / omega, rel=1e-4)
    assert last(result, "speed")[0] == pytest.approx(np.cos(omega), rel=1e-3)


def test_rho_inf_of_one_keeps_the_energy_and_less_damps_it() -> None:
    energies = []
    for rho_inf in (1.0, 0.5):
        history = solved(bar("jump", 4.0), n=8, steps=100, rho_inf=rho_inf).history
        energies.append(history["kinetic"] + history["internal"])
    np.testing.assert_allclose(energies[0], energies[0][0], rtol=1e-9)  # conserved exactly, Newton's tolerance
    assert energies[1][-1] < 0.97 * energies[1][0], "a jump excites frequencies that rho_inf < 1 must damp"
    assert energies[1].max() < 1.02 * energies[1][0]


# --- bodies without supports ------------------------------------------------------------------------------------------
@pytest.mark.parametrize("frame", ["total", "updated"])
def test_free_fall_keeps_galileos_law(frame: str) -> None:
    mean = tuple(Probe(f"mean{i}", "mean_velocity", component=i) for i in range(2))
    start = lambda x: np.array([1.0 - 3.0 * (x[1] - 0.5), 3.0 * (x[0] - 0.5)])  # noqa: E731 - thrown with a spin
    thrown = block(
        2, RUBBER, (), (Load("gravity", (0.0, -10.0)),), dynamic=True, t_end=0.5, initial_velocity=start, probes=mean
    )
    history = solved(thrown, n=2, steps=20, frame=frame).history
    # linear momentum: its rate is the weight, whatever the body does; the trapezoidal rule is exact for it
    np.testing.assert_allclose(history["mean0"], 1.0, atol=1e-9)
    np.testing.assert_allclose(history["mean1"], -10.0 * history["t"], atol=1e-9 * 5)


def test_initial_acceleration_balances_the_loads() -> None:
    # a body at rest in its weight's equilibrium stays there: gravity against a traction on its base
    load = (Load("gravity", (0.0, -10.0)), Load("traction", (0.0, 20.0), where=at_most(1, 0.0)))
    floating = block(2, STEEL, (), load, dynamic=True, t_end=0.05, probes=(Probe("mean", "mean_velocity", component=1),))
    history = solved(floating, n=2, steps=10).history
    # density 2 times 10 m/s2 against 20 Pa: the centre of mass stays at rest to rounding
    np.testing.assert_allclose(history["mean"], 0.0, atol=1e-12)


def test_stiff_beam_hardly_turns() -> None:
    # a beam 100 times as stiff is 10 times as fast and moves a hundredth as far
    soft, stiff = (solved(replace(scenes.get("beam_drop")(stiffness=s), measures=()), n=2) for s in (1, 100))
    ratio = soft.history["tip"].min() / stiff.history["tip"].min()
    assert ratio == pytest.approx(100.0, rel=0.1)  # large rotation shortens the arm: a few percent
