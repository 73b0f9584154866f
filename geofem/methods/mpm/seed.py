"""Where material points begin: shapes and meshes filled with points and their domains."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from geofem.core import meshfile
from geofem.mistake import Mistake
from geofem.scene import Array, Box, Disc, MeshFile, Polygon, Ring, Scene, Shape


@dataclass(frozen=True)
class Seeds:
    """Points (n, d), their volumes (n,), half edge vectors of their domains (n, d, d), one row an edge, and, in the plane, the four
    corners of these (n, 4, 2), counter-clockwise. exact : the volume of the shape. box : its bounds, where they are known."""

    points: Array
    volumes: Array
    edges: Array
    corners: Array | None
    exact: float
    box: tuple[Array, Array] | None = None

    @property
    def bounds(self) -> tuple[Array, Array]:
        """The box around the shape, or around the domains."""
        if self.box is not None:
            return self.box
        extent = np.abs(self.edges).sum(axis=1)
        return (self.points - extent).min(axis=0), (self.points + extent).max(axis=0)


def fill_all(scene: Scene, spacing: float, axial: bool) -> list[Seeds]:
    """The points of every region, about ``spacing`` (m) apart; with axial symmetry volumes are per radian.

    Raises ``Mistake`` for a shape that is thinner than the spacing, and for a mesh file that cannot be used.
    """
    if any(isinstance(region.shape, MeshFile) for region in scene.regions):
        cells = meshfile.read(scene)
        made = [of_cells(cells.points, cells.cells[cells.regions == r], cells.kind, spacing) for r in range(len(scene.regions))]
    else:
        made = [fill(region.shape, spacing) for region in scene.regions]
    if not axial:
        return made
    turned = [s.volumes * s.points[:, 0] for s in made]
    return [replace(s, volumes=volumes, exact=float(volumes.sum())) for s, volumes in zip(made, turned)]


def fill(shape: Shape, spacing: float) -> Seeds:
    """Points that fill a shape.

    A box is divided evenly, and a ring or a disc into layers and these into sectors, so that the volumes add up to the shape's own;
    a convex polygon of four corners is divided by its bilinear map; of any other those squares of a lattice are taken whose centre lies
    inside, and their volumes scaled to add up to the polygon's.
    """
    if isinstance(shape, Ring):
        return sectors(np.array(shape.centre), shape.inner, shape.outer, spacing)
    if isinstance(shape, Disc):
        return sectors(np.array(shape.centre), 0.0, shape.radius, spacing)
    if isinstance(shape, Polygon):
        return mapped(shape, spacing) or lattice(shape, spacing)
    assert isinstance(shape, Box)
    low, high = np.array(shape.low), np.array(shape.high)
    count = np.maximum(1, np.round((high - low) / spacing)).astype(int)
    size = (high - low) / count
    axes = [a + s * (np.arange(n) + 0.5) for a, s, n in zip(low, size, count)]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(low))
    return squares(x, size, float(np.prod(high - low)))


def squares(x: Array, size: Array, exact: float) -> Seeds:
    """Points with upright domains of one size."""
    n, dim = x.shape
    edges = np.tile(np.diag(0.5 * size), (n, 1, 1))
    corners = None
    if dim == 2:
        corners = x[:, None] + 0.5 * size * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    return Seeds(x, np.full(n, size.prod()), edges, corners, exact)


def sectors(centre: Array, inner: float, outer: float, spacing: float) -> Seeds:
    """Layers of sectors; the innermost layer of a disc has four."""
    layers = max(1, round((outer - inner) / spacing))
    parts = []
    for a, b in pairwise(np.linspace(inner, outer, layers + 1)):
        count = max(4, round(np.pi * (a + b) / spacing))
        turn = 2 * np.pi * np.arange(count + 1) / count
        ray = np.column_stack([np.cos(turn), np.sin(turn)])
        corners = centre + np.stack([a * ray[:-1], b * ray[:-1], b * ray[1:], a * ray[1:]], axis=1)
        middle = 2 * np.pi * (np.arange(count) + 0.5) / count
        half = np.pi / count
        # the centre of mass of the sector, so that the points carry its mass where it is
        r = 2 / 3 * (b**3 - a**3) / (b**2 - a**2) * np.sin(half) / half
        x = centre + r * np.column_stack([np.cos(middle), np.sin(middle)])
        parts.append((x, np.full(count, np.pi * (b**2 - a**2) / count), corners))
    x, volumes, corners = (np.concatenate(arrays) for arrays in zip(*parts))
    return Seeds(x, volumes, half_edges(corners), corners, float(np.pi * (outer**2 - inner**2)))


def half_edges(corners: Array) -> Array:
    """Half edge vectors (n, 2, 2) of the parallelograms that fit quadrilaterals (n, 4, 2) best."""
    a, b, c, d = np.moveaxis(corners, 1, 0)
    return 0.25 * np.stack([b + c - a - d, c + d - a - b], axis=1)


def mapped(shape: Polygon, spacing: float) -> Seeds | None:
    """The parts of a convex polygon of four corners; None of any other."""
    p = np.array(shape.points)
    side = np.roll(p, -1, axis=0) - p
    after = np.roll(side, -1, axis=0)
    if len(p) != 4 or np.any(side[:, 0] * after[:, 1] - side[:, 1] * after[:, 0] <= 0):
        return None
    length = np.linalg.norm(side, axis=1)
    counts = [max(1, round(0.5 * (length[a] + length[a + 2]) / spacing)) for a in range(2)]
    return of_quadrilaterals(divide(p[None, [0, 1, 3, 2]], counts[0], counts[1]))


def divide(x: Array, first: int, second: int) -> Array:
    """Corners (n first second, 4, 2) of the parts of quadrilaterals (n, 4, 2), in dolfinx's vertex order, by their bilinear map."""
    r, s = np.meshgrid(np.linspace(0.0, 1.0, first + 1), np.linspace(0.0, 1.0, second + 1), indexing="ij")
    weights = np.stack([(1 - r) * (1 - s), r * (1 - s), (1 - r) * s, r * s], axis=-1)
    at = np.einsum("ijv,nvc->nijc", weights, x)
    return np.stack([at[:, :-1, :-1], at[:, 1:, :-1], at[:, 1:, 1:], at[:, :-1, 1:]], axis=3).reshape(-1, 4, 2)


def of_quadrilaterals(corners: Array) -> Seeds:
    """One point in each quadrilateral (n, 4, 2), at its centroid; corners may go round either way."""
    a, b, c, d = np.moveaxis(corners, 1, 0)
    one, other = 0.5 * np.linalg.det(np.stack([b - a, c - a], axis=1)), 0.5 * np.linalg.det(np.stack([c - a, d - a], axis=1))
    volumes = one + other
    x = (a + c + (one / volumes)[:, None] * b + (other / volumes)[:, None] * d) / 3.0
    back = volumes < 0
    corners = np.where(back[:, None, None], corners[:, [0, 3, 2, 1]], corners)
    volumes = np.abs(volumes)
    box = corners.reshape(-1, 2).min(axis=0), corners.reshape(-1, 2).max(axis=0)
    return Seeds(x, volumes, half_edges(corners), corners, float(volumes.sum()), box)


def lattice(shape: Polygon, spacing: float) -> Seeds:
    """Squares of a lattice over the polygon's box whose centres lie inside."""
    low, high = np.array(shape.bounds)
    count = np.maximum(1, np.round((high - low) / spacing)).astype(int)
    size = (high - low) / count
    axes = [low[c] + size[c] * (np.arange(count[c]) + 0.5) for c in range(2)]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    x = x[shape.contains(x.T)]
    if not len(x):
        raise Mistake(f"Polygon at {shape.points[0]}: thinner than the spacing of the points, {spacing:g} m; raise n or ppc")
    px, py = np.array(shape.points).T
    exact = float(0.5 * np.sum(px * np.roll(py, -1) - py * np.roll(px, -1)))
    made = squares(x, size, exact)
    return Seeds(x, np.full(len(x), exact / len(x)), made.edges, made.corners, exact)


def of_cells(points: Array, cells: Array, kind: str, spacing: float) -> Seeds:
    """Points in the straight cells of a mesh: each cell is divided until its parts are at most about ``spacing`` across.

    Quadrilaterals and hexahedra are divided by their own coordinates; simplices into the quadrilaterals or hexahedra between their
    corners and centroids first. cells : vertices in dolfinx's order.
    """
    simplex = kind.startswith("t")
    vertices = cells[:, : {"triangle": 3, "tetrahedron": 4, "quadrilateral": 4, "hexahedron": 8}[kind]]
    if not len(vertices):
        raise Mistake("a region has no cells of its own in the mesh file; name its physical group")
    x = points[vertices]
    box = points[np.unique(vertices)].min(axis=0), points[np.unique(vertices)].max(axis=0)
    dim = x.shape[2]
    if simplex:
        x = boxes_of_simplices(x)
    volume_of = tensor_volumes(x)
    across = float(np.mean(np.abs(volume_of)) ** (1.0 / dim))
    parts = max(1, round(across / spacing))
    if dim == 2:
        return replace(of_quadrilaterals(divide(x, parts, parts)), box=box)
    at = (np.arange(parts) + 0.5) / parts
    local = np.stack(np.meshgrid(*[at] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    signs = (np.arange(2**dim)[:, None] >> np.arange(dim)) & 1
    weights = np.prod(np.where(signs, local[:, None], 1.0 - local[:, None]), axis=2)
    where = np.einsum("pv,cvi->cpi", weights, x).reshape(-1, dim)
    slopes = []
    for a in range(dim):
        others = [b for b in range(dim) if b != a]
        w = np.prod(np.where(signs[:, others], local[:, None][..., others], 1.0 - local[:, None][..., others]), axis=2)
        slopes.append(np.einsum("pv,cvi->cpi", w * (2.0 * signs[:, a] - 1.0), x).reshape(-1, dim))
    edges = 0.5 / parts * np.stack(slopes, axis=1)
    volumes = np.abs(np.linalg.det(2.0 * edges))
    exact = float(np.abs(volume_of).sum())
    # turned so that the edges are right-handed
    flip = np.linalg.det(edges) < 0
    edges[flip, 0] *= -1.0
    return Seeds(where, volumes * exact / volumes.sum(), edges, None, exact, box)


def boxes_of_simplices(x: Array) -> Array:
    """Every triangle (n, 3, 2) as three quadrilaterals, every tetrahedron (n, 4, 3) as four hexahedra, in dolfinx's vertex order."""
    corners, dim = x.shape[1], x.shape[2]
    parts = []
    for c in range(corners):
        others = [v for v in range(corners) if v != c]
        vertices = []
        for bits in range(2**dim):
            # the corner itself, then the middles of edges, of faces, and of the cell that hold it
            group = [c, *(others[a] for a in range(dim) if (bits >> a) & 1)]
            vertices.append(x[:, group].mean(axis=1))
        parts.append(np.stack(vertices, axis=1))
    return np.concatenate(parts)


def tensor_volumes(x: Array) -> Array:
    """Volumes (n,) of bilinear quadrilaterals or trilinear hexahedra (n, 2**d, d), by Gauss's rule of 2 points a direction."""
    dim = x.shape[2]
    gauss = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0)
    signs = (np.arange(2**dim)[:, None] >> np.arange(dim)) & 1
    total = np.zeros(len(x))
    for local in np.stack(np.meshgrid(*[gauss] * dim, indexing="ij"), axis=-1).reshape(-1, dim):
        factors = np.where(signs, local, 1.0 - local)
        J = np.stack(
            [
                np.einsum("v,cvi->ci", np.prod(np.delete(factors, a, axis=1), axis=1) * (2.0 * signs[:, a] - 1.0), x)
                for a in range(dim)
            ],
            axis=2,
        )
        total += np.linalg.det(J) / 2**dim
    return total
