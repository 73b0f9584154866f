"""What the material points and the grid tell each other in an explicit step (Sulsky, Chen & Schreyer 1994).

    m_n = sum S_np m_p        m_n v_n = sum S_np m_p v_p        f_n = sum S_np m_p b_p - sum V0_p tau_p grad S_np
    v_n' = v_n + dt a_n,  a_n = f_n / m_n + g,  or the prescribed velocity
    v_p' = flip (v_p + dt sum S_np a_n) + (1 - flip) sum S_np v_n'            (FLIP and PIC, blended)
    x_p' = x_p + dt sum S_np v_n'              F_p' = (I + dt L_p) F_p,  L_p = sum v_n grad S_np

V0 is the reference volume and tau the Kirchhoff stress, so that V0 tau = V sigma. The schemes differ in the nodal velocity
behind L: ``usl`` (update stress last) takes v_n'; ``usf`` (update stress first) the v_n mapped from the points, before the
forces; ``musl`` (modified update stress last) the velocities mapped anew from the updated points.

A *shape* is the plug-in: a function of a coordinate in cells that gives the first node, the weights of the nodes from there
on, and their derivatives; the weights of the two directions are multiplied.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numba import njit

from geofem.methods.mpm import grid as g
from geofem.methods.mpm.grid import FAST, accelerate, clear, hold, momentum_to_velocity, set_velocity

SCHEMES = ("musl", "usl", "usf")


@njit(inline="always", **FAST)
def hat(s: float) -> Any:
    """The two linear hat functions at s."""
    first = int(s)
    r = s - first
    return first, (1.0 - r, r), (-1.0, 1.0)


SHAPES = {"linear": hat}


@cache
def make_transfer(shape: str, scheme: str, small: bool) -> tuple[Callable[..., None], Callable[..., None]]:
    """The passes that know no material: ``to_grid`` opens a step, ``to_points`` ends it.

    The points are at ``at`` on the grid: where they were at the end of the last step, or, with ``small`` strain, in the
    reference configuration.
    """
    weights = SHAPES[shape]
    reach = len(weights(0.5)[1])
    first, modified = scheme == "usf", scheme == "musl"

    @njit(**FAST)
    def scatter(at, v, mass, volume, tau, body, lattice, grid, dt, sums):  # type: ignore[no-untyped-def]
        """Mass, momentum, and forces where the stress is known already."""
        x0, y0, per_h, _, ny = lattice
        loaded = len(body) > 0
        for p in range(len(at)):
            i, wx, dx = weights((at[p, 0] - x0) * per_h)
            j, wy, dy = weights((at[p, 1] - y0) * per_h)
            m = mass[p]
            px, py = m * v[p, 0], m * v[p, 1]
            s = -volume[p] * per_h
            sxx, syy, sxy = s * tau[p, 0], s * tau[p, 1], s * tau[p, 3]
            bx = by = 0.0
            if loaded:
                bx, by = m * body[p, 0], m * body[p, 1]
                sums[g.IMPULSE_X] += dt * bx
                sums[g.IMPULSE_Y] += dt * by
            for k in range(reach):
                for q in range(reach):
                    n = (i + k) * ny + j + q
                    w = wx[k] * wy[q]
                    grid[n, g.MASS] += w * m
                    grid[n, g.VX] += w * px
                    grid[n, g.VY] += w * py
                    if first:
                        grid[n, g.AX] += w * bx
                        grid[n, g.AY] += w * by
                    else:
                        gx, gy = dx[k] * wy[q], wx[k] * dy[q]
                        grid[n, g.AX] += w * bx + sxx * gx + sxy * gy
                        grid[n, g.AY] += w * by + sxy * gx + syy * gy

    @njit(**FAST)
    def blend(at, x, v, mass, body, lattice, grid, dt, flip, sums):  # type: ignore[no-untyped-def]
        """New positions and velocities of the points and, in the scheme musl, their momentum back to the grid."""
        x0, y0, per_h, _, ny = lattice
        loaded = len(body) > 0
        kinetic = speed2 = work = 0.0
        for p in range(len(at)):
            i, wx, _ = weights((at[p, 0] - x0) * per_h)
            j, wy, _ = weights((at[p, 1] - y0) * per_h)
            vx = vy = ax = ay = 0.0
            for k in range(reach):
                for q in range(reach):
                    n = (i + k) * ny + j + q
                    w = wx[k] * wy[q]
                    vx += w * grid[n, g.VX]
                    vy += w * grid[n, g.VY]
                    ax += w * grid[n, g.AX]
                    ay += w * grid[n, g.AY]
            m = mass[p]
            if loaded:
                work += m * (body[p, 0] * vx + body[p, 1] * vy)
            x[p, 0] += dt * vx
            x[p, 1] += dt * vy
            vx = flip * (v[p, 0] + dt * ax) + (1.0 - flip) * vx
            vy = flip * (v[p, 1] + dt * ay) + (1.0 - flip) * vy
            v[p, 0], v[p, 1] = vx, vy
            square = vx * vx + vy * vy
            kinetic += m * square
            speed2 = max(speed2, square)
            if modified:
                for k in range(reach):
                    for q in range(reach):
                        n = (i + k) * ny + j + q
                        w = wx[k] * wy[q] * m
                        grid[n, g.WX] += w * vx
                        grid[n, g.WY] += w * vy
        sums[g.KINETIC] = 0.5 * kinetic
        sums[g.SPEED2] = speed2
        sums[g.WORK] += dt * work

    @njit(**FAST)
    def to_grid(at, x, v, mass, volume, tau, body, lattice, grid, held, least_mass, dt, gravity, damping, flip, sums, marks):  # type: ignore[no-untyped-def]
        ny = lattice[4]
        box = (marks[g.I0], marks[g.I1] + reach, marks[g.J0], marks[g.J1] + reach)
        clear(grid, box, ny)
        sums[:] = 0.0
        scatter(at, v, mass, volume, tau, body, lattice, grid, dt, sums)
        if first:
            momentum_to_velocity(grid, g.VX, g.WX, box, ny, least_mass)
            set_velocity(grid, g.WX, held)
        momentum_to_velocity(grid, g.VX, g.VX, box, ny, least_mass)
        if first:
            return
        accelerate(grid, box, ny, least_mass, dt, gravity, damping, sums)
        hold(grid, held, least_mass, dt, gravity, damping, sums)
        blend(at, x, v, mass, body, lattice, grid, dt, flip, sums)
        if modified:
            momentum_to_velocity(grid, g.WX, g.WX, box, ny, least_mass)
            set_velocity(grid, g.WX, held)

    @njit(**FAST)
    def to_points(at, x, v, mass, body, lattice, grid, held, least_mass, dt, gravity, damping, flip, sums, marks):  # type: ignore[no-untyped-def]
        if first:
            ny = lattice[4]
            box = (marks[g.I0], marks[g.I1] + reach, marks[g.J0], marks[g.J1] + reach)
            accelerate(grid, box, ny, least_mass, dt, gravity, damping, sums)
            hold(grid, held, least_mass, dt, gravity, damping, sums)
            blend(at, x, v, mass, body, lattice, grid, dt, flip, sums)
        if not small:
            settle(at, x, lattice, marks)

    return to_grid, to_points


@cache
def make_deform(shape: str, scheme: str, point: Callable[..., int], small: bool) -> Callable[..., None]:
    """The pass in between, compiled for the point function of a material law; with ``small`` strain F = I + grad u."""
    weights = SHAPES[shape]
    reach = len(weights(0.5)[1])
    strain_velocity = g.VX if scheme == "usl" else g.WX
    first = scheme == "usf"

    @njit(**FAST)
    def deform(at, F, state, volume, tau, par, lattice, grid, dt, sums, marks, offset):  # type: ignore[no-untyped-def]
        """Deformation gradient and stress; in the scheme usf the forces too."""
        x0, y0, per_h, _, ny = lattice
        old, new_state = np.empty(5), np.empty(state.shape[1])
        power = 0.0
        for p in range(len(at)):
            i, wx, dx = weights((at[p, 0] - x0) * per_h)
            j, wy, dy = weights((at[p, 1] - y0) * per_h)
            lxx = lxy = lyx = lyy = 0.0
            for k in range(reach):
                for q in range(reach):
                    n = (i + k) * ny + j + q
                    gx, gy = dx[k] * wy[q], wx[k] * dy[q]
                    vx, vy = grid[n, strain_velocity], grid[n, strain_velocity + 1]
                    lxx += vx * gx
                    lxy += vx * gy
                    lyx += vy * gx
                    lyy += vy * gy
            s = dt * per_h
            lxx, lxy, lyx, lyy = s * lxx, s * lxy, s * lyx, s * lyy
            xx, xy, yx, yy = F[p, 0], F[p, 1], F[p, 2], F[p, 3]
            old[0], old[1], old[2], old[3], old[4] = xx, xy, yx, yy, F[p, 4]
            if small:
                F[p, 0], F[p, 1], F[p, 2], F[p, 3] = xx + lxx, xy + lxy, yx + lyx, yy + lyy
            else:
                F[p, 0], F[p, 1] = xx + lxx * xx + lxy * yx, xy + lxx * xy + lxy * yy
                F[p, 2], F[p, 3] = yx + lyx * xx + lyy * yx, yy + lyx * xy + lyy * yy
            txx, tyy, tzz, txy = tau[p, 0], tau[p, 1], tau[p, 2], tau[p, 3]
            if point(F[p], old, state[p], par, dt, tau[p], new_state) < 0:
                F[p, 0], F[p, 1], F[p, 2], F[p, 3] = xx, xy, yx, yy
                tau[p, 0], tau[p, 1], tau[p, 2], tau[p, 3] = txx, tyy, tzz, txy
                marks[g.FAULT], marks[g.POINT] = g.TANGLED, offset + p
                continue
            for k in range(len(new_state)):
                state[p, k] = new_state[k]
            power += volume[p] * ((txx + tau[p, 0]) * lxx + (tyy + tau[p, 1]) * lyy + (txy + tau[p, 3]) * (lxy + lyx))
            if first:
                s = -volume[p] * per_h
                txx, tyy, txy = s * tau[p, 0], s * tau[p, 1], s * tau[p, 3]
                for k in range(reach):
                    for q in range(reach):
                        n = (i + k) * ny + j + q
                        gx, gy = dx[k] * wy[q], wx[k] * dy[q]
                        grid[n, g.AX] += txx * gx + txy * gy
                        grid[n, g.AY] += txy * gx + tyy * gy
        sums[g.STRAIN_WORK] += 0.5 * power

    return deform


@njit(**FAST)  # no cache: it would outlive a change of the constants in grid.py
def settle(at, x, lattice, marks):  # type: ignore[no-untyped-def]
    """Put the points where they have come to; count those that change cell, and box the cells that hold points."""
    x0, y0, per_h, nx, ny = lattice
    crossed = 0
    i0 = j0 = g.FAR
    i1 = j1 = 0
    for p in range(len(at)):
        sx, sy = (x[p, 0] - x0) * per_h, (x[p, 1] - y0) * per_h
        if not (0.0 <= sx < nx - 1 and 0.0 <= sy < ny - 1):  # so written that nan is outside
            marks[g.FAULT], marks[g.POINT] = g.ESCAPED, p
            continue
        i, j = int(sx), int(sy)
        crossed += i != int((at[p, 0] - x0) * per_h) or j != int((at[p, 1] - y0) * per_h)
        i0, i1, j0, j1 = min(i0, i), max(i1, i), min(j0, j), max(j1, j)
        at[p, 0], at[p, 1] = x[p, 0], x[p, 1]
    marks[g.CROSSED] = crossed
    marks[g.I0], marks[g.I1], marks[g.J0], marks[g.J1] = i0, i1, j0, j1
