"""Tessellations of nodes: the same cells whoever makes them, the old body's area to rounding, and no node lost in silence."""

from __future__ import annotations

import numpy as np
import pytest

from geofem.methods.pfem.tessellation import Tessellation, backends, simplices
from geofem.methods.pfem.tessellation.alpha import AlphaShape
from geofem.methods.pfem.tessellation.constrained import Constrained
from geofem.mistake import Mistake
from geofem.scene import Array

NATIVE = pytest.mark.skipif(backends.native() is None, reason="needs CGAL's headers")


def lattice(n: int, gdim: int = 2, jitter: float = 0.2, seed: int = 0) -> tuple[Array, Array]:
    """Nodes of the unit square or cube, n cells a side, those inside off their places by a part of the spacing; and sizes."""
    axes = np.meshgrid(*[np.arange(n + 1) / n] * gdim, indexing="ij")
    x = np.stack(axes, axis=-1).reshape(-1, gdim)
    inner = ((x > 0) & (x < 1)).all(axis=1)
    x[inner] += np.random.default_rng(seed).uniform(-jitter, jitter, (inner.sum(), gdim)) / n
    return x, np.full(len(x), 1 / n)


def assert_valid(x: Array, t: Tessellation) -> None:
    """Positive volumes, at most two cells at each facet, and a boundary that is closed."""
    assert (simplices.volumes(x, t.cells) > 0).all()
    corners = t.cells.shape[1]
    facets = np.sort(t.cells[:, simplices.FACETS[corners]].reshape(-1, corners - 1), axis=1)
    counts = np.unique(facets, axis=0, return_counts=True)[1] if len(facets) else np.zeros(0, int)
    assert counts.max(initial=0) <= 2 and (counts == 1).sum() == len(t.facets)
    if corners == 3:
        leaving, reaching = (np.bincount(t.facets[:, k], minlength=len(x)) for k in (0, 1))
        assert np.array_equal(leaving, reaching)


# --- simplices --------------------------------------------------------------------------------------------------------
def test_regular_simplices_have_quality_one_and_known_radii() -> None:
    triangle = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, np.sqrt(3) / 2]])
    tetrahedron = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, -1.0, 1.0], [-1.0, 1.0, -1.0]])
    for x, radius in ((triangle, 1 / np.sqrt(3)), (tetrahedron, np.sqrt(3.0))):
        cells = np.arange(len(x))[None]
        assert simplices.quality(x, cells) == pytest.approx(1.0, rel=1e-14)
        assert simplices.circumradii(x, cells) == pytest.approx(radius, rel=1e-14)


@pytest.mark.parametrize("gdim", [2, 3])
def test_boundary_has_the_body_on_its_left_or_behind(gdim: int) -> None:
    """By Gauss's theorem the facets give the volume, with its sign."""
    x, size = lattice(5, gdim)
    cells = backends.delaunay(x)
    facets = simplices.boundary(cells, simplices.neighbours(cells))
    corner = x[facets]
    if gdim == 2:
        volume = (corner[:, 0, 0] * corner[:, 1, 1] - corner[:, 1, 0] * corner[:, 0, 1]).sum() / 2
    else:
        volume = np.linalg.det(corner).sum() / 6
    assert volume == pytest.approx(1.0, rel=1e-13)


@pytest.mark.parametrize("gdim", [2, 3])
def test_order_and_parents_do_not_depend_on_how_cells_are_written(gdim: int) -> None:
    x, _ = lattice(4, gdim)
    cells = backends.delaunay(x)
    rng = np.random.default_rng(1)
    rows = rng.permutation(len(cells))
    even = np.array([[1, 2, 0], [2, 0, 1]]) if gdim == 2 else np.array([[1, 0, 3, 2], [0, 2, 3, 1], [3, 1, 0, 2]])
    written = np.take_along_axis(cells[rows], even[rng.integers(len(even), size=len(cells))], axis=1)
    again, old = simplices.ordered(written)
    assert np.array_equal(again, cells) and np.array_equal(np.sort(written[old], axis=1), np.sort(cells, axis=1))
    assert np.array_equal(simplices.parents(written, cells), rows)
    assert (simplices.parents(written[:3], cells[[rows[0]]]) == [0, -1, -1]).all()


# --- backends ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "gdim, backend", [(2, "compas"), pytest.param(2, "native", marks=NATIVE), pytest.param(3, "native", marks=NATIVE)]
)
def test_backends_give_the_same_cells_in_the_same_order(gdim: int, backend: str) -> None:
    x = np.random.default_rng(2).random((300, gdim))
    x[200] = x[17]
    cells = backends.delaunay(x, backend)
    assert np.array_equal(cells, backends.delaunay(x, "qhull"))
    assert 17 in cells and 200 not in cells


@pytest.mark.parametrize("x, says", [
    (np.zeros((2, 2)), "2 nodes"), (np.outer(np.arange(5.0), [1.0, 2.0]), "line"),
    (np.array([[0.0, 0], [1, 0], [0, np.nan]]), "node 2"), (np.eye(3)[[0, 1, 2, 0, 1]], "plane"),
])  # fmt: skip
def test_what_cannot_be_tessellated_is_a_mistake_in_one_line(x: Array, says: str) -> None:
    with pytest.raises(Mistake, match=says) as mistake:
        backends.delaunay(x)
    assert "\n" not in str(mistake.value)


# --- the body's area --------------------------------------------------------------------------------------------------
def test_constrained_keeps_the_area_that_an_alpha_shape_loses() -> None:
    x, size = lattice(20)
    first = Constrained()(x, size, None)
    notch = 0.3 * np.exp(-(((x[:, 0] - 0.5) / 0.1) ** 2)) * x[:, 1]
    moved = x - np.stack([0.0 * notch, notch], axis=1)
    area = simplices.volumes(moved, first.cells).sum()
    kept, alpha = Constrained()(moved, size, first), AlphaShape()(moved, size, first)
    assert_valid(moved, kept)
    assert simplices.volumes(moved, kept.cells).sum() == pytest.approx(area, rel=1e-13)
    assert abs(simplices.volumes(moved, alpha.cells).sum() / area - 1) > 1e-4
