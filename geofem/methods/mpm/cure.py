"""The cure of volumetric locking: the volumetric part of strain and stress is averaged over the points of each cell.

The volumetric part of every increment is replaced by the mean over the cell (F-bar, de Souza Neto et al. 1996; for material points
Coombs et al. 2018), and the mean stress likewise in the forces, so that the work done agrees.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from numba import njit

from geofem.methods.mpm.deeds import inlined, make_get_gradient
from geofem.methods.mpm.kind import OPTIONS, Kind
from geofem.methods.mpm.scatter import make_cell, make_det
from geofem.methods.mpm.shapes import SHAPES


@cache
def make_pressures(kind: Kind) -> Callable[..., None]:
    """Sums over each cell of the volume of its points and of volume times mean Cauchy stress.

    (q, lo, hi, lattice, cells) -> None. cells (n, 3) : volume, volume times mean stress, volume after the step. The mean stress is
    that of the plane, or of space, as only its strains are averaged.
    """
    cell, averaged = make_cell(kind.dim), 3 if kind.axial else kind.dim
    det = make_det(kind)

    @njit(**OPTIONS)
    def pressures(q, lo, hi, lattice, cells):  # type: ignore[no-untyped-def]
        ordered = len(q.order) > 0
        for e in range(lo, hi):
            p = q.order[e] if ordered else e
            c = cell(q.at, p, lattice)
            mean = q.tau[p, 0] + q.tau[p, 1]
            if averaged == 3:
                mean += q.tau[p, 2]
            cells[c, 0] += q.volume[p] * det(q.F, p)
            cells[c, 1] += q.volume[p] * mean / averaged

    return pressures


@cache
def make_increment(kind: Kind) -> Callable[..., float]:
    """(L) -> det(I + L) of one point's increment, with the hoop's stretch in axial symmetry."""
    axial = kind.axial
    if kind.dim == 2:

        @inlined
        def increment(L):  # type: ignore[no-untyped-def]
            plane = (1.0 + L[0]) * (1.0 + L[3]) - L[1] * L[2]
            return plane * (1.0 + L[4]) if axial else plane

    else:

        @inlined
        def increment(L):  # type: ignore[no-untyped-def]
            a, e, i = 1.0 + L[0], 1.0 + L[4], 1.0 + L[8]
            return a * (e * i - L[5] * L[7]) - L[1] * (L[3] * i - L[5] * L[6]) + L[2] * (L[3] * L[7] - e * L[6])

    return increment


@cache
def make_dilate(kind: Kind) -> Callable[..., None]:
    """The cure of volumetric locking, first half: the increments of points lo ... hi, and the volume they give each cell.

    The volumetric part of every increment is replaced by the mean over the cell (F-bar, de Souza Neto et al. 1996; for material
    points Coombs et al. 2018), and the mean stress likewise in the forces, so that the work done agrees.
    (q, lo, hi, nodes, lattice, cells, dt) -> None. cells : see ``make_pressures``.
    """
    dim, axial = kind.dim, kind.axial
    get = SHAPES[kind.shape].over(dim)(make_get_gradient(dim, 1 if kind.scheme == "usl" else 1 + 2 * dim))
    cell, det, increment = make_cell(dim), make_det(kind), make_increment(kind)
    zeros = (0.0,) * (dim + dim * dim)

    @njit(**OPTIONS)
    def dilate(q, lo, hi, nodes, lattice, cells, dt):  # type: ignore[no-untyped-def]
        ordered = len(q.order) > 0
        per_h = lattice[3]
        for e in range(lo, hi):
            p = q.order[e] if ordered else e
            got = get(nodes, lattice, q.at, q.domain, q.stretch, p, zeros)
            for r in range(dim * dim):
                q.L[p, r] = dt * per_h * got[dim + r]
            if axial:
                q.L[p, 4] = dt * got[0] / q.at[p, 0]
            c = cell(q.at, p, lattice)
            cells[c, 2] += q.volume[p] * det(q.F, p) * increment(q.L[p])

    return dilate
