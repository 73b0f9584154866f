"""Cracks as polylines: the side of a point, the frame of a tip, and which cells a crack touches.

A crack runs from its first point to its last; its + side is on the left of that way. Points on the crack belong to the + side.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from geofem.materials.kinematics import kernel
from geofem.methods.xfem.grid import Bins, Grid
from geofem.scene import Array, Crack

TOUCH = 1e-10
"""Barycentric distance at which a point outside a cell still counts as on it, and fraction of a cell's size at which a node lies
on a crack: rounding puts what is on a line on either side of it."""
MEET = 1e-8
"""A cell that holds less of a crack than this part of its size, at a tip, lies ahead of it."""
EDGE = 1e-9
"""A crack's end nearer to the boundary than this part of a cell is its mouth and no tip."""


class Lines(NamedTuple):
    """All cracks: crack c runs through points[start[c]:start[c + 1]]; points (n, 2) m. Segment s joins the points s and s + 1."""

    points: Array
    start: Array


class Tips(NamedTuple):
    """The tips of all cracks.

    at : (tips, 2) m. axis : (tips, 2) unit vector ahead. crack : (tips,) whose end it is. point : (tips,) its number in ``Lines``.
    turn : (tips,) 1 if the angle to the axis is positive on the + side of the crack, as at its last point, else -1.
    """

    at: Array
    axis: Array
    turn: Array
    crack: Array
    point: Array


class Touch(NamedTuple):
    """The cells that cracks touch: cells (m,), each with the segments segment[start[k]:start[k + 1]], in order."""

    cells: Array
    start: Array
    segment: Array


def polylines(cracks: tuple[Crack, ...]) -> Lines:
    """The cracks of a scene as arrays."""
    return lines_of([np.array(crack.points, float) for crack in cracks])


def lines_of(cracks: Sequence[Array]) -> Lines:
    """Polylines (n, 2), one after the other."""
    points = np.concatenate([np.empty((0, 2)), *cracks])
    return Lines(points, np.concatenate([[0], np.cumsum([len(line) for line in cracks], dtype=np.int64)]))


def cracks_of(lines: Lines) -> list[Array]:
    """The points (n, 2) of each crack."""
    return [lines.points[a:b] for a, b in zip(lines.start, lines.start[1:])]


def find_tips(grid: Grid, lines: Lines, joined: Array, boundary: Array) -> Tips:
    """The ends of cracks that lie inside a body and not on another crack. Collective.

    joined : (cracks, 2), see ``Sectors``. boundary : (facets, 2) nodes of this rank's part of the boundary.
    """
    found: list[tuple[Array, Array, float, int, int]] = []
    for c in range(len(lines.start) - 1):
        first, last = int(lines.start[c]), int(lines.start[c + 1]) - 1
        for end, inner, turn, branch in ((first, first + 1, -1.0, joined[c, 0]), (last, last - 1, 1.0, joined[c, 1])):
            if branch:
                continue
            at = lines.points[end]
            held = bool(len(cells_at(grid, at)))
            mouth = distance_to(at, grid.X[boundary]) <= EDGE * grid.size.max(initial=0.0)
            # a rank that holds the end need not hold the boundary it lies on
            answers = grid.comm.allgather((held, mouth))
            if any(h for h, _ in answers) and not any(m for _, m in answers):
                axis = at - lines.points[inner]
                found.append((at, axis / np.hypot(*axis), turn, c, end))
    columns = list(zip(*found)) or [()] * 5
    return Tips(
        np.array(columns[0], float).reshape(-1, 2), np.array(columns[1], float).reshape(-1, 2),
        np.array(columns[2], float), np.array(columns[3], np.int64), np.array(columns[4], np.int64),
    )  # fmt: skip


def cells_at(grid: Grid, x: Array) -> Array:
    """The cells of this rank that hold a point, those on whose side or corner it lies included."""
    return touched(Lines(np.array([x, x]), np.array([0, 2])), grid.X, grid.T, grid.bins)[0]


def distance_to(x: Array, edges: Array) -> float:
    """Distance (m) of a point to the nearest of the edges (n, 2, 2); infinite without any."""
    if not len(edges):
        return np.inf
    along = edges[:, 1] - edges[:, 0]
    t = np.clip(np.einsum("ei,ei->e", x - edges[:, 0], along) / np.einsum("ei,ei->e", along, along), 0.0, 1.0)
    return float(np.hypot(*(x - edges[:, 0] - t[:, None] * along).T).min())


def touching(grid: Grid, lines: Lines, tips: Tips) -> Touch:
    """The cells of this rank that the cracks touch, in time proportional to their number.

    Not those that a tip does but meet: they lie ahead of it, and the crack parts nothing in them.
    """
    cell, segment = touched(lines, grid.X, grid.T, grid.bins)
    kept = np.ones(len(cell), bool)
    for k in np.flatnonzero(np.isin(segment, tips.point) | np.isin(segment + 1, tips.point)):
        a, b = lines.points[segment[k]], lines.points[segment[k] + 1]
        first, last = contact(a, b, *grid.X[grid.T[cell[k]]])
        short = (last - first) * np.hypot(*(b - a)) <= MEET * grid.size[cell[k]]
        at_tip = (first == 0.0 and segment[k] in tips.point) or (last == 1.0 and segment[k] + 1 in tips.point)
        kept[k] = not (short and at_tip)
    cell, segment = cell[kept], segment[kept]
    order = np.lexsort((segment, cell))
    cells, first = np.unique(cell[order], return_index=True)
    return Touch(cells, np.append(first, len(cell)).astype(np.int64), segment[order])


@kernel
def touched(lines: Lines, X: Array, T: Array, bins: Bins) -> tuple[Array, Array]:
    """Pairs (cell, segment) of all cells that the segments touch, unsorted."""
    low, width, counts, starts, members = bins
    cell, segment = np.empty(64, np.int64), np.empty(64, np.int64)
    found = 0
    seen = np.full(T.shape[0], -1, np.int64)
    for c in range(lines.start.shape[0] - 1):
        for s in range(lines.start[c], lines.start[c + 1] - 1):
            a, b = lines.points[s], lines.points[s + 1]
            steps = int(np.hypot(b[0] - a[0], b[1] - a[1]) / width) + 1
            for k in range(steps):
                # the bins that this piece of the segment passes
                x0, x1 = a[0] + (b[0] - a[0]) * k / steps, a[0] + (b[0] - a[0]) * (k + 1) / steps
                y0, y1 = a[1] + (b[1] - a[1]) * k / steps, a[1] + (b[1] - a[1]) * (k + 1) / steps
                i0 = max(int(np.floor((min(x0, x1) - low[0]) / width - 1e-9)), 0)
                i1 = min(int(np.floor((max(x0, x1) - low[0]) / width + 1e-9)), counts[0] - 1)
                j0 = max(int(np.floor((min(y0, y1) - low[1]) / width - 1e-9)), 0)
                j1 = min(int(np.floor((max(y0, y1) - low[1]) / width + 1e-9)), counts[1] - 1)
                for i in range(i0, i1 + 1):
                    for j in range(j0, j1 + 1):
                        place = i * counts[1] + j
                        for m in range(starts[place], starts[place + 1]):
                            t = members[m]
                            if seen[t] == s:
                                continue
                            seen[t] = s
                            if not touches(a, b, X[T[t, 0]], X[T[t, 1]], X[T[t, 2]]):
                                continue
                            if found == cell.shape[0]:
                                cell = np.concatenate((cell, np.empty_like(cell)))
                                segment = np.concatenate((segment, np.empty_like(segment)))
                            cell[found], segment[found] = t, s
                            found += 1
    return cell[:found], segment[:found]


@kernel
def touches(a: Array, b: Array, p: Array, q: Array, r: Array) -> bool:
    """True if the segment from a to b touches the closed triangle p, q, r."""
    first, last = contact(a, b, p, q, r)
    return first <= last


@kernel
def contact(a: Array, b: Array, p: Array, q: Array, r: Array) -> tuple[float, float]:
    """Where on the segment from a (0) to b (1) the closed triangle p, q, r begins and ends; the end comes first if nowhere.

    The segment is clipped by the three barycentric coordinates.
    """
    double = (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
    first, last = 0.0, 1.0
    for k in range(3):
        u, v = (p, q) if k == 0 else ((q, r) if k == 1 else (r, p))
        at_a = ((v[0] - u[0]) * (a[1] - u[1]) - (v[1] - u[1]) * (a[0] - u[0])) / double + TOUCH
        at_b = ((v[0] - u[0]) * (b[1] - u[1]) - (v[1] - u[1]) * (b[0] - u[0])) / double + TOUCH
        if at_a < 0.0 and at_b < 0.0:
            return 1.0, 0.0
        if at_a < 0.0:
            first = max(first, at_a / (at_a - at_b))
        elif at_b < 0.0:
            last = min(last, at_a / (at_a - at_b))
    return first, last


@kernel
def offset(x: float, y: float, lines: Lines, crack: int) -> tuple[float, float, float, float]:
    """Signed offset (m) of a point from a crack, positive on the + side, the unit normal that it is measured along, and the distance (m).

    It is measured from the nearest point of the polyline; beyond an end from the straight line on. Nearest to an inner
    vertex, the normal is the mean of its two segments', which has the right sign on either side of any kink.
    """
    first, last = lines.start[crack], lines.start[crack + 1] - 2
    least, nearest, place = np.inf, first, 0.0
    for s in range(first, last + 1):
        ax, ay = lines.points[s]
        dx, dy = lines.points[s + 1, 0] - ax, lines.points[s + 1, 1] - ay
        t = ((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy)
        t = min(max(t, 0.0), 1.0)
        square = (x - ax - t * dx) ** 2 + (y - ay - t * dy) ** 2
        if square < least:
            least, nearest, place = square, s, t
    nx, ny = normal(lines, nearest)
    foot = nearest
    if place == 0.0 and nearest > first:
        mx, my = normal(lines, nearest - 1)
        nx, ny = nx + mx, ny + my
    elif place == 1.0:
        foot = nearest + 1
        if nearest < last:
            mx, my = normal(lines, nearest + 1)
            nx, ny = nx + mx, ny + my
    scale = 1.0 / np.hypot(nx, ny)
    nx, ny = nx * scale, ny * scale
    return (x - lines.points[foot, 0]) * nx + (y - lines.points[foot, 1]) * ny, nx, ny, np.sqrt(least)


@kernel
def normal(lines: Lines, s: int) -> tuple[float, float]:
    """The unit normal of a segment, to its left."""
    dx, dy = lines.points[s + 1, 0] - lines.points[s, 0], lines.points[s + 1, 1] - lines.points[s, 1]
    length = np.hypot(dx, dy)
    return -dy / length, dx / length


@kernel
def side(x: float, y: float, lines: Lines, crack: int, slack: float) -> float:
    """1 on the + side of a crack and within ``slack`` (m) of it, else -1."""
    return 1.0 if offset(x, y, lines, crack)[0] >= -slack else -1.0


@kernel
def sides(x: Array, lines: Lines, crack: int, slack: Array) -> tuple[Array, Array]:
    """The side of each point x (n, 2), and where to evaluate given functions there: points on the crack are moved off it to
    their side, by ten times their slack."""
    out, off = np.empty(x.shape[0]), x.copy()
    for k in range(x.shape[0]):
        height, nx, ny, distance = offset(x[k, 0], x[k, 1], lines, crack)
        out[k] = 1.0 if height >= -slack[k] else -1.0
        if distance <= 2.0 * slack[k]:
            off[k, 0] += 10.0 * slack[k] * nx
            off[k, 1] += 10.0 * slack[k] * ny
    return out, off


@kernel
def polar(x: float, y: float, lines: Lines, tips: Tips, tip: int, slack: float) -> tuple[float, float]:
    """Distance to a tip and angle to its axis, which jumps on the crack itself, also where that is kinked behind the tip.

    Where the side of the polyline and that of the straight axis differ, the angle goes on beyond +-pi.
    """
    dx, dy = x - tips.at[tip, 0], y - tips.at[tip, 1]
    ahead = dx * tips.axis[tip, 0] + dy * tips.axis[tip, 1]
    up = dy * tips.axis[tip, 0] - dx * tips.axis[tip, 1]
    theta = np.arctan2(up, ahead)
    if ahead < 0.0:
        sign = tips.turn[tip] * side(x, y, lines, tips.crack[tip], slack)
        if theta * sign < 0.0:
            theta += 2.0 * np.pi * sign
    return np.hypot(dx, dy), theta
