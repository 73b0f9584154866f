"""One explicit step of material points on a grid: the passes over points and nodes in the order of the scheme, on threads."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numba.core import config

from geofem.methods.mpm import grid as g
from geofem.methods.mpm.advance import make_advance, make_strain
from geofem.methods.mpm.conditions import Held, Walls, hold, set_velocity, stop
from geofem.methods.mpm.cure import make_dilate, make_pressures
from geofem.methods.mpm.deeds import ALL, FORCES, MASS, START, VELOCITY
from geofem.methods.mpm.kind import SCRATCH, Kind
from geofem.methods.mpm.parts import carry_corners, make_hear, make_keep_moments, make_tell
from geofem.methods.mpm.points import Body
from geofem.methods.mpm.scatter import make_scatter
from geofem.methods.mpm.shapes import SHAPES
from geofem.scene import Array

PARTNERS = 4096
"""Nodes of small mass that can be joined to a neighbour in one step."""


class Stepper:
    """The passes of one rank, with the arrays that its threads share or have for themselves.

    flip : share of flip against pic. order : m of xpic. damping : see ``grid.accelerate``. least_mass : nodes below it (kg) are left
    out; small_mass : those below it move as one with a neighbour. held, walls : the conditions on the nodes that were laid out last.
    """

    held: Held
    walls: Walls

    def __init__(self, grid: g.Grid, bodies: list[Body], kind: Kind, *, flip: float, order: int, damping: float,
                 least_mass: float, small_mass: float, threads: int):  # fmt: skip
        self.grid, self.bodies, self.kind, self.shape, self.h = grid, bodies, kind, SHAPES[kind.shape], grid.h
        self.flip, self.order, self.damping, self.threads = flip, order, damping, threads
        self.least_mass, self.small_mass = least_mass, small_mass
        self.ratio = 1.0  # see grid.accelerate
        self.partner, self.lent = np.zeros((PARTNERS, 2), np.int64), np.zeros(PARTNERS)
        self.box: tuple[int, ...] = (0,) * 6
        self._pool = ThreadPoolExecutor(threads) if threads > 1 else None
        self._faulty: list[tuple[Any, ...]] = [()] * threads  # body, fault and point of each thread's first fault in a step
        self._scratch = np.zeros((threads, SCRATCH))
        self._sums, self._marks = np.zeros((threads, g.SUMS)), np.zeros((threads, g.MARKS), np.int64)

    def lay_out(self, count: int) -> None:
        """The arrays of ``count`` nodes; the conditions on them are to be made anew."""
        columns = g.COLUMNS[self.grid.dim]
        self.grid.nodes = np.zeros((count, columns))
        self._nodes = [self.grid.nodes, *(np.zeros((count, columns)) for _ in range(self.threads - 1))]
        self._cell_sums = [np.zeros((count if self.kind.cure else 0, 3)) for _ in range(self.threads)]
        self.lattice, self.rows = self.grid.lattice, self.grid.rows
        self.box = (0,) * 6

    def share_points(self) -> None:
        """Give every thread its share of each body's points, after their number has changed."""
        self._cuts = [np.linspace(0, body.N, self.threads + 1).astype(int) for body in self.bodies]

    def step(self, dt: float, gravity: tuple[float, float, float]) -> None:
        """One step of dt (s) under the acceleration of gravity (m/s2), the points' own forces and the conditions as they are set."""
        self._sums[:] = 0.0
        self._marks[:] = 0
        self._faulty = [()] * self.threads
        self._marks[:, g.BOX : g.BOX + 6 : 2] = g.FAR
        rows, dim, scheme, columns = self.rows, self.grid.dim, self.kind.scheme, self.grid.nodes.shape[1]
        self._over_nodes(lambda thread, box: g.clear(self.grid.nodes, 0, columns, box, rows))
        if self.kind.transfer == "apic":
            keep, lattice = make_keep_moments(self.kind), self.lattice
            self._over_points(lambda t, body, k, lo, hi: keep(body.cloud, body.arrays["spread"], lo, hi, lattice))
        self._scatter(START if scheme == "usf" else ALL)
        if self._marks[:, g.FAULT].any():
            return
        if scheme == "usf":
            self._to_velocity(VELOCITY, 1 + 2 * dim)
            set_velocity(self.grid.nodes, 1 + 2 * dim, self.held.arrays, self.walls.arrays, dim)
            self._strain(dt)
            self._scatter(FORCES)
        self._move(dt, gravity)

    def sums(self) -> Array:
        """What was summed up in the step over the rank's own points and nodes: see ``grid``."""
        sums: Array = self._sums.sum(axis=0)
        sums[g.SPEED2] = self._sums[:, g.SPEED2].max()
        return sums

    def gained(self, dt: float) -> float:
        """The change of the nodes' kinetic energy in the last step of dt (J)."""
        return g.gained(self.grid.nodes, self.grid.dim, self.box, self.rows, self.grid.own, dt) / self.ratio

    def velocity(self) -> Array:
        """The velocity (nodes, d) that the points' momenta give the nodes of the rank's window now (m/s); zero where no point is."""
        nodes, marks = np.zeros_like(self.grid.nodes), np.zeros(g.MARKS, np.int64)
        scatter = make_scatter(self.kind, START if self.kind.scheme == "usf" else ALL)
        for body in self.bodies:
            scatter(body.cloud, 0, body.N, nodes, self.lattice, self._cell_sums[0], marks)
        there = nodes[:, MASS] > self.least_mass
        out: Array = np.zeros((len(nodes), self.grid.dim))
        out[there] = nodes[there, VELOCITY : VELOCITY + self.grid.dim] / nodes[there, MASS][:, None]
        return out

    def fault(self, now: float) -> tuple[str, str] | None:
        """Cause and words of a fault in this rank's own points."""
        for faulty in self._faulty:
            if faulty:
                body, fault, point = faulty
                X, x = (body.arrays[name][point] for name in ("X", "x"))
                place = f"the material point of ({', '.join(f'{v:.4g}' for v in X)}) m, now at ({', '.join(f'{v:.4g}' for v in x)}) m,"
                if fault == g.ESCAPED:
                    return "volume", f"{place} left the background grid at t = {now:.4g}"
                if fault == g.FOLDED:
                    return "tangle", f"the domain of {place} is no longer convex at t = {now:.4g}"
                return "tangle", f"{place} is turned inside out (det F <= 0) at t = {now:.4g}"
        return None

    def compile(self) -> None:
        """Run the passes over no points, so that their compilation belongs to the set-up.

        Numba leaves LLVM's vectoriser of straight-line code off. At the corners of domains it saves a third of a point's time;
        products of functions along the axes gain nothing, and hats lose.
        """
        before = config.SLP_VECTORIZE
        config.SLP_VECTORIZE = int(self.shape.domain != "half")
        try:
            self._compile()
        finally:
            config.SLP_VECTORIZE = before

    def _compile(self) -> None:
        grid, kind, sums = self.grid, self.kind, np.zeros(g.SUMS)
        fused = kind.scheme == "usl" and not kind.cure
        rest = self._scratch[0], sums, self._marks[0]
        for body in self.bodies:
            if kind.transfer == "apic":
                make_keep_moments(kind)(body.cloud, body.arrays["spread"], 0, 0, self.lattice)
            for what in (START, FORCES) if kind.scheme == "usf" else (ALL,):
                make_scatter(kind, what)(body.cloud, 0, 0, grid.nodes, self.lattice, self._cell_sums[0], self._marks[0])
            make_advance(kind, body.answer if fused else None)(
                body.cloud, 0, 0, 0, grid.nodes, grid.nodes, self.lattice, body.par, 1.0, self.flip, self.h, *rest
            )
            if not fused:
                make_strain(kind, body.answer)(
                    body.cloud, 0, 0, 0, grid.nodes, self.lattice, self._cell_sums[0], body.par, 1.0, *rest
                )

    # --- threads --------------------------------------------------------------------------------------------------------
    def _each(self, work: Callable[[int], None]) -> None:
        """Do the work of every thread: work(thread)."""
        if self._pool is None:
            work(0)
        else:
            list(self._pool.map(work, range(self.threads)))

    def _over_points(self, work: Callable[..., None]) -> None:
        """work(thread, body, its number, first point, end) for the share of every body's points that each thread has."""

        def share(thread: int) -> None:
            for k, (body, cut) in enumerate(zip(self.bodies, self._cuts)):
                if cut[thread] < cut[thread + 1]:
                    work(thread, body, k, int(cut[thread]), int(cut[thread + 1]))
                    if self._marks[thread, g.FAULT] and not self._faulty[thread]:
                        self._faulty[thread] = (body, *self._marks[thread, [g.FAULT, g.POINT]].tolist())

        self._each(share)

    def _over_nodes(self, work: Callable[..., None]) -> None:
        """work(thread, box) for the share of the reached nodes that each thread has."""
        i0, i1, *rest = self.box

        def share(thread: int) -> None:
            cut = [i0 + (i1 - i0) * k // self.threads for k in (thread, thread + 1)]
            work(thread, (*cut, *rest))

        self._each(share)

    # --- the parts of a step --------------------------------------------------------------------------------------------
    def _scatter(self, what: str) -> None:
        """Points to the grid."""
        kind, lattice = self.kind, self.lattice
        if kind.cure and what != START:
            self._sum_cells(make_pressures(kind), (0, 1))
        scatter = make_scatter(kind, what)
        self._over_points(
            lambda t, body, k, lo, hi: scatter(body.cloud, lo, hi, self._nodes[t], lattice, self._cell_sums[0], self._marks[t])
        )
        if what != FORCES:
            self._marks[0, g.BOX : g.BOX + 6 : 2] = self._marks[:, g.BOX : g.BOX + 6 : 2].min(axis=0)
            self._marks[0, g.BOX + 1 : g.BOX + 6 : 2] = self._marks[:, g.BOX + 1 : g.BOX + 6 : 2].max(axis=0)
            self.box = self.grid.box(self._marks[0]) if any(body.N for body in self.bodies) else (0,) * 6
        self._join(0, 1 + 2 * self.grid.dim)

    def _join(self, first: int, end: int) -> None:
        """Add what the other threads put into their own grids."""
        if self.threads > 1:
            rows = self.rows

            def add(thread: int, box: tuple[int, ...]) -> None:
                for others in self._nodes[1:]:
                    g.add_grid(self.grid.nodes, others, box, rows, first, end)

            self._over_nodes(add)

    def _sum_cells(self, sums: Callable[..., None], columns: tuple[int, ...], *more: Any) -> None:
        """Cell sums of the volumetric cure, of all threads."""
        lattice = self.lattice
        for cells in self._cell_sums:
            cells[:, columns] = 0.0
        self._over_points(lambda t, body, k, lo, hi: sums(body.cloud, lo, hi, *more, lattice, self._cell_sums[t]))
        for cells in self._cell_sums[1:]:
            self._cell_sums[0][:, columns] += cells[:, columns]

    def _to_velocity(self, momentum: int, velocity: int) -> None:
        dim, rows = self.grid.dim, self.rows
        self._over_nodes(lambda t, box: g.to_velocity(self.grid.nodes, momentum, velocity, dim, box, rows, self.least_mass))

    def _move(self, dt: float, gravity: tuple[float, float, float]) -> None:
        """The momentum balance on the nodes, and what the points make of it."""
        grid, kind, dim, rows = self.grid, self.kind, self.grid.dim, self.rows
        nodes, held, walls, lattice = grid.nodes, self.held.arrays, self.walls.arrays, self.lattice
        if kind.transfer == "xpic":
            self._without_noise()
        joined = 0
        if self.small_mass > 0.0:
            joined = g.merge_small(nodes, dim, self.box, rows, self.small_mass, self.partner, self.lent)
        self._over_nodes(
            lambda t, box: g.accelerate(
                nodes, dim, box, rows, grid.own, self.least_mass, dt, self.ratio, gravity, self.damping, self._sums[t]
            )
        )
        g.part_again(nodes, dim, self.partner, self.lent, joined)
        hold(nodes, dim, held, self.least_mass, dt, self.ratio, gravity, self.damping, self._sums[0])
        stop(nodes, dim, walls, self.least_mass, dt, self.ratio, gravity, self._sums[0])

        fused = self.kind.scheme == "usl" and not kind.cure
        W = 1 + 2 * dim
        if self.kind.scheme == "musl" and kind.transfer == "xpic":
            self._over_nodes(lambda t, box: g.clear(nodes, W, W + dim, box, rows))
        advance = [make_advance(kind, body.answer if fused else None) for body in self.bodies]
        self._over_points(
            lambda t, body, k, lo, hi: advance[k](
                body.cloud, lo, hi, body.n, nodes, self._nodes[t], lattice, body.par, dt, self.flip, self.h,
                self._scratch[t], self._sums[t], self._marks[t],
            )
        )  # fmt: skip
        if self.kind.scheme == "musl":
            self._join(W, W + dim)
            self._to_velocity(W, W)
            set_velocity(nodes, W, held, walls, dim)
        if not fused and self.kind.scheme != "usf":
            self._strain(dt)
        if self.shape.domain == "corners" and not kind.small:
            self._over_points(
                lambda t, body, k, lo, hi: carry_corners(body.arrays["domain"], lo, hi, nodes, lattice, dt, self._marks[t])
            )

    def _strain(self, dt: float) -> None:
        """Strains and stresses from the velocities on the grid."""
        kind, lattice, nodes = self.kind, self.lattice, self.grid.nodes
        if kind.cure:
            if self.kind.scheme == "usf":
                self._sum_cells(make_pressures(kind), (0, 1))
            dilate = make_dilate(kind)
            self._sum_cells(lambda q, lo, hi, lat, cells: dilate(q, lo, hi, nodes, lat, cells, dt), (2,))
        strain = [make_strain(kind, body.answer) for body in self.bodies]
        self._over_points(
            lambda t, body, k, lo, hi: strain[k](
                body.cloud,
                lo,
                hi,
                body.n,
                nodes,
                lattice,
                self._cell_sums[0],
                body.par,
                dt,
                self._scratch[t],
                self._sums[t],
                self._marks[t],
            )
        )

    def _without_noise(self) -> None:
        """XPIC: the points' velocities without what the grid does not see, (I - (I - P)^m) v with P = S S^+ (Hammerquist & Nairn
        2017, eq. 19); they are kept in ``C``."""
        dim, lattice, nodes = self.grid.dim, self.lattice, self.grid.nodes
        W, rows = 1 + 2 * dim, self.rows
        hear, tell = make_hear(self.kind, W), make_tell(self.kind)
        self._to_velocity(VELOCITY, W)
        for body in self.bodies:
            body.arrays["C"][: body.N] = 0.0
        heard = [np.empty((body.N, dim)) for body in self.bodies]
        for r in range(1, self.order + 1):
            self._over_points(lambda t, body, k, lo, hi: hear(body.cloud, lo, hi, nodes, lattice, heard[k]))
            share = (-1) ** (r + 1) * math.comb(self.order, r)
            for body, out in zip(self.bodies, heard):
                body.arrays["C"][: body.N] += share * out
            if r < self.order:
                self._over_nodes(lambda t, box: g.clear(nodes, W, W + dim, box, rows))
                self._over_points(
                    lambda t, body, k, lo, hi: tell(body.cloud._replace(v=heard[k]), lo, hi, self._nodes[t], lattice)
                )
                self._join(W, W + dim)
                self._to_velocity(W, W)
