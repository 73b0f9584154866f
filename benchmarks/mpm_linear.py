"""How many material points mpm-linear moves by a step in a second: python benchmarks/mpm_linear.py

A free elastic square, four points a cell, one thread, float64; CPU seconds of the process, the least of several runs, through
``Model.step`` with the stress update and all bookkeeping.
"""

from __future__ import annotations

import os

os.environ["NUMBA_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"

import time

import numpy as np

from geofem.methods.mpm import LinearMpm
from geofem.methods.mpm.points import FIELDS
from geofem.scene import Box, Material, Region, Scene


def square(law: str) -> Scene:
    """1 m x 1 m in free, small vibration."""
    material = Material(law, 1000.0, {"E": 1e6, "nu": 0.3})
    return Scene(
        name="square",
        regions=(Region("square", Box((0.0, 0.0), (1.0, 1.0)), material),),
        length=1.0,
        supports=(),
        dynamic=True,
        initial_velocity=lambda x: 0.1 * np.stack([np.sin(np.pi * x[0]), -np.sin(np.pi * x[1])]),
        room=Box((-0.1, -0.1), (1.1, 1.1)),
    )


def rate(law: str, scheme: str, n: int, *, shuffled: bool = False, runs: int = 6, steps: int = 10) -> float:
    """Million point-steps per CPU second."""
    model = LinearMpm().build(square(law), n=n, scheme=scheme, sort_after=np.inf)
    if shuffled:
        order = np.random.default_rng(0).permutation(len(model.points.id))
        state = model.state()
        model.restore(state | {name: state[name][order] for name in FIELDS})
    least = np.inf
    for _ in range(runs):
        start = time.process_time()
        for _ in range(steps):
            model.step(model.dt())
        least = min(least, time.process_time() - start)
    return steps * len(model.points.id) / least / 1e6


if __name__ == "__main__":
    print("million point-steps per CPU second, one core")
    for law in ("linear_elastic", "neo_hooke", "hencky"):
        for scheme in ("musl", "usl", "usf"):
            print(f"{law:15s} {scheme:5s}   102 400 points, sorted   {rate(law, scheme, 160):6.1f}", flush=True)
    for n, points, steps in ((160, "  102 400", 10), (640, "1 638 400", 2)):
        for shuffled, order in ((False, "sorted"), (True, "shuffled")):
            speed = rate("linear_elastic", "musl", n, shuffled=shuffled, steps=steps)
            print(f"linear_elastic  musl {points} points, {order:9s}{speed:6.1f}", flush=True)
