"""Shape functions of the material points, alone: what every one must reproduce, and what each is by its definition."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit
from numba.extending import register_jitable

from geofem.methods.mpm.deeds import putting
from geofem.methods.mpm.shapes import SHAPES, make_extent

Array = np.ndarray
NODES = 13
"""Nodes of the test grid along every axis; cells are 1 m."""
CASES = [(name, dim) for name in SHAPES for dim in (2, 3) if (name, dim) != ("cpdi2", 3)]
QUICK = settings(derandomize=True, deadline=None, max_examples=60)
EPS = 2e-13
"""Rounding of sums over up to 216 sites of positions up to 12."""


@cache
def sites(name: str, dim: int) -> Any:
    """(at, domain, F, table, whole) -> number of sites; a row of the table is node, weight, gradient, place of a site.

    whole (1 + dim, nodes) : weights and gradients added to the grid as the method does.
    """

    @register_jitable
    def give(w, gx, gy, gz, x, y, z, acc):  # type: ignore[no-untyped-def]
        table, count, _ = acc
        k = count[0]
        count[0] = k + 1
        table[k, 1], table[k, 2], table[k, 3], table[k, 4] = w, gx, gy, gz
        table[k, 5], table[k, 6], table[k, 7] = x, y, z
        return w, gx, gy, gz, k, table

    @register_jitable
    def add(nodes, n, f, got):  # type: ignore[no-untyped-def]
        w, gx, gy, gz, k, table = got
        table[k, 0] = n
        nodes[n, 0] += f * w
        nodes[n, 1] += f * gx
        nodes[n, 2] += f * gy
        nodes[n, 3] += f * gz

    loop = SHAPES[name].over(dim)(putting(give, add))
    extent = make_extent(SHAPES[name], dim)

    @njit(cache=True)
    def reach(lattice, at, domain, F, table, whole):  # type: ignore[no-untyped-def]
        count = np.zeros(1, np.int64)
        loop(whole, lattice, at, domain, F, 0, (table, count, 0))
        return count[0], extent(at, domain, F, 0, lattice[3])

    return reach


class Point:
    """One material point on a grid of 1 m: weights w (n,) and gradients g (n, dim) of the nodes, whose places are x (n, dim)."""

    def __init__(self, name: str, at: Array, domain: Array, F: Array | None = None):
        dim = len(at)
        self.at, self.domain, self.F = np.array(at, float), np.array(domain, float), np.eye(dim) if F is None else F
        # the plane's deformation gradient has the out-of-plane stretch last
        row = np.append(self.F.ravel(), 1.0)[: 5 if dim == 2 else 9]
        lattice = (0.0, 0.0, 0.0, 1.0, *([NODES] * dim + [1])[:3], 0, SHAPES[name].pad)
        whole = np.zeros((NODES**dim, 4))
        table = np.zeros((1000, 8))
        count, self.extent = sites(name, dim)(lattice, self.at[None], self.domain.reshape(1, -1), row[None], table, whole)
        self.table = table[:count]
        self.w, self.g = whole[:, 0], whole[:, 1 : 1 + dim]
        self.x = np.stack(np.meshgrid(*[np.arange(NODES)] * dim, indexing="ij"), axis=-1).reshape(-1, dim).astype(float)


unit = st.floats(0.0, 1.0)


@st.composite
def stretches(draw, dim: int, most: float = 0.6):
    """Deformation gradients I + A, |A_ij| <= most / dim, so that det F > 0."""
    part = st.floats(-most / dim, most / dim)
    return np.eye(dim) + np.array([draw(part) for _ in range(dim * dim)]).reshape(dim, dim)


@st.composite
def points(draw, name: str, dim: int, margin: float = 4.0):
    """A point of a shape, anywhere from 4 to 8 m, with a domain of some size and deformation."""
    at = np.array([draw(st.floats(margin, NODES - 1 - margin)) for _ in range(dim)])
    F = draw(stretches(dim))
    sizes = np.array([draw(st.floats(0.05, 0.5)) for _ in range(dim)])
    if SHAPES[name].domain == "edges":
        return Point(name, at, np.diag(sizes) @ draw(stretches(dim, 0.4)), F)
    if SHAPES[name].domain == "corners":
        turn = draw(stretches(2, 0.4))
        nudge = np.array([draw(st.floats(-0.2, 0.2)) for _ in range(8)]).reshape(4, 2)
        square = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) + nudge
        return Point(name, at, at + (square * sizes) @ turn.T, F)
    return Point(name, at, sizes, F)


def polygon_mean(corners: Array) -> Array:
    """The centroid of a quadrilateral (4, 2), by the shoelace formula."""
    x, y = corners.T
    cross = x * np.roll(y, -1) - np.roll(x, -1) * y
    return np.array([np.sum((x + np.roll(x, -1)) * cross), np.sum((y + np.roll(y, -1)) * cross)]) / (3 * cross.sum())


# --- what all of them must do -------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name, dim", CASES)
def test_linear_fields_are_reproduced(name: str, dim: int) -> None:
    """sum w = 1, sum g = 0, sum w x = x (CPDI2: the mean of the domain), sum g x = I; no node beyond the extent that is told."""

    @QUICK
    @given(points(name, dim))
    def check(p: Point) -> None:
        middle = polygon_mean(p.domain.reshape(4, 2)) if name == "cpdi2" else p.at
        assert p.w.sum() == pytest.approx(1.0, abs=EPS)
        assert p.g.sum(axis=0) == pytest.approx(0.0, abs=10 * EPS)
        assert p.w @ p.x == pytest.approx(middle, abs=EPS * NODES)
        assert p.x.T @ p.g == pytest.approx(np.eye(dim), abs=20 * EPS * NODES)
        assert p.w.min() >= -EPS
        # sites lie where they say: at their node, or within the cell whose low node is the last but all of its corners
        assert p.table[:, 1] @ p.table[:, 5 : 5 + dim] == pytest.approx(middle, abs=EPS * NODES)
        reached = p.x[(p.w != 0) | np.any(p.g != 0, axis=1)]
        low, high = (np.floor(p.at + s * np.array(p.extent[:dim])) for s in (-1, 1))
        assert np.all(reached >= low) and np.all(reached <= high + 1)

    check()


@pytest.mark.parametrize("name, dim", [c for c in CASES if SHAPES[c[0]].domain == "half"])
def test_gradients_are_differences_of_the_weights(name: str, dim: int) -> None:
    """Central differences of 1e-6 m meet the gradients to 1e-8, and to their jump where a kink lies in between."""

    @QUICK
    @given(points(name, dim))
    def check(p: Point) -> None:
        e = 1e-6
        for c in range(dim):
            after, before = (Point(name, p.at + s * e * np.eye(dim)[c], p.domain, p.F) for s in (1, -1))
            difference = (after.w - before.w) / (2 * e)
            if np.allclose(after.g, before.g, atol=1e-3):  # hats have kinks at the nodes
                assert p.g[:, c] == pytest.approx(difference, abs=1e-8 + 10 * e)

    check()


# --- what each of them is -----------------------------------------------------------------------------------------------------
def hats(x: Array) -> Array:
    """The hats of all nodes (n,) at a place (dim,)."""
    axes = [np.maximum(0.0, 1.0 - np.abs(np.arange(NODES) - s)) for s in x]
    whole = axes[0]
    for axis in axes[1:]:
        whole = np.multiply.outer(whole, axis)
    return whole.ravel()


def mean_hat(s: float, l: float) -> tuple[Array, Array]:
    """The hats of a row of nodes averaged over s - l ... s + l, and their slopes: exactly, by Gauss's rule between the kinks."""
    inner = np.arange(np.ceil(s - l), np.floor(s + l) + 1)
    cuts = np.unique(np.concatenate([[s - l], inner, [s + l]]))
    gauss = 0.5 * np.array([-1.0, 1.0]) / np.sqrt(3.0)
    node = np.arange(NODES)
    mean = np.zeros(NODES)
    for a, b in zip(cuts[:-1], cuts[1:]):
        for q in 0.5 * (a + b) + gauss * (b - a):
            mean += 0.5 * (b - a) * np.maximum(0.0, 1.0 - np.abs(node - q))
    ends = [np.maximum(0.0, 1.0 - np.abs(node - q)) for q in (s - l, s + l)]
    return mean / (2 * l), (ends[1] - ends[0]) / (2 * l)


@pytest.mark.parametrize("name, dim", [("gimp", 2), ("gimp", 3), ("cpgimp", 2), ("cpgimp", 3)])
def test_gimp_is_the_mean_of_the_hat_over_the_domain(name: str, dim: int) -> None:
    """uGIMP over the domain of the reference configuration, cpGIMP over the one stretched along each axis by |F e_a|."""

    @QUICK
    @given(points(name, dim))
    def check(p: Point) -> None:
        stretch = np.linalg.norm(p.F, axis=0) if name == "cpgimp" else np.ones(dim)
        axes = [mean_hat(s, l) for s, l in zip(p.at, p.domain * stretch)]
        for c in range(-1, dim):
            whole = np.ones(())
            for a, (w, slope) in enumerate(axes):
                whole = np.multiply.outer(whole, slope if a == c else w)
            assert (p.w if c < 0 else p.g[:, c]) == pytest.approx(whole.ravel(), abs=1e-12)

    check()


def test_hats_are_hats() -> None:
    @QUICK
    @given(points("hat", 2))
    def check(p: Point) -> None:
        assert p.w == pytest.approx(hats(p.at), abs=1e-14)

    check()


@pytest.mark.parametrize("name, dim", [("cpdi", 2), ("cpdi", 3), ("cpdi2", 2)])
def test_cpdi_integrates_the_interpolated_hats_exactly(name: str, dim: int) -> None:
    """Mean weight and gradient over the domain of sum_c N_c(xi) hat(x_c), by Gauss's rule of 3 points a direction.

    Gradients come from integrals of N_c grad^T over the domain divided by its volume.
    """
    gauss, weight = np.polynomial.legendre.leggauss(3)

    @QUICK
    @given(points(name, dim))
    def check(p: Point) -> None:
        signs = np.array(np.meshgrid(*[(-1.0, 1.0)] * dim, indexing="ij")).reshape(dim, -1).T
        if name == "cpdi2":
            signs = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
            corners = p.domain.reshape(4, 2)
        else:
            corners = p.at + signs @ (p.domain.reshape(dim, dim) @ p.F.T)
        at_corners = np.array([hats(c) for c in corners])
        w, g, volume = np.zeros(len(p.w)), np.zeros_like(p.g), 0.0
        for q in np.stack(np.meshgrid(*[np.arange(3)] * dim, indexing="ij"), axis=-1).reshape(-1, dim):
            factors = 0.5 * (1.0 + signs * gauss[q])
            N = factors.prod(axis=1)
            dN = np.stack([0.5 * signs[:, a] * np.delete(factors, a, axis=1).prod(axis=1) for a in range(dim)], axis=1)
            J = corners.T @ dN
            part = np.linalg.det(J) * weight[q].prod()
            volume += part
            w += part * (N @ at_corners)
            g += part * (at_corners.T @ (dN @ np.linalg.inv(J)))
        assert p.w == pytest.approx(w / volume, abs=1e-12)
        assert p.g == pytest.approx(g / volume, abs=1e-10)

    check()


@pytest.mark.parametrize("name, degree", [("bspline2", 2), ("bspline3", 3)])
def test_bsplines_are_bsplines(name: str, degree: int) -> None:
    """Away from the edges: the cardinal spline of scipy."""
    from scipy.interpolate import BSpline

    knots = np.arange(degree + 2) - 0.5 * (degree + 1)
    spline = BSpline.basis_element(knots, extrapolate=False)

    @QUICK
    @given(points(name, 2))
    def check(p: Point) -> None:
        axes = [np.nan_to_num(spline(s - np.arange(NODES))) for s in p.at]
        assert p.w == pytest.approx(np.multiply.outer(*axes).ravel(), abs=1e-13)

    check()


@pytest.mark.parametrize("name", ["bspline2", "bspline3"])
@pytest.mark.parametrize("dim", [2, 3])
def test_bsplines_at_the_edge_of_the_room(name: str, dim: int) -> None:
    """In the two cells at an edge: partition of unity, linear fields, no negative weight, no node beyond the edge; on the edge
    its own nodes alone."""
    edges = np.array([SHAPES[name].pad, NODES - 1 - SHAPES[name].pad], float)

    @QUICK
    @given(st.lists(st.floats(0.0, 2.0, exclude_max=True), min_size=dim, max_size=dim), st.booleans())
    def check(s: list[float], high: bool) -> None:
        at = edges[1] - np.array(s) if high else edges[0] + np.array(s)
        p = Point(name, at, np.full(dim, 0.25))
        if name == "bspline3" and np.any(at == edges[1]):
            return  # there the cubic's next cell begins; the method ends a run before a point stands on that edge
        assert p.w.sum() == pytest.approx(1.0, abs=EPS) and p.w @ p.x == pytest.approx(at, abs=EPS * NODES)
        assert p.x.T @ p.g == pytest.approx(np.eye(dim), abs=20 * EPS * NODES) and p.w.min() >= -EPS
        assert np.all(p.w[np.any((p.x < edges[0]) | (p.x > edges[1]), axis=1)] == 0.0)

    check()
    for edge in edges:
        if name == "bspline3" and edge == edges[1]:
            continue
        p = Point(name, np.array([edge, *[6.3] * (dim - 1)]), np.full(dim, 0.25))
        assert np.all(np.abs(p.w[p.x[:, 0] != edge]) < EPS)


@pytest.mark.parametrize("l", [0.5, 0.05])
def test_gimp_at_its_borders(l: float) -> None:
    """Where the domain begins to touch the next node, and at the largest domain, weights go over without a jump."""
    for s in (4.5, 5.0 - l, 5.0, 5.0 + l):
        before, after = (Point("gimp", np.array([s + e, 6.1]), np.full(2, l)).w for e in (-1e-9, 1e-9))
        assert after == pytest.approx(before, abs=1e-8)
