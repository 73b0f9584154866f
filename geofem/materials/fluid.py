"""Viscous, weakly compressible fluids. par = (mu, K, gamma, cavitation, tau_y, m): Pa s, Pa, 1, Pa, Pa, s.

tau = J (2 eta dev d - p I) with the rate of deformation d = (I - (f f^T)^-1) / 2 dt: the Almansi strain of the step,
f = F F_old^-1, over dt; first-order in dt, and zero in any rigid rotation. A Newtonian fluid has eta = mu. One of Bingham flows
where its shear stress exceeds tau_y only, here as Papanastasiou (1987, J. Rheol. 31:385-404) regularised it,

    eta = mu + tau_y (1 - exp(-m g)) / g,    g = sqrt(2 dev d : dev d),

so that instead of standing still it creeps, with the viscosity mu + m tau_y at most.

The pressure is that of Tait's equation as Cole (1948, Underwater Explosions) and Monaghan (1994, J. Comput.
Phys. 110:399-406) write it, p = K / gamma ((1/J)^gamma - 1), gamma = 7 for water; gamma = 1, p = K (1/J - 1), is linear
in the density. It does not fall below the pressure ``cavitation`` (0 for water with a free surface, which would else hang
together in threads): J is the whole change of volume, so a fluid that has parted resists only when it is back at its density.
"""

from __future__ import annotations

import math

import numpy as np

from geofem.materials import Kernels, values
from geofem.materials.kinematics import (
    Array,
    Floats,
    det,
    helper,
    indices,
    inverse_plane,
    inverse_solid,
    kernel,
    push,
    unpack_inverse,
)
from geofem.materials.solid import times
from geofem.scene import Material


@helper
def pressure(J: float, par: Array) -> tuple[float, float]:
    """(-J p, bulk) with bulk = J d(-J p)/dJ + J p: K J^(1 - gamma), and 0 at the pressure of cavitation."""
    K, gamma, cavitation = par[1], par[2], par[3]
    power = 1.0 if gamma == 1.0 else J ** (1.0 - gamma)
    sphere = K / gamma * (J - power)
    if sphere > -cavitation * J:
        return -cavitation * J, 0.0
    return sphere, K * power


@helper
def viscosity(g: float, par: Array) -> tuple[float, float]:
    """(eta, d eta / dg) at the shear rate g (1/s)."""
    mu, strength, m = par[0], par[4], par[5]
    if strength == 0.0:
        return mu, 0.0
    s = m * g
    if s < 1e-4:  # else cancellation
        return mu + strength * m * (1.0 - 0.5 * s), -strength * m * m * (0.5 - s / 3.0)
    rest = math.exp(-s)
    return mu + strength * (1.0 - rest) / g, strength * (s * rest - 1.0 + rest) / (g * g)


@helper
def stress(F: Array, F_old: Array, par: Array, dt: float) -> tuple[Floats, Floats, float, float, float]:
    """(c, tau, bulk, eta, thinning): c = (f f^T)^-1 and tau by 6 tensor components each (xx, yy, zz, xy, yz, xz), bulk as in
    ``pressure``, eta the viscosity, thinning = (d eta / dg) / g, 0 at g = 0."""
    if F.shape[0] == 5:
        i0, i1, i2, i3, i4 = inverse_plane(F)
        g0, g1 = F_old[0] * i0 + F_old[1] * i2, F_old[0] * i1 + F_old[1] * i3
        g2, g3 = F_old[2] * i0 + F_old[3] * i2, F_old[2] * i1 + F_old[3] * i3
        g4 = F_old[4] * i4
        c = (g0 * g0 + g2 * g2, g1 * g1 + g3 * g3, g4 * g4, g0 * g1 + g2 * g3, 0.0, 0.0)
    else:
        i = inverse_solid(F)
        g0, g1, g2 = times(F_old[0], F_old[1], F_old[2], i)
        g3, g4, g5 = times(F_old[3], F_old[4], F_old[5], i)
        g6, g7, g8 = times(F_old[6], F_old[7], F_old[8], i)
        c = (
            g0 * g0 + g3 * g3 + g6 * g6, g1 * g1 + g4 * g4 + g7 * g7, g2 * g2 + g5 * g5 + g8 * g8,
            g0 * g1 + g3 * g4 + g6 * g7, g1 * g2 + g4 * g5 + g7 * g8, g0 * g2 + g3 * g5 + g6 * g8,
        )  # fmt: skip
    J = det(F)
    mean = (c[0] + c[1] + c[2]) / 3.0
    square = (c[0] - mean) ** 2 + (c[1] - mean) ** 2 + (c[2] - mean) ** 2 + 2.0 * (c[3] ** 2 + c[4] ** 2 + c[5] ** 2)
    g = math.sqrt(0.5 * square) / dt
    eta, slope = viscosity(g, par)
    viscous = eta * J / dt
    sphere, bulk = pressure(J, par)
    sphere += viscous * mean
    tau = (
        sphere - viscous * c[0], sphere - viscous * c[1], sphere - viscous * c[2],
        -viscous * c[3], -viscous * c[4], -viscous * c[5],
    )  # fmt: skip
    return c, tau, bulk, eta, slope / g if g > 0.0 else 0.0


@helper
def symmetric(t: Floats, full: Array) -> None:
    """Write the tensor of 6 components into the 3 x 3 array ``full``."""
    full[0, 0], full[1, 1], full[2, 2] = t[0], t[1], t[2]
    full[0, 1] = full[1, 0] = t[3]
    full[1, 2] = full[2, 1] = t[4]
    full[0, 2] = full[2, 0] = t[5]


@kernel
def finite(F: Array, F_old: Array, state: Array, par: Array, dt: float, P: Array, A: Array, new_state: Array) -> int:
    g = F.shape[1]
    row, column = indices(g)
    inverse, c, tau, mixed, metric, pulled, strained, turned = np.empty((8, 3, 3))
    for n in range(F.shape[0]):
        J = det(F[n])
        if not J > 0.0:
            return -1 - n
        unpack_inverse(F[n], inverse)
        c_components, tau_components, bulk, eta, thinning = stress(F[n], F_old[n], par, dt)
        symmetric(c_components, c)
        symmetric(tau_components, tau)
        # With F^-1 on the second legs: pulled = tau F^-T, mixed = F^-1 c, metric = F^-1 F^-T.
        for i in range(3):
            for j in range(3):
                pulled[i, j] = mixed[i, j] = metric[i, j] = 0.0
                for k in range(3):
                    pulled[i, j] += tau[i, k] * inverse[j, k]
                    mixed[i, j] += inverse[i, k] * c[k, j]
                    metric[i, j] += inverse[i, k] * inverse[j, k]
        viscous, thins = eta * J / dt, thinning * J / dt**3
        mean = (c[0, 0] + c[1, 1] + c[2, 2]) / 3.0
        # strained = dev c F^-T, turned = dev c c F^-T: g^2 = dev c : dev c / 2 dt^2 changes by -2 (dev c c) : l / dt^2.
        for i in range(3):
            for j in range(3):
                strained[i, j] = -mean * inverse[j, i]
                turned[i, j] = -mean * mixed[j, i]
                for k in range(3):
                    strained[i, j] += c[i, k] * inverse[j, k]
                    turned[i, j] += c[i, k] * mixed[j, k]
        # d tau / d l = (tau + bulk I) x I + viscous (d(l^T c + c l) / d l)' + thins dev c x dev c c, and -tau x I from the
        # pull-back of P.
        for p in range(g):
            i, j = row[p], column[p]
            P[n, p] = pulled[i, j]
            for q in range(g):
                k, l = row[q], column[q]
                A[n, p, q] = (
                    (pulled[i, j] + bulk * inverse[j, i]) * inverse[l, k]
                    - pulled[i, l] * inverse[j, k]
                    + viscous * (inverse[l, i] * mixed[j, k] + c[i, k] * metric[j, l] - 2.0 / 3.0 * inverse[j, i] * mixed[l, k])
                    + thins * strained[i, j] * turned[k, l]
                )
    return 0


@helper
def point(F: Array, F_old: Array, state: Array, par: Array, dt: float, tau: Array, new_state: Array) -> int:
    if not det(F) > 0.0:
        return -1
    _, t, _, _, _ = stress(F, F_old, par, dt)
    tau[0], tau[1], tau[2], tau[3] = t[0], t[1], t[2], t[3]
    if F.shape[0] == 9:
        tau[4], tau[5] = t[4], t[5]
    return 0


def parameters(material: Material, weakening: float = 1.0) -> Array:
    """(mu, K, gamma, cavitation, tau_y, m); the yield stress is a strength, and divided by ``weakening``."""
    p = {"tau_y": 0.0, "m": 0.0} | values(material)
    return np.array([p["mu"], p["K"], p["gamma"], p["cavitation"], p["tau_y"] / weakening, p["m"]])


def wave_speed(par: Array, density: float) -> float:
    """sqrt(K / density), m/s, at rest; (1/J)^((gamma - 1) / 2) times as much under pressure."""
    return math.sqrt(par[1] / density)


FLUID = Kernels(
    parameters=parameters,
    state_size=lambda m: 0,
    small=None,
    finite=finite,
    point=point,
    wave_speed=wave_speed,
    push=push,
)
KERNELS = {"newtonian": FLUID, "bingham": FLUID}
