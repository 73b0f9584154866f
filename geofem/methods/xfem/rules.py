"""Quadrature on cells that cracks cut: convex pieces, their triangles, and Gauss rules on these; polar ones around a tip.

A cell is split by the line of every segment that touches the piece at hand, so that each piece lies on one side of each
crack, also where the crack has a kink inside the cell. Pieces are cut into triangles from a corner, and those with a tip on
them from the tip, where the rule of Duffy (1982) takes the singularity of the gradient away.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import basix
import numpy as np

from geofem.materials.kinematics import kernel
from geofem.methods.xfem.geometry import Lines, Touch
from geofem.methods.xfem.grid import Grid
from geofem.scene import Array

ONE, FAR, NEAR, POLAR = range(4)
"""Kinds of rules: one point, two degrees of exactness, and polar around the first corner."""
FLAT = 1e-14
"""Triangles below this part of a cell's area are left out."""
CLOSE = 0.25
"""Cells nearer to a tip than this part of their size take the polar rule from their nearest point, where the gradient peaks."""
VICINITY = 4.0
"""So many cell sizes around a tip the rule of the higher degree is used."""


@dataclass(frozen=True)
class Degrees:
    """How finely to integrate: degrees of exactness near the tip and farther off, and Gauss points per direction of polar rules."""

    near: int = 8
    far: int = 4
    polar: int = 8


class Rule(NamedTuple):
    """Points x (n, 2) and weights w (n,) of cells (m,): those of cells[k] are start[k] to start[k + 1]."""

    cells: Array
    start: Array
    x: Array
    w: Array


class Triangles(NamedTuple):
    """The triangles (n, 3, 2) that cells are cut into, those of the k-th cell start[k] to start[k + 1], and their kind of rule (n,)."""

    start: Array
    corners: Array
    kind: Array


@cache
def table(degrees: Degrees) -> tuple[Array, Array, Array]:
    """The rules of all kinds on the unit triangle, one after the other: start (5,), points (n, 2), weights (n,)."""
    gauss, weight = np.polynomial.legendre.leggauss(degrees.polar)
    gauss, weight = 0.5 * (gauss + 1.0), 0.5 * weight
    s, t = (a.ravel() for a in np.meshgrid(gauss, gauss, indexing="ij"))
    rules = [basix.make_quadrature(basix.CellType.triangle, d) for d in (1, degrees.far, degrees.near)]
    rules.append((np.stack([s * (1.0 - t), s * t], axis=1), np.outer(weight, weight).ravel() * s))
    start = np.cumsum([0, *(len(w) for _, w in rules)])
    return start, np.concatenate([x for x, _ in rules]), np.concatenate([w for _, w in rules])


class Cutter:
    """Makes rules for any cells of a grid with cracks.

    touch : the cells that cracks touch. tips : (tips, 2) m, the points that get polar rules.
    """

    def __init__(self, grid: Grid, lines: Lines, touch: Touch, tips: Array):
        self.grid, self.lines, self.touch, self.tips = grid, lines, touch, tips
        self.place = np.full(len(grid.T), -1, np.int64)
        self.place[touch.cells] = np.arange(len(touch.cells))

    def triangles(self, cells: Array, kind: Array) -> Triangles:
        """The triangles of the cells (m,); kind (m,) is ONE, FAR or NEAR, and POLAR around a tip unless it is ONE."""
        apex, polar = nearest_tips(cells, self.grid.X, self.grid.T, self.grid.size, self.tips, CLOSE)
        return cut_cells(
            cells, kind, apex, polar & (kind != ONE), self.grid.X, self.grid.T,
            self.lines.points, self.place, self.touch.start, self.touch.segment,
        )  # fmt: skip

    def rule(self, cells: Array, graded: Array | None = None, degrees: Degrees | None = None) -> Rule:
        """The rule of the cells (m,): those with ``graded`` (m,) take the degrees, all others one point per triangle.

        Without ``graded`` all take the degrees.
        """
        kind = np.full(len(cells), FAR)
        for tip in self.tips:
            centre = self.grid.X[self.grid.T[cells]].mean(axis=1)
            kind[np.hypot(*(centre - tip).T) < VICINITY * self.grid.size[cells]] = NEAR
        if graded is not None:
            kind[~graded] = ONE
        triangles = self.triangles(cells, kind)
        return Rule(cells, *points_of(triangles, *table(degrees or Degrees())))


@kernel
def points_of(triangles: Triangles, first: Array, xi: Array, weight: Array) -> tuple[Array, Array, Array]:
    """The points of all triangles: start by cell, x and w; see ``table`` for the rules."""
    cells = triangles.start.shape[0] - 1
    start = np.zeros(cells + 1, np.int64)
    for k in range(cells):
        start[k + 1] = start[k]
        for t in range(triangles.start[k], triangles.start[k + 1]):
            start[k + 1] += first[triangles.kind[t] + 1] - first[triangles.kind[t]]
    x, w = np.empty((start[cells], 2)), np.empty(start[cells])
    n = 0
    for t in range(triangles.start[cells]):
        a, b, c = triangles.corners[t, 0], triangles.corners[t, 1], triangles.corners[t, 2]
        double = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        for q in range(first[triangles.kind[t]], first[triangles.kind[t] + 1]):
            for i in range(2):
                x[n, i] = a[i] + xi[q, 0] * (b[i] - a[i]) + xi[q, 1] * (c[i] - a[i])
            w[n] = weight[q] * double
            n += 1
    return start, x, w


@kernel
def nearest_tips(cells: Array, X: Array, T: Array, size: Array, tips: Array, close: float) -> tuple[Array, Array]:
    """The point of each cell (m, 2) that is nearest to a tip, and whether the tip is closer than ``close`` times the cell's size."""
    apex, near = np.zeros((cells.shape[0], 2)), np.zeros(cells.shape[0], np.bool_)
    for k in range(cells.shape[0]):
        nodes = T[cells[k]]
        least = (close * size[cells[k]]) ** 2
        for t in range(tips.shape[0]):
            x, y = tips[t]
            a = X[nodes[0]]
            if (x - a[0]) ** 2 + (y - a[1]) ** 2 > (8.0 * size[cells[k]]) ** 2:
                continue
            inside = True
            for e in range(3):
                a, b = X[nodes[e]], X[nodes[(e + 1) % 3]]
                dx, dy = b[0] - a[0], b[1] - a[1]
                if dx * (y - a[1]) - dy * (x - a[0]) >= 0.0:
                    continue
                inside = False
                s = min(max(((x - a[0]) * dx + (y - a[1]) * dy) / (dx * dx + dy * dy), 0.0), 1.0)
                px, py = a[0] + s * dx, a[1] + s * dy
                square = (x - px) ** 2 + (y - py) ** 2
                if square < least:
                    least, near[k] = square, True
                    apex[k, 0], apex[k, 1] = px, py
            if inside:
                least, near[k] = 0.0, True
                apex[k, 0], apex[k, 1] = x, y
    return apex, near


@kernel
def cut_cells(
    cells: Array, kind: Array, apex: Array, polar: Array, X: Array, T: Array,
    points: Array, place: Array, starts: Array, segments: Array,
) -> Triangles:  # fmt: skip
    """See ``Cutter.triangles``; apex (m, 2) is the centre of the polar rule of the cells with ``polar`` (m,)."""
    start = np.zeros(cells.shape[0] + 1, np.int64)
    corners, kinds = np.empty((2 * cells.shape[0] + 64, 3, 2)), np.empty(2 * cells.shape[0] + 64, np.int64)
    n = 0
    for k in range(cells.shape[0]):
        at = place[cells[k]]
        first, last = (starts[at], starts[at + 1]) if at >= 0 else (0, 0)
        lines = last - first
        # n lines cut the plane into n (n + 1) / 2 + 1 pieces at most; each adds a corner to a piece
        piece, corner = np.empty((lines * (lines + 1) // 2 + 2, lines + 4, 2)), np.zeros(lines * (lines + 1) // 2 + 2, np.int64)
        for i in range(3):
            piece[0, i, 0], piece[0, i, 1] = X[T[cells[k], i]]
        corner[0] = 3
        pieces = 1
        size = np.sqrt(double_area(piece[0]))
        for j in range(first, last):
            a, b = points[segments[j]], points[segments[j] + 1]
            for p in range(pieces):
                if crosses(a, b, piece[p], corner[p], 1e-12 * size):
                    corner[p], corner[pieces] = split(a, b, piece[p], corner[p], piece[pieces], 1e-12 * size)
                    pieces += corner[pieces] > 0
        need = n + pieces * (lines + 4)
        while need > kinds.shape[0]:
            corners, kinds = np.concatenate((corners, np.empty_like(corners))), np.concatenate((kinds, np.empty_like(kinds)))
        for p in range(pieces):
            n = fan(piece[p], corner[p], apex[k], polar[k], kind[k], FLAT * size * size, 1e-10 * size, corners, kinds, n)
        start[k + 1] = n
    return Triangles(start, corners[:n], kinds[:n])


@kernel
def double_area(p: Array) -> float:
    """Twice the area of the triangle of the first three corners of p (n, 2), positive if they go counter-clockwise."""
    return (p[1, 0] - p[0, 0]) * (p[2, 1] - p[0, 1]) - (p[1, 1] - p[0, 1]) * (p[2, 0] - p[0, 0])


@kernel
def crosses(a: Array, b: Array, polygon: Array, corners: int, slack: float) -> bool:
    """True if the segment from a to b comes within ``slack`` (m) of the convex polygon's inside."""
    first, last = 0.0, 1.0
    for k in range(corners):
        px, py = polygon[k]
        dx, dy = polygon[(k + 1) % corners, 0] - px, polygon[(k + 1) % corners, 1] - py
        scale = 1.0 / np.hypot(dx, dy)
        at_a = (dx * (a[1] - py) - dy * (a[0] - px)) * scale + slack
        at_b = (dx * (b[1] - py) - dy * (b[0] - px)) * scale + slack
        if at_a < 0.0 and at_b < 0.0:
            return False
        if at_a < 0.0:
            first = max(first, at_a / (at_a - at_b))
        elif at_b < 0.0:
            last = min(last, at_a / (at_a - at_b))
    return first <= last


@kernel
def split(a: Array, b: Array, polygon: Array, corners: int, other: Array, slack: float) -> tuple[int, int]:
    """Cut a convex polygon by the line through a and b: it keeps the part on the left, ``other`` takes the one on the right.

    Returns their numbers of corners; (corners, 0) if the line leaves it whole. Corners within ``slack`` (m) lie on the line.
    """
    length = np.hypot(b[0] - a[0], b[1] - a[1])
    nx, ny = -(b[1] - a[1]) / length, (b[0] - a[0]) / length
    height = np.empty(corners)
    above, below = False, False
    for k in range(corners):
        height[k] = (polygon[k, 0] - a[0]) * nx + (polygon[k, 1] - a[1]) * ny
        above |= height[k] > slack
        below |= height[k] < -slack
    if not (above and below):
        return corners, 0
    whole = polygon[:corners].copy()
    left, right = 0, 0
    for k in range(corners):
        if height[k] >= -slack:
            polygon[left] = whole[k]
            left += 1
        if height[k] <= slack:
            other[right] = whole[k]
            right += 1
        after = (k + 1) % corners
        if (height[k] > slack and height[after] < -slack) or (height[k] < -slack and height[after] > slack):
            t = height[k] / (height[k] - height[after])
            for i in range(2):
                polygon[left, i] = whole[k, i] + t * (whole[after, i] - whole[k, i])
                other[right, i] = polygon[left, i]
            left += 1
            right += 1
    return left, right


@kernel
def fan(
    polygon: Array, corners: int, apex: Array, polar: bool, kind: int, flat: float, slack: float,
    out: Array, kinds: Array, n: int,
) -> int:  # fmt: skip
    """Append the triangles of a convex polygon to out and kinds from place n on, and return the place after them.

    They share a corner of it, or the apex if that lies on it and the rule is to be polar.
    """
    for k in range(corners):
        px, py = polygon[k]
        dx, dy = polygon[(k + 1) % corners, 0] - px, polygon[(k + 1) % corners, 1] - py
        polar &= dx * (apex[1] - py) - dy * (apex[0] - px) >= -slack * np.hypot(dx, dy)
    for k in range(corners):
        if polar:
            out[n, 0] = apex
        else:
            out[n, 0] = polygon[0]
        out[n, 1], out[n, 2] = polygon[k], polygon[(k + 1) % corners]
        if double_area(out[n]) > flat:
            kinds[n] = POLAR if polar else kind
            n += 1
    return n
