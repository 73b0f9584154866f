"""Linear solver of flow: MUMPS for small systems; FGMRES with a Schur complement by multigrid for large ones.

By blocks the matrix is [F G; D C], with F of velocities, of mass over dt and viscosity, and C of the stabilisation and compliance.
The preconditioner is its lower triangle [F 0; D S], with S = C - D F^-1 G approximated in ``Schur``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from geofem.core.solvers import FACTORISATION_ERRORS, Matrix, set_defaults
from geofem.cost import phase
from geofem.mistake import Breakdown
from geofem.scene import Array

SPLIT_DOFS = {2: 200_000, 3: 15_000}
"""From so many unknowns on in the plane, and in space, the system is solved by blocks: where that costs less CPU time a step than
MUMPS, whose factors serve all iterations of a step (benchmarks/pfem_linear.py)."""
SHARE = 0.5
"""What S takes of the lumped masses: between the consistent mass of linear elements on smooth velocities (1) and on the roughest (1/4,
in space 1/5). Iterations hardly change from .4 to .7."""
VISCOUS = 2.0
"""Where half of the diagonal of F is above so many times the lumped masses, viscosity couples the velocities beyond their
neighbours, and F needs multigrid too: at viscosity dt / density h^2 of .2 or so."""
GAMG = {"pc_type": "gamg", "mg_levels_ksp_type": "richardson", "mg_levels_ksp_max_it": 1, "mg_levels_pc_type": "sor"}
VELOCITY = GAMG | {"pc_gamg_aggressive_coarsening": 0}
INERTIA = GAMG | {"pc_gamg_threshold": 0.05}
"""The stencil of S reaches two cells far: weak entries are left out of its graph, or the coarse grids lose the mesh."""
TOLERANCE = 1e-4
"""Of the residual of a correction. The configuration moves between the iterations of a step, so that more would not save one of them:
with 1e-8 there are as many, of twice the inner iterations, and velocities agree to 1e-9 after two steps."""
PREFIX = "pfem_split_"


class FlowSolver:
    """Solve with one matrix again and again; its preconditioner is made when it is told to.

    pressure : (k,) owned local dofs of the pressure; all others are velocities. scales : () -> ``FlowForms.scales`` of the owned dofs.
    """

    def __init__(self, matrix: Matrix, gdim: int, pressure: Array, scales: Callable[[], Array], comm: MPI.Intracomm):
        self.matrix = matrix
        self._scales, self._comm, self._gdim = scales, comm, gdim
        self._b, self._x = matrix.mat.createVecs()
        owned = matrix.mat.getLocalSize()[0]
        self._p = np.sort(pressure)
        self._u = np.setdiff1d(np.arange(owned), self._p)
        self.iterations = 0
        self.ksp = PETSc.KSP().create(comm if comm.size > 1 else PETSc.COMM_SELF)
        self._schur: Schur | None = None
        self.split = matrix.mat.size[0] >= SPLIT_DOFS[gdim]
        if not self.split:
            set_defaults({"pfem_ksp_type": "preonly", "pfem_pc_type": "lu", "pfem_pc_factor_mat_solver_type": "mumps"})
            self.ksp.setOptionsPrefix("pfem_")
            self.ksp.setOperators(matrix.mat)
            self.ksp.setFromOptions()

    def _renew(self) -> None:
        """Tell the preconditioner that the matrix is a new one. Collective."""
        self.ksp.setOperators(self.matrix.mat)
        if not self.split:
            return
        scales = self._scales()
        if self._schur is None:
            self._schur = Schur()
            self._by_blocks(scales)
        self._schur.mass, self._schur.volume = scales[self._u], scales[self._p]
        self.ksp.setUp()
        pc = self.ksp.getPC().getFieldSplitSubKSP()[1].getPC()
        if pc.getType() == "none":
            pc.setType("python")
            pc.setPythonContext(self._schur)

    def _by_blocks(self, scales: Array) -> None:
        """Choose the preconditioner of F, and cut the matrix into blocks."""
        over = np.median(self.matrix.mat.getDiagonal().array[self._u] / scales[self._u]) if len(self._u) else 0.0
        viscous = self._comm.allreduce(float(over), op=MPI.MAX) > VISCOUS
        weak = {"pc_type": "ilu" if self._comm.size == 1 else "bjacobi"}
        options: dict[str, Any] = {
            "ksp_type": "fgmres", "ksp_rtol": TOLERANCE, "ksp_max_it": 300, "pc_type": "fieldsplit", "pc_fieldsplit_type": "schur",
            "pc_fieldsplit_schur_fact_type": "lower", "pc_fieldsplit_schur_precondition": "a11",
            "fieldsplit_u_ksp_type": "preonly", "fieldsplit_p_ksp_type": "preonly", "fieldsplit_p_pc_type": "none",
        }  # fmt: skip
        options |= {f"fieldsplit_u_{name}": value for name, value in (VELOCITY if viscous else weak).items()}
        set_defaults({PREFIX + name: value for name, value in options.items()})
        self.ksp.setOptionsPrefix(PREFIX)
        pc = self.ksp.getPC()
        pc.setType("fieldsplit")
        first = self.matrix.mat.getOwnershipRange()[0]
        sets = [
            PETSc.IS().createGeneral((first + dofs).astype(PETSc.IntType), comm=self.ksp.comm) for dofs in (self._u, self._p)
        ]
        if len(self._u) == self._gdim * len(self._p):  # without bubbles the velocities of a node follow each other
            sets[0].setBlockSize(self._gdim)
        pc.setFieldSplitIS(("u", sets[0]), ("p", sets[1]))
        self.ksp.setFromOptions()

    def solve(self, rhs: Array, renew: bool) -> Array:
        """A^-1 rhs for the owned dofs. Raises ``Breakdown`` (newton).

        renew : the matrix is a new one; else the factors of before serve.
        """
        with phase("solve"):
            self._b.array[:] = rhs
            try:
                if renew:
                    self._renew()
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


class Schur:
    """S^-1 by the sum of its two limits, which covers all viscosities (Cahouet and Chabard 1988, Int. J. Numer. Methods Fluids 8:869-895).

    Where mass rules, F is the masses over dt: S = C - D F^-1 G, a Laplacian that knows the free surface, by multigrid. Where
    viscosity rules, - D F^-1 G is the mass of the pressures over twice the viscosity: it and C are well conditioned, and one
    sweep of SOR will do. C belongs to both, so that S is met within a factor of two where C rules.

    mass : of the velocities over dt (k,) (N s/m). volume : of the pressures, over twice the viscosity (j,). Both of the owned dofs.
    """

    mass: Array
    volume: Array

    def setUp(self, pc: PETSc.PC) -> None:
        whole, _ = pc.getOperators()
        _, _, G, D, C = whole.getSchurComplementSubMatrices()
        over = G.createVecLeft()
        over.array[:] = 1.0 / (SHARE * self.mass)
        scaled = G.copy()
        scaled.diagonalScale(L=over)
        inert = D.matMult(scaled)
        inert.aypx(-1.0, C)
        viscous = C.copy()
        diagonal = viscous.getDiagonal()
        diagonal.array[:] += self.volume
        viscous.setDiagonal(diagonal)
        self._parts = [preconditioner("inertia_", inert, INERTIA), preconditioner("viscosity_", viscous, {"pc_type": "sor"})]
        self._one = viscous.createVecLeft()

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        inertia, viscosity = self._parts
        inertia.apply(x, y)
        viscosity.apply(x, self._one)
        y.axpy(1.0, self._one)


def preconditioner(name: str, matrix: PETSc.Mat, options: dict[str, Any]) -> PETSc.PC:
    """A preconditioner of its own options, which a user may set. Collective."""
    set_defaults({PREFIX + name + option: value for option, value in options.items()})
    pc = PETSc.PC().create(matrix.comm)
    pc.setOptionsPrefix(PREFIX + name)
    pc.setOperators(matrix)
    pc.setFromOptions()
    pc.setUp()
    return pc
