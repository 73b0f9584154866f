"""The explicit material point method as a model of a scene: steps, balances, and what a run asks of it."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from geofem import materials
from geofem.cost import phase
from geofem.methods.mpm import answers, setting
from geofem.methods.mpm import grid as g
from geofem.methods.mpm.background import Background
from geofem.methods.mpm.base import PointModel
from geofem.methods.mpm.conditions import Held, Walls
from geofem.methods.mpm.kind import Kind
from geofem.methods.mpm.stepper import Stepper
from geofem.methods.mpm.timestep import NodalStep
from geofem.mistake import Breakdown
from geofem.scene import Array, Scene

LEAST_MASS = 1e-12
"""Nodes with less than this share of a point's mass are left out: their velocity would be rounding."""
WORTH_SORTING = 20_000
"""Fewer points than this fit into a processor's cache in any order."""
RAMP = 5.0
"""Passages of a wave through the body in which a load is raised; the slowest axial mode takes four for one swing."""
SAMPLES = 200
"""Load steps of a load that is pushed on steadily: they cost nothing, and the run is sampled between them."""
SOUND = 8
"""Steps between two looks at the speed of waves in what a material that stiffens has become."""
TURN = 10_000_000
"""Point steps, about a second, after which a scene without inertia gives the run a turn."""
UNREST = 0.5
"""Nodal forces out of balance, against the reactions, with which a body that does not move is not at rest: where points have
crossed cells, local damping can hold it by the noise. What is left of that noise at a true rest is below 0.4."""
PATIENCE = 400
"""A load step that has not come to rest after so many passages of a wave through the body has failed."""
TOO_FAST = 10.0
"""A speed of so many times that of a wave and the largest at the start together is no motion, but a step that is too long."""


class ExplicitMpm(PointModel):
    """Material points on a background grid; see ``Mpm.build`` for the knobs.

    A scene without inertia is solved by dynamic relaxation: the load rises smoothly in a time of its own, and damped steps go
    on until the body is at rest; ``t`` is the last load at which it was. With ``passages`` it is pushed on steadily instead.
    """

    def __init__(self, scene: Scene, *, shape: str, n: int, ppc: int, transfer: str, flip: float, order: int, scheme: str,
                 cfl: float, damping: float, small_mass: float, cure: bool, split: float, load_steps: int, passages: float | None,
                 tolerance: float, sort_after: float, threads: int, dt_control: str):  # fmt: skip
        loaded = bool(scene.rigids) or any(load.kind == "body" for load in scene.loads)
        spent = any(materials.get(region.material.law).energy is None for region in scene.regions)
        kind = Kind(
            shape, scene.gdim, scene.plane == "axisymmetric", scene.strain == "small", scheme, transfer, loaded, spent, cure
        )
        super().__init__(scene, kind, scene.length / n, ppc, split)
        self._now = 0.0
        self._target, self._time, self._calm = 0.0, 0.0, -1.0  # of the load that is being raised: calm >= 0
        self.work = {"steps": 0, "newton": 0, "linear": 0, "point_steps": 0, "remeshes": 0}
        self.cfl, self.order = cfl, order
        self.load_steps, self.passages, self.tolerance, self.sort_after = load_steps, passages, tolerance, sort_after
        self._nodal = NodalStep(self.kind) if dt_control == "nodal" else None
        self._set_off()
        wave_speed = max(self._speeds)
        low, high = g.bodies(scene, self._bounds)
        self._sounds = self._speeds_of_waves()
        self.passage = float(np.linalg.norm(high - low)) / wave_speed
        point_mass = self.mass / sum(body.n for body in self.bodies)
        self.stepper = Stepper(
            self.grid, self.bodies, self.kind, flip=flip, order=order, damping=damping, least_mass=LEAST_MASS * point_mass,
            small_mass=small_mass * point_mass, threads=threads,
        )  # fmt: skip
        self.balance = answers.Balance(self.bodies, self.mass, spent, scheme == "usf")
        self._gravity = [load for load in scene.loads if load.kind == "gravity"]
        self._body_loads = [load for load in scene.loads if load.kind == "body"]
        self._strayed = 0.0
        self._fastest = self._largest_speed()
        self._too_fast = TOO_FAST * (wave_speed + math.sqrt(self._fastest))
        self._unbalance = self._reactions = self._last_dt = 0.0
        self._divide()
        self.stepper.compile()

    def _set_off(self) -> None:
        """Initial velocities of the points, and with apic their gradients (by differences)."""
        velocity = self.scene.initial_velocity
        for body in self.bodies:
            if velocity is None:
                continue
            X = body.own("X")
            body.own("v")[:] = np.broadcast_to(np.asarray(velocity(X.T), float).T, X.shape)
            if self.kind.transfer == "apic":
                d, e = X.shape[1], 1e-5 * self.h
                for c in range(d):
                    step = np.zeros(d)
                    step[c] = e
                    after, before = (np.broadcast_to(np.asarray(velocity((X + s * step).T), float).T, X.shape) for s in (1, -1))
                    body.own("C").reshape(-1, d, d)[:, :, c] = (after - before) / (2 * e)

    @property
    def _speeds(self) -> list[float]:
        return [body.law.wave_speed(body.par, region.material.density) for body, region in zip(self.bodies, self.scene.regions)]

    def _speeds_of_waves(self) -> list[float]:
        """The largest speed of compression waves in each body as it is now (m/s). Collective."""
        speeds = np.array(self._speeds)
        for k, (body, region) in enumerate(zip(self.bodies, self.scene.regions)):
            if not self.kind.small and body.law.stretched_speed is not None and body.n:
                speeds[k] = max(speeds[k], body.law.stretched_speed(body.own("F"), body.par, region.material.density))
        return np.max(self.comm.allgather(speeds), axis=0).tolist()

    def _largest_speed(self) -> float:
        """The largest squared speed of a point on any rank."""
        largest = max((float(np.max(np.sum(b.own("v") ** 2, axis=1), initial=0.0)) for b in self.bodies), default=0.0)
        return self.comm.allreduce(largest, op=MPI.MAX)

    # --- ranks --------------------------------------------------------------------------------------------------------
    def _lay_out(self, last: int) -> None:
        """The nodes' arrays of the window that ends before the row ``last``, and the conditions on them."""
        per_row = int(np.prod(self.grid.shape[1:]))
        count = (last - self.grid.first) * per_row
        self.stepper.lay_out(count)
        coordinates = g.on_edges(self.grid.coordinates(), self._bounds, self.h)
        row = self.grid.first + np.arange(count) // per_row
        mine = (row >= self.grid.own[0]) & (row < self.grid.own[1])
        self.stepper.held, self.stepper.walls = Held(self.scene, coordinates, mine), Walls(self.scene, coordinates, mine)

    def _halo(self) -> int:
        """Cells around a slab whose points can bear on its points within a step.

        A point hears from nodes within its reach, and these from points within theirs; each stage of a step widens this once.
        """
        stages = 1 + (self.kind.scheme != "usl") + (self.order - 1 if self.kind.transfer == "xpic" else 0)
        reach = 1 + math.ceil(self._extent() if self.shape.spread else self.shape.reach)
        return stages * (2 * reach + 1) + (2 if self.kind.cure else 0) + (2 if self.stepper.small_mass > 0 else 0) + 1

    def _exchange(self) -> None:
        super()._exchange()
        self.stepper.share_points()

    # --- steps --------------------------------------------------------------------------------------------------------
    def dt(self) -> float:
        """The stable step (s), or the share of the scene's load that is next."""
        if self.scene.dynamic:
            return self._courant()
        return self.scene.t_end / (self.load_steps if self.passages is None else max(self.load_steps, SAMPLES))

    def step(self, dt: float) -> None:
        """One explicit step; in a scene without inertia many of them, of which only the last one moves ``t``.

        Raises ``Breakdown``: ``tangle`` (det F <= 0 at a point), ``volume`` (a point left the grid), ``cfl`` (velocities
        beyond all measure: see ``TOO_FAST``), ``energy`` (twice the energy that was ever put in), ``newton`` (no rest under a load),
        ``fracture`` (a body that is to stay whole fell apart).
        """
        if self.scene.dynamic:
            dt = min(dt, self._courant())
            self._advance(dt, self.t + dt)
            self.t = self._now
        elif self.passages is not None:
            self._push(dt)
        else:
            self._relax(dt)

    def _courant(self) -> float:
        wave = max(self._sounds) if self._nodal is None else 0.5 * self.h * self._nodal.frequency(self)
        return self.cfl * self.h / (wave + math.sqrt(self._fastest))

    def _push(self, dt: float) -> None:
        """Raise the load by dt at a steady rate: the whole of it takes ``passages`` passages of a wave through the body."""
        assert self.passages is not None
        rate = self.scene.t_end / (self.passages * self.passage)
        target = self.t + dt
        while self._now < target - 1e-12 * self.scene.t_end:
            h = self._courant()
            self._advance(h, min(target, self._now + h * rate))
        self.t = target

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
            balanced = self._unbalance <= UNREST * self._reactions
            quiet = s == 1.0 and balanced and self.balance.kinetic <= self.tolerance * abs(self.balance.external)
            self._calm = self._calm + h if quiet else 0.0
            if self._calm >= self.passage:
                self.t, self._calm = self._target, -1.0
                return
            if self._time > PATIENCE * self.passage:
                raise Breakdown(
                    "newton", f"no rest under the load of t = {self._target:.4g}: kinetic energy {self.balance.kinetic:.3g} J"
                )

    def _advance(self, dt: float, t1: float) -> None:
        """One explicit step of dt (s) that ends at the scene's time t1.

        Velocities belong to the middles of steps, so that forces act from the middle of the last step to that of this one, and at
        first for half a step: second order in time for steps of any length.
        """
        if self.scene.dynamic:
            self.stepper.ratio = 0.5 * (1.0 + self._last_dt / dt)
        gravity = self._loads(dt, t1)
        self.stepper.step(dt, gravity)
        self._last_dt, self._now = dt, t1
        self._account(dt)

    def _loads(self, dt: float, t1: float) -> tuple[float, float, float]:
        """Supports, rigid bodies, strength and forces of the points for this step; returns the acceleration of gravity (m/s2)."""
        scene, now = self.scene, self._now
        gravity = np.zeros(3)
        for load in self._gravity:
            gravity[: scene.gdim] += scene.amplitude(load, now) * np.array(load.value)
        self.stepper.held.follow(now, t1, dt)
        if scene.weakening is not None:
            for body, region in zip(self.bodies, scene.regions):
                body.par[:] = body.law.parameters(region.material, scene.weakening(now))
        self._impulse = np.zeros(3)
        if self.kind.loaded:
            for contact in self._contacts:
                contact.follow(now, t1, dt)
                contact.force[:] = 0.0
            for body, region, speed in zip(self.bodies, scene.regions, self._speeds):
                force = body.force[: body.N]
                force[:] = 0.0
                for load in self._body_loads:
                    value = np.asarray(load.value(body.arrays["X"][: body.N].T, now)).T
                    force += scene.amplitude(load, now) * body.arrays["mass"][: body.N, None] * value
                for contact in self._contacts:
                    contact.force += contact.touch(body, region.material.density * speed**2 / self.h, self.h, dt)
                self._impulse[: scene.gdim] += self.stepper.ratio * dt * force[: body.n].sum(axis=0)
        return float(gravity[0]), float(gravity[1]), float(gravity[2])

    # --- after a step -------------------------------------------------------------------------------------------------
    def _account(self, dt: float) -> None:
        """Carry the balances on, look for faults, hand points over, and sort them when they have strayed. Collective."""
        sums = self.stepper.sums()
        sums[g.IMPULSE : g.IMPULSE + 3] += self._impulse
        fault = self.stepper.fault(self._now)
        if self.comm.size > 1:
            with phase("exchange"):
                told = self.comm.allgather((sums, fault))
            sums = np.sum([s for s, _ in told], axis=0)
            sums[g.SPEED2] = max(s[g.SPEED2] for s, _ in told)
            fault = next((f for _, f in told if f), None)
        self.work["steps"] += 1
        self.work["point_steps"] += self._total
        self._fastest, self._unbalance, self._reactions = sums[g.SPEED2], sums[g.UNBALANCE], sums[g.REACTIONS]
        self.balance.add(sums)
        if fault:
            raise Breakdown(*fault)
        if not self._fastest <= self._too_fast**2:  # nan fails too
            raise Breakdown("cfl", f"a material point is faster than {self._too_fast:.4g} m/s at t = {self._now:.4g}")
        if self.balance.exploded:
            raise Breakdown("energy", f"more than twice the energy put in is there at t = {self._now:.4g}")
        for body in self.bodies:
            body.settle()
        if self.work["steps"] % SOUND == 0:
            self._sounds = self._speeds_of_waves()
        moved = math.sqrt(self._fastest) * dt / self.h
        changed = self.splitter.check(self.bodies, self.h, moved, self.comm)
        self._strayed += dt * math.sqrt(2.0 * self.balance.kinetic / self.balance.mass) / self.h
        if changed or (self._strayed > self.sort_after and self._total >= WORTH_SORTING):
            with phase("sort"):
                for body in self.bodies:
                    body.N = body.n
                    body.sort(setting.cells_of(body, self.grid))
                    body.make_room(body.N)
            self._strayed = 0.0
        if changed or self.comm.size > 1:
            self._exchange()
        self.watch.look(self, moved)

    @property
    def _total(self) -> int:
        """Points on all ranks; splitting is the only thing that changes it."""
        return self.splitter.total or self._count()

    def _count(self) -> int:
        self.splitter.total = self.comm.allreduce(sum(body.n for body in self.bodies))
        return self.splitter.total

    # --- what the model tells -----------------------------------------------------------------------------------------
    def _nodal_reaction(self, name: str, component: int) -> float:
        return self.stepper.held.reaction(name, component) + self.stepper.walls.reaction(name, component)

    def energy(self) -> dict[str, float]:
        """Kinetic energy of the points, stored energy or else work of the stresses, and work of loads and supports since t = 0 (J per
        metre), at one instant. Collective."""
        balance = self.balance
        if balance.spent:
            return balance.energy()
        # the change of the nodes' kinetic energy in the last step is the work done on them, less that which the stresses took
        gained = self.comm.allreduce(self.stepper.gained(self._last_dt))
        return balance.energy(balance.stored(self.bodies, self.comm), balance.last[2] - gained)

    def checks(self) -> dict[str, float | None]:
        """Drift of the mass, the momentum that no force accounts for against the largest there has been, and drift of the volume."""
        return self.balance.checks(self.bodies, self.comm)

    def functions(self) -> list[fem.Function]:
        """The velocity that the points give the background grid."""
        mesh, velocity = self._grid_mesh
        mesh.fill(velocity, self.stepper.velocity())
        return [velocity]

    @cached_property
    def _grid_mesh(self) -> tuple[Background, fem.Function]:
        mesh = Background(self.grid, self.slabs, self.comm)
        space = fem.functionspace(mesh.mesh, ("Lagrange", 1, (self.grid.dim,)))
        return mesh, fem.Function(space, name="velocity")

    def size(self) -> dict[str, int]:
        nodes, occupied = self._active()
        return {"dofs": self.grid.dim * nodes, "cells": occupied, "points": self._total}

    def savings(self) -> dict[str, float]:
        """``active_grid``: nodes that the points reach, against all nodes of the grid."""
        return {"active_grid": self._active()[0] / int(np.prod(self.grid.shape))}

    def _active(self) -> tuple[int, int]:
        """Nodes that the points reach, and cells that hold points, on all ranks."""
        per_row = int(np.prod(self.grid.shape[1:]))
        a, b = (row * per_row - self.grid.first * per_row for row in self.grid.own)
        reached = int(np.count_nonzero(self.grid.nodes[max(a, 0) : b, g.MASS]))
        occupied = len(np.unique(np.concatenate([setting.cells_of(body, self.grid) for body in self.bodies])))
        return self.comm.allreduce(reached), self.comm.allreduce(occupied)

    # --- checkpoints --------------------------------------------------------------------------------------------------
    def state(self) -> dict[str, Array]:
        """All that a checkpoint must hold, on rank 0. Collective."""
        return setting.gather(self.comm, self.bodies) | {
            "clock": np.array([self.t, self._now, self._target, self._time, self._calm]),
            "balance": self.balance.state(),
            "last": np.array(
                [self._fastest, self._unbalance, self._reactions, self._strayed, self._last_dt, self.stepper.ratio]
                + [*self.splitter.state(), *self.watch.state()]
            ),  # fmt: skip
            "sounds": np.array(self._sounds),
            "work": np.array([self.work["steps"], self.work["point_steps"]]),
        }

    def restore(self, state: dict[str, Array]) -> None:
        """Take up what ``state`` gave, on any number of ranks. Collective."""
        setting.scatter(state, self.bodies, self.grid, self.slabs)
        self.t, self._now, self._target, self._time, self._calm = state["clock"].tolist()
        self.balance.restore(state["balance"])
        self._fastest, self._unbalance, self._reactions, self._strayed, *last = state["last"].tolist()
        self._sounds = state["sounds"].tolist()
        self._last_dt, self.stepper.ratio, split, *watch = last
        self.splitter.restore(split)
        self.watch.restore(*watch)
        self.work["steps"], self.work["point_steps"] = state["work"].tolist()
        self.splitter.total = 0
        self.grid.nodes[:] = 0.0
        self._exchange()
