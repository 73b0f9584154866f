"""The extended finite element method: cracks that run through a mesh as they like, by functions added to its nodes."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

from geofem import materials
from geofem.core import mesh as meshes
from geofem.core.forms import Template
from geofem.methods.xfem.enrichment import TIPS
from geofem.methods.xfem.intact import Intact
from geofem.methods.xfem.model import XfemModel
from geofem.mistake import Mistake
from geofem.scene import Scene

RADIUS = 0.2
"""Default radius of the enrichment of tips, as a part of the scene's length."""


class Xfem:
    """Linear triangles enriched by the jump across cracks and by the field of their tips, in plane linear elasticity."""

    name = "xfem"

    def __init__(self) -> None:
        self._kept: tuple[tuple[Any, ...], Intact] | None = None
        """The last body that was meshed and what it was made from: a sweep over cracks and loads uses it again."""

    def refuses(self, scene: Scene) -> str | None:
        """Why this method cannot solve the scene, in a sentence; None if it can."""
        if scene.plane not in ("plane_strain", "plane_stress"):
            return "xfem works in plane strain and plane stress"
        if scene.dynamic or scene.collapse:
            return "xfem solves bodies at rest under loads that they carry"
        if scene.strain != "small" or {region.material.law for region in scene.regions} != {"linear_elastic"}:
            return "xfem is for small strains of linear_elastic bodies"
        if scene.growth and any(crack.friction or crack.cohesion for crack in scene.cracks):
            return "xfem lets cracks grow whose faces are free or touch without friction: those with a memory do not grow yet"
        if scene.walls or scene.rigids:
            return "xfem has no contact with walls or rigid bodies; use a material point method"
        if scene.inlets or scene.outlets:
            return "xfem has no inlets and outlets; use pfem"
        return None

    def build(
        self,
        scene: Scene,
        *,
        n: int = 20,
        enrichment: str = "modes",
        radius: float | None = None,
        grading: float | None = None,
        steps: int = 1,
        da: float | None = None,
    ) -> XfemModel:
        """Discretise a scene.

        Parameters
        ----------
        n : cells across the scene's own length.
        enrichment : of the nodes around a tip, besides the jump across cracks: modes (the displacement fields of both modes, two
            dofs a node, within the radius, with Fries' ramp), branches (four functions, eight dofs, within the radius), corrected
            (branches with the ramp: accurate, but nearly dependent), topological (branches at the cell of the tip only), or
            heaviside (none).
        radius : of that enrichment (m); by default a fifth of the scene's length. It is raised to 2.5 cells, and cut to .45 of
            the distance to the other end of the crack and .7 of that to the boundary.
        grading : exponent with which cells shrink towards the scene's singular points; 2 by default.
        steps : of the load, where no crack grows.
        da : way of the fastest tip in a step (m), where cracks grow; a twentieth of the scene's length of growth by default.

        Raises ``Mistake`` for knobs out of range.
        """
        if enrichment not in TIPS:
            raise Mistake(f"knob enrichment = {enrichment!r}: choose from {', '.join(TIPS)}")
        if TIPS[enrichment] is not None and any(crack.cohesion for crack in scene.cracks):
            raise Mistake(f"knob enrichment = {enrichment!r}: a crack with cohesion has no singular tip; choose heaviside")
        for name, value in (("n", n), ("steps", steps)):
            if not isinstance(value, int) or value < 1:
                raise Mistake(f"knob {name} = {value}: give a whole number, at least 1")
        dt = scene.t_end / steps
        if scene.growth is not None:
            dt = scene.growth.length / 20.0 if da is None else da
            if steps != 1 or not dt > 0:
                raise Mistake(
                    f"knobs da = {dt:g} and steps = {steps}: where cracks grow, each step is of da > 0 (m); leave steps"
                )
        elif da is not None:
            raise Mistake(f"knob da = {da:g}: no crack of scene {scene.name} grows; give it a Growth, or use geofem.grow")
        radius = RADIUS * scene.length if radius is None else radius
        if not radius > 0:
            raise Mistake(f"knob radius = {radius}: the radius of the enrichment is positive (m)")
        grading = (2.0 if scene.singular else 1.0) if grading is None else grading
        if not grading >= 1:
            raise Mistake(f"knob grading = {grading}: is an exponent of at least 1 (uniform cells)")
        key = (scene.regions, scene.length, scene.singular, scene.plane, n, grading)
        if self._kept is None or self._kept[0] != key:
            self._kept = key, intact(scene, n, grading)
        return XfemModel(scene, self._kept[1], TIPS[enrichment], radius, dt)


def intact(scene: Scene, n: int, grading: float) -> Intact:
    """The body of a scene without its cracks, meshed. Collective."""
    for region in scene.regions:
        materials.check(region.material, f"region {region.name!r}", incompressible_ok=False)
    body = meshes.build(MPI.COMM_WORLD, scene, n=n, cell="triangle", grading=grading)
    if body.mesh.topology.cell_name() != "triangle" or body.mesh.geometry.cmaps[0].degree != 1:
        raise Mistake("xfem needs a mesh of triangles with straight sides")
    template = Template(
        cell="triangle",
        geometry=body.mesh.ufl_domain().ufl_coordinate_element(),
        order=1,
        plane=scene.plane,
        strain="small",
        laws=("linear_elastic",) * len(scene.regions),
        mixed=False,
        updated=False,
        degree=1,
    )
    return Intact(template, body, scene.regions)
