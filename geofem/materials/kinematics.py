"""Deformation gradients as flat vectors: determinant, inverse, and the change of reference configuration.

g = 5: (xx, xy, yx, yy, zz); g = 9: row by row. All helpers are inlined into compiled callers and never allocate.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit
from numba.extending import register_jitable

Array = np.ndarray
Floats = tuple[float, ...]
Kernel = Callable[..., Any]

# No 'nnan', 'ninf': a nan must stay visible to the comparisons that look for it.
FLAGS = {"error_model": "numpy", "fastmath": {"contract", "nsz", "arcp", "reassoc"}}

# Helpers are plain functions to Python and compiled code to numba. Not njit: numba keys its cache by the functions that a
# kernel closes over, and a dispatcher's key is new in every process. Inlined, and without counting references to their
# arguments, which their callers hold anyway (_nrt: numba's runtime): the counting took more than half of a point's time.
# A helper must therefore not allocate nor return an array that it was given.
helper = register_jitable(forceinline=True, _nrt=False, **FLAGS)
kernel = njit(cache=True, **FLAGS)

# Row and column of each component.
ROWS_PLANE, COLUMNS_PLANE = np.array([0, 0, 1, 1, 2]), np.array([0, 1, 0, 1, 2])
ROWS_SOLID, COLUMNS_SOLID = np.repeat(np.arange(3), 3), np.tile(np.arange(3), 3)


@helper
def det_plane(F: Array) -> float:
    return (F[0] * F[3] - F[1] * F[2]) * F[4]


@helper
def det_solid(F: Array) -> float:
    return (
        F[0] * (F[4] * F[8] - F[5] * F[7]) - F[1] * (F[3] * F[8] - F[5] * F[6]) + F[2] * (F[3] * F[7] - F[4] * F[6])
    )  # fmt: skip


@helper
def inverse_plane(F: Array) -> Floats:
    """The inverse, as a tuple of 5."""
    d = 1.0 / (F[0] * F[3] - F[1] * F[2])
    return F[3] * d, -F[1] * d, -F[2] * d, F[0] * d, 1.0 / F[4]


@helper
def inverse_solid(F: Array) -> Floats:
    """The inverse, as a tuple of 9."""
    d = 1.0 / det_solid(F)
    return (
        (F[4] * F[8] - F[5] * F[7]) * d, (F[2] * F[7] - F[1] * F[8]) * d, (F[1] * F[5] - F[2] * F[4]) * d,
        (F[5] * F[6] - F[3] * F[8]) * d, (F[0] * F[8] - F[2] * F[6]) * d, (F[2] * F[3] - F[0] * F[5]) * d,
        (F[3] * F[7] - F[4] * F[6]) * d, (F[1] * F[6] - F[0] * F[7]) * d, (F[0] * F[4] - F[1] * F[3]) * d,
    )  # fmt: skip


@helper
def indices(g: int) -> tuple[Array, Array]:
    """Rows and columns of the g components."""
    return (ROWS_PLANE, COLUMNS_PLANE) if g == 5 else (ROWS_SOLID, COLUMNS_SOLID)


@helper
def det(F: Array) -> float:
    return det_plane(F) if F.shape[0] == 5 else det_solid(F)


@helper
def unpack(F: Array, full: Array) -> None:
    """Write the deformation gradient into the 3 x 3 array ``full``."""
    if F.shape[0] == 5:
        full[:] = 0.0
        full[0, 0], full[0, 1], full[1, 0], full[1, 1], full[2, 2] = F[0], F[1], F[2], F[3], F[4]
    else:
        for i in range(9):
            full[i // 3, i % 3] = F[i]


@helper
def unpack_inverse(F: Array, full: Array) -> None:
    """Write the inverse deformation gradient into the 3 x 3 array ``full``."""
    if F.shape[0] == 5:
        full[:] = 0.0
        full[0, 0], full[0, 1], full[1, 0], full[1, 1], full[2, 2] = inverse_plane(F)
    else:
        (
            full[0, 0], full[0, 1], full[0, 2], full[1, 0], full[1, 1], full[1, 2], full[2, 0], full[2, 1], full[2, 2],
        ) = inverse_solid(F)  # fmt: skip


@kernel
def push(P: Array, A: Array, Fn: Array) -> None:
    """From the reference configuration to configuration n, in place: P_n = P Fn^T / det Fn and
    A_n[iakc] = A[iJkL] Fn[aJ] Fn[cL] / det Fn.

    P (N, g), A (N, g, g), Fn (N, g), the deformation gradient of configuration n. Then the virtual work of P_n on
    gradients with respect to x_n, per volume of configuration n, is that of P per reference volume.
    """
    g = P.shape[1]
    d = 2 if g == 5 else 3
    row = np.empty(d)
    for n in range(P.shape[0]):
        F = Fn[n]
        scale = 1.0 / det(F)
        for start in range(0, d * d, d):
            for a in range(d):
                row[a] = 0.0
                for j in range(d):
                    row[a] += P[n, start + j] * F[d * a + j]
            for a in range(d):
                P[n, start + a] = row[a] * scale
            for q in range(g):
                for a in range(d):
                    row[a] = 0.0
                    for j in range(d):
                        row[a] += A[n, start + j, q] * F[d * a + j]
                for a in range(d):
                    A[n, start + a, q] = row[a]
        if g == 5:
            P[n, 4] *= F[4] * scale
            for q in range(g):
                A[n, 4, q] *= F[4]
        for p in range(g):
            for start in range(0, d * d, d):
                for a in range(d):
                    row[a] = 0.0
                    for j in range(d):
                        row[a] += A[n, p, start + j] * F[d * a + j]
                for a in range(d):
                    A[n, p, start + a] = row[a] * scale
            if g == 5:
                A[n, p, 4] *= F[4] * scale


def matrices(F: Array) -> Array:
    """Deformation gradients (N, g) as (N, 3, 3)."""
    if F.shape[1] == 9:
        return F.reshape(-1, 3, 3)
    full = np.zeros((len(F), 3, 3))
    full[:, ROWS_PLANE, COLUMNS_PLANE] = F
    return full


def by_dimension(plane: Kernel, solid: Kernel) -> Kernel:
    """One batch kernel out of two: the first argument's number of components tells which; each is compiled when needed."""

    def batch(first: Array, *rest: Any) -> int:
        return (plane if first.shape[1] in (4, 5) else solid)(first, *rest)

    return batch
