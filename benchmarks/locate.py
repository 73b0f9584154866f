"""Point location: microseconds of CPU per point, geofem.core.locate beside dolfinx, on one process.

python benchmarks/locate.py
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from mpi4py import MPI

from geofem.core.locate import Locator

# isort: split
from dolfinx import geometry, mesh

COUNT = 20_000


def cpu(work: Callable[[], object], repeats: int = 3) -> float:
    """Least CPU seconds of a few repetitions."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


def main() -> None:
    world, tensor = MPI.COMM_WORLD, mesh.CellType
    cases = [
        mesh.create_rectangle(world, [[0, 0], [1, 1]], [100, 100], diagonal=mesh.DiagonalType.crossed),
        mesh.create_rectangle(world, [[0, 0], [1, 1]], [150, 150], tensor.quadrilateral),
        mesh.create_unit_cube(world, 20, 20, 20),
        mesh.create_unit_cube(world, 30, 30, 30, tensor.hexahedron),
    ]
    print(f"{'cells':>24} {'build ms':>9} {'bins':>7} {'walk':>7} {'dolfinx':>8}   us/point; walk: points moved by 0.3 h")
    for domain in cases:
        print(row(domain), flush=True)


def row(domain: mesh.Mesh) -> str:
    """Times for one mesh of the unit square or cube."""
    rng = np.random.default_rng(0)
    gdim = domain.geometry.dim
    x, cells = domain.geometry.x[:, :gdim], domain.geometry.dofmaps[0]
    points = rng.random((COUNT, gdim))
    moved = np.clip(points + 0.3 * len(cells) ** (-1 / gdim) * rng.standard_normal((COUNT, gdim)), 0, 1)
    padded = np.zeros((COUNT, 3))
    padded[:, :gdim] = points
    locator = Locator(x, cells)
    found = locator.find(points)

    def with_dolfinx() -> None:
        tree = geometry.bb_tree(domain, domain.topology.dim)
        candidates = geometry.compute_collisions_points(tree, padded)
        geometry.compute_colliding_cells(domain, candidates, padded)

    build = cpu(lambda: Locator(x, cells)) * 1e3
    searches = (lambda: locator.find(points)), (lambda: locator.find(moved, found)), with_dolfinx
    bins, walk, peer = (cpu(search) * 1e6 / COUNT for search in searches)
    return f"{len(cells):>10} {locator.kind:>13} {build:9.1f} {bins:7.2f} {walk:7.2f} {peer:8.2f}"


if __name__ == "__main__":
    main()
