"""Surface tension, a yield stress and a second dam by pfem: exact frequencies, theories of plastic layers, an experiment."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import geofem
from geofem import Result
from geofem.methods.pfem.flow import surface_force, surface_stiffness

SQUARE = np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])


def run(scene: str, **knobs: Any) -> Result:
    result = geofem.run(scene, method="pfem", **knobs)
    assert result.status == "ok", (result.cause, result.message)
    return result


@pytest.mark.parametrize("facets, gdim", [(SQUARE, 2), (TETRAHEDRON, 3)])
def test_surface_force_and_stiffness_are_derivatives_of_the_area(facets: np.ndarray, gdim: int) -> None:
    x = np.random.default_rng(0).normal(size=(4, gdim))
    h, tension = 1e-6, 0.7

    def area(x: np.ndarray) -> float:
        corner = x[facets]
        edge = corner[:, 1:] - corner[:, :1]
        each = np.linalg.norm(edge[:, 0] if gdim == 2 else 0.5 * np.cross(edge[:, 0], edge[:, 1]), axis=1)
        return tension * float(each.sum())

    force, stiffness = surface_force(x, facets, tension), surface_stiffness(x, facets, tension)
    for node in range(4):
        for axis in range(gdim):
            step = np.zeros_like(x)
            step[node, axis] = h
            assert (area(x + step) - area(x - step)) / (2 * h) == pytest.approx(-force[node, axis], abs=1e-8)
            change = (surface_force(x + step, facets, tension) - surface_force(x - step, facets, tension))[node] / (2 * h)
            assert np.allclose(-change, stiffness[node, :, axis], atol=1e-8)


def test_a_disc_swings_with_rayleighs_frequency_and_the_damping_of_its_viscosity() -> None:
    result = run("square_drop", shape="disc", n=5)
    assert result.error["frequency"] < 0.006 and result.error["damping"] < 2e-3
    assert abs(result.checks["volume"]) < 1e-10


def test_mud_stops_where_its_yield_stress_holds_it() -> None:
    """Between the hydrostatic theory and the one with normal stresses, close to the latter."""
    result = run("bingham_slump", n=6)
    assert result.error["run_out"] == result.error["height"] == 0.0
    assert result.qoi["rest"] < 1e-3 and abs(result.checks["volume"]) < 1e-6


def test_grains_run_as_far_as_another_solver_of_their_rheology_says_and_come_to_rest() -> None:
    result = run("column_collapse", setup="lagree", n=6)
    assert result.error["run_out"] < 0.15 and result.error["height"] < 0.03
    assert abs(result.history["mean_velocity"][-1]) < 1e-3
    assert abs(result.checks["volume"]) < 1e-5 and result.checks["energy"] < 0.03


def test_front_of_koshizukas_dam_break() -> None:
    result = run("dam_break", setup="koshizuka", n=10)
    assert result.error["front"] < 0.05 and result.qoi["volume"] < 1e-3
