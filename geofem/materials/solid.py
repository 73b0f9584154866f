"""From a law in principal space to its kernels in space (m = 6, g = 9); what a law is: see ``geofem.materials.plane``."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from geofem.materials.kinematics import Array, Floats, Kernel, det_solid, helper, inverse_solid, kernel
from geofem.materials.plane import OPEN
from geofem.materials.principal import eigen_solid, log_slope, shear_ratio


@helper
def trial_solid(F: Array, F_old: Array, state: Array, history: bool) -> Floats:
    """The elastic trial left Cauchy-Green tensor, see ``plane.trial_plane``."""
    if history:
        i = inverse_solid(F_old)
        f0, f1, f2 = times(F[0], F[1], F[2], i)
        f3, f4, f5 = times(F[3], F[4], F[5], i)
        f6, f7, f8 = times(F[6], F[7], F[8], i)
        b = (1.0 + state[0], state[3], state[5], state[3], 1.0 + state[1], state[4], state[5], state[4], 1.0 + state[2])
        x0, x1, x2 = times(f0, f1, f2, b)
        y0, y1, y2 = times(f3, f4, f5, b)
        z0, z1, z2 = times(f6, f7, f8, b)
    else:
        f0, f1, f2, f3, f4, f5, f6, f7, f8 = F[0], F[1], F[2], F[3], F[4], F[5], F[6], F[7], F[8]
        x0, x1, x2, y0, y1, y2, z0, z1, z2 = f0, f1, f2, f3, f4, f5, f6, f7, f8
    return (
        x0 * f0 + x1 * f1 + x2 * f2, y0 * f3 + y1 * f4 + y2 * f5, z0 * f6 + z1 * f7 + z2 * f8,
        x0 * f3 + x1 * f4 + x2 * f5, y0 * f6 + y1 * f7 + y2 * f8, x0 * f6 + x1 * f7 + x2 * f8,
    )  # fmt: skip


@helper
def times(x: float, y: float, z: float, m: Floats) -> tuple[float, float, float]:
    """The row (x, y, z) times the matrix m, given row by row."""
    return x * m[0] + y * m[3] + z * m[6], x * m[1] + y * m[4] + z * m[7], x * m[2] + y * m[5] + z * m[8]


@helper
def compose(r: Floats, axes: Floats) -> Floats:
    """The tensor (xx, yy, zz, xy, yz, xz) with the 3 eigenvalues r along the axes, 3 components each."""
    ux, uy, uz, vx, vy, vz, wx, wy, wz = axes
    a, b, c = r
    return (
        a * ux * ux + b * vx * vx + c * wx * wx,
        a * uy * uy + b * vy * vy + c * wy * wy,
        a * uz * uz + b * vz * vz + c * wz * wz,
        a * ux * uy + b * vx * vy + c * wx * wy,
        a * uy * uz + b * vy * vz + c * wy * wz,
        a * ux * uz + b * vx * vz + c * wx * wz,
    )


@helper
def shear_ratios(s: Floats, r: Floats, d: Floats, G: float) -> tuple[float, float, float]:
    """``shear_ratio`` between axes 0 and 1, 1 and 2, 0 and 2; s, r: trial and returned stresses, d: principal tangent."""
    return (
        shear_ratio(s[0], s[1], r[0], r[1], d[0], d[1], d[3], d[4], G),
        shear_ratio(s[1], s[2], r[1], r[2], d[4], d[5], d[7], d[8], G),
        shear_ratio(s[0], s[2], r[0], r[2], d[0], d[2], d[6], d[8], G),
    )


@helper
def strain_between(row: Array, axes: Floats, a: int, b: int) -> None:
    """Write the 6 coefficients that give the strain between axes a and b from the strain components."""
    ux, uy, uz, vx, vy, vz = axes[3 * a], axes[3 * a + 1], axes[3 * a + 2], axes[3 * b], axes[3 * b + 1], axes[3 * b + 2]
    row[0], row[1], row[2] = ux * vx, uy * vy, uz * vz
    row[3], row[4], row[5] = 0.5 * (ux * vy + uy * vx), 0.5 * (uy * vz + uz * vy), 0.5 * (ux * vz + uz * vx)


def small_solid(returned: Kernel, tangent: Kernel) -> Kernel:
    """The small-strain batch kernel of a principal-space law (see ``Kernels.small``)."""

    @kernel
    def small(dstrain: Array, state: Array, par: Array, stress: Array, tangents: Array, new_state: Array) -> int:
        lam, G = par[0], par[1]
        plastic = 0
        # Row k of basis: the strain between two axes, (00, 11, 22, 01, 12, 02), from the 6 strain components.
        basis, moved, t = np.empty((6, 6)), np.empty((6, 6)), np.empty(6)
        for n in range(dstrain.shape[0]):
            volume = lam * (dstrain[n, 0] + dstrain[n, 1] + dstrain[n, 2])
            for i in range(3):
                t[i] = state[n, i] + volume + 2.0 * G * dstrain[n, i]
                t[i + 3] = state[n, i + 3] + G * dstrain[n, i + 3]
            s, axes = eigen_solid(t[0], t[1], t[2], t[3], t[4], t[5])
            region, ra, rb, rc = returned(s[0], s[1], s[2], par, math.inf)
            D = tangents[n]
            D[:] = 0.0
            if region == 0:
                for i in range(3):
                    for j in range(3):
                        D[i, j] = lam
                    D[i, i] += 2.0 * G
                    D[i + 3, i + 3] = G
            else:
                plastic += 1
                d = tangent(region, s[0], s[1], s[2], par, math.inf)
                shear = shear_ratios(s, (ra, rb, rc), d, G)
                strain_between(basis[0], axes, 0, 0)
                strain_between(basis[1], axes, 1, 1)
                strain_between(basis[2], axes, 2, 2)
                strain_between(basis[3], axes, 0, 1)
                strain_between(basis[4], axes, 1, 2)
                strain_between(basis[5], axes, 0, 2)
                for i in range(3):
                    for j in range(6):
                        moved[i, j] = d[3 * i] * basis[0, j] + d[3 * i + 1] * basis[1, j] + d[3 * i + 2] * basis[2, j]
                        moved[i + 3, j] = 4.0 * G * shear[i] * basis[i + 3, j]
                for i in range(6):
                    for k in range(6):
                        for j in range(6):
                            D[i, j] += basis[k, i] * moved[k, j]
                t[0], t[1], t[2], t[3], t[4], t[5] = compose((ra, rb, rc), axes)
            for i in range(6):
                stress[n, i] = new_state[n, i] = t[i]
        return plastic

    return small


def finite_solid(returned: Kernel, tangent: Kernel, history: bool) -> tuple[Kernel, Kernel]:
    """The finite-strain batch kernel of a principal-space law and its point kernel: see ``plane.finite_plane``."""

    @helper
    def answer(F: Array, F_old: Array, state: Array, par: Array, dt: float, new_state: Array) -> Any:
        """Return mapping at a point; writes the new state. Returns the region, stretches squared l, logarithmic strains e,
        trial stresses s and Kirchhoff stresses r along the axes, and the axes."""
        lam, G = par[0], par[1]
        b = trial_solid(F, F_old, state, history)
        l, axes = eigen_solid(b[0], b[1], b[2], b[3], b[4], b[5])
        e = (0.5 * math.log(l[0]), 0.5 * math.log(l[1]), 0.5 * math.log(l[2]))
        volume = lam * (e[0] + e[1] + e[2])
        s = (volume + 2.0 * G * e[0], volume + 2.0 * G * e[1], volume + 2.0 * G * e[2])
        region, ra, rb, rc = returned(s[0], s[1], s[2], par, dt)
        if history:
            if region == OPEN:
                v = math.exp(2.0 / 3.0 * (e[0] + e[1] + e[2]))
                b = (v, v, v, 0.0, 0.0, 0.0)
            elif region > 0:
                mean = lam / (3.0 * lam + 2.0 * G) * (ra + rb + rc)
                b = compose((math.exp((ra - mean) / G), math.exp((rb - mean) / G), math.exp((rc - mean) / G)), axes)
            new_state[0], new_state[1], new_state[2] = b[0] - 1.0, b[1] - 1.0, b[2] - 1.0
            new_state[3], new_state[4], new_state[5] = b[3], b[4], b[5]
        return region, l, e, s, (ra, rb, rc), axes

    @kernel
    def finite(F: Array, F_old: Array, state: Array, par: Array, dt: float, P: Array, A: Array, new_state: Array) -> int:
        G = par[1]
        plastic = 0
        # Row 3 a + b of basis: axis a times axis b pulled back by F^-1, over the components of F.
        basis, moved, pulled = np.empty((9, 9)), np.empty((9, 9)), np.empty(9)
        for n in range(F.shape[0]):
            if not det_solid(F[n]) > 0.0:
                return -1 - n
            region, l, e, s, r, axes = answer(F[n], F_old[n], state[n], par, dt, new_state[n])
            plastic += region > 0
            d = tangent(region, s[0], s[1], s[2], par, dt)
            shear = shear_ratios(s, r, d, G)
            i = inverse_solid(F[n])
            for b in range(3):
                for j in range(3):
                    pulled[3 * b + j] = axes[3 * b] * i[3 * j] + axes[3 * b + 1] * i[3 * j + 1] + axes[3 * b + 2] * i[3 * j + 2]
            for a in range(3):
                for b in range(3):
                    for k in range(3):
                        for j in range(3):
                            basis[3 * a + b, 3 * k + j] = axes[3 * a + k] * pulled[3 * b + j]
            for j in range(9):
                x, y, z = basis[0, j], basis[4, j], basis[8, j]
                moved[0, j] = (d[0] - r[0]) * x + d[1] * y + d[2] * z
                moved[4, j] = d[3] * x + (d[4] - r[1]) * y + d[5] * z
                moved[8, j] = d[6] * x + d[7] * y + (d[8] - r[2]) * z
                P[n, j] = r[0] * x + r[1] * y + r[2] * z
            for pair in range(3):
                a, b = (pair, pair + 1) if pair < 2 else (0, 2)
                # Derivative of the shear stress between axes a and b by the trial left Cauchy-Green tensor.
                h = 2.0 * G * shear[pair] * log_slope(e[a], e[b], l[a], l[b])
                ab, ba = 3 * a + b, 3 * b + a
                for j in range(9):
                    moved[ab, j] = h * l[b] * basis[ab, j] + (h * l[a] - r[a]) * basis[ba, j]
                    moved[ba, j] = (h * l[b] - r[b]) * basis[ab, j] + h * l[a] * basis[ba, j]
            for p in range(9):
                for q in range(9):
                    A[n, p, q] = 0.0
                for k in range(9):
                    for q in range(9):
                        A[n, p, q] += basis[k, p] * moved[k, q]
        return plastic

    @helper
    def point(F: Array, F_old: Array, state: Array, par: Array, dt: float, tau: Array, new_state: Array) -> int:
        if not det_solid(F) > 0.0:
            return -1
        region, _, _, _, r, axes = answer(F, F_old, state, par, dt, new_state)
        tau[0], tau[1], tau[2], tau[3], tau[4], tau[5] = compose(r, axes)
        return 1 if region > 0 else 0

    return finite, point
