"""All kernels of an isotropic law, given in principal space; what such a law is: see ``geofem.materials.plane``."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from geofem.materials import Kernels
from geofem.materials.kinematics import Array, Kernel, by_dimension, helper, push
from geofem.materials.plane import finite_plane, small_plane
from geofem.materials.solid import finite_solid, small_solid


def isotropic(
    returned: Kernel,
    tangent: Kernel,
    parameters: Callable[..., Array],
    energy: Callable[[Array, Array], Array] | None = None,
    *,
    apex: Callable[[Array], float] | None = None,
    small: bool = True,
) -> Kernels:
    """The kernels of a law in principal space: plastic, or hyperelastic in the logarithmic strain if it has an ``energy``.

    apex : par -> the mean stress (Pa) that no elastic state exceeds: a state that keeps more volume than that has a gap.
    small : False for plastic laws that need the step or a gap, which small strain does not know.
    """
    history = energy is None

    def stored(state: Array, par: Array, m: int, finite: bool) -> Array:
        return elastic_energy(state, par, m, finite, apex(par) if apex else math.inf)

    finite_in_plane, point_in_plane = finite_plane(returned, tangent, history)
    finite_in_space, point_in_space = finite_solid(returned, tangent, history)

    @helper
    def point(F: Array, F_old: Array, state: Array, par: Array, dt: float, tau: Array, new_state: Array) -> int:
        if F.shape[0] == 5:
            return point_in_plane(F, F_old, state, par, dt, tau, new_state)
        return point_in_space(F, F_old, state, par, dt, tau, new_state)

    return Kernels(
        parameters=parameters,
        state_size=(lambda m: m) if history else (lambda m: 0),
        small=by_dimension(small_plane(returned, tangent), small_solid(returned, tangent)) if history and small else None,
        finite=by_dimension(finite_in_plane, finite_in_space),
        point=point,
        wave_speed=wave_speed,
        push=push,
        energy=energy,
        elastic_energy=stored if history else None,
    )


def wave_speed(par: Array, density: float) -> float:
    """sqrt((lambda + 2 G) / density), m/s."""
    return math.sqrt((par[0] + 2.0 * par[1]) / density)


def elastic_energy(state: Array, par: Array, m: int, finite: bool, apex: float = math.inf) -> Array:
    """Stored energy (J/m3): of the stress in a small-strain state, of the logarithmic strain in a finite-strain state.

    state (N, s) -> (N,). At finite strain per reference volume; a gap beyond the mean stress ``apex`` (Pa) stores nothing more.
    """
    lam, G = par[0], par[1]
    shear = state[:, 3:m]
    if not finite:
        trace = state[:, :3].sum(1)
        square = (state[:, :3] ** 2).sum(1) + 2.0 * (shear**2).sum(1)
        return (square - lam / (3.0 * lam + 2.0 * G) * trace**2) / (4.0 * G)
    b = np.zeros((len(state), 3, 3))
    b[:, range(3), range(3)] = 1.0 + state[:, :3]
    for k, (i, j) in enumerate(((0, 1), (1, 2), (0, 2))[: m - 3]):
        b[:, i, j] = b[:, j, i] = shear[:, k]
    energy = logarithmic_energy(b, lam, G)
    if apex == math.inf:
        return energy
    K = lam + 2.0 * G / 3.0
    gap = 0.5 * K * np.log(np.linalg.det(b)) > apex
    return np.where(gap, 0.5 * apex**2 / K, energy)


def logarithmic_energy(b: Array, lam: float, G: float) -> Array:
    """lambda/2 (tr e)^2 + G e:e with e = ln(b) / 2, for left or right Cauchy-Green tensors b (N, 3, 3)."""
    e = 0.5 * np.log(np.linalg.eigvalsh(b))
    return 0.5 * lam * e.sum(1) ** 2 + G * (e**2).sum(1)
