"""One step of a fluid body: the equations on the present tessellation, obstacles as held, tied or rubbing nodes, and who flies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from geofem import materials
from geofem.methods.pfem.budget import node_volumes
from geofem.methods.pfem.cloud import Cloud
from geofem.methods.pfem.contact import Contact, Touch
from geofem.methods.pfem.fluid_forms import FlowForms, flow_forms
from geofem.methods.pfem.fluid_system import FluidSystem
from geofem.methods.pfem.tessellation import Tessellation
from geofem.scene import Array, Scene

CONFIGURATIONS = {"start": 0.0, "mid": 0.5, "end": 1.0}
STIFF = 1e6
"""Springs that hold nodes to oblique or moving faces, by the node's own mass over dt and its viscosity."""
CREEP = 1e-3
"""Speed of slip, by what gravity gives in a step, below which friction is a dashpot."""

ROUNDING = 1e-9
"""Changes of the velocity below this fraction of what gravity gives in a step are rounding: a fluid at rest has no other scale."""


@dataclass(frozen=True)
class Scheme:
    """How a step is made.

    theta : 1/2 keeps the energy, 1 damps. configuration : start, mid or end: where the equations hold. element : p1p1 or mini.
    stabilisation : factor on tau of p1p1. tolerance : of the iteration, by the largest velocity. compressible : with the bulk
    modulus K of the law, else incompressible.
    """

    theta: float
    configuration: str
    element: str
    stabilisation: float
    tolerance: float
    compressible: bool


class Flow:
    """The solver of a scene's fluid; on every rank.

    ``reaction`` (n, gdim): force of obstacles on the nodes in the last step (N), ``traction`` that of what is beyond outlets,
    ``touch`` what touched what.
    """

    def __init__(self, comm: MPI.Intracomm, scene: Scene, scheme: Scheme):
        self.comm, self.scene, self.scheme = comm, scene, scheme
        material = scene.regions[0].material
        self.par = materials.values(material)
        self.density, self.law = material.density, material.law
        self.tension = self.par.get("surface_tension", 0.0)
        self.springs = bool(scene.rigids) or self.tension > 0 or any(0 < wall.friction < np.inf for wall in scene.walls)
        self.springs |= any(outlet.traction is not None for outlet in scene.outlets)
        self.forms: FlowForms = flow_forms(scene.gdim, scheme.element, self.law, self.springs)
        self.system: FluidSystem | None = None
        self.touch: Touch
        self.reaction = self.traction = np.zeros((0, scene.gdim))
        self.factorisations = self.linear = self.iterations = 0

    def constants(self) -> dict[str, float]:
        """Values of the constants of the forms."""
        par = self.par
        named = {"viscosity": par.get("mu", 0.0), "density": self.density, "tau": self.scheme.stabilisation}
        if self.scheme.compressible:
            named["compliance"] = 1.0 / par["K"]
        if self.law == "bingham":
            named |= {"yield_stress": par["tau_y"], "growth": par["m"]}
        if self.law == "mu_i":
            named |= {"mu_s": par["mu_s"], "mu_2": par["mu_2"], "I_0": par["I_0"], "grain": par["d"] * par["rho_s"] ** 0.5}
        return named

    def renew(self, x: Array, tessellation: Tessellation | None) -> None:
        """Take a new tessellation (rank 0). Collective."""
        if self.system is not None:
            self.system.destroy()
        self.system = FluidSystem(self.comm, self.forms, x, tessellation, self.constants())

    def gravity(self, t: float) -> Array:
        """Acceleration (gdim,) at t (m/s2)."""
        total = np.zeros(self.scene.gdim)
        for load in self.scene.loads:
            total += self.scene.amplitude(load, t) * np.asarray(load.value, float)[: self.scene.gdim]
        return total

    def solve(self, cloud: Cloud, mesh: Tessellation, obstacles: Contact, t: float, dt: float) -> tuple[Array, Array]:
        """Velocities (n, gdim) and pressures (n,) at t + theta dt. Raises ``Breakdown``. Collective.

        mesh : cells and boundary facets, on every rank.
        """
        system, scheme = self.system, self.scheme
        assert system is not None
        gravity = self.gravity(t + scheme.theta * dt)
        system.constants["gravity"].value[:] = gravity
        system.set_start(cloud.x, cloud.v, cloud.p, scheme.theta)
        ties = Ties(self, cloud, mesh, obstacles, t, dt, gravity)
        adjust = ties.adjust if self.springs else None
        # a heap that has come to rest has no velocity to measure by, and its friction settles no better than that of one that flows
        still = scheme.tolerance if self.law == "mu_i" else ROUNDING
        way = CONFIGURATIONS[scheme.configuration]
        system.solve(dt, scheme.theta, way, ties.held, ties.speed, scheme.tolerance, still, adjust)
        force = system.residual()
        local = np.column_stack([system.velocity(), system.pressure(), force[system.velocity_dofs]])
        whole = system.everywhere(cloud.n, local)
        gdim = self.scene.gdim
        u, p, force = whole[:, :gdim], whole[:, gdim], whole[:, gdim + 1 :]
        self.reaction = np.where(ties.held, force, 0.0) + ties.force(u)
        self.traction, self.touch = ties.traction, ties.touch
        self.factorisations += system.factorisations
        self.linear += system.solver.iterations
        self.iterations += system.iterations
        system.factorisations = system.solver.iterations = system.iterations = 0
        return u, p

    def power(self) -> float:
        """Dissipation (W) in the last step. Collective."""
        assert self.system is not None
        return self.system.power()


class Ties:
    """What obstacles, outlets and surface tension do to nodes in one step: components that are held, springs and forces.

    held (n, gdim) bool, with the ``speed`` (n, gdim) (m/s) of those components. traction (n, gdim): force of outlets (N).
    """

    def __init__(self, flow: Flow, cloud: Cloud, mesh: Tessellation, obstacles: Contact, t: float, dt: float, gravity: Array):
        self.flow, self.cloud, self.mesh, self.dt = flow, cloud, mesh, dt
        n, gdim = cloud.x.shape
        self.touch = touch = obstacles.touch(cloud)
        self.held, self.speed = np.zeros((n, gdim), bool), np.zeros((n, gdim))
        self.spring, self.pull = np.zeros((n, gdim, gdim)), np.zeros((n, gdim))
        par = flow.par
        scale = flow.density * node_volumes(cloud.x, mesh.cells) / dt + par.get("mu", 0.0) * cloud.size ** (gdim - 2)
        self.rub: list[tuple[Array, Array, Array, Array]] = []
        self.creep = CREEP * dt * float(np.linalg.norm(gravity)) + 1e-300
        for row in range(gdim):
            on = touch.obstacle[:, row] >= 0
            normal, speed = touch.normals[:, row], touch.speed[:, row]
            still = ~np.any(touch.velocity[:, row], axis=1)
            straight = on & (np.abs(normal).max(axis=1) > 1 - 1e-12)
            stick = on & np.isinf(touch.friction[:, row])
            axis = np.abs(normal).argmax(axis=1)
            face = np.flatnonzero(straight)
            self.held[face, axis[face]] = True
            self.speed[face, axis[face]] = speed[face] * normal[face, axis[face]]
            self.held[stick & still] = True
            who = np.flatnonzero(on & ~straight & ~(stick & still))
            stiff = STIFF * scale[who]
            self.spring[who] += stiff[:, None, None] * normal[who, :, None] * normal[who, None, :]
            self.pull[who] += (stiff * speed[who])[:, None] * normal[who]
            moving = np.flatnonzero(stick & ~still)
            if len(moving):
                along = np.eye(gdim) - normal[moving, :, None] * normal[moving, None, :]
                self.spring[moving] += STIFF * scale[moving, None, None] * along
                self.pull[moving] += STIFF * scale[moving, None] * np.einsum("nij,nj->ni", along, touch.velocity[moving, row])
            who = np.flatnonzero(on & (touch.friction[:, row] > 0) & ~stick)
            if len(who):
                self.rub.append((who, normal[who], touch.friction[who, row], touch.velocity[who, row]))
        self.now = self.spring, self.pull
        self.traction = np.zeros((n, gdim))
        self.exits, self.then = [], t + flow.scheme.theta * dt
        for outlet in obstacles.outlets:
            if outlet.traction is not None:
                on = cloud.fields["held"][:, outlet.column] > 0.999
                self.exits.append((mesh.facets[on[mesh.facets].all(axis=1)], outlet.traction))

    def adjust(self, x: Array, u: Array, force: Array) -> tuple[Array, Array, Array]:
        """Springs (n, gdim, gdim), forces (n, gdim) and volumes (n,) of the nodes in an iteration.

        x : (n, gdim) the nodes in the configuration of the equations; u : (n, gdim) their velocities; force : out of balance (N).
        """
        spring, pull = self.spring.copy(), self.pull.copy()
        for who, normal, friction, velocity in self.rub:
            held = np.where(self.held[who], force[who], 0.0) + self.pull[who]
            held -= np.einsum("nij,nj->ni", self.spring[who], u[who])
            press = np.maximum(np.einsum("ni,ni->n", held, normal), 0.0)
            along = np.eye(u.shape[1]) - normal[:, :, None] * normal[:, None, :]
            slip = np.linalg.norm(np.einsum("nij,nj->ni", along, u[who] - velocity), axis=1)
            drag = (friction * press / np.maximum(slip, self.creep))[:, None, None] * along
            spring[who] += drag
            pull[who] += np.einsum("nij,nj->ni", drag, velocity)
        self.now = spring, pull
        if self.exits:
            self.traction = np.sum([traction_force(x, facets, told, self.then) for facets, told in self.exits], axis=0)
            pull = pull + self.traction
        if self.flow.tension:
            # The shortest ripples would not settle if the surface only pulled: it also resists, node by node.
            stiff = CONFIGURATIONS[self.flow.scheme.configuration] * self.dt
            resist = stiff * surface_stiffness(x, self.mesh.facets, self.flow.tension)
            spring = spring + resist
            pull = pull + surface_force(x, self.mesh.facets, self.flow.tension) + np.einsum("nij,nj->ni", resist, u)
        return spring, pull, node_volumes(x, self.mesh.cells)

    def force(self, u: Array) -> Array:
        """Force of springs and friction on the nodes (n, gdim) (N)."""
        spring, pull = self.now
        return pull - np.einsum("nij,nj->ni", spring, u)


def traction_force(x: Array, facets: Array, traction: Callable[[Array, float], Array], t: float) -> Array:
    """Nodal forces (n, 2) (N) of a traction (Pa) at t, linear along each of the facets (k, 2), of a boundary in the plane."""
    out = np.zeros_like(x)
    a, b = facets.T
    length = np.linalg.norm(x[a] - x[b], axis=1)[:, None]
    at_a, at_b = (np.asarray(traction(x[end].T, t), float).T for end in (a, b))
    np.add.at(out, a, length * (2 * at_a + at_b) / 6)
    np.add.at(out, b, length * (at_a + 2 * at_b) / 6)
    return out


def surface_force(x: Array, facets: Array, tension: float) -> Array:
    """- d(tension * area of the boundary) / dx, (n, gdim) (N): that of the polygon in the plane, of triangles in space."""
    out = np.zeros_like(x)
    if x.shape[1] == 2:
        edge = x[facets[:, 1]] - x[facets[:, 0]]
        unit = tension * edge / np.linalg.norm(edge, axis=1)[:, None]
        np.add.at(out, facets[:, 0], unit)
        np.add.at(out, facets[:, 1], -unit)
        return out
    a, b, c = (x[facets[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    unit = normal / np.linalg.norm(normal, axis=1)[:, None]
    for k, (p, q) in enumerate(((b, c), (c, a), (a, b))):
        np.add.at(out, facets[:, k], -0.5 * tension * np.cross(unit, q - p))
    return out


def surface_stiffness(x: Array, facets: Array, tension: float) -> Array:
    """The blocks (n, gdim, gdim) (N/m) of each node with itself in the second derivative of tension * area of the boundary."""
    out = np.zeros((*x.shape, x.shape[1]))
    if x.shape[1] == 2:
        edge = x[facets[:, 1]] - x[facets[:, 0]]
        normal = np.column_stack([edge[:, 1], -edge[:, 0]])
        block = tension * normal[:, :, None] * normal[:, None, :] / (np.linalg.norm(edge, axis=1) ** 3)[:, None, None]
        np.add.at(out, facets[:, 0], block)
        np.add.at(out, facets[:, 1], block)
        return out
    a, b, c = (x[facets[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    size = np.linalg.norm(normal, axis=1)
    for k, (p, q) in enumerate(((b, c), (c, a), (a, b))):
        weight = 0.5 * tension * np.sum((q - p) ** 2, axis=1) / size**3
        np.add.at(out, facets[:, k], weight[:, None, None] * normal[:, :, None] * normal[:, None, :])
    return out
