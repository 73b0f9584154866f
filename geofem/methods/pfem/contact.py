"""What the nodes touch: walls, rigid bodies and supports; who touches what is a field of the cloud, ``held``."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from geofem.methods.pfem.budget import Budget, lumped, volumes
from geofem.methods.pfem.cloud import Cloud
from geofem.mistake import Mistake
from geofem.scene import Array, Inlet, Outlet, Rigid, Scene, Wall

TOUCH = 1e-3
"""Within this part of its size a node touches an obstacle that it moves towards."""
ON = 1e-9
"""Within this part of its size a node lies on an outlet."""
SLIP = 0.05
"""A held node that is farther than this part of its size from the obstacle has slid off its end or round its corner."""


@dataclass(frozen=True)
class Touch:
    """The constraints of each node, at most gdim of them, linearly independent; unused rows are zero.

    normals : (n, gdim, gdim) unit normals into the body, one a row. speed : (n, gdim) velocity of the obstacle along each (m/s).
    velocity : (n, gdim, gdim) velocity of the obstacle (m/s). friction : (n, gdim) Coulomb's coefficient, inf where it sticks.
    obstacle : (n, gdim) its number, -1 where there is none.
    """

    normals: Array
    speed: Array
    velocity: Array
    friction: Array
    obstacle: Array

    @property
    def count(self) -> Array:
        """How many constraints each node has, (n,)."""
        return (self.obstacle >= 0).sum(axis=1)


class Contact(Protocol):
    """What stops nodes: ``Obstacles``, or the classical particles of walls."""

    names: list[str]
    rigids: list[Convex]
    inlets: list[Inflow]
    outlets: list[Outflow]

    def follow(self, t: float, dt: float) -> None: ...

    def held(self, cloud: Cloud) -> Array: ...

    def touch(self, cloud: Cloud, *, outlets: bool = False) -> Touch: ...

    def clip(self, cloud: Cloud, cells: Array, budget: Budget) -> Any: ...

    def release(self, cloud: Cloud, force: Array, cells: Array, budget: Budget) -> Any: ...


class Plane:
    """A wall or an opening: its plane, found once by bisection of its predicate."""

    def __init__(self, wall: Wall | Inlet | Outlet, low: Array, high: Array):
        self.name, self.where = wall.name, wall.where
        self.friction = wall.friction if isinstance(wall, Wall) else 0.0
        self.normal = np.array(wall.normal, float)
        axis = int(np.argmax(np.abs(self.normal)))
        span = float((high - low).max())
        grid = np.meshgrid(*[np.linspace(a, b, 23) for a, b in zip(low, high)], indexing="ij")
        lines = np.stack([g.ravel() for g in grid])
        out, beyond = lines.copy(), lines.copy()  # a wall may end: look for it along many lines
        for _ in range(30):
            out[axis] = 0.5 * (low + high)[axis] + span * self.normal[axis]
            beyond[axis] = 0.5 * (low + high)[axis] - span * self.normal[axis]
            found = np.asarray(wall.where(beyond), bool) & ~np.asarray(wall.where(out), bool)
            if found.any():
                break
            span *= 2
        else:
            kind = type(wall).__name__.lower()
            raise Mistake(f"{kind} {wall.name}: its 'where' is true nowhere behind the bodies; is its normal towards the body?")
        out, beyond = out[:, found][:, :1], beyond[:, found][:, :1]
        for _ in range(200):
            middle = 0.5 * (out + beyond)
            if middle[axis, 0] in (out[axis, 0], beyond[axis, 0]):
                break
            out, beyond = (out, middle) if np.asarray(wall.where(middle), bool)[0] else (middle, beyond)
        place = float(beyond[axis, 0])
        rounded = float(f"{place:.12g}")  # a plane at 0.3 that the bisection found at 0.30000000000000004
        self.axis, self.place = axis, rounded if abs(rounded - place) <= 1e-12 * span else place
        if abs(self.place) < 1e-12 * span:
            self.place = 0.0
        self.velocity = np.zeros(len(self.normal))

    def meet(self, cloud: Cloud) -> None:
        """Go through the nodes that lie on it but for the tolerance of its predicate."""
        away = np.abs(cloud.x[:, self.axis] - self.place)
        nearest = int(away.argmin())
        if away[nearest] < 1e-6 * cloud.size[nearest]:
            self.place = float(cloud.x[nearest, self.axis])

    def height(self, x: Array) -> Array:
        """Distance (n,) of nodes (n, gdim) from the whole of the plane, negative beyond it."""
        return (x[:, self.axis] - self.place) * self.normal[self.axis]

    def reach(self, x: Array) -> tuple[Array, Array]:
        """Distance (n,) of nodes (n, gdim) from the plane, negative beyond it, inf where there is none; and normals (n, gdim)."""
        distance = self.height(x)
        behind = x.T.copy()
        behind[self.axis] = self.place - 1e-9 * self.normal[self.axis] * (1.0 + abs(self.place))
        distance = np.where(np.asarray(self.where(behind), bool), distance, np.inf)
        return distance, np.broadcast_to(self.normal, x.shape)

    def put(self, x: Array, distance: Array, normals: Array) -> Array:
        """The places (n, gdim) on the plane."""
        x = x.copy()
        x[:, self.axis] = self.place
        return x


def planes_of(walls: Iterable[Wall | Inlet | Outlet], scene: Scene, cloud: Cloud) -> list[Plane]:
    """Walls or openings of a scene, looked for around its nodes and in its room."""
    low, high = cloud.x.min(axis=0), cloud.x.max(axis=0)
    if scene.room is not None:
        low, high = np.minimum(low, scene.room.low), np.maximum(high, scene.room.high)
    planes = [Plane(wall, low, high) for wall in walls]
    for plane in planes:
        plane.meet(cloud)
    return planes


@dataclass(frozen=True)
class Inflow:
    """An inlet: its nodes stay where they are, while what they are made of goes on; ``column`` of the field ``held`` is theirs.

    velocity : (x, t) -> (2, n) (m/s).
    """

    plane: Plane
    column: int
    velocity: Callable[[Array, float], Array]

    def speeds(self, x: Array, t: float) -> Array:
        """Velocities (n, 2) (m/s) at places x (n, 2). Raises ``Mistake`` where they point out of the body."""
        v = np.asarray(self.velocity(x.T, t), float).T
        if v.shape != x.shape or not np.isfinite(v).all():
            raise Mistake(
                f"inlet {self.plane.name}: its velocity at t = {t:.4g} is not {x.shape[1]} finite numbers for each place"
            )
        if (v @ self.plane.normal < -1e-12 * np.abs(v).max(initial=0.0)).any():
            raise Mistake(f"inlet {self.plane.name}: its velocity at t = {t:.4g} points out of the body; there, use an outlet")
        return v


@dataclass(frozen=True)
class Outflow:
    """An outlet; nodes on it are marked in ``column`` of the field ``held``. traction : see ``geofem.Outlet``."""

    plane: Plane
    column: int
    traction: Callable[[Array, float], Array] | None

    def beyond(self, cloud: Cloud) -> Array:
        """Which nodes have passed it, (n,) bool."""
        return self.plane.reach(cloud.x)[0] < -ON * cloud.size


class Convex:
    """A rigid body: a convex polygon that moves."""

    def __init__(self, rigid: Rigid):
        self.name, self.friction, self.motion = rigid.name, rigid.friction, rigid.motion
        self.corners = np.array(rigid.shape.points, float)
        side = np.roll(self.corners, -1, axis=0) - self.corners
        self.normals = np.stack([side[:, 1], -side[:, 0]], axis=1) / np.linalg.norm(side, axis=1)[:, None]
        self.shift, self.velocity = np.zeros(2), np.zeros(2)
        self.open = np.ones(len(self.corners), bool)
        """Faces that can be touched, as no wall lies against them."""

    def follow(self, t: float, dt: float) -> None:
        """Stand where it is at t, with the mean velocity of the step of dt that follows."""
        if self.motion is not None:
            self.shift = np.array(self.motion(t), float)
            self.velocity = (np.array(self.motion(t + dt), float) - self.shift) / dt if dt > 0 else np.zeros(2)

    def reach(self, x: Array) -> tuple[Array, Array]:
        """Distance (n,) of nodes (n, 2) from the body, negative in it, and the normals (n, 2) out of it."""
        relative = x - self.shift
        height = np.einsum("fd,nfd->nf", self.normals, relative[:, None] - self.corners)
        face = np.where(self.open, height, -np.inf).argmax(axis=1)
        distance, normals = height[np.arange(len(x)), face], self.normals[face].copy()
        away = relative[:, None] - self.corners
        length = np.linalg.norm(away, axis=2)
        corner = length.argmin(axis=1)
        # Outside of two faces a corner is nearest.
        start, end = self.corners[face], np.roll(self.corners, -1, axis=0)[face]
        along = np.einsum("nd,nd->n", relative - start, end - start) / ((end - start) ** 2).sum(axis=1)
        by_corner = (distance > 0) & ((along < 0) | (along > 1))
        at = np.arange(len(x))
        distance = np.where(by_corner, length[at, corner], distance)
        radial = away[at, corner] / np.maximum(length[at, corner], 1e-300)[:, None]
        return distance, np.where(by_corner[:, None], radial, normals)

    def put(self, x: Array, distance: Array, normals: Array) -> Array:
        """The places (n, 2) on its boundary."""
        return x - distance[:, None] * normals


class Obstacles:
    """Walls, rigid bodies, openings and fixed supports of a scene, numbered in this order; ``names`` (k,) are theirs.

    A node that reaches an obstacle is held: it stays on it, may slide along it, and is let go by ``release``. What openings do
    between the steps is in ``openings``.
    """

    def __init__(self, scene: Scene, cloud: Cloud):
        self.planes = planes_of(scene.walls, scene, cloud)
        self.rigids = [Convex(rigid) for rigid in scene.rigids]
        self.solids: list[Any] = [*self.planes, *self.rigids]
        ins, outs = planes_of(scene.inlets, scene, cloud), planes_of(scene.outlets, scene, cloud)
        self.surfaces = [*self.solids, *ins, *outs]
        start = len(self.solids)
        self.inlets = [Inflow(p, start + k, told.velocity) for k, (p, told) in enumerate(zip(ins, scene.inlets))]
        start += len(ins)
        self.outlets = [Outflow(p, start + k, told.traction) for k, (p, told) in enumerate(zip(outs, scene.outlets))]
        self.supports = [(s.name, s.where, c) for s in scene.supports if s.value is None for c in s.components]
        if any(isinstance(where, str) for _, where, _ in self.supports):
            raise Mistake(f"scene {scene.name}: supports of particles are predicates, not names of physical groups")
        self.names = [*(s.name for s in self.surfaces), *(name for name, _, _ in self.supports)]
        cloud.fields["held"] = np.zeros((cloud.n, len(self.surfaces)))
        self.follow(0.0, 0.0)
        for o, surface in enumerate(self.surfaces):
            distance, _ = surface.reach(cloud.x)
            cloud.fields["held"][distance < TOUCH * cloud.size, o] = 1.0

    def follow(self, t: float, dt: float) -> None:
        """Move the rigid bodies to where they are at t (s); dt (s) is the step that follows."""
        self.middle = t + 0.5 * dt
        for rigid in self.rigids:
            rigid.follow(t, dt)
            corners = rigid.corners + rigid.shift
            middle = 0.5 * (corners + np.roll(corners, -1, axis=0)) + 1e-3 * np.ptp(corners, axis=0).max() * rigid.normals
            buried = [plane.reach(middle)[0] < 0 for plane in self.planes]
            rigid.open = ~np.any(buried, axis=0) if buried else rigid.open

    def held(self, cloud: Cloud) -> Array:
        """(n, k) bool: who is held by what. New nodes are where all their parents were; supports ask for the reference place."""
        held = cloud.fields["held"] > 0.999
        on = [np.asarray(where(cloud.X.T), bool) for _, where, _ in self.supports if not isinstance(where, str)]
        return np.column_stack([held, *on]) if on else held

    def touch(self, cloud: Cloud, *, outlets: bool = False) -> Touch:
        """The constraints of all nodes, those of inlets and supports first. outlets : nodes on them also stay in their plane."""
        n, gdim = cloud.x.shape
        first, last = len(self.surfaces), len(self.names)
        normals, velocity = np.zeros((n, gdim, gdim)), np.zeros((n, gdim, gdim))
        friction, obstacle = np.zeros((n, gdim)), np.full((n, gdim), -1)
        count, held = np.zeros(n, np.int64), self.held(cloud)
        for inlet in self.inlets:
            who = np.flatnonzero(held[:, inlet.column])
            normals[who], count[who], obstacle[who] = np.eye(gdim), gdim, inlet.column
            velocity[who] = inlet.speeds(cloud.x[who], self.middle)[:, None]
        exits = [outlet.column for outlet in self.outlets] if outlets else []
        for o in [*range(first, last), *range(len(self.solids)), *exits]:
            who = np.flatnonzero(held[:, o])
            if o < first:
                direction = self.surfaces[o].reach(cloud.x[who])[1]
            else:
                direction = np.zeros((len(who), gdim))
                direction[:, self.supports[o - first][2]] = 1.0
            rest = direction - np.einsum("kij,kj,kid->kd", normals[who], direction, normals[who])  # rows so far are orthogonal
            # A wall and a support, or two walls, in one plane constrain once.
            new = (np.linalg.norm(rest, axis=1) > 0.1) & (count[who] < gdim)
            who, direction = who[new], direction[new]
            normals[who, count[who]] = direction
            obstacle[who, count[who]] = o
            if o < len(self.solids):
                velocity[who, count[who]] = self.solids[o].velocity
                friction[who, count[who]] = self.solids[o].friction
            count[who] += 1
        return Touch(normals, np.einsum("nij,nij->ni", normals, velocity), velocity, friction, obstacle)

    def clip(self, cloud: Cloud, cells: Array, budget: Budget) -> Array:
        """Put nodes that went through an obstacle, or that rest on it, back onto it, and stop what moves into it.

        Momentum goes to the obstacle, and is booked as ``wall``; so is the volume (m2 or m3) that this made, which is
        owed to the free surface near by. Returns the displacements (n, gdim) (m).
        """
        start, field = cloud.x.copy(), cloud.fields["held"]
        for o, solid in enumerate(self.solids):
            distance, normals = solid.reach(cloud.x)
            into = np.einsum("nd,nd->n", cloud.v - solid.velocity, normals)  # < 0: moves into the obstacle
            held = field[:, o] > 0.999
            reached = (distance < 0) | (distance < TOUCH * cloud.size) & (into < 0)
            gone = held & (distance > SLIP * cloud.size)
            field[gone, o] = 0.0
            on = np.flatnonzero((held | reached) & ~gone & np.isfinite(distance))
            budget.jolted |= bool((field[on, o] < 0.999).any())
            field[on, o] = 1.0
            cloud.x[on] = solid.put(cloud.x[on], distance[on], normals[on])
            cloud.v[on] -= into[on, None] * normals[on]
            if math.isinf(solid.friction):
                cloud.v[on] = solid.velocity
            field[cloud.carried > 0, o] = 0.0  # what flies slides along it, and may leave at once
        for outlet in self.outlets:
            field[outlet.plane.height(cloud.x) > SLIP * cloud.size, outlet.column] = 0.0
        budget.book("wall", budget.look(cloud, cells))
        moved = (cloud.x != start).any(axis=1)
        if moved.any():
            near = cells[moved[cells].any(axis=1)]
            made = volumes(cloud.x, near) - volumes(start, near)
            made[np.abs(made) < 1e-14 * cloud.size[near].mean(axis=1) ** cloud.x.shape[1]] = 0.0
            due = np.column_stack([cloud.x[near].mean(axis=1), -made])[made != 0]
            budget.owed = np.concatenate([budget.owed, due])
        return cloud.x - start

    def release(self, cloud: Cloud, force: Array, cells: Array, budget: Budget) -> Array:
        """Let go of nodes that pull at an obstacle: force (n, gdim) (N) of the obstacles on the nodes. Returns who, (n,) bool.

        A node that was let go is held again when it has come back through the obstacle, or moves towards it within its touch.
        """
        mass, field = lumped(cloud, cells), cloud.fields["held"]
        kept = (field[:, [inlet.column for inlet in self.inlets]] > 0.999).any(
            axis=1
        )  # they are pushed in there, whatever it takes
        scale = 1e-9 * np.abs(force).max(initial=0.0)  # a reaction of zero, to rounding, holds
        let = np.zeros(cloud.n, bool)
        for o, solid in enumerate(self.solids):
            _, normals = solid.reach(cloud.x)
            pull = ~kept & (field[:, o] > 0.999) & (np.einsum("nd,nd->n", force, normals) < -scale) & (mass > 0)
            field[pull, o] = 0.0
            let |= pull
        budget.jolted |= bool(let.any())
        return let
