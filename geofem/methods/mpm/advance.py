"""What the points make of the nodes' velocities: they move, they are strained, and their stress follows; see ``scatter``."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numba import njit

from geofem.methods.mpm import grid as g
from geofem.methods.mpm.cure import make_increment
from geofem.methods.mpm.deeds import AGAIN, inlined, make_get_gradient, make_get_motion, make_put
from geofem.methods.mpm.kind import OPTIONS, Answer, Kind
from geofem.methods.mpm.scatter import make_cell, make_packs, make_unmoment
from geofem.methods.mpm.shapes import SHAPES


@cache
def make_move(kind: Kind) -> Callable[..., Any]:
    """(q, p, got, dt, flip, h) -> (work of the point's force, its kinetic energy twice, its speed squared); moves point p.

    got : what ``make_get_motion`` carried.
    """
    dim, loaded, apic, xpic = kind.dim, kind.loaded, kind.transfer == "apic", kind.transfer == "xpic"
    B, D = 3 * dim + dim * dim, 3 * dim + 2 * dim * dim
    unmoment = make_unmoment(dim)

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
            unmoment(q.C, p, got, B, got, D, 1.0 / h)
        return work, m * square, square

    return move


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


@inlined
def keep_state(q, p, new_state):  # type: ignore[no-untyped-def]
    for k in range(len(new_state)):
        q.state[p, k] = new_state[k]


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
                keep_state(q, p, new_state)
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
                keep_state(q, p, new_state)
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
