"""Stress intensity factors by the interaction integral in its domain form.

With q = 1 near the tip and 0 outside the ring, sigma and u of the solution, and those of mode m with K_m = 1 (superscript m),

    I_m = int (sigma_ij u^m_i,1 + sigma^m_ij u_i,1 - sigma_kl eps^m_kl delta_1j) q,j dA = 2 K_m / E',

along the tip's axis 1 (Yau, Wang and Corten 1980; Shih and Asaro 1988), E' = E / (1 - nu^2) in plane strain, E in plane stress.
Valid where the crack is straight and without traction inside the ring, and no body force acts there.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from geofem.methods.xfem.basis import World, fields_at
from geofem.methods.xfem.enrichment import TIE, CellEntries
from geofem.methods.xfem.fields import modes_at
from geofem.methods.xfem.grid import Grid
from geofem.methods.xfem.rules import Rule
from geofem.scene import Array


def stress(g: Array, lam: Array, mu: Array) -> Array:
    """The stress (n, 2, 2) in the plane (Pa) of displacement gradients (n, 2, 2); lam, mu : (n,) Lame constants in the plane."""
    strain = 0.5 * (g + np.swapaxes(g, 1, 2))
    trace = strain[:, 0, 0] + strain[:, 1, 1]
    return 2.0 * mu[:, None, None] * strain + (lam * trace)[:, None, None] * np.eye(2)


def ring(grid: Grid, at: Array, radius: float) -> tuple[Array, Array]:
    """The cells that the circle around a tip passes, and the nodal weights q (nodes,): 1 inside of it, 0 outside."""
    q = (np.hypot(*(grid.X - at).T) < (1.0 + TIE) * radius).astype(float)
    inside = q[grid.T].sum(axis=1)
    return np.flatnonzero((inside > 0) & (inside < 3)), q


def intensity(
    grid: Grid, world: World, tip: int, kappa: float, cells: Array, q: Array, rule: Rule, acting: CellEntries,
    x: Array, lam: Array, mu: Array,
) -> Array:  # fmt: skip
    """K_I and K_II (2,) of a tip (Pa sqrt(m)) by the given ring of cells. Collective.

    cells, q : of ``ring``, with a rule and its acting entries. x : all local dofs. lam, mu : (all cells,) Pa, in the plane.
    """
    owner = np.repeat(np.arange(len(cells)), np.diff(rule.start))
    first, second = lam[cells][owner], mu[cells][owner]
    g = fields_at(rule, acting, world, x)[1]
    aux = modes_at(rule.x, world.lines, world.tips, tip, kappa)[1] / (2.0 * second[:, None, None, None])
    corners = grid.X[grid.T[cells]]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    rise = q[grid.T[cells]]
    db, dc = rise[:, 1] - rise[:, 0], rise[:, 2] - rise[:, 0]
    double = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    dq = np.stack([db * b[:, 1] - dc * a[:, 1], dc * a[:, 0] - db * b[:, 0]], axis=1) / double[:, None]
    axis = world.tips.axis[tip]
    sigma = stress(g, first, second)
    out = np.zeros(2)
    for m in range(2):
        other = stress(aux[:, m], first, second)
        # the derivative along the axis of each displacement
        flux = np.einsum("nij,nik,k->nj", sigma, aux[:, m], axis) + np.einsum("nij,nik,k->nj", other, g, axis)
        flux -= np.einsum("nij,nij->n", sigma, aux[:, m])[:, None] * axis
        out[m] = np.einsum("n,nj,nj->", rule.w, flux, dq[owner])
    total = grid.comm.allreduce(out, op=MPI.SUM)
    # E' = 8 mu / (kappa + 1) in both plane states
    shear = grid.comm.allreduce(float(mu[cells].max(initial=0.0)), op=MPI.MAX)
    return 4.0 * shear / (kappa + 1.0) * total
