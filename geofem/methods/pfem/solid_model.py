"""The particle finite element method for solids as a model of a scene: steps, remeshing in between, and what a run asks of it."""

from __future__ import annotations

from typing import Any

import numpy as np
from mpi4py import MPI

from geofem import materials
from geofem.core import mesh as meshes
from geofem.core import meshing
from geofem.core.mpi import on_root
from geofem.methods.pfem import answers, solid_body
from geofem.methods.pfem.solid_body import STATES, Body
from geofem.methods.pfem.solid_dynamic import Dynamic
from geofem.methods.pfem.solid_remesh import TRANSFERS, Remesher
from geofem.methods.pfem.solid_static import Static
from geofem.methods.pfem.transfer import to_nodes
from geofem.mistake import Mistake, unknown
from geofem.scene import Array, Box, MeshFile, Probe, Scene

STABILISATION = 2e-3
"""Default share of the shear stiffness: with a hundredth the strip footing bears 3 % more, with none Newton takes four times as many
iterations."""
STEPS_PER_CELL = 4
"""Load steps in which a rigid body goes the scene's length, by the cells across it."""
DAMPING = 0.02
"""The same for explicit steps, which are so short that it is the damping ratio of the shortest waves."""


class SolidModel:
    """Solids whose nodes are the material; see ``Pfem.build`` for the knobs."""

    def __init__(self, scene: Scene, body: Body, solver: Static | Dynamic, remesher: Remesher | None):
        self.scene, self.body, self.solver, self.remesher = scene, body, solver, remesher
        self.t = 0.0
        self.comm = body.comm
        self.work = {"steps": 0, "newton": 0, "linear": 0, "point_steps": 0, "remeshes": 0}
        self._places = answers.Places(scene, body.cloud, body.cells)

    def dt(self) -> float:
        return self.solver.dt

    def step(self, dt: float) -> None:
        self.t = self.solver.step(self.t, dt)
        self.work["steps"] += 1
        if isinstance(self.solver, Static):
            self.work["newton"] = self.work["linear"] = self.solver.iterations
        else:
            self.work["point_steps"] = self.solver.points
        if self.remesher is not None:
            self.remesher.look(self.t, dt if self.scene.dynamic else 0.0)
            self.work["remeshes"] = self.remesher.count

    # --- what the runner asks -------------------------------------------------------------------------------------------
    def probe(self, probe: Probe) -> float:
        """The sampled number of a probe; see ``Probe`` for the quantities."""
        if probe.quantity == "reaction":
            assert probe.of is not None
            return float(self.solver.reaction[probe.of][probe.component])
        stress = np.pad(self._nodal_stress(), ((0, 0), (0, 2))) if probe.quantity == "stress" else np.empty((0, 6))
        return self._places.probe(probe, self.body.cloud, self.body.mass, self.t, stress)

    def _nodal_stress(self) -> Array:
        """Cauchy stress at the nodes (n, 4); of history in triangles the mean around a node."""
        stress = self.body.laws.cauchy(self.body.history)
        if self.body.nodal:
            return stress
        return to_nodes(stress, self.body.cells, self.body.triangles.volume, self.body.cloud.n)[0]

    def energy(self) -> dict[str, float]:
        v = self.body.cloud.v
        kinetic = float(0.5 * self.body.mass @ np.sum(v**2, axis=1))
        return {"kinetic": kinetic, "internal": self.solver.internal, "external": self.solver.external}

    def checks(self) -> dict[str, float | None]:
        """Drift of mass and volume, and the largest force out of balance, relative."""
        mass = abs(float(self.body.mass.sum()) / self.body.start["mass"] - 1.0)
        return {"mass": mass, "momentum": self.solver.imbalance, "volume": self.body.volume() / self.body.start["volume"] - 1.0}

    def size(self) -> dict[str, int]:
        return {"dofs": 2 * self.body.cloud.n, "cells": len(self.body.cells), "points": self.body.domains.n}

    def savings(self) -> dict[str, float]:
        return {}

    def functions(self) -> list[Any]:
        return []

    def snapshot(self) -> dict[str, Any]:
        """See ``Model.snapshot``; on rank 0."""
        if self.comm.rank:
            return {}
        outlines = [
            np.array(rigid.shape.points) + (np.array(rigid.motion(self.t)) if rigid.motion else 0.0)
            for rigid in self.scene.rigids
        ]
        return answers.snapshot(self.body.cloud, self.body.cells, outlines) | {"stress": self._nodal_stress()}

    # --- checkpoints ----------------------------------------------------------------------------------------------------
    def state(self) -> dict[str, Array]:
        """See ``Model.state``."""
        if self.comm.rank:
            return {}
        numbers = np.array([self.t, *self.work.values(), self.remesher.count if self.remesher else 0])
        owed = {"owed": self.remesher.budget.owed} if self.remesher else {}
        return {"numbers": numbers, "solver": self.solver.state(), **owed, **self.body.state()}

    def restore(self, state: dict[str, Array]) -> None:
        """See ``Model.restore``."""
        self.t, *counts = state["numbers"].tolist()
        self.work = {name: int(count) for name, count in zip(self.work, counts)}
        self.body.restore(state)
        self.solver.restore(state["solver"])
        if self.remesher is not None:
            self.remesher.count, self.remesher.budget.owed = int(counts[-1]), state["owed"]
            self.remesher.resume()


def refuses_solid(scene: Scene) -> str | None:
    """Why the solids of this scene are not for pfem, in a sentence; None if they are."""
    if scene.plane != "plane_strain":
        return "pfem has solids in plane strain only"
    if scene.inlets or scene.outlets:
        return "pfem has inlets and outlets for fluids only"
    small = scene.strain == "small"
    for region in scene.regions:
        law = materials.LAWS[region.material.law]
        if not (law.small if small else law.finite):
            return f"{law.name} has no form of {scene.strain} strain"
    return None


def inside(scene: Scene, point: tuple[float, ...]) -> bool:
    """Whether a point lies in a body or on its boundary."""
    return any(
        bool(region.shape.contains(np.array(point)[:, None])[0])
        for region in scene.regions
        if not isinstance(region.shape, MeshFile)
    )


def build_solid(
    scene: Scene, *, n: int, state: str | None, cured: bool | None, stabilisation: float | None, grading: float | None,
    steps: int | None, tolerance: float | None, remesh: bool, transfer: str,
) -> SolidModel:  # fmt: skip
    """See ``Pfem.build``."""
    plastic = any(materials.LAWS[region.material.law].history for region in scene.regions)
    state = state or ("nodal" if plastic else "points")
    if state not in STATES:
        raise unknown("state", state, STATES)
    for name, value in (("n", n), ("steps", steps)):
        if value is not None and (not isinstance(value, int) or value < 1):
            raise Mistake(f"knob {name} = {value!r}: give a whole number, at least 1")
    if transfer not in TRANSFERS:
        raise unknown("transfer", transfer, TRANSFERS)
    if cured and scene.dynamic and state == "points":
        # The average feels nothing of neighbours that swell and shrink in turn; in motion they do, and their areas weigh the stresses.
        raise Mistake("knob cured = True: triangles in motion would make volume; leave it out, or take state = nodal")
    cured = not scene.dynamic if cured is None else cured
    if stabilisation is None:
        stabilisation = DAMPING if scene.dynamic else STABILISATION
    if not stabilisation >= 0:
        raise Mistake(f"knob stabilisation = {stabilisation:g} must not be negative")
    for region in scene.regions:
        materials.check(region.material, f"region {region.name!r}")
    grading = grading if grading is not None else (2.0 if plastic and scene.strain == "small" else 1.0)
    comm = MPI.COMM_WORLD

    def made() -> Any:
        corners = [p for rigid in scene.rigids for p in rigid.shape.points if inside(scene, p)]
        shapes = [region.shape for region in scene.regions]
        if corners or not all(isinstance(meshing.upright(shape), Box | MeshFile) for shape in shapes):
            poles, law = (corners, 2.0) if corners else (scene.singular, grading)
            mesh = meshing.fragments(scene.regions, shapes, scene.length, scene.length / n, "triangle", poles, law)
        else:
            mesh = meshes.serial(scene, n, "triangle", grading)
        return solid_body.start(scene, mesh.points, mesh.cells, mesh.regions, scene.length / n)

    cloud, cells = comm.bcast(on_root(comm, made))
    body = Body(scene, cloud, cells, state, cured, stabilisation, comm)
    # with several bodies the triangulation between them is theirs to touch by, and each keeps its own
    mended = remesh and scene.strain == "finite" and len(scene.regions) == 1
    remesher = Remesher(body, scene.length / n, transfer) if mended else None
    if scene.dynamic:
        return SolidModel(scene, body, Dynamic(body), remesher)
    steps = steps or (STEPS_PER_CELL * n if scene.rigids else 10)
    static = Static(body, scene.t_end / steps, tolerance or (1e-5 if plastic else 1e-9))
    return SolidModel(scene, body, static, remesher)
