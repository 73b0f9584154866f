"""Kernels of the explicit steps of solids: what the material answers at the domains, and how the nodes move under the forces."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numba import njit

from geofem.methods.pfem.solid_domains import OPTIONS, gradient_of
from geofem.scene import Array


@njit(**OPTIONS, inline="always")
def compose(a: float, b: float, c: float, d: float, g: Array, out: Array) -> None:
    """The gradient (a, b, c, d) of a step after the one before, g (5,), into out (5,)."""
    out[0], out[1] = a * g[0] + b * g[2], a * g[1] + b * g[3]
    out[2], out[3], out[4] = c * g[0] + d * g[2], c * g[1] + d * g[3], g[4]


@cache
def make_update(point: Callable[..., Any]) -> Callable[..., Any]:
    """The step of a law at the domains of region k among those from lo to hi, see ``update``; point: see ``materials.Kernels``."""

    @njit(**OPTIONS)
    def update(first, node, gradient, bulk, u, Fn, f, state, region, k, par, dt, hold, lo, hi, P, off, work):  # type: ignore[no-untyped-def]
        """Take u (n, 2), the displacement since configuration n, to the stresses P (d, 4) on it; f (d, 4), the gradient I + du/dx of
        the step before, and the state are replaced. hold: the modulus of what is taken off, see ``Body``: of the deviator of the
        step, off (d, 2), xx and xy. work (d,): adds that of the material's stresses per volume, less that of what is off. Returns -1,
        or the first domain that has turned inside out."""
        F, old, tau, new = np.empty(5), np.empty(5), np.empty(4), np.empty(4)
        for d in range(lo, hi):
            if region[d] != k:
                continue
            a, b, c, e = gradient_of(first, node, gradient, bulk, u, d, 1.0)
            g = Fn[d]
            compose(a, b, c, e, g, F)
            p, q, r, t = f[d, 0], f[d, 1], f[d, 2], f[d, 3]
            compose(p, q, r, t, g, old)
            for j in range(4):
                new[j] = state[d, j]
            if point(F, old, state[d], par, dt, tau, new) < 0:
                return d
            for j in range(4):
                state[d, j] = new[j]
            scale = 1.0 / ((a * e - b * c) * (g[0] * g[3] - g[1] * g[2]) * g[4])
            da, db, dc, de = a - p, b - q, c - r, e - t
            xx, xy = scale * (tau[0] * e - tau[3] * b), scale * (tau[3] * a - tau[0] * c)
            yx, yy = scale * (tau[3] * e - tau[1] * b), scale * (tau[1] * a - tau[3] * c)
            m, s = off[d, 0], off[d, 1]
            work[d] += 0.5 * (
                (P[d, 0] + m + xx) * da + (P[d, 1] + s + xy) * db + (P[d, 2] + s + yx) * dc + (P[d, 3] - m + yy) * de
            )
            mean, shear = 0.5 * hold * (da - de), 0.5 * hold * (db + dc)
            work[d] -= mean * (da - de) + shear * (db + dc)
            off[d, 0], off[d, 1] = mean, shear
            P[d, 0], P[d, 1], P[d, 2], P[d, 3] = xx - mean, xy - shear, yx - shear, yy + mean
            f[d, 0], f[d, 1], f[d, 2], f[d, 3] = a, b, c, e
        return -1

    return update


@njit(**OPTIONS)
def add_hold(cells: Array, gradient: Array, volume: Array, hold: Array, du: Array, force: Array) -> float:
    """Add the forces with which triangles resist the deviator of the gradient of du (n, 2), by the moduli hold (m,).

    Returns the work that such forces take in a step like that (J/m).
    """
    work = 0.0
    for c in range(len(cells)):
        xx = xy = yx = yy = 0.0
        for k in range(3):
            a = cells[c, k]
            gx, gy = gradient[3 * c + k, 0], gradient[3 * c + k, 1]
            xx += du[a, 0] * gx
            xy += du[a, 0] * gy
            yx += du[a, 1] * gx
            yy += du[a, 1] * gy
        mean, shear = 0.5 * hold[c] * volume[c] * (xx - yy), 0.5 * hold[c] * volume[c] * (xy + yx)
        work += mean * (xx - yy) + shear * (xy + yx)
        for k in range(3):
            a = cells[c, k]
            gx, gy = gradient[3 * c + k, 0], gradient[3 * c + k, 1]
            force[a, 0] += mean * gx + shear * gy
            force[a, 1] += shear * gx - mean * gy
    return work


@njit(**OPTIONS)
def advance(
    u: Array, du: Array, v: Array, mass: Array, force: Array, load: Array, dt: float, fixed: Array, given: Array,
    normal: Array, distance: Array, drift: Array, friction: Array, impulse: Array, held: Array,
) -> float:  # fmt: skip
    """One step dt (s) of all nodes: velocities v (n, 2) at the middle of the step, displacements u and their changes du.

    force, load : (n, 2) of the stresses, to be taken off, and of gravity and the like. fixed, given : (n, 2) dofs of given velocity.
    normal (o, n, 2), distance (o, n) : the face of each obstacle that a node may touch, and how far the node is in front of it, carried
    on; drift (o, 2) : velocity of the obstacles. A node that would pass through a face comes to lie on it, and of its tangential
    velocity loses at most the friction times what that took: a node leaves freely. impulse (o, 2), held (n, 2) : adds those of
    obstacles and supports on the nodes (N s). Returns the work of loads, obstacles and supports (J).
    """
    work = 0.0
    for a in range(len(v)):
        m = mass[a]
        if m <= 0.0:
            du[a, 0] = du[a, 1] = 0.0
            continue
        before0, before1 = v[a, 0], v[a, 1]
        for i in range(2):
            v[a, i] += dt * (load[a, i] - force[a, i]) / m
            if fixed[a, i]:
                held[a, i] += m * (given[a, i] - v[a, i])
                work += m * (given[a, i] - v[a, i]) * given[a, i]
                v[a, i] = given[a, i]
        for o in range(len(normal)):
            nx, ny = normal[o, a, 0], normal[o, a, 1]
            rx, ry = v[a, 0] - drift[o, 0], v[a, 1] - drift[o, 1]
            towards = nx * rx + ny * ry
            if distance[o, a] + dt * towards < 0.0:
                push = -distance[o, a] / dt - towards
                tx, ty = rx - towards * nx, ry - towards * ny
                along = np.sqrt(tx * tx + ty * ty)
                loss = 1.0 if friction[o] * push >= along else friction[o] * push / along
                cx, cy = push * nx - loss * tx, push * ny - loss * ty
                if fixed[a, 0]:
                    cx = 0.0
                if fixed[a, 1]:
                    cy = 0.0
                v[a, 0] += cx
                v[a, 1] += cy
                impulse[o, 0] += m * cx
                impulse[o, 1] += m * cy
                work += m * (cx * (0.5 * (v[a, 0] + before0)) + cy * (0.5 * (v[a, 1] + before1)))
            distance[o, a] += dt * (nx * (v[a, 0] - drift[o, 0]) + ny * (v[a, 1] - drift[o, 1]))
        for i in range(2):
            du[a, i] = dt * v[a, i]
            u[a, i] += du[a, i]
        work += dt * (load[a, 0] * 0.5 * (v[a, 0] + before0) + load[a, 1] * 0.5 * (v[a, 1] + before1))
    return work


@njit(**OPTIONS)
def largest_frequency(
    first: Array, node: Array, gradient: Array, bulk: Array, volume: Array, modulus: Array, mass: Array
) -> float:
    """A bound on the largest circular frequency (1/s) of the domains of moduli (d,) of compression: rows of the stiffness (Gershgorin)."""
    row = np.zeros(len(mass))
    for d in range(len(volume)):
        total = 0.0
        for s in range(first[d], first[d + 1]):
            total += np.hypot(gradient[s, 0], gradient[s, 1]) + 1.5 * np.hypot(bulk[s, 0], bulk[s, 1])
        for s in range(first[d], first[d + 1]):
            size = np.hypot(gradient[s, 0], gradient[s, 1]) + 1.5 * np.hypot(bulk[s, 0], bulk[s, 1])
            row[node[s]] += volume[d] * modulus[d] * size * total
    most = 0.0
    for a in range(len(mass)):
        if mass[a] > 0.0:
            most = max(most, row[a] / mass[a])
    return np.sqrt(most)
