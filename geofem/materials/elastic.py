"""Hooke's law, geometrically linear, and the compressible neo-Hookean solid. par = (lambda, G) in Pa."""

from __future__ import annotations

import math

import numpy as np

from geofem.materials import Kernels
from geofem.materials.hencky import parameters
from geofem.materials.isotropic import elastic_energy, wave_speed
from geofem.materials.kinematics import (
    Array,
    det,
    helper,
    indices,
    kernel,
    matrices,
    push,
    unpack_inverse,
)


# --- Hooke ----------------------------------------------------------------------------------------------------------------
@kernel
def linear_small(dstrain: Array, state: Array, par: Array, stress: Array, tangents: Array, new_state: Array) -> int:
    lam, G = par[0], par[1]
    m = dstrain.shape[1]
    for n in range(dstrain.shape[0]):
        volume = lam * (dstrain[n, 0] + dstrain[n, 1] + dstrain[n, 2])
        for i in range(m):
            change = volume + 2.0 * G * dstrain[n, i] if i < 3 else G * dstrain[n, i]
            stress[n, i] = new_state[n, i] = state[n, i] + change
            for j in range(m):
                tangents[n, i, j] = lam if i < 3 and j < 3 else 0.0
            tangents[n, i, i] += 2.0 * G if i < 3 else G
    return 0


@kernel
def linear_finite(F: Array, F_old: Array, state: Array, par: Array, dt: float, P: Array, A: Array, new_state: Array) -> int:
    """P = C : (sym F - I): geometrically linear, so that the deformation may be any, det F <= 0 too. Leaves the state alone."""
    lam, G = par[0], par[1]
    g = F.shape[1]
    row, column = indices(g)
    for n in range(F.shape[0]):
        trace = F[n, 0] + F[n, 3] + F[n, 4] if g == 5 else F[n, 0] + F[n, 4] + F[n, 8]
        for p in range(g):
            i, j = row[p], column[p]
            q = transposed(p, g)
            P[n, p] = G * (F[n, p] + F[n, q]) + (lam * (trace - 3.0) - 2.0 * G if i == j else 0.0)
            for r in range(g):
                A[n, p, r] = lam if i == j and row[r] == column[r] else 0.0
            A[n, p, p] += G
            A[n, p, q] += G
    return 0


@helper
def transposed(p: int, g: int) -> int:
    """The place of component ji, given that of ij."""
    if g == 5:
        return 3 - p if p == 1 or p == 2 else p
    return 3 * (p % 3) + p // 3


@helper
def linear_point(F: Array, F_old: Array, state: Array, par: Array, dt: float, tau: Array, new_state: Array) -> int:
    lam, G = par[0], par[1]
    if F.shape[0] == 5:
        volume = lam * (F[0] + F[3] + F[4] - 3.0)
        tau[0], tau[1] = volume + 2.0 * G * (F[0] - 1.0), volume + 2.0 * G * (F[3] - 1.0)
        tau[2], tau[3] = volume + 2.0 * G * (F[4] - 1.0), G * (F[1] + F[2])
    else:
        volume = lam * (F[0] + F[4] + F[8] - 3.0)
        tau[0], tau[1] = volume + 2.0 * G * (F[0] - 1.0), volume + 2.0 * G * (F[4] - 1.0)
        tau[2] = volume + 2.0 * G * (F[8] - 1.0)
        tau[3], tau[4], tau[5] = G * (F[1] + F[3]), G * (F[5] + F[7]), G * (F[2] + F[6])
    return 0


def linear_energy(F: Array, par: Array) -> Array:
    """lambda/2 (tr e)^2 + G e:e, e = sym F - I: F (N, g) -> (N,), J/m3."""
    full = matrices(F)
    e = 0.5 * (full + np.swapaxes(full, 1, 2)) - np.eye(3)
    return 0.5 * par[0] * np.trace(e, axis1=1, axis2=2) ** 2 + par[1] * (e**2).sum((1, 2))


# --- neo-Hooke --------------------------------------------------------------------------------------------------------------
@kernel
def neo_hooke_finite(F: Array, F_old: Array, state: Array, par: Array, dt: float, P: Array, A: Array, new_state: Array) -> int:
    """P = G (F - F^-T) + lambda ln J F^-T (Bonet and Wood 2008, eq. 6.28). Leaves the state alone."""
    lam, G = par[0], par[1]
    g = F.shape[1]
    row, column = indices(g)
    inverse = np.empty((3, 3))
    for n in range(F.shape[0]):
        J = det(F[n])
        if not J > 0.0:
            return -1 - n
        unpack_inverse(F[n], inverse)
        pressure = lam * math.log(J) - G
        for p in range(g):
            i, j = row[p], column[p]
            P[n, p] = G * F[n, p] + pressure * inverse[j, i]
            for q in range(g):
                k, l = row[q], column[q]
                A[n, p, q] = lam * inverse[j, i] * inverse[l, k] - pressure * inverse[j, k] * inverse[l, i]
            A[n, p, p] += G
    return 0


@helper
def neo_hooke_point(F: Array, F_old: Array, state: Array, par: Array, dt: float, tau: Array, new_state: Array) -> int:
    """tau = G (F F^T - I) + lambda ln J I."""
    lam, G = par[0], par[1]
    J = det(F)
    if not J > 0.0:
        return -1
    pressure = lam * math.log(J) - G
    if F.shape[0] == 5:
        tau[0] = G * (F[0] * F[0] + F[1] * F[1]) + pressure
        tau[1] = G * (F[2] * F[2] + F[3] * F[3]) + pressure
        tau[2] = G * F[4] * F[4] + pressure
        tau[3] = G * (F[0] * F[2] + F[1] * F[3])
    else:
        tau[0] = G * (F[0] * F[0] + F[1] * F[1] + F[2] * F[2]) + pressure
        tau[1] = G * (F[3] * F[3] + F[4] * F[4] + F[5] * F[5]) + pressure
        tau[2] = G * (F[6] * F[6] + F[7] * F[7] + F[8] * F[8]) + pressure
        tau[3] = G * (F[0] * F[3] + F[1] * F[4] + F[2] * F[5])
        tau[4] = G * (F[3] * F[6] + F[4] * F[7] + F[5] * F[8])
        tau[5] = G * (F[0] * F[6] + F[1] * F[7] + F[2] * F[8])
    return 0


def neo_hooke_energy(F: Array, par: Array) -> Array:
    """G/2 (F:F - 3 - 2 ln J) + lambda/2 ln^2 J: F (N, g) -> (N,), J/m3 of reference volume."""
    logJ = np.log(np.linalg.det(matrices(F)))
    return 0.5 * par[1] * ((F**2).sum(1) - 3.0 - 2.0 * logJ) + 0.5 * par[0] * logJ**2


@kernel
def neo_hooke_stiffest(F: Array, par: Array) -> float:
    """Largest modulus (Pa) of a compression wave over points, lambda (1 - ln J) + G (1 + n . b n), b = F F^T; n . b n by a bound,
    the largest sum of a row of |b|."""
    lam, G = par[0], par[1]
    stiffest = 0.0
    for p in range(F.shape[0]):
        f = F[p]
        if len(f) == 5:
            xx, yy, zz = f[0] * f[0] + f[1] * f[1], f[2] * f[2] + f[3] * f[3], f[4] * f[4]
            xy, yz, xz = abs(f[0] * f[2] + f[1] * f[3]), 0.0, 0.0
        else:
            xx, yy = f[0] * f[0] + f[1] * f[1] + f[2] * f[2], f[3] * f[3] + f[4] * f[4] + f[5] * f[5]
            zz, xy = f[6] * f[6] + f[7] * f[7] + f[8] * f[8], abs(f[0] * f[3] + f[1] * f[4] + f[2] * f[5])
            yz, xz = abs(f[3] * f[6] + f[4] * f[7] + f[5] * f[8]), abs(f[0] * f[6] + f[1] * f[7] + f[2] * f[8])
        stretch = max(xx + xy + xz, yy + xy + yz, zz + xz + yz)
        stiffest = max(stiffest, lam * (1.0 - math.log(det(f))) + G * (1.0 + stretch))
    return stiffest


def neo_hooke_speed(F: Array, par: Array, density: float) -> float:
    return math.sqrt(neo_hooke_stiffest(F, par) / density)


KERNELS = {
    "linear_elastic": Kernels(
        parameters=parameters,
        state_size=lambda m: m,
        small=linear_small,
        finite=linear_finite,
        point=linear_point,
        wave_speed=wave_speed,
        push=push,
        energy=linear_energy,
        elastic_energy=elastic_energy,
    ),
    "neo_hooke": Kernels(
        parameters=parameters,
        state_size=lambda m: 0,
        small=None,
        finite=neo_hooke_finite,
        point=neo_hooke_point,
        wave_speed=wave_speed,
        push=push,
        energy=neo_hooke_energy,
        stretched_speed=neo_hooke_speed,
    ),
}
