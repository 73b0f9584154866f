"""What the material points of one body and the grid tell each other in a step, in passes over the points.

    scatter   m_n = sum S_np m_p,  m_n v_n = sum S_np m_p v_p,  f_n = sum S_np (f_p - V0_p tau_theta / r e_r) - sum V0_p tau_p grad S_np
    (grid)    v_n' = v_n + dt a_n,  a_n = f_n / m_n + g,  or what supports and walls prescribe
    advance   v_p' = v_p + dt sum S_np a_n or another ``Transfer``,  x_p' = x_p + dt sum S_np v_n'
    strain    F_p' = (I + dt L_p) F_p,  L_p = sum v_n grad S_np,  and the stress

(Sulsky, Chen & Schreyer 1994; Bardenhagen 2002 for the order of the passes). V0 is the reference volume and tau the Kirchhoff
stress, so that V0 tau = V sigma; f_p is a force on the point. In the scheme ``usl`` (update stress last) L belongs to v_n' and
advance and strain are one pass; in ``usf`` (update stress first) to the v_n mapped from the points, and the forces follow it; in
``musl`` (modified) to the velocities mapped anew from the updated points.

Every pass is a factory: it is compiled for a shape, a dimension, a transfer and, where the stress is updated, a law.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numba import njit

from geofem.methods.mpm import grid as g
from geofem.methods.mpm.deeds import FORCES, START, inlined, make_put
from geofem.methods.mpm.kind import OPTIONS, TINY, Kind
from geofem.methods.mpm.shapes import SHAPES, make_extent


@cache
def make_packs(dim: int, affine: bool, shape: str) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Starts of what the deeds carry along: (q, p, lattice, m, body, stress factor, affine factor) -> for putting, and for getting.

    An affine velocity belongs to the mean place of a point's weights: the point, or the centroid of a quadrilateral.
    """
    if dim == 2:
        if SHAPES[shape].domain == "corners":

            @inlined
            def middle(q, p):  # type: ignore[no-untyped-def]
                d = q.domain[p]
                one = (d[2] - d[0]) * (d[5] - d[1]) - (d[4] - d[0]) * (d[3] - d[1])
                other = (d[4] - d[0]) * (d[7] - d[1]) - (d[6] - d[0]) * (d[5] - d[1])
                share = one / (one + other)
                x = (d[0] + d[4] + share * d[2] + (1.0 - share) * d[6]) / 3.0
                return x, (d[1] + d[5] + share * d[3] + (1.0 - share) * d[7]) / 3.0

        else:

            @inlined
            def middle(q, p):  # type: ignore[no-untyped-def]
                return q.at[p, 0], q.at[p, 1]

        @inlined
        def to_put(q, p, lattice, m, bx, by, bz, s, xx, yy, zz, a):  # type: ignore[no-untyped-def]
            per_h = lattice[3]
            x, y = middle(q, p)
            sx, sy = (x - lattice[0]) * per_h, (y - lattice[1]) * per_h
            px, py, xy = m * q.v[p, 0], m * q.v[p, 1], s * q.tau[p, 3]
            if affine:
                C = q.C
                return m, px, py, bx, by, s * xx, s * yy, xy, sx, sy, a * C[p, 0], a * C[p, 1], a * C[p, 2], a * C[p, 3]
            return m, px, py, bx, by, s * xx, s * yy, xy, sx, sy, 0.0, 0.0, 0.0, 0.0

        @inlined
        def to_get(q, p, lattice):  # type: ignore[no-untyped-def]
            per_h = lattice[3]
            x, y = middle(q, p)
            sx, sy = (x - lattice[0]) * per_h, (y - lattice[1]) * per_h
            z = 0.0
            return z, z, z, z, z, z, z, z, sx, sy, z, z, z, z, z, z, z

    else:

        @inlined
        def to_put(q, p, lattice, m, bx, by, bz, s, xx, yy, zz, a):  # type: ignore[no-untyped-def]
            per_h = lattice[3]
            sx, sy, sz = (q.at[p, 0] - lattice[0]) * per_h, (q.at[p, 1] - lattice[1]) * per_h, (q.at[p, 2] - lattice[2]) * per_h
            px, py, pz = m * q.v[p, 0], m * q.v[p, 1], m * q.v[p, 2]
            xy, yz, xz = s * q.tau[p, 3], s * q.tau[p, 4], s * q.tau[p, 5]
            if affine:
                C = q.C
                return (
                    m, px, py, pz, bx, by, bz, s * xx, s * yy, s * zz, xy, yz, xz, sx, sy, sz,
                    a * C[p, 0], a * C[p, 1], a * C[p, 2], a * C[p, 3], a * C[p, 4], a * C[p, 5], a * C[p, 6], a * C[p, 7], a * C[p, 8],
                )  # fmt: skip
            z = 0.0
            return m, px, py, pz, bx, by, bz, s * xx, s * yy, s * zz, xy, yz, xz, sx, sy, sz, z, z, z, z, z, z, z, z, z

        @inlined
        def to_get(q, p, lattice):  # type: ignore[no-untyped-def]
            per_h = lattice[3]
            sx, sy, sz = (q.at[p, 0] - lattice[0]) * per_h, (q.at[p, 1] - lattice[1]) * per_h, (q.at[p, 2] - lattice[2]) * per_h
            z = 0.0
            return z, z, z, z, z, z, z, z, z, z, z, z, z, z, z, sx, sy, sz, z, z, z, z, z, z, z, z, z, z, z, z, z, z, z

    return to_put, to_get


@cache
def make_cell(dim: int) -> Callable[..., Any]:
    """(at, p, lattice) -> the row of the low node of the cell that holds point p."""
    if dim == 2:

        @inlined
        def cell(at, p, lattice):  # type: ignore[no-untyped-def]
            per_h = lattice[3]
            return int((at[p, 0] - lattice[0]) * per_h) * lattice[5] + int((at[p, 1] - lattice[1]) * per_h) - lattice[7]

    else:

        @inlined
        def cell(at, p, lattice):  # type: ignore[no-untyped-def]
            x0, y0, z0, per_h, _, ny, nz, base, _ = lattice
            i, j, k = int((at[p, 0] - x0) * per_h), int((at[p, 1] - y0) * per_h), int((at[p, 2] - z0) * per_h)
            return (i * ny + j) * nz + k - base

    return cell


@cache
def make_det(kind: Kind) -> Callable[..., float]:
    """(F, p) -> det F of point p, 1 at small strain."""
    if kind.small:

        @inlined
        def det(F, p):  # type: ignore[no-untyped-def]
            return 1.0

    elif kind.dim == 2:

        @inlined
        def det(F, p):  # type: ignore[no-untyped-def]
            return (F[p, 0] * F[p, 3] - F[p, 1] * F[p, 2]) * F[p, 4]

    else:

        @inlined
        def det(F, p):  # type: ignore[no-untyped-def]
            return (
                F[p, 0] * (F[p, 4] * F[p, 8] - F[p, 5] * F[p, 7])
                - F[p, 1] * (F[p, 3] * F[p, 8] - F[p, 5] * F[p, 6])
                + F[p, 2] * (F[p, 3] * F[p, 7] - F[p, 4] * F[p, 6])
            )

    return det


@cache
def make_unmoment(dim: int) -> Callable[..., Any]:
    """(C, p, M, k, D, m, factor) -> None: row by row C_p = factor M D^-1, for moments M of an affine velocity (from M[k] on) and second
    moments D of weights (3 or 6 from D[m] on, row by row of the upper half), of which the diagonal is at least ``TINY``."""
    if dim == 2:

        @inlined
        def unmoment(C, p, M, k, D, m, factor):  # type: ignore[no-untyped-def]
            a, b, d = max(D[m], TINY), D[m + 1], max(D[m + 2], TINY)
            scale = factor / (a * d - b * b)
            for r in range(2):
                u, w = M[k + 2 * r], M[k + 2 * r + 1]
                C[p, 2 * r], C[p, 2 * r + 1] = scale * (u * d - w * b), scale * (w * a - u * b)

    else:

        @inlined
        def unmoment(C, p, M, k, D, m, factor):  # type: ignore[no-untyped-def]
            a, b, c = max(D[m], TINY), D[m + 1], D[m + 2]
            d, e, f = max(D[m + 3], TINY), D[m + 4], max(D[m + 5], TINY)
            i0, i1, i2 = d * f - e * e, c * e - b * f, b * e - c * d
            i3, i4, i5 = a * f - c * c, b * c - a * e, a * d - b * b
            scale = factor / (a * i0 + b * i1 + c * i2)
            for r in range(3):
                u, v, w = M[k + 3 * r], M[k + 3 * r + 1], M[k + 3 * r + 2]
                C[p, 3 * r] = scale * (u * i0 + v * i1 + w * i2)
                C[p, 3 * r + 1] = scale * (u * i1 + v * i3 + w * i4)
                C[p, 3 * r + 2] = scale * (u * i2 + v * i4 + w * i5)

    return unmoment


@njit(**OPTIONS)
def find_escaped(q, lo, hi, lattice, pad, reach, marks):  # type: ignore[no-untyped-def]
    """Mark a point lo ... hi whose nodes are not all on the grid, or that is within ``pad`` nodes of its edge."""
    low, count = (lattice[0], lattice[1], lattice[2]), (lattice[4], lattice[5], lattice[6])
    for p in range(lo, hi):
        e = q.order[p] if len(q.order) > 0 else p
        for c in range(q.at.shape[1]):
            s, n = (q.at[e, c] - low[c]) * lattice[3], count[c]
            if not (pad <= s <= n - 1 - pad and s + reach < n - 1):
                marks[g.FAULT], marks[g.POINT] = g.ESCAPED, e


@cache
def make_scatter(kind: Kind, what: str) -> Callable[..., None]:
    """Mass and momenta of points lo ... hi to the grid, and their forces or these alone; marks the nodes that are reached.

    (q, lo, hi, nodes, lattice, cells, marks) -> None. cells : see ``make_pressures``.
    """
    dim, axial, cure = kind.dim, kind.axial, kind.cure and what != START
    loaded, affine, opens = kind.loaded and what != START, kind.transfer == "apic" and what != FORCES, what != FORCES
    over = SHAPES[kind.shape].over(dim)
    put = over(make_put(dim, what, affine))
    extent, cell, det = make_extent(SHAPES[kind.shape], dim), make_cell(dim), make_det(kind)
    to_put, _ = make_packs(dim, affine, kind.shape)
    averaged = 3 if axial else dim
    spread, fixed = opens and SHAPES[kind.shape].spread, opens and not SHAPES[kind.shape].spread
    reach = SHAPES[kind.shape].reach
    # a domain may pass a wall by its half, in the nodes beyond the room; only splines end at the room's edge
    ends = SHAPES[kind.shape].ends

    @njit(**OPTIONS)
    def scatter(q, lo, hi, nodes, lattice, cells, marks):  # type: ignore[no-untyped-def]
        per_h, pad = lattice[3], float(lattice[8]) if ends else reach
        ordered = len(q.order) > 0
        i0 = j0 = k0 = g.FAR
        i1 = j1 = k1 = 0
        if fixed:
            low, count = (lattice[0], lattice[1], lattice[2]), (lattice[4], lattice[5], lattice[6])
            for c in range(dim):
                least, most, start = np.inf, -np.inf, low[c]
                for e in range(lo, hi):
                    s = q.at[q.order[e] if ordered else e, c]
                    least, most = min(least, s), max(most, s)
                least, most, n = (least - start) * per_h, (most - start) * per_h, count[c]
                if not (least >= pad and most <= n - 1 - pad and most + reach < n - 1):
                    find_escaped(q, lo, hi, lattice, pad, reach, marks)
                    return
                marks[g.BOX + 2 * c] = min(marks[g.BOX + 2 * c], int(least - reach))
                marks[g.BOX + 2 * c + 1] = max(marks[g.BOX + 2 * c + 1], int(most + reach) + 1)
        for e in range(lo, hi):
            p = q.order[e] if ordered else e
            if spread:
                ex, ey, ez = extent(q.at, q.domain, q.stretch, p, per_h)
                sx, sy, nx, ny = (q.at[p, 0] - lattice[0]) * per_h, (q.at[p, 1] - lattice[1]) * per_h, lattice[4], lattice[5]
                inside = pad <= sx <= nx - 1 - pad and sx >= ex and sx + ex < nx - 1
                inside = inside and pad <= sy <= ny - 1 - pad and sy >= ey and sy + ey < ny - 1
                if dim == 3:
                    sz, nz = (q.at[p, 2] - lattice[2]) * per_h, lattice[6]
                    inside = inside and pad <= sz <= nz - 1 - pad and sz >= ez and sz + ez < nz - 1
                    k0, k1 = min(k0, int(sz - ez)), max(k1, int(sz + ez) + 1)
                if not inside:  # so written that nan is outside
                    marks[g.FAULT], marks[g.POINT] = g.ESCAPED, p
                    continue
                i0, i1 = min(i0, int(sx - ex)), max(i1, int(sx + ex) + 1)
                j0, j1 = min(j0, int(sy - ey)), max(j1, int(sy + ey) + 1)
            bx = by = bz = 0.0
            if loaded:
                bx, by = q.force[p, 0], q.force[p, 1]
                if dim == 3:
                    bz = q.force[p, 2]
            xx, yy, zz = q.tau[p, 0], q.tau[p, 1], q.tau[p, 2]
            if cure:
                c = cell(q.at, p, lattice)
                mean = xx + yy
                if averaged == 3:
                    mean += zz
                shift = det(q.F, p) * cells[c, 1] / cells[c, 0] - mean / averaged
                xx, yy, zz = xx + shift, yy + shift, zz + shift
            V = q.mass[p] * q.per_density
            if axial:
                bx -= V * zz / q.at[p, 0]
            put(nodes, lattice, q.at, q.domain, q.stretch, p,
                to_put(q, p, lattice, q.mass[p], bx, by, bz, -V * per_h, xx, yy, zz, q.mass[p] / per_h))  # fmt: skip
        if spread:
            marks[2], marks[3] = min(marks[2], i0), max(marks[3], i1)
            marks[4], marks[5] = min(marks[4], j0), max(marks[5], j1)
            if dim == 3:
                marks[6], marks[7] = min(marks[6], k0), max(marks[7], k1)

    return scatter
