"""CPU milliseconds of a step of ``pfem`` by phase, one thread, and what the compilers' caches gained after the first step.

OMP_NUM_THREADS=1 uv run python benchmarks/pfem_step.py [cells across, ...]

The scene is ``dam_break`` from its start, STEPS steps after WARM ones that compile and loosen the lattice; the
iteration goes on to 1e-6 of the largest velocity. ``rest`` is what has no phase. Marks to hold: 40 ms at 1 100 nodes, 500 ms at 10 000,
remesh + mesh + spaces at most a quarter of it, no file more.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import geofem.core  # noqa: F401  # isort: skip
from geofem import methods, scenes
from geofem.cost import CLOCK

SIZES = (22, 68)
WARM, STEPS, REPEATS = 10, 10, 3


def compiled() -> int:
    """Files in the caches of FFCx and numba."""
    homes = [Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "fenics"]
    homes.append(Path(os.environ.get("NUMBA_CACHE_DIR", Path(__file__).parents[1] / "geofem")))
    kinds = (".so", ".c", ".nbi", ".nbc")
    return sum(path.suffix in kinds for home in homes if home.is_dir() for path in home.rglob("*"))


def steps(n: int) -> tuple[float, dict[str, float], int, dict[str, int], int]:
    """CPU seconds of ``STEPS`` steps, those of their phases, nodes, the work they took, and files compiled after the first step."""
    model = methods.get("pfem").build(scenes.get("dam_break")(), n=n)
    model.step(model.dt())
    files = compiled()
    for _ in range(WARM):
        model.step(model.dt())
    before, work, start = dict(CLOCK.seconds), dict(model.work), time.process_time()
    for _ in range(STEPS):
        model.step(model.dt())
    spent = time.process_time() - start
    phases = {name: seconds - before.get(name, 0.0) for name, seconds in CLOCK.seconds.items()}
    done = {name: count - work.get(name, 0) for name, count in model.work.items()}
    return spent, phases, model.size()["points"], done, compiled() - files


def main(sizes: tuple[int, ...] = SIZES) -> None:
    for n in sizes:
        runs = [steps(n) for _ in range(REPEATS)]
        spent, phases, nodes, done, files = min(runs, key=lambda run: run[0])
        print(f"n = {n}: {nodes} nodes, {1e3 * spent / STEPS:.1f} ms a step, {files} files compiled after the first step")
        told = {name: seconds for name, seconds in phases.items() if seconds > 0.0}
        told["rest"] = spent - sum(told.values())
        print("  " + ", ".join(f"{name} {1e3 * seconds / STEPS:.1f}" for name, seconds in told.items()))
        print("  " + ", ".join(f"{name} {count / STEPS:g}" for name, count in done.items() if count) + " a step")
        geometry = sum(told.get(name, 0.0) for name in ("remesh", "mesh", "spaces"))
        print(f"  remesh + mesh + spaces: {geometry / spent:.0%}", flush=True)


if __name__ == "__main__":
    main(tuple(map(int, sys.argv[1:])) or SIZES)
