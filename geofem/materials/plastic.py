"""Perfect plasticity in principal space: von Mises, Tresca, Mohr-Coulomb, Drucker-Prager.

A law is a pair of helpers for principal trial stresses a >= b >= c, tension positive (see ``geofem.materials.plane``).
Trial stresses outside the yield surface by less than rounding count as elastic, so that a point at rest on the surface
answers elastically. The comparisons are such that a nan does too, and so stays visible.
"""

from __future__ import annotations

import math

import numpy as np

from geofem.materials import lame, values
from geofem.materials.isotropic import isotropic
from geofem.materials.kinematics import Array, Floats, helper
from geofem.materials.plane import OPEN, Stresses
from geofem.scene import Material

ROUNDING = 1e-12
"""Yield stresses are compared to within this fraction of the stresses and the strength."""


# --- von Mises: sqrt(J2) <= k; par = (lambda, G, k) -----------------------------------------------------------------------
@helper
def deviator(a: float, b: float, c: float) -> Floats:
    """(a', b', c', sqrt(J2), mean)."""
    mean = (a + b + c) / 3.0
    a, b, c = a - mean, b - mean, c - mean
    return a, b, c, math.sqrt(0.5 * (a * a + b * b + c * c)), mean


@helper
def von_mises_returned(a: float, b: float, c: float, par: Array, dt: float) -> Stresses:
    """Radial return (Wilkins 1964)."""
    da, db, dc, q, mean = deviator(a, b, c)
    if not q > par[2] * (1.0 + ROUNDING):
        return 0, a, b, c
    ratio = par[2] / q
    return 1, mean + ratio * da, mean + ratio * db, mean + ratio * dc


@helper
def von_mises_tangent(region: int, a: float, b: float, c: float, par: Array, dt: float) -> Floats:
    """K 1 x 1 + 2 G r (I - 1 x 1 / 3 - s x s / 2 J2) with r = k / sqrt(J2), the last term when plastic only."""
    lam, G = par[0], par[1]
    ratio, na, nb, nc = 1.0, 0.0, 0.0, 0.0
    if region > 0:
        da, db, dc, q, _ = deviator(a, b, c)
        ratio = par[2] / q
        root = math.sqrt(G * ratio) / q
        na, nb, nc = root * da, root * db, root * dc
    off = lam + 2.0 * G / 3.0 * (1.0 - ratio)
    on = off + 2.0 * G * ratio
    ab, bc, ac = off - na * nb, off - nb * nc, off - na * nc
    return on - na * na, ab, ac, ab, on - nb * nb, bc, ac, bc, on - nc * nc


def von_mises_parameters(material: Material, weakening: float = 1.0) -> Array:
    """(lambda, G, k / weakening) in Pa."""
    p = values(material)
    return np.array([*lame(p["E"], p["nu"]), p["k"] / weakening])


# --- Drucker-Prager: sqrt(J2) + A mean <= k, flow by B; par = (lambda, G, A, B, k, K, 1 / (G + A B K), gap) ---------------
@helper
def drucker_prager_returned(a: float, b: float, c: float, par: Array, dt: float) -> Stresses:
    """Region 1: the cone; region 2: its apex (de Souza Neto, Peric and Owen 2008, section 8.3)."""
    G, A, B, k, K, inverse = par[1], par[2], par[3], par[4], par[5], par[6]
    da, db, dc, q, mean = deviator(a, b, c)
    f = q + A * mean - k
    if not f > ROUNDING * (q + A * abs(mean) + k):
        return 0, a, b, c
    multiplier = f * inverse
    if q < G * multiplier:
        apex = k / A
        return (OPEN if par[7] > 0.0 and mean > 0.0 else 2), apex, apex, apex
    ratio = 1.0 - G * multiplier / q
    mean -= B * K * multiplier
    return 1, mean + ratio * da, mean + ratio * db, mean + ratio * dc


@helper
def drucker_prager_tangent(region: int, a: float, b: float, c: float, par: Array, dt: float) -> Floats:
    lam, G, A, B, k, K, inverse = par[0], par[1], par[2], par[3], par[4], par[5], par[6]
    if region >= 2:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    if region == 0:
        d = lam + 2.0 * G
        return d, lam, lam, lam, d, lam, lam, lam, d
    da, db, dc, q, mean = deviator(a, b, c)
    na, nb, nc = da / q, db / q, dc / q
    loss = G * (q + A * mean - k) * inverse / q
    off = K - 2.0 * G / 3.0 * (1.0 - loss)
    on = off + 2.0 * G * (1.0 - loss)
    # Flow (D times the flow direction), gradient (D times that of the yield surface), and the turn of the radial direction.
    fa, fb, fc = G * na + B * K, G * nb + B * K, G * nc + B * K
    ga, gb, gc = (G * na + A * K) * inverse, (G * nb + A * K) * inverse, (G * nc + A * K) * inverse
    turn = G * loss
    return (
        on - fa * ga + turn * na * na, off - fa * gb + turn * na * nb, off - fa * gc + turn * na * nc,
        off - fb * ga + turn * nb * na, on - fb * gb + turn * nb * nb, off - fb * gc + turn * nb * nc,
        off - fc * ga + turn * nc * na, off - fc * gb + turn * nc * nb, on - fc * gc + turn * nc * nc,
    )  # fmt: skip


def drucker_prager_parameters(material: Material, weakening: float = 1.0) -> Array:
    """(lambda, G, A, B, k, K, 1 / (G + A B K), gap): the cone that fails and dilates like Mohr-Coulomb in plane strain.

    Plastic flow without strain across the plane asks for a stress -2 B sqrt(J2) / 3 there (deviatoric); equating the
    in-plane strength and dilation with those of Mohr-Coulomb gives B = sin psi / sqrt(1 + sin^2 psi / 3) and
    (A, k) = (sin phi, c cos phi) / (sqrt(1 - B^2 / 3) + B sin phi / 3); for psi = phi these are the constants of
    Drucker and Prager (1952, Q. Appl. Math. 10:157-165).
    """
    E, nu, c, phi, psi = strength(material, weakening)
    lam, G = lame(E, nu)
    K = lam + 2.0 * G / 3.0
    B = math.sin(psi) / math.sqrt(1.0 + math.sin(psi) ** 2 / 3.0)
    scale = math.sqrt(1.0 - B * B / 3.0) + B * math.sin(phi) / 3.0
    A, k = math.sin(phi) / scale, c * math.cos(phi) / scale
    return np.array([lam, G, A, B, k, K, 1.0 / (G + A * B * K), gap(material)])


def drucker_prager_apex(par: Array) -> float:
    """The largest mean stress, Pa."""
    return par[4] / par[2] if par[2] > 0.0 else math.inf


def gap(material: Material) -> float:
    """1 if what has opened in tension must close before it resists again, else 0."""
    return values(material).get("gap", 0.0)


def strength(material: Material, weakening: float) -> tuple[float, float, float, float, float]:
    """(E, nu, c, phi, psi) with c, tan phi and tan psi divided by ``weakening``; angles in radians."""
    p = values(material)
    phi, psi = (math.atan(math.tan(math.radians(p.get(angle, 0.0))) / weakening) for angle in ("phi", "psi"))
    return p["E"], p["nu"], p["c"] / weakening, phi, psi


# --- Mohr-Coulomb and Tresca: m a - c <= s ------------------------------------------------------------------------------
# par: lambda, G, m, s, apex, then for each region (1: plane, 2: edge a = b, 3: edge b = c) the returned stress as an
# affine function of the trial stress, 12 numbers (matrix row by row, then the constant), then for each region the
# tangent, 9 numbers; region 4 is the apex. Last comes gap.
MAPS, TANGENTS, GAP = 5, 5 + 3 * 12, 5 + 3 * 12 + 3 * 9


@helper
def mohr_coulomb_returned(a: float, b: float, c: float, par: Array, dt: float) -> Stresses:
    """Return to the plane, an edge or the apex of the sorted sextant.

    All are flat, so each region's map is affine (Clausen, Damkilde and Andersen 2007, Computers and Structures
    85:1795-1807). An edge holds the point if the return to the plane passes it and the return to the edge stays short of
    the apex; past the plane and both edges lies the apex. Without dilation (psi = 0) no plastic flow leads there: stresses
    with too much tension are put there all the same.
    """
    m, s, apex = par[2], par[3], par[4]
    if not m * a - c - s > ROUNDING * (m * abs(a) + abs(c) + s):
        return 0, a, b, c
    ra, rb, rc = affine(a, b, c, par, MAPS)
    if ra >= rb and rb >= rc:
        return 1, ra, rb, rc
    if rb > ra:
        ta, tb, tc = affine(a, b, c, par, MAPS + 12)
        if ta <= apex:
            return 2, ta, tb, tc
    if rc > rb:
        ta, tb, tc = affine(a, b, c, par, MAPS + 24)
        if ta <= apex:
            return 3, ta, tb, tc
    return (OPEN if par[GAP] > 0.0 and a + b + c > 0.0 else 4), apex, apex, apex


@helper
def affine(a: float, b: float, c: float, par: Array, at: int) -> tuple[float, float, float]:
    return (
        par[at] * a + par[at + 1] * b + par[at + 2] * c + par[at + 9],
        par[at + 3] * a + par[at + 4] * b + par[at + 5] * c + par[at + 10],
        par[at + 6] * a + par[at + 7] * b + par[at + 8] * c + par[at + 11],
    )


@helper
def mohr_coulomb_tangent(region: int, a: float, b: float, c: float, par: Array, dt: float) -> Floats:
    if region >= 4:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    if region == 0:
        lam, d = par[0], par[0] + 2.0 * par[1]
        return d, lam, lam, lam, d, lam, lam, lam, d
    at = TANGENTS + 9 * (region - 1)
    return (
        par[at], par[at + 1], par[at + 2], par[at + 3], par[at + 4], par[at + 5], par[at + 6], par[at + 7], par[at + 8],
    )  # fmt: skip


def mohr_coulomb_parameters(material: Material, weakening: float = 1.0) -> Array:
    """The layout above; m = (1 + sin phi) / (1 - sin phi), s = 2 c sqrt(m), apex = s / (m - 1), infinite for phi = 0."""
    E, nu, c, phi, psi = strength(material, weakening)
    lam, G = lame(E, nu)
    m, flow = ((1.0 + math.sin(angle)) / (1.0 - math.sin(angle)) for angle in (phi, psi))
    s = 2.0 * c * math.sqrt(m)
    stiffness = lam * np.ones((3, 3)) + 2.0 * G * np.eye(3)
    compliance = np.linalg.inv(stiffness)
    gradient, direction = np.array([m, 0.0, -1.0]), np.array([flow, 0.0, -1.0])
    step = stiffness @ direction / (gradient @ stiffness @ direction)
    maps, constants = [np.eye(3) - np.outer(step, gradient)], [s * step]
    # An edge is the line start + t line; trial stresses reach it along flow directions normal to the flow's own edge.
    for line, normal, start in (
        ([1.0, 1.0, m], [1.0, 1.0, flow], [0.0, 0.0, -s]),
        ([1.0, m, m], [1.0, flow, flow], [0.0, -s, -s]),
    ):
        along = compliance @ normal / (np.array(line) @ compliance @ normal)
        maps.append(np.outer(line, along))
        constants.append(np.array(start) - np.array(line) * (along @ start))
    flat = [number for map, constant in zip(maps, constants) for number in (*map.ravel(), *constant)]
    tangents = [number for map in maps for number in (map @ stiffness).ravel()]
    return np.array([lam, G, m, s, s / (m - 1.0) if m > 1.0 else math.inf, *flat, *tangents, gap(material)])


def mohr_coulomb_apex(par: Array) -> float:
    """The largest mean stress, Pa."""
    return par[4]


KERNELS = {
    "von_mises": isotropic(von_mises_returned, von_mises_tangent, von_mises_parameters),
    "tresca": isotropic(mohr_coulomb_returned, mohr_coulomb_tangent, mohr_coulomb_parameters, apex=mohr_coulomb_apex),
    "drucker_prager": isotropic(
        drucker_prager_returned, drucker_prager_tangent, drucker_prager_parameters, apex=drucker_prager_apex
    ),
}
KERNELS["mohr_coulomb"] = KERNELS["tresca"]
