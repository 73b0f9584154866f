"""Bodies with cracks for method ``fem``: meshes that conform to the cracks, graded to their tips, with quarter-point cells there."""

from __future__ import annotations

from mpi4py import MPI

from geofem import materials
from geofem.core.forms import Template
from geofem.cost import phase
from geofem.methods.conforming import mesh
from geofem.methods.conforming.body import CrackedBody
from geofem.methods.conforming.model import ConformingModel
from geofem.mistake import Mistake
from geofem.scene import MeshFile, Scene

GRADING = 3.0
"""Default exponent. At sqrt(r), cells of order 2 keep theirs with exponents above 4 (Raugel 1978); with quarter points 3 does as well up to
n = 32, and better on coarse meshes."""


def refuses(scene: Scene) -> str | None:
    """Why fem cannot solve the scene with its cracks, in a sentence; None if it can."""
    if scene.plane not in ("plane_strain", "plane_stress"):
        return "fem solves bodies with cracks in plane strain and plane stress"
    if scene.dynamic or scene.collapse:
        return "fem solves bodies with cracks at rest, under loads that they carry"
    if scene.strain != "small" or {region.material.law for region in scene.regions} != {"linear_elastic"}:
        return "fem solves bodies with cracks in small strains of linear_elastic materials"
    if any(isinstance(region.shape, MeshFile) for region in scene.regions):
        return "fem makes its own mesh along cracks; give shapes in place of a mesh file"
    if any(crack.pressure or crack.friction is not None or crack.cohesion for crack in scene.cracks):
        return "fem takes cracks with free faces only; use xfem where they bear pressure, contact or cohesion"
    if scene.growth is not None and scene.growth.strength is not None:
        return "fem lets no new cracks open; use xfem"
    if any(probe.quantity in ("T", "opening", "opening_error") for probe in scene.probes):
        return "fem measures no T-stress or opening of cracks; use xfem"
    return None


def build(
    scene: Scene,
    n: int,
    order: int,
    grading: float | None,
    quarter_point: bool | None,
    steps: int | None,
    da: float | None,
) -> ConformingModel:
    """Discretise a scene with cracks; see ``Fem.build`` for the knobs, which are checked there. Collective."""
    quarter_point = order > 1 if quarter_point is None else quarter_point
    if quarter_point and order == 1:
        raise Mistake("knob quarter_point = True: needs order 2 or 3, cells of order 1 have no nodes on their sides")
    for region in scene.regions:
        materials.check(region.material, f"region {region.name!r}", incompressible_ok=False)
    geometry = min(order, 2)
    grading = GRADING if grading is None else grading

    def make(present: Scene) -> CrackedBody:
        with phase("mesh"):
            meshed = mesh.build(MPI.COMM_WORLD, present, n, geometry, grading, quarter_point)
        template = Template(
            cell="triangle",
            geometry=meshed.body.mesh.ufl_domain().ufl_coordinate_element(),
            order=order,
            plane=scene.plane,
            strain="small",
            laws=("linear_elastic",) * len(scene.regions),
            mixed=False,
            updated=False,
            # cells around a tip and along round sides are not affine
            degree=max(1, 2 * (order - 1) + 2 * (geometry - 1)),
            followers=sum(load.kind == "pressure" for load in scene.loads),
        )
        return CrackedBody(present, template, meshed, steps or 1)

    return ConformingModel(scene, make, da if da is not None else scene.t_end / 20.0)
