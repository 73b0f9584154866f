"""A static crack by ``xfem`` beside plain finite elements on the same mesh without a crack: CPU seconds, one thread.

uv run python benchmarks/xfem_static.py [cells across, ...]

The scene is ``williams``, uniform triangles. Each contender starts from the mesh and ends with the displacement:

xfem    space and stiffness of the mesh without the crack, cut cells, rules, enriched dofs, their stiffness, supports, matrix,
        factorisation, solution; two dofs a node of the near field within a fifth of the side.
P1, P2  space, stiffness, supports, factorisation, solution of the square without a crack, with the same code and solver.

Parts of ``xfem`` are told apart by the phases of ``geofem.cost``; ``rest`` is spaces, maps and whatever has no phase. Marks to
hold: at most three times P1 from 10 000 cells, less than P2 from 50 000.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import replace

import geofem.core  # noqa: F401  # isort: skip
import numpy as np
from dolfinx import fem
from mpi4py import MPI

from geofem import scenes
from geofem.core import mesh as meshes
from geofem.core.conditions import Condition, DisplacementDofs
from geofem.core.forms import Forms, Template
from geofem.core.mesh import Body
from geofem.core.solvers import LinearSolver, Matrix
from geofem.cost import CLOCK
from geofem.methods.xfem import RADIUS
from geofem.methods.xfem.enrichment import TIPS
from geofem.methods.xfem.intact import Intact
from geofem.methods.xfem.model import XfemModel

SIZES = (71, 160, 224)
REPEATS = 3
SCENE = scenes.get("williams")()


def template(body: Body, order: int) -> Template:
    return Template(
        cell="triangle",
        geometry=body.mesh.ufl_domain().ufl_coordinate_element(),
        order=order,
        plane=SCENE.plane,
        strain="small",
        laws=("linear_elastic",),
        mixed=False,
        updated=False,
        degree=max(1, 2 * (order - 1)),
    )


def plain(body: Body, order: int) -> int:
    """Solve the square without its crack; returns the number of dofs."""
    scene = replace(SCENE, cracks=())
    forms = Forms(body.mesh, template(body, order), body.regions)
    forms.set_parameters([region.material for region in scene.regions])
    dofs = DisplacementDofs(forms)
    conditions = [Condition(forms, dofs, body, s, c) for s in scene.supports for c in s.components]
    for condition in conditions:
        condition.set(1.0)
    bcs = [condition.bc for condition in conditions]
    matrix = Matrix(forms.form("tangent"))
    matrix.assemble(bcs)
    b = np.zeros(forms.unknown.x.array.size)
    fem.apply_lifting(b, [matrix.form], [bcs])
    for bc in bcs:
        bc.set(b)
    LinearSolver(matrix, forms.space, definite=True).solve(b)
    return b.size


def cracked(body: Body) -> int:
    """Solve the square with its crack; returns the number of dofs."""
    intact = Intact(template(body, 1), body, SCENE.regions)
    model = XfemModel(SCENE, intact, TIPS["modes"], RADIUS * SCENE.length, 1.0)
    model.step(1.0)
    return model.size()["dofs"]


def timed(work: Callable[..., int], *words: object) -> tuple[float, dict[str, float], int]:
    """CPU seconds of the fastest of several runs, its phases, and its dofs; compilation left out."""
    best = float("inf"), {}, 0
    for _ in range(REPEATS):
        CLOCK.reset()
        start = time.process_time()
        dofs = work(*words)
        phases = dict(CLOCK.seconds)
        spent = time.process_time() - start - phases.pop("jit", 0.0)
        best = min(best, (spent, phases, dofs), key=lambda one: one[0])
    return best


def main(sizes: tuple[int, ...]) -> None:
    warm = meshes.build(MPI.COMM_WORLD, SCENE, n=8)
    for work in (lambda: cracked(warm), lambda: plain(warm, 1), lambda: plain(warm, 2)):
        work()
    names = ("cut", "assembly", "supports", "loads", "solve")
    print(f"{'cells':>8s}{'dofs':>8s}{'xfem':>8s}   ({''.join(f'{name:>9s}' for name in (*names, 'rest'))} )"
          f"{'P1':>9s}{'P2':>9s}{'xfem/P1':>9s}{'xfem/P2':>9s}")  # fmt: skip
    for n in sizes:
        body = meshes.build(MPI.COMM_WORLD, SCENE, n=n)
        whole, phases, dofs = timed(cracked, body)
        one, two = (timed(plain, body, order)[0] for order in (1, 2))
        parts = [phases.get(name, 0.0) for name in names]
        shown = "".join(f"{part:9.3f}" for part in (*parts, whole - sum(parts)))
        print(
            f"{len(body.regions):8d}{dofs:8d}{whole:8.3f}   ({shown} ){one:9.3f}{two:9.3f}{whole / one:9.2f}{whole / two:9.2f}"
        )


if __name__ == "__main__":
    main(tuple(map(int, sys.argv[1:])) or SIZES)
