"""The particle finite element method for fluids as a model of a scene: steps, remeshing in between, and what a run asks of it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from mpi4py import MPI

from geofem.core.mpi import on_root
from geofem.cost import phase
from geofem.methods.pfem import answers
from geofem.methods.pfem.budget import KINDS, OPEN, Budget, half_square, lumped, node_volumes, volumes
from geofem.methods.pfem.cloud import Cloud
from geofem.methods.pfem.contact import Contact
from geofem.methods.pfem.flow import CONFIGURATIONS, Flow, Scheme
from geofem.methods.pfem.openings import fill, leaving, let_in
from geofem.methods.pfem.particles import beside_walls
from geofem.methods.pfem.resample import needs, remesh
from geofem.methods.pfem.surface import Rules
from geofem.methods.pfem.tessellation import Tessellation, Tessellator
from geofem.methods.pfem.tessellation.alpha import AlphaShape
from geofem.mistake import Breakdown
from geofem.scene import Array, Probe, Scene

GROW = 1.5
"""A step is longer than the one before by this factor at most, once steps had to be cut."""
SMALLEST = 1e-3
"""A step is cut no further than to this fraction of what the CFL number allows."""
RIPPLE = 0.5
"""Share of the time of the shortest ripple of surface tension (Brackbill, Kothe and Zemach 1992, J. Comput. Phys. 100:335-354)."""
FLAT = 0.02
"""A step is cut where it would leave less than this part of the volume of a cell."""


class FluidModel:
    """A fluid whose nodes are the material; see ``Pfem.build`` for the knobs.

    Nodes and cells are the same on every rank; geometry is made on rank 0, the equations are solved by all.
    """

    def __init__(self, scene: Scene, cloud: Cloud, mesh: Tessellation, tessellator: Tessellator, scheme: Scheme, rules: Rules,
                 cfl: float, dt: float, obstacles: Contact):  # fmt: skip
        self.scene, self.cloud, self.mesh, self.tessellator, self.rules = scene, cloud, mesh, tessellator, rules
        self.comm = MPI.COMM_WORLD
        self.cfl, self._longest = cfl, dt
        self.scheme = scheme
        self.flow = Flow(self.comm, scene, scheme)
        self.obstacles = obstacles
        self.t, self._limit = 0.0, math.inf
        self.work = {"steps": 0, "newton": 0, "linear": 0, "remeshes": 0, "cuts": 0, "factorisations": 0, "meshes": 0}
        if scene.initial_velocity is not None:
            cloud.v[:] = scene.initial_velocity(cloud.X.T).T
        self.budget = Budget(self.flow.gravity(0.0))
        self.budget.jolted = fill(cloud, obstacles)
        self._stale = True
        self.kept = not isinstance(tessellator, AlphaShape)
        """Whether the boundary is that of the step before; an alpha shape finds it anew in every step."""
        self.budget.look(cloud, mesh.cells)
        self.start = self.budget.now
        self._worst = 0.0
        self._energy = {"internal": 0.0, "external": 0.0}
        self.impulse = np.zeros(scene.gdim)
        self._reactions = np.zeros((len(obstacles.names), scene.gdim))
        """Forces of the obstacles on the nodes in the last step (N)."""
        self._pushed = self.flow.density * math.sqrt(2 * self.start.volume * self.start.kinetic)
        """Sizes of all impulses of gravity and of the first momentum (N s), the scale of what ought to be nought."""
        self._places = answers.Places(scene, cloud, mesh.cells)

    # --- the step -------------------------------------------------------------------------------------------------
    def dt(self) -> float:
        """The step in which no node goes further than ``cfl`` spacings, at its speed and falling freely."""
        gravity = float(np.linalg.norm(self.flow.gravity(self.t)))
        speed = np.linalg.norm(self.cloud.v, axis=1)
        way = self.cfl * self.cloud.size
        fall = (-speed + np.sqrt(speed**2 + 2 * gravity * way)) / gravity if gravity > 0 else way / np.maximum(speed, 1e-300)
        limit = float(fall.min())
        if self.flow.tension:
            ripple = self.flow.density * float(self.cloud.size.min()) ** 3 / (2 * math.pi * self.flow.tension)
            limit = min(limit, RIPPLE * math.sqrt(ripple))
        return min(limit, self._longest, self._limit)

    def step(self, dt: float) -> None:
        """Advance by dt, or by less where cells would turn over. Raises ``Breakdown`` with the last good state kept."""
        first = dt
        while True:
            try:
                self._advance(dt)
                break
            except Breakdown as end:
                self.work["cuts"] += 1
                dt *= 0.5
                if dt < SMALLEST * first:
                    raise Breakdown(end.cause, f"{end}; at t = {self.t:.4g}, after cutting the step to {dt:.1e} s") from None
        self.t += dt
        self.work["steps"] += 1
        self._limit = GROW * dt if dt < first or self._limit < math.inf else math.inf
        if self._limit >= self._longest:
            self._limit = math.inf
        self._retessellate(dt)

    def _advance(self, dt: float) -> None:
        """Solve for a step, and move the nodes if no cell turns over. Collective."""
        cloud, mesh = self.cloud, self.mesh
        if self._stale:
            self.flow.renew(cloud.x, mesh if self.comm.rank == 0 else None)
            self.work["meshes"] += 1
            self._stale = False
        self.obstacles.follow(self.t, dt)
        # Velocities that jumped are not solenoidal; theta = 1/2 would carry that on with alternating sign.
        self.flow.scheme = replace(self.scheme, theta=1.0) if self.budget.jolted else self.scheme
        u, p = self.flow.solve(cloud, mesh, self.obstacles, self.t, dt)
        for name, counted in (
            ("newton", self.flow.iterations),
            ("linear", self.flow.linear),
            ("factorisations", self.flow.factorisations),
        ):
            self.work[name] = counted
        with phase("move"):
            before = volumes(cloud.x, mesh.cells)
            after = volumes(cloud.x + dt * u, mesh.cells)
            if (after <= FLAT * np.minimum(before, np.mean(before))).any():
                raise Breakdown("tangle", f"a cell would keep {float((after / before).min()):.2g} of its volume in a step")
            self._move(dt, u, p)

    def _move(self, dt: float, u: Array, p: Array) -> None:
        """Take the velocities and pressures at t + theta dt, and keep the books."""
        cloud, mesh, theta = self.cloud, self.mesh, self.flow.scheme.theta
        gravity = self.flow.gravity(self.t + theta * dt)
        flying = np.bincount(mesh.cells.ravel(), minlength=cloud.n) == 0
        if "fixed" in cloud.fields:
            flying &= cloud.fields["fixed"] < 0.5
        new = cloud.v + (u - cloud.v) / theta
        way = CONFIGURATIONS[self.scheme.configuration]
        middle = cloud.x + way * dt * u
        mass = self.flow.density * node_volumes(middle, mesh.cells)
        # what theta above 1/2 damps: (v1 - v0).u is the change of v.v / 2 and (theta - 1/2) |v1 - v0|^2
        damped = (2 * theta - 1) * half_square(new - cloud.v, mesh.cells, volumes(middle, mesh.cells))
        self._energy["internal"] += dt * self.flow.power() + self.flow.density * damped
        pushed = self.flow.reaction + self.flow.traction
        self._reactions = answers.reactions(self.flow.touch, len(self.obstacles.names), self.flow.reaction)
        work = float((mass[:, None] * gravity * u).sum()) + float((pushed * u).sum())
        flown = self.flow.density * cloud.carried
        fall = cloud.v * dt + 0.5 * dt * dt * gravity
        self._energy["external"] += dt * work + float((flown[:, None] * fall * gravity).sum())
        self._pushed += dt * float((mass + flown).sum()) * float(np.linalg.norm(gravity))
        self.impulse += dt * ((mass + flown).sum() * gravity + pushed.sum(axis=0))
        cloud.x = np.where(flying[:, None], cloud.x + fall, cloud.x + dt * u)
        cloud.v = np.where(flying[:, None], cloud.v + dt * gravity, new)
        cloud.p = np.where(flying, 0.0, cloud.p + (p - cloud.p) / theta if self.scheme.compressible else p)
        self.budget.jolted = False
        self.budget.book("lagrangian", self.budget.look(cloud, mesh.cells))

    def _retessellate(self, dt: float) -> None:
        """Obstacles, and new nodes and cells where the mesh asks for it. Collective."""
        with phase("contact"):
            self.obstacles.follow(self.t, dt)
            self.obstacles.release(self.cloud, self.flow.reaction, self.mesh.cells, self.budget)
            self.obstacles.clip(self.cloud, self.mesh.cells, self.budget)
            let_in(self.cloud, self.mesh, self.obstacles, self.t, self.budget)
        ids = self.cloud.id
        with phase("remesh"):
            made = on_root(self.comm, lambda: self._remesh(dt))
            if self.comm.size > 1:
                self.cloud, self.budget, made = self.comm.bcast(
                    (self.cloud, self.budget, made) if self.comm.rank == 0 else None
                )
        if made is not None:
            # what flies away or comes back may change the numbers of the nodes and no cell
            same = np.array_equal(made.cells, self.mesh.cells) and np.array_equal(ids, self.cloud.id)
            self.mesh, self._stale = made, not same
            self.work["remeshes"] += 1
        self._worst = max(self._worst, self._drift(), key=abs)

    def _drift(self) -> float:
        """Volume that was made, by that of the start."""
        return (self.budget.now.volume - self.budget.passed().volume) / self.start.volume - 1.0

    def _remesh(self, dt: float) -> Tessellation | None:
        if (
            self.kept
            and not leaving(self.cloud, self.obstacles)
            and not needs(self.cloud, self.mesh, self.rules, self.budget, dt)
        ):
            return None
        made = remesh(self.cloud, self.mesh, self.obstacles, self.tessellator, self.rules, self.budget, dt)
        if "fixed" in self.cloud.fields:
            made = beside_walls(made, self.cloud)
            self.budget.book("resample", self.budget.look(self.cloud, made.cells))
        return made

    # --- what the runner asks -------------------------------------------------------------------------------------
    def probe(self, probe: Probe) -> float:
        """The sampled number of a probe; see ``Probe`` for the quantities."""
        if probe.quantity == "reaction":
            return float(self._reactions[self.obstacles.names.index(str(probe.of)), probe.component])
        if probe.quantity in OPEN:
            return abs(self.budget.of[probe.quantity].volume)
        cloud, volume = self.cloud, lumped(self.cloud, self.mesh.cells)
        if probe.quantity == "volume":
            return float(volume.sum())
        if probe.quantity == "pressure_error":
            assert probe.exact is not None
            return math.sqrt(volume @ (cloud.p - probe.exact(cloud.x.T, self.t)) ** 2 / volume.sum())
        return self._places.probe(probe, cloud, volume, self.t, -cloud.p[:, None] * np.array([1.0, 1, 1, 0, 0, 0]))

    def _taken(self) -> dict[str, float]:
        """Kinetic energy (J) that each kind of change between the steps took: inelastic impacts, and nodes made anew."""
        return {kind: -self.flow.density * self.budget.of[kind].kinetic for kind in KINDS if kind not in ("lagrangian", *OPEN)}

    def _put_in(self) -> float:
        """Work of gravity, of what moves and of what is beyond outlets, and the kinetic energy that came in less what left (J)."""
        return self._energy["external"] + self.flow.density * self.budget.passed().kinetic

    def energy(self) -> dict[str, float]:
        """Kinetic energy; ``internal``: heat of viscosity, of the stabilisation and of impacts, and the energy of the surface;
        ``external``: work of gravity, of what moves and of outlets' tractions, and what comes in less what leaves."""
        kinetic = self.flow.density * self.budget.now.kinetic
        heat, work = self._energy["internal"] + sum(self._taken().values()), self._put_in()
        surface = answers.surface(self.cloud.x, self.mesh.facets) if self.flow.tension else 0.0
        return {"kinetic": kinetic, "internal": heat + self.flow.tension * surface, "external": work}

    def checks(self) -> dict[str, float | None]:
        """Relative drifts: ``volume`` of the mesh and of what flies, the largest so far; ``momentum`` less all impulses.

        ``volume_`` and ``energy_`` with a kind of change: what it made in volume, and took of the energy that was put in.
        """
        now = self.budget.now
        put_in = self.flow.density * self.start.kinetic + abs(self._put_in())
        drift = self._drift()
        lost = self.flow.density * (now.momentum - self.start.momentum) - self.impulse
        for kind in ("wall", "resample", *OPEN):
            # what obstacles took when nodes were put on them, and from nodes that were made anew on them
            lost -= self.flow.density * self.budget.of[kind].momentum
        momentum = float(np.linalg.norm(lost)) / self._pushed if self._pushed > 0 and self.scheme.element == "p1p1" else None
        made = {f"volume_{kind}": self.budget.of[kind].volume / self.start.volume for kind in KINDS if kind not in OPEN}
        taken = {f"energy_{kind}": energy / put_in for kind, energy in self._taken().items()} if put_in > 0 else {}
        return {"mass": drift, "momentum": momentum, "volume": self._worst, **made, **taken}

    def size(self) -> dict[str, int]:
        return {"dofs": (self.scene.gdim + 1) * self.cloud.n, "cells": len(self.mesh.cells), "points": self.cloud.n}

    def savings(self) -> dict[str, float]:
        """``meshes``: tessellations made, by steps."""
        return {"meshes": self.work["meshes"] / max(self.work["steps"], 1)}

    def functions(self) -> list[Any]:
        return []

    def snapshot(self) -> dict[str, Any]:
        if self.comm.rank:
            return {}
        cloud = self.cloud
        outlines = [rigid.corners + rigid.shift for rigid in self.obstacles.rigids]
        return answers.snapshot(cloud, self.mesh.cells, outlines) | {"pressure": cloud.p, "carried": cloud.carried}

    # --- checkpoints ----------------------------------------------------------------------------------------------
    def state(self) -> dict[str, Array]:
        numbers = [self.t, self._limit, self._worst, self._pushed, *self._energy.values(), *self.impulse]
        out = {"numbers": np.array(numbers), "work": np.array(list(self.work.values()), float)}
        out |= {"cells": self.mesh.cells, "facets": self.mesh.facets, "reactions": self._reactions}
        out |= answers.cloud_state(self.cloud) | answers.budget_state(self.budget)
        return out

    def restore(self, state: dict[str, Array]) -> None:
        self.t, self._limit, self._worst, self._pushed, internal, external, *impulse = state["numbers"].tolist()
        self._energy = {"internal": internal, "external": external}
        self.impulse = np.array(impulse)
        self.work = dict(zip(self.work, state["work"].astype(int).tolist()))
        self.flow.iterations, self.flow.linear, self.flow.factorisations = (
            self.work[k] for k in ("newton", "linear", "factorisations")
        )
        cells = state["cells"].astype(np.int64)
        self.mesh = Tessellation(cells, state["facets"].astype(np.int64), np.arange(len(cells)))
        self._reactions = state["reactions"]
        answers.restore_cloud(self.cloud, state)
        answers.restore_budget(self.budget, state)
        self.budget.look(self.cloud, self.mesh.cells)
        self._stale = True
