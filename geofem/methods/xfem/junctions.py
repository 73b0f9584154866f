"""Where cracks meet: cracks cut where they cross, joined where their ends meet, and the parts of the body around a junction.

A crack that ends on another one, its main, parts the body on one side of the main only: the two sectors between the branch
and the two arms of the main. Daux, Moes, Dolbow, Sukumar and Belytschko (2000) take a function of value +-1 in the sectors and
that of the main's jump beyond it; with the jump of the main, the one taken here, 0 beyond the main, spans the same space. Of
cracks that cross, one is cut into two branches of the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from geofem.materials.kinematics import kernel
from geofem.methods.xfem.geometry import Lines, cracks_of, lines_of, side
from geofem.scene import Array

JOIN = 1e-9
"""Points closer than this part of the extent of all cracks are one."""
NEAR = 1e-3
"""So far from a junction, as a part of the shortest segment there, it is asked in which sector a crack leaves it."""


class Sectors(NamedTuple):
    """The borders of the parts that a crack c parts: ``plus`` of the one on its + side, ``minus`` of that on its - side.

    Each runs along the crack, and from an end on another crack on along that one's arm. joined : (cracks, 2) bool, whether the
    first and the last point lie on another crack.
    """

    plus: Lines
    minus: Lines
    joined: Array


@kernel
def part(x: float, y: float, lines: Lines, sectors: Sectors, crack: int) -> float:
    """1 on the + side of a crack, -1 on its - side, 0 beyond a crack that it ends on."""
    if not (sectors.joined[crack, 0] or sectors.joined[crack, 1]):
        return side(x, y, lines, crack, 0.0)
    plus, minus = side(x, y, sectors.plus, crack, 0.0), side(x, y, sectors.minus, crack, 0.0)
    if plus == minus:
        return plus
    # a crack with both ends on one main: the borders overlap along it, and both hold the point
    return 0.0 if plus < 0.0 else side(x, y, lines, crack, 0.0)


@kernel
def parts(x: Array, lines: Lines, sectors: Sectors, crack: int) -> Array:
    """``part`` of each point x (n, 2)."""
    out = np.empty(x.shape[0])
    for k in range(x.shape[0]):
        out[k] = part(x[k, 0], x[k, 1], lines, sectors, crack)
    return out


# --- cutting and joining ----------------------------------------------------------------------------------------------
def network(lines: Lines) -> Lines:
    """The cracks such that one passes each point where cracks meet, the straightest way, and all others end there, on its vertex."""
    cracks = cracks_of(lines)
    if len(cracks) < 2:
        return lines
    slack = JOIN * float(np.ptp(lines.points, axis=0).max())
    places: list[Array] = []
    for j in range(len(cracks)):
        for i in range(j):
            for point in contacts(cracks[i], cracks[j], slack):
                cracks[i], k = with_vertex(cracks[i], point, slack)
                cracks[j], at = with_vertex(cracks[j], point, slack)
                cracks[j][at] = cracks[i][k]
                places.append(cracks[i][k])
    pieces = [piece for crack in cracks for piece in cut_at(crack, places)]
    for place in places:
        straightest = 1.0
        pair: tuple[int, int] | None = None
        ends = [(k, way) for k, piece in enumerate(pieces) for way in ways_from(place, piece)]
        for n, (j, b) in enumerate(ends):
            for i, a in ends[:n]:
                # of ways as straight as each other, the first, whatever rounding says
                if i != j and a @ b < straightest - 1e-9:
                    straightest, pair = float(a @ b), (i, j)
        if pair is not None and main_at(pieces, place) is None:
            pieces[pair[0]] = chained(pieces[pair[0]], pieces.pop(pair[1]), place)
    return lines_of(pieces)


def cut_at(crack: Array, places: Sequence[Array]) -> list[Array]:
    """A polyline in pieces between those of its vertices that are among the places."""
    inner = [k for k in range(1, len(crack) - 1) if any((crack[k] == place).all() for place in places)]
    ends = [0, *inner, len(crack) - 1]
    return [crack[a : b + 1] for a, b in zip(ends, ends[1:])]


def ways_from(place: Array, piece: Array) -> list[Array]:
    """The unit vectors along which a polyline leaves a place, for each end of it there."""
    inward = [piece[k] - piece[end] for end, k in ((0, 1), (-1, -2)) if (piece[end] == place).all()]
    return [way / np.hypot(*way) for way in inward]


def contacts(a: Array, b: Array, slack: float) -> list[Array]:
    """The points (2,) where two polylines (n, 2) and (m, 2) meet, an end within ``slack`` (m) included, each once."""
    e, f = np.diff(a, axis=0)[:, None], np.diff(b, axis=0)[None]
    lengths = np.hypot(e[..., 0], e[..., 1]), np.hypot(f[..., 0], f[..., 1])
    to = b[None, :-1] - a[:-1, None]
    det = e[..., 0] * f[..., 1] - e[..., 1] * f[..., 0]
    flat = np.abs(det) <= 1e-12 * lengths[0] * lengths[1]
    with np.errstate(divide="ignore", invalid="ignore"):
        s = (to[..., 0] * f[..., 1] - to[..., 1] * f[..., 0]) / det
        t = (to[..., 0] * e[..., 1] - to[..., 1] * e[..., 0]) / det
    inside = [(p >= -slack / length) & (p <= 1.0 + slack / length) for p, length in zip((s, t), lengths)]
    rows, columns = np.nonzero(~flat & inside[0] & inside[1])
    found = [a[i] + min(max(s[i, j], 0.0), 1.0) * e[i, 0] for i, j in zip(rows, columns)]
    found += [p for p in a[[0, -1]] for q in b[[0, -1]] if np.hypot(*(p - q)) <= slack]
    apart: list[Array] = []
    for point in found:
        if all(np.hypot(*(point - other)) > 2.0 * slack for other in apart):
            apart.append(point)
    return apart


def with_vertex(line: Array, at: Array, slack: float) -> tuple[Array, int]:
    """A copy of a polyline with a vertex at a point on it, unless one is as near as ``slack`` (m), and the vertex' number."""
    away = np.hypot(*(line - at).T)
    k = int(away.argmin())
    if away[k] <= 2.0 * slack:
        return line.copy(), k
    along = np.diff(line, axis=0)
    t = np.clip(((at - line[:-1]) * along).sum(axis=1) / (along**2).sum(axis=1), 0.0, 1.0)
    k = int(np.hypot(*(line[:-1] + t[:, None] * along - at).T).argmin()) + 1
    return np.insert(line, k, at, axis=0), k


def chained(a: Array, b: Array, at: Array) -> Array:
    """Two polylines with an end in common as one, in the direction of the first."""
    if (a[-1] == at).all():
        return np.concatenate([a, (b if (b[0] == at).all() else b[::-1])[1:]])
    return np.concatenate([(b if (b[-1] == at).all() else b[::-1])[:-1], a])


def main_at(cracks: Sequence[Array], at: Array) -> int | None:
    """The crack that passes a point."""
    return next((c for c, line in enumerate(cracks) if (line[1:-1] == at).all(axis=1).any()), None)


# --- sectors ----------------------------------------------------------------------------------------------------------
def sectors_of(lines: Lines) -> Sectors:
    """The sectors of all cracks of a ``network``."""
    cracks = cracks_of(lines)
    mains = [[main_at(cracks, crack[end]) for end in (0, -1)] for crack in cracks]
    joined = np.array([[main is not None for main in pair] for pair in mains], bool).reshape(-1, 2)
    plus, minus = list(cracks), list(cracks)
    left = list(range(len(cracks)))
    done: list[int] = []
    while left:
        # a branch after its mains; in a ring of cracks that end on each other, some first one
        c = next((c for c in left if not set(mains[c]) & set(left)), left[0])
        left.remove(c)
        for end, main in zip((0, -1), mains[c]):
            if main is None:
                continue
            at = cracks[c][end]
            way = (cracks[c][1] if end == 0 else cracks[c][-2]) - at
            segments = [np.diff(cracks[k], axis=0) for k in (main, c)]
            shortest = min(float(np.hypot(*segment.T).min()) for segment in segments)
            near = at + NEAR * shortest / np.hypot(*way) * way
            sign = side(*near, lines, main, 0.0)
            border = (plus if sign > 0 else minus)[main]
            for other in done:  # branches from the same junction
                if (cracks[other][[0, -1]] == at).all(axis=1).any():
                    up, down = (side(*near, lines_of([of[other]]), 0, 0.0) for of in (plus, minus))
                    if up == down:
                        sign, border = up, (plus if up > 0 else minus)[other]
            k = int(np.flatnonzero((border == at).all(axis=1))[0])
            # seen along the border, it goes on at the left of a branch that comes in from its + side
            onward, back = border[k:], border[: k + 1]
            if end == -1:
                left_arm, right_arm = (onward, back[::-1]) if sign > 0 else (back[::-1], onward)
                plus[c] = np.concatenate([plus[c], left_arm[1:]])
                minus[c] = np.concatenate([minus[c], right_arm[1:]])
            else:
                left_arm, right_arm = (back, onward[::-1]) if sign > 0 else (onward[::-1], back)
                plus[c] = np.concatenate([left_arm[:-1], plus[c]])
                minus[c] = np.concatenate([right_arm[:-1], minus[c]])
        done.append(c)
    return Sectors(lines_of(plus), lines_of(minus), joined)
