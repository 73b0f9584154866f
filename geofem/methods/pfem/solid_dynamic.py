"""Motion by explicit steps: many of them on one configuration, then the domains are taken anew.

Central differences: velocities at the middle of steps, which are as long as a bound on the highest frequency allows. The forces of
walls and rigid bodies are those that keep a node from passing through a face within the step.
"""

from __future__ import annotations

import math

import numpy as np

from geofem.cost import phase
from geofem.methods.pfem import solid_contact, solid_domains, solid_explicit, solid_interface
from geofem.methods.pfem.solid_body import Body
from geofem.methods.pfem.solid_laws import History, stretched, volume_only
from geofem.methods.pfem.solid_system import gathered, share
from geofem.mistake import Breakdown
from geofem.scene import Array

SAFETY = 0.9
"""Share of the critical step, 2 by the bound on the highest frequency."""
MOVE, STEPS = 0.1, 200
"""A configuration is kept until a node has moved by this part of the spacing, or for so many steps."""
SAMPLES = 200
"""Configurations to a period, or to the whole of a run, at least: a run is sampled between them."""
TOO_FAST = 10.0
"""No node is faster than so many times the wave speed: the steps are unstable then."""


class Dynamic:
    """The solver of scenes in motion."""

    def __init__(self, body: Body):
        self.body, self.scene = body, body.scene
        velocity = self.scene.initial_velocity
        if velocity is not None:
            X = body.cloud.X
            body.cloud.v = np.broadcast_to(np.asarray(velocity(X.T), float).T, X.shape).copy()
        self.obstacles = solid_contact.obstacles(self.scene, body.cloud)
        names = [*(s.name for s in self.scene.supports), *(o.name for o in self.obstacles)]
        self.reaction = {name: np.zeros(2) for name in names}
        self.iterations = self.points = 0
        self.internal = self.external = 0.0
        self._momentum, self._impulse, self._fastest = self.momentum(), np.zeros(2), 0.0
        self._wave = max(law.wave_speed(par, rho) for law, par, rho in zip(body.laws.laws, body.laws.par, body.laws.density))

    @property
    def dt(self) -> float:
        """The time (s) for which this configuration may be kept."""
        critical = self._critical()
        cloud = self.body.cloud
        speed = np.linalg.norm(cloud.v, axis=1)
        span = min(MOVE / max(float(np.max(speed / cloud.size)), 1e-300), (self.scene.period or self.scene.t_end) / SAMPLES)
        return critical * max(1, min(STEPS, math.ceil(span / critical)))

    def _critical(self) -> float:
        """The stable step (s)."""
        d, body = self.body.domains, self.body
        lame = body.laws.lame[body.history.region]
        modulus = (lame[:, 0] + 2.0 * lame[:, 1]) / body.history.volume
        fastest = solid_explicit.largest_frequency(d.first, d.node, d.gradient, d.bulk, d.volume, modulus, body.mass)
        # springs between bodies stiffen as they are pressed together
        return (SAFETY if len(self.scene.regions) == 1 else 0.5 * SAFETY) * 2.0 / fastest

    def momentum(self) -> Array:
        return self.body.mass @ self.body.cloud.v

    @property
    def imbalance(self) -> float:
        """Momentum that no force accounts for, by the largest there has been."""
        scale = math.sqrt(self.body.start["mass"]) * self._fastest
        return float(np.linalg.norm(self.momentum() - self._momentum - self._impulse)) / scale if scale else 0.0

    def step(self, t: float, dt: float) -> float:
        """Steps that end at t + dt; returns that. Raises ``Breakdown``: ``tangle`` (a domain inside out), ``cfl`` (too fast)."""
        with phase("explicit"):
            count = max(1, math.ceil(dt / self._critical() - 1e-9))
            self._run(t, dt / count, count)
        return t + dt

    def _run(self, t: float, h: float, count: int) -> None:
        body, cloud, domains, laws = self.body, self.body.cloud, self.body.domains, self.body.laws
        n, d, span = cloud.n, domains.n, h * count
        laws.weaken(t + 0.5 * span)
        fixed, given, supported = self._held(t, span)
        loads = body.loads(t), body.loads(t + span)
        normal, distance, drift, friction = self._faces(t, span)
        u, du, held, impulse = np.zeros((n, 2)), np.zeros((n, 2)), np.zeros((n, 2)), np.zeros((len(self.obstacles), 2))
        f = np.zeros((d, 4))
        f[:, [0, 3]] = 1.0
        history = body.history
        state, region, F, work = history.state.copy(), history.region, history.F, np.zeros(d)
        off = np.zeros((d, 2))
        P = self._stress()
        lo, hi = share(d, body.comm)
        hold = 2.0 * body.stabilisation * laws.lame[:, 1] if body.nodal else np.zeros(len(laws.laws))
        hold_cells = hold[cloud.region[body.cells[:, 0]]]
        updates = [solid_explicit.make_update(law.point) for law in laws.laws]
        tri = body.triangles
        elements = solid_interface.contact_elements(cloud, body.facets)
        lame = laws.lame[cloud.region]
        spring = lame[:, 0] + 2.0 * lame[:, 1]
        for k in range(count):
            s = (k + 0.5) / count
            force = np.zeros((n, 2))
            solid_domains.add_forces(domains.first, domains.node, domains.gradient, domains.bulk, domains.volume, P, force)
            if len(elements):
                solid_interface.add_contact(elements, cloud.x, u, spring, cloud.size, force)
            if body.stabilised:
                self.internal += solid_explicit.add_hold(body.cells, tri.gradient, tri.volume, hold_cells, du, force)
            self.external += solid_explicit.advance(
                u, du, cloud.v, body.mass, force, (1 - s) * loads[0] + s * loads[1], h, fixed, given, normal, distance, drift,
                friction, impulse, held,
            )  # fmt: skip
            for j, update in enumerate(updates):
                bad = update(domains.first, domains.node, domains.gradient, domains.bulk, u, F, f, state, region, j, laws.par[j],
                             h, hold[j], lo, hi, P, off, work)  # fmt: skip
                if bad >= 0:
                    break
            if body.comm.size > 1:
                bad = max(body.comm.allgather(bad))
                P = gathered(P[lo:hi], d, body.comm)
            if bad >= 0:
                raise Breakdown("tangle", f"a domain turns inside out at t = {t + (k + 1) * h:.4g}")
        self.iterations += count
        self.points += count * d
        if body.comm.size > 1:
            packed = gathered(np.hstack([f[lo:hi], state[lo:hi], work[lo:hi, None]]), d, body.comm)
            f, state, work = packed[:, :4].copy(), packed[:, 4:8].copy(), packed[:, 8].copy()
        self._settle(u, f, state, supported, fixed, held / span, impulse, span, loads)
        self.internal += float(domains.volume @ work)

    def _stress(self) -> Array:
        """Stresses on this configuration (d, 4) of the state as it is."""
        return self.body.laws.respond(self.body.history, np.zeros((self.body.domains.n, 4)), 0.0).P

    def _held(self, t: float, span: float) -> tuple[Array, Array, list[Array]]:
        """Dofs of given velocity (n, 2), the velocities (m/s), and the nodes of each support."""
        cloud = self.body.cloud
        fixed, given = np.zeros((cloud.n, 2), bool), np.zeros((cloud.n, 2))
        supported = self.body.supported()
        for support, nodes in zip(self.scene.supports, supported):
            value = 0.0 if support.value is None else support.value(cloud.X[nodes].T, t + span)
            for c in support.components:
                fixed[nodes, c] = True
                given[nodes, c] = (value - (cloud.x[nodes, c] - cloud.X[nodes, c])) / span
        return fixed, given, supported

    def _faces(self, t: float, span: float) -> tuple[Array, Array, Array, Array]:
        """Of each obstacle: the normal of the face that each node may touch, its distance, the velocity, and the friction."""
        x, count = self.body.cloud.x, len(self.obstacles)
        normal, distance = np.zeros((count, len(x), 2)), np.full((count, len(x)), np.inf)
        drift, friction = np.zeros((count, 2)), np.zeros(count)
        for o, obstacle in enumerate(self.obstacles):
            found = obstacle.distances(x, t)
            face = np.argmax(found, axis=1)
            normal[o], distance[o] = obstacle.normals[face], found[np.arange(len(x)), face]
            drift[o] = (obstacle.shift(t + span) - obstacle.shift(t)) / span
            friction[o] = min(obstacle.friction, 1e300)
        return normal, distance, drift, friction

    def _settle(self, u: Array, f: Array, state: Array, supported: list[Array], fixed: Array, held: Array, impulse: Array,
                span: float, loads: tuple[Array, Array]) -> None:  # fmt: skip
        """Make the end of the steps the configuration."""
        body, cloud = self.body, self.body.cloud
        for support, nodes in zip(self.scene.supports, supported):
            self.reaction[support.name] = np.array([held[nodes, c].sum() if c in support.components else 0.0 for c in range(2)])
        for o, obstacle in enumerate(self.obstacles):
            self.reaction[obstacle.name] = impulse[o] / span
        self._impulse += impulse.sum(axis=0) + span * (held.sum(axis=0) + 0.5 * (loads[0] + loads[1]).sum(axis=0))
        cloud.x = cloud.x + u
        F = stretched(f - np.array([1.0, 0, 0, 1]), body.history.F)
        path = np.array(body.laws.path)[body.history.region]
        F[path] = volume_only(F[path])
        body.history = History(F, state, body.history.region)
        speed = np.sqrt(np.max(np.sum(cloud.v**2, axis=1)))
        if not speed < TOO_FAST * self._wave:
            raise Breakdown("cfl", f"a node moves at {speed:.3g} m/s, many times the speed of waves: the steps are too long")
        self._fastest = max(self._fastest, float(np.sqrt(np.sum(body.mass[:, None] * cloud.v**2))))
        body.configure()

    # --- checkpoints ----------------------------------------------------------------------------------------------------
    def state(self) -> Array:
        """Numbers that go on from step to step."""
        head = [self.iterations, self.points, self._fastest, self.internal, self.external]
        return np.array([*head, *self._momentum, *self._impulse, *np.ravel(list(self.reaction.values()))])

    def restore(self, state: Array) -> None:
        iterations, points, self._fastest, self.internal, self.external = state[:5].tolist()
        self.iterations, self.points = int(iterations), int(points)
        self._momentum, self._impulse = state[5:7], state[7:9].copy()
        self.reaction = dict(zip(self.reaction, state[9:].reshape(-1, 2)))
