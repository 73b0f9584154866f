"""Delaunay triangulations by CGAL or Qhull, behind one function that gives the same cells whoever makes them."""

from __future__ import annotations

import ctypes
import functools
import hashlib
import logging
import os
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from geofem.methods.pfem.tessellation import flips, simplices
from geofem.mistake import Mistake, unknown
from geofem.scene import Array

log = logging.getLogger("geofem")

SOURCE = Path(__file__).with_name("tessellate.cpp")
TIE = 1e-9
"""Largest weight in Qhull's triangulations, by the size of the cloud squared: it decides between equals only."""
STEEP = 1e-7
"""Facets of the hull that are steeper are those of its rim, not cells: their circles would be a million times the cloud."""
FLAGS = ("-O2", "-DNDEBUG", "-frounding-math", "-std=c++17", "-shared", "-fPIC")
LIBRARIES = ("-lgmp", "-lmpfr")


def delaunay(x: Array, backend: str = "auto") -> Array:
    """The cells (m, gdim + 1) int64 of the Delaunay triangulation of x (n, gdim), of positive volume, in an order of their own.

    backend : native (CGAL, compiled on this machine), compas (CGAL in the package compas_cgal, in the plane only), qhull
        (scipy), or auto: the first of these that there is.

    Of nodes at the same place the first has the cells, the others none; cells whose volume rounds to nothing are left out.
    Raises ``Mistake`` for nodes that no triangulation can have.
    """
    x = np.ascontiguousarray(x, float)
    cells = simplices.ordered(triangulated(x, backend)[0])[0]
    volumes = simplices.volumes(x, cells)
    return cells if (volumes > 0).all() else cells[volumes > 0]


def constrained(x: Array, edges: Array, backend: str = "auto") -> tuple[Array, Array, Array]:
    """The constrained Delaunay triangulation of the plane that has the directed edges (k, 2).

    Returns its cells (m, 3), as ``delaunay``'s, but with those whose area rounds to nothing; on which side of the edges each
    lies (m,): 1 on the left, -1 on the right, 0 where they are not closed and so do not tell; and which edges could not be
    put in (k,), as they cross others. Edges at the same place in opposite directions are none: bodies that touch are one.
    """
    x = np.ascontiguousarray(x, float)
    cells, first = triangulated(x, backend)
    across = simplices.neighbours(cells)
    held = np.ascontiguousarray(edges, np.int64) if first is None else first[edges]
    marks, refused = flips.hold(x, cells, across, held)
    sides = flips.sides(cells, across, marks)
    cells, rows = simplices.ordered(cells)
    return cells, sides[rows], refused


def triangulated(x: Array, backend: str) -> tuple[Array, Array | None]:
    """All cells of the Delaunay triangulation, also flat ones, turned so that their volume is not negative.

    Each node stands for those at the same place after it: which one stands for each (n,), or None if all do for themselves.
    """
    n, gdim = x.shape
    if n <= gdim:
        raise Mistake(f"pfem: {n} nodes cannot be tessellated in {gdim}D; give at least {gdim + 1}")
    if not np.isfinite(x).all():
        raise Mistake(f"pfem: node {np.flatnonzero(~np.isfinite(x).all(axis=1))[0]} is not at a finite place")
    cells = method(backend, gdim)(x)
    if len(cells) == 0:
        raise Mistake(f"pfem: the {n} nodes all lie on one {'line' if gdim == 2 else 'plane'}; no cell fits between them")
    used = np.zeros(n, bool)
    used[cells.ravel()] = True
    if used.all():
        return cells, None
    _, first, number = np.unique(x, axis=0, return_index=True, return_inverse=True)
    stands = first[number.ravel()]
    return stands[cells], stands


# --- who makes them ---------------------------------------------------------------------------------------------------
def method(backend: str, gdim: int) -> Callable[[Array], Array]:
    """The function from nodes to cells that a backend stands for."""
    if backend not in ("auto", "native", "compas", "qhull"):
        raise unknown("backend", backend, ("auto", "native", "compas", "qhull"))
    if backend == "compas" and gdim == 3:
        raise Mistake("pfem: backend compas tessellates the plane only; in 3D choose native or qhull")
    if backend in ("auto", "native"):
        library = native()
        if library is not None:
            return functools.partial(by_native, library)
        if backend == "native":
            raise Mistake("pfem: backend native needs CGAL's headers: sudo apt-get install -y g++ libcgal-dev")
    return by_qhull if gdim == 3 or backend == "qhull" else by_compas


def by_native(library: ctypes.CDLL, x: Array) -> Array:
    n, gdim = x.shape
    function = library.delaunay2 if gdim == 2 else library.delaunay3
    room = 2 * n if gdim == 2 else 8 * n
    while True:
        cells = np.empty((room, gdim + 1), np.int64)
        count = function(n, x.ctypes.data, cells.ctypes.data, room)
        if count < 0:
            raise RuntimeError("CGAL could not make a Delaunay triangulation")
        if count <= room:
            return cells[:count]
        room = count


def by_compas(x: Array) -> Array:
    # the extension module itself: the package's own one imports half a second of geometry that is not needed here
    from compas_cgal import _triangulation

    padded = np.zeros((len(x), 3))
    padded[:, :2] = x
    return _triangulation.delaunay_triangulation(padded).astype(np.int64)


def by_qhull(x: Array) -> Array:
    """The lower hull of the nodes lifted to a paraboloid (Edelsbrunner and Seidel 1986), off it by the least of weights.

    Where more than gdim + 1 nodes lie on a sphere Qhull splits what they span facet by facet, with diagonals that do not meet or
    flat cells among them; with weights the nodes are in general position, and no cell of a regular triangulation is flat.
    """
    from scipy.spatial import ConvexHull, QhullError

    gdim = x.shape[1]
    y = x - x.mean(axis=0)
    span = float(np.abs(y).max(initial=0.0)) or 1.0
    y /= span
    # at random: weights in arithmetic progression would balance each other on a lattice
    weight = TIE * np.random.default_rng(0).random(len(x))
    try:
        hull = ConvexHull(np.column_stack([y, (y**2).sum(axis=1) + weight]))
    except (QhullError, ValueError):  # all nodes on one line or plane, or too few
        return np.empty((0, gdim + 1), np.int64)
    cells = hull.simplices[hull.equations[:, gdim] < -STEEP].astype(np.int64)
    turned = simplices.volumes(x, cells) < 0
    cells[turned, -2:] = cells[turned, :-3:-1]
    return cells


# --- the native library -----------------------------------------------------------------------------------------------
def compiler() -> list[str]:
    """The C++ compiler: $CXX, or c++."""
    return shlex.split(os.environ.get("CXX") or "c++")


def library_path() -> Path | None:
    """Where the compiled library is kept, by a hash of its source and its compiler; None without a compiler."""
    command = compiler()
    found = shutil.which(command[0])
    if found is None:
        return None
    status = os.stat(found)
    key = repr((SOURCE.read_bytes(), command, os.path.realpath(found), status.st_mtime_ns, FLAGS, LIBRARIES))
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "geofem"
    return folder / f"tessellate-{hashlib.sha256(key.encode()).hexdigest()[:16]}.so"


@functools.cache
def native() -> ctypes.CDLL | None:
    """CGAL, compiled by the first who asks (some 15 s) and kept; None where headers or compiler are missing."""
    path = library_path()
    if path is None:
        log.info("pfem: no C++ compiler; CGAL by compas_cgal in the plane, Qhull in space")
        return None
    try:
        if not path.exists():
            compile_to(path)
        library = ctypes.CDLL(str(path))
    except (OSError, subprocess.CalledProcessError) as error:
        log.info("pfem: no native CGAL (%s); CGAL by compas_cgal in the plane, Qhull in space", error)
        return None
    for function in (library.delaunay2, library.delaunay3):
        function.restype = ctypes.c_int64
        function.argtypes = [ctypes.c_int64, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64]
    return library


def compile_to(path: Path) -> None:
    """Compile the library; who reads it meanwhile finds nothing or all of it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        made = Path(folder, path.name)
        log.info("pfem: compiling CGAL's Delaunay triangulations, once (some 15 s)")
        subprocess.run([*compiler(), *FLAGS, str(SOURCE), "-o", str(made), *LIBRARIES], check=True, capture_output=True)
        os.replace(made, path)
