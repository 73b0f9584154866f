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
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from geofem.methods.mpm import grid as g
from geofem.methods.mpm.deeds import AGAIN, FORCES, START, inlined, make_get_gradient, make_get_motion, make_put, putting
from geofem.methods.mpm.grid import OPTIONS as GRID_OPTIONS
from geofem.methods.mpm.shapes import SHAPES, make_extent, turn

Array = np.ndarray
# Without numba's runtime: its atomic counting of references to rows of arrays took a third of a point's time. The passes can
# then allocate nothing; their scratch is given.
OPTIONS = {**GRID_OPTIONS, "_nrt": False}
SCRATCH = 64
"""Numbers of scratch that a pass needs."""
SCHEMES = ("usl", "musl", "usf")


class Cloud(NamedTuple):
    """The points of one body as the passes see them; N points, d dimensions, g and m as in ``geofem.materials``.

    X, x, at, v : (N, d) reference position, position, place on the grid in this step (m), velocity (m/s).
    C : (N, d d) gradient of the velocity within a point's domain (1/s, apic), or the velocity without noise (N, d) (m/s, xpic).
    F : (N, g) deformation gradient. L : (N, d d) its increment's gradient dt L, for the volumetric cure only.
    tau : (N, m) Kirchhoff stress (Pa). state : (N, s). mass (kg), volume (m3, reference), force (N, d) on the point (N).
    domain : see ``Shape.domain``. stretch (N, g) : the deformation gradient of the domains in this step, so that all passes of a step
    see the same domain; the identity at small strain. order : (N,) the order in which points add to the grid; empty: as they are.
    per_density : volume over mass (m3/kg), which saves reading both.
    """

    X: Array
    x: Array
    at: Array
    v: Array
    C: Array
    F: Array
    L: Array
    tau: Array
    state: Array
    mass: Array
    volume: Array
    force: Array
    domain: Array
    stretch: Array
    order: Array
    per_density: float


class Answer(NamedTuple):
    """A material law as the passes need it: its point kernel, whether that looks at the F before the step, and has a state."""

    point: Callable[..., int]
    history: bool
    stateful: bool


@dataclass(frozen=True)
class Kind:
    """What passes are compiled for; ``axial``: axial symmetry, x is the radius, and masses and volumes are per radian.

    scheme : see above. transfer : ``flip`` (blended with pic), ``apic``, ``xpic``. small : small strain, F = I + grad u.
    loaded : points carry forces of their own. spent : the work of the stresses is summed up (where no stored energy tells it).
    cure : the volumetric part of strain and stress is averaged over cells.
    """

    shape: str
    dim: int
    axial: bool
    small: bool
    scheme: str
    transfer: str
    loaded: bool
    spent: bool
    cure: bool


# --- helpers of all passes ---------------------------------------------------------------------------------------------------
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


# --- to the grid -----------------------------------------------------------------------------------------------------------
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


@cache
def make_pressures(kind: Kind) -> Callable[..., None]:
    """Sums over each cell of the volume of its points and of volume times mean Cauchy stress.

    (q, lo, hi, lattice, cells) -> None. cells (n, 3) : volume, volume times mean stress, volume after the step. The mean stress is
    that of the plane, or of space, as only its strains are averaged.
    """
    cell, averaged = make_cell(kind.dim), 3 if kind.axial else kind.dim
    det = make_det(kind)

    @njit(**OPTIONS)
    def pressures(q, lo, hi, lattice, cells):  # type: ignore[no-untyped-def]
        ordered = len(q.order) > 0
        for e in range(lo, hi):
            p = q.order[e] if ordered else e
            c = cell(q.at, p, lattice)
            mean = q.tau[p, 0] + q.tau[p, 1]
            if averaged == 3:
                mean += q.tau[p, 2]
            cells[c, 0] += q.volume[p] * det(q.F, p)
            cells[c, 1] += q.volume[p] * mean / averaged

    return pressures


# --- to the points -----------------------------------------------------------------------------------------------------------
@cache
def make_move(kind: Kind) -> Callable[..., Any]:
    """(q, p, got, dt, flip, h) -> (work of the point's force, its kinetic energy twice, its speed squared); moves point p.

    got : what ``make_get_motion`` carried.
    """
    dim, loaded, apic, xpic = kind.dim, kind.loaded, kind.transfer == "apic", kind.transfer == "xpic"
    B, D = 3 * dim + dim * dim, 3 * dim + 2 * dim * dim

    @inlined
    def move(q, p, got, dt, flip, h):  # type: ignore[no-untyped-def]
        work = square = 0.0
        m = q.mass[p]
        for c in range(dim):
            v = got[c]
            if loaded:
                work += q.force[p, c] * v
            q.x[p, c] += dt * v
            if xpic:
                v = q.C[p, c] + dt * got[dim + c]
            elif not apic:
                v = flip * (q.v[p, c] + dt * got[dim + c]) + (1.0 - flip) * v
            q.v[p, c] = v
            square += v * v
        if apic:
            if dim == 2:
                a, b, d = got[D] + TINY, got[D + 1], got[D + 2] + TINY
                scale = 1.0 / ((a * d - b * b) * h)
                for c in range(2):
                    u, w = got[B + 2 * c], got[B + 2 * c + 1]
                    q.C[p, 2 * c], q.C[p, 2 * c + 1] = scale * (u * d - w * b), scale * (w * a - u * b)
            else:
                a, b, c, d, e, f = got[D] + TINY, got[D + 1], got[D + 2], got[D + 3] + TINY, got[D + 4], got[D + 5] + TINY
                i0, i1, i2 = d * f - e * e, c * e - b * f, b * e - c * d
                scale = 1.0 / ((a * i0 + b * i1 + c * i2) * h)
                i3, i4, i5 = a * f - c * c, b * c - a * e, a * d - b * b
                for r in range(3):
                    u, v, w = got[B + 3 * r], got[B + 3 * r + 1], got[B + 3 * r + 2]
                    q.C[p, 3 * r] = scale * (u * i0 + v * i1 + w * i2)
                    q.C[p, 3 * r + 1] = scale * (u * i1 + v * i3 + w * i4)
                    q.C[p, 3 * r + 2] = scale * (u * i2 + v * i4 + w * i5)
        return work, m * square, square

    return move


TINY = 1e-14
"""Added to the second moments (cells squared) of a point that sits on a node, whose hat tells nothing of the gradient."""


@cache
def make_gradient(dim: int) -> Callable[..., Any]:
    """(got, start, factor) -> the gradient that stands in ``got`` from ``start`` on, row by row, times a factor."""
    if dim == 2:

        @inlined
        def gradient(got, a, s):  # type: ignore[no-untyped-def]
            return s * got[a], s * got[a + 1], s * got[a + 2], s * got[a + 3]

    else:

        @inlined
        def gradient(got, a, s):  # type: ignore[no-untyped-def]
            return (
                s * got[a], s * got[a + 1], s * got[a + 2], s * got[a + 3], s * got[a + 4],
                s * got[a + 5], s * got[a + 6], s * got[a + 7], s * got[a + 8],
            )  # fmt: skip

    return gradient


@cache
def make_deform(kind: Kind, answer: Answer) -> Callable[..., float]:
    """(q, p, L, hoop, par, dt, scratch) -> twice the work of the stresses, or nan if det F <= 0; updates F and stress.

    L : dt times the velocity gradient, row by row. hoop : that of the hoop with axial symmetry.
    """
    law, history, stateful = answer
    axial, small, spent = kind.axial, kind.small, kind.spent
    if kind.dim == 2:

        @inlined
        def deform(q, p, L, hoop, par, dt, scratch):  # type: ignore[no-untyped-def]
            F, tau, old, new_state = q.F[p], q.tau[p], scratch[:5], scratch[16 : 16 + q.state.shape[1]]
            lxx, lxy, lyx, lyy = L
            xx, xy, yx, yy, zz = F[0], F[1], F[2], F[3], F[4]
            if history:
                old[0], old[1], old[2], old[3], old[4] = xx, xy, yx, yy, zz
            if small:
                F[0], F[1], F[2], F[3] = xx + lxx, xy + lxy, yx + lyx, yy + lyy
            else:
                F[0], F[1] = xx + lxx * xx + lxy * yx, xy + lxx * xy + lxy * yy
                F[2], F[3] = yx + lyx * xx + lyy * yx, yy + lyx * xy + lyy * yy
            if axial:
                F[4] = zz + hoop if small else zz * (1.0 + hoop)
            txx, tyy, tzz, txy = tau[0], tau[1], tau[2], tau[3]
            if law(F, old, q.state[p], par, dt, tau, new_state) < 0:
                F[0], F[1], F[2], F[3], F[4] = xx, xy, yx, yy, zz
                tau[0], tau[1], tau[2], tau[3] = txx, tyy, tzz, txy
                return np.nan
            if stateful:
                for k in range(len(new_state)):
                    q.state[p, k] = new_state[k]
            if not spent:
                return 0.0
            power = (txx + tau[0]) * lxx + (tyy + tau[1]) * lyy + (txy + tau[3]) * (lxy + lyx)
            if axial:
                power += (tzz + tau[2]) * hoop
            return q.mass[p] * q.per_density * power

    else:

        @inlined
        def deform(q, p, L, hoop, par, dt, scratch):  # type: ignore[no-untyped-def]
            F, tau, old, before = q.F[p], q.tau[p], scratch[:9], scratch[9:15]
            new_state = scratch[16 : 16 + q.state.shape[1]]
            for k in range(9):
                old[k] = F[k]
            for k in range(6):
                before[k] = tau[k]
            for r in range(3):
                for c in range(3):
                    F[3 * r + c] += (
                        L[3 * r + c] if small else L[3 * r] * old[c] + L[3 * r + 1] * old[3 + c] + L[3 * r + 2] * old[6 + c]
                    )
            if law(F, old, q.state[p], par, dt, tau, new_state) < 0:
                for k in range(9):
                    F[k] = old[k]
                for k in range(6):
                    tau[k] = before[k]
                return np.nan
            if stateful:
                for k in range(len(new_state)):
                    q.state[p, k] = new_state[k]
            if not spent:
                return 0.0
            power = (before[0] + tau[0]) * L[0] + (before[1] + tau[1]) * L[4] + (before[2] + tau[2]) * L[8]
            power += (before[3] + tau[3]) * (L[1] + L[3]) + (before[4] + tau[4]) * (L[5] + L[7])
            return q.mass[p] * q.per_density * (power + (before[5] + tau[5]) * (L[2] + L[6]))

    return deform


@cache
def make_advance(kind: Kind, law: Answer | None) -> Callable[..., None]:
    """Velocities and places of points lo ... hi and, with a law, their strain and stress too (scheme usl).

    (q, lo, hi, own, nodes, others, lattice, par, dt, flip, h, scratch, sums, marks) -> None. In the scheme musl the momenta of the updated
    points go to ``others`` for the strains. own : points from there on are copies of those of other ranks, not counted in sums.
    """
    dim, axial, again = kind.dim, kind.axial, kind.scheme == "musl"
    affine = kind.transfer == "apic"
    over = SHAPES[kind.shape].over(dim)
    get = over(make_get_motion(dim, law is not None, affine))
    put = over(make_put(dim, AGAIN, affine))
    to_put, to_get = make_packs(dim, affine, kind.shape)
    move, gradient = make_move(kind), make_gradient(dim)
    if law is None:

        @inlined
        def deform(q, p, L, hoop, par, dt, scratch):  # type: ignore[no-untyped-def]
            return 0.0

    else:
        deform = make_deform(kind, law)
    zeros = (0.0,) * (2 * dim + dim * dim)
    strains, spent, plain = law is not None, law is not None and kind.spent, not affine

    @njit(**OPTIONS)
    def advance(q, lo, hi, own, nodes, others, lattice, par, dt, flip, h, scratch, sums, marks):  # type: ignore[no-untyped-def]
        ordered = len(q.order) > 0
        kinetic = fastest = work = power = 0.0
        per_h = lattice[3]
        for e in range(lo, hi):
            p = np.uint64(q.order[e] if ordered else e)  # numba then need not ask whether it counts from the end
            if plain:
                got = get(nodes, lattice, q.at, q.domain, q.stretch, p, zeros)
            else:
                got = get(nodes, lattice, q.at, q.domain, q.stretch, p, to_get(q, p, lattice))
            radius = q.at[p, 0]
            done, square, speed = move(q, p, got, dt, flip, h)
            if strains:
                hoop = dt * got[0] / radius if axial else 0.0
                dissipated = deform(q, p, gradient(got, 2 * dim, dt * per_h), hoop, par, dt, scratch)
                if not dissipated == dissipated:
                    marks[g.FAULT], marks[g.POINT] = g.TANGLED, p
                    dissipated = 0.0
            if again:
                put(
                    others,
                    lattice,
                    q.at,
                    q.domain,
                    q.stretch,
                    p,
                    to_put(q, p, lattice, q.mass[p], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, q.mass[p] * h),
                )
            if np.int64(p) < own:
                kinetic += square
                work += done
                fastest = max(fastest, speed)
                if spent:
                    power += dissipated
        sums[g.KINETIC] += 0.5 * kinetic
        sums[g.SPEED2] = max(sums[g.SPEED2], fastest)
        sums[g.WORK] += dt * work
        sums[g.STRAIN_WORK] += 0.5 * power

    return advance


@cache
def make_strain(kind: Kind, law: Answer) -> Callable[..., None]:
    """Strain and stress of points lo ... hi from the nodal velocities, or with the cure from ``q.L`` (see ``make_dilate``).

    (q, lo, hi, own, nodes, lattice, cells, par, dt, scratch, sums, marks) -> None.
    """
    dim, axial, cure = kind.dim, kind.axial, kind.cure
    get = SHAPES[kind.shape].over(dim)(make_get_gradient(dim, 1 if kind.scheme == "usl" else 1 + 2 * dim))
    deform, cell, gradient = make_deform(kind, law), make_cell(dim), make_gradient(dim)
    zeros = (0.0,) * (dim + dim * dim)
    power_of_ratio = 1.0 / (3 if axial else dim)
    increment = make_increment(kind)

    @njit(**OPTIONS)
    def strain(q, lo, hi, own, nodes, lattice, cells, par, dt, scratch, sums, marks):  # type: ignore[no-untyped-def]
        ordered = len(q.order) > 0
        power, per_h = 0.0, lattice[3]
        for e in range(lo, hi):
            p = np.uint64(q.order[e] if ordered else e)  # numba then need not ask whether it counts from the end
            if cure:
                c = cell(q.at, p, lattice)
                stretch = (cells[c, 2] / (cells[c, 0] * increment(q.L[p]))) ** power_of_ratio
                change, hoop = q.L[p], 0.0
                for r in range(dim * dim):
                    change[r] *= stretch
                for r in range(dim):
                    change[(dim + 1) * r] += stretch - 1.0
                if axial:
                    hoop = stretch * (1.0 + change[4]) - 1.0
                dissipated = deform(q, p, gradient(change, 0, 1.0), hoop, par, dt, scratch)
            else:
                got = get(nodes, lattice, q.at, q.domain, q.stretch, p, zeros)
                hoop = dt * got[0] / q.at[p, 0] if axial else 0.0
                dissipated = deform(q, p, gradient(got, dim, dt * per_h), hoop, par, dt, scratch)
            if not dissipated == dissipated:
                marks[g.FAULT], marks[g.POINT] = g.TANGLED, p
            elif np.int64(p) < own:
                power += dissipated
        sums[g.STRAIN_WORK] += 0.5 * power

    return strain


@cache
def make_increment(kind: Kind) -> Callable[..., float]:
    """(L) -> det(I + L) of one point's increment, with the hoop's stretch in axial symmetry."""
    axial = kind.axial
    if kind.dim == 2:

        @inlined
        def increment(L):  # type: ignore[no-untyped-def]
            plane = (1.0 + L[0]) * (1.0 + L[3]) - L[1] * L[2]
            return plane * (1.0 + L[4]) if axial else plane

    else:

        @inlined
        def increment(L):  # type: ignore[no-untyped-def]
            a, e, i = 1.0 + L[0], 1.0 + L[4], 1.0 + L[8]
            return a * (e * i - L[5] * L[7]) - L[1] * (L[3] * i - L[5] * L[6]) + L[2] * (L[3] * L[7] - e * L[6])

    return increment


@cache
def make_dilate(kind: Kind) -> Callable[..., None]:
    """The cure of volumetric locking, first half: the increments of points lo ... hi, and the volume they give each cell.

    The volumetric part of every increment is replaced by the mean over the cell (F-bar, de Souza Neto et al. 1996; for material
    points Coombs et al. 2018), and the mean stress likewise in the forces, so that the work done agrees.
    (q, lo, hi, nodes, lattice, cells, dt) -> None. cells : see ``make_pressures``.
    """
    dim, axial = kind.dim, kind.axial
    get = SHAPES[kind.shape].over(dim)(make_get_gradient(dim, 1 if kind.scheme == "usl" else 1 + 2 * dim))
    cell, det, increment = make_cell(dim), make_det(kind), make_increment(kind)
    zeros = (0.0,) * (dim + dim * dim)

    @njit(**OPTIONS)
    def dilate(q, lo, hi, nodes, lattice, cells, dt):  # type: ignore[no-untyped-def]
        ordered = len(q.order) > 0
        per_h = lattice[3]
        for e in range(lo, hi):
            p = q.order[e] if ordered else e
            got = get(nodes, lattice, q.at, q.domain, q.stretch, p, zeros)
            for r in range(dim * dim):
                q.L[p, r] = dt * per_h * got[dim + r]
            if axial:
                q.L[p, 4] = dt * got[0] / q.at[p, 0]
            c = cell(q.at, p, lattice)
            cells[c, 2] += q.volume[p] * det(q.F, p) * increment(q.L[p])

    return dilate


# --- less common passes --------------------------------------------------------------------------------------------------------
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
