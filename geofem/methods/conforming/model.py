"""The model behind method ``fem`` for scenes with cracks, as the runner sees it: where they grow, each step has a mesh of its own."""

from __future__ import annotations

import gc
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from geofem.core.propagation import PROBED, End, Peak, Propagation
from geofem.methods.conforming.body import CrackedBody
from geofem.mistake import Breakdown, Mistake
from geofem.scene import Array, Crack, Growth, Probe, Scene

FORGET = 10
"""Remeshings after which what former meshes held is freed: a process has only some 2000 communicators."""


class ConformingModel:
    """A scene with cracks: the body with the present ones, and what was counted on the way to its state.

    Parameters
    ----------
    make : the body of a scene, meshed anew. da : way of the fastest tip in a step (m), where cracks grow.
    """

    def __init__(self, scene: Scene, make: Callable[[Scene], CrackedBody], da: float):
        self.scene, self._make, self._da = scene, make, da
        self.comm = MPI.COMM_WORLD
        self.cracked = make(scene)
        self.t = 0.0
        self._external = 0.0
        self._remeshes, self._steps = 0, 0
        self.propagation = Propagation(scene.growth or Growth(length=scene.length), self)
        if scene.growth is not None:
            self.cracked.balance_at(0.0)
            self._external = self.cracked.energy()["internal"]  # the load has risen to its size before t = 0
        self._factors: tuple[Array, Array] | None = None

    # --- cracks that grow, see ``geofem.core.propagation.Cracks`` ----------------------------------------------------
    def paths(self) -> list[Array]:
        return [np.array(crack.points, float) for crack in self.cracked.scene.cracks]

    def ends(self) -> list[End]:
        return [End(tip.crack, tip.last, tip.at, tip.axis) for tip in self.cracked.tips]

    def factors(self) -> tuple[Array, Array]:
        if self._factors is None:
            self._factors = self.cracked.factors()
        return self._factors

    def recut(self, paths: list[Array]) -> None:
        """Mesh the body along cracks in the place of the present ones, and balance the load anew; these stay if that fails.

        External work is counted for loads that do not change. Collective.
        """
        before = self.cracked
        cracks = tuple(Crack(tuple(map(tuple, path.tolist()))) for path in paths)
        try:
            after = self._make(replace(self.scene, cracks=cracks))
        except Mistake as mistake:
            raise Breakdown("tangle", str(mistake)) from None
        after.balance_at(self.t)
        self._external += after.load_work() - before.load_work()
        self.cracked, self._factors = after, None
        self._remeshes += 1
        if self._remeshes % FORGET == 0:
            del before
            gc.collect()
            PETSc.garbage_cleanup(self.comm)

    def walls(self) -> Array:
        return self.cracked.walls

    def peak(self, away: float) -> Peak | None:
        raise Mistake("fem lets no new cracks open; use xfem")

    # --- the step -------------------------------------------------------------------------------------------------
    def dt(self) -> float:
        return self._da if self.scene.growth is not None else self.cracked.dt()

    def step(self, dt: float) -> None:
        """Advance by dt. Raises ``Breakdown`` if the matrix is singular, or (arrest) where no crack grows any more."""
        if self.scene.growth is not None:
            self.t += self.propagation.step(dt)
        else:
            self._factors = None
            self.cracked.step(dt)
            self.t, self._external = self.cracked.t, self.cracked.energy()["external"]
        self._steps += 1

    @property
    def work(self) -> dict[str, int]:
        return {"steps": self._steps, "remeshes": self._remeshes}

    # --- what the runner asks -------------------------------------------------------------------------------------
    def probe(self, probe: Probe) -> float:
        """The sampled number of a probe; see ``Probe`` for the quantities."""
        if probe.quantity in PROBED:
            return self.propagation.probe(probe)
        return self.cracked.probe(probe)

    def energy(self) -> dict[str, float]:
        return self.cracked.energy() | {"external": self._external}

    def checks(self) -> dict[str, float | None]:
        return self.cracked.checks()

    def size(self) -> dict[str, int]:
        return self.cracked.size()

    def savings(self) -> dict[str, float]:
        return {}

    def snapshot(self) -> dict[str, Any]:
        return self.cracked.snapshot()

    def functions(self) -> list[fem.Function]:
        return [] if self.scene.growth is not None else self.cracked.functions()

    def state(self) -> dict[str, np.ndarray]:
        """The time, the work done and the cracks: a linear body without memory is solved anew when a run is resumed."""
        paths = self.paths()
        numbers = [self.t, self._external, self._steps, self._remeshes, self.propagation.cycles]
        start = np.cumsum([0, *map(len, paths)])
        return {"numbers": np.array(numbers), "points": np.concatenate(paths), "start": start}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        t, external, steps, remeshes, self.propagation.cycles = state["numbers"].tolist()
        self.t = t
        if self.scene.growth is not None:
            start = state["start"]
            self.recut([state["points"][a:b] for a, b in zip(start, start[1:])])
        else:
            self.cracked.balance_at(t)
            self._factors = None
        self._external, self._steps, self._remeshes = external, int(steps), int(remeshes)
