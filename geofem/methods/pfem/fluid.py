"""From a scene of fluid to its model: knobs checked, first nodes, walls of particles where they are asked for."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from geofem import materials
from geofem.core import mesh as meshes
from geofem.core.mpi import on_root
from geofem.methods.pfem.cloud import Cloud
from geofem.methods.pfem.contact import Contact, Obstacles
from geofem.methods.pfem.flow import CONFIGURATIONS, Scheme
from geofem.methods.pfem.fluid_forms import ELEMENTS
from geofem.methods.pfem.fluid_model import FluidModel
from geofem.methods.pfem.particles import WallParticles, beside_walls
from geofem.methods.pfem.surface import Rules
from geofem.methods.pfem.tessellation import Tessellation, Tessellator, backends, simplices
from geofem.methods.pfem.tessellation.alpha import AlphaShape
from geofem.methods.pfem.tessellation.common import finished
from geofem.methods.pfem.tessellation.constrained import Constrained
from geofem.methods.pfem.tessellation.inside import InsideBody
from geofem.mistake import Mistake, unknown
from geofem.scene import Scene

TOLERANCES = {"newtonian": 1e-6, "bingham": 1e-4, "mu_i": 1e-3}
"""Change of the velocity in the last iteration, by the largest one: where the viscosity depends on the flow, convergence is slow."""
FLUIDS = set(TOLERANCES)
STEPS = 100
"""At least so many steps a run and a period."""


def refuses(scene: Scene) -> str | None:
    """Why fluids cannot solve the scene."""
    if not scene.dynamic:
        return "pfem moves fluids by their inertia: the scene must be dynamic"
    if len({(r.material.law, r.material.density, tuple(sorted(r.material.parameters.items()))) for r in scene.regions}) > 1:
        return "pfem flows one material at a time"
    if any(load.kind == "body" for load in scene.loads):
        return "pfem drives fluids by gravity, not by a body force"
    if scene.gdim == 3 and (scene.rigids or scene.inlets or scene.outlets):
        return "pfem knows rigid bodies, inlets and outlets in the plane only"
    return None


def build_fluid(
    scene: Scene, *, n: int, tessellation: str, alpha: float, backend: str, configuration: str, theta: float | None, cfl: float,
    dt: float | None, element: str, stabilisation: float | None, tolerance: float | None, compressible: bool, walls: str, jitter: float,
) -> FluidModel:  # fmt: skip
    """See ``Pfem.build``."""
    choices = (
        ("tessellation", tessellation, ("constrained", "alpha")),
        ("configuration", configuration, tuple(CONFIGURATIONS)),
        ("element", element, ELEMENTS),
        ("walls", walls, ("slide", "fixed")),
    )
    for name, value, known in choices:
        if value not in known:
            raise unknown(name, value, known)
    if tessellation == "alpha" and (scene.inlets or scene.outlets):
        raise Mistake("knob tessellation = 'alpha': inlets and outlets need a boundary that is kept; use constrained")
    if not isinstance(n, int) or n < 1:
        raise Mistake(f"knob n = {n!r}: the number of cells across the scene's length is a whole number, at least 1")
    if not isinstance(compressible, bool):
        raise Mistake(f"knob compressible = {compressible!r}: is true or false")
    if theta is None:
        theta = 0.5 if tessellation == "constrained" else 1.0
    stabilisation = 1.0 if stabilisation is None else stabilisation
    if tolerance is None:
        tolerance = TOLERANCES[scene.regions[0].material.law]
    longest = scene.t_end / STEPS if dt is None else dt
    if dt is None and scene.period:
        longest = min(longest, scene.period / STEPS)
    limits = (
        ("theta", theta, 0.5, 1.0), ("alpha", alpha, 0.5, 10.0), ("cfl", cfl, 1e-4, 100.0), ("jitter", jitter, 0.0, 0.3),
        ("stabilisation", stabilisation, 0.0, 1e3), ("tolerance", tolerance, 1e-14, 1e-1), ("dt", longest, 1e-300, scene.t_end),
    )  # fmt: skip
    for name, number, low, high in limits:
        if not low <= number <= high:
            raise Mistake(f"knob {name} = {number:g}: must lie in [{low:g}, {high:g}]")
    for region in scene.regions:
        materials.check(region.material, f"region {region.name!r}")
        if not region.material.density > 0:
            raise Mistake(f"region {region.name!r}: a fluid needs a density, in kg/m3")
    size = scene.length / n
    maker: Tessellator = AlphaShape(alpha, backend=backend)
    if tessellation == "constrained":
        maker = Constrained(alpha, backend=backend) if scene.gdim == 2 else InsideBody(alpha, backend=backend)
    comm = MPI.COMM_WORLD
    cloud, mesh = comm.bcast(on_root(comm, lambda: first(scene, n, size, jitter, maker, backend)))
    obstacles: Contact = Obstacles(scene, cloud) if walls == "slide" else WallParticles(scene, cloud)
    if walls == "fixed":
        mesh = comm.bcast(on_root(comm, lambda: beside_walls(maker(cloud.x, cloud.size, None), cloud)))
    kept = tessellation == "constrained"
    rules = Rules(boundary=kept and scene.gdim == 2, skin=kept and scene.gdim == 3)
    scheme = Scheme(theta, configuration, element, stabilisation, tolerance, compressible)
    return FluidModel(scene, cloud, mesh, maker, scheme, rules, cfl, longest, obstacles)


def first(scene: Scene, n: int, size: float, jitter: float, maker: Tessellator, backend: str) -> tuple[Cloud, Tessellation]:
    """The first nodes and cells; cells are made anew around nodes that were shifted."""
    backends.method(backend, scene.gdim)  # raises now, not when the mesh is made anew
    made = meshes.serial(scene, n, "triangle" if scene.gdim == 2 else "tetrahedron", 1.0)
    points, cells = made.points[:, : scene.gdim], made.cells.astype(np.int64)
    turned = simplices.volumes(points, cells) < 0
    cells[turned, :2] = cells[turned, 1::-1]
    cloud = Cloud.at_rest(points, np.full(len(points), size))
    mesh = finished(simplices.ordered(cells)[0], None)
    if jitter:
        inner = np.setdiff1d(np.arange(cloud.n), mesh.facets)
        cloud.x[inner] += np.random.default_rng(0).uniform(-jitter, jitter, (len(inner), scene.gdim)) * size
        cloud.X[:] = cloud.x
        mesh = maker(cloud.x, cloud.size, mesh)
    return cloud, mesh
