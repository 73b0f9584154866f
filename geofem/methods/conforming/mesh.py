"""Meshes that conform to cracks: Gmsh's triangles along every crack, nodes parted on its faces, quarter points at its tips."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from mpi4py import MPI
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from geofem.core import mesh as meshes
from geofem.core.mesh import Body
from geofem.core.meshing import Cells, collect, compact, gmsh_model, paired_facets, plane_surface, refuse_overlap, set_size
from geofem.core.mpi import on_root
from geofem.mistake import Mistake
from geofem.scene import Array, Crack, Scene

STRAIGHT = 1e-3
"""Sine of the angle up to which a crack behind its tip counts as straight."""
NEAR = 1e-9
"""A node closer to a crack than this part of the body's size lies on it."""
SIDES = {1: ((1, 2), (0, 2), (0, 1)), 2: ((1, 2, 3), (0, 2, 4), (0, 1, 5))}
"""Nodes of each side of a triangle of order 1 and 2 in dolfinx's order: the two corners first."""


class Tip(NamedTuple):
    """An end of a crack inside a body.

    at : (2,) m. axis : (2,) unit vector ahead. crack : its number. last : True at the last point of the crack, False at the first.
    clear : distance (m) within which there is nothing but the crack, straight: no kink, other crack or boundary.
    """

    at: Array
    axis: Array
    crack: int
    last: bool
    clear: float


class Meshed(NamedTuple):
    """A body along whose cracks the mesh is parted. walls : (k, 2, 2) the sides of its boundary (m), those of cracks left out."""

    body: Body
    tips: tuple[Tip, ...]
    walls: Array


def build(comm: MPI.Intracomm, scene: Scene, n: int, order: int, grading: float, quarter_point: bool) -> Meshed:
    """Mesh the regions of a scene along its cracks. Collective.

    n, grading : as in ``geofem.core.mesh.build``, towards the tips, and without tips towards the scene's singular points.
    order : of the geometry, 1 or 2. quarter_point : of the cells around a tip, put the nodes on the sides to it at a quarter.

    Raises ``Mistake`` for bodies that overlap or that Gmsh cannot mesh.
    """
    made = on_root(comm, lambda: serial(scene, n, order, grading))
    tips, walls = comm.bcast(made and made[1:])
    if made and quarter_point:
        move_to_quarter(made[0], tips)
    return Meshed(meshes.distribute(comm, scene, made and made[0]), tips, walls)


def serial(scene: Scene, n: int, order: int, grading: float) -> tuple[Cells, tuple[Tip, ...], Array]:
    """The mesh, parted along the cracks, their tips and the sides of the boundary, on one process."""
    shapes = [region.shape for region in scene.regions]
    with gmsh_model("cracks") as gmsh:
        occ = gmsh.model.occ
        surfaces = [(2, plane_surface(occ, shape)) for shape in shapes]
        lines = [(1, line) for crack in scene.cracks for line in polyline(occ, crack)]
        try:
            pieces = occ.fragment(surfaces, lines)[1]
            occ.synchronize()
            tags = sorted({tag for found in pieces[: len(shapes)] for _, tag in found})
            owner = np.array([[(2, tag) in found for tag in tags] for found in pieces[: len(shapes)]])
            refuse_overlap(scene.regions, owner)
            curves = [tag for found in pieces[len(shapes) :] for _, tag in found]
            ends = loose_ends(gmsh.model, curves, tags, shapes)
            set_size(gmsh, scene.length, scene.length / n, ends or scene.singular, grading)
            gmsh.model.mesh.generate(2)
            gmsh.model.mesh.setOrder(order)
        except Exception as error:
            if isinstance(error, Mistake):
                raise
            raise Mistake(
                f"scene {scene.name}: Gmsh cannot mesh the body along its cracks ({error}); check their points"
            ) from None
        whole = collect(gmsh.model.mesh, tags, owner.argmax(axis=0), shapes, "triangle", order)
    rows = whole.cells[:, SIDES[order]].reshape(-1, order + 1)[:, :2]
    pairs = paired_facets(rows)
    outer = np.ones(len(rows), bool)
    outer[pairs] = False
    walls = whole.points[rows[outer]]
    return parted(whole, scene.cracks, pairs), find_tips(scene.cracks, ends, walls), walls


def polyline(occ: Any, crack: Crack) -> list[int]:
    """The tags of new lines along a crack."""
    points = [occ.addPoint(*point, 0.0) for point in crack.points]
    return [occ.addLine(a, b) for a, b in zip(points, points[1:])]


def loose_ends(model: Any, curves: Sequence[int], tags: Sequence[int], shapes: Sequence[Any]) -> list[tuple[float, float]]:
    """Where cracks end inside a body: the points off its boundary that belong to one piece only.

    curves : the pieces of cracks, also those outside. tags : of the surfaces of the body.
    """
    ends: list[int] = []
    for curve in curves:
        points = [tag for _, tag in model.getBoundary([(1, curve)], oriented=False)]
        middle = np.mean([model.getValue(0, point, [])[:2] for point in points], axis=0)
        if any(shape.contains(middle[:, None])[0] for shape in shapes):
            ends += points
    outer = model.getBoundary([(2, tag) for tag in tags], oriented=False)
    boundary = {point for _, curve in outer for point in model.getAdjacencies(1, curve)[1]}
    loose = [end for end in ends if ends.count(end) == 1 and end not in boundary]
    return [tuple(model.getValue(0, end, [])[:2].tolist()) for end in loose]


def find_tips(cracks: Sequence[Crack], ends: Sequence[tuple[float, float]], boundary: Array) -> tuple[Tip, ...]:
    """The tips of all cracks, in their order.

    ends : where they end inside a body. boundary : (k, 2, 2) its sides.
    """
    found = []
    places = np.array(ends).reshape(-1, 2)
    for c, crack in enumerate(cracks):
        for last in (False, True):
            points = np.array(crack.points, float)[:: -1 if last else 1]
            at, axis = points[0], points[0] - points[1]
            axis /= np.hypot(*axis)
            if not (np.hypot(*(places - at).T) < NEAR * np.ptp(boundary)).any():
                continue
            behind = at - points
            off, length = np.abs(behind @ np.array([-axis[1], axis[0]])), np.hypot(*behind.T)
            bent = np.flatnonzero(off > STRAIGHT * length)
            straight = int(bent[0]) - 1 if len(bent) else len(points) - 1
            others = [np.array(other.points, float) for k, other in enumerate(cracks) if k != c] + [points[straight + 1 :]]
            sides = [boundary, *(np.stack([other[:-1], other[1:]], axis=1) for other in others)]
            clear = min(length[straight], *(distance(at, edges) for edges in sides))
            found.append(Tip(at, axis, c, last, float(clear)))
    return tuple(found)


def distance(x: Array, edges: Array) -> float:
    """Distance (m) of a point to the nearest of the edges (n, 2, 2); infinite without any."""
    a, along = edges[:, 0], edges[:, 1] - edges[:, 0]
    t = np.clip(np.einsum("ei,ei->e", x - a, along) / np.einsum("ei,ei->e", along, along), 0.0, 1.0)
    return float(np.hypot(*(x - a - t[:, None] * along).T).min(initial=np.inf))


def parted(whole: Cells, cracks: Sequence[Crack], pairs: Array) -> Cells:
    """The mesh with nodes of their own on each face of every crack.

    Around a node on a crack the cells that hang together by sides off all cracks share a copy of it: one at a tip, two along
    the crack and at its mouth, as many as there are sectors where cracks meet.

    pairs : the numbers of sides, three to a cell, that are the same side of two cells.
    """
    slots = np.arange(whole.cells.size).reshape(whole.cells.shape)
    sides = np.array(SIDES[whole.order])
    rows, nodes = slots[:, sides].reshape(-1, sides.shape[1]), whole.cells[:, sides].reshape(-1, sides.shape[1])
    turned = nodes[:, 0] > nodes[:, 1]
    rows[turned, :2] = rows[turned, 1::-1]
    cut = on_cracks(whole.points, nodes[pairs[:, 0], :2], cracks)
    first, second = rows[pairs[~cut]].swapaxes(0, 1).reshape(2, -1)
    graph = coo_matrix((np.ones(len(first), np.int8), (first, second)), shape=(slots.size, slots.size))
    copy = connected_components(graph, directed=False)[1].reshape(slots.shape)
    split = np.zeros(len(whole.points), bool)
    split[nodes[pairs[cut, 0]]] = True
    # a copy's number is free to be any beyond the nodes' own
    origin = np.zeros(copy.max() + 1, np.int64)
    origin[copy] = whole.cells
    cells = np.where(split[whole.cells], len(whole.points) + copy, whole.cells)
    return compact(np.concatenate([whole.points, whole.points[origin]]), cells, whole.kind, whole.regions, whole.order)


def on_cracks(points: Array, edges: Array, cracks: Sequence[Crack]) -> Array:
    """Which of the edges (m, 2), node numbers, lie along a crack, (m,) bool."""
    near = NEAR * np.ptp(points)
    found = np.zeros(len(edges), bool)
    for crack in cracks:
        for a, b in zip(np.array(crack.points, float), np.array(crack.points[1:], float)):
            along = (b - a) / np.hypot(*(b - a))
            t, off = (points - a) @ along, (points - a) @ np.array([-along[1], along[0]])
            on = (np.abs(off) < near) & (t > -near) & (t < np.hypot(*(b - a)) + near)
            found |= on[edges].all(axis=1)
    return found


def move_to_quarter(made: Cells, tips: Sequence[Tip]) -> None:
    """Put the nodes on the sides that meet at a tip at a quarter of their length from it.

    On these cells r goes like the square of the distance in the reference cell along every ray from the tip, so that polynomials
    there are polynomials in sqrt(r) here (Henshell and Shaw 1975, Barsoum 1976).
    """
    for tip in tips:
        node = np.hypot(*(made.points - tip.at).T).argmin()
        for a, b, middle in SIDES[2]:
            for end, other in ((a, b), (b, a)):
                cells = made.cells[made.cells[:, end] == node]
                made.points[cells[:, middle]] = 0.75 * tip.at + 0.25 * made.points[cells[:, other]]
