"""Forces and tangent of material points on the nodes of the grid, and the volumetric cure that couples the points of a cell.

A point's displacement gradient of the load step, G (g components, the last of g = 5 the hoop's with axial symmetry), is linear in the
nodal increments: G = B du. With the cure the law sees, in place of the increment f = I + G,

    f~ = (theta / det f)^(1/d) f,  theta = sum V det f / sum V over the points of the cell,

V being volumes at the start of the step (F-bar of de Souza Neto et al. 1996 in its form that keeps the work of the stresses, so that
the tangent of an elastic law is symmetric; Coombs et al. 2018 for material points). At small strain G~ = G + (theta - tr G) / d I. In
both cases the law's work depends on (G, theta) of each point, and the chain rule gives forces and tangent exactly.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from numba import njit

from geofem.materials.kinematics import COLUMNS_PLANE, COLUMNS_SOLID, ROWS_PLANE, ROWS_SOLID, unpack_inverse
from geofem.methods.mpm.grid import OPTIONS


@cache
def make_increments(dim: int, axial: bool) -> Callable[..., None]:
    """(count, dof, weight, gradient, radius, du, G, u) -> None: displacement gradients (N, g) and displacements (N, d) of points."""

    @njit(**OPTIONS)
    def increments(count, dof, weight, gradient, radius, du, G, u):  # type: ignore[no-untyped-def]
        for p in range(len(count)):
            for k in range(G.shape[1]):
                G[p, k] = 0.0
            for c in range(dim):
                u[p, c] = 0.0
            for k in range(count[p]):
                n, w = dof[p, k], weight[p, k]
                for r in range(dim):
                    u[p, r] += w * du[n, r]
                    for c in range(dim):
                        G[p, dim * r + c] += gradient[p, k, c] * du[n, r]
            if axial:
                G[p, 4] = u[p, 0] / radius[p]

    return increments


@cache
def make_average(g: int, d: int, small: bool) -> Callable[..., None]:
    """How the averaged increment depends on (G, theta).

    (f (N, g), theta (N,), T (N, g, g + 1), D (N, g)) -> None: T, the derivative of what the law sees with respect to (G, theta), and
    D, that of det f (of tr G at small strain) with respect to G. d : components of the volume that is averaged.
    """
    rows, columns = (ROWS_PLANE, COLUMNS_PLANE) if g == 5 else (ROWS_SOLID, COLUMNS_SOLID)
    last = 4 if g == 5 and d == 2 else g  # components from here on take no part in the average

    @njit(**OPTIONS)
    def average(f, theta, T, D):  # type: ignore[no-untyped-def]
        inverse = np.empty((3, 3))
        for p in range(len(f)):
            T[p] = 0.0
            D[p] = 0.0
            if small:
                for a in range(g):
                    T[p, a, a] = 1.0
                for a in range(last):
                    if rows[a] == columns[a]:
                        D[p, a] = 1.0
                        T[p, a, g] = 1.0 / d
                        for b in range(last):
                            if rows[b] == columns[b]:
                                T[p, a, b] -= 1.0 / d
                continue
            unpack_inverse(f[p], inverse)
            j = f[p, 0] * f[p, 3] - f[p, 1] * f[p, 2]
            if g == 5 and d == 3:
                j *= f[p, 4]
            elif g == 9:
                j = 1.0 / np.linalg.det(inverse)
            s = (theta[p] / j) ** (1.0 / d)
            for a in range(last, g):
                T[p, a, a] = 1.0
            for a in range(last):
                D[p, a] = j * inverse[columns[a], rows[a]]
                T[p, a, a] = s
                T[p, a, g] = s * f[p, a] / (d * theta[p])
            for a in range(last):
                for b in range(last):
                    T[p, a, b] -= s / d * f[p, a] * inverse[columns[b], rows[b]]

    return average


@cache
def make_chain(g: int, d: int, small: bool) -> Callable[..., None]:
    """(f, theta, ratio, T, D, P, A, H) -> None: the tangent H (N, g + 1, g + 1) of the points with respect to (G, theta).

    ratio (N,) : the cell's force on its volume over the sum of the volumes, see ``Response.update``.
    """
    rows, columns = (ROWS_PLANE, COLUMNS_PLANE) if g == 5 else (ROWS_SOLID, COLUMNS_SOLID)
    last = 4 if g == 5 and d == 2 else g

    @njit(**OPTIONS)
    def chain(f, theta, ratio, T, D, P, A, H):  # type: ignore[no-untyped-def]
        inverse, kappa, half = np.empty((3, 3)), np.empty(g + 1), np.empty((g, g + 1))
        for p in range(len(f)):
            for a in range(g):
                for b in range(g + 1):
                    half[a, b] = 0.0
                    for c in range(g):
                        half[a, b] += A[p, a, c] * T[p, c, b]
            for a in range(g + 1):
                for b in range(g + 1):
                    H[p, a, b] = 0.0
                    for c in range(g):
                        H[p, a, b] += T[p, c, a] * half[c, b]
            if small:
                continue
            unpack_inverse(f[p], inverse)
            t = theta[p]
            kappa[:] = 0.0
            kappa[g] = 1.0 / t
            power = 0.0
            s = T[p, 0, 0] + T[p, 0, g] * t * inverse[0, 0]
            for a in range(last):
                kappa[a] = -inverse[columns[a], rows[a]]
                power += s * P[p, a] * f[p, a]
            for a in range(g + 1):
                for b in range(g + 1):
                    H[p, a, b] += power / (d * d) * kappa[a] * kappa[b]
                    if a < last:
                        H[p, a, b] += s / d * P[p, a] * kappa[b]
                    if b < last:
                        H[p, a, b] += s / d * P[p, b] * kappa[a]
            H[p, g, g] -= power / d / (t * t)
            j = D[p, 0] / inverse[0, 0]
            for a in range(last):
                for b in range(last):
                    turned = inverse[columns[a], rows[b]] * inverse[columns[b], rows[a]]
                    H[p, a, b] += power / d * turned + ratio[p] * j * (kappa[a] * kappa[b] - turned)

    return chain


@cache
def make_forces(dim: int, axial: bool) -> Callable[..., None]:
    """(count, dof, weight, gradient, radius, stress (N, g), load (N, d), out (blocks, d)) -> None: adds B^T stress - S load."""

    @njit(**OPTIONS)
    def forces(count, dof, weight, gradient, radius, stress, load, out):  # type: ignore[no-untyped-def]
        for p in range(len(count)):
            for k in range(count[p]):
                n, w = dof[p, k], weight[p, k]
                for r in range(dim):
                    value = -w * load[p, r]
                    for c in range(dim):
                        value += stress[p, dim * r + c] * gradient[p, k, c]
                    out[n, r] += value
                if axial:
                    out[n, 0] += stress[p, 4] * w / radius[p]

    return forces


@cache
def make_stiffness(dim: int, axial: bool, cure: bool) -> Callable[..., None]:
    """The tangent of every group of points, a dense block over its nodes' dofs.

    (points, start, first, slot, count, weight, gradient, radius, volume, H, D, spring, values) -> None. spring (N, d, d) : minus the
    derivative of the point's own force with respect to its displacement (N/m), or empty. values : the blocks, one after the other.
    """
    g = 5 if dim == 2 else 9

    @njit(**OPTIONS)
    def stiffness(points, start, first, slot, count, weight, gradient, radius, volume, H, D, spring, values):  # type: ignore[no-untyped-def]
        at = 0
        most = slot.shape[1]
        HB = np.empty((most, dim, g))
        for e in range(len(start) - 1):
            m = (first[e + 1] - first[e]) * dim
            K = values[at : at + m * m].reshape(m, m)
            K[:] = 0.0
            b, left, right, both, total = np.zeros(m), np.zeros(m), np.zeros(m), 0.0, 0.0
            for q in range(start[e], start[e + 1]):
                p = points[q]
                V, h = volume[p], H[p]
                total += V
                for k in range(count[p]):
                    for r in range(dim):
                        for a in range(g):
                            value = 0.0
                            for c in range(dim):
                                value += h[a, dim * r + c] * gradient[p, k, c]
                            if axial and r == 0:
                                value += h[a, 4] * weight[p, k] / radius[p]
                            HB[k, r, a] = V * value
                for i in range(count[p]):
                    row = slot[p, i] * dim
                    for k in range(count[p]):
                        column = slot[p, k] * dim
                        for c in range(dim):
                            for r in range(dim):
                                value = 0.0
                                for s in range(dim):
                                    value += HB[k, c, dim * r + s] * gradient[p, i, s]
                                if axial and r == 0:
                                    value += HB[k, c, 4] * weight[p, i] / radius[p]
                                K[row + r, column + c] += value
                    if len(spring):
                        for k in range(count[p]):
                            column = slot[p, k] * dim
                            for r in range(dim):
                                for c in range(dim):
                                    K[row + r, column + c] += weight[p, i] * weight[p, k] * spring[p, r, c]
                if cure:
                    both += V * h[g, g]
                    for k in range(count[p]):
                        row = slot[p, k] * dim
                        for r in range(dim):
                            for c in range(dim):
                                a = dim * r + c
                                b[row + r] += V * D[p, a] * gradient[p, k, c]
                                left[row + r] += V * h[a, g] * gradient[p, k, c]
                                right[row + r] += V * h[g, a] * gradient[p, k, c]
                            if axial and r == 0:
                                w = weight[p, k] / radius[p]
                                b[row] += V * D[p, 4] * w
                                left[row] += V * h[4, g] * w
                                right[row] += V * h[g, 4] * w
            if cure:
                for i in range(m):
                    b[i] /= total
                for i in range(m):
                    for k in range(m):
                        K[i, k] += left[i] * b[k] + b[i] * right[k] + both * b[i] * b[k]
            at += m * m

    return stiffness
