"""Equilibrium step by step: Newton's method with backtracking on the displacement of a step, with contact by penalty.

A step is cut where Newton fails, or where a triangle would lose most of its area before the nodes are tessellated anew.
"""

from __future__ import annotations

import numpy as np

from geofem.methods.pfem import solid_contact, solid_domains
from geofem.methods.pfem.solid_body import Body
from geofem.methods.pfem.solid_contact import Touch
from geofem.methods.pfem.solid_laws import Answer, hooke
from geofem.mistake import Breakdown
from geofem.scene import Array

ITERATIONS, HALVINGS = 40, 6
CIRCLE, ELASTIC_SHARE = 4, 0.02
"""Where that many iterations bring nothing, so much of the elastic tangent is mixed in, as in ``geofem.core.newton``."""
CRUSHED = 0.2
"""A step that leaves less than this of a triangle's area is cut."""
SMALLEST_STEP = 1e-3
ROUNDING = 1e-13
"""An out-of-balance force below this times the stiffness and the displacement of a step is zero."""


class Static:
    """The solver of scenes without inertia.

    first : the step (of t) it starts with. tolerance : out-of-balance force relative to the forces that balance.
    """

    def __init__(self, body: Body, first: float, tolerance: float):
        self.body, self.scene = body, body.scene
        self.dt = self.first = first
        self.tolerance = tolerance
        self.obstacles = solid_contact.obstacles(body.scene, body.cloud)
        for k in range(len(self.obstacles)):
            body.cloud.fields[f"touch{k}"] = np.zeros((body.cloud.n, 3))
        scene = self.scene
        names = [*(s.name for s in scene.supports), *(w.name for w in scene.walls), *(r.name for r in scene.rigids)]
        self.reaction = {name: np.zeros(2) for name in names}
        self.iterations = self.cuts = 0
        self.imbalance = self.internal = self.external = 0.0

    def step(self, t: float, dt: float) -> float:
        """One step from t by dt, or less; returns the new t. Raises ``Breakdown``; the last good state stays."""
        while True:
            try:
                self._solve(t, t + dt)
                break
            except Breakdown as end:
                self.cuts += 1
                dt *= 0.5
                self.dt = dt
                if dt < SMALLEST_STEP * self.first:
                    raise Breakdown(end.cause, f"{end}; at t = {t:.4g}, after cutting the step to {dt:.1e}") from None
        if dt >= self.dt:
            self.dt = min(self.first, 1.5 * self.dt)
        return t + dt

    def _solve(self, t0: float, t1: float) -> None:
        body, cloud = self.body, self.body.cloud
        body.laws.weaken(t1)
        n = cloud.n
        fixed, target = np.zeros((n, 2), bool), np.zeros((n, 2))
        supported = body.supported()
        for support, nodes in zip(self.scene.supports, supported):
            value = 0.0 if support.value is None else support.value(cloud.X[nodes].T, t1)
            for c in support.components:
                fixed[nodes, c] = True
                target[nodes, c] = value - (cloud.x[nodes, c] - cloud.X[nodes, c])
        loads = body.loads(t1)
        touches = self._touches(t0, t1)
        du = np.zeros((n, 2))
        answer, force, blocks = self._evaluate(du, t1 - t0, loads, touches)
        pending = bool(np.any(np.abs(target[fixed]) > 0))
        norms: list[float] = []
        stiff = float(np.max(body.laws.lame @ [1.0, 2.0]))
        for _ in range(ITERATIONS):
            norm, scale = self._norms(force, fixed, loads, touches)
            if not pending and norm <= max(self.tolerance * scale, ROUNDING * stiff * float(np.linalg.norm(du))):
                break
            if not pending:
                norms.append(norm)
            correction = self._correct(
                answer, force, blocks, touches, fixed, target - du if pending else np.zeros_like(du), norms
            )
            length, before = 1.0, norm
            for _ in range(HALVINGS):
                answer, force, blocks = self._evaluate(du + length * correction, t1 - t0, loads, touches)
                if answer.valid and (pending or self._norms(force, fixed, loads, touches)[0] < 0.999 * before):
                    break
                length *= 0.5
            if not answer.valid:
                raise Breakdown("tangle", "a domain turns inside out however short the correction")
            du = du + length * correction
            pending = pending and length < 1.0
            if norm > 1e8 * max(norms[0] if norms else norm, scale):
                raise Breakdown("newton", f"the force grows to {norm:.1e}")
        else:
            raise Breakdown("newton", f"no balance in {ITERATIONS} iterations: force {norm:.1e} among forces of {scale:.1e}")
        if not body.small:
            area = solid_domains.gradients(cloud.x + du, body.cells)[1]
            if np.any(area < CRUSHED * body.triangles.volume):
                raise Breakdown("tangle", "a triangle loses most of its area in a step")
        self._accept(du, answer, force, fixed, loads, touches, supported, norm / scale if scale else 0.0)

    def _touches(self, t0: float, t1: float) -> list[Touch]:
        body, cloud = self.body, self.body.cloud
        if not self.obstacles:
            return []
        edge = body.boundary()
        lame = body.laws.lame[cloud.region]
        stiffness = solid_contact.STIFF * (lame[:, 0] + 2.0 * lame[:, 1])
        return [
            solid_contact.begin(o, cloud.x, t0, t1, edge, cloud.fields[f"touch{k}"], stiffness, cloud.size)
            for k, o in enumerate(self.obstacles)
        ]

    def _evaluate(self, du: Array, dt: float, loads: Array, touches: list[Touch]) -> tuple[Answer, Array, list[Array]]:
        """The answer, the nodal forces out of balance (n, 2), and the stiffness of the contacts."""
        answer, inner = self.body.respond(du, dt)
        force = loads - inner
        blocks = []
        for touch in touches:
            blocks.append(touch.evaluate(du))
            np.add.at(force, touch.nodes, touch.force)
        return answer, force, blocks

    def _norms(self, force: Array, fixed: Array, loads: Array, touches: list[Touch]) -> tuple[float, float]:
        """Force out of balance, and size of the forces that balance: loads, reactions and contact forces."""
        contact = sum(float(np.sum(touch.force**2)) for touch in touches)
        scale = np.sqrt(np.sum(force[fixed] ** 2) + np.sum(loads**2) + contact)
        return float(np.linalg.norm(force[~fixed])), float(scale)

    def _correct(self, answer: Answer, force: Array, blocks: list[Array], touches: list[Touch], fixed: Array, given: Array,
                 norms: list[float]) -> Array:  # fmt: skip
        body = self.body
        circling = len(norms) > CIRCLE and min(norms[-CIRCLE:]) > 0.5 * min(norms[:-CIRCLE])
        for mixed in (circling, True):
            A = answer.A
            if mixed:
                A = (1.0 - ELASTIC_SHARE) * A + ELASTIC_SHARE * hooke(body.laws.lame)[body.history.region]
            body.stiffen(A)
            for touch, block in zip(touches, blocks):
                body.system.add_nodal(touch.nodes, block)
            self.iterations += 1
            try:
                return body.system.solve(force, fixed, np.where(fixed, given, 0.0))
            except Breakdown:
                if mixed:
                    raise
        raise AssertionError

    def _accept(self, du: Array, answer: Answer, force: Array, fixed: Array, loads: Array, touches: list[Touch],
                supported: list[Array], imbalance: float) -> None:  # fmt: skip
        held = np.where(fixed, -force, 0.0)
        for support, nodes in zip(self.scene.supports, supported):
            self.reaction[support.name] = np.array([held[nodes, c].sum() if c in support.components else 0.0 for c in range(2)])
        for k, touch in enumerate(touches):
            self.reaction[touch.obstacle.name] = touch.force.sum(axis=0)
            self.body.cloud.fields[f"touch{k}"] = touch.remember(self.body.cloud.n)
            self.external += float(np.sum(touch.force @ touch.move))
        self.external += float(np.sum((held + loads) * du))
        self.internal += self.body.accept(du, answer)
        self.imbalance = max(self.imbalance, imbalance)
        if not self.body.small:
            self.body.configure()

    # --- checkpoints ----------------------------------------------------------------------------------------------------
    def state(self) -> Array:
        """Numbers that go on from step to step."""
        head = [self.dt, self.iterations, self.imbalance, self.internal, self.external]
        return np.array([*head, *np.ravel(list(self.reaction.values()))])

    def restore(self, state: Array) -> None:
        self.dt, iterations, self.imbalance, self.internal, self.external, *reaction = state.tolist()
        self.iterations = int(iterations)
        self.reaction = dict(zip(self.reaction, np.reshape(reaction, (-1, 2))))
