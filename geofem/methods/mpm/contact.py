"""Rigid bodies that touch the material points: a penalty on the depth to which the points' domains reach into them.

The domain, not the node, tells where the body ends, so that a face in any direction is met to second order in the size of the
domains, and no gap of a cell stays open. The stiffness is that of the material over one cell: what the points sink in is the
elastic shortening of a cell under the contact pressure.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
from numba import njit

from geofem.methods.mpm.deeds import inlined
from geofem.methods.mpm.grid import OPTIONS
from geofem.methods.mpm.points import Body
from geofem.methods.mpm.shapes import SHAPES
from geofem.scene import Array, Rigid


class Contact:
    """One rigid body: where it is, and the force (N) that it exerted on the bodies in the last step.

    place : its number among the scene's rigid bodies, each of which has a grip of its own on the points.
    """

    def __init__(self, rigid: Rigid, place: int):
        self.rigid = rigid
        p = np.array(rigid.shape.points)
        side = np.roll(p, -1, axis=0) - p
        length = np.linalg.norm(side, axis=1)
        self.normals = np.stack([side[:, 1], -side[:, 0]], axis=1) / length[:, None]  # out of the rigid body
        self.corners = p
        self.friction = min(rigid.friction, 1e300)
        self.velocity = np.zeros(2)
        self.force = np.zeros(2)
        self.columns = slice(2 * place, 2 * place + 2)
        self.follow(0.0, 0.0, 1.0)

    def follow(self, t0: float, t1: float, dt: float) -> None:
        """Where the body stands at the scene's time t0, and the velocity that takes it to its place at t1 in dt (s)."""
        a, b = (np.array(self.rigid.motion(t)) if self.rigid.motion else np.zeros(2) for t in (t0, t1))
        self.velocity = (b - a) / dt
        self.points = self.corners + a
        self.faces = np.column_stack([self.normals, self.points])
        self.box = np.concatenate([self.points.min(axis=0), self.points.max(axis=0)])

    def grip(self, body: Body) -> Array:
        """The friction force (N, 2) that this rigid body holds on the body's points, copies included; a view."""
        return body.arrays["grip"][:, self.columns]

    def touch(self, body: Body, stiffness: float, h: float, dt: float) -> Array:
        """Add the contact forces to those of the body's points; returns their sum (2,) over the rank's own points."""
        return make_touch(SHAPES[body.kind.shape].domain, body.kind.small)(
            body.cloud, self.grip(body), body.n, self.faces, self.box, self.velocity, self.friction, stiffness, h, dt
        )


@cache
def make_reach(kind: str) -> Any:
    """(q, p, nx, ny, h) -> reach (m) of domains given by half lengths, edges or corners."""

    @inlined
    def reach(q, p, nx, ny, h):  # type: ignore[no-untyped-def]
        """How far the domain of point p reaches from it along -n."""
        d = q.domain[p]
        if kind == "half":
            return h * (abs(nx) * d[0] + abs(ny) * d[1])
        if kind == "edges":
            F = q.stretch[p]
            return h * (
                abs(nx * (F[0] * d[0] + F[1] * d[1]) + ny * (F[2] * d[0] + F[3] * d[1]))
                + abs(nx * (F[0] * d[2] + F[1] * d[3]) + ny * (F[2] * d[2] + F[3] * d[3]))
            )
        x, y = q.x[p, 0], q.x[p, 1]
        a, b = nx * (x - d[0]) + ny * (y - d[1]), nx * (x - d[2]) + ny * (y - d[3])
        c, e = nx * (x - d[4]) + ny * (y - d[5]), nx * (x - d[6]) + ny * (y - d[7])
        return max(a, b, c, e)

    return reach


@cache
def make_side(kind: str) -> Any:
    """(q, p, j) -> unit normal into the domain of point p at its side j of four."""

    @inlined
    def side(q, p, j):  # type: ignore[no-untyped-def]
        d = q.domain[p]
        if kind == "half":
            tx, ty = (1.0, 0.0) if j < 2 else (0.0, 1.0)
            turn = 1.0 if j % 2 else -1.0
        elif kind == "edges":
            F, o = q.stretch[p], 0 if j < 2 else 2
            tx, ty = F[0] * d[o] + F[1] * d[o + 1], F[2] * d[o] + F[3] * d[o + 1]
            turn = 1.0 if j % 2 else -1.0
        else:
            o, a = 2 * j, 2 * ((j + 1) & 3)  # counter-clockwise: what is inside lies on the left
            tx, ty, turn = d[a] - d[o], d[a + 1] - d[o + 1], 1.0
        scale = turn / math.sqrt(tx * tx + ty * ty)
        return -scale * ty, scale * tx

    return side


@cache
def make_meet(kind: str, small: bool) -> Any:
    """(q, p, x, y, faces, box, h) -> (nx, ny, depth, area): how a point, moved to (x, y), meets a convex rigid body.

    Two convex bodies are apart if one side of either parts them; else they meet along that normal n, from the rigid body to the point,
    in which they overlap least. The sides of the domain count too: a long one that passes by a corner of the rigid body lies behind all
    faces of it, and yet is apart. depth (m) : the overlap, not positive where they are apart. area (m2) : the domain's share of the
    surface.
    """
    reach, side = make_reach(kind), make_side(kind)

    @inlined
    def meet(q, p, x, y, faces, box, h):  # type: ignore[no-untyped-def]
        nx, ny, depth, area = 0.0, 0.0, -1.0, 0.0
        right, left = reach(q, p, -1.0, 0.0, h), reach(q, p, 1.0, 0.0, h)
        up, down = reach(q, p, 0.0, -1.0, h), reach(q, p, 0.0, 1.0, h)
        if x + right > box[0] and x - left < box[2] and y + up > box[1] and y - down < box[3]:
            gap, extent = -np.inf, 0.0
            for k in range(len(faces)):
                ax, ay = faces[k, 0], faces[k, 1]
                e = reach(q, p, ax, ay, h)
                s = ax * (x - faces[k, 2]) + ay * (y - faces[k, 3]) - e
                if s > gap:
                    gap, nx, ny, extent = s, ax, ay, e
            for j in range(4):
                ax, ay = side(q, p, j)
                far = -np.inf
                for k in range(len(faces)):
                    far = max(far, ax * faces[k, 2] + ay * faces[k, 3])
                e = reach(q, p, ax, ay, h)
                s = ax * x + ay * y - e - far
                if s > gap:
                    gap, nx, ny, extent = s, ax, ay, e
            F = q.F[p]
            J = 1.0 if small else (F[0] * F[3] - F[1] * F[2]) * F[4]
            depth, area = -gap, 0.5 * q.volume[p] * J / extent
        return nx, ny, depth, area

    return meet


@cache
def make_touch(kind: str, small: bool) -> Any:
    """The pass over the points, for domains given by half lengths, edges or corners."""
    meet = make_meet(kind, small)

    @njit(**OPTIONS)
    def touch(q, grip, own, faces, box, velocity, friction, stiffness, h, dt):  # type: ignore[no-untyped-def]
        total = np.zeros(2)
        for p in range(len(q.mass)):
            nx, ny, depth, area = meet(q, p, q.x[p, 0], q.x[p, 1], faces, box, h)
            if depth <= 0.0:
                grip[p, 0] = grip[p, 1] = 0.0
                continue
            push = stiffness * area * depth
            slip = -ny * (q.v[p, 0] - velocity[0]) + nx * (q.v[p, 1] - velocity[1])
            hold = -ny * grip[p, 0] + nx * grip[p, 1] - stiffness * area * dt * slip
            most = friction * push
            hold = min(max(hold, -most), most)
            grip[p, 0], grip[p, 1] = -ny * hold, nx * hold
            fx, fy = push * nx + grip[p, 0], push * ny + grip[p, 1]
            q.force[p, 0] += fx
            q.force[p, 1] += fy
            if p < own:
                total[0] += fx
                total[1] += fy
        return total

    return touch
