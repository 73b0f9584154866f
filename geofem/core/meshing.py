"""Meshes of a scene's regions on one process, as plain arrays: mapped grids by numpy, all other shapes by Gmsh.

One law of grading serves all of them: with exponent ``grading`` the cells near a singular point have the size
h(d) ~ d**(1 - 1 / grading), d being the distance to it; k cells from it one is then at a distance ~ k**grading.
With 1 the cells are uniform. A field that behaves like d**a loses no order p if grading > p / a (Raugel 1978).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from geofem.mistake import Mistake
from geofem.scene import Array, Box, Disc, Point, Polygon, Region, Ring, Scene

CELLS = {2: ("triangle", "quadrilateral"), 3: ("tetrahedron", "hexahedron")}


@dataclass(frozen=True)
class Cells:
    """A mesh on one process.

    points : (n, gdim) m. cells : (m, nodes) node numbers in dolfinx's local order. kind : the shape of the cells.
    regions : (m,) number of the region of each cell. groups : name -> (k, nodes) the facets of a named part of the boundary.
    order : polynomial order of the geometry.
    """

    points: Array
    cells: Array
    kind: str
    regions: Array
    groups: dict[str, Array] = field(default_factory=dict)
    order: int = 1


def generate(scene: Scene, n: int, cell: str, grading: float) -> Cells:
    """Mesh the regions of a scene whose shapes are boxes, polygons and rings; see ``geofem.core.mesh.build``.

    Raises ``Mistake`` for shapes that overlap, that cross themselves or that cannot be meshed in the scene's dimension.
    """
    if cell not in CELLS[scene.gdim]:
        raise Mistake(f"scene {scene.name}: cells are {' or '.join(CELLS[scene.gdim])} in {scene.gdim}D, not {cell!r}")
    if n < 1 or grading < 1:
        raise Mistake(f"scene {scene.name}: needs n >= 1 and grading >= 1, got n = {n} and grading = {grading:g}")
    shapes = [upright(region.shape) for region in scene.regions]
    for region, shape in zip(scene.regions, shapes):
        if len(shape.bounds[0]) != scene.gdim:
            kind = type(shape).__name__
            raise Mistake(f"region {region.name}: a {kind} of {len(shape.bounds[0])}D does not fit a {scene.gdim}D scene")
        if isinstance(shape, Polygon):
            refuse_crossing(region.name, shape)
    h = scene.length / n
    first = shapes[0]
    if all(isinstance(shape, Box) for shape in shapes):
        return boxes(scene.regions, shapes, scene.length, n, cell, scene.singular, grading)
    if len(shapes) == 1 and isinstance(first, Ring):
        return ring(first, h, cell, scene.singular, grading)
    if len(shapes) == 1 and isinstance(first, Polygon) and is_mappable(first):
        return mapped(first, n, h, cell, scene.singular, grading)
    return fragments(scene.regions, shapes, scene.length, h, cell, scene.singular, grading)


def upright(shape: Any) -> Any:
    """The box that a rectangular polygon is if its sides lie along the axes; any other shape as it is."""
    if isinstance(shape, Polygon) and len(shape.points) == 4 and not shape.holes:
        low, high = shape.bounds
        if set(shape.points) == {low, high, (low[0], high[1]), (high[0], low[1])}:
            return Box(low, high)
    return shape


# --- mapped grids -----------------------------------------------------------------------------------------------------
def axis(knots: Sequence[float], length: float, n: float, poles: Sequence[float], grading: float) -> Array:
    """Grid lines from the lowest to the highest knot, graded towards the poles: about n cells across ``length`` from a pole.

    Every knot and every pole in between is a grid line, exactly. The lines are equally spaced between knots in
    u = |x - pole|**(1 / grading), with the nearest pole; without a pole in between they are equally spaced.
    """
    low, high = min(knots), max(knots)
    poles = [p for p in poles if low <= p <= high]
    places = distinct([low, high, *poles, *knots], high - low)
    stretch, shrink = distance_law(distinct(poles, high - low), grading)
    u = stretch(places)
    cells = max(1, round(n * float(u[-1] - u[0]) / (length ** (1 / grading) if poles else length)))
    inner = [shrink(np.linspace(a, b, k + 1)[1:-1]) for a, b, k in zip(u, u[1:], shares(np.diff(u), cells))]
    return np.concatenate([places[:1], *(np.append(line, place) for line, place in zip(inner, places[1:]))])


def distance_law(poles: Array, grading: float) -> tuple[Callable[[Array], Array], Callable[[Array], Array]]:
    """The map x -> u of ``axis``, continuous and growing, and its inverse; without poles u = x."""
    if len(poles) == 0:
        return np.asarray, np.asarray
    half = 0.5 * np.diff(poles)
    borders = poles[:-1] + half
    origin = np.concatenate([[0.0], np.cumsum(2 * half ** (1 / grading))])

    def stretch(x: Array) -> Array:
        k = np.searchsorted(borders, x)
        return origin[k] + np.sign(x - poles[k]) * np.abs(x - poles[k]) ** (1 / grading)

    def shrink(u: Array) -> Array:
        k = np.searchsorted(origin[:-1] + half ** (1 / grading), u)
        return poles[k] + np.sign(u - origin[k]) * np.abs(u - origin[k]) ** grading

    return stretch, shrink


def shares(lengths: Array, cells: int) -> Array:
    """How many of the cells each part gets, in proportion to its length and at least one."""
    return np.maximum(1, np.rint(cells * lengths / lengths.sum())).astype(int)


def distinct(values: Sequence[float], scale: float) -> Array:
    """Sorted, without those that differ from an earlier one by rounding only."""
    kept: list[float] = []
    for value in values:
        if all(abs(value - other) > 1e-9 * scale for other in kept):
            kept.append(value)
    return np.sort(np.array(kept, float))


def lattice(shape: Sequence[int]) -> Array:
    """Cells of a grid of ``shape`` cells, (m, 2**d) node numbers in tensor order; the first axis runs fastest."""
    nodes = np.arange(np.prod([k + 1 for k in shape])).reshape([k + 1 for k in shape[::-1]])
    corners = np.ndindex(*(2,) * len(shape))
    picks = [nodes[tuple(slice(b, b + k) for b, k in zip(corner, shape[::-1]))].ravel() for corner in corners]
    return np.stack(picks, axis=1)


def split(cells: Array, shape: Sequence[int], cell: str) -> Array:
    """Tensor cells as they are, or cut into simplices: (m, parts, nodes).

    Squares are cut by parallel diagonals, but for the two corners of the grid that these would leave to a single triangle:
    with alternating directions linear triangles hardly lock, which no mesh of a real body would grant them. Cubes are cut into
    the six tetrahedra around one space diagonal (Kuhn 1960).
    """
    if cell in ("quadrilateral", "hexahedron"):
        return cells[:, None]
    if cell == "triangle":
        parts = cells[:, [[0, 1, 2], [1, 3, 2]]]
        parts[[0, -1]] = cells[[0, -1]][:, [[0, 1, 3], [0, 3, 2]]]
        return parts
    return cells[:, [[0, 1, 3, 7], [0, 5, 1, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 4, 5, 7], [0, 6, 4, 7]]]


def boxes(
    regions: Sequence[Region],
    shapes: Sequence[Box],
    length: float,
    n: int,
    cell: str,
    singular: Sequence[Point],
    grading: float,
) -> Cells:
    """One grid through all boxes, with lines along all their sides; cells outside every box are left out."""
    low, high = np.array([s.low for s in shapes]), np.array([s.high for s in shapes])
    axes = [axis([*low[:, d], *high[:, d]], length, n, [p[d] for p in singular], grading) for d in range(low.shape[1])]
    shape = [len(line) - 1 for line in axes]
    points = np.stack([a.ravel() for a in np.meshgrid(*axes[::-1], indexing="ij")[::-1]], axis=1)
    cells = lattice(shape)
    owner = np.array([s.contains(points[cells].mean(axis=1).T) for s in shapes])
    refuse_overlap(regions, owner)
    inside = owner.any(axis=0)
    parts = split(cells, shape, cell)[inside]
    number = np.repeat(owner.argmax(axis=0)[inside], parts.shape[1])
    return compact(points, parts.reshape(-1, parts.shape[2]), cell, number)


def refuse_overlap(regions: Sequence[Region], owner: Array) -> None:
    """Mistake if a piece lies in two regions; owner : (regions, pieces) bool."""
    twice = owner.sum(axis=0) > 1
    if twice.any():
        a, b = np.flatnonzero(owner[:, twice.argmax()])[:2]
        raise Mistake(
            f"regions {regions[a].name!r} and {regions[b].name!r} overlap: cut one of them back to the common boundary"
        )


def compact(points: Array, cells: Array, kind: str, regions: Array, order: int = 1) -> Cells:
    """The mesh without the nodes that no cell uses."""
    used, cells = np.unique(cells, return_inverse=True)
    return Cells(points[used], cells.reshape(len(regions), -1), kind, regions.astype(np.int32), order=order)


def facet_vertices(kind: str) -> Array:
    """Local vertices of the facets of a cell in dolfinx's vertex order, (facets, vertices).

    Facet k of a simplex is opposite to vertex k; facets 2 a and 2 a + 1 of a square or cube are the two ends of axis a.
    """
    if kind in ("triangle", "tetrahedron"):
        corners = 3 if kind == "triangle" else 4
        return np.array([[v for v in range(corners) if v != k] for k in range(corners)])
    dim = 2 if kind == "quadrilateral" else 3
    return np.array([[v for v in range(2**dim) if (v >> a) & 1 == end] for a in range(dim) for end in (0, 1)])


def paired_facets(facets: Array) -> Array:
    """Which rows of facets (m, vertices) are the same facet of two cells: (pairs, 2) row numbers."""
    ordered = np.sort(facets, axis=1)
    rows = np.lexsort(ordered.T)
    same = np.all(ordered[rows[1:]] == ordered[rows[:-1]], axis=1)
    return np.stack([rows[:-1][same], rows[1:][same]], axis=1)


def corners_of(shape: Polygon) -> tuple[Array, Array, Array]:
    """Corners p (k, 2), the sides that leave them, and the sine of the turn at each (positive where convex)."""
    p = np.array(shape.points)
    side = np.roll(p, -1, axis=0) - p
    before = np.roll(side, 1, axis=0)
    turn = before[:, 0] * side[:, 1] - before[:, 1] * side[:, 0]
    return p, side, turn / (np.linalg.norm(before, axis=1) * np.linalg.norm(side, axis=1))


def refuse_crossing(name: str, shape: Polygon) -> None:
    """Mistake if two sides of a polygon cross or touch other than at a common corner: Gmsh would search for ever."""
    a, side, turn = corners_of(shape)
    b = a + side
    folded = (np.abs(turn) < 1e-9) & (np.sum(side * np.roll(side, 1, axis=0), axis=1) < 0)

    def left(x: Array) -> Array:
        """On which side (-1, 0, 1) of each side i, continued, each point j lies."""
        d = x - a[:, None]
        cross = side[:, None, 0] * d[..., 1] - side[:, None, 1] * d[..., 0]
        return np.sign(np.where(np.abs(cross) < 1e-12 * np.ptp(a) ** 2, 0.0, cross))

    start, end = left(a), left(b)
    between_ends = np.all((np.minimum(a, b)[:, None] <= a) & (a <= np.maximum(a, b)[:, None]), axis=2)
    touches = (start == 0) & between_ends
    crosses = (start * end < 0) & ((start * end).T < 0)
    i, j = np.indices(crosses.shape)
    strangers = (i != j) & (j != (i + 1) % len(a))
    if folded.any() or (strangers & (touches | (crosses & (i != (j + 1) % len(a))))).any():
        raise Mistake(f"region {name!r}: two sides of its polygon cross or touch; give its corners in their order around it")


def is_mappable(shape: Polygon) -> bool:
    """Four corners and no hole, none re-entrant or nearly straight: the bilinear map is one-to-one and well conditioned."""
    return len(shape.points) == 4 and not shape.holes and bool(np.all(corners_of(shape)[2] > 0.05))


def mapped(shape: Polygon, n: int, h: float, cell: str, singular: Sequence[Point], grading: float) -> Cells:
    """Bilinear image of a grid. A parallelogram gets cells of size h; any other quadrangle n cells in both directions."""
    p, side, _ = corners_of(shape)
    counts = [n, n]
    if np.allclose(p[0] + p[2], p[1] + p[3], rtol=0, atol=1e-9 * np.abs(side).max()):
        counts = [max(1, round(float(np.linalg.norm(side[k])) / h)) for k in range(2)]
    places = np.array([inverse_bilinear(p, np.array(point)) for point in singular]).reshape(-1, 2)
    xi, eta = (axis([0.0, 1.0], 1.0, counts[d], places[:, d].tolist(), grading) for d in range(2))
    t, s = (a.ravel()[:, None] for a in np.meshgrid(eta, xi, indexing="ij"))
    points = between(between(p[0], p[1], s), between(p[3], p[2], s), t)
    grid = [len(xi) - 1, len(eta) - 1]
    parts = split(lattice(grid), grid, cell)
    return Cells(points, parts.reshape(-1, parts.shape[2]), cell, np.zeros(parts.shape[0] * parts.shape[1], np.int32))


def between(a: Array, b: Array, s: Array) -> Array:
    """The point at the part s of the way from a to b; exact at both ends, and where a and b agree."""
    return np.where(s < 0.5, a + s * (b - a), b - (1 - s) * (b - a))


def inverse_bilinear(p: Array, x: Array) -> Array:
    """Parameters (s, t) of the point x (2,) in the quadrangle with corners p (4, 2), by Newton's method."""
    st = np.full(2, 0.5)
    for _ in range(50):
        s, t = st
        bottom, top = p[0] + s * (p[1] - p[0]), p[3] + s * (p[2] - p[3])
        slope = np.stack([(1 - t) * (p[1] - p[0]) + t * (p[2] - p[3]), top - bottom], axis=1)
        change = np.linalg.solve(slope, x - bottom - t * (top - bottom))
        st = st + change
        if np.abs(change).max() < 1e-14:
            break
    return st


def ring(shape: Ring, h: float, cell: str, singular: Sequence[Point], grading: float) -> Cells:
    """A polar grid: about h in both directions at the mean radius; the number around is a multiple of four."""
    centre = np.array(shape.centre)
    poles = [float(np.linalg.norm(np.array(p) - centre)) for p in singular]
    thickness = shape.outer - shape.inner
    radii = axis([shape.inner, shape.outer], thickness, max(1, round(thickness / h)), poles, grading)
    around = 4 * max(2, round(0.25 * np.pi * (shape.inner + shape.outer) / h))
    angle = 2 * np.pi * np.arange(around) / around
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = centre + (direction[:, None] * radii[:, None]).reshape(-1, 2)
    grid = [len(radii) - 1, around]
    parts = split(lattice(grid), grid, cell) % len(points)  # the last row of nodes is the first one again
    return Cells(points, parts.reshape(-1, parts.shape[2]), cell, np.zeros(parts.shape[0] * parts.shape[1], np.int32))


# --- Gmsh -------------------------------------------------------------------------------------------------------------
@contextmanager
def gmsh_model(name: str) -> Iterator[Any]:
    """A fresh, silent Gmsh model with default options; the caller's own Gmsh session, if there is one, stays open."""
    try:
        import gmsh
    except (ImportError, OSError) as error:
        raise Mistake(f"Gmsh cannot be loaded ({error}): 'geofem doctor' names the system package it lacks") from None
    outer = gmsh.isInitialized()
    if not outer:
        gmsh.initialize(readConfigFiles=False, interruptible=False)
    gmsh.option.restoreDefaults()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("General.NumThreads", 1)  # more would make the mesh depend on chance
    gmsh.model.add(name)
    try:
        yield gmsh
    finally:
        gmsh.model.remove()
        if not outer:
            gmsh.finalize()


def fragments(
    regions: Sequence[Region],
    shapes: Sequence[Any],
    length: float,
    h: float,
    cell: str,
    singular: Sequence[Point],
    grading: float,
) -> Cells:
    """Unstructured mesh of plane shapes, conforming where they touch; singular points are nodes."""
    with gmsh_model("regions") as gmsh:
        surfaces = [(2, plane_surface(gmsh.model.occ, shape)) for shape in shapes]
        nodes = [(0, gmsh.model.occ.addPoint(*point, 0.0)) for point in singular]
        try:
            pieces = [surfaces]
            if len(surfaces) + len(nodes) > 1:
                pieces = gmsh.model.occ.fragment(surfaces, nodes)[1][: len(shapes)]
            gmsh.model.occ.synchronize()
            tags = sorted({tag for found in pieces for _, tag in found})
            owner = np.array([[(2, tag) in found for tag in tags] for found in pieces])
            refuse_overlap(regions, owner)
            set_size(gmsh, length, h, singular, grading)
            if cell == "quadrilateral":
                # halving the triangles and quadrilaterals of a mesh of twice the size makes it all quadrilaterals
                for option, value in zip(("MeshSizeFactor", "Algorithm", "RecombineAll", "SubdivisionAlgorithm"), (2, 8, 1, 1)):
                    gmsh.option.setNumber(f"Mesh.{option}", value)
            gmsh.model.mesh.generate(2)
        except Exception as error:
            if isinstance(error, Mistake):
                raise
            raise Mistake(f"region {regions[0].name!r}: Gmsh cannot mesh it ({error}); check its corners") from None
        return collect(gmsh.model.mesh, tags, owner.argmax(axis=0), shapes, cell)


def plane_surface(occ: Any, shape: Any) -> int:
    """The tag of a new surface of that shape."""
    if isinstance(shape, Disc):
        return occ.addDisk(*shape.centre, 0.0, shape.radius, shape.radius)
    if isinstance(shape, Ring):
        outer, inner = (occ.addDisk(*shape.centre, 0.0, r, r) for r in (shape.outer, shape.inner))
        return occ.cut([(2, outer)], [(2, inner)])[0][0][1]
    if isinstance(shape, Box):
        (x, y), (a, b) = shape.low, shape.high
        shape = Polygon(((x, y), (a, y), (a, b), (x, b)))
    corners = [occ.addPoint(*p, 0.0) for p in shape.points]
    sides = [occ.addLine(a, b) for a, b in zip(corners, corners[1:] + corners[:1])]
    rims = [occ.addCurveLoop([occ.addCircle(*hole.centre, 0.0, hole.radius)]) for hole in shape.holes]
    return occ.addPlaneSurface([occ.addCurveLoop(sides), *rims])


def set_size(gmsh: Any, length: float, h: float, singular: Sequence[Point], grading: float) -> None:
    """The mesh size: h everywhere, or the law of grading h(d) = grading h (d / length)**(1 - 1 / grading).

    From d = 0 to d = length there are length / h cells; the first of them has the size length (h / length)**grading, which
    keeps the size from vanishing at the point itself.
    """
    for option in "MeshSizeFromPoints", "MeshSizeFromCurvature", "MeshSizeExtendFromBoundary":
        gmsh.option.setNumber(f"Mesh.{option}", 0)
    formulas = [repr(h)]
    if singular and grading > 1:
        least, slope, power = length * (h / length) ** grading, grading * h / length ** (1 - 1 / grading), 0.5 - 0.5 / grading
        formulas = [f"{least!r} + {slope!r} * ((x - ({p[0]!r}))^2 + (y - ({p[1]!r}))^2)^{power!r}" for p in singular]
    fields = []
    for formula in formulas:
        fields.append(gmsh.model.mesh.field.add("MathEval"))
        gmsh.model.mesh.field.setString(fields[-1], "F", formula)
    smallest = gmsh.model.mesh.field.add("Min")
    gmsh.model.mesh.field.setNumbers(smallest, "FieldsList", fields)
    gmsh.model.mesh.field.setAsBackgroundMesh(smallest)


GMSH_CELLS = {
    ("triangle", 1): (2, [0, 1, 2]),
    ("triangle", 2): (9, [0, 1, 2, 4, 5, 3]),
    ("quadrilateral", 1): (3, [0, 1, 3, 2]),
}
"""Gmsh's number of a shape and order of cells, and the places in its list of nodes of those in dolfinx's order."""


def collect(mesh: Any, tags: Sequence[int], numbers: Array, shapes: Sequence[Any], cell: str, order: int = 1) -> Cells:
    """The Gmsh mesh of the surfaces ``tags`` of regions ``numbers`` as arrays."""
    known, xyz, _ = mesh.getNodes()
    place = np.zeros(int(known.max()) + 1, np.int64)
    place[known] = np.arange(len(known))
    points = on_upright_sides(xyz.reshape(-1, 3)[:, :2].copy(), shapes)
    code, nodes = GMSH_CELLS[cell, order]
    blocks, regions = [], []
    for tag, number in zip(tags, numbers):
        codes, _, found = mesh.getElements(2, tag)
        assert list(codes) == [code], f"Gmsh made other cells than {cell}s"
        blocks.append(place[found[0].astype(np.int64)].reshape(-1, len(nodes))[:, nodes])
        regions.append(np.full(len(blocks[-1]), number))
    return compact(points, np.concatenate(blocks), cell, np.concatenate(regions), order)


def on_upright_sides(points: Array, shapes: Sequence[Any]) -> Array:
    """Take the rounding off nodes on sides along an axis, so that a predicate like x[1] >= 4 finds them."""
    for shape in shapes:
        if isinstance(shape, Polygon | Box):
            ends = np.array(shape.points if isinstance(shape, Polygon) else shape.bounds)
            for d in range(2):
                for value in np.unique(ends[:, d]):
                    points[np.abs(points[:, d] - value) < 1e-11 * np.ptp(ends), d] = value
    return points
