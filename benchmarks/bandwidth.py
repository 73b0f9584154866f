"""How many bytes a second a core moves, and what that allows a step of material points at most.

python benchmarks/bandwidth.py [BYTES ...]          BYTES that a point moves in a step, in place of the counts below

The triad of STREAM (McCalpin 1995), a[i] = b[i] + s c[i], compiled by numba, float64, one thread, arrays far beyond the caches:
seconds of CPU, the least of several runs. A triad names 24 bytes; since a line of ``a`` is read before it is written
(write-allocate), 32 are moved. The second figure is what a step can be held against, if its bytes are counted the same way.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from numba import njit

LENGTH = 1 << 25
"""Numbers in each of the three arrays: 0.8 GB in all."""
RUNS = 15

# Fields of a point in the plane, bytes in float64.
POSITION = VELOCITY = 16
MASS = VOLUME = 8
GRADIENT, STRESS = 40, 32  # F with its zz component; xx, yy, zz, xy
AFFINE = PLANE_GRADIENT = 32
NODE = 64 / 4  # a line of the grid for four points


@njit(fastmath=True)
def triad(a, b, c, s):  # type: ignore[no-untyped-def]
    for i in range(len(a)):
        a[i] = b[i] + s * c[i]


def bandwidth() -> tuple[float, float]:
    """Bytes per CPU second of one core: as STREAM names them, and with those that write-allocate adds."""
    a, b, c = np.zeros(LENGTH), np.ones(LENGTH), np.ones(LENGTH)
    triad(a[:8], b[:8], c[:8], 3.0)
    least = np.inf
    for _ in range(RUNS):
        start = time.process_time()
        triad(a, b, c, 3.0)
        least = min(least, time.process_time() - start)
    assert a[-1] == 4.0
    return 24 * LENGTH / least, 32 * LENGTH / least


def moved(read: float, updated: float = 0, written: float = 0) -> float:
    """Bytes over the memory bus: fields that are only read; read and written back; written only, after write-allocate."""
    return read + 2 * updated + 2 * written


def bound(bytes_per_point_step: float, bytes_per_second: float) -> float:
    """Million point-steps per second that the bandwidth allows, if nothing is found in a cache."""
    return bytes_per_second / bytes_per_point_step / 1e6


TO_GRID = moved(POSITION + VELOCITY + MASS + VOLUME + STRESS)
TO_POINTS = moved(VOLUME, updated=POSITION + VELOCITY + GRADIENT, written=STRESS)
GRID = moved(NODE, updated=2 * NODE, written=NODE)
"""Cleared, filled, solved and read, where no cache holds it."""
MLS = moved(POSITION + VELOCITY + AFFINE, updated=PLANE_GRADIENT) + moved(0, updated=POSITION, written=VELOCITY + AFFINE)
COUNTS = {
    "two passes: to the grid; back, with F and stress": TO_GRID + TO_POINTS,
    "the same, and a grid beyond the cache": TO_GRID + TO_POINTS + GRID,
    "two passes of MLS-MPM: C in place of the stress": MLS,
    "one pass: back and at once to the next grid": moved(MASS + VOLUME, updated=POSITION + VELOCITY + GRADIENT),
}
"""Bytes of a point in a step, by what the step is made of; linear elastic, float64, in the plane."""


def main(counts: list[float]) -> None:
    named, total = bandwidth()
    print(f"one core: {named / 1e9:.1f} GB/s as STREAM counts, {total / 1e9:.1f} GB/s with write-allocate")
    print(f"{'bytes per point and step':56s}{'bytes':>8s}   million point-steps per second at most")
    for what, count in [("given", count) for count in counts] or COUNTS.items():
        print(f"{what:56s}{count:8.0f}{bound(count, total):8.1f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("bytes", nargs="*", type=float)
    main(parser.parse_args().bytes)
