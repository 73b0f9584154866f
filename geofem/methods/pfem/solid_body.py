"""The bodies as nodes and triangles: their smoothing domains, the history at them, masses, supports and loads.

All of it is the same on every rank. A rank lets the material answer on its share of the domains, and the answers are exchanged.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from geofem.cost import phase
from geofem.methods.pfem import answers, solid_domains
from geofem.methods.pfem.cloud import Cloud
from geofem.methods.pfem.solid_laws import Answer, History, Laws
from geofem.methods.pfem.solid_system import System, gathered, share
from geofem.methods.pfem.tessellation import simplices
from geofem.mistake import Mistake
from geofem.scene import Array, Scene

STATES = ("nodal", "points")


class Body:
    """Nodes, triangles and what the material remembers.

    state : ``nodal``, domains and history around nodes; ``points``, in the triangles. cured : of triangles, the volume change is averaged.
    stabilisation : share of the elastic shear stiffness with which triangles resist where they differ from the domains of their
        nodes, anew in each step; it holds the modes of which the domains around nodes feel next to nothing.
    """

    def __init__(
        self, scene: Scene, cloud: Cloud, cells: Array, state: str, cured: bool, stabilisation: float, comm: MPI.Intracomm
    ):
        self.scene, self.cloud, self.comm = scene, cloud, comm
        self.nodal, self.cured, self.stabilisation = state == "nodal", cured, stabilisation
        self.laws = Laws(scene)
        self.small = self.laws.small
        self.cells, self.facets = cells, simplices.boundary(cells, simplices.neighbours(cells))
        at_rest = History.at_rest(cloud.region if self.nodal else cloud.region[cells[:, 0]])
        self.history = at_rest
        self._system: System | None = None
        self.configure()
        self.start = {"volume": self.volume()}
        self.mass = self.lumped()
        self.start["mass"] = float(self.mass.sum())

    # --- geometry -----------------------------------------------------------------------------------------------------
    @property
    def geometry(self) -> Array:
        """Where the domains are taken from, (n, 2)."""
        return self.cloud.X if self.small else self.cloud.x

    def configure(self) -> None:
        """Take the domains from the nodes as they are now."""
        with phase("domains"):
            x = self.geometry
            self.triangles = solid_domains.of_cells(x, self.cells, False)
            if self.nodal:
                self.domains = solid_domains.of_nodes(x, self.cells)
            else:
                self.domains = solid_domains.of_cells(x, self.cells, True) if self.cured else self.triangles
            steady = 2.0 * self.laws.lame[:, 1] * self.stabilisation
            self._hold = deviatoric(steady)

    def renew(self, cells: Array, facets: Array, history: History, mass: Array) -> None:
        """Take other cells, on nodes that may be others, with their history and masses (n,) (kg/m)."""
        self.cells, self.facets, self.history, self.mass = cells, facets, history, mass
        if self._system is not None:
            self._system.destroy()
            self._system = None
        self.configure()

    @property
    def system(self) -> System:
        """The linear system of the present cells."""
        if self._system is None:
            self._system = System(self.cloud.n, self.domains, self.comm)
        return self._system

    def volume(self) -> float:
        """Of all cells as they are now (m2)."""
        return float(simplices.volumes(self.cloud.x, self.cells).sum())

    def lumped(self) -> Array:
        """(n,) mass of the nodes (kg/m): a third of each cell around them, at the density of its region's start."""
        mass = np.zeros(self.cloud.n)
        per_cell = self.triangles.volume * self.laws.density[self.cloud.region[self.cells[:, 0]]] / 3.0
        np.add.at(mass, self.cells.ravel(), np.repeat(per_cell, 3))
        return mass

    def boundary(self) -> Array:
        """The nodes on the boundary, sorted."""
        return np.unique(self.facets)

    # --- forces -------------------------------------------------------------------------------------------------------
    def gradients(self, u: Array) -> Array:
        """Of u (n, 2), over the domains (d, 4)."""
        d = self.domains
        out = np.empty((d.n, 4))
        solid_domains.strain(d.first, d.node, d.gradient, d.bulk, u, 0, d.n, out)
        return out

    def respond(self, du: Array, dt: float) -> tuple[Answer, Array]:
        """The answer of the material to the displacement du (n, 2) since the last configuration, and the nodal forces (n, 2) that it
        takes. Collective."""
        with phase("material"):
            gradient = self.gradients(du)
            answer = self._answer(gradient, dt)
            force = np.zeros((self.cloud.n, 2))
            if not answer.valid:
                return answer, force
            d = self.domains
            P = answer.P
            if self.stabilised:
                t = self.triangles
                own = np.empty((t.n, 4))
                solid_domains.strain(t.first, t.node, t.gradient, t.bulk, du, 0, t.n, own)
                hold = self._hold[self.cloud.region[self.cells[:, 0]]]
                solid_domains.add_forces(
                    t.first, t.node, t.gradient, t.bulk, t.volume, np.einsum("dij,dj->di", hold, own), force
                )
                P = P - np.einsum("dij,dj->di", self._hold[self.history.region], gradient)
            solid_domains.add_forces(d.first, d.node, d.gradient, d.bulk, d.volume, P, force)
            return answer, force

    @property
    def stabilised(self) -> bool:
        return self.nodal and self.stabilisation > 0

    def _answer(self, gradient: Array, dt: float) -> Answer:
        if self.comm.size == 1:
            return self.laws.respond(self.history, gradient, dt)
        n = self.domains.n
        own = slice(*share(n, self.comm))
        h = self.history
        part = self.laws.respond(History(h.F[own], h.state[own], h.region[own]), gradient[own], dt)
        packed = np.hstack([part.P, part.A.reshape(-1, 16), part.F, part.state])
        whole = gathered(packed, n, self.comm)
        valid = self.comm.allreduce(part.valid, op=MPI.LAND)
        return Answer(whole[:, :4], whole[:, 4:20].reshape(-1, 4, 4), whole[:, 20:25], whole[:, 25:], valid)

    def stiffen(self, A: Array) -> None:
        """Fill the matrix of the system with tangents A (d, 4, 4) of the domains."""
        with phase("assemble"):
            self.system.clear()
            if self.stabilised:
                A = A - self._hold[self.history.region]
                self.system.add(self.triangles, self._hold[self.cloud.region[self.cells[:, 0]]])
            self.system.add(self.domains, A)

    def accept(self, du: Array, answer: Answer) -> float:
        """Move the nodes, make the answer the history; returns the work of the stresses (J/m), by the trapezoidal rule."""
        gradient = self.gradients(du)
        volume = self.domains.volume
        work = float(volume @ np.sum(0.5 * (self._last_stress() + answer.P) * gradient, axis=1))
        self.cloud.x = self.cloud.x + du
        self.history = History(answer.F, answer.state, self.history.region)
        return work

    def _last_stress(self) -> Array:
        """Stresses at the start of the step, (d, 4)."""
        return self.laws.respond(self.history, np.zeros((self.domains.n, 4)), 0.0).P

    # --- checkpoints ----------------------------------------------------------------------------------------------------
    def state(self) -> dict[str, Array]:
        """All that the body is."""
        history = self.history
        return answers.cloud_state(self.cloud) | {
            "cells": self.cells, "facets": self.facets, "mass": self.mass,
            "F": history.F, "state": history.state, "of": history.region,
        }  # fmt: skip

    def restore(self, state: dict[str, Array]) -> None:
        answers.restore_cloud(self.cloud, state)
        self.renew(state["cells"], state["facets"], History(state["F"], state["state"], state["of"]), state["mass"])

    # --- supports and loads ---------------------------------------------------------------------------------------------
    def supported(self) -> list[Array]:
        """The nodes of each support of the scene, by their reference positions."""
        return [
            np.flatnonzero(support.where(self.cloud.X.T))
            for support in self.scene.supports
            if not isinstance(support.where, str)
        ]

    def loads(self, t: float) -> Array:
        """Nodal forces (n, 2) of gravity and other forces of mass at t."""
        force = np.zeros((self.cloud.n, 2))
        for load in self.scene.loads:
            a = np.array(load.value)[:2] if load.kind == "gravity" else np.asarray(load.value(self.cloud.X.T, t)).T
            force += self.scene.amplitude(load, t) * self.mass[:, None] * a
        return force


def deviatoric(modulus: Array) -> Array:
    """(k, 4, 4): modulus times the deviator of the symmetric gradient."""
    symmetric = np.array([[1.0, 0, 0, 0], [0, 0.5, 0.5, 0], [0, 0.5, 0.5, 0], [0, 0, 0, 1.0]])
    mean = 0.5 * np.outer([1.0, 0, 0, 1], [1.0, 0, 0, 1])
    return modulus[:, None, None] * (symmetric - mean)


def start(scene: Scene, points: Array, cells: Array, regions: Array, h: float) -> tuple[Cloud, Array]:
    """The nodes and triangles of a first mesh; ``size`` is the mean length of the sides at each node, as it grades.

    Raises ``Mistake`` where regions share nodes: history around nodes belongs to one material.
    """
    cells = np.asarray(cells, np.int64)
    region = np.full(len(points), -1, np.int64)
    for k in range(len(scene.regions)):
        own = np.unique(cells[regions == k])
        if np.any(region[own] >= 0):
            raise Mistake(f"scene {scene.name}: region {scene.regions[k].name} is joined to another one; pfem wants them apart")
        region[own] = k
    sides = np.concatenate([cells[:, [0, 1]], cells[:, [1, 2]], cells[:, [2, 0]]])
    length = np.linalg.norm(points[sides[:, 0]] - points[sides[:, 1]], axis=1)
    total, count = np.zeros(len(points)), np.zeros(len(points))
    for end in 0, 1:
        np.add.at(total, sides[:, end], length)
        np.add.at(count, sides[:, end], 1.0)
    return Cloud.at_rest(
        points[:, :2].copy(), np.divide(total, count, out=np.full(len(points), h), where=count > 0), region
    ), cells
