"""Dense granular flow by the mu(I) rheology of Jop, Forterre and Pouliquen (2006, Nature 441:727-730), elasto-plastic.

Kirchhoff stress and logarithmic elastic strain follow Hooke's law; shear flows, without change of volume, once
q = sqrt(J2) exceeds mu_s p. Then q = mu(I) p with

    mu(I) = mu_s + (mu_2 - mu_s) / (1 + I_0 / I),    I = rate d / sqrt(p / rho_s),

rate : plastic shear strain rate of the step, sqrt(2 D:D). p : mean pressure, of Kirchhoff as are the stresses: it differs from
Cauchy's by J, that is by a part p / K. At a vanishing rate this is the cone of Drucker and Prager without dilation.

Grains do not attract each other: where the elastic volume change is positive the stress is zero, and the volume is kept in the
elastic state (``OPEN`` in ``geofem.materials.plane``), so that the gap closes before the material resists. That is the criterion
of density of Dunatunga and Kamrin (2015, J. Fluid Mech. 779:483-513), with the density of the reference as the critical
one, and the correction of volume v_c of Tampubolon et al. (2017, ACM Trans. Graph. 36:105), which is not lost but
the trace of ln(b_e) / 2 here.
"""

from __future__ import annotations

import math

import numpy as np

from geofem.materials import lame, values
from geofem.materials.isotropic import isotropic
from geofem.materials.kinematics import Array, Floats, helper
from geofem.materials.plane import OPEN, Stresses
from geofem.materials.plastic import ROUNDING, deviator
from geofem.scene import Material


# par = (lambda, G, K, mu_s, mu_2, viscosity): with the last, I_0 G sqrt(1 / rho_s) / d, the step dt has
# alpha = viscosity dt sqrt(p), a stress.
@helper
def sheared(q: float, p: float, par: Array, dt: float) -> Floats:
    """(q at the end of the step, root, alpha) for the trial q > mu_s p.

    The plastic shear strain (q_trial - q) / G over dt, put into q = mu(I) p, gives
    q^2 - (mu_2 p + q_trial + alpha) q + mu_2 p q_trial + mu_s p alpha = 0 (Dunatunga and Kamrin 2015);
    q is the smaller solution, ``root`` the difference of the two, both written without cancellation.
    """
    low, high, alpha = par[3] * p, par[4] * p, par[5] * dt * math.sqrt(p)
    root = math.sqrt((high - q) ** 2 + alpha * (alpha + 2.0 * (high + q - 2.0 * low)))
    return 2.0 * (high * q + low * alpha) / (high + q + alpha + root), root, alpha


@helper
def returned(a: float, b: float, c: float, par: Array, dt: float) -> Stresses:
    """Region 1: flow."""
    da, db, dc, q, mean = deviator(a, b, c)
    if mean > 0.0 or (mean == 0.0 and q > 0.0):
        return OPEN, 0.0, 0.0, 0.0
    if not q > -par[3] * mean * (1.0 + ROUNDING):
        return 0, a, b, c
    ratio = sheared(q, -mean, par, dt)[0] / q
    return 1, mean + ratio * da, mean + ratio * db, mean + ratio * dc


@helper
def tangent(region: int, a: float, b: float, c: float, par: Array, dt: float) -> Floats:
    """K 1 x 1 + 2 G r (I - 1 x 1 / 3) + n x (G (dq/dq_trial - r) n - K dq/dp 1), with r = q / q_trial and n = s_trial / q_trial."""
    lam, G, K, low, high = par[0], par[1], par[2], par[3], par[4]
    if region == 0:
        d = lam + 2.0 * G
        return d, lam, lam, lam, d, lam, lam, lam, d
    if region == OPEN:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    da, db, dc, trial, mean = deviator(a, b, c)
    p = -mean
    q, root, alpha = sheared(trial, p, par, dt)
    by_trial = (high * p - q) / root
    by_p = (high * (trial - q) + alpha * (1.5 * low - 0.5 * q / p)) / root
    ratio = q / trial
    off = K - 2.0 * G / 3.0 * ratio
    on = off + 2.0 * G * ratio
    na, nb, nc = da / trial, db / trial, dc / trial
    turn, push = G * (by_trial - ratio), K * by_p
    ta, tb, tc = turn * na - push, turn * nb - push, turn * nc - push
    return (
        on + na * ta, off + na * tb, off + na * tc,
        off + nb * ta, on + nb * tb, off + nb * tc,
        off + nc * ta, off + nc * tb, on + nc * tc,
    )  # fmt: skip


def parameters(material: Material, weakening: float = 1.0) -> Array:
    """(lambda, G, K, mu_s, mu_2, I_0 G / (d sqrt(rho_s))), both friction coefficients divided by ``weakening``."""
    p = values(material)
    lam, G = lame(p["E"], p["nu"])
    viscosity = p["I_0"] * G / (p["d"] * math.sqrt(p["rho_s"]))
    return np.array([lam, G, lam + 2.0 * G / 3.0, p["mu_s"] / weakening, p["mu_2"] / weakening, viscosity])


def apex(par: Array) -> float:
    """No tension."""
    return 0.0


KERNELS = {"mu_i": isotropic(returned, tangent, parameters, apex=apex, small=False)}
