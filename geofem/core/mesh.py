"""Distributed meshes of a scene: made or read on rank 0, the same whatever the number of ranks."""

from __future__ import annotations

from dataclasses import dataclass

import basix
import basix.ufl
import numpy as np
from dolfinx import fem, mesh
from dolfinx.graph import adjacencylist
from dolfinx.io.utils import distribute_entity_data
from mpi4py import MPI

from geofem.core import meshfile, meshing
from geofem.core.mpi import on_root
from geofem.mistake import Mistake
from geofem.scene import Array, MeshFile, Ring, Scene, Where


@dataclass(frozen=True)
class Body:
    """The bodies of a scene, meshed.

    mesh : cells of one shape; no ghost cells, so that every local cell is owned.
    regions : (local cells,) index into ``scene.regions``.
    groups : name -> indices of the local facets of a physical group of a mesh file.
    original_cells : (local cells,) number of each cell in the mesh that rank 0 made: it does not depend on the number of
        ranks and is the key of checkpoints.
    """

    mesh: mesh.Mesh
    regions: Array
    groups: dict[str, Array]
    original_cells: Array


def build(
    comm: MPI.Intracomm, scene: Scene, *, n: int, cell: str = "triangle", grading: float = 1.0, geometry_order: int = 1
) -> Body:
    """Mesh the regions of a scene. Collective.

    Boxes (and upright rectangles), layered or not, get one grid, a single ring a polar one; sides have round(side / h) cells
    with h = scene.length / n. A single convex quadrangle gets the bilinear image of a grid: n cells in both directions, or
    round(side / h) if it is a parallelogram. Other polygons, and several touching shapes, are meshed by Gmsh with the cell
    size h. Singular points of the scene are nodes. A mesh file brings its own cells: n, cell and grading do not apply.

    Parameters
    ----------
    n : cells across ``scene.length``.
    cell : ``triangle``, ``quadrilateral``, ``tetrahedron`` or ``hexahedron``.
    grading : exponent >= 1 of the distance law k**grading towards ``scene.singular``, see ``geofem.core.meshing``: n cells
        lie within ``scene.length`` of a singular point, smaller ones near it and larger ones beyond.
    geometry_order : polynomial order of the cells; above 1, those of a ring follow its circles, all others stay straight.

    Raises ``Mistake``: shapes that overlap or cannot be meshed, a file that is not a sound mesh, groups that it lacks.
    """
    body = distribute(comm, scene, on_root(comm, lambda: serial(scene, n, cell, grading)))
    return elevated(body, scene, geometry_order) if geometry_order > body.mesh.geometry.cmaps[0].degree else body


def distribute(comm: MPI.Intracomm, scene: Scene, made: meshing.Cells | None) -> Body:
    """The mesh that rank 0 has ``made``, shared out to all ranks; None on the others. Collective."""
    kind, order, nodes = comm.bcast(made and (made.kind, made.order, made.cells.shape[1]))
    element = basix.ufl.element("Lagrange", kind, order, basix.LagrangeVariant.equispaced, shape=(scene.gdim,))
    cells = made.cells if made else np.empty((0, nodes), np.int64)
    points = made.points if made else np.empty((0, scene.gdim))
    domain = mesh.create_mesh(comm, cells, element, points)
    original = np.asarray(domain.topology.original_cell_index, np.int64)
    if len(scene.regions) > 1:
        regions = comm.bcast(made and made.regions)[original]
    else:
        regions = np.zeros(len(original), np.int32)
    domain.topology.create_connectivity(scene.gdim - 1, scene.gdim)
    names = comm.bcast(made and list(made.groups))
    groups = {name: distributed_facets(domain, made.groups[name] if made else None) for name in names}
    return Body(domain, regions, groups, original)


def serial(scene: Scene, n: int, cell: str, grading: float) -> meshing.Cells:
    """The mesh of a scene on one process."""
    if any(isinstance(region.shape, MeshFile) for region in scene.regions):
        return meshfile.read(scene)
    return meshing.generate(scene, n, cell, grading)


def distributed_facets(domain: mesh.Mesh, nodes: Array | None) -> Array:
    """Local indices of the facets that rank 0 names by their input nodes (k, nodes)."""
    fdim = domain.topology.dim - 1
    width = domain.comm.bcast(nodes.shape[1] if nodes is not None else None)
    facets = nodes if nodes is not None else np.empty((0, width), np.int64)
    vertices, values = distribute_entity_data(domain, fdim, facets, np.zeros(len(facets), np.int32))
    tags = mesh.meshtags_from_entities(domain, fdim, adjacencylist(vertices), values.astype(np.int32))
    return np.asarray(tags.indices)


def elevated(body: Body, scene: Scene, order: int) -> Body:
    """The same cells on the same ranks with a geometry of higher order."""
    old = body.mesh
    comm, gdim = old.comm, old.geometry.dim
    space = fem.functionspace(old, ("Lagrange", order, (gdim,)))
    nodes = space.dofmap.index_map
    points = space.tabulate_dof_coordinates()[:, :gdim]
    cells = space.dofmap.list
    shape = scene.regions[0].shape
    if isinstance(shape, Ring) and len(scene.regions) == 1:
        points[cells] = on_circles(old, space.element.interpolation_points, np.array(shape.centre))

    def stay(comm: MPI.Intracomm, parts: int, kinds: list, vertices: list) -> object:
        return adjacencylist(np.full((len(cells), 1), comm.rank, np.int32))._cpp_object

    new = mesh.create_mesh(
        comm,
        nodes.local_to_global(cells.ravel().astype(np.int32)).reshape(cells.shape),
        space.ufl_element(),
        points[: nodes.size_local],
        partitioner=stay,
    )
    first = comm.exscan(len(cells)) or 0
    old_cell = np.asarray(new.topology.original_cell_index) - first
    return Body(new, body.regions[old_cell], carried_facets(old, new, old_cell, body.groups), body.original_cells[old_cell])


def on_circles(domain: mesh.Mesh, places: Array, centre: Array) -> Array:
    """Nodes (cells, places, 2) at local places (places, 2) of the cells, interpolated in polar coordinates."""
    element = basix.create_element(basix.ElementFamily.P, domain.basix_cell(), 1)
    weights = element.tabulate(0, places)[0, :, :, 0]
    arm = domain.geometry.x[domain.geometry.dofmaps[0]][:, :, :2] - centre
    start = np.arctan2(arm[:, :1, 1], arm[:, :1, 0])
    turn = np.arctan2(arm[:, :, 1], arm[:, :, 0]) - start
    turn -= 2 * np.pi * np.rint(turn / (2 * np.pi))
    radius, angle = np.hypot(arm[:, :, 0], arm[:, :, 1]) @ weights.T, start + turn @ weights.T
    return centre + radius[:, :, None] * np.stack([np.cos(angle), np.sin(angle)], axis=2)


def carried_facets(old: mesh.Mesh, new: mesh.Mesh, old_cell: Array, groups: dict[str, Array]) -> dict[str, Array]:
    """Facet groups of the old mesh on the new one: the same facets of the same cells."""
    fdim = old.topology.dim - 1
    tables = []
    for domain in old, new:
        domain.topology.create_connectivity(fdim + 1, fdim)
        domain.topology.create_connectivity(fdim, fdim + 1)
        tables.append(domain.topology.connectivity(fdim + 1, fdim).array.reshape(len(old_cell), -1))
    image = np.full(old.topology.index_map(fdim).size_local + old.topology.index_map(fdim).num_ghosts, -1, np.int32)
    image[tables[0][old_cell]] = tables[1]
    return {name: np.sort(image[facets]) for name, facets in groups.items()}


def facets(body: Body, where: Where, what: str) -> Array:
    """Local indices of the boundary facets that a predicate picks, or those of a physical group of the mesh file. Collective.

    A facet is picked if the predicate holds at all its vertices, which must still be at their reference positions.
    ``what`` names the support or load, for the ``Mistake`` that is raised if no facet on any rank is picked.
    """
    domain = body.mesh
    if isinstance(where, str):
        if where not in body.groups:
            have = ", ".join(sorted(body.groups)) or "none; name the parts of the boundary in a mesh file"
            raise Mistake(f"{what}: there is no group of facets {where!r} (there is {have})")
        found = body.groups[where]
    else:
        gdim = domain.geometry.dim
        domain.topology.create_connectivity(domain.topology.dim - 1, domain.topology.dim)
        found = mesh.locate_entities_boundary(domain, domain.topology.dim - 1, lambda x: where(x[:gdim]))
    if domain.comm.allreduce(len(found)) == 0:
        raise Mistake(f"{what}: picks no facet of the boundary; check 'where' against the bounds of the body")
    return found
