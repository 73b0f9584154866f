"""Tessellations for pfem: milliseconds of CPU a call by each backend, for the bare Delaunay cells and for whole tessellations.

python benchmarks/pfem_tessellation.py [--largest 100000]

The body is a square or a cube of jittered nodes, stirred by a fifth of the spacing between two calls; one thread.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np

from geofem.methods.pfem.tessellation import Tessellator, backends, simplices
from geofem.methods.pfem.tessellation.alpha import AlphaShape
from geofem.methods.pfem.tessellation.constrained import Constrained
from geofem.methods.pfem.tessellation.inside import InsideBody
from geofem.scene import Array


def cpu(work: Callable[[], object], repeats: int = 3) -> float:
    """Least CPU milliseconds of a few repetitions, after one that compiles."""
    work()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return 1e3 * min(times)


def body(count: int, gdim: int) -> tuple[Array, Array, Array]:
    """About so many nodes of the unit square or cube, where they are one step later, and their sizes."""
    n = round(count ** (1 / gdim)) - 1
    rng = np.random.default_rng(0)
    x = np.stack(np.meshgrid(*[np.arange(n + 1) / n] * gdim, indexing="ij"), axis=-1).reshape(-1, gdim)
    inner = ((x > 0) & (x < 1)).all(axis=1)
    x[inner] += 0.2 / n * rng.uniform(-1, 1, (inner.sum(), gdim))
    moved = x + 0.2 / n * np.stack([np.sin(9 * x[:, (d + 1) % gdim]) for d in range(gdim)], axis=1)
    return x, moved, np.full(len(x), 1 / n)


def row(count: int, gdim: int, backend: str) -> str:
    x, moved, size = body(count, gdim)
    ways: tuple[Tessellator, ...] = (AlphaShape(backend=backend), (Constrained if gdim == 2 else InsideBody)(backend=backend))
    cells = backends.delaunay(moved, backend)
    old = ways[1](x, size, None)
    across = simplices.neighbours(cells)
    times = [
        cpu(lambda: backends.method(backend, gdim)(moved)),
        *(cpu(lambda way=way: way(moved, size, old)) for way in ways),  # type: ignore[misc]
        cpu(lambda: simplices.ordered(cells)),
        cpu(lambda: simplices.neighbours(cells)),
        cpu(lambda: simplices.boundary(cells, across)),
        cpu(lambda: simplices.parents(cells, old.cells)),
    ]
    return f"{gdim:2} {len(x):7} {len(cells):7} {backend:>7}" + "".join(f"{t:10.2f}" for t in times)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--largest", type=int, default=100_000, help="nodes of the largest body")
    largest = parser.parse_args().largest
    names = ("delaunay", "alpha", "keeping", "order", "neighbour", "boundary", "parents")
    print(f"{'d':>2} {'nodes':>7} {'cells':>7} {'backend':>7}" + "".join(f"{name:>10}" for name in names))
    here = [backend for backend in ("native", "compas", "qhull") if backend != "native" or backends.native()]
    for gdim in (2, 3):
        for count in (1_000, 10_000, 100_000):
            for backend in here:
                if count <= largest and (gdim, backend) != (3, "compas"):
                    print(row(count, gdim, backend), flush=True)


if __name__ == "__main__":
    main()
