"""Newton's method with backtracking for one step of a boundary value problem in its weak form.

For plastic laws the full correction is taken only when it lowers the out-of-balance force, else it is halved: four large steps
with backtracking cost a third of the factorisations of fifteen small ones without (measured on the strip footing). For elastic
laws the force may grow on the way: where a slender body rotates, the first corrections stretch it, and insisting on a lower
force would stop there. In both cases an inadmissible state (det F <= 0) halves the correction.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from dolfinx import fem, la
from mpi4py import MPI

from geofem.core.solvers import Operator
from geofem.cost import phase
from geofem.mistake import Breakdown

MAX_ITERATIONS = 50
MAX_HALVINGS = 6
DIVERGED = 1e8
CIRCLE, ELASTIC_SHARE = 4, 0.02
EPSILON = 1e-14
ROUNDING = 1e-6
"""Below this fraction of the forces, an out-of-balance force that no longer halves is taken for rounding."""


class Solver(Protocol):
    """What Newton's method asks of a linear solver, like ``solvers.LinearSolver``."""

    matrix: Operator

    def solve(self, rhs: np.ndarray) -> np.ndarray: ...


@dataclass
class Residual:
    """What an evaluation of the out-of-balance force found.

    force : (dofs,) local array, ghosts summed into their owners. scale : size of the forces that balance (N).
    valid : False on a rank where the state is inadmissible (det F <= 0).
    """

    force: np.ndarray
    scale: float
    valid: bool


class Newton:
    """Drive the unknown of a weak form to balance under Dirichlet conditions.

    Parameters
    ----------
    unknown : the function to be changed in place.
    bcs : Dirichlet conditions, their values already those of the new state.
    evaluate : () -> Residual at the current unknown (collective).
    linearise : () -> None, fills the solver's matrix with the tangent at the current unknown.
    lift : (b) -> None, subtracts from b the tangent times the prescribed increments, ghosts not yet summed.
    tolerance : out-of-balance force relative to the forces that balance.
    stabilise : (share) mixes a share of the elastic tangent into that of a plastic law, taken where the iteration goes round in
        circles between the faces of yield surfaces. With it, the force must fall at every iteration; without, it may grow.
    """

    def __init__(
        self,
        unknown: fem.Function,
        bcs: list[fem.DirichletBC],
        solver: Solver,
        evaluate: Callable[[], Residual],
        linearise: Callable[[], None],
        lift: Callable[[np.ndarray], None],
        tolerance: float,
        stabilise: Callable[[float], None] | None = None,
    ):
        self.unknown, self.bcs, self.solver = unknown, bcs, solver
        self.evaluate, self.linearise, self.lift, self.tolerance = evaluate, linearise, lift, tolerance
        self.stabilise, self.monotone = stabilise, stabilise is not None
        self.comm = unknown.function_space.mesh.comm
        self.owned = unknown.function_space.dofmap.index_map.size_local * unknown.function_space.dofmap.index_map_bs
        self.iterations = 0
        self.scale = 0.0
        self._free = np.ones(self.owned, bool)
        for bc in bcs:
            dofs, _ = bc.dof_indices()
            self._free[dofs[dofs < self.owned]] = False

    def _norm(self, residual: Residual) -> float:
        """Norm of the force at the free dofs, infinite where any rank's state is inadmissible."""
        force = residual.force[: self.owned][self._free]
        local = float(force @ force) if residual.valid else np.inf
        total = self.comm.allreduce(local if np.isfinite(local) else np.inf, op=MPI.SUM)
        return float(np.sqrt(total))

    def _prescribed_gap(self) -> float:
        """Largest change that the Dirichlet conditions still ask for."""
        gap = self.unknown.x.array.copy()
        for bc in self.bcs:
            bc.set(gap)
        return self.comm.allreduce(float(np.abs(gap - self.unknown.x.array).max(initial=0.0)), op=MPI.MAX)

    def solve(self) -> None:
        """Iterate to balance. Raises ``Breakdown`` (newton, tangle) if that fails; the unknown is then left wherever it was."""
        now, norm = self._evaluate()
        if not np.isfinite(norm):
            raise Breakdown("tangle", "the step starts from an inadmissible state")
        self.scale, first = now.scale, norm
        pending = self._prescribed_gap() > 0.0
        norms: list[float] = []
        for _ in range(MAX_ITERATIONS):
            if not pending and norm <= self.tolerance * self.scale:
                return
            self._leave_circles(norms)
            correction = self._correct(now, pending)
            before, previous, length = self.unknown.x.array.copy(), norm, 1.0
            for _ in range(MAX_HALVINGS):
                self.unknown.x.array[: self.owned] = before[: self.owned] + length * correction
                self.unknown.x.scatter_forward()
                now, norm = self._evaluate()
                self.scale = now.scale
                # prescribed increments put the state out of balance by design: there only admissibility is asked for
                lower = pending or not self.monotone or norm < 0.999 * previous
                if np.isfinite(norm) and (lower or norm <= self.tolerance * self.scale):
                    break
                length *= 0.5
            if not np.isfinite(norm):
                raise Breakdown("tangle", f"det F <= 0 however short the correction (forces of {self.scale:.1e})")
            # where no length lowers the force, the shortest is taken: it is often the way past a kink of a yield surface
            if not pending and norm <= self._rounding(previous):
                return
            pending = pending and length < 1.0
            norms.append(norm)
            if norm > DIVERGED * max(first, self.scale):
                break
        if norm > self.tolerance * self.scale:
            raise Breakdown(
                "newton", f"no balance in {MAX_ITERATIONS} iterations: force {norm:.1e} among forces of {self.scale:.1e}"
            )

    def _leave_circles(self, norms: list[float]) -> None:
        """Mix in some elastic tangent while the last iterations are no better than those before."""
        if self.stabilise is None:
            return
        circling = len(norms) > CIRCLE and min(norms[-CIRCLE:]) > 0.5 * min(norms[:-CIRCLE])
        self.stabilise(ELASTIC_SHARE if circling else 0.0)

    def _evaluate(self) -> tuple[Residual, float]:
        now = self.evaluate()
        return now, self._norm(now)

    def _correct(self, now: Residual, pending: bool) -> np.ndarray:
        """The full Newton correction of the owned dofs, prescribed increments included."""
        space = self.unknown.function_space
        with phase("assemble"):
            self.linearise()
            rhs = la.vector(space.dofmap.index_map, space.dofmap.index_map_bs)
            if pending:
                self.lift(rhs.array)
                rhs.scatter_reverse(la.InsertMode.add)
        rhs.array[: self.owned] -= now.force[: self.owned]
        for bc in self.bcs:
            bc.set(rhs.array, self.unknown.x.array)
        self.iterations += 1
        try:
            return self.solver.solve(rhs.array[: self.owned])
        except Breakdown:
            # cells whose points all stand at the apex of a yield surface have no stiffness left
            if self.stabilise is None:
                raise
            self.stabilise(ELASTIC_SHARE)
            self.linearise()
            return self.solver.solve(rhs.array[: self.owned])

    def _rounding(self, previous: float) -> float:
        """The out-of-balance force that rounding leaves: no iteration can make it smaller.

        For elastic laws it is what a rounding error of the displacement costs; for plastic ones, whose displacement may be
        without bound, a small force that no longer halves.
        """
        if self.monotone:
            return ROUNDING * self.scale if self.scale * ROUNDING > 0.5 * previous else 0.0
        spring = self.solver.matrix.mat.getDiagonal().array * self.unknown.x.array[: self.owned]
        return EPSILON * float(np.sqrt(self.comm.allreduce(float(spring @ spring), op=MPI.SUM)))
