"""Supports and walls of a load step at rest: which nodal increments are prescribed, and which nodes a wall stops."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from geofem.methods.mpm.conditions import Held, Walls
from geofem.methods.mpm.system import System
from geofem.scene import Array, Scene

FREE, SLIDING, STICKING = 0, 1, 2
SLACK = 1e-9
"""Pull on a wall, as a share of the forces in balance, and motion into it, by the size of a cell, that are rounding."""


class Limits:
    """Supports and walls on the nodes of the grid's window.

    modes : of each node of each wall: free, sliding (only its normal component is held) or sticking. They are found by going round:
    solve, let go what the wall would have to pull, stop what moves into it, let slip what friction cannot hold (an active-set method).
    """

    def __init__(self, scene: Scene, coordinates: Array, mine: Array):
        self.supports, self.walls = Held(scene, coordinates, mine), Walls(scene, coordinates, mine)
        self.dim = scene.gdim
        self.modes = np.full(len(self.walls.arrays[0]), STICKING)

    def follow(self, t0: float, t1: float) -> None:
        self.supports.follow(t0, t1, 1.0)

    def apply(self, system: System) -> None:
        """Tell the system what is held now, and the friction of nodes that slide."""
        dofs, values = [], []
        node, component, increment, _, _ = self.supports.arrays
        block = system.dof_of_node[node]
        there = block >= 0
        dofs.append(block[there] * self.dim + component[there])
        values.append(increment[there])
        node, axis, _, friction, force, _ = self.walls.arrays
        block = system.dof_of_node[node]
        system.nodal[:] = 0.0
        for c in range(self.dim):
            held = (block >= 0) & ((self.modes == STICKING) & (friction > 0.0) | (self.modes != FREE) & (axis == c))
            dofs.append(block[held] * self.dim + c)
            values.append(np.zeros(int(held.sum())))
            slides = (block >= 0) & (self.modes == SLIDING) & (axis != c)
            # every rank has the node: it is the owner's force that counts
            system.nodal[block[slides], c] += force[slides, c]
        system.hold(np.concatenate(dofs), np.concatenate(values))

    def review(self, system: System, tolerance: float) -> bool:
        """Reactions of the last solution; True if walls ask for another one. Collective."""
        self._react(system)
        node, axis, sign, friction, force, mine = self.walls.arrays
        if not system.comm.allreduce(len(node)):
            return False
        block = system.dof_of_node[node]
        there = block >= 0
        du = system.unknown.x.array.reshape(-1, self.dim)
        rows = np.arange(len(node))
        into = np.where(there, -sign * du[block, axis], 0.0)
        out = np.where(there, system.force[block, axis] * sign, 0.0)
        modes = self.modes.copy()
        pulled = (modes != FREE) & (out < -SLACK * system.scale)
        modes[pulled] = FREE
        modes[(modes == FREE) & ~pulled & (into > SLACK * system.background.grid.h)] = STICKING
        needed = system.force[block].copy()
        needed[rows, axis] = 0.0
        size, most = np.linalg.norm(needed, axis=1), friction * np.maximum(out, 0.0)
        slips = there & (modes == STICKING) & (friction < 1e300) & (size > most)
        modes[slips] = SLIDING
        was = force.copy()
        force[:] = np.where(there[:, None] & (modes != FREE)[:, None], system.force[block], 0.0)
        slides = modes == SLIDING
        along = np.where((size > 0) & (self.modes == STICKING), 1.0, 0.0)[:, None] * needed
        # a node that slides already keeps the direction of its friction
        before = was.copy()
        before[rows, axis] = 0.0
        along = np.where((self.modes == SLIDING)[:, None], before, along)
        length = np.linalg.norm(along, axis=1)
        along = along * np.where(length > 0, most / np.where(length > 0, length, 1.0), 0.0)[:, None]
        normal = force[rows, axis].copy()
        force[slides] = along[slides]
        force[rows, axis] = normal
        changed = not np.array_equal(modes, self.modes)
        lagging = float(np.abs(along - before)[slides & mine].max(initial=0.0)) > tolerance * system.scale
        self.modes = modes
        return bool(system.comm.allreduce(changed or lagging, op=MPI.LOR))

    def _react(self, system: System) -> None:
        node, component, _, reaction, _ = self.supports.arrays
        block = system.dof_of_node[node]
        reaction[:] = np.where(block >= 0, system.force[block, component], 0.0)

    def reaction(self, name: str, component: int) -> float:
        """The force (N) of a support or wall on the bodies, at this rank's own nodes."""
        return self.supports.reaction(name, component) + self.walls.reaction(name, component)
