"""Linear solver of flow: MUMPS for small systems; FGMRES with a Schur complement by multigrid for large ones."""

from __future__ import annotations

from itertools import count
from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from geofem.core.solvers import FACTORISATION_ERRORS, Matrix, set_defaults
from geofem.cost import phase
from geofem.mistake import Breakdown
from geofem.scene import Array

SPLIT_DOFS = 200_000
"""From so many unknowns on the system is solved by blocks."""
PREFIXES = count()


class FlowSolver:
    """Solve with one matrix again and again; its preconditioner is made when it is told to.

    velocity, pressure : (k, gdim) and (k,) local dofs. owned : number of owned dofs.
    """

    def __init__(self, matrix: Matrix, velocity: Array, pressure: Array, owned: int, comm: MPI.Intracomm):
        self.matrix = matrix
        self._velocity, self._pressure, self._owned, self._comm = velocity, pressure, owned, comm
        self._b, self._x = matrix.mat.createVecs()
        self.iterations = 0
        self.ksp = PETSc.KSP().create(comm if comm.size > 1 else PETSc.COMM_SELF)
        self.split = matrix.mat.size[0] >= SPLIT_DOFS
        if self.split:
            self._by_blocks()
        else:
            set_defaults({"pfem_ksp_type": "preonly", "pfem_pc_type": "lu", "pfem_pc_factor_mat_solver_type": "mumps"})
            self.ksp.setOptionsPrefix("pfem_")
        self.ksp.setOperators(matrix.mat)
        self.ksp.setFromOptions()

    def _by_blocks(self) -> None:
        """Lower Schur factorisation, ILU for the velocity, GAMG for S = C - B diag(A)^-1 B^T."""
        options: dict[str, Any] = {
            "ksp_type": "fgmres", "ksp_rtol": 1e-8, "ksp_max_it": 300, "pc_type": "fieldsplit", "pc_fieldsplit_type": "schur",
            "pc_fieldsplit_schur_fact_type": "lower", "pc_fieldsplit_schur_precondition": "selfp",
            "fieldsplit_u_ksp_type": "preonly", "fieldsplit_u_pc_type": "ilu" if self._comm.size == 1 else "bjacobi",
            "fieldsplit_p_ksp_type": "preonly", "fieldsplit_p_pc_type": "gamg",
        }  # fmt: skip
        set_defaults({f"pfem_split_{name}": value for name, value in options.items()})
        self.ksp.setOptionsPrefix("pfem_split_")
        pc = self.ksp.getPC()
        pc.setType("fieldsplit")
        first = self.matrix.mat.getOwnershipRange()[0]
        u = np.sort(self._velocity[self._velocity < self._owned]) + first
        p = np.sort(self._pressure[self._pressure < self._owned]) + first
        comm = self.ksp.comm
        sets = [PETSc.IS().createGeneral(dofs.astype(PETSc.IntType), comm=comm) for dofs in (u, p)]
        sets[0].setBlockSize(self._velocity.shape[1])
        pc.setFieldSplitIS(("u", sets[0]), ("p", sets[1]))

    def solve(self, rhs: Array, renew: bool) -> Array:
        """A^-1 rhs for the owned dofs. Raises ``Breakdown`` (newton).

        renew : the matrix is a new one; else the factors of before serve.
        """
        with phase("solve"):
            self._b.array[:] = rhs
            try:
                if renew:
                    self.ksp.setOperators(self.matrix.mat)
                self.ksp.solve(self._b, self._x)
            except PETSc.Error as error:
                if error.ierr not in FACTORISATION_ERRORS:
                    raise
                raise Breakdown("newton", f"the flow solver failed (PETSc error {error.ierr})") from None
            reason = self.ksp.getConvergedReason()
            if reason < 0:
                raise Breakdown("newton", f"the flow solver failed (PETSc reason {reason})")
            self.iterations += self.ksp.its
            return self._x.array.copy()

    def destroy(self) -> None:
        for of in (self.ksp, self._b, self._x):
            of.destroy()
