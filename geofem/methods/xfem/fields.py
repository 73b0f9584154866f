"""The near field of a tip at points of a mesh: its angle jumps across the crack behind the tip, wherever that runs."""

from __future__ import annotations

import numpy as np

from geofem.core.neartip import branches, modes
from geofem.materials.kinematics import kernel
from geofem.methods.xfem.geometry import Lines, Tips, polar
from geofem.scene import Array


@kernel
def modes_at(x: Array, lines: Lines, tips: Tips, tip: int, kappa: float) -> tuple[Array, Array]:
    """2 mu times the displacements (n, 2 modes, 2) and gradients (n, 2 modes, 2, 2) of both modes at the points x (n, 2)."""
    u, g = np.empty((x.shape[0], 2, 2)), np.empty((x.shape[0], 2, 2, 2))
    for k in range(x.shape[0]):
        r, theta = polar(x[k, 0], x[k, 1], lines, tips, tip, 0.0)
        modes(r, theta, tips.axis[tip, 0], tips.axis[tip, 1], kappa, u[k], g[k])
    return u, g


@kernel
def branches_at(x: Array, lines: Lines, tips: Tips, tip: int) -> Array:
    """The four branches at the points x (n, 2): (n, 4)."""
    f, g = np.empty((x.shape[0], 4)), np.empty((4, 2))
    for k in range(x.shape[0]):
        r, theta = polar(x[k, 0], x[k, 1], lines, tips, tip, 0.0)
        branches(r, theta, tips.axis[tip, 0], tips.axis[tip, 1], f[k], g)
    return f
