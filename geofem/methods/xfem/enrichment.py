"""Which nodes carry which enrichment, and the dofs of each.

An enrichment is one function: the jump across one crack, or the near field of one tip. A node carries a list of them, each
an entry with dofs and with the function's value at the node, which is taken off so that the standard dofs stay the nodal
displacements (the shift). Kinds:

JUMP : N_i (H - H_i) / 2, H = +-1 by the side of the crack; two dofs, the components. Of a crack that ends on another one, the
    function is 0 beyond that one, see ``junctions``. H_i is free for nodes there: it is the side that holds more of their support,
    so that the function lives on the smaller one, and its overlap with the function of the other crack stays bounded.
MODES : N_i R (u_m - u_m(x_i)), m = I, II: the displacement fields of the two modes themselves; two dofs, like K_I and K_II.
BRANCHES : N_i R (f_j - f_j(x_i)), the four branches; eight dofs, a pair of components each (Moes, Dolbow and Belytschko 1999).

R is 1, or the sum of N_i over the nodes inside the radius (Fries 2008), which ends the enrichment without parasitic terms.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from geofem.materials.kinematics import kernel
from geofem.methods.xfem.fields import branches_at, modes_at
from geofem.methods.xfem.geometry import TOUCH, Lines, Tips, cells_at, sides
from geofem.methods.xfem.grid import TIE, Grid
from geofem.methods.xfem.junctions import Sectors, part, parts
from geofem.methods.xfem.rules import ONE, Cutter, Triangles, double_area
from geofem.scene import Array

JUMP, MODES, BRANCHES = range(3)
WIDTH = np.array([2, 2, 8])
"""Dofs of an entry of each kind."""
LEAST = 1e-10
"""A node carries a jump only if more than this part of its support lies on the other side."""


@dataclass(frozen=True)
class TipChoice:
    """How tips are enriched: the kind, whether with Fries' ramp, and whether all within a radius or only the cells of the tip."""

    kind: int
    ramp: bool
    disc: bool


TIPS: dict[str, TipChoice | None] = {
    "modes": TipChoice(MODES, ramp=True, disc=True),
    "branches": TipChoice(BRANCHES, ramp=False, disc=True),
    "corrected": TipChoice(BRANCHES, ramp=True, disc=True),
    "topological": TipChoice(BRANCHES, ramp=False, disc=False),
    "heaviside": None,
}


class Functions(NamedTuple):
    """The enrichment functions, jumps first: kind (n,), of (n,) the number of the crack or tip, ramp (n,), kappa (n,)."""

    kind: Array
    of: Array
    ramp: Array
    kappa: Array


class Entries(NamedTuple):
    """The entries of node i are start[i] to start[i + 1], sorted by function.

    function (n,). dof (n,) first local number among the enriched ones. value (n, 4) of the function at the node: the side, the
    two modes' components or the four branches. ramp (n,) R at the node.
    """

    start: Array
    function: Array
    dof: Array
    value: Array
    ramp: Array


class Enrichment:
    """The entries of all nodes of a grid, the same on every rank that knows the node.

    functions, entries : see there. dofs : local number of enriched dofs; the owned ones come first.
    parted : (touched cells, cracks), where a crack's function is not zero: 1 on its - side, 2 on its + side, 3 on both.
    """

    def __init__(
        self, grid: Grid, sectors: Sectors, tips: Tips, cutter: Cutter, choice: TipChoice | None, radius: Array, kappa: Array
    ):
        lines = cutter.lines
        self.grid, self.lines, self.sectors, self.tips = grid, lines, sectors, tips
        cracks = len(lines.start) - 1
        self.parted = np.zeros((len(cutter.touch.cells), cracks), np.int64)
        near = [self._near_tip(t) for t in range(len(tips.turn))]
        # within a disc, modes open the crack next to its tip, and a jump there would depend on them: the condition grows by half
        apart = [held if choice is not None and choice.disc else inside for held, inside in near]
        parts = [self._jump(c, cutter, apart) for c in range(cracks)]
        kinds, of, ramps = [JUMP] * cracks, list(range(cracks)), [False] * cracks
        if choice is not None:
            for t in range(len(tips.turn)):
                parts.append(self._tip(t, cracks + t, choice, near[t][0], radius[t], kappa[t]))
                kinds.append(choice.kind)
                of.append(t)
                ramps.append(choice.ramp)
        every = np.concatenate([np.ones(cracks), kappa]) if choice is not None else np.ones(cracks)
        self.functions = Functions(np.array(kinds, np.int64), np.array(of, np.int64), np.array(ramps, bool), every)
        self._number(parts)

    def _near_tip(self, t: int) -> tuple[Array, Array]:
        """Nodes of the cells that hold a tip, and those whose support has it inside and not on its rim, (nodes,) bool. Collective."""
        grid, at = self.grid, self.tips.at[t]
        cells = cells_at(grid, at)
        nodes = grid.T[cells].ravel()
        corners = grid.X[grid.T[cells]]
        hats = np.empty((len(cells), 3))
        for v in range(3):
            along, to = corners[:, (v + 2) % 3] - corners[:, (v + 1) % 3], at - corners[:, (v + 1) % 3]
            hats[:, v] = 0.5 * (along[:, 0] * to[:, 1] - along[:, 1] * to[:, 0]) / grid.area[cells]
        inside = (hats > 10.0 * TOUCH).ravel().astype(float)
        return grid.sum_to_nodes(nodes, np.ones(len(nodes))) > 0.0, grid.sum_to_nodes(nodes, inside) > 0.0

    def _jump(self, c: int, cutter: Cutter, apart: list[Array]) -> tuple[Array, int, Array, Array]:
        """Nodes, function, values and ramps of the entries of one crack's jump. Collective.

        apart : per tip, the nodes without jump (nodes,), among them all whose support has the tip inside: it is not parted.
        """
        grid = self.grid
        cells = jump_cells(cutter, self.sectors, c)
        plus, minus = areas(cutter.triangles(cells, np.full(len(cells), ONE)), self.lines, self.sectors, c)
        least = 1e-13 * grid.area[cells]
        self.parted[cutter.place[cells], c] = (minus > least) + 2 * (plus > least)
        nodes = grid.T[cells]
        of_plus, of_minus = (grid.sum_to_nodes(nodes.ravel(), np.repeat(area, 3)) for area in (plus, minus))
        near = np.flatnonzero(of_plus + of_minus > 0.0)  # also nodes whose cells there are another rank's
        own = np.ones(len(grid.X))
        own[near] = self._own_sides(near, c, of_plus[near], of_minus[near])
        chosen = np.where(own > 0, of_minus, of_plus) > LEAST * grid.support
        for t in np.flatnonzero(self.tips.crack == c):
            chosen &= ~apart[t]
        found = np.flatnonzero(chosen)
        values = np.zeros((len(found), 4))
        values[:, 0] = own[found]
        return found, c, values, np.ones(len(found))

    def _own_sides(self, nodes: Array, c: int, plus: Array, minus: Array) -> Array:
        """The side of each node, +-1; of those that lie on neither, the one that has more of their support: plus or minus (nodes,)."""
        x, slack, sectors = self.grid.X[nodes], TOUCH * np.sqrt(self.grid.support[nodes]), self.sectors
        if not sectors.joined[c].any():
            return sides(x, self.lines, c, slack)[0]
        here = parts(x, self.lines, sectors, c)
        # a node on both borders lies on the crack, so on its + side, and one on either of them on the other crack
        first, second = ((sides(x, border, c, slack)[1] != x).any(axis=1) for border in (sectors.plus, sectors.minus))
        here[first != second] = 0.0
        here[first & second] = 1.0
        return np.where(here == 0.0, np.where(minus > (1.0 + TIE) * plus, -1.0, 1.0), here)

    def _tip(
        self, t: int, function: int, choice: TipChoice, held: Array, radius: float, kappa: float
    ) -> tuple[Array, int, Array, Array]:
        """Nodes, function, values and ramps of the entries of one tip. Collective."""
        grid, tips = self.grid, self.tips
        inside = held.copy()
        if choice.disc:
            inside |= np.hypot(*(grid.X - tips.at[t]).T) < (1.0 + TIE) * radius
        chosen = inside
        if choice.ramp:
            cells = np.flatnonzero(inside[grid.T].any(axis=1))
            nodes = grid.T[cells].ravel()
            chosen = grid.sum_to_nodes(nodes, np.ones(len(nodes))) > 0.0
        found = np.flatnonzero(chosen)
        slack = TOUCH * np.sqrt(grid.support[found])
        x = sides(grid.X[found], self.lines, tips.crack[t], slack)[1]
        if choice.kind == MODES:
            values = modes_at(x, self.lines, tips, t, kappa)[0].reshape(-1, 4)
        else:
            values = branches_at(x, self.lines, tips, t)
        return found, function, values, inside[found].astype(float)

    def _number(self, parts: list[tuple[Array, int, Array, Array]]) -> None:
        """Sort the entries by node and function, and number their dofs: first those of owned nodes, as nodes are sorted so."""
        parts = [*parts, (np.empty(0, np.int64), 0, np.empty((0, 4)), np.empty(0))]  # there may be no crack
        node = np.concatenate([p[0] for p in parts])
        function = np.concatenate([np.full(len(p[0]), p[1], np.int64) for p in parts])
        order = np.lexsort((function, node))
        node, function = node[order], function[order]
        width = WIDTH[self.functions.kind[function]]
        dof = np.cumsum(width) - width
        start = np.searchsorted(node, np.arange(len(self.grid.X) + 1)).astype(np.int64)
        self.entries = Entries(
            start, function, dof, np.concatenate([p[2] for p in parts])[order], np.concatenate([p[3] for p in parts])[order]
        )
        self.node = node
        self.dofs = int(width.sum())
        self.owned = int(width[node < self.grid.owned].sum())

    def first_dofs(self) -> Array:
        """The local number of the first enriched dof of each node, (nodes,); of the next one if it has none."""
        return np.append(self.entries.dof, self.dofs)[self.entries.start[:-1]]


class CellEntries(NamedTuple):
    """The entries that act in cells (m,): start (m + 1,), and of each its place, vertex (k,) and entry (k,), sorted by function."""

    start: Array
    vertex: Array
    entry: Array


@kernel
def entries_of(cells: Array, T: Array, entries: Entries, functions: Functions, place: Array, parted: Array) -> CellEntries:
    """The entries that are not zero in the given cells.

    place : (cells,) row of each cell in ``parted``, -1 if no crack touches it. parted : of ``Enrichment``.
    """
    start = np.zeros(cells.shape[0] + 1, np.int64)
    vertex, entry = np.empty(4 * cells.shape[0] + 64, np.int64), np.empty(4 * cells.shape[0] + 64, np.int64)
    n = 0
    for k in range(cells.shape[0]):
        nodes = T[cells[k]]
        while n + 3 * functions.kind.shape[0] > entry.shape[0]:
            vertex, entry = np.concatenate((vertex, np.empty_like(vertex))), np.concatenate((entry, np.empty_like(entry)))
        first = n
        for v in range(3):
            for e in range(entries.start[nodes[v]], entries.start[nodes[v] + 1]):
                f = entries.function[e]
                if functions.kind[f] == JUMP:
                    row = place[cells[k]]
                    if row < 0:
                        continue
                    # bit 1: the cell has a part on the - side, bit 2: on the + side
                    if parted[row, f] & (1 if entries.value[e, 0] > 0.0 else 2) == 0:
                        continue
                elif functions.ramp[f]:
                    ramp = 0.0
                    for i in range(3):
                        for other in range(entries.start[nodes[i]], entries.start[nodes[i] + 1]):
                            if entries.function[other] == f:
                                ramp += entries.ramp[other]
                    if ramp == 0.0:
                        continue
                # insertion sort by function
                p = n
                while p > first and entries.function[entry[p - 1]] > f:
                    vertex[p], entry[p] = vertex[p - 1], entry[p - 1]
                    p -= 1
                vertex[p], entry[p] = v, e
                n += 1
        start[k + 1] = n
    return CellEntries(start, vertex[:n], entry[:n])


def crack_cells(cutter: Cutter, c: int) -> Array:
    """The cells of this rank that crack c touches."""
    touch, lines = cutter.touch, cutter.lines
    mine = (touch.segment >= lines.start[c]) & (touch.segment < lines.start[c + 1] - 1)
    owner = np.repeat(np.arange(len(touch.cells)), np.diff(touch.start))
    return touch.cells[np.unique(owner[mine])]


def jump_cells(cutter: Cutter, sectors: Sectors, c: int) -> Array:
    """The cells of this rank where the jump of crack c may act. Collective.

    Those that it touches, and if it ends on another crack, those of that one around them, where nodes beyond it see its sectors.
    """
    grid, cells = cutter.grid, crack_cells(cutter, c)
    if not sectors.joined[c].any():
        return cells
    nodes = grid.T[cells].ravel()
    around = grid.sum_to_nodes(nodes, np.ones(len(nodes))) > 0.0
    others = cutter.touch.cells
    return others[around[grid.T[others]].any(axis=1)]


@kernel
def areas(triangles: Triangles, lines: Lines, sectors: Sectors, crack: int) -> tuple[Array, Array]:
    """The area of each cell on the + and on the - side of a crack, see ``part``."""
    cells = triangles.start.shape[0] - 1
    plus, minus = np.zeros(cells), np.zeros(cells)
    for k in range(cells):
        for t in range(triangles.start[k], triangles.start[k + 1]):
            corners = triangles.corners[t]
            x = (corners[0, 0] + corners[1, 0] + corners[2, 0]) / 3.0
            y = (corners[0, 1] + corners[1, 1] + corners[2, 1]) / 3.0
            here = part(x, y, lines, sectors, crack)
            if here > 0.0:
                plus[k] += 0.5 * double_area(corners)
            elif here < 0.0:
                minus[k] += 0.5 * double_area(corners)
    return plus, minus
