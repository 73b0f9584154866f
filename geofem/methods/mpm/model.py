"""The explicit material point method as a model of a scene: steps, probes, balances, checkpoints."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np

from geofem import materials
from geofem.cost import phase
from geofem.methods.mpm import grid as g
from geofem.methods.mpm.grid import Held, make_grid
from geofem.methods.mpm.kernels import make_deform, make_transfer
from geofem.methods.mpm.points import FIELDS, cells, seed
from geofem.mistake import Breakdown
from geofem.scene import Array, Probe, Scene

LEAST_MASS = 1e-12
"""Nodes with less than this share of a point's mass are left out: their velocity would be rounding."""
WORTH_SORTING = 20_000
"""Fewer points than this fit into a processor's cache in any order."""
RAMP = 5.0
"""Passages of a wave through the body in which a load is raised; the slowest axial mode takes four for one swing."""
TURN = 10_000_000
"""Point steps, about a second, after which a scene without inertia gives the run a turn."""
UNREST = 0.5
"""Nodal forces out of balance, against the reactions, with which a body that does not move is not at rest: where points have
crossed cells, local damping can hold it by the noise. What is left of that noise at a true rest is below 0.4."""
PATIENCE = 400
"""A load step that has not come to rest after so many passages of a wave through the body has failed."""


class ExplicitMpm:
    """Material points on a background grid; see ``LinearMpm.build`` for the knobs.

    A scene without inertia is solved by dynamic relaxation: the load rises smoothly in a time of its own, and damped steps go
    on until the body is at rest; ``t`` is the last load at which it was.
    """

    def __init__(self, scene: Scene, *, shape: str, n: int, ppc: int, flip: float, scheme: str, cfl: float, damping: float,
                 load_steps: int, tolerance: float, sort_after: float):  # fmt: skip
        self.scene = scene
        self.t = self._now = 0.0
        self._target, self._time, self._calm = 0.0, 0.0, -1.0  # of the load that is being raised: calm >= 0
        self.work = {"steps": 0, "newton": 0, "linear": 0, "point_steps": 0, "remeshes": 0}
        self.flip, self.cfl, self.damping = flip, cfl, damping
        self.load_steps, self.tolerance, self.sort_after = load_steps, tolerance, sort_after

        self.h = scene.length / n
        self.grid, coordinates = make_grid(scene, self.h)
        self.held = Held(scene, coordinates)
        laws = [materials.get(region.material.law) for region in scene.regions]
        parameters = [law.parameters(region.material) for law, region in zip(laws, scene.regions, strict=True)]
        speeds = [
            law.wave_speed(par, region.material.density)
            for law, par, region in zip(laws, parameters, scene.regions, strict=True)
        ]
        self.wave_speed = max(speeds)
        self.points = points = seed(scene, self.h, ppc, [law.initial_state(1, 4)[0] for law in laws])
        points.sort(self.grid.lattice)
        size = points.X.max(0) - points.X.min(0)
        self.passage = float(np.hypot(*size)) / self.wave_speed
        self.least_mass = LEAST_MASS * float(points.mass.mean())

        small = scene.strain == "small"
        self._to_grid, self._to_points = make_transfer(shape, scheme, small)
        self._deform = []
        for law, par, (a, b) in zip(laws, parameters, pairwise(points.first), strict=True):
            arrays = points.at[a:b], points.F[a:b], points.state[a:b, : law.state_size(4)], points.volume[a:b], points.tau[a:b]
            self._deform.append((make_deform(shape, scheme, law.point, small), arrays, par, a))
        self._gravity = [load for load in scene.loads if load.kind == "gravity"]
        self._body = [load for load in scene.loads if load.kind == "body"]
        self._body_force = np.zeros((len(points.id) if self._body else 0, 2))
        self._around: dict[tuple[float, ...], tuple[Array, Array]] = {}

        self._sums, self._marks = np.zeros(g.SUMS), np.zeros(g.MARKS, np.int64)
        self._sums[g.SPEED2] = np.max(np.sum(points.v**2, axis=1))
        self._energy_at_start = self._kinetic = float(0.5 * points.mass @ np.sum(points.v**2, axis=1))
        self._momentum_at_start = points.mass @ points.v
        self._mass_at_start = float(points.mass.sum())
        self._impulse = np.zeros(2)
        self._internal = self._external = 0.0
        self._largest_kinetic, self._largest_work = self._kinetic, 0.0
        self._crossed = 0
        self._compile()
        self._box()

    # --- steps --------------------------------------------------------------------------------------------------------
    def dt(self) -> float:
        """The Courant step (s), or the scene's load step."""
        return self._courant() if self.scene.dynamic else self.scene.t_end / self.load_steps

    def step(self, dt: float) -> None:
        """One explicit step; in a scene without inertia many of them, of which only the last one moves ``t``.

        Raises ``Breakdown``: ``tangle`` (det F <= 0 at a point), ``volume`` (a point left the grid), ``cfl`` (velocities
        beyond ten wave speeds), ``energy`` (twice the energy that was ever put in), ``newton`` (no rest under a load).
        """
        if self.scene.dynamic:
            dt = min(dt, self._courant())
            self._advance(dt, self.t + dt)
            self.t = self._now
        else:
            self._relax(dt)

    def _courant(self) -> float:
        return self.cfl * self.h / (self.wave_speed + math.sqrt(self._sums[g.SPEED2]))

    def _relax(self, dt: float) -> None:
        """Raise the load by dt smoothly, and wait until the body has been at rest for the passage of a wave.

        Comes back before that after ``TURN`` point steps, so that the run can be watched and stopped.
        """
        turn = self.work["point_steps"] + TURN
        if self._calm < 0.0:  # a new load
            self._target, self._time, self._calm = self.t + dt, 0.0, 0.0
        while self.work["point_steps"] < turn:
            h = self._courant()
            self._time += h
            s = min(1.0, self._time / (RAMP * self.passage))
            self._advance(h, self.t + (self._target - self.t) * s * s * (3.0 - 2.0 * s) if s < 1.0 else self._target)
            balanced = self._sums[g.UNBALANCE] <= UNREST * self._sums[g.REACTIONS]
            quiet = s == 1.0 and balanced and self._kinetic <= self.tolerance * abs(self._external)
            self._calm = self._calm + h if quiet else 0.0
            if self._calm >= self.passage:
                self.t, self._calm = self._target, -1.0
                return
            if self._time > PATIENCE * self.passage:
                raise Breakdown(
                    "newton", f"no rest under the load of t = {self._target:.4g}: kinetic energy {self._kinetic:.3g} J"
                )

    def _advance(self, dt: float, t1: float) -> None:
        """One explicit step of dt (s) that ends at the scene's time t1."""
        q, lattice, nodes, held = self.points, self.grid.lattice, self.grid.nodes, self.held.arrays
        sums, marks = self._sums, self._marks
        gx = gy = 0.0
        for load in self._gravity:
            factor = self.scene.amplitude(load, self._now)
            gx += factor * load.value[0]
            gy += factor * load.value[1]
        self._body_force[:] = 0.0
        for load in self._body:
            self._body_force += self.scene.amplitude(load, self._now) * np.asarray(load.value(q.X.T, self._now)).T
        self.held.follow(self._now, t1, dt)
        settings = (self._body_force, lattice, nodes, held, self.least_mass, dt, (gx, gy), self.damping, self.flip, sums, marks)
        self._to_grid(q.at, q.x, q.v, q.mass, q.volume, q.tau, *settings)
        for deform, arrays, par, first in self._deform:
            deform(*arrays, par, lattice, nodes, dt, sums, marks, first)
        self._to_points(q.at, q.x, q.v, q.mass, *settings)
        self._now = t1
        self._account()

    def _account(self) -> None:
        """Carry the balances on, look for faults, and sort the points when they have strayed."""
        sums, marks, q = self._sums, self._marks, self.points
        self.work["steps"] += 1
        self.work["point_steps"] += len(q.id)
        self._kinetic = float(sums[g.KINETIC])
        self._internal += float(sums[g.STRAIN_WORK])
        self._external += float(sums[g.WORK])
        self._impulse[0] += sums[g.IMPULSE_X]
        self._impulse[1] += sums[g.IMPULSE_Y]
        self._largest_kinetic = max(self._largest_kinetic, self._kinetic)
        self._largest_work = max(self._largest_work, abs(self._external))
        if marks[g.FAULT]:
            p = marks[g.POINT]
            place = f"the material point of ({q.X[p, 0]:.4g}, {q.X[p, 1]:.4g}) m, now at ({q.x[p, 0]:.4g}, {q.x[p, 1]:.4g}) m,"
            if marks[g.FAULT] == g.ESCAPED:
                raise Breakdown("volume", f"{place} left the background grid at t = {self._now:.4g}")
            raise Breakdown("tangle", f"{place} is turned inside out (det F <= 0) at t = {self._now:.4g}")
        if not sums[g.SPEED2] <= (10.0 * self.wave_speed) ** 2:  # nan fails too
            raise Breakdown("cfl", f"a material point is faster than ten wave speeds at t = {self._now:.4g}")
        growth = self._kinetic + self._internal - self._external - self._energy_at_start
        if growth > self._energy_at_start + self._largest_work:
            raise Breakdown("energy", f"more than twice the energy put in is there at t = {self._now:.4g}")
        self._crossed += int(marks[g.CROSSED])
        if self._crossed > self.sort_after * len(q.id) >= self.sort_after * WORTH_SORTING:
            with phase("sort"):
                q.sort(self.grid.lattice)
            self._crossed = 0

    def _compile(self) -> None:
        """Run the kernels over no points, so that their compilation belongs to the set-up."""
        q, none = self.points, slice(0, 0)
        lattice, nodes, held = self.grid.lattice, self.grid.nodes, self.held.arrays
        settings = (self._body_force[none], lattice, nodes, held, self.least_mass, 1.0, (0.0, 0.0), self.damping, self.flip)
        sums, marks = self._sums.copy(), self._marks.copy()
        self._to_grid(q.at[none], q.x[none], q.v[none], q.mass[none], q.volume[none], q.tau[none], *settings, sums, marks)
        for deform, arrays, par, first in self._deform:
            deform(*(array[none] for array in arrays), par, lattice, nodes, 1.0, sums, marks, first)
        self._to_points(q.at[none], q.x[none], q.v[none], q.mass[none], *settings, sums, marks)

    def _box(self) -> None:
        """The box of cells that hold points."""
        cell = cells(self.points.at, self.grid.lattice)
        i, j = np.divmod(cell, self.grid.shape[1])
        self._marks[[g.I0, g.I1, g.J0, g.J1]] = i.min(), i.max(), j.min(), j.max()

    # --- what the model tells -----------------------------------------------------------------------------------------
    def probe(self, probe: Probe) -> float:
        """The value of a probe now; fields at a material point come from the plane through its nearest points."""
        q, c = self.points, probe.component
        if probe.quantity == "reaction":
            assert probe.of is not None
            return self.held.reaction(probe.of, c)
        if probe.quantity == "mean_velocity":
            return float(q.mass @ q.v[:, c]) / self._mass_at_start
        if probe.quantity == "displacement_error":
            assert probe.exact is not None
            error = (q.x - q.X).T - probe.exact(q.X.T, self.t)
            return math.sqrt(float(q.mass @ np.sum(error**2, axis=0)) / self._mass_at_start)
        assert probe.at is not None
        if probe.at not in self._around:
            self._around[probe.at] = q.around(probe.at)
        ids, weights = self._around[probe.at]
        near = q.place[ids]
        if probe.quantity == "displacement":
            return float(weights @ (q.x[near, c] - q.X[near, c]))
        if probe.quantity == "velocity":
            return float(weights @ q.v[near, c])
        return float(weights @ self._stress(near)[:, c]) if c < 4 else 0.0

    def _stress(self, points: Any = slice(None)) -> Array:
        """Cauchy stress (n, 4) of points: xx, yy, zz, xy (Pa)."""
        F, tau = self.points.F[points], self.points.tau[points]
        if self.scene.strain == "small":
            return tau
        return tau / ((F[:, 0] * F[:, 3] - F[:, 1] * F[:, 2]) * F[:, 4])[:, None]

    def energy(self) -> dict[str, float]:
        """Kinetic energy of the points, work of the stresses, and work of loads and supports since t = 0 (J per metre)."""
        return {"kinetic": self._kinetic, "internal": self._internal, "external": self._external}

    def checks(self) -> dict[str, float | None]:
        """Drift of the mass, and the momentum that no force accounts for against the largest there has been."""
        momentum = self.points.mass @ self.points.v - self._momentum_at_start - self._impulse
        scale = math.sqrt(2.0 * self._mass_at_start * self._largest_kinetic) or 1.0
        return {
            "mass": abs(float(self.points.mass.sum()) / self._mass_at_start - 1.0),
            "momentum": float(np.hypot(*momentum)) / scale,
            "volume": None,
        }

    def functions(self) -> list[Any]:
        return []

    def snapshot(self) -> dict[str, Any]:
        """Points where they are now, in the order in which they were seeded."""
        q = self.points
        order = q.place
        return {
            "points": np.column_stack([q.x[order], np.zeros(len(order))]),
            "cells": np.arange(len(order))[:, None],
            "cell": "vertex",
            "displacement": (q.x - q.X)[order],
            "velocity": q.v[order],
            "stress": self._stress()[order],
        }

    def _active(self) -> tuple[int, int]:
        """Nodes that the points reach, and cells that hold points."""
        cell = np.unique(cells(self.points.at, self.grid.lattice))
        ny = self.grid.shape[1]
        return len(np.unique([cell, cell + 1, cell + ny, cell + ny + 1])), len(cell)

    def size(self) -> dict[str, int]:
        nodes, occupied = self._active()
        return {"dofs": 2 * nodes, "cells": occupied, "points": len(self.points.id)}

    def savings(self) -> dict[str, float]:
        """``active_grid``: nodes that the points reach, against all nodes of the grid."""
        return {"active_grid": self._active()[0] / len(self.grid.nodes)}

    # --- checkpoints --------------------------------------------------------------------------------------------------
    def state(self) -> dict[str, Array]:
        clock = [self.t, self._now, self._target, self._time, self._calm]
        balance = [self._kinetic, self._internal, self._external, self._largest_kinetic, self._largest_work]
        return {name: getattr(self.points, name).copy() for name in FIELDS} | {
            "clock": np.array(clock),
            "balance": np.array(balance),
            "impulse": self._impulse.copy(),
            "sums": self._sums.copy(),
            "crossed": np.array(self._crossed),
            "work": np.array([self.work["steps"], self.work["point_steps"]]),
        }

    def restore(self, state: dict[str, Array]) -> None:
        for name in FIELDS:
            getattr(self.points, name)[:] = state[name]
        self.points.place[self.points.id] = np.arange(len(self.points.id))
        self.t, self._now, self._target, self._time, self._calm = state["clock"].tolist()
        self._kinetic, self._internal, self._external, self._largest_kinetic, self._largest_work = state["balance"].tolist()
        self._impulse[:] = state["impulse"]
        self._sums[:] = state["sums"]
        self._crossed = int(state["crossed"])
        self.work["steps"], self.work["point_steps"] = state["work"].tolist()
        self._marks[:] = 0
        self.grid.nodes[:] = 0.0
        self._box()
