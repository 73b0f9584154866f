"""Prescribed displacements on a boundary that cracks may cut.

With the shift, standard dofs are the displacements of nodes. Where a crack cuts a supported edge, the jump of the node on
its one side is what lets the displacement on the other side be prescribed: it is chosen so that both parts of the edge
carry the linear interpolants of the given displacement. Tip functions vanish at nodes, and are held at zero on supports.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from dolfinx import fem

from geofem.core.mesh import Body, facets
from geofem.methods.xfem.basis import World
from geofem.methods.xfem.enrichment import JUMP, WIDTH, Enrichment
from geofem.methods.xfem.geometry import TOUCH, sides
from geofem.methods.xfem.grid import Grid, boundary_edges
from geofem.methods.xfem.system import Numbering
from geofem.scene import Array, Scene, Support

SHORT = 1e-6
"""Where a crack leaves less than this part of an edge on one side, the displacement of that part is not prescribed."""
INWARD = 1e-3
"""The displacement next to a crack is taken at this part of the way from the crack to the next node."""


class CutEdge(NamedTuple):
    """An edge that a crack cuts: its node with the jump and the one beyond the cut, a place (2,) just beyond the cut and the
    share of the edge from there on, the jump's first local dof, and how much its function jumps across the cut."""

    node: int
    beyond: int
    place: Array
    share: float
    dof: int
    jump: float


class Supports:
    """The prescribed dofs of a scene and their values at any time.

    dofs : (k,) local numbers of owned dofs, sorted. Made collectively.
    """

    def __init__(self, scene: Scene, body: Body, grid: Grid, enrichment: Enrichment, world: World, numbering: Numbering):
        self.grid, self.enrichment, self.world, self.numbering = grid, enrichment, world, numbering
        self.supports = scene.supports
        self._where = [facets(body, s.where, f"support {s.name!r}") for s in scene.supports]
        self._edges = [boundary_edges(grid, found) for found in self._where]
        self._nodes = [
            fem.locate_dofs_topological(grid.space, 1, found.astype(np.int32)).astype(np.int64) for found in self._where
        ]
        self._positions = self._off_cracks()
        self._cuts = [list(self._cut_edges(edges)) for edges in self._edges]
        self.dofs = np.array(sorted(self._given(0.0)), np.int64)

    def values(self, t: float) -> Array:
        """The values of ``dofs`` at time t. Collective."""
        given = self._given(t)
        return np.array([given[dof] for dof in self.dofs.tolist()])

    def owned_of(self, support: Support, component: int) -> Array:
        """The owned standard dofs that a support holds in one direction."""
        nodes = self._nodes[self.supports.index(support)]
        return 2 * nodes[nodes < self.grid.owned] + component

    def _off_cracks(self) -> Array:
        """Where to ask for the displacement of each node: nodes on a crack lie on its + side."""
        grid, x = self.grid, self.grid.X.copy()
        edge = np.unique(np.concatenate([*self._nodes, np.empty(0, np.int64)]))
        for c in range(len(self.world.lines.start) - 1):
            x[edge] = sides(x[edge], self.world.lines, c, TOUCH * np.sqrt(grid.support[edge]))[1]
        return x

    def _given(self, t: float) -> dict[int, float]:
        """The values of all prescribed owned dofs by their local number. Collective."""
        out: dict[int, float] = {}
        sent: dict[int, float] = {}
        for support, nodes, cuts in zip(self.supports, self._nodes, self._cuts):
            value = self._value(support, t)
            for component in support.components:
                at = value(self._positions[nodes])
                out.update((2 * n + component, v) for n, v in zip(nodes.tolist(), at.tolist()) if n < self.grid.owned)
            self._hold_tips(nodes, out)
            if cuts:
                near = value(np.array([cut.place for cut in cuts]))
                far = value(self._positions[[cut.beyond for cut in cuts]])
                own = value(self._positions[[cut.node for cut in cuts]])
                for cut, v_near, v_far, v_own in zip(cuts, near, far, own):
                    continued = v_far + (v_near - v_far) / cut.share
                    for component in support.components:
                        sent[int(self.numbering.to_global[cut.dof + component])] = (continued - v_own) / cut.jump
        first, owned = self.numbering.first, self.numbering.owned
        for part in self.grid.comm.allgather(sent):
            for number, v in part.items():
                if first <= number < first + owned:
                    out[int(self.numbering.local_owned[number - first])] = float(v)
        return out

    def _value(self, support: Support, t: float) -> Callable[[Array], Array]:
        """The prescribed displacement at time t, as a function of positions (n, 2)."""
        if support.value is None:
            return lambda x: np.zeros(len(x))
        given = support.value
        return lambda x: np.broadcast_to(np.asarray(given(x.T, t), float), len(x))

    def _hold_tips(self, nodes: Array, out: dict[int, float]) -> None:
        """Put zeros for the dofs of tip functions at the nodes into ``out``."""
        entries, functions = self.enrichment.entries, self.enrichment.functions
        for n in nodes[nodes < self.grid.owned].tolist():
            for e in range(entries.start[n], entries.start[n + 1]):
                kind = functions.kind[entries.function[e]]
                if kind != JUMP:
                    out.update((2 * len(self.grid.X) + int(entries.dof[e]) + j, 0.0) for j in range(WIDTH[kind]))

    def _cut_edges(self, edges: Array) -> Iterator[CutEdge]:
        """Those of the edges that a crack cuts, from the side of each node that carries its jump."""
        entries, functions = self.enrichment.entries, self.enrichment.functions
        lines, X = self.world.lines, self.grid.X
        for a, b in edges.tolist():
            for i, j in ((a, b), (b, a)):
                for e in range(entries.start[i], entries.start[i + 1]):
                    f = entries.function[e]
                    if functions.kind[f] != JUMP:
                        continue
                    slack = TOUCH * np.sqrt(self.grid.support[[j]])
                    own, other = entries.value[e, 0], sides(X[[j]], lines, int(f), slack)[0][0]
                    cut = crossing(X[i], X[j], lines.points[lines.start[f] : lines.start[f + 1]])
                    if own == other or cut is None or 1.0 - cut < SHORT:
                        continue
                    place = cut + INWARD * (1.0 - cut)
                    dof = 2 * len(X) + int(entries.dof[e])
                    yield CutEdge(i, j, X[i] + place * (X[j] - X[i]), 1.0 - place, dof, 0.5 * (other - own))


def crossing(a: Array, b: Array, polyline: Array) -> float | None:
    """Where a polyline (n, 2) first crosses the segment from a to b, 0 at a and 1 at b; None if it does not."""
    return min(crossings(a, b, polyline), default=None)


def crossings(a: Array, b: Array, polyline: Array) -> list[float]:
    """All places where a polyline (n, 2) crosses the segment from a to b, 0 at a and 1 at b."""
    edge = b - a
    found = []
    for p, q in zip(polyline, polyline[1:]):
        along = q - p
        det = edge[0] * along[1] - edge[1] * along[0]
        if det == 0.0:
            continue
        t = ((p - a)[0] * along[1] - (p - a)[1] * along[0]) / det
        s = ((p - a)[0] * edge[1] - (p - a)[1] * edge[0]) / det
        if -TOUCH <= t <= 1.0 + TOUCH and -TOUCH <= s <= 1.0 + TOUCH:
            found.append(min(max(t, 0.0), 1.0))
    return found
