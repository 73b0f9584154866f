"""Tessellations of nodes: the same cells whoever makes them, the old body's area to rounding, and no node lost in silence."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geofem.core.locate import Locator
from geofem.methods.pfem.tessellation import Tessellation, Tessellator, backends, simplices, slivers
from geofem.methods.pfem.tessellation.alpha import AlphaShape
from geofem.methods.pfem.tessellation.constrained import Constrained
from geofem.methods.pfem.tessellation.inside import InsideBody
from geofem.methods.pfem.tessellation.winding import enclosed_volume, winding
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


def test_without_a_compiler_the_wheel_and_qhull_stand_in(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CXX", "no-such-compiler")
    monkeypatch.setattr(backends, "native", backends.native.__wrapped__)
    for gdim in (2, 3):
        x = np.random.default_rng(4).random((50, gdim))
        assert np.array_equal(backends.delaunay(x), backends.delaunay(x, "qhull"))
    with pytest.raises(Mistake, match="apt-get install -y g.. libcgal-dev"):
        backends.delaunay(x, "native")
    with pytest.raises(Mistake, match="plane only"):
        backends.delaunay(x, "compas")


def test_library_is_compiled_whole_or_not_at_all_and_found_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Four who compile at once, with a slow compiler that writes its output in two parts."""
    compiler = tmp_path / "compiler"
    compiler.write_text('#!/bin/sh\nwhile [ "$1" != -o ]; do shift; done\necho one > $2; sleep 0.2; echo two >> $2\n')
    compiler.chmod(0o755)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("CXX", str(compiler))
    path = backends.library_path()
    assert path is not None
    with ThreadPoolExecutor() as pool:
        work = [pool.submit(backends.compile_to, path) for _ in range(4)]
        while not all(job.done() for job in work):
            assert not path.exists() or path.read_text() == "one\ntwo\n"
    assert [job.exception() for job in work] == [None] * 4 and list(path.parent.iterdir()) == [path]
    assert backends.library_path() == path
    monkeypatch.setenv("CXX", f"{compiler} -march=native")
    assert backends.library_path() != path


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


def star(radii: Array, inner: Array) -> tuple[Array, Array]:
    """A star-shaped polygon of these radii, and nodes inside of it at (share of the radius, angle); and the directed edges."""
    k = len(radii)
    angle = 2 * np.pi * np.arange(k) / k
    rim = radii[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    place, share = inner[:, 1] * k, 0.9 * np.sqrt(inner[:, 0])
    side = place.astype(int) % k
    along = (place - np.floor(place))[:, None]
    nodes = share[:, None] * ((1 - along) * rim[side] + along * rim[(side + 1) % k])
    return np.concatenate([rim, nodes]), np.stack([np.arange(k), (np.arange(k) + 1) % k], axis=1)


@settings(max_examples=60, deadline=None)
@given(st.integers(5, 40), st.integers(0, 60), st.floats(0.0, 0.3), st.integers(0, 2**32 - 1))
def test_constrained_keeps_the_area_of_any_star_that_moves_a_little(sides: int, inner: int, rough: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, edges = star(1 + rough * rng.uniform(-1, 1, sides), rng.random((inner, 2)))
    size = np.full(len(x), np.pi / sides)
    body = Tessellation(np.empty((0, 3), np.int64), edges, np.empty(0, np.int64))
    way = Constrained()
    t = way(x, size, body)
    for _ in range(3):
        x = x + 2e-3 / sides * rng.uniform(-1, 1, x.shape)
        rim = x[edges]
        area = (rim[:, 0, 0] * rim[:, 1, 1] - rim[:, 1, 0] * rim[:, 0, 1]).sum() / 2
        t = way(x, size, t)
        assert_valid(x, t)
        assert simplices.volumes(x, t.cells).sum() == pytest.approx(area, rel=1e-12)
        assert np.array_equal(np.sort(t.facets, axis=0), np.sort(edges, axis=0))
    assert way.seen["crossed"] == way.seen["doubtful"] == way.seen["loose"] == 0


def test_edges_are_those_of_a_constrained_triangulation_by_cgal() -> None:
    """The wheel's own one, which takes one polygon: the same triangles as edges put in by flips."""
    from compas_cgal import _triangulation, _types_std

    rng = np.random.default_rng(3)
    x, edges = star(1 + 0.8 * rng.uniform(-1, 1, 60), rng.random((300, 2)))
    padded = np.column_stack([x, np.zeros(len(x))])
    nothing = _types_std.VectorRowMatrixXd()
    nodes, found = _triangulation.constrained_delaunay_triangulation(padded[:60], padded, nothing, nothing, False)
    number = {tuple(place): k for k, place in enumerate(x)}
    theirs = np.array([number[tuple(place)] for place in nodes[:, :2]])[found.astype(int)]
    cells, sides, refused = backends.constrained(x, edges)
    assert not refused.any()
    assert np.array_equal(simplices.ordered(theirs)[0], cells[sides > 0])


def square(moved: tuple[float, float]) -> tuple[Array, Array, Tessellation, int]:
    """A square of 10 x 10 cells, one of whose nodes next to the upper side has gone elsewhere; its cells before that."""
    x, size = lattice(10, jitter=0.0)
    old = Constrained()(x, size, None)
    node = int(np.argmin(np.linalg.norm(x - [0.5, 0.9], axis=1)))
    x[node] = moved
    return x, size, old, node


def test_node_on_the_boundary_divides_its_edge() -> None:
    for height in (1.0, np.nextafter(1.0, 0.0), 1.0 - 1e-14):
        x, size, old, node = square((0.55, height))
        way = Constrained()
        t = way(x, size, old)
        assert_valid(x, t)
        assert node in t.facets and simplices.volumes(x, t.cells).sum() == pytest.approx(1.0, rel=1e-12)


def test_node_that_slips_out_is_caught_and_one_that_flies_off_is_counted() -> None:
    x, size, old, node = square((0.55, 1.003))
    way = Constrained()
    assert node in way(x, size, old).cells and way.seen["caught"] == 1
    x, size, old, node = square((0.55, 1.3))
    way = Constrained()
    assert node not in way(x, size, old).cells and way.seen["loose"] == 1


def test_bodies_that_touch_node_on_node_are_one_and_keep_their_area() -> None:
    x, size = lattice(6)
    one = Constrained()(x, size, None)
    n = len(x)
    both = np.concatenate([x, x + [1.0, 0.0]])
    facets = np.concatenate([one.facets, one.facets + n])
    old = Tessellation(np.concatenate([one.cells, one.cells + n]), facets, np.full(2 * len(one.cells), -1))
    way = Constrained()
    t = way(both, np.tile(size, 2), old)
    assert_valid(both, t)
    assert simplices.volumes(both, t.cells).sum() == pytest.approx(2.0, rel=1e-13) and len(t.facets) == len(facets) - 12
    assert way.seen["doubtful"] == way.seen["crossed"] == 0 and way.seen["loose"] == 7  # the later nodes of the interface


def test_boundary_that_crosses_itself_still_gives_a_mesh() -> None:
    """A node of the upper side goes down through the lower one: what edges do not tell, the winding number does."""
    x, size = lattice(10, jitter=0.0)
    old = Constrained()(x, size, None)
    node = int(np.argmin(np.linalg.norm(x - [0.5, 1.0], axis=1)))
    x[node] = (0.5, -0.2)
    way = Constrained()
    t = way(x, size, old)
    assert_valid(x, t)
    assert way.seen["crossed"] == 2
    assert simplices.volumes(x, t.cells).sum() == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("gdim", [2, 3])
def test_winding_tells_the_inside_as_cells_do_also_straight_below_nodes_and_edges(gdim: int) -> None:
    x, size = lattice(10, gdim)
    x = x[np.linalg.norm(x - 0.5, axis=1) > 0.3]
    t = AlphaShape(1.1)(x, size[: len(x)], None)
    # no side is upright, so that no point is on the boundary, though all have the first coordinates of its nodes and edges
    x[:, :-1] += 0.03 * np.sin(5 * x[:, -1:]) * (x[:, :-1] - 2)
    places = np.concatenate([x[t.facets[:, 0]], x[t.facets[:, :2]].mean(axis=1), x[t.facets].mean(axis=1)])
    rng = np.random.default_rng(5)
    points = np.concatenate([places[rng.integers(len(places), size=500)], rng.random((500, gdim))])
    points[:, -1] = rng.uniform(-0.1, 1.1, len(points))
    inside = Locator(x, t.cells).find(points) >= 0
    assert np.array_equal(winding(x, t.facets, points), inside) and 200 < inside.sum() < 800
    assert enclosed_volume(x, t.facets) == pytest.approx(simplices.volumes(x, t.cells).sum(), rel=1e-12)
    # a body twice is wound round twice
    assert np.array_equal(winding(x, np.concatenate([t.facets, t.facets]), points), 2 * inside)


# --- space ------------------------------------------------------------------------------------------------------------
def test_delaunay_of_space_keeps_slivers_and_swaps_remove_them() -> None:
    x, _ = lattice(8, 3, jitter=0.25)
    cells = backends.delaunay(x)
    mended = slivers.swapped(x, cells, 0.1)
    before, after = ((simplices.quality(x, c) < 0.1).sum() for c in (cells, mended))
    assert before > 20 and after <= 0.1 * before
    assert (simplices.volumes(x, mended) > 0).all()
    assert simplices.volumes(x, mended).sum() == pytest.approx(1.0, rel=1e-13)
    # an edge of few good cells is left with few bad ones, but its radius never told which: they are as round as others
    bad = simplices.quality(x, cells) < 0.1
    assert simplices.circumradii(x, cells)[bad].min() < 1.2 / 8


@pytest.mark.parametrize("gdim, n", [(2, 16), (3, 6)])
def test_inside_body_keeps_the_volume_that_an_alpha_shape_makes_and_loses(gdim: int, n: int) -> None:
    """The upper side is dented, step by step."""
    worst = {}
    for way in (InsideBody(), AlphaShape()):
        x, size = lattice(n, gdim)
        t: Tessellation = way(x, size, None)
        dent = np.zeros_like(x)
        dent[:, -1] = -0.06 * np.exp(-(((x[:, 0] - 0.5) / 0.2) ** 2)) * x[:, -1]
        made = [0.0]
        for _ in range(8):
            x = x + dent
            before = simplices.volumes(x, t.cells).sum()
            t = way(x, size, t)
            assert_valid(x, t)
            made.append(made[-1] + simplices.volumes(x, t.cells).sum() - before)
        assert len(np.unique(t.cells)) == len(x)
        worst[type(way)] = np.abs(made).max()
    assert worst[InsideBody] < 1e-4 and worst[AlphaShape] > 2e-3


def test_inside_body_opens_no_hole_and_keeps_a_bubble() -> None:
    x, size = lattice(6, 3, jitter=0.1)
    x = x[np.linalg.norm(x - 0.5, axis=1) > 0.3]
    size = size[: len(x)]
    first = InsideBody(alpha=1.0)(x, size, None)
    volume = simplices.volumes(x, first.cells).sum()
    x = x + 0.01 * np.stack([np.sin(3 * x[:, 1]), np.cos(4 * x[:, 0]), np.zeros(len(x))], axis=1)
    t = InsideBody()(x, size, first)
    assert_valid(x, t)
    assert volume < 0.95 and simplices.volumes(x, t.cells).sum() == pytest.approx(volume, rel=0.01)


def test_inside_body_tears_only_where_it_is_told_to() -> None:
    x, size = lattice(8, jitter=0.0)
    old = InsideBody()(x, size, None)
    x[x[:, 0] > 0.51, 0] += 1.0
    for part, volume in ((np.inf, 2.0), (3.0, 7 / 8)):
        t = old
        for _ in range(8):
            t = InsideBody(part=part)(x, size, t)
            assert_valid(x, t)
        assert simplices.volumes(x, t.cells).sum() == pytest.approx(volume, rel=1e-12)


def test_inside_body_fills_the_place_of_a_node_that_was_removed() -> None:
    """Also beside the boundary: of the old cells those around the node are missing."""
    x, size = lattice(6, 3)
    old = InsideBody()(x, size, None)
    gone = int(np.argmin(np.linalg.norm(x - [1 / 6, 0.5, 0.5], axis=1)))
    kept = np.arange(len(x)) != gone
    number = np.cumsum(kept) - 1
    rows = kept[old.cells].all(axis=1)
    left = Tessellation(number[old.cells[rows]], number[old.facets], np.flatnonzero(rows))
    t = InsideBody()(x[kept], size[kept], left)
    assert_valid(x[kept], t)
    assert simplices.volumes(x[kept], t.cells).sum() == pytest.approx(1.0, rel=1e-3)
    assert len(t.facets) == len(old.facets)


# --- any nodes --------------------------------------------------------------------------------------------------------
@st.composite
def clouds(draw: st.DrawFn, gdim: int) -> Array:
    """Nodes with duplicates, some on a line, some alone, in two bodies that touch, or around a hole; on a coarse grid or not."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    parts = [rng.random((draw(st.integers(0, 60)), gdim))]
    if draw(st.booleans()):
        parts.append(rng.random((draw(st.integers(1, 20)), gdim)) + np.eye(gdim)[0])  # touches the first
    if draw(st.booleans()):
        parts.append(np.outer(rng.random(draw(st.integers(1, 8))), rng.random(gdim)))  # a line
    if draw(st.booleans()):
        parts.append(5 + 3 * rng.random((draw(st.integers(1, 3)), gdim)))  # alone
    x = np.concatenate(parts)
    if draw(st.booleans()):
        x = x[np.linalg.norm(x - 0.5, axis=1) > 0.25]  # a hole
    if draw(st.booleans()):
        x = np.round(x * 4) / 4  # many on lines, on circles and at one place
    if len(x) and draw(st.booleans()):
        x = np.concatenate([x, x[rng.integers(len(x), size=draw(st.integers(1, 6)))]])
    return x + draw(st.sampled_from([0.0, 1e-9])) * rng.standard_normal(x.shape)


def used(x: Array, t: Tessellation) -> int:
    """The number of places that have a cell."""
    return len(np.unique(x[np.unique(t.cells)] + 0.0, axis=0))


@pytest.mark.parametrize("way", [AlphaShape(), AlphaShape(2.0, backend="qhull"), Constrained(), InsideBody()])
@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_any_cloud_gives_a_valid_mesh_or_one_line(way: Tessellator, data: st.DataObject) -> None:
    """Also after the nodes have moved, and moved far: no crash, and each node has a cell, flies, or is told of."""
    gdim = 2 if isinstance(way, Constrained) else data.draw(st.sampled_from([2, 3]))
    x = data.draw(clouds(gdim))
    size = np.full(len(x), 0.3)
    try:
        t = way(x, size, None)
    except Mistake as mistake:
        assert "\n" not in str(mistake)
        return
    assert_valid(x, t)
    rng = np.random.default_rng(len(x))
    for far in (1e-3, 0.3):
        x = x + far * rng.uniform(-1, 1, x.shape)
        if isinstance(way, Constrained | InsideBody):
            way.seen.clear()
        old, t = t, way(x, size, t)
        assert_valid(x, t)
        if isinstance(way, Constrained | InsideBody):
            lost = np.setdiff1d(old.cells, t.cells)
            assert len(lost) <= way.seen["loose"]
