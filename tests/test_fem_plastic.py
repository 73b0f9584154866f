"""Collapse loads and large plastic strain by finite elements against Prandtl, limit analysis, and Gibson and Anderson."""

from __future__ import annotations

import math

import numpy as np
import pytest
from blocks import block, last, rollers, solved

from geofem import Material, Support
from geofem.scenes._parts import at_least

CAPACITY = 2.0 + np.pi


# --- strip footing ----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "n, steps, dofs, error", [(4, 4, 1300, 0.015), pytest.param(6, 8, 10_000, 0.0075, marks=pytest.mark.slow)]
)
def test_graded_footing_finds_prandtls_load_with_few_unknowns(n: int, steps: int, dofs: int, error: float) -> None:
    result = solved("footing", n=n, grading=2.5, steps=steps)
    assert result.size["dofs"] <= dofs
    assert result.error["Nc"] < error
    # reduced quadratic quadrilaterals do not go below the upper bound by more than Newton's tolerance, 1e-5
    assert result.qoi["Nc"] > CAPACITY - 1e-3


def test_footing_has_a_plateau() -> None:
    # ideal plasticity: once the mechanism is there, more settlement asks for no more load
    history = solved("footing", n=4, grading=2.5, steps=8).history
    load = -history["load"]
    assert load[-1] < 1.005 * load[len(load) // 2]


def test_fully_integrated_linear_quadrilaterals_lock_under_the_footing() -> None:
    # Nagtegaal, Parks and Rice 1974: too many constraints of volume for the unknowns there are
    result = solved("footing", n=4, order=1, cell="quadrilateral", quadrature="full", steps=4)
    assert result.error["Nc"] > 0.15 and result.qoi["Nc"] > CAPACITY


# --- gravity ----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("case, n", [("ex1", 4), ("ex1", 8), pytest.param("ex2", 8, marks=pytest.mark.slow), ("undrained", 4)])
def test_slope_fails_within_two_percent_of_limit_analysis(case: str, n: int) -> None:
    result = solved("slope", case=case, n=n)
    assert result.error["FoS"] < 0.02
    # the run ends because equilibrium is lost, and says where
    assert result.at["t"] == pytest.approx(result.qoi["FoS"])


def test_vertical_cut_falls_within_two_percent_of_limit_analysis() -> None:
    coarse, fine = (solved("vertical_cut", n=n) for n in (4, 6))
    assert fine.error["N"] < 0.02
    # elements that do not lock come down to the collapse load from above
    assert coarse.qoi["N"] > fine.qoi["N"] > fine.reference["N"]["lower"]


# --- large strain -----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("frame", ["total", "updated"])
def test_cavity_expands_at_the_pressure_of_gibson_and_anderson(frame: str) -> None:
    assert solved("cavity", n=2, frame=frame).error["p_over_cu"] < 0.005


@pytest.mark.slow
@pytest.mark.parametrize("knobs", [{"Ir": 100}, {"expansion": 3, "outer": 40}], ids=str)
def test_cavity_holds_for_other_soils_and_expansions(knobs: dict) -> None:
    assert solved("cavity", n=2, **knobs).error["p_over_cu"] < 0.005


# --- one element ------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("strain", ["small", "finite"])
@pytest.mark.parametrize("gdim, law, strength", [(2, "tresca", 2.0), (3, "von_mises", math.sqrt(3.0))])
def test_compressed_block_yields_at_its_strength(strain: str, gdim: int, law: str, strength: float) -> None:
    # free sides: the stress difference is 2 c (Tresca), and sqrt(J2) = k is a stress of sqrt(3) k along one axis (von Mises)
    clay = Material(law, 1.0, {"E": 1000.0, "nu": 0.3, "c" if law == "tresca" else "k": 1.0})
    axis = gdim - 1
    press = Support("press", at_least(axis, 1.0), (axis,), lambda x, t: 0 * x[0] - 0.01 * t)
    result = solved(block(gdim, clay, (*rollers(gdim), press), strain=strain), n=1, order=1, tolerance=1e-9)
    # at finite strain the law bounds the Kirchhoff stress, larger by J, which stays within (1 - 2 nu) sigma / E = 1e-3 of 1
    tolerance = 1e-6 if strain == "small" else 2e-3
    assert last(result, {2: "yy", 3: "zz"}[gdim])[0] == pytest.approx(-strength, rel=tolerance)
    assert last(result, "xx")[0] == pytest.approx(0.0, abs=1e-6)
