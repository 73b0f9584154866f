"""The implicit material point method for bodies at rest: balance of forces on the active cells of the grid, load step by load step.

Updated Lagrangian (Charlton, Coombs & Augarde 2017; Guilkey & Weiss 2003): at the start of a step every point looks up its shape
functions; Newton's method finds the nodal increments du for which sum V_n P_n grad S balances the loads; then F = (I + sum du grad S)
F_n, points move with the grid, and the grid is put back.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from mpi4py import MPI

from geofem.methods.mpm import answers, setting
from geofem.methods.mpm import grid as g
from geofem.methods.mpm.background import Background
from geofem.methods.mpm.base import PointModel
from geofem.methods.mpm.kind import Kind
from geofem.methods.mpm.limits import Limits
from geofem.methods.mpm.parts import carry_corners
from geofem.methods.mpm.press import Press
from geofem.methods.mpm.system import System
from geofem.mistake import Breakdown
from geofem.scene import Array, Scene

SMALLEST_STEP = 1e-3
"""A step is cut no further than this fraction of the first one."""
ROUNDS = 30
"""Solutions of one step until walls are settled."""


class ImplicitMpm(PointModel):
    """Material points at rest on a background grid; see ``Mpm.build`` for the knobs."""

    def __init__(self, scene: Scene, *, shape: str, n: int, ppc: int, cure: bool, split: float, load_steps: int, tolerance: float,
                 penalty: float, plastic: bool):  # fmt: skip
        kind = Kind(shape, scene.gdim, scene.plane == "axisymmetric", scene.strain == "small", "usl", "flip", False, True, cure)
        super().__init__(scene, kind, scene.length / n, ppc, split)
        self.tolerance, self.plastic = tolerance, plastic
        self._dt = self._first_dt = scene.t_end / load_steps
        self.work = {"steps": 0, "newton": 0, "linear": 0, "cuts": 0, "point_steps": 0}
        self.balance = answers.Balance(self.bodies, self.mass, spent=True, stress_first=False)
        # the modulus of compression waves, of cells in contact and of nodes that hardly any point holds
        densities = [region.material.density or 1.0 for region in scene.regions]
        self._moduli = [rho * b.law.wave_speed(b.par, rho) ** 2 for b, rho in zip(self.bodies, densities)]
        self._penalty = penalty * max(self._moduli)
        self._imbalance, self.least = 0.0, math.inf
        self._last = (0, 0)
        self._divide()

    # --- ranks --------------------------------------------------------------------------------------------------------
    def _halo(self) -> int:
        """Cells beyond a slab that its points reach."""
        return 2 + math.ceil(self._extent() if self.shape.spread else self.shape.reach)

    def _lay_out(self, last: int) -> None:
        """The nodes of the window that ends before the row ``last``, their conditions, and the mesh of the grid."""
        per_row = int(np.prod(self.grid.shape[1:]))
        count = (last - self.grid.first) * per_row
        self._rate = np.zeros((count, self.grid.dim))  # of the nodes' increments in the last step, by the scene's time
        self.grid.nodes = np.zeros((count, g.COLUMNS[self.grid.dim]))
        coordinates = g.on_edges(self.grid.coordinates(), g.shape_bounds(self.scene) or [], self.h)
        row = self.grid.first + np.arange(count) // per_row
        self.limits = Limits(self.scene, coordinates, (row >= self.grid.own[0]) & (row < self.grid.own[1]))
        self.background = Background(self.grid, self.slabs, self.comm, ghosts=self.slabs.halo + 2)

    def _exchange(self) -> None:
        """Hand points over as they must be, and order all by their cells. Collective."""
        super()._exchange()
        for body in self.bodies:
            body.N = body.n
            body.sort(setting.cells_of(body, self.grid))
            body.make_room(body.N)

    # --- steps --------------------------------------------------------------------------------------------------------
    def dt(self) -> float:
        return self._dt

    def step(self, dt: float) -> None:
        """Raise the load by dt, or by less where Newton asks for it.

        Raises ``Breakdown``: ``newton`` (no balance), ``tangle`` (det F <= 0), ``nullspace`` (the grid can move without straining a
        point), ``volume`` (a point left the grid), ``fracture`` (a body that is to stay whole fell apart); the last good state stays.
        """
        system = self._system()
        goes_on = True
        while True:
            try:
                before = self._solve(system, self.t + dt, dt, goes_on)
                break
            except Breakdown as end:
                self._count(system)
                if end.cause == "nullspace":
                    raise Breakdown("nullspace", f"{end}; at t = {self.t:.4g}") from None
                if goes_on and self._rate.any():
                    goes_on = False
                    continue
                self.work["cuts"] += 1
                dt *= 0.5
                if dt < SMALLEST_STEP * self._first_dt:
                    raise Breakdown(end.cause, f"{end}; at t = {self.t:.4g}, after cutting the step to {dt:.1e}") from None
                self._dt = dt
        self._count(system)
        self._accept(system, before, dt)
        if dt >= self._dt:
            self._dt = min(self._first_dt, 1.5 * self._dt)

    def _system(self) -> System:
        self._check_places()
        cells = np.concatenate([setting.cells_of(body, self.grid) for body in self.bodies])
        definite = not self.plastic and not self._contacts
        system = System(self.background, self.bodies, self.kind, self._extent(), cells, self._penalty, definite)
        self._last = system.dofs, system.cells
        return system

    def _check_places(self) -> None:
        """Raises ``Breakdown`` (volume) if a domain has left the grid. Collective."""
        out = False
        for body in self.bodies:
            at = (body.own("X" if self.kind.small else "x") - self.grid.low) / self.h
            reach = 0.5 * np.abs(self.splitter.edges(body, self.h)).sum(axis=1) if self.shape.spread else self.shape.reach
            end = np.array(self.grid.shape) - 1
            pad = self.grid.pad
            inside = (at >= pad) & (at <= end - pad) & (at - reach >= 0) & (at + reach < end)
            out |= not bool(inside.all())
        if self.comm.allreduce(out, op=MPI.LOR):
            raise Breakdown("volume", f"a material point left the background grid at t = {self.t:.4g}")

    def _count(self, system: System) -> None:
        self.work["newton"] += system.newton_iterations
        system.newton_iterations = 0
        self.work["linear"] += system.solver.iterations - system.linear_iterations
        system.linear_iterations = system.solver.iterations

    def _loads(self, system: System, t: float) -> None:
        """Forces of the points at the scene's time t; the strength at t."""
        scene, parts = self.scene, []
        for body, region in zip(self.bodies, scene.regions):
            force = np.zeros((body.n, scene.gdim))
            for load in scene.loads:
                value = load.value if load.kind == "gravity" else np.asarray(load.value(body.own("X").T, t)).T
                force += scene.amplitude(load, t) * body.own("mass")[:, None] * np.asarray(value, float)
            parts.append(force)
            if scene.weakening is not None:
                body.par[:] = body.law.parameters(region.material, scene.weakening(t))
        system.load = np.concatenate(parts)

    def _solve(self, system: System, t: float, dt: float, goes_on: bool = True) -> tuple[Array, Array, Array]:
        """Find the balance at t; returns internal, external and reaction forces of the start of the step on the same nodes.

        goes_on : begin with a motion like that of the last step: where soil flows, the flow on the grid changes little from step to
        step, and from rest most iterations would go into finding it again.
        """
        system.dt = dt
        system.unknown.x.array[:] = 0.0
        self.limits.follow(self.t, t)
        before = self._forces_at_start(system)
        self._loads(system, t)
        if self._contacts:
            system.touch = self._press(t)
        for turn in range(ROUNDS):
            self.limits.apply(system)
            if turn == 0 and goes_on:
                system.begin(dt * self._rate)
            system.solve(self.tolerance, self.plastic)
            if not self.limits.review(system, self.tolerance):
                return before
        raise Breakdown("newton", f"walls do not settle in {ROUNDS} rounds")

    def _press(self, t: float) -> Press:
        """The rigid bodies at their places of t."""
        for contact in self._contacts:
            contact.follow(self.t, t, 1.0)
            moved = contact.velocity.copy()
            contact.follow(t, t, 1.0)
            contact.velocity = moved
        return Press(self._contacts, self.bodies, [modulus / self.h for modulus in self._moduli], self.h)

    def _forces_at_start(self, system: System) -> tuple[Array, Array, Array]:
        """Forces before the load is raised, for the work that it does."""
        self._loads(system, self.t)
        if self._contacts:
            system.touch = self._press(self.t)
        system.evaluate()
        return system.internal, system.external, system.internal - system.external

    def _accept(self, system: System, before: tuple[Array, Array, Array], dt: float) -> None:
        """Move the points with the grid, and carry the balances on."""
        du = system.unknown.x.array.reshape(-1, self.grid.dim)
        held = np.zeros(du.size, bool)
        held[system.held] = True
        held = held.reshape(du.shape)
        left = np.where(held, 0.0, system.force)
        self._imbalance = max(self._imbalance, system.norm(left) / (system.scale or 1.0))
        self.least = min(self.least, system.solver.least or math.inf)
        internal, external, reaction = before
        own = slice(0, system.owned)
        work = 0.5 * (internal + system.internal).ravel()[own] @ du.ravel()[own]
        forces = external + system.external + np.where(held, reaction + system.force, 0.0)
        sums = np.zeros(g.SUMS)
        sums[g.STRAIN_WORK], sums[g.WORK] = self.comm.allreduce(np.array([work, 0.5 * forces.ravel()[own] @ du.ravel()[own]]))
        self.balance.add(sums)
        _, u = system.increments(du)
        if self.shape.domain == "corners":
            self._carry_corners(system, du)
        system.response.commit()
        at = 0
        for body in self.bodies:
            body.own("x")[:] += u[at : at + body.n]
            at += body.n
            body.settle()
        if isinstance(system.touch, Press):
            system.touch.commit()
        self._rate[:] = 0.0
        self._rate[system.node_of_dof] = du / dt
        self.t += dt
        self.work["steps"] += 1
        self.work["point_steps"] += self._total()
        moved = math.sqrt(self.comm.allreduce(float((u**2).sum(axis=1).max(initial=0.0)), op=MPI.MAX)) / self.h
        self.splitter.check(self.bodies, self.h, moved, self.comm)
        self._check_places()
        self._exchange()
        self.watch.look(self, moved)

    def _carry_corners(self, system: System, du: Array) -> None:
        nodes = self.grid.nodes
        nodes[:] = 0.0
        nodes[system.node_of_dof, 1 : 1 + self.grid.dim] = du
        marks = np.zeros(g.MARKS, np.int64)
        for body in self.bodies:
            carry_corners(body.arrays["domain"], 0, body.n, nodes, self.grid.lattice, 1.0, marks)
        if self.comm.allreduce(int(marks[g.FAULT])):
            raise Breakdown("tangle", f"a domain is no longer convex at t = {self.t:.4g}")

    def _total(self) -> int:
        return self.comm.allreduce(sum(body.n for body in self.bodies))

    # --- what the model tells -----------------------------------------------------------------------------------------
    def _nodal_reaction(self, name: str, component: int) -> float:
        return self.limits.reaction(name, component)

    def energy(self) -> dict[str, float]:
        """Work of the stresses, and of loads and supports since t = 0 (J per metre), by the trapezoidal rule."""
        return {"kinetic": 0.0, "internal": self.balance.internal, "external": self.balance.external}

    def checks(self) -> dict[str, float | None]:
        """Drift of mass and volume, and the largest force left out of balance."""
        return self.balance.checks(self.bodies, self.comm) | {"momentum": self._imbalance}

    def functions(self) -> list[Any]:
        return []

    def size(self) -> dict[str, int]:
        return {"dofs": self._last[0], "cells": self._last[1], "points": self._total()}

    def savings(self) -> dict[str, float]:
        """``active_grid``: unknowns of the active cells, against those of the whole grid."""
        return {"active_grid": self._last[0] / (self.grid.dim * int(np.prod(self.grid.shape)))}

    # --- checkpoints --------------------------------------------------------------------------------------------------
    def state(self) -> dict[str, Array]:
        """All that a checkpoint must hold, on rank 0. Collective."""
        numbers = [self.t, self._dt, self._imbalance, self.least, *self._last]
        per_row = int(np.prod(self.grid.shape[1:]))
        first, end = ((row - self.grid.first) * per_row for row in self.grid.own)
        rates = self.comm.gather(self._rate[first:end])
        return setting.gather(self.comm, self.bodies) | {
            "clock": np.array(numbers), "balance": self.balance.state(), "work": np.array(list(self.work.values())),
            "rate": np.concatenate(rates) if rates is not None else np.zeros((0, self.grid.dim)),
        }  # fmt: skip

    def restore(self, state: dict[str, Array]) -> None:
        """Take up what ``state`` gave, on any number of ranks. Collective."""
        setting.scatter(state, self.bodies, self.grid, self.slabs)
        self.t, self._dt, self._imbalance, self.least, dofs, cells = state["clock"].tolist()
        self._last = int(dofs), int(cells)
        self.balance.restore(state["balance"])
        self.work = dict(zip(self.work, state["work"].tolist()))
        self._exchange()
        first = self.grid.first * int(np.prod(self.grid.shape[1:]))
        self._rate[:] = state["rate"][first : first + len(self._rate)]
