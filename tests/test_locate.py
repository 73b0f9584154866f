"""Point location: each point is found in a cell that holds it, by bins and by walks, beside dolfinx and on random meshes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mpi4py import MPI
from scipy.spatial import Delaunay

from geofem.core.locate import KINDS, Locator

# isort: split
from dolfinx import geometry, mesh

SHAPES = {"triangle": 2, "quadrilateral": 2, "tetrahedron": 3, "hexahedron": 3}
ROUNDING = 1e-12
"""Local coordinates come from two-digit sums of coordinates of size one, divided by cells of size 0.1."""


def shape_functions(xi: np.ndarray, kind: str) -> np.ndarray:
    """(points, vertices), written apart from the code under test."""
    if kind in ("triangle", "tetrahedron"):
        return np.column_stack([1 - xi.sum(axis=1), xi])
    columns = []
    for v in range(2 ** xi.shape[1]):
        columns.append(np.prod([xi[:, a] if v >> a & 1 else 1 - xi[:, a] for a in range(xi.shape[1])], axis=0))
    return np.column_stack(columns)


def skewed(kind: str, n: int = 6) -> tuple[np.ndarray, np.ndarray, mesh.Mesh]:
    """A grid of the unit square or cube whose inner and outer nodes are moved by up to a quarter of a cell."""
    cell = getattr(mesh.CellType, kind)
    gdim = SHAPES[kind]
    domain = (
        mesh.create_unit_square(MPI.COMM_SELF, n, n, cell) if gdim == 2 else mesh.create_unit_cube(MPI.COMM_SELF, n, n, n, cell)
    )
    x = domain.geometry.x
    if gdim == 2 or kind == "tetrahedron":
        x[:, :gdim] += 0.2 / n * np.random.default_rng(1).uniform(-1, 1, (len(x), gdim))
    else:
        # faces stay plane where x is a function of x only: dolfinx takes the cells of a mesh for their convex hulls
        x[:, :3] += 0.2 / n * np.sin(2 * np.pi * 1.7 * x[:, :3])
    return x[:, :gdim].copy(), domain.geometry.dofmaps[0], domain


def inside_points(x: np.ndarray, cells: np.ndarray, kind: str, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Random points made inside known cells."""
    rng = np.random.default_rng(2)
    gdim = x.shape[1]
    owner = rng.integers(len(cells), size=count)
    if kind in ("triangle", "tetrahedron"):
        xi = rng.dirichlet(np.ones(gdim + 1), count)[:, 1:]
    else:
        xi = rng.random((count, gdim))
    return np.einsum("pv,pvi->pi", shape_functions(xi, kind), x[cells[owner]]), owner


@pytest.mark.parametrize("kind", SHAPES)
def test_every_point_is_found_in_the_cell_it_was_made_in(kind: str) -> None:
    x, cells, _ = skewed(kind)
    points, owner = inside_points(x, cells, kind, 2000)
    locator = Locator(x, cells)
    assert KINDS[x.shape[1], cells.shape[1]] == locator.kind == kind
    found = locator.find(points)
    assert np.array_equal(found, owner)  # none of the random points lies on a facet
    xi = locator.reference(points, found)
    back = np.einsum("pv,pvi->pi", shape_functions(xi, kind), x[cells[found]])
    assert np.abs(back - points).max() < ROUNDING


@pytest.mark.parametrize("kind", SHAPES)
def test_a_walk_ends_in_the_same_cell_as_the_bins_wherever_it_starts(kind: str) -> None:
    x, cells, _ = skewed(kind)
    points, owner = inside_points(x, cells, kind, 2000)
    guess = np.random.default_rng(3).integers(-1, len(cells), size=len(points))
    assert np.array_equal(Locator(x, cells).find(points, guess), owner)


@pytest.mark.parametrize("kind", SHAPES)
def test_a_walk_in_a_convex_body_hardly_needs_the_bins(kind: str) -> None:
    """Of skewed squares and cubes far away Newton's method may find a false point: some walks there end in nothing."""
    x, cells, _ = skewed(kind, 4)
    keep = np.all((x > 1e-3) & (x < 1 - 1e-3), axis=1)
    x[~keep] = np.rint(4 * x[~keep]) / 4  # the sides straight again
    points, owner = inside_points(x, cells, kind, 500)
    locator = Locator(x, cells)
    locator._starts[:] = 0  # empty bins
    assert np.all(locator.find(points) == -1)
    found = locator.find(points, np.roll(owner, 1))
    assert np.all((found == owner) | (found == -1))
    assert np.mean(found == owner) > (0.95 if kind in ("quadrilateral", "hexahedron") else 0.999)


@pytest.mark.parametrize("kind", SHAPES)
def test_dolfinx_finds_the_same_cells(kind: str) -> None:
    x, cells, domain = skewed(kind)
    points, _ = inside_points(x, cells, kind, 300)
    padded = np.zeros((len(points), 3))
    padded[:, : x.shape[1]] = points
    tree = geometry.bb_tree(domain, domain.topology.dim)
    collisions = geometry.compute_colliding_cells(domain, geometry.compute_collisions_points(tree, padded), padded)
    found = Locator(x, cells).find(points)
    assert all(cell in collisions.links(p) for p, cell in enumerate(found))


@pytest.mark.parametrize("kind", SHAPES)
def test_points_outside_and_in_a_hole_are_found_in_no_cell(kind: str) -> None:
    x, cells, _ = skewed(kind)
    gdim = x.shape[1]
    middle = x[cells].mean(axis=1)
    hole = np.abs(middle - 0.5).max(axis=1) < 0.2
    points = np.vstack([np.full(gdim, 0.5), np.full(gdim, 1.3), np.full(gdim, -4.0), np.eye(gdim)[0] * 7])
    locator = Locator(x, cells[~hole])
    assert np.all(locator.find(points) == -1)
    assert np.all(locator.find(points, np.zeros(len(points), int)) == -1)
    assert np.all(np.isnan(locator.reference(points, locator.find(points))))


def test_a_walk_around_a_hole_arrives() -> None:
    x, cells, _ = skewed("triangle", 12)
    kept = cells[np.abs(x[cells].mean(axis=1) - 0.5).max(axis=1) > 0.3]
    points, owner = inside_points(x, kept, "triangle", 500)
    across = np.roll(np.arange(len(kept)), len(kept) // 2)[owner]
    assert np.array_equal(Locator(x, kept).find(points, across), owner)


@pytest.mark.parametrize("kind", SHAPES)
def test_nodes_and_corners_of_the_mesh_belong_to_a_cell(kind: str) -> None:
    x, cells, _ = skewed(kind)
    locator = Locator(x, cells)
    found = locator.find(x)
    xi = locator.reference(x, found)
    assert np.all(found >= 0)
    assert np.abs(np.rint(xi) - xi).max() < 1e-10  # a node is a vertex of its cell


@pytest.mark.parametrize("kind", SHAPES)
def test_neighbours_are_mutual_and_share_a_facet(kind: str) -> None:
    x, cells, _ = skewed(kind)
    n = Locator(x, cells).neighbours
    shared = {"triangle": 2, "quadrilateral": 2, "tetrahedron": 3, "hexahedron": 4}[kind]
    for c, row in enumerate(n):
        for other in row[row >= 0]:
            assert c in n[other]
            assert len(set(cells[c]) & set(cells[other])) == shared
    boundary = {"triangle": 24, "quadrilateral": 24, "tetrahedron": 6 * 72, "hexahedron": 6 * 36}[kind]
    assert np.sum(n < 0) == boundary


def test_a_flat_cell_holds_nothing() -> None:
    x = np.array([[0.0, 0], [1, 0], [0, 1], [2, 0]])
    cells = np.array([[0, 1, 3], [0, 1, 2]])
    assert Locator(x, cells).find(np.array([[0.2, 0.2], [0.0, 0.0], [1.5, 0.0]])).tolist() == [1, 1, -1]


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(4, 200), gdim=st.sampled_from([2, 3]), graded=st.booleans())
def test_random_delaunay_meshes_agree_with_their_own_search(seed: int, count: int, gdim: int, graded: bool) -> None:
    """Any cell of any size: where Qhull's own search finds a cell, ours finds one that holds the point, and the reverse."""
    rng = np.random.default_rng(seed)
    x = rng.random((count + gdim, gdim)) ** (4 if graded else 1)
    hull = Delaunay(x)
    if not len(hull.simplices) or len(hull.coplanar):
        return
    volume = np.abs(np.linalg.det(x[hull.simplices[:, 1:]] - x[hull.simplices[:, :1]]))
    points = rng.random((200, gdim))
    locator = Locator(x, hull.simplices, hull.neighbors)
    found = locator.find(points, rng.integers(-1, len(hull.simplices), 200))
    xi = locator.reference(points, found)
    weights = shape_functions(xi[found >= 0], "triangle")
    # 1e-10 is the tolerance of the search itself
    assert weights.min(initial=0.0) >= -1e-9
    sound = volume.min() > 1e-9  # Qhull may lose points in slivers, and so may we
    assert not sound or np.array_equal(found >= 0, hull.find_simplex(points, tol=1e-10) >= 0)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_random_convex_quadrangle_is_inverted_exactly(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.uniform(0, 2 * np.pi, 4))
    if np.diff(angle, append=angle[0] + 2 * np.pi).max() > 0.9 * np.pi or np.diff(angle).min() < 0.2:
        return
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    x, cells = ring, np.array([[0, 1, 3, 2]])
    xi = rng.random((50, 2))
    points = shape_functions(xi, "quadrilateral") @ x[cells[0]]
    locator = Locator(x, cells)
    assert np.all(locator.find(points) == 0)
    # the smallest Jacobian of these shapes is about 0.02
    assert np.abs(locator.reference(points, np.zeros(50, int)) - xi).max() < 1e-10
