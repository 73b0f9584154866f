"""What the kernels say of a row of points before anything moves: where neighbours part, which time step is stable, what nobody sees.

A uniform row of points in the plane, ``ppc`` of them per cell of size 1 before it is stretched, one cell wide and held sideways: the
bar of one dimension, by the very loops that a run uses. Density, Young's modulus of the present configuration and the speed of
waves are 1. With S_np and g_np the weights and gradients along the row, summed over the nodes across it,

    m_n = sum S_np m_p,    K_nm = sum V_p g_np g_mp,    V_p = stretch / ppc,

a step of central differences is stable up to 2 / omega, omega**2 the largest eigenvalue of K against m.

The place of the row against the grid, ``offset`` in [0, 1) cells from its first edge to the last node before it, matters much: ask
for the worst of many.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache
from typing import Any

import numpy as np
from numba import njit

from geofem import methods
from geofem.methods.mpm import Mpm
from geofem.methods.mpm import grid as g
from geofem.methods.mpm.deeds import inlined, putting
from geofem.methods.mpm.grid import OPTIONS
from geofem.methods.mpm.kind import Cloud, Kind
from geofem.methods.mpm.parts import make_neighbours
from geofem.methods.mpm.shapes import SHAPES
from geofem.scene import Array

ROUNDING = 1e-9
"""Eigenvalues below this share of the largest are zero, nodes below this share of a point's mass are not there."""
MARGIN, ROWS, ROW = 6, 9, 4
"""Nodes on either side of the row of points; nodes across it, and the cell (of these) that it lies in."""


def make_kind(shape: str) -> Kind:
    """The passes of a run in plane strain without anything special."""
    return Kind(shape, 2, axial=False, small=False, scheme="usl", transfer="flip", loaded=False, spent=False, cure=False)


def make_row(shape: str, at: Array, stretch: float, ppc: int) -> Cloud:
    """Points of unit density at ``at`` (N,) cells along x, their domains stretched by ``stretch`` along it."""
    N, none = len(at), np.zeros((0, 0))
    x = np.column_stack([at, np.full(N, ROW + 0.5)])
    half = np.array([0.5 / ppc, 0.5 / ppc])
    present = half * (stretch, 1.0)
    domain = {
        "half": np.tile(half, (N, 1)),
        "edges": np.tile(np.diag(half).ravel(), (N, 1)),
        "corners": (x[:, None] + present * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])).reshape(N, 8),
    }[SHAPES[shape].domain]
    F = np.tile([stretch, 0.0, 0.0, 1.0, 1.0], (N, 1))
    v = np.zeros((N, 2))
    mass = np.full(N, 1.0 / ppc)
    return Cloud(
        X=x, x=x, at=x, v=v, C=none, F=F, L=none, tau=np.zeros((N, 4)), state=none, mass=mass, volume=mass, force=none,
        domain=domain, stretch=F, order=np.empty(0, np.int64), per_density=1.0,
    )  # fmt: skip


def lattice(count: int) -> tuple[float, float, float, float, int, int, int, int, int]:
    """``count`` by ``ROWS`` nodes, spacing 1."""
    return 0.0, 0.0, 0.0, 1.0, count, ROWS, 1, 0, 1


# --- where neighbours part ------------------------------------------------------------------------------------------------
def parted(shape: str, ppc: int, stretch: float, offsets: int = 200) -> float:
    """Share of the offsets at which two neighbours share no node."""
    first = MARGIN + stretch + (np.arange(offsets) + 0.37) / offsets
    at = np.column_stack([first, first + stretch / ppc]).ravel()
    row = make_row(shape, at, stretch, ppc)
    nodes = np.full((len(at), 64), -1, np.int64)
    make_neighbours(make_kind(shape))(row, len(at), lattice(int(at.max() + stretch) + MARGIN), nodes)
    a, b = nodes[0::2, :, None], nodes[1::2, None, :]
    return float(1.0 - np.mean(np.any((a == b) & (a >= 0), axis=(1, 2))))


def parting_stretch(shape: str, ppc: int, most: float = 12.0) -> float | None:
    """The least stretch, to 0.01, at which two neighbours share no node at the worst offset; None if they hold up to ``most``."""
    low, high = 1.0, None
    for stretch in np.arange(1.25, most + 0.25, 0.25).tolist():
        if parted(shape, ppc, stretch) > 0:
            high = stretch
            break
        low = stretch
    while high is not None and high - low > 0.01:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if parted(shape, ppc, middle) > 0 else (middle, high)
    return high


# --- the frozen step -----------------------------------------------------------------------------------------------------------
@cache
def make_weights(kind: Kind) -> Callable[..., None]:
    """Weights and gradients along x of points on all nodes: (q, count, lattice, out (count, nodes, 2)) -> None."""

    @inlined
    def give(w, gx, gy, gz, x, y, z, p):  # type: ignore[no-untyped-def]
        return w, gx, p

    @inlined
    def add(out, n, f, got):  # type: ignore[no-untyped-def]
        w, gx, p = got
        out[p, n, 0] += f * w
        out[p, n, 1] += f * gx

    over = SHAPES[kind.shape].over(kind.dim)(putting(give, add))

    @njit(**OPTIONS)
    def weights(q, count, lattice, out):  # type: ignore[no-untyped-def]
        for p in range(count):
            over(out, lattice, q.at, q.domain, q.stretch, p, p)

    return weights


def bar(shape: str, ppc: int, stretch: float, offset: float, cells: int = 8) -> tuple[Array, Array]:
    """Lumped masses (n,) and stiffness (n, n) of the nodes that a row of ``cells * ppc`` points reaches."""
    at = MARGIN + offset + stretch * (np.arange(cells * ppc) + 0.5) / ppc
    row = make_row(shape, at, stretch, ppc)
    return assemble(make_kind(shape), row, lattice(int(at[-1] + stretch) + MARGIN), stretch * row.volume)


def assemble(kind: Kind, row: Cloud, lattice: tuple[Any, ...], volume: Array) -> tuple[Array, Array]:
    """Lumped masses (n,) and stiffness (n, n) along x of points whose present volumes are ``volume`` (N,), all nodes across as one."""
    N, columns, across = len(row.mass), lattice[4], lattice[5]
    out = np.zeros((N, columns * across, 2))
    make_weights(kind)(row, N, lattice, out)
    S, gradient = np.moveaxis(out.reshape(N, columns, across, 2).sum(axis=2), 2, 0)
    mass, stiffness = row.mass @ S, gradient.T @ (volume[:, None] * gradient)
    there = mass > ROUNDING * row.mass.mean()
    return mass[there], stiffness[np.ix_(there, there)]


def merged(mass: Array, stiffness: Array, small: float) -> tuple[Array, Array]:
    """The bar whose nodes lighter than ``small`` move as one with their heaviest neighbour, see ``grid.merge_small``."""
    n = len(mass)
    nodes = np.zeros((n, g.COLUMNS[2]))
    nodes[:, 0] = mass
    partner, lent = np.zeros((n, 2), np.int64), np.zeros(n)
    count = g.merge_small(nodes, 2, (0, n, 0, 1, 0, 1), (1, 1, 0), small, partner, lent)
    joined = np.eye(n)
    for light, heavy in partner[:count]:
        joined[light] = joined[heavy]
    joined = joined[:, np.setdiff1d(np.arange(n), partner[:count, 0])]
    return mass @ joined, joined.T @ stiffness @ joined


def frequencies2(mass: Array, stiffness: Array) -> Array:
    """Squares of the angular frequencies (n,), ascending."""
    return np.linalg.eigvalsh(stiffness / np.sqrt(np.outer(mass, mass)))


def critical_step(shape: str, ppc: int, stretch: float, offset: float, small_mass: float = 0.0) -> float:
    """The largest stable step, in passages of a wave through a cell. small_mass : see ``Mpm.build``."""
    m, K = bar(shape, ppc, stretch, offset)
    if small_mass > 0:
        m, K = merged(m, K, small_mass / ppc)
    return float(2.0 / np.sqrt(frequencies2(m, K)[-1]))


def worst_step(shape: str, ppc: int = 2, stretch: float = 1.0, small_mass: float = 0.0, offsets: Iterable[float] = ()) -> float:
    """The least of the critical steps over the offsets, by default 64 evenly spread ones."""
    return min(critical_step(shape, ppc, stretch, o, small_mass) for o in (offsets or (np.arange(64) + 0.5) / 64))


def null_modes(shape: str, ppc: int, stretch: float, offset: float, cells: int = 16) -> int:
    """Motions of the nodes, beside the rigid one, that strain no point: zero eigenvalues of the stiffness but one."""
    _, K = bar(shape, ppc, stretch, offset, cells)
    own = np.linalg.eigvalsh(K)
    return int(np.sum(own < ROUNDING * own[-1])) - 1


def null_share(method: str, *, stretch: float, ppc: int = 2, cells: int = 64, kernel: str | None = None) -> dict[str, float]:
    """For the map of the null space: {"null_modes": share of the nodes' motions that strain no point}, worst of 8 offsets.

    method : the name of one of the material point methods; kernel : see ``Mpm.build``.
    """
    named = methods.get(method)
    assert isinstance(named, Mpm)
    shape = named.kernels[kernel or next(iter(named.kernels))]
    counts = []
    for offset in (np.arange(8) + 0.37) / 8:
        nodes = len(bar(shape, ppc, stretch, offset, cells)[0])
        counts.append(null_modes(shape, ppc, stretch, offset, cells) / nodes)
    return {"null_modes": max(counts)}
