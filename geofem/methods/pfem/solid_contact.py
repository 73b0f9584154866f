"""Nodes that touch walls and rigid bodies: a penalty of many times the material's stiffness, and Coulomb's friction.

A boundary node belongs to the face whose plane it is farthest in front of at the start of a step, so that a node that slides past a
corner changes its face with the step. In front of it there is no force; behind it the depth and the tangential way since it
touched are springs, whose tangential force is at most the friction times the normal one. With ``STIFF`` times the moduli per
node (Pa in the plane), a node sinks in by a few ten-thousandths of the spacing under a pressure of some strengths.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from geofem.methods.pfem.cloud import Cloud
from geofem.methods.pfem.contact import Convex, planes_of
from geofem.scene import Array, Rigid, Scene, Wall

STIFF = 10.0
CORNER, REACH = 0.05, 2.0
"""In sizes: how far in front of another face a node must be to change to it, and how far off nodes may touch in a step."""


@dataclass(frozen=True)
class Obstacle:
    """A wall, of one face, or a rigid body.

    normals : (k, 2) out of the obstacle. points : (k, 2) of the faces at t = 0.
    """

    name: str
    friction: float
    normals: Array
    points: Array
    source: Wall | Rigid

    def shift(self, t: float) -> Array:
        """How far it has moved since t = 0 (m)."""
        if isinstance(self.source, Rigid) and self.source.motion is not None:
            return np.asarray(self.source.motion(t), float)
        return np.zeros(2)

    def distances(self, x: Array, t: float) -> Array:
        """Of positions (n, 2) in front of each face (n, k)."""
        return np.einsum("kj,nkj->nk", self.normals, x[:, None] - (self.points + self.shift(t)))


def obstacles(scene: Scene, cloud: Cloud) -> list[Obstacle]:
    """The walls and rigid bodies of a scene."""
    out = []
    for wall, plane in zip(scene.walls, planes_of(scene.walls, scene, cloud)):
        point = np.zeros(2)
        point[plane.axis] = plane.place
        out.append(Obstacle(wall.name, wall.friction, plane.normal[None], point[None], wall))
    for rigid in scene.rigids:
        convex = Convex(rigid)
        out.append(Obstacle(rigid.name, rigid.friction, convex.normals, convex.corners, rigid))
    return out


@dataclass
class Touch:
    """The contact of the nodes with one obstacle in a step.

    nodes : (k,) that may touch, each a face, with its normal (k, 2). start : (k,) distance (m) before the step, slip : (k, 2) the
        tangential spring (m).
    force : (k, 2) on the nodes, as last evaluated; stretch : (k, 2) the spring that goes with it. move : (2,) of the obstacle.
    """

    obstacle: Obstacle
    nodes: Array
    face: Array
    normal: Array
    start: Array
    slip: Array
    move: Array
    stiffness: Array
    force: Array
    stretch: Array

    def remember(self, n: int) -> Array:
        """(n, 3) of all nodes for the next step: the tangential spring (m) and one more than the face, 0 where nothing touches."""
        out = np.zeros((n, 3))
        touching = np.any(self.force != 0.0, axis=1)
        out[self.nodes[touching]] = np.column_stack([self.stretch, self.face + 1.0])[touching]
        return out

    def evaluate(self, du: Array) -> Array:
        """Forces on the nodes for the displacement du (n, 2) in this step; returns their stiffness (k, 2, 2)."""
        u = du[self.nodes] - self.move
        depth = self.start + np.einsum("kj,kj->k", self.normal, u)
        touching = depth < 0.0
        pressure = np.where(touching, -self.stiffness * depth, 0.0)
        outer = self.normal[:, :, None] * self.normal[:, None, :]
        along = np.eye(2) - outer
        spring = self.slip + np.einsum("kij,kj->ki", along, u)
        trial = self.stiffness * np.linalg.norm(spring, axis=1)
        most = np.where(touching, self.obstacle.friction * pressure if self.obstacle.friction < math.inf else math.inf, 0.0)
        stuck = touching & (trial <= most)
        ratio = np.where(stuck, 1.0, np.divide(most, trial, out=np.zeros_like(trial), where=(trial > most) & touching))
        self.stretch = spring * ratio[:, None]
        self.force = pressure[:, None] * self.normal - self.stiffness[:, None] * self.stretch
        blocks = np.where(touching, self.stiffness, 0.0)[:, None, None] * outer
        blocks += np.where(stuck, self.stiffness, 0.0)[:, None, None] * along
        sliding = touching & ~stuck & (trial > 0)
        if self.obstacle.friction > 0 and sliding.any():
            way = spring / np.maximum(np.linalg.norm(spring, axis=1), 1e-300)[:, None]
            turn = self.obstacle.friction * self.stiffness[:, None, None] * way[:, :, None] * self.normal[:, None, :]
            blocks -= np.where(sliding[:, None, None], turn, 0.0)
        return blocks


def begin(
    obstacle: Obstacle, x: Array, t0: float, t1: float, nodes: Array, memory: Array, stiffness: Array, size: Array
) -> Touch:
    """The contact of the ``nodes`` at x (n, 2) with an obstacle in the step from t0 to t1, but for those far off.

    memory : (n, 3) what ``remember`` left. size : (n,) spacing (m).
    """
    distance = obstacle.distances(x[nodes], t0)
    face = np.argmax(distance, axis=1)
    every = np.arange(len(nodes))
    # a node at a corner keeps its face until it is clearly in front of another one; a new node between two faces has none
    old = np.rint(memory[nodes, 2]).astype(int) - 1
    known = (old >= 0) & (np.abs(memory[nodes, 2] - 1 - old) < 1e-9) & (distance.max(axis=1) < CORNER * size[nodes])
    face = np.where(known, old, face)
    start = distance[every, face]
    move = obstacle.shift(t1) - obstacle.shift(t0)
    near = start < REACH * size[nodes] + np.linalg.norm(move)
    nodes, face, start = nodes[near], face[near], start[near]
    return Touch(obstacle, nodes, face, obstacle.normals[face], start, memory[nodes, :2], move, stiffness[nodes],
                 np.zeros((len(nodes), 2)), np.zeros((len(nodes), 2)))  # fmt: skip
