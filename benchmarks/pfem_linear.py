"""Iterations and CPU time of pfem's linear solvers of flow against the size: FGMRES by blocks, and MUMPS.

OMP_NUM_THREADS=1 uv run python benchmarks/pfem_linear.py [largest number of nodes]

Water at rest, a dam break from its start, and a column that is stirred, thin and thick; nodes are shifted at random. For each size:
inner iterations of an outer one to a relative 1e-8, which tells how good the preconditioner is; then, as the method solves, outer and
inner iterations and CPU milliseconds of the solver a step, by blocks and by MUMPS. ``fourier`` is viscosity dt / density h^2.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import geofem.core  # noqa: F401  # isort: skip
import numpy as np

from geofem import methods, scenes
from geofem.cost import CLOCK
from geofem.methods.pfem import flow_solver
from geofem.scene import Array, Scene

SIZES = {2: (22, 45, 90, 180), 3: (6, 9, 14, 18)}
NEVER, ALWAYS = {2: 10**12, 3: 10**12}, {2: 1, 3: 1}
STEPS = 2
THICK = 100.0


def state(name: str, gdim: int) -> Scene:
    """``rest``, ``start``, ``stirred`` or ``thick``."""
    if name == "rest":
        return scenes.get("hydrostatic")(dim=gdim)
    scene = scenes.get("dam_break")(setup="martin_moyce" if gdim == 2 else "solid")
    if name == "start":
        return scene
    a = scene.length

    def stir(X: Array) -> Array:
        return np.stack([np.sin(3 * X[0] / a), *[np.zeros_like(X[0])] * (gdim - 2), -0.5 * X[-1] / a])

    region = scene.regions[0]
    parameters = region.material.parameters | ({"mu": THICK} if name == "thick" else {})
    region = replace(region, material=replace(region.material, parameters=parameters))
    return replace(scene, initial_velocity=stir, regions=(region,))


def steps(scene: Scene, n: int, blocks: bool, tolerance: float) -> tuple[int, float, float, float, float]:
    """Nodes, Fourier number, outer iterations a step, inner ones of an outer one, and CPU ms of the solver a step."""
    flow_solver.SPLIT_DOFS, flow_solver.TOLERANCE = ALWAYS if blocks else NEVER, tolerance
    model = methods.get("pfem").build(scene, n=n, jitter=0.2)
    model.step(model.dt())
    work, before = dict(model.work), CLOCK.seconds["solve"]
    for _ in range(STEPS):
        dt = model.dt()
        model.step(dt)
    newton, linear = (model.work[name] - work[name] for name in ("newton", "linear"))
    fourier = model.flow.par["mu"] * dt / model.flow.density / float(model.cloud.size.mean()) ** 2
    return model.size()["points"], fourier, newton / STEPS, linear / newton, 1e3 * (CLOCK.seconds["solve"] - before) / STEPS


def main(largest: int = 20_000) -> None:
    usual = flow_solver.TOLERANCE
    print(
        f"{'':>12} {'nodes':>6} {'fourier':>8} {'to 1e-8':>8} {'outer':>6} {'inner':>6} {'blocks (ms)':>12} {'MUMPS (ms)':>11}"
    )
    for gdim, sizes in SIZES.items():
        for name in ("rest", "start", "stirred", "thick"):
            for n in sizes:
                scene = state(name, gdim)
                if 2 * n**2 * (n // 2 if gdim == 3 else 1) > largest:
                    continue
                inner = steps(scene, n, True, 1e-8)[3]
                nodes, fourier, outer, loose, blocks = steps(scene, n, True, usual)
                mumps = steps(scene, n, False, usual)[4]
                print(
                    f"{gdim}D {name:>9} {nodes:>6} {fourier:>8.1e} {inner:>8.1f} {outer:>6.1f} {loose:>6.1f} "
                    f"{blocks:>12.0f} {mumps:>11.0f}",
                    flush=True,
                )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
