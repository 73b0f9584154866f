"""Two threads and two ranks against one, in seconds on the clock: material points moved by a step in a second.

uv run python benchmarks/mpm_scaling.py [--points 1600000 400000] [--methods mpm-linear mpm-gimp]

Threads: the knob ``threads`` of the method, 1 and 2 in one process, whose models take turns block by block. Ranks: ``mpirun -n 1``
and ``-n 2`` with the mpirun beside this Python, taking turns too. The best block counts; what a method does not take is
``refused``. Wall time is what threads and ranks are for, but on a machine that others use it says little: look at the load that
is printed, and repeat.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from inspect import signature
from pathlib import Path
from typing import Any

from mpm_peers import ONE_THREAD, square

POINTS, METHODS = (1_600_000, 400_000), ("mpm-linear", "mpm-gimp")
ROUNDS, BLOCKS = 3, 5
"""Turns of mpirun, and blocks of steps in each process."""
WORK = 8_000_000
"""Point-steps in a block."""


def model_of(method: str, points: int, **knobs: Any) -> Any:
    """The square of that many points, or the reason why not, as text."""
    from geofem import methods
    from geofem.mistake import Mistake

    if method not in methods.known():
        return "not registered"
    found, scene = methods.get(method), square("linear_elastic")
    if reason := found.refuses(scene):
        return f"refused: {reason}"
    if missing := set(knobs) - set(signature(found.build).parameters):
        return f"refused: no knob {', '.join(missing)}"
    try:
        return found.build(scene, n=round((points / 4) ** 0.5), scheme="usl", **knobs)
    except Mistake as mistake:
        return f"refused: {mistake}"


def block(model: Any, steps: int) -> float:
    """Million point-steps per second on the clock, of the slowest rank."""
    from mpi4py import MPI

    MPI.COMM_WORLD.Barrier()
    start = time.perf_counter()
    for _ in range(steps):
        model.step(model.dt())
    seconds = MPI.COMM_WORLD.allreduce(time.perf_counter() - start, MPI.MAX)
    return steps * model.size()["points"] / seconds / 1e6


def rates(method: str, points: int, threads: list[int]) -> dict[str, Any]:
    """The best block for every number of threads, by its name; none given: the method's own, as ``own``. On all ranks."""
    models = {str(t): model_of(method, points, threads=t) for t in threads} or {"own": model_of(method, points)}
    steps = max(2, WORK // points)
    found: dict[str, Any] = {name: model for name, model in models.items() if isinstance(model, str)}
    ready = {name: model for name, model in models.items() if name not in found}
    for model in ready.values():
        block(model, 1)  # compiles
    for _ in range(BLOCKS):
        for name, model in ready.items():
            found[name] = max(found.get(name, 0.0), block(model, steps))
    return found


def apart(launcher: list[str], method: str, points: int, threads: list[int]) -> dict[str, Any]:
    """``rates`` in processes of their own."""
    caps = ONE_THREAD | {"NUMBA_NUM_THREADS": str(max(threads, default=1))}
    with tempfile.TemporaryDirectory() as folder:
        answer = Path(folder) / "answer.json"
        command = [sys.executable, __file__, "--answer", str(answer), "--methods", method, "--points", str(points)]
        done = subprocess.run(
            [*launcher, *command, "--threads", *map(str, threads)], capture_output=True, text=True, env=os.environ | caps
        )
        if done.returncode or not answer.exists():
            print(f"{method}, {points} points, failed:\n{done.stdout[-2000:]}{done.stderr[-2000:]}", file=sys.stderr)
            return {}
        return json.loads(answer.read_text())


def compare(what: str, one: Any, two: Any) -> str:
    """A row's end: both rates and their ratio, or why there is none."""
    if isinstance(one, float) and isinstance(two, float):
        return f"{what:10s}{one:8.2f}{two:8.2f}{two / one:8.2f}"
    return f"{what:10s}{next((x for x in (two, one) if isinstance(x, str)), 'failed')}"


def main(methods: list[str], points: list[int]) -> None:
    mpirun = str(Path(sys.executable).parent / "mpirun")
    print(f"million point-steps per second on the clock; {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    print(f"{'':32s}{'':10s}{'one':>8s}{'two':>8s}{'ratio':>8s}")
    for method in methods:
        for count in points:
            row = f"{method:14s}{count:10d} points "
            found = apart([], method, count, [1, 2])
            print(row, compare("threads", found.get("1"), found.get("2")), sep="", flush=True)
            best: dict[int, Any] = {1: None, 2: None}
            for _ in range(ROUNDS):
                for ranks in best:
                    if isinstance(best[ranks], str):
                        continue
                    rate = apart([mpirun, "-n", str(ranks)], method, count, []).get("own")
                    best[ranks] = rate if isinstance(rate, str) else max(rate or 0.0, best[ranks] or 0.0) or None
                if isinstance(best[1], str) or best[2] is None or isinstance(best[2], str):
                    break
            print(row, compare("ranks", best[1], best[2]), sep="", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--methods", nargs="*", default=list(METHODS))
    parser.add_argument("--points", nargs="*", type=int, default=list(POINTS))
    parser.add_argument("--threads", nargs="*", type=int, default=[], help=argparse.SUPPRESS)
    parser.add_argument("--answer", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.answer is None:
        main(given.methods, given.points)
    else:
        from geofem.core.mpi import install_abort_hook

        install_abort_hook()  # an error of one rank must not leave the other waiting
        answer = rates(given.methods[0], given.points[0], given.threads)
        from mpi4py import MPI

        if MPI.COMM_WORLD.rank == 0:
            given.answer.write_text(json.dumps(answer))
