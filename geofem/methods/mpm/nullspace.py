"""A linear solver that looks at the spectrum: material points too far apart leave motions of the grid that strain none of them."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from geofem.core.solvers import LinearSolver
from geofem.mistake import Breakdown
from geofem.scene import Array

SINGULAR = 1e-11
"""A least eigenvalue of the scaled tangent below this is none. Bars of 4 x 1 have 1e-3, and 1e-13 to 1e-16 beyond a stretch of ppc."""
ITERATIONS = 4
"""Inverse iterations: each one brings out the least eigenvalue by its ratio to the next."""


class Watched:
    """Solves like the ``LinearSolver`` it is made of, and estimates the least eigenvalue of the first matrix that it is given.

    least : |eigenvalue| of D^-1/2 A D^-1/2 that is closest to zero, D the diagonal of A. Raises ``Breakdown`` (nullspace) where there
    is none but zero, also if the factorisation fails for that.
    """

    def __init__(self, solver: LinearSolver, start: Array):
        self._solver, self.matrix = solver, solver.matrix
        self.least: float | None = None
        self._start = start

    @property
    def iterations(self) -> int:
        return self._solver.iterations

    def solve(self, rhs: Array) -> Array:
        if self.least is not None:
            return self._solver.solve(rhs)
        self.least = 0.0
        try:
            out = self._solver.solve(rhs)
            self.least = self._estimate()
        except Breakdown as end:
            raise Breakdown("nullspace", f"the tangent is singular: {end}") from None
        if not self.least > SINGULAR:
            raise Breakdown("nullspace", f"a motion of the grid strains no point: least eigenvalue {self.least:.1e}")
        return out

    def _estimate(self) -> float:
        comm: MPI.Intracomm = self.matrix.mat.comm.tompi4py()
        scale = np.sqrt(np.abs(self.matrix.mat.getDiagonal().array))
        x, least = self._start / np.sqrt(comm.allreduce(float(self._start @ self._start))), 0.0
        for _ in range(ITERATIONS):
            y = scale * self._solver.solve(scale * x)
            size = float(np.sqrt(comm.allreduce(float(y @ y))))
            if not np.isfinite(size):
                return 0.0
            least, x = 1.0 / size, y / size
        return least
