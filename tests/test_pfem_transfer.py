"""History of cells from one tessellation to the next: what is kept, what is spread."""

from __future__ import annotations

import numpy as np
import pytest

from geofem.methods.pfem.transfer import averaged, copied
from geofem.methods.pfem.vortex import turned

SQUARE = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
OLD, NEW = np.array([[0, 1, 2], [0, 2, 3]]), np.array([[0, 1, 3], [1, 2, 3]])
"""The two diagonals of a square."""


def centroids(x: np.ndarray, cells: np.ndarray) -> np.ndarray:
    return x[cells].mean(axis=1)


def test_unchanged_cells_keep_their_values_to_the_last_bit() -> None:
    values = np.random.default_rng(0).normal(size=(2, 3))
    kept = copied(values, np.array([1, 0]), centroids(SQUARE, OLD), centroids(SQUARE, OLD[::-1]))
    assert np.array_equal(kept, values[::-1])


def test_a_new_cell_takes_the_value_of_the_nearest() -> None:
    x = SQUARE + [[0, 0], [0.2, 0], [0, 0], [0, 0.1]]
    values = np.array([1.0, 2.0])
    found = copied(values, np.array([-1, -1]), centroids(x, OLD), centroids(x, NEW))
    for value, c in zip(found, centroids(x, NEW)):
        assert value == values[np.linalg.norm(centroids(x, OLD) - c, axis=1).argmin()]


@pytest.mark.parametrize("shape", [(), (4,), (2, 2)])
def test_both_keep_a_constant(shape: tuple[int, ...]) -> None:
    values = np.broadcast_to(np.random.default_rng(1).normal(size=shape), (2, *shape)).copy()
    parents = np.array([-1, -1])
    assert np.array_equal(copied(values, parents, centroids(SQUARE, OLD), centroids(SQUARE, NEW)), values)
    assert np.allclose(averaged(values, OLD, np.array([0.5, 0.5]), NEW, 4), values, rtol=1e-15, atol=0)


def test_averaging_spreads_even_where_nothing_changed() -> None:
    found = averaged(np.array([1.0, 0.0]), OLD, np.array([0.5, 0.5]), OLD, 4)
    assert np.allclose(found, [2 / 3, 1 / 3])


def test_averaging_leaves_out_nodes_that_are_new() -> None:
    cells = np.array([[0, 1, 4]])
    assert averaged(np.array([3.0, 3.0]), OLD, np.array([0.5, 0.5]), cells, 5) == pytest.approx([3.0])
    with pytest.raises(ValueError, match="no node in common"):
        averaged(np.array([3.0, 3.0]), OLD, np.array([0.5, 0.5]), np.array([[4, 5, 6]]), 7)


def test_one_turn_of_a_vortex_spares_what_is_copied_and_flattens_what_is_averaged() -> None:
    """3 % of the cells change in a step, so that copying errs where there is change and averaging everywhere."""
    kept, spread = (turned("pfem", turns=1.0, way=way) for way in ("copied", "averaged"))
    assert kept["peak"] < 0.2 and kept["error"] < 0.2
    assert spread["peak"] > 0.5 and spread["error"] > 0.5
    assert kept["changed"] == spread["changed"] < 0.05


def test_error_of_copying_falls_with_the_size_of_the_cells() -> None:
    coarse, fine = (turned("pfem", turns=1.0, n=n) for n in (20, 40))
    assert fine["error"] < 0.65 * coarse["error"]
