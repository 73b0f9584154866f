"""The particle finite element method: the nodes are the material, and are tessellated anew whenever the mesh asks for it."""

from __future__ import annotations

from typing import Any

from geofem.methods.pfem import fluid, solid_model
from geofem.methods.pfem.fluid import FLUIDS
from geofem.methods.pfem.fluid_model import FluidModel
from geofem.methods.pfem.solid_model import SolidModel
from geofem.mistake import Mistake
from geofem.scene import Scene

ONLY = {
    "fluids": (
        "tessellation", "alpha", "backend", "configuration", "theta", "cfl", "dt", "element", "compressible", "walls", "jitter",
    ),
    "solids": ("state", "cured", "transfer", "remesh", "grading", "steps"),
}  # fmt: skip
"""Knobs that say something to one kind of scene only."""


class Pfem:
    """Fluids and elastoplastic solids on nodes that are the material (Idelsohn, Onate and Del Pin 2004)."""

    name = "pfem"

    def refuses(self, scene: Scene) -> str | None:
        """Why this method cannot solve the scene, in a sentence; None if it can."""
        if any(load.kind in ("traction", "pressure") for load in scene.loads):
            return "pfem takes no boundary traction yet"
        if scene.cracks or scene.growth:
            return "pfem has no cracks"
        if scene.plane not in ("plane_strain", "solid"):
            return "pfem works in plane strain and, with fluids, in space"
        if any(isinstance(support.where, str) for support in scene.supports):
            return "pfem needs supports as predicates of position, not as groups of a mesh file"
        laws = {region.material.law for region in scene.regions}
        if laws & FLUIDS and laws - FLUIDS:
            return "pfem has no scenes of fluids and solids together yet"
        return fluid.refuses(scene) if laws & FLUIDS else solid_model.refuses_solid(scene)

    def build(
        self,
        scene: Scene,
        *,
        n: int = 10,
        tessellation: str = "constrained",
        alpha: float = 1.25,
        backend: str = "auto",
        configuration: str = "mid",
        theta: float | None = None,
        cfl: float = 0.25,
        dt: float | None = None,
        element: str = "p1p1",
        stabilisation: float | None = None,
        tolerance: float | None = None,
        compressible: bool = False,
        walls: str = "slide",
        jitter: float = 0.0,
        state: str | None = None,
        cured: bool | None = None,
        transfer: str = "copy",
        remesh: bool = True,
        grading: float | None = None,
        steps: int | None = None,
    ) -> FluidModel | SolidModel:
        """The model of a scene.

        n : cells across the scene's length.
        stabilisation : of fluids the factor on tau of equal-order elements (1; 0: none); of solids the share of the shear stiffness
            that acts on each triangle against the modes that nodal averages do not see (0.002, and 0.02 in motion).
        tolerance : of fluids the change of the velocity in the last iteration by the largest velocity (1e-6; bingham 1e-4,
            mu_i 1e-3, where at rest by what gravity gives in a step); of solids the force out of balance by the forces that balance
            (1e-9, plastic laws 1e-5).

        Of fluids:

        tessellation : constrained (the boundary is kept, in the plane; in space, cells within the body that was), or alpha: the
            classical alpha shape, which makes volume.
        alpha : radius of the circumscribed circle, by the spacing, up to which a cell belongs to the alpha shape.
        backend : of the triangulation: auto, native (CGAL's headers and a compiler), compas (the wheel compas_cgal), qhull.
        configuration : where the equations hold: mid (the step then keeps the volume), end (the classical updated Lagrangian), start.
        theta : of the time rule, 0.5 (keeps the energy; the default) to 1 (backward Euler; the default with alpha shapes, whose new cells
            bring velocities that are not solenoidal).
        cfl : no node goes further in a step than this part of its spacing. dt : longest step (s); by default a hundredth of the
            run, and of the period.
        element : p1p1 (stabilised), or mini (bubbles, as a check).
        compressible : with the bulk modulus of the law; without, incompressible.
        walls : slide (nodes of the fluid lie on the walls and slide), or fixed: the classical particles of the wall that do not move.
        jitter : shift of the first inner nodes, by the spacing, at random: any cloud of nodes will do.

        Of solids:

        state : where history lives, nodal (averages around nodes: no transfer; the default for plastic laws), or points (in the triangles).
        cured : of points, whether the change of volume is averaged around nodes against locking; by default in scenes without
            inertia, and in these only: in motion a collapse and a swinging beam would gain a sixth of their volume.
        transfer : of points in triangles made anew: copy of the nearest, or average by way of the nodes.
        remesh : False keeps the first triangles, as scenes of several bodies and of small strain always do (``work`` then counts no
            remeshes, and the run ends by ``tangle`` where a triangle turns over).
        grading : exponent with which the first cells shrink towards the scene's singular points.
        steps : load steps of a scene without inertia (10, and 4 n with rigid bodies).

        Raises ``Mistake`` for a knob or a material out of range.
        """
        told: dict[str, Any] = {name: value for name, value in locals().items() if name not in ("self", "scene")}
        kind = "fluids" if scene.regions[0].material.law in FLUIDS else "solids"
        idle = ONLY["solids" if kind == "fluids" else "fluids"]
        defaults = Pfem.build.__kwdefaults__ or {}
        for name in idle:
            if told[name] != defaults[name]:
                raise Mistake(
                    f"knob {name} = {told[name]!r}: says nothing to scenes of {kind}, and {scene.name} is one; leave it out"
                )
        own = {name: value for name, value in told.items() if name not in idle}
        if kind == "fluids":
            return fluid.build_fluid(scene, **own)
        return solid_model.build_solid(scene, **own)
