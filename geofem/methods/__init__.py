"""Methods by name: what each is, and where it lives. Nothing heavy is imported until a method is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any, Protocol

import numpy as np

from geofem.mistake import unknown
from geofem.scene import Probe, Scene


class Model(Protocol):
    """A scene made solvable by one method. One whose cracks can grow has a ``propagation``, see ``geofem.core.propagation``."""

    t: float
    work: dict[str, int]
    """Counters of work: ``steps``, ``newton``, ``linear``, ``point_steps``, ``remeshes``."""

    def dt(self) -> float:
        """The step that the model would take now (s, or a part of the load in a static scene)."""

    def step(self, dt: float) -> None:
        """Advance by at most dt; ``t`` says how far it went. Raises ``Breakdown`` and leaves the last good state."""

    def probe(self, probe: Probe) -> float: ...

    def energy(self) -> dict[str, float]:
        """``kinetic``, ``internal`` energy and ``external`` work done by loads and supports since t = 0 (J)."""

    def checks(self) -> dict[str, float | None]:
        """Relative drifts of ``mass``, ``momentum``, ``volume`` since the start (None where it has no meaning)."""

    def snapshot(self) -> dict[str, Any]:
        """``points`` (n, 3), ``cells``, ``cell`` (shape), ``displacement`` (n, gdim), and fields; on rank 0 only.

        Pictures and films draw these where they are there: ``velocity`` (n, gdim), ``stress`` (n or cells, 4 or 6), ``pressure``,
        ``plastic_strain``, ``region`` (a number each), and of material points and rigid bodies ``edges``, ``corners``, ``volume``
        and ``rigid``, see ``geofem.study.paint``.
        """

    def functions(self) -> list[Any]:
        """The present fields as dolfinx functions of one element on one mesh, for VTX files; none where there is no mesh."""

    def size(self) -> dict[str, int]:
        """``dofs``, ``cells``, ``points`` over all ranks."""

    def state(self) -> dict[str, np.ndarray]:
        """All that a checkpoint must hold, gathered on rank 0 and independent of the number of ranks."""

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Take up a state that ``state`` gave, on any number of ranks. Called on every rank with the same arrays."""

    def savings(self) -> dict[str, float]:
        """What the method did not have to model, as fractions of the full model."""


class Method(Protocol):
    """How one method turns a scene into a model. The keyword arguments of ``build`` are its knobs."""

    name: str

    def refuses(self, scene: Scene) -> str | None:
        """Why this method cannot solve the scene, in a sentence; None if it can."""

    def build(self, scene: Scene, **knobs: Any) -> Model: ...


@dataclass(frozen=True)
class Entry:
    """Where a method lives, as ``module:attribute``, and what it is, in a line."""

    target: str
    summary: str


METHODS = {
    "fem": Entry(
        "geofem.methods.lagrangian:Fem", "finite elements on a mesh that follows the material (total or updated Lagrangian)"
    ),
    "xfem": Entry("geofem.methods.xfem:Xfem", "finite elements enriched by the jump across cracks and the field of their tips"),
    "pfem": Entry("geofem.methods.pfem:Pfem", "finite elements on nodes that are the material, tessellated anew as they move"),
    "mpm-linear": Entry("geofem.methods.mpm:LinearMpm", "material points with classical hat functions on a background grid"),
    "mpm-gimp": Entry(
        "geofem.methods.mpm:GimpMpm", "material points with domains: generalised interpolation, uniform or contiguous"
    ),
    "mpm-cpdi": Entry("geofem.methods.mpm:CpdiMpm", "material points with parallelogram domains that deform with them"),
    "mpm-cpdi2": Entry("geofem.methods.mpm:Cpdi2Mpm", "material points with quadrilateral domains that keep touching"),
    "mpm-bspline": Entry("geofem.methods.mpm:BsplineMpm", "material points with quadratic or cubic B-splines on the grid"),
}


def known() -> dict[str, Entry]:
    """The built-in methods and those of other packages (entry point group ``geofem.methods``)."""
    found = dict(METHODS)
    for point in entry_points(group="geofem.methods"):
        found[point.name] = Entry(point.value, f"from {point.dist.name if point.dist else point.value}")
    return found


def get(name: str) -> Method:
    """The method of that name. Raises ``Mistake`` if there is none."""
    methods = known()
    if name not in methods:
        raise unknown("method", name, methods)
    module, _, attribute = methods[name].target.partition(":")
    return getattr(import_module(module), attribute)()
