"""Rigid bodies against material points in a load step at rest: the penalty of ``contact`` with its tangent.

The reach of a domain and its share of the surface are those at the start of the step; the depth, and with Coulomb's friction the slip
since then, follow the trial displacement.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numba import njit

from geofem.methods.mpm.contact import Contact, make_meet
from geofem.methods.mpm.grid import OPTIONS
from geofem.methods.mpm.points import Body
from geofem.methods.mpm.shapes import SHAPES
from geofem.scene import Array

ROUGH = 10.0
"""The largest coefficient of friction. With an infinite one a point that barely touches a face drags it with any force and, a hair
away, with none: between the two there is no balance to be found. Pressed soil yields long before it slips at a slope of 84 degrees."""


class Press:
    """All rigid bodies against all points of a rank, one body after the other; each ``Contact`` holds the force of its rigid body."""

    def __init__(self, contacts: list[Contact], bodies: list[Body], stiffness: list[float], h: float):
        self.contacts, self.bodies, self.stiffness, self.h = contacts, bodies, stiffness, h
        self.grips = [np.zeros((body.n, 2 * len(contacts))) for body in bodies]

    def __call__(self, u: Array) -> tuple[Array, Array]:
        """Forces (N, 2) on points displaced by u (N, 2), and minus their derivative (N, 2, 2)."""
        force, spring = np.zeros_like(u), np.zeros((len(u), 2, 2))
        for contact in self.contacts:
            contact.force[:] = 0.0
        at = 0
        for body, grip, k in zip(self.bodies, self.grips, self.stiffness):
            part = slice(at, at + body.n)
            at += body.n
            grip[:] = 0.0
            press = make_press(SHAPES[body.kind.shape].domain, body.kind.small)
            for contact in self.contacts:
                contact.force += press(
                    body.cloud, contact.grip(body), body.n, u[part], contact.faces, contact.box, contact.velocity,
                    min(contact.friction, ROUGH), k, self.h, force[part], spring[part], grip[:, contact.columns],
                )  # fmt: skip
        return force, spring

    def commit(self) -> None:
        for body, grip in zip(self.bodies, self.grips):
            body.own("grip")[:] = grip


@cache
def make_press(kind: str, small: bool) -> Any:
    """The pass over the points, for domains given by half lengths, edges or corners."""
    meet = make_meet(kind, small)

    @njit(**OPTIONS)
    def press(q, grip, own, u, faces, box, moved, friction, stiffness, h, force, spring, new_grip):  # type: ignore[no-untyped-def]
        total = np.zeros(2)
        for p in range(own):
            nx, ny, depth, area = meet(q, p, q.x[p, 0] + u[p, 0], q.x[p, 1] + u[p, 1], faces, box, h)
            if depth <= 0.0:
                continue
            k = stiffness * area
            push = k * depth
            slip = -ny * (u[p, 0] - moved[0]) + nx * (u[p, 1] - moved[1])
            hold = -ny * grip[p, 0] + nx * grip[p, 1] - k * slip
            most = friction * push
            along, across = k, 0.0
            if hold > most:
                hold, along, across = most, 0.0, friction * k
            elif hold < -most:
                hold, along, across = -most, 0.0, -friction * k
            new_grip[p, 0], new_grip[p, 1] = -ny * hold, nx * hold
            fx, fy = push * nx - ny * hold, push * ny + nx * hold
            force[p, 0] += fx
            force[p, 1] += fy
            total[0] += fx
            total[1] += fy
            spring[p, 0, 0] += k * nx * nx + along * ny * ny - across * ny * nx
            spring[p, 0, 1] += k * nx * ny - along * ny * nx - across * ny * ny
            spring[p, 1, 0] += k * ny * nx - along * nx * ny + across * nx * nx
            spring[p, 1, 1] += k * ny * ny + along * nx * nx + across * nx * ny
        return total

    return press
