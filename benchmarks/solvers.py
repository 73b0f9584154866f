"""Where iteration beats factorisation in 3D: MUMPS beside CG with GAMG on an elastic cube, through the method ``fem``.

python benchmarks/solvers.py [largest n]

A cube held at one face bends under its weight. Process CPU seconds of the phase ``solve`` (set-up and solution of one system), the
least of two runs, and the iterations; ``geofem.core.solvers.ITERATIVE_DOFS`` is the number of dofs from which it iterates.
"""

from __future__ import annotations

import sys

import geofem
from geofem.core import solvers
from geofem.scene import Box, Load, Material, Probe, Region, Scene, Support

RUNS = 2
CUBE = Scene(
    name="cube",
    regions=(Region("cube", Box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)), Material("linear_elastic", 1.0, {"E": 1000.0, "nu": 0.3})),),
    length=1.0,
    supports=(Support("wall", lambda x: x[0] <= 0.0, (0, 1, 2)),),
    loads=(Load("gravity", (0.0, 0.0, -9.81)),),
    probes=(Probe("uz", "displacement", at=(1.0, 0.5, 0.5), component=2),),
    plane="solid",
    strain="small",
)


def solve(first_iterative: float, **knobs: object) -> geofem.Result:
    """The run of least CPU time in ``solve`` when systems of more dofs than that are solved by CG."""
    solvers.ITERATIVE_DOFS = first_iterative
    runs = [geofem.run(CUBE, "fem", tolerance=1e-8, **knobs) for _ in range(RUNS)]
    return min(runs, key=lambda run: run.cost["phases"]["solve"])


def main(largest: int) -> None:
    chosen = solvers.ITERATIVE_DOFS
    print(
        f"{'cells':>12} {'n':>3} {'dofs':>7} {'MUMPS s':>8} {'CG s':>7} {'iterations':>10} {'MUMPS/CG':>8}   chosen   difference of uz"
    )
    for cell, order in (("tetrahedron", 2), ("hexahedron", 2), ("tetrahedron", 1)):
        for n in (4, 6, 8, 10, 12, 14, 16):
            size = n if order == 2 else 2 * n
            if n > largest:
                break
            direct, iterative = (solve(border, n=size, cell=cell, order=order) for border in (float("inf"), 0))
            seconds = [run.cost["phases"]["solve"] for run in (direct, iterative)]
            last = [run.history["uz"][-1] for run in (direct, iterative)]
            dofs = direct.size["dofs"]
            print(
                f"{cell:>11}{order} {size:3} {dofs:7} {seconds[0]:8.2f} {seconds[1]:7.2f} {iterative.work['linear']:10} "
                f"{seconds[0] / seconds[1]:8.1f}   {'CG' if dofs > chosen else 'MUMPS':8} {abs(last[1] / last[0] - 1):.0e}",
                flush=True,
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 14)
