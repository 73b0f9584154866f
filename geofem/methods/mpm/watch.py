"""What is looked after between steps: domains that outgrow their cells are split, and bodies that fall apart are noticed."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from mpi4py import MPI
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from geofem.methods.mpm.kind import Kind
from geofem.methods.mpm.parts import make_neighbours
from geofem.methods.mpm.points import SHIFT, Body
from geofem.methods.mpm.shapes import Shape
from geofem.mistake import Breakdown
from geofem.scene import Array, Scene

WAY = 0.25
"""Cells that the fastest point may go between two looks."""
REDUCTIONS = 20
"""Rounds of the reduction of a lattice; each halves an edge at least."""


class Splitter:
    """Splits points in two along the longest edge of their domain where that is longer than ``longest`` cells; 0 splits none."""

    def __init__(self, kind: Kind, shape: Shape, longest: float):
        self.kind, self.shape, self.longest = kind, shape, longest
        self.total = 0
        self._way = 0.0
        if not shape.spread or kind.small:
            self.longest = 0.0  # a domain that does not stretch does not outgrow its cell

    def edges(self, body: Body, h: float) -> Array:
        """Edge vectors (n, d, d) of the present domains of own points, in cells."""
        d = body.arrays["X"].shape[1]
        place = body.own("domain")
        if self.shape.domain == "corners":
            c = place.reshape(-1, 4, 2) / h
            return 0.5 * np.stack([c[:, 1] + c[:, 2] - c[:, 0] - c[:, 3], c[:, 2] + c[:, 3] - c[:, 0] - c[:, 1]], axis=1)
        F = body.stretch[: body.n]
        full = F.reshape(-1, 3, 3) if d == 3 else F[:, :4].reshape(-1, 2, 2)
        half = place.reshape(-1, d, d) if self.shape.domain == "edges" else place[:, :, None] * np.eye(d)
        return 2.0 * np.einsum("nij,naj->nai", full, half)

    def extent(self, body: Body, h: float) -> float:
        """Half the largest extent of a domain along an axis (cells)."""
        return float(0.5 * np.abs(self.edges(body, h)).sum(axis=1).max(initial=0.0)) if body.n else 0.0

    def check(self, bodies: list[Body], h: float, moved: float, comm: MPI.Intracomm) -> bool:
        """Split what is due; True if any rank did. moved : way of the fastest point since the last call (cells). Collective."""
        if self.longest <= 0:
            return False
        self._way += moved
        if self._way < WAY:
            return False
        self._way = 0.0
        for body in bodies:
            self._reduce(body, h)
        count = sum(self._split(body, h) for body in bodies)
        count = comm.allreduce(count)
        if count:
            self.total = 0
        return count > 0

    def state(self) -> tuple[float, ...]:
        return (self._way,)

    def restore(self, way: float) -> None:
        self._way = way

    def _reduce(self, body: Body, h: float) -> None:
        """Choose the shortest edges for parallelograms that are too long, by Gauss's reduction of their lattice.

        Domains of edges a, b and a, b - k a tile the plane in the same points, with the same areas, for any whole k. Shear would
        else make of every domain a needle with two long edges in almost one direction, from which no gradient can be told.
        """
        if self.shape.domain != "edges" or not body.n:
            return
        now = self.edges(body, h)
        due = np.flatnonzero(np.linalg.norm(now, axis=2).max(axis=1) > self.longest)
        d = now.shape[1]
        born = body.own("domain").reshape(-1, d, d)
        now, new = now[due], born[due]
        rows = np.arange(len(due))
        for _ in range(REDUCTIONS):
            lengths = np.einsum("nai,nai->na", now, now)
            order = np.argsort(lengths, axis=1)
            changed = False
            for i, j in itertools.combinations(range(d), 2):
                short, long = order[:, i], order[:, j]
                k = np.round(np.einsum("ni,ni->n", now[rows, short], now[rows, long]) / lengths[rows, short])
                changed |= bool(k.any())
                for edges in (now, new):
                    edges[rows, long] -= k[:, None] * edges[rows, short]
            if not changed:
                break
        born[due] = new

    def _split(self, body: Body, h: float) -> int:
        """Halve the domains of own points that are too long; mass, momentum and volume are kept. Returns how many."""
        body.N = body.n
        lengths = np.linalg.norm(self.edges(body, h), axis=2)
        along = lengths.argmax(axis=1)
        due = np.flatnonzero(lengths.max(axis=1) > self.longest)
        if not len(due):
            return 0
        fields = {name: values.copy() for name, values in body.pick(due).items()}
        a = along[due]
        ids = fields["id"]
        # the numbers of a point's halves follow from its own, so that they do not depend on the ranks: 2 q + 1 and 2 q + 2 in the
        # binary tree below the point it was born as
        first, second = ids + body.born * (ids // body.born + 1), ids + body.born * (ids // body.born + 2)
        if second.max() >= SHIFT:
            raise Breakdown("volume", "a point was split more often than its number can tell; the body stretches without end")
        new = self._halves(fields, a, h)
        for sign, numbers, half in ((0, first, new[0]), (1, second, new[1])):
            for name, values in half.items():
                fields[name] = values
            fields["id"] = numbers
            if sign == 0:
                for name, values in fields.items():
                    body.arrays[name][due] = values
                fields = {name: values.copy() for name, values in fields.items()}
            else:
                body.add(fields, own=True)
        return len(due)

    def _halves(self, fields: dict[str, Array], a: Array, h: float) -> tuple[dict[str, Array], dict[str, Array]]:
        """What differs between the two halves of points: places, domains, masses and volumes."""
        n, d = fields["x"].shape
        rows = np.arange(n)
        place = fields["domain"].copy()
        F = fields["F"]
        full = F.reshape(-1, 3, 3) if d == 3 else F[:, :4].reshape(-1, 2, 2)
        common = {name: 0.5 * fields[name] for name in ("mass", "volume", "grip")}
        if self.shape.domain == "corners":
            c = place.reshape(-1, 4, 2)
            # edge 0 joins corners 0-1 and 3-2, edge 1 corners 0-3 and 1-2
            low = np.where((a == 0)[:, None, None], c[:, [0, 3]], c[:, [0, 1]])
            high = np.where((a == 0)[:, None, None], c[:, [1, 2]], c[:, [3, 2]])
            middle = 0.5 * (low + high)
            first, second = c.copy(), c.copy()
            zero = a == 0
            first[zero, 1], first[zero, 2] = middle[zero, 0], middle[zero, 1]
            second[zero, 0], second[zero, 3] = middle[zero, 0], middle[zero, 1]
            one = ~zero
            first[one, 3], first[one, 2] = middle[one, 0], middle[one, 1]
            second[one, 0], second[one, 1] = middle[one, 0], middle[one, 1]
            shift = 0.5 * (second.mean(axis=1) - first.mean(axis=1))
            inverse = np.linalg.inv(full)
            back = np.einsum("nij,nj->ni", inverse, shift)
            domains = first.reshape(n, -1), second.reshape(n, -1)
        else:
            edges = place.reshape(-1, d, d) if self.shape.domain == "edges" else place[:, :, None] * np.eye(d)
            back = 0.5 * h * edges[rows, a]
            shift = np.einsum("nij,nj->ni", full, back)
            if self.shape.domain == "edges":
                edges = edges.copy()
                edges[rows, a] *= 0.5
                place = edges.reshape(n, -1)
            else:
                place[rows, a] *= 0.5
            domains = place, place
        made = []
        for sign, domain in zip((-1.0, 1.0), domains):
            half = {"x": fields["x"] + sign * shift, "X": fields["X"] + sign * back, "domain": domain, **common}
            if self.kind.transfer == "apic":
                C = fields["C"].reshape(-1, d, d)
                half["v"] = fields["v"] + sign * np.einsum("nij,nj->ni", C, shift)
                half["spread"] = np.zeros_like(fields["spread"])  # of halves the gradient is known, not the moment
            made.append(half)
        return made[0], made[1]


class Watch:
    """Notices that a body which is to stay whole has fallen apart: that no chain of shared nodes joins all of its points."""

    def __init__(self, scene: Scene, shape: Shape):
        self.on = scene.intact
        self.shape = shape
        self._way = np.inf
        self._start: int | None = None

    def state(self) -> tuple[float, ...]:
        return self._way, -1.0 if self._start is None else float(self._start)

    def restore(self, way: float, start: float) -> None:
        self._way, self._start = way, None if start < 0 else int(start)

    def look(self, model: Any, moved: float) -> None:
        """Raises ``Breakdown("fracture")``. moved : way of the fastest point since the last call (cells). Collective."""
        if not self.on:
            return
        self._way += moved
        if self._way < WAY:
            return
        self._way = 0.0
        pieces = model.comm.bcast(count_pieces(model))
        if self._start is None:
            self._start = pieces
        if pieces > self._start:
            raise Breakdown("fracture", f"the body is in {pieces} pieces that share no node of the grid, at t = {model.t:.4g}")


def count_pieces(model: Any) -> int | None:
    """Pieces of the bodies that share no node of the grid; on rank 0."""
    pairs = []
    lattice = list(model.grid.lattice)
    lattice[7] = 0  # numbers of nodes in the whole lattice
    neighbours = make_neighbours(model.kind)
    for k, body in enumerate(model.bodies):
        out = np.full((body.n, 4096 if model.grid.dim == 3 else 256), -1, np.int64)
        neighbours(body.cloud, body.n, tuple(lattice), out)
        ids = np.broadcast_to(body.own("id")[:, None] * len(model.bodies) + k, out.shape)
        there = out >= 0
        pairs.append(np.column_stack([ids[there], out[there]]))
    told = model.comm.gather(np.concatenate(pairs)) if model.comm.size > 1 else [np.concatenate(pairs)]
    if told is None:
        return None
    table = np.concatenate(told)
    _, points = np.unique(table[:, 0], return_inverse=True)
    _, nodes = np.unique(table[:, 1], return_inverse=True)
    size = points.max() + 1 + nodes.max() + 1
    graph = coo_array((np.ones(len(points)), (points, points.max() + 1 + nodes)), shape=(size, size))
    return int(connected_components(graph, directed=False)[0])
