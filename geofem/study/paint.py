"""Bodies in the plane, drawn into Matplotlib's axes: cells, material points by their domains, rigid bodies.

Points that belong to no cell, as drops that fly off a mesh do, are drawn as dots, of the area ``carried`` (n,) (m2) where there is one.
What a snapshot may hold beside ``points`` (n, 3), ``cells`` and ``cell``, for a cloud of n material points in the plane:

``edges`` (n, 4)
    half edge vectors r1, r2 of each point's domain as it is now: a parallelogram with the corners x +- r1 +- r2 (m);
    (n, 9) in space: r1, r2, r3.
``corners`` (n, 8)
    x, y of the four corners of each point's domain in order (m); goes before ``edges``.
``volume`` (n,)
    present volume of each point per unit of thickness (m2): the size of its dot where there are no domains.
``region`` (n,)
    index of the body that a point or cell belongs to.
``rigid`` (k, 2)
    closed polygons, rows of nan between them: rigid bodies and walls (m); two rows are drawn as a line.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection, PolyCollection
from scipy.spatial import cKDTree

from geofem.study.fields import Array, Snapshot

CORNERS = {"triangle": (0, 1, 2), "triangle6": (0, 3, 1, 4, 2, 5), "quad": (0, 1, 2, 3), "quad8": (0, 4, 1, 5, 2, 6, 3, 7),
           "quad9": (0, 4, 1, 5, 2, 6, 3, 7)}  # fmt: skip
"""The nodes around a cell, with those in the middle of its sides where it has them."""
OUTLINED = 8.0
"""Cells and domains of this mean width (points, 1/72 inch) or more are drawn with their outlines."""
SMOOTH = 20_000
"""More domains than this are drawn without smoothing their sides: twice as fast, and they are a few pixels each."""
FARTHEST = 0.25
"""Points that belong to no cell are shown up to this part of the body's length away from it."""
LINE = "#00000059"
SIGNS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])


def domains(snapshot: Snapshot) -> Array | None:
    """The corners (n, 4, 2) of the domains of material points; None where the snapshot does not tell."""
    points = np.asarray(snapshot["points"])[:, :2]
    if "corners" in snapshot:
        return np.asarray(snapshot["corners"]).reshape(-1, 4, 2)
    if "edges" in snapshot and np.asarray(snapshot["edges"]).shape[1] == 4:
        return points[:, None] + SIGNS @ np.asarray(snapshot["edges"]).reshape(-1, 2, 2)
    return None


def magnification(snapshot: Snapshot) -> float:
    """By what to multiply the displacements of a small-strain body, so that they show and do not hide the body: 1, 2 or 5 times a
    power of ten, with which the largest is about a twelfth of the body's length. 1 for material points and for bodies in space.
    """
    if str(snapshot["cell"]) == "vertex" or is_solid(snapshot):
        return 1.0
    u = np.asarray(snapshot["displacement"])[:, :2]
    largest = float(np.hypot(*u.T).max(initial=0.0))
    length = float(np.ptp(np.asarray(snapshot["points"])[:, :2] - u, axis=0).max())
    if not 0.0 < largest < np.inf:
        return 1.0
    wish = length / 12.0 / largest
    power = 10.0 ** np.floor(np.log10(wish))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= wish))


def magnified(snapshot: Snapshot, times: float) -> Snapshot:
    """The snapshot with its displacements, not its fields, multiplied."""
    if times == 1.0:
        return snapshot
    points, u = np.array(snapshot["points"], float), np.asarray(snapshot["displacement"])
    points[:, : u.shape[1]] += (times - 1.0) * u
    return {**snapshot, "points": points}


def polygons(snapshot: Snapshot) -> list[Array]:
    """The ``rigid`` polygons, each (k, 2)."""
    rows = np.asarray(snapshot.get("rigid", np.empty((0, 2))), float)
    gaps = np.flatnonzero(np.isnan(rows).any(axis=1))
    parts = [part[~np.isnan(part).any(axis=1)] for part in np.split(rows, gaps)]
    return [part for part in parts if len(part) > 1]


def spacing(snapshot: Snapshot) -> float:
    """Distance (m) between neighbouring points, by its median; 0 for a single point."""
    points = np.asarray(snapshot["points"])
    if len(points) < 2:
        return 0.0
    some = points[:: max(1, len(points) // 2000)]
    return float(np.median(cKDTree(points).query(some, k=2)[0][:, 1]))


def outlined(axes: Axes, around: Array) -> bool:
    """Whether polygons (n, k, 2) are large enough on paper for a line around each."""
    x, y = np.moveaxis(around, -1, 0)
    area = 0.5 * np.abs(np.mean(np.sum(x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1), axis=1)))
    scale = axes.bbox.width * 72.0 / axes.figure.dpi / abs(float(np.diff(axes.get_xlim())[0]))
    return bool(np.sqrt(area) * scale >= OUTLINED)


def draw_rigid(axes: Axes, snapshot: Snapshot) -> list[Any]:
    parts = polygons(snapshot)
    bodies, lines = [p for p in parts if len(p) > 2], [p for p in parts if len(p) == 2]
    drawn: list[Any] = []
    if bodies:
        drawn += [
            PolyCollection(bodies, facecolor="#dedede", edgecolor="#aaaaaa", linewidth=0, hatch="//", zorder=3),
            PolyCollection(bodies, facecolor="none", edgecolor="#3c3c3c", linewidth=1.6, zorder=3),
        ]
    if lines:
        drawn.append(LineCollection(lines, color="#3c3c3c", linewidth=4, zorder=3))
    return [axes.add_collection(one, autolim=False) for one in drawn]


def draw_cloud(axes: Axes, snapshot: Snapshot, values: Array, side: float, look: dict[str, Any]) -> list[Any]:
    """Material points as their domains, or as dots of their volume, or else as dots about ``side`` (m) wide."""
    around = domains(snapshot)
    if around is not None:
        few = outlined(axes, around)
        lines = {"edgecolor": LINE if few else "face", "linewidth": 0.5 if few else 0.35}
        if len(around) > SMOOTH:
            lines = {"edgecolor": "none", "antialiased": False}
        drawn: Any = PolyCollection(around, array=values, rasterized=True, **lines, **look)
    else:
        points = np.asarray(snapshot["points"])[:, :2]
        # A dot that is a little larger than the circle of equal area leaves no gaps between neighbours at rest.
        width = 1.25 * (np.sqrt(np.abs(snapshot["volume"])) if "volume" in snapshot else np.full(len(points), side))
        drawn = EllipseCollection(width, width, 0.0, units="xy", offsets=points, offset_transform=axes.transData, array=values,
                                  linewidth=0, rasterized=True, **look)  # fmt: skip
    return [axes.add_collection(drawn, autolim=False)]


def alone(snapshot: Snapshot) -> Array:
    """The numbers of the points that belong to no cell."""
    used = np.zeros(len(snapshot["points"]), bool)
    used[np.asarray(snapshot["cells"]).ravel()] = True
    return np.flatnonzero(~used)


def draw_cells(axes: Axes, snapshot: Snapshot, values: Array, look: dict[str, Any]) -> list[Any]:
    points = np.asarray(snapshot["points"])[:, :2]
    around = np.asarray(snapshot["cells"])[:, list(CORNERS[str(snapshot["cell"])])]
    drawn: list[Any] = []
    free = alone(snapshot)
    if len(values) == len(points) and len(free):
        side = np.full(len(free), 0.25 * spacing(snapshot))
        if "carried" in snapshot:
            side = np.maximum(side, np.sqrt(np.asarray(snapshot["carried"])[free]))
        drops = EllipseCollection(side, side, 0.0, units="xy", offsets=points[free], offset_transform=axes.transData,
                                  array=values[free], linewidth=0, **look)  # fmt: skip
        drawn.append(axes.add_collection(drops, autolim=False))
    if not len(around):
        return drawn
    if len(values) == len(points):
        fans = np.concatenate([around[:, [0, i, i + 1]] for i in range(1, around.shape[1] - 1)])
        drawn.append(axes.tripcolor(*points.T, values, triangles=fans, shading="gouraud", rasterized=True, **look))
    else:
        drawn.append(
            axes.add_collection(
                PolyCollection(points[around], array=values, edgecolor="face", linewidth=0.35, **look), autolim=False
            )
        )
    if outlined(axes, points[around]):
        mesh = PolyCollection(points[around], facecolor="none", edgecolor=LINE, linewidth=0.6)
        drawn.append(axes.add_collection(mesh, autolim=False))
    return drawn


def body(axes: Axes, snapshot: Snapshot, values: Array, side: float, look: dict[str, Any]) -> list[Any]:
    """Draw the body, coloured by one value per point or cell, and the rigid bodies; returns what was added to the axes.

    side : width (m) of points of which the snapshot tells neither domain nor volume. look : ``cmap``, ``norm``.
    The limits of the axes stay as they are: see ``bounds``.
    """
    if str(snapshot["cell"]) == "vertex":
        drawn = draw_cloud(axes, snapshot, values, side, look)
    else:
        drawn = draw_cells(axes, snapshot, values, look)
    return drawn + draw_rigid(axes, snapshot)


# --- how much room ----------------------------------------------------------------------------------------------------
def bounds(snapshot: Snapshot, side: float = 0.0) -> Array:
    """The box (2, gdim) around the body, [[low], [high]] (m); a few stray material points do not count, nor drops far off."""
    points = np.asarray(snapshot["points"], float)
    free = alone(snapshot)
    if 0 < len(free) < len(points):
        body = np.delete(points, free, axis=0)
        room = FARTHEST * np.ptp(body, axis=0).max()
        points = np.concatenate([body, np.clip(points[free], body.min(axis=0) - room, body.max(axis=0) + room)])
    around = domains(snapshot) if str(snapshot["cell"]) == "vertex" and not is_solid(snapshot) else None
    if around is not None:
        points = around.reshape(-1, 2)
    points = points[np.isfinite(points).all(axis=1)][:, : 3 if is_solid(snapshot) else 2]
    if not len(points):
        return np.array([[0.0] * points.shape[1], [1.0] * points.shape[1]])
    box = np.array([points.min(axis=0), points.max(axis=0)])
    if str(snapshot["cell"]) == "vertex":
        most = np.percentile(points, (0.2, 99.8), axis=0)
        room = 0.25 * np.ptp(most, axis=0).max()
        stray = np.array([most[0] - box[0] > room, box[1] - most[1] > room])
        box = np.where(stray, most, box)
        if is_solid(snapshot) and "edges" in snapshot:
            side = float(np.abs(np.reshape(snapshot["edges"], (-1, 3, 3))).sum(axis=1).max()) / 0.6
        if around is None:
            box += [[-0.6 * side], [0.6 * side]]
    return box


def is_solid(snapshot: Snapshot) -> bool:
    """Whether the body is one in space: its cells are, or its points do not lie in the plane z = 0."""
    cell = str(snapshot["cell"])
    return cell.startswith(("tetra", "hexa")) or (cell == "vertex" and bool(np.any(np.asarray(snapshot["points"])[:, 2:])))


def room(boxes: Array, rigid: list[Array]) -> Array:
    """One box (2, gdim) for all pictures: around the bodies, with a margin, and what fits beside them of the rigid ones."""
    low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    size = (high - low).max() or 1.0
    a, b = low.copy(), high.copy()
    for part in rigid:
        a = np.minimum(a, np.maximum(part.min(axis=0), low - 0.12 * size))
        b = np.maximum(b, np.minimum(part.max(axis=0), high + 0.12 * size))
    if len(a) == 3:
        step = 10.0 ** np.floor(np.log10(size)) / 5.0  # round numbers, which the corners of the axes will bear
        return np.array([np.floor(a / step + 1e-6), np.ceil(b / step - 1e-6)]) * step
    thin = np.maximum(size / 8.0 - (b - a), 0.0) / 2.0  # no strip is drawn that is longer than eight times its height
    return np.array([a - thin - 0.03 * size, b + thin + 0.03 * size])
