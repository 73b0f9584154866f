"""What faces of a crack do to each other: contact with Coulomb's friction, and cohesion that softens linearly.

A law ties the traction t that holds the faces together, (normal, along), to their jump g. Both are found from z = t + r g, r being
any stiffness above that of softening (Pa/m): then each z has one t, also where faces are rigid, and g = (z - t) / r (the
return map of Simo and Laursen 1992). With friction the part along counts the slip since the last step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from geofem.scene import Array, Crack


class Law(NamedTuple):
    """The laws of stations (m,) along cracks: friction, strength (Pa), 0 where nothing holds, opening (m) at which it is spent."""

    friction: Array
    strength: Array
    spent: Array


def law_of(cracks: list[Crack]) -> Law:
    """The laws of stations, each given by its crack."""
    holding = [crack.cohesion for crack in cracks]
    return Law(
        np.array([crack.friction or 0.0 for crack in cracks]),
        np.array([c.strength if c else 0.0 for c in holding]),
        np.array([2.0 * c.energy / c.strength if c else 1.0 for c in holding]),
    )


def respond(z: Array, law: Law, r: Array, worst: Array) -> tuple[Array, Array]:
    """The tractions (m, 2) of z (m, 2), Pa, and their derivatives (m, 2, 2); worst : (m,) largest opening so far (m)."""
    t, slope = np.zeros_like(z), np.zeros((len(z), 2, 2))
    touching = z[:, 0] < 0.0
    t[touching, 0], slope[touching, 0, 0] = z[touching, 0], 1.0
    limit = law.friction * np.maximum(-z[:, 0], 0.0)
    stick = (np.abs(z[:, 1]) <= limit) & (limit > 0.0)
    t[:, 1] = np.clip(z[:, 1], -limit, limit)
    slope[stick, 1, 1] = 1.0
    slips = touching & ~stick
    slope[slips, 1, 0] = -law.friction[slips] * np.sign(z[slips, 1])
    holds = law.strength > 0.0
    # cohesion acts along z, or along the faces where they touch
    free = np.where((holds & touching)[:, None], z * (0.0, 1.0), z)[holds]
    size = np.hypot(*free.T)
    bears, rise = cohesion(size, law.strength[holds], law.spent[holds], r[holds], worst[holds])
    along = np.divide(free, size[:, None], out=np.zeros_like(free), where=size[:, None] > 0.0)
    secant = np.divide(bears, size, out=np.ones_like(size), where=size > 0.0)
    outer = along[:, :, None] * along[:, None, :]
    both = (1.0 - touching[holds])[:, None, None] * np.eye(2) + touching[holds][:, None, None] * np.diag([0.0, 1.0])
    t[holds] += bears[:, None] * along
    slope[holds] += rise[:, None, None] * outer + secant[:, None, None] * (both - outer)
    return t, slope


def cohesion(size: Array, strength: Array, spent: Array, r: Array, worst: Array) -> tuple[Array, Array]:
    """The traction of |z| = size and its derivative."""
    softening = strength / spent
    opening = np.maximum((size - strength) / (r - softening), 0.0)
    t, rise = strength - softening * opening, -softening / (r - softening)
    gone = opening >= spent
    t, rise = np.where(gone, 0.0, t), np.where(gone, 0.0, rise)
    rigid = (worst == 0.0) & (size <= strength)
    t, rise = np.where(rigid, size, t), np.where(rigid, 1.0, rise)
    secant = np.divide(np.maximum(strength - softening * worst, 0.0), worst, out=np.zeros_like(t), where=worst > 0.0)
    back = (worst > 0.0) & (size <= (r + secant) * worst)
    return np.where(back, secant / (r + secant) * size, t), np.where(back, secant / (r + secant), rise)
