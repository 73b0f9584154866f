"""Sparse matrices that are cheap to fill again and again, and linear solvers chosen by dimension and size.

Measured on 181 202 dofs of P2 triangles: assembly into a dolfinx MatrixCSR takes half the time of PETSc's MatSetValues, so
on one rank PETSc looks at the CSR arrays without copying them; on several ranks PETSc's own matrix is filled.
"""

from __future__ import annotations

from typing import Any, Protocol

import dolfinx.fem.petsc as fem_petsc
import numpy as np
from dolfinx import fem, la
from petsc4py import PETSc

from geofem.cost import phase
from geofem.mistake import Breakdown

OURS: set[str] = set()
"""Names of PETSc options that hold our defaults and not the user's wish."""
ITERATIVE_DOFS = 30_000
"""3D problems above this many dofs are solved by CG + GAMG, all others by MUMPS: up to three times faster at 73k dofs
(benchmarks/solvers.py)."""

MINIMUM_FILL, AUTOMATIC = 2, 7
"""MUMPS's orderings. In 2D approximate minimum fill with a symmetric factorisation takes less than half the time of MUMPS's own choice
and LU at 15k dofs, .6 at 60k, and .7 at 230k (benchmarks/xfem_static.py)."""
FACTORISATION_ERRORS = (71, 72, 76)
"""PETSc's numbers of a zero pivot, a floating point exception, and an error within an external library like MUMPS."""
UNSOLVED = 1e-3
"""A residual above this fraction of the right-hand side is no solution: even slender bodies (condition 1e12) stay far below."""


class Matrix:
    """A sparse matrix with the pattern of a bilinear form; ``mat`` is PETSc's view of it."""

    def __init__(self, form: fem.Form):
        self.form = form
        self._csr: la.MatrixCSR | None = None
        comm = form.mesh.comm
        if comm.size == 1:
            self._csr = fem.create_matrix(form, la.BlockMode.expanded)
            rows = self._csr.indptr.size - 1
            index = (self._csr.indptr.astype(PETSc.IntType), self._csr.indices.astype(PETSc.IntType))
            self.mat = PETSc.Mat().createAIJWithArrays((rows, rows), (*index, self._csr.data), comm=PETSc.COMM_SELF)
        else:
            self.mat = fem_petsc.create_matrix(form)

    def assemble(self, bcs: list[fem.DirichletBC] | None = None, diagonal: float = 1.0) -> None:
        """Fill the matrix afresh from its form; rows and columns of ``bcs`` hold nothing but ``diagonal``."""
        if self._csr is not None:
            self._csr.data.fill(0.0)
            fem.assemble_matrix(self._csr, self.form, bcs=bcs, diag=diagonal)
        else:
            self.mat.zeroEntries()
            fem_petsc.assemble_matrix(self.mat, self.form, bcs=bcs, diag=diagonal)
        self.mat.assemble()

    def combine(self, factor: float, other: Matrix, weight: float) -> None:
        """self <- factor * self + weight * other, of the same pattern."""
        self.mat.scale(factor)
        self.mat.axpy(weight, other.mat, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)


def rigid_body_modes(space: fem.FunctionSpace) -> PETSc.NullSpace:
    """The near-nullspace of elasticity, orthonormal, for algebraic multigrid (translations, then rotations)."""
    gdim = space.mesh.geometry.dim
    owned = space.dofmap.index_map.size_local
    x = space.tabulate_dof_coordinates()[:owned]
    planes = [(0, 1)] if gdim == 2 else [(0, 1), (1, 2), (0, 2)]
    modes = []
    for k in range(gdim + len(planes)):
        values = np.zeros((owned, gdim))
        if k < gdim:
            values[:, k] = 1.0
        else:
            i, j = planes[k - gdim]
            values[:, i], values[:, j] = -x[:, j], x[:, i]
        modes.append(values.ravel())
    vectors: list[PETSc.Vec] = []
    for mode in modes:
        vector = PETSc.Vec().createMPI((mode.size, PETSc.DETERMINE), comm=space.mesh.comm)
        vector.array[:] = mode
        for other in vectors:
            vector.axpy(-vector.dot(other), other)
        vector.normalize()
        vectors.append(vector)
    return PETSc.NullSpace().create(vectors=vectors)


class Operator(Protocol):
    """Anything that a solver can work with: ``mat`` is PETSc's matrix."""

    mat: Any


class LinearSolver:
    """Solve with one matrix again and again.

    MUMPS in 2D and for small, mixed or plastic systems, its symmetric factorisation for definite ones; CG with GAMG and the
    rigid-body near-nullspace for large elastic ones in 3D. Every choice can be overridden by PETSc options without prefix
    (``-ksp_type gmres -pc_type ilu``).
    """

    def __init__(self, matrix: Operator, space: fem.FunctionSpace, definite: bool):
        self.matrix, self.iterations = matrix, 0
        dofs = space.dofmap.index_map.size_global * space.dofmap.index_map_bs
        self._definite = definite
        self._ordering = MINIMUM_FILL if space.mesh.geometry.dim == 2 else AUTOMATIC
        self._iterative = definite and space.mesh.geometry.dim == 3 and dofs > ITERATIVE_DOFS
        if self._iterative:
            matrix.mat.setBlockSize(3)
            matrix.mat.setNearNullSpace(rigid_body_modes(space))
        self._set_up()

    def _set_up(self) -> None:
        self._b, self._x = self.matrix.mat.createVecs()
        self._left = self._b.duplicate()
        self.ksp = PETSc.KSP().create(self.matrix.mat.comm)
        self.ksp.setOperators(self.matrix.mat)
        options: dict[str, Any] = {
            "ksp_type": "preonly", "pc_type": "cholesky" if self._definite else "lu", "pc_factor_mat_solver_type": "mumps",
            "mat_mumps_icntl_7": self._ordering, "mat_mumps_icntl_14": 100,
        }  # fmt: skip
        if self._iterative:
            options = {"ksp_type": "cg", "ksp_rtol": 1e-10, "ksp_max_it": 500, "pc_type": "gamg", "mg_levels_ksp_type": "chebyshev",
                       "mg_levels_pc_type": "jacobi"}  # fmt: skip
        set_defaults(options)
        self.ksp.setFromOptions()

    def destroy(self) -> None:
        """Free what PETSc holds, not the matrix; nothing can be solved any more. Collective."""
        for of in (self.ksp, self._b, self._x, self._left):
            of.destroy()

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """A^-1 rhs for the owned dofs with the current entries of the matrix. Raises ``Breakdown`` (newton) where that fails."""
        with phase("solve"):
            self._b.array[:] = rhs
            try:
                self.ksp.setOperators(self.matrix.mat)
                self.ksp.solve(self._b, self._x)
                reason = self.ksp.getConvergedReason()
                failure = f"reason {reason}" if reason < 0 else ""
                if self._definite and not failure:
                    # of a body that nothing holds, MUMPS finds pivots of rounding and an answer that is none; where a plastic
                    # body begins to flow the tangent is nearly singular too, but there backtracking makes use of the direction
                    self.matrix.mat.mult(self._x, self._left)
                    self._left.axpy(-1.0, self._b)
                    left, size = self._left.norm(), self._b.norm()
                    failure = "" if left <= UNSOLVED * size else f"residual {left:.1e} of {size:.1e}"
            except PETSc.Error as error:
                if error.ierr not in FACTORISATION_ERRORS:
                    raise
                failure = f"error {error.ierr}"
        if failure:
            # PETSc keeps a failed factor and leaves vectors locked after an error of MUMPS: start again with new objects
            self._set_up()
            raise Breakdown("newton", f"the linear solver failed (PETSc {failure}); the tangent may be singular")
        self.iterations += self.ksp.its
        return self._x.array.copy()


def set_defaults(options: dict[str, Any]) -> None:
    """Put options into PETSc's database where the user has not set them; they stay, as PETSc reads some of them late."""
    given = PETSc.Options()
    if given.hasName("pc_type") and "pc_type" not in OURS:
        # another preconditioner has no use for the options of ours
        options = {name: value for name, value in options.items() if name.startswith("ksp_")}
    for name, value in options.items():
        if name in OURS or not given.hasName(name):
            given[name] = value
            OURS.add(name)
