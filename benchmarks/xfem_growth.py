"""What a step of growth costs, and whether the factors of the standard block are worth keeping from step to step.

python benchmarks/xfem_growth.py [cells across the plate ...]

Two tips grow in the scene ``inclined_crack``. Process CPU seconds of a whole step, the least of several, and where they go.
Then two ways to solve the last step's system, with the whole of the tips' enrichment (modes within the radius) and with jumps only:

fresh : MUMPS analyses the pattern, factorises and solves, as the method does; ``analysis`` is the part of that which a pattern
    that stays would save.
schur : the standard block is factorised once for all steps. A step solves with it for each new column of the enriched block and
    twice for the load, then factorises the dense Schur complement on the enriched dofs (George and Liu 1981; a low-rank update in
    the sense of Woodbury 1950). Columns of nodes whose enrichment is as it was are taken to be kept.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import geofem
import geofem.core
from geofem.cost import CLOCK

# isort: split
from petsc4py import PETSc

STEPS = 5
RUNS = 3
BLOCK = 64
"""Right-hand sides that are solved for at a time."""


def least(work: Callable[[], object]) -> float:
    """CPU seconds of the quickest of several runs."""
    seconds = []
    for _ in range(RUNS):
        start = time.process_time()
        work()
        seconds.append(time.process_time() - start)
    return min(seconds)


def solver(mat: Any) -> Any:
    """A KSP that solves with MUMPS."""
    ksp = PETSc.KSP().create(mat.comm)
    ksp.setOperators(mat)
    ksp.setType("preonly")
    ksp.pc.setType("lu")
    ksp.pc.setFactorSolverType("mumps")
    return ksp


def fresh(mat: Any, b: Any) -> None:
    ksp, x = solver(mat), b.duplicate()
    ksp.solve(b, x)
    ksp.destroy()


def analysis(mat: Any, b: Any) -> float:
    """The part of a fresh solution's time (on the clock) that goes into the analysis of the pattern."""
    events = [PETSc.Log.Event(name) for name in ("MatLUFactorSym", "MatLUFactorNum", "MatSolve")]
    before = [event.getPerfInfo()["time"] for event in events]
    fresh(mat, b)
    spent = [event.getPerfInfo()["time"] - start for event, start in zip(events, before)]
    return float(spent[0] / sum(spent))


def schur(mat: Any, standard: int, new: int) -> float:
    """CPU seconds of a step with the factors of the standard block at hand, for so many new columns."""
    enriched = mat.size[0] - standard
    first = PETSc.IS().createStride(standard, 0, 1)
    block = mat.createSubMatrix(first, first)
    ksp = solver(block)
    ksp.setUp()
    factor = ksp.pc.getFactorMatrix()
    columns = PETSc.Mat().createDense([standard, BLOCK], array=np.random.default_rng(1).random((standard, BLOCK)))
    columns.assemble()
    solution = columns.duplicate()
    per_column = least(lambda: factor.matSolve(columns, solution)) / BLOCK
    dense = np.eye(enriched) + 1e-3 / enriched
    return (new + 2) * per_column + least(lambda: np.linalg.cholesky(dense))


def changed(before: Any, after: Any) -> int:
    """Enriched dofs of nodes whose enrichment is not what it was."""

    def entries(body: Any) -> dict[int, bytes]:
        found, start = body.enrichment.entries, body.enrichment.entries.start
        return {
            n: found.function[a:b].tobytes() + found.value[a:b].tobytes() + found.ramp[a:b].tobytes()
            for n, (a, b) in enumerate(zip(start, start[1:]))
            if b > a
        }

    old, new = entries(before), entries(after)
    first = after.enrichment.first_dofs()
    width = np.diff(np.append(first, after.enrichment.dofs))
    return int(sum(width[n] for n in new if old.get(n) != new[n]))


def study(n: int, enrichment: str) -> None:
    seconds: list[float] = []
    body = before = None
    mark = 0.0
    for number, step in enumerate(
        geofem.grow("inclined_crack", n=n, da=0.2, until=0.2 * (STEPS + 1), enrichment=enrichment, beta=30.0)
    ):
        if number == 1:
            CLOCK.reset()
        if number > 1:
            seconds.append(time.process_time() - mark)
        before, body = body, step.model.cracked
        mark = time.process_time()
    phases = {name: spent / len(seconds) for name, spent in CLOCK.seconds.items()}
    mat, total = body.system.mat, body.numbering.total
    standard = 2 * len(body.grid.X)
    b = mat.createVecRight()
    b.setRandom()
    new = changed(before, body)
    print(
        f"{enrichment:>10} {total:>7} {total - standard:>8} {new:>7} {min(seconds):>7.3f}  "
        + " ".join(f"{phases.get(name, 0.0):>8.3f}" for name in ("cut", "assembly", "solve", "intensity"))
        + f"  {least(lambda: fresh(mat, b)):>8.3f} {analysis(mat, b):>8.0%} {schur(mat, standard, new):>8.3f}",
        flush=True,
    )


def main(sizes: list[int]) -> None:
    PETSc.Log.begin()
    print(
        f"{'enrichment':>10} {'dofs':>7} {'enriched':>8} {'new':>7} {'step s':>7}  {'cut':>8} {'assembly':>8} {'solve':>8} "
        f"{'K':>8}  {'fresh':>8} {'analysis':>8} {'schur':>8}"
    )
    for n in sizes:
        for enrichment in ("modes", "heaviside"):
            study(n, enrichment)


if __name__ == "__main__":
    main([int(n) for n in sys.argv[1:]] or [38, 76, 152])
