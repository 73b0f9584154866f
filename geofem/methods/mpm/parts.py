"""Passes over single parts of the points: their velocity again (xpic) or its moments (apic), corners of domains, and nodes."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from numba import njit

from geofem.methods.mpm import grid as g
from geofem.methods.mpm.deeds import AGAIN, inlined, make_get_gradient, make_get_spread, make_put, putting
from geofem.methods.mpm.kind import OPTIONS, Kind
from geofem.methods.mpm.scatter import make_packs, make_unmoment
from geofem.methods.mpm.shapes import SHAPES, turn


@cache
def make_hear(kind: Kind, first: int) -> Callable[..., None]:
    """The velocity in the columns from ``first`` on, at points lo ... hi: (q, lo, hi, nodes, lattice, out (N, d)) -> None."""
    dim = kind.dim
    get = SHAPES[kind.shape].over(dim)(make_get_gradient(dim, first))
    zeros = (0.0,) * (dim + dim * dim)

    @njit(**OPTIONS)
    def hear(q, lo, hi, nodes, lattice, out):  # type: ignore[no-untyped-def]
        for p in range(lo, hi):
            got = get(nodes, lattice, q.at, q.domain, q.stretch, p, zeros)
            for c in range(dim):
                out[p, c] = got[c]

    return hear


@cache
def make_tell(kind: Kind) -> Callable[..., None]:
    """Momenta of the velocities ``out`` to the columns behind the strains: (q with v = out, lo, hi, nodes, lattice) -> None."""
    dim = kind.dim
    put = SHAPES[kind.shape].over(dim)(make_put(dim, AGAIN, False))
    to_put, _ = make_packs(dim, False, kind.shape)

    @njit(**OPTIONS)
    def tell(q, lo, hi, nodes, lattice):  # type: ignore[no-untyped-def]
        ordered = len(q.order) > 0
        for e in range(lo, hi):
            p = q.order[e] if ordered else e
            put(
                nodes,
                lattice,
                q.at,
                q.domain,
                q.stretch,
                p,
                to_put(q, p, lattice, q.mass[p], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
            )

    return tell


@inlined
def times(C, r, s):  # type: ignore[no-untyped-def]
    """The row of a gradient that begins at r times the symmetric matrix s of space."""
    x, y, z = C[r], C[r + 1], C[r + 2]
    return x * s[0] + y * s[1] + z * s[2], x * s[1] + y * s[3] + z * s[4], x * s[2] + y * s[4] + z * s[5]


@cache
def make_keep_moments(kind: Kind) -> Callable[..., None]:
    """Affine velocities of points lo ... hi after they moved: what passes from step to step is their moment C D, with the second
    moments D of the weights where the point was, and not C itself (Jiang et al. 2015): only so is angular momentum kept.

    (q, spread, lo, hi, lattice) -> None. spread (N, 3 or 6) : D (cells squared); zeros where C is a gradient of no certain place.
    """
    dim = kind.dim
    get = SHAPES[kind.shape].over(dim)(make_get_spread(dim))
    _, to_get = make_packs(dim, True, kind.shape)
    unmoment = make_unmoment(dim)
    count = 3 * (dim - 1)

    @njit(**OPTIONS)
    def keep_moments(q, spread, lo, hi, lattice):  # type: ignore[no-untyped-def]
        for p in range(lo, hi):
            start, s = to_get(q, p, lattice), spread[p]
            if dim == 2:
                got = get(q.x, lattice, q.at, q.domain, q.stretch, p, (start[8], start[9], 0.0, 0.0, 0.0))
            else:
                zeros = (start[15], start[16], start[17], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
                got = get(q.x, lattice, q.at, q.domain, q.stretch, p, zeros)
            if s[0] > 0.0:
                C = q.C[p]
                if dim == 2:
                    moments = (
                        C[0] * s[0] + C[1] * s[1], C[0] * s[1] + C[1] * s[2],
                        C[2] * s[0] + C[3] * s[1], C[2] * s[1] + C[3] * s[2],
                    )  # fmt: skip
                else:
                    moments = times(C, 0, s) + times(C, 3, s) + times(C, 6, s)
                unmoment(q.C, p, moments, 0, got, dim, 1.0)
            for k in range(count):
                s[k] = got[dim + k]

    return keep_moments


FLAT = 1e-9
"""A corner that turns the wrong way by more than this share of the area is past rounding."""


@njit(**OPTIONS)
def carry_corners(domain, lo, hi, nodes, lattice, dt, marks):  # type: ignore[no-untyped-def]
    """Move the corners (N, 8) of quadrilateral domains with the velocity that the grid has there; one not convex is marked."""
    x0, y0, _, per_h, _, ny, _, base, _ = lattice
    for p in range(lo, hi):
        for c in range(4):
            sx, sy = (domain[p, 2 * c] - x0) * per_h, (domain[p, 2 * c + 1] - y0) * per_h
            i, j = int(sx), int(sy)
            rx, ry, n = sx - i, sy - j, i * ny + j - base
            a, b, d, e = (1.0 - rx) * (1.0 - ry), (1.0 - rx) * ry, rx * (1.0 - ry), rx * ry
            for k in range(2):
                v = a * nodes[n, 1 + k] + b * nodes[n + 1, 1 + k] + d * nodes[n + ny, 1 + k] + e * nodes[n + ny + 1, 1 + k]
                domain[p, 2 * c + k] += dt * v
        d = domain[p]
        first, second, third, fourth = turn(d, 0, 2, 6), turn(d, 2, 4, 0), turn(d, 4, 6, 2), turn(d, 6, 0, 4)
        least = -FLAT * (first + third)
        # two corners may lie in one place, as at the middle of a disc; so written that nan is a fault
        if not (first > least and second > least and third > least and fourth > least):
            marks[g.FAULT], marks[g.POINT] = g.FOLDED, p


@njit(**OPTIONS)
def note(row, n):  # type: ignore[no-untyped-def]
    """Put n in the first free place of the row, in the last if there is none."""
    k = 0
    while k < len(row) - 1 and row[k] >= 0:
        k += 1
    row[k] = n


@cache
def make_neighbours(kind: Kind) -> Callable[..., None]:
    """The nodes of the first ``count`` points that have weight: (q, count, lattice, out (count, most)) -> None; -1 fills the rest."""
    dim = kind.dim

    @inlined
    def give(w, gx, gy, gz, x, y, z, a):  # type: ignore[no-untyped-def]
        return w, a

    @inlined
    def add(out, n, f, got):  # type: ignore[no-untyped-def]
        w, p = got
        if f * w > SHARED:
            note(out[p], n)

    reach = SHAPES[kind.shape].over(dim)(putting(give, add))

    @njit(**OPTIONS)
    def neighbours(q, count, lattice, out):  # type: ignore[no-untyped-def]
        for p in range(count):
            reach(out, lattice, q.at, q.domain, q.stretch, p, p)

    return neighbours


SHARED = 1e-12
"""A weight below this is rounding: a point of that weight does not share the node."""
