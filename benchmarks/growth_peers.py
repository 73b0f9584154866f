"""A step of growth on a mesh that knows no crack beside one that follows it and is made anew: CPU seconds, path, K; one thread.

uv run python benchmarks/growth_peers.py

The scene is ``shear_edge_crack``, its crack led on by the largest hoop stress in steps of a twentieth of the width. ``fem`` meshes
the body for every step, and that is in its time. Both are judged by ``fem`` with twice as many cells as it has at most here:
the path by the farthest of the crack's points from its points, K by the worst relative difference of K_I after a step.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

import geofem

SCENE, DA, UNTIL = "shear_edge_crack", 0.35, 1.75
RUNS = {"xfem": (20, 40, 80), "fem": (8, 16, 32)}
JUDGE = 64
REPEATS = 3


def growth(method: str, n: int) -> tuple[list[Any], float, int]:
    """The states on the way, the CPU seconds of the fastest step (the first state left out), and the most dofs."""
    steps, spent, dofs = [], [], 0
    start = time.process_time()
    for step in geofem.grow(SCENE, method, n=n, da=DA, until=UNTIL):
        spent.append(time.process_time() - start)
        steps.append(step)
        dofs = max(dofs, step.model.size()["dofs"])
        start = time.process_time()
    return steps, min(spent[1:]), dofs


def main() -> None:
    judge = growth("fem", JUDGE)[0]
    print(f"{'':8s}{'n':>4s}{'dofs':>8s}{'s a step':>10s}{'path off':>10s}{'K_I off':>10s}")
    for method, sizes in RUNS.items():
        growth(method, 8)  # compilation
        for n in sizes:
            runs = [growth(method, n) for _ in range(REPEATS)]
            steps, _, dofs = runs[0]
            path = np.hypot(*(steps[-1].path[0] - judge[-1].path[0]).T).max()
            K = max(abs(own.K[0, 0] / best.K[0, 0] - 1.0) for own, best in zip(steps, judge))
            print(f"{method:8s}{n:4d}{dofs:8d}{min(run[1] for run in runs):10.3f}{path:10.1e}{K:10.1e}", flush=True)


if __name__ == "__main__":
    main()
