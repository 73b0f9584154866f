"""The faces of cracks: a rule along them, and the jump of the displacement at its points as a matrix on the dofs.

A crack is cut into pieces, one for each cell that it passes; along an edge, the piece belongs to the cell on the - side. The
jump is the displacement of the + side less that of the - side, normal to the crack and along it: its normal part is the
opening. On segments that end at a tip the rule is Gauss's in the square root of the distance, which is exact for openings of
the modes and for tractions times their slope.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from geofem.materials.kinematics import kernel
from geofem.methods.xfem.basis import World, dofs_of, enriched, hat_gradients, hats, scratch, width_of
from geofem.methods.xfem.enrichment import CellEntries
from geofem.methods.xfem.geometry import Lines, Touch
from geofem.methods.xfem.rules import Rule, double_area
from geofem.scene import Array

POINTS = 8
"""Gauss points on each piece: functions of a tip are no polynomials."""
OFF = 1e-9
"""The sides of a crack are told apart this part of a cell's size off it; pieces shorter than that are left out."""


class Faces(NamedTuple):
    """The faces of all cracks in this rank's cells.

    rule : by pieces, weights are lengths (m). crack : (n,) number of the crack at each point. segment : (n,) of ``Lines``.
    normal : (n, 2) unit vectors from the - to the + side. arc : (n,) length (m) of the crack from its first point.
    jump : (2 n, local dofs) matrix: of each point the jump normal to the crack, then along its way.
    """

    rule: Rule
    crack: Array
    segment: Array
    normal: Array
    arc: Array
    jump: csr_array

    def jumps(self, x: Array) -> Array:
        """The jumps (n, 2), normal and along (m); x : local dofs."""
        return (self.jump @ x).reshape(-1, 2)

    def force(self, traction: Array) -> Array:
        """The forces at local dofs of tractions on the + faces (n, 2), normal and along (Pa), and the opposite ones on the - faces."""
        return self.jump.T @ (self.rule.w[:, None] * traction).ravel()

    def vectors(self, local: Array) -> Array:
        """Vectors (n, 2) in the frame of the mesh from their parts (n, 2) normal to the crack and along it."""
        along = np.stack([self.normal[:, 1], -self.normal[:, 0]], axis=1)
        return local[:, :1] * self.normal + local[:, 1:] * along

    def on_side(self, sign: float, size: Array) -> Rule:
        """The rule with its points moved just off the crack, to its + or - side; size : (cells,) of all cells (m)."""
        here = np.repeat(size[self.rule.cells], np.diff(self.rule.start))
        return self.rule._replace(x=self.rule.x + sign * OFF * here[:, None] * self.normal)


def pieces(lines: Lines, tip_points: Array, touch: Touch, X: Array, T: Array) -> tuple[Rule, Array]:
    """The rule along all cracks in the cells that they touch, and the segment of each of its points.

    tip_points : numbers of the points of ``Lines`` that are tips.
    """
    is_tip = np.zeros(len(lines.points) + 1, bool)
    is_tip[tip_points] = True
    gauss, weight = np.polynomial.legendre.leggauss(POINTS)
    cells, segment, x, w = along_cracks(lines, is_tip, touch, X, T, 0.5 * (gauss + 1.0), 0.5 * weight)
    return Rule(cells, POINTS * np.arange(len(cells) + 1), x, w), np.repeat(segment, POINTS)


def faces_of(rule: Rule, segment: Array, acting: CellEntries, world: World, dofs: int) -> Faces:
    """The faces with the jump of the basis; acting : the entries in the cells of the rule. dofs : number of local ones."""
    lines = world.lines
    along = lines.points[segment + 1] - lines.points[segment]
    length = np.hypot(*along.T)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / length[:, None]
    start = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(lines.points, axis=0).T))])
    crack = np.searchsorted(lines.start, segment, side="right") - 1
    arc = start[segment] - start[lines.start[crack]] + np.hypot(*(rule.x - lines.points[segment]).T)
    first, column, value = jump_rows(rule, normal, acting, world)
    jump = csr_array((value, column, first), shape=(2 * len(rule.w), dofs))
    return Faces(rule, crack, segment, normal, arc, jump)


@kernel
def along_cracks(
    lines: Lines, is_tip: Array, touch: Touch, X: Array, T: Array, gauss: Array, weight: Array
) -> tuple[Array, Array, Array, Array]:
    """Cell and segment of each piece, and the points and weights on them, ``gauss`` and ``weight`` being a rule on (0, 1)."""
    most = touch.segment.shape[0]
    cells, segment = np.empty(most, np.int64), np.empty(most, np.int64)
    points = gauss.shape[0]
    x, w = np.empty((most * points, 2)), np.empty(most * points)
    corners = np.empty((3, 2))
    n = 0
    for k in range(touch.cells.shape[0]):
        for v in range(3):
            corners[v] = X[T[touch.cells[k], v]]
        size = np.sqrt(double_area(corners))
        for j in range(touch.start[k], touch.start[k + 1]):
            s = touch.segment[j]
            a, b = lines.points[s], lines.points[s + 1]
            first, last = within(a, b, corners)
            length = np.hypot(b[0] - a[0], b[1] - a[1])
            if (last - first) * length <= OFF * size or elsewhere(a, b, 0.5 * (first + last), corners):
                continue
            head, tail = is_tip[s], is_tip[s + 1]
            if head and tail:
                head = first + last < 1.0
                tail = not head
            for q in range(points):
                if head or tail:
                    # r = z^2, r being the distance to the tip
                    near, far = (first, last) if head else (1.0 - last, 1.0 - first)
                    root = np.sqrt(near) + gauss[q] * (np.sqrt(far) - np.sqrt(near))
                    part = root * root if head else 1.0 - root * root
                    w[n * points + q] = weight[q] * 2.0 * root * (np.sqrt(far) - np.sqrt(near)) * length
                else:
                    part = first + gauss[q] * (last - first)
                    w[n * points + q] = weight[q] * (last - first) * length
                for i in range(2):
                    x[n * points + q, i] = a[i] + part * (b[i] - a[i])
            cells[n], segment[n] = touch.cells[k], s
            n += 1
    return cells[:n], segment[:n], x[: n * points], w[: n * points]


@kernel
def within(a: Array, b: Array, corners: Array) -> tuple[float, float]:
    """Where on the segment from a (0) to b (1) the triangle begins and ends, so that neighbours neither overlap nor leave a gap."""
    double = double_area(corners)
    first, last = 0.0, 1.0
    for v in range(3):
        p, q = corners[v], corners[(v + 1) % 3]
        at_a = ((q[0] - p[0]) * (a[1] - p[1]) - (q[1] - p[1]) * (a[0] - p[0])) / double
        at_b = ((q[0] - p[0]) * (b[1] - p[1]) - (q[1] - p[1]) * (b[0] - p[0])) / double
        if max(at_a, at_b) < OFF:
            # outside, or along the edge
            if min(at_a, at_b) < -OFF:
                return 0.0, 0.0
        elif at_a < 0.0:
            first = max(first, at_a / (at_a - at_b))
        elif at_b < 0.0:
            last = min(last, at_a / (at_a - at_b))
    return first, last


@kernel
def elsewhere(a: Array, b: Array, part: float, corners: Array) -> bool:
    """True if the segment from a to b runs along an edge of the triangle there, which lies on its left: the next cell has the piece."""
    x, y = a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1])
    double = double_area(corners)
    for v in range(3):
        p, q = corners[v], corners[(v + 1) % 3]
        height = ((q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0])) / double
        if height < OFF:
            r = corners[(v + 2) % 3]
            return (b[0] - a[0]) * (r[1] - a[1]) - (b[1] - a[1]) * (r[0] - a[0]) > 0.0
    return False


@kernel
def jump_rows(rule: Rule, normal: Array, acting: CellEntries, world: World) -> tuple[Array, Array, Array]:
    """The matrix of ``Faces.jump`` by rows: first (2 n + 1,), column and value."""
    size, widest = 0, 0
    for k in range(rule.cells.shape[0]):
        width = width_of(k, acting, world)
        size += 2 * width * (rule.start[k + 1] - rule.start[k])
        widest = max(widest, width)
    first, column, value = np.zeros(2 * rule.w.shape[0] + 1, np.int64), np.empty(size, np.int64), np.empty(size)
    up, down, G = np.empty((widest, 2)), np.empty((widest, 2)), np.empty((widest, 2, 2))
    dofs = np.empty(widest + 6, np.int64)
    s = scratch()
    filled = 0
    for k in range(rule.cells.shape[0]):
        cell = rule.cells[k]
        n = dofs_of(k, cell, acting, world, dofs)
        hat_gradients(cell, world, s.dN)
        off = OFF / np.sqrt(abs(s.dN[1, 0] * s.dN[2, 1] - s.dN[1, 1] * s.dN[2, 0]))
        for q in range(rule.start[k], rule.start[k + 1]):
            x, y = rule.x[q]
            nx, ny = normal[q]
            hats(x, y, cell, world, s)
            enriched(x + off * nx, y + off * ny, k, acting, world, s, up, G)
            enriched(x - off * nx, y - off * ny, k, acting, world, s, down, G)
            for i in range(2):
                ex, ey = (nx, ny) if i == 0 else (ny, -nx)
                for a in range(6, n):
                    column[filled] = dofs[a]
                    value[filled] = ex * (up[a - 6, 0] - down[a - 6, 0]) + ey * (up[a - 6, 1] - down[a - 6, 1])
                    filled += 1
                first[2 * q + i + 1] = filled
    return first, column, value
