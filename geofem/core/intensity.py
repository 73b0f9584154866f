"""Stress intensity factors and T-stress by the interaction integral, the energy release rate by the J integral, over domains.

With q = 1 near the tip and 0 outside a ring, sigma and u of the solution, W its energy density, and the axis 1 ahead of the tip,

    J = int (sigma_ij u_i,1 - W delta_1j) q,j dA   (Rice 1968; Li, Shih and Needleman 1985).

The mixed terms of J for the sum of the solution and the mode m with K_m = 1 (superscript m) give its intensity factor:

    int (sigma_ij u^m_i,1 + sigma^m_ij u_i,1 - sigma_kl eps^m_kl delta_1j) q,j dA = 2 K_m / E'   (Yau, Wang and Corten 1980),

E' = E / (1 - nu^2) in plane strain, E in plane stress. With the field of a point force of size 1 at the tip along the axis in
the place of the mode, they are T / E', where T is the regular stress along the axis at the tip (Cardew, Goldthorpe, Howard and
Kfouri 1985; Kfouri 1986).

Valid where the crack is straight inside the ring and the material is the same all around. Forces f on the body inside it, per
area or on the faces of the crack, add - int q f_i u_i,1 to J (Li, Shih and Needleman 1985) and the same with u^m to the mixed
terms, where the other field has no forces.
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

    @property
    def modulus(self) -> float:
        """mu (Pa) at the ring. Collective."""
        return float(self.comm.allreduce(float(self.mu.max(initial=0.0)), op=MPI.MAX))

    def integral(self, flux: Array) -> float:
        """The integral of flux_j q,j of a flux (n, 2) over the ring on all ranks. Collective."""
        return float(self.comm.allreduce(float(np.einsum("n,nj,nj->", self.w, flux, self.slope)), op=MPI.SUM))


class Forces(NamedTuple):
    """What acts on the body inside a ring, at points of its area and of the faces of the crack, those of this rank.

    w : (n,) weights times q. f : (n, 2) force per m3 or m2 (N). g : (n, 2, 2) displacement gradient, on faces that of their side.
    """

    w: Array
    f: Array
    g: Array

    def work(self, g: Array, axis: Array) -> float:
        """The integral of q f_i g_ij axis_j on this rank; g : (n, 2, 2)."""
        return float(np.einsum("n,ni,nij,j->", self.w, self.f, g, axis))


NONE = Forces(np.empty(0), np.empty((0, 2)), np.empty((0, 2, 2)))


def stress(g: Array, lam: Array, mu: Array) -> Array:
    """The stress (n, 2, 2) in the plane (Pa) of displacement gradients (n, 2, 2); lam, mu : (n,) Lame constants in the plane."""
    strain = 0.5 * (g + np.swapaxes(g, 1, 2))
    trace = strain[:, 0, 0] + strain[:, 1, 1]
    return 2.0 * mu[:, None, None] * strain + (lam * trace)[:, None, None] * np.eye(2)


def flux_of(sigma: Array, g: Array, axis: Array) -> Array:
    """sigma_ij g_ik axis_k - sigma_kl g_kl axis_j, (n, 2): twice the flux of J for a field with itself, less its first term."""
    return np.einsum("nij,nik,k->nj", sigma, g, axis) - 0.5 * np.einsum("nij,nij->n", sigma, g)[:, None] * axis


def release(ring: Ring, forces: Forces = NONE) -> float:
    """J, the energy release rate of a tip (J/m2). Collective."""
    work = ring.comm.allreduce(forces.work(forces.g, ring.axis), op=MPI.SUM)
    return ring.integral(flux_of(stress(ring.g, ring.lam, ring.mu), ring.g, ring.axis)) - work


def mixed(ring: Ring, other: Array, forces: Forces, there: Array) -> float:
    """The mixed terms of J for the solution and another field. Collective.

    other : (n, 2, 2) gradients of its displacement times 2 mu at the points of the ring, and there : at those of the forces.
    """
    lam, mu = ring.lam, ring.mu
    g = other / (2.0 * mu[:, None, None])
    # sigma : eps^m is sigma^m : eps, so that half of it goes with each of the two fluxes
    flux = flux_of(stress(ring.g, lam, mu), g, ring.axis) + flux_of(stress(g, lam, mu), ring.g, ring.axis)
    work = ring.comm.allreduce(forces.work(there, ring.axis), op=MPI.SUM) / (2.0 * ring.modulus)
    return ring.integral(flux) - work


def intensity(ring: Ring, modes: Array, kappa: float, forces: Forces = NONE, there: Array | None = None) -> Array:
    """K_I and K_II (2,) of a tip (Pa sqrt(m)). Collective.

    modes : (n, 2, 2, 2) gradients of 2 mu u of both modes with K = 1 at the points of the ring, and there : at those of the
    forces. kappa : Kolosov's constant.
    """
    there = np.empty((0, 2, 2, 2)) if there is None else there
    both = [mixed(ring, modes[:, m], forces, there[:, m]) for m in range(2)]
    # E' = 8 mu / (kappa + 1) in both plane states
    return 4.0 * ring.modulus / (kappa + 1.0) * np.array(both)


def tension(
    ring: Ring, point: Array, kappa: float, forces: Forces = NONE, there: Array | None = None, pressure: float = 0.0
) -> float:
    """T, the regular stress along the axis at a tip (Pa). Collective.

    point : (n, 2, 2) gradients of 2 mu u of a point force of 1 at the tip (``neartip.point_force``) at the points of the ring,
    and there : at those of the forces. pressure : on both faces at the tip (Pa).
    """
    there = np.empty((0, 2, 2)) if there is None else there
    # E' times the mixed terms is T - sigma_22, sigma_22 = -pressure: eps_11 of the regular part, and sigma_22 times the constant
    # opening that the point force gives the crack
    return 8.0 * ring.modulus / (kappa + 1.0) * mixed(ring, point, forces, there) - pressure
