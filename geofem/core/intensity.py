"""Stress intensity factors by the interaction integral, and the energy release rate by the J integral, as domain integrals.

With q = 1 near the tip and 0 outside a ring, sigma and u of the solution, W its energy density, and the axis 1 ahead of the tip,

    J = int (sigma_ij u_i,1 - W delta_1j) q,j dA   (Rice 1968; Li, Shih and Needleman 1985).

The mixed terms of J for the sum of the solution and the mode m with K_m = 1 (superscript m) give its intensity factor:

    int (sigma_ij u^m_i,1 + sigma^m_ij u_i,1 - sigma_kl eps^m_kl delta_1j) q,j dA = 2 K_m / E'   (Yau, Wang and Corten 1980),

E' = E / (1 - nu^2) in plane strain, E in plane stress. Valid where the crack is straight and free of traction inside the ring,
no force of mass acts there, and the material is the same all around.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from mpi4py import MPI

from geofem.scene import Array


class Ring(NamedTuple):
    """The solution at the quadrature points of the cells of a ring, those of this rank.

    w : (n,) weights (m2). slope : (n, 2) gradient of q (1/m). g : (n, 2, 2) displacement gradients. axis : (2,) ahead of the tip.
    lam, mu : (n,) Lame constants (Pa) in the plane.
    """

    comm: MPI.Comm
    w: Array
    slope: Array
    g: Array
    axis: Array
    lam: Array
    mu: Array

    def integral(self, flux: Array) -> float:
        """The integral of flux_j q,j of a flux (n, 2) over the ring on all ranks. Collective."""
        return float(self.comm.allreduce(float(np.einsum("n,nj,nj->", self.w, flux, self.slope)), op=MPI.SUM))


def stress(g: Array, lam: Array, mu: Array) -> Array:
    """The stress (n, 2, 2) in the plane (Pa) of displacement gradients (n, 2, 2); lam, mu : (n,) Lame constants in the plane."""
    strain = 0.5 * (g + np.swapaxes(g, 1, 2))
    trace = strain[:, 0, 0] + strain[:, 1, 1]
    return 2.0 * mu[:, None, None] * strain + (lam * trace)[:, None, None] * np.eye(2)


def flux_of(sigma: Array, g: Array, axis: Array) -> Array:
    """sigma_ij g_ik axis_k - sigma_kl g_kl axis_j, (n, 2): twice the flux of J for a field with itself, less its first term."""
    return np.einsum("nij,nik,k->nj", sigma, g, axis) - 0.5 * np.einsum("nij,nij->n", sigma, g)[:, None] * axis


def release(ring: Ring) -> float:
    """J, the energy release rate of a tip (J/m2). Collective."""
    return ring.integral(flux_of(stress(ring.g, ring.lam, ring.mu), ring.g, ring.axis))


def intensity(ring: Ring, modes: Array, kappa: float) -> Array:
    """K_I and K_II (2,) of a tip (Pa sqrt(m)). Collective.

    modes : (n, 2, 2, 2) gradients of 2 mu u of both modes with K = 1 at the points. kappa : Kolosov's constant.
    """
    lam, mu = ring.lam, ring.mu
    sigma = stress(ring.g, lam, mu)
    other = modes / (2.0 * mu[:, None, None, None])
    # sigma : eps^m is sigma^m : eps, so that half of it goes with each of the two fluxes
    mixed = [
        ring.integral(flux_of(sigma, other[:, m], ring.axis) + flux_of(stress(other[:, m], lam, mu), ring.g, ring.axis))
        for m in range(2)
    ]
    shear = ring.comm.allreduce(float(mu.max(initial=0.0)), op=MPI.MAX)
    # E' = 8 mu / (kappa + 1) in both plane states
    return 4.0 * shear / (kappa + 1.0) * np.array(mixed)
