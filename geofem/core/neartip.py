"""The displacement near a crack tip in a linear elastic body: the modes of Williams, the branches that span them, a force at the tip.

At distance r and angle theta to the tip's axis (Williams 1957),

    2 mu u_I  = sqrt(r / 2 pi) (kappa - cos theta) (cos theta/2, sin theta/2),
    2 mu u_II = sqrt(r / 2 pi) ((kappa + 2 + cos theta) sin theta/2, -(kappa - 2 + cos theta) cos theta/2),

kappa = 3 - 4 nu in plane strain and (3 - nu) / (1 + nu) in plane stress. All components lie in the frame of the mesh.
"""

from __future__ import annotations

import numpy as np

from geofem.materials.kinematics import kernel
from geofem.scene import Array

TINY = 1e-300
"""Keeps the gradient at the tip itself finite (m)."""


def kolosov(nu: float, plane: str) -> float:
    """Kolosov's constant kappa (-)."""
    return (3.0 - nu) / (1.0 + nu) if plane == "plane_stress" else 3.0 - 4.0 * nu


@kernel
def modes(r: float, theta: float, ax: float, ay: float, kappa: float, u: Array, g: Array) -> None:
    """2 mu times the displacement u[m] (m) and its gradient g[m, i, j] of K_I = 1 (m = 0) and K_II = 1 (m = 1), axis (ax, ay)."""
    r = max(r, TINY)
    scale = np.sqrt(r / (2.0 * np.pi))
    c, s, ch, sh = np.cos(theta), np.sin(theta), np.cos(0.5 * theta), np.sin(0.5 * theta)
    for m in range(2):
        if m == 0:
            f0, f1 = ch * (kappa - c), sh * (kappa - c)
            d0, d1 = -0.5 * sh * (kappa - c) + ch * s, 0.5 * ch * (kappa - c) + sh * s
        else:
            f0, f1 = sh * (kappa + 2.0 + c), -ch * (kappa - 2.0 + c)
            d0, d1 = 0.5 * ch * (kappa + 2.0 + c) - sh * s, 0.5 * sh * (kappa - 2.0 + c) + ch * s
        # along the axis and across it, then the derivatives by r and theta
        f0, f1, d0, d1 = ax * f0 - ay * f1, ay * f0 + ax * f1, ax * d0 - ay * d1, ay * d0 + ax * d1
        for i in range(2):
            f, d = (f0, d0) if i == 0 else (f1, d1)
            u[m, i] = scale * f
            by_ahead, by_up = (0.5 * c * f - s * d) * scale / r, (0.5 * s * f + c * d) * scale / r
            g[m, i, 0], g[m, i, 1] = ax * by_ahead - ay * by_up, ay * by_ahead + ax * by_up


@kernel
def branches(r: float, theta: float, ax: float, ay: float, f: Array, g: Array) -> None:
    """f[j] and its gradient g[j, i] of the four branches sqrt(r) (sin t/2, cos t/2, sin t/2 sin t, cos t/2 sin t).

    Belytschko and Black 1999.
    """
    r = max(r, TINY)
    root = np.sqrt(r)
    c, s, ch, sh = np.cos(theta), np.sin(theta), np.cos(0.5 * theta), np.sin(0.5 * theta)
    for j in range(4):
        first, slope = (sh, 0.5 * ch) if j % 2 == 0 else (ch, -0.5 * sh)
        if j >= 2:
            first, slope = first * s, slope * s + first * c
        f[j] = root * first
        by_ahead, by_up = (0.5 * c * first - s * slope) / root, (0.5 * s * first + c * slope) / root
        g[j, 0], g[j, 1] = ax * by_ahead - ay * by_up, ay * by_ahead + ax * by_up


def point_force(x: Array, at: Array, axis: Array, kappa: float) -> Array:
    """2 mu times the displacement gradient (n, 2, 2) of a force of 1 (N/m) at a tip along its axis, the faces being free.

    x : (n, 2) m. The stress is radial, sigma_rr = -cos theta / (pi r): the potentials are phi = -log z / 4 pi and psi = -phi
    (Muskhelishvili 1953), 2 mu (u_1 + i u_2) = kappa phi - z conj(phi') - conj(psi).
    """
    turn = complex(*axis)
    z = ((x - at) @ np.array([1.0, 1j])) / turn
    bar = z.conjugate()
    ahead = -(kappa / z + z / bar**2) / (4.0 * np.pi)
    up = -1j * (kappa / z - 2.0 / bar - z / bar**2) / (4.0 * np.pi)
    local = np.array([[ahead.real, up.real], [ahead.imag, up.imag]])
    rotation = np.array([[axis[0], -axis[1]], [axis[1], axis[0]]])
    return np.einsum("ia,abn,jb->nij", rotation, local, rotation)
