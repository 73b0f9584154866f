"""Newton's method with backtracking for one step of a boundary value problem in its weak form.

The full correction is taken when it lowers the out-of-balance force, else it is halved: four large steps with backtracking
cost a third of the factorisations of fifteen small ones without (measured on the strip footing).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from dolfinx import fem, la
from mpi4py import MPI
from petsc4py import PETSc

from geofem.core.solvers import LinearSolver, Matrix
from geofem.cost import phase
from geofem.mistake import Breakdown

MAX_ITERATIONS = 25
MAX_HALVINGS = 6


@dataclass
class Balance:
    """What an evaluation of the out-of-balance force found.

    force : residual with ghosts summed into their owners. scale : size of the forces that balance (N).
    valid : False on any rank where the state is inadmissible (det F <= 0).
    """

    force: la.Vector
    scale: float
    valid: bool


class Newton:
    """Drive the unknown of a weak form to balance under Dirichlet conditions.

    Parameters
    ----------
    unknown : the function to be changed in place.
    bcs : Dirichlet conditions, their values already those of the new state.
    balance : () -> Balance at the current unknown (collective).
    linearise : (bcs) -> None, fills ``matrix`` with the tangent at the current unknown.
    """

    def __init__(
        self,
        unknown: fem.Function,
        bcs: list[fem.DirichletBC],
        matrix: Matrix,
        solver: LinearSolver,
        balance: Callable[[], Balance],
        linearise: Callable[[list[fem.DirichletBC]], None],
        tolerance: float = 1e-9,
    ):
        self.unknown, self.bcs, self.matrix, self.solver = unknown, bcs, matrix, solver
        self.balance, self.linearise, self.tolerance = balance, linearise, tolerance
        self.comm = unknown.function_space.mesh.comm
        self.owned = unknown.function_space.dofmap.index_map.size_local * unknown.function_space.dofmap.index_map_bs
        self.iterations = 0
        self._free = np.ones(self.owned, bool)
        for bc in bcs:
            dofs, _ = bc.dof_indices()
            self._free[dofs[dofs < self.owned]] = False
        self._rhs, self._correction = matrix.mat.createVecRight(), matrix.mat.createVecRight()

    def _norm(self, balance: Balance) -> float:
        """Norm of the force at the free dofs, infinite where any rank's state is inadmissible."""
        force = balance.force.array[: self.owned][self._free]
        local = float(force @ force) if balance.valid else np.inf
        total = self.comm.allreduce(local if np.isfinite(local) else np.inf, op=MPI.SUM)
        return float(np.sqrt(total))

    def _prescribed_gap(self) -> float:
        """Largest change that the Dirichlet conditions still ask for."""
        gap = self.unknown.x.array.copy()
        for bc in self.bcs:
            bc.set(gap)
        return self.comm.allreduce(float(np.abs(gap - self.unknown.x.array).max(initial=0.0)), op=MPI.MAX)

    def solve(self, lift: Callable[[np.ndarray, list[fem.DirichletBC]], None]) -> None:
        """Iterate to balance. Raises ``Breakdown`` (newton) if that fails; the unknown is then left wherever it was.

        lift : (b, bcs) subtracts from b the tangent times the prescribed increments, ghosts not yet summed.
        """
        space = self.unknown.function_space
        x = self.unknown.x
        now = self.balance()
        norm = self._norm(now)
        if not np.isfinite(norm):
            raise Breakdown("newton", "the step starts from an inadmissible state")
        pending = self._prescribed_gap() > 0.0
        for _ in range(MAX_ITERATIONS):
            if not pending and norm <= self.tolerance * now.scale:
                return
            with phase("assemble"):
                self.linearise(self.bcs)
            rhs = la.vector(space.dofmap.index_map, space.dofmap.index_map_bs)
            if pending:
                with phase("assemble"):
                    lift(rhs.array, self.bcs)
                rhs.scatter_reverse(la.InsertMode.add)
            rhs.array[: self.owned] -= now.force.array[: self.owned]
            for bc in self.bcs:
                bc.set(rhs.array, x.array)
            self._rhs.array[:] = rhs.array[: self.owned]
            self.solver.solve(self._rhs, self._correction)
            self.iterations += 1
            correction = self._correction.array.copy()
            before = x.array.copy()
            length, previous = 1.0, norm
            for _ in range(MAX_HALVINGS):
                x.array[: self.owned] = before[: self.owned] + length * correction
                x.scatter_forward()
                now = self.balance()
                norm = self._norm(now)
                # prescribed increments put the state out of balance by design: there only admissibility is asked for
                if np.isfinite(norm) and (pending or norm < (1.0 - 1e-4 * length) * previous or norm <= self.tolerance * now.scale):
                    break
                if self._stagnates(correction, before) and np.isfinite(norm):
                    return
                length *= 0.5
            else:
                raise Breakdown("newton", f"backtracking found no better state (out-of-balance force {norm:.2e}, forces {now.scale:.2e})")
            pending = pending and length < 1.0
        if norm > self.tolerance * now.scale:
            raise Breakdown("newton", f"no balance after {MAX_ITERATIONS} iterations (force {norm:.2e} of {now.scale:.2e})")

    def _stagnates(self, correction: np.ndarray, before: np.ndarray) -> bool:
        """True if the correction is rounding: the balance cannot become better in this arithmetic."""
        sizes = self.comm.allreduce(np.array([np.abs(correction).max(initial=0.0), np.abs(before).max(initial=0.0)]), op=MPI.MAX)
        return bool(sizes[0] <= 1e-13 * sizes[1])
