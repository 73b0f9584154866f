"""Hooke's law between Kirchhoff stress and logarithmic strain (Hencky 1928; Anand 1979, J. Appl. Mech. 46:78-82)."""

from __future__ import annotations

import numpy as np

from geofem.materials import lame, values
from geofem.materials.isotropic import isotropic, logarithmic_energy
from geofem.materials.kinematics import Array, Floats, helper, matrices
from geofem.materials.plane import Stresses
from geofem.scene import Material


@helper
def returned(a: float, b: float, c: float, par: Array, dt: float) -> Stresses:
    return 0, a, b, c


@helper
def tangent(region: int, a: float, b: float, c: float, par: Array, dt: float) -> Floats:
    """Hooke's law in principal axes."""
    lam, G = par[0], par[1]
    d = lam + 2.0 * G
    return d, lam, lam, lam, d, lam, lam, lam, d


def parameters(material: Material, weakening: float = 1.0) -> Array:
    """(lambda, G) in Pa."""
    p = values(material)
    return np.array(lame(p["E"], p["nu"]))


def energy(F: Array, par: Array) -> Array:
    """lambda/2 ln^2 J + G e:e, e the logarithmic strain: F (N, g) -> (N,), J/m3 of reference volume."""
    full = matrices(F)
    return logarithmic_energy(np.swapaxes(full, 1, 2) @ full, par[0], par[1])


KERNELS = {"hencky": isotropic(returned, tangent, parameters, energy)}
