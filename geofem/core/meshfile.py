"""Meshes from files: Gmsh's .msh by Gmsh, anything else by meshio; checked before use, on one process."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import basix
import numpy as np
from dolfinx.io.utils import cell_perm_gmsh, cell_perm_vtk
from dolfinx.mesh import to_type

from geofem.core.meshing import CELLS, Cells, compact, facet_vertices, gmsh_model, paired_facets, refuse_overlap
from geofem.mistake import Mistake
from geofem.scene import Array, MeshFile, Scene

SHAPES = {  # meshio's name: shape, order, dimension
    "line": ("interval", 1, 1),
    "line3": ("interval", 2, 1),
    "triangle": ("triangle", 1, 2),
    "triangle6": ("triangle", 2, 2),
    "quad": ("quadrilateral", 1, 2),
    "quad9": ("quadrilateral", 2, 2),
    "tetra": ("tetrahedron", 1, 3),
    "tetra10": ("tetrahedron", 2, 3),
    "hexahedron": ("hexahedron", 1, 3),
    "hexahedron27": ("hexahedron", 2, 3),
}
GMSH = {1: "line", 8: "line3", 2: "triangle", 9: "triangle6", 3: "quad", 10: "quad9",
        4: "tetra", 11: "tetra10", 5: "hexahedron", 12: "hexahedron27"}  # fmt: skip


@dataclass
class Blocks:
    """What a file holds, in its own node order.

    points : (n, 3). cells : meshio's name of the shape -> (m, nodes). groups : name -> shape -> rows of ``cells``.
    point_groups : name -> node numbers, for formats that name parts of the boundary by their nodes.
    """

    points: Array
    cells: dict[str, Array] = field(default_factory=dict)
    groups: dict[str, dict[str, Array]] = field(default_factory=dict)
    point_groups: dict[str, Array] = field(default_factory=dict)


def read(scene: Scene) -> Cells:
    """The mesh of a scene whose regions are mesh files: all of them groups of one file.

    Raises ``Mistake``: the file cannot be read, lacks a group that a region, a support or a load names, has no cells of the
    scene's dimension or cells of several shapes, or is not a sound mesh (see ``check``).
    """
    shapes = [region.shape for region in scene.regions if isinstance(region.shape, MeshFile)]
    path = Path(shapes[0].path)
    if len(shapes) < len(scene.regions) or any(Path(shape.path) != path for shape in shapes):
        raise Mistake(f"scene {scene.name}: regions from a mesh file must all be groups of the same file, like {path}")
    blocks = read_msh(path) if path.suffix == ".msh" else read_meshio(path)
    name, kind, order = cell_shape(path, blocks, scene.gdim)
    found = blocks.cells[name]
    owner = np.ones((len(shapes), len(found)), bool)
    solid = {key: rows[name] for key, rows in blocks.groups.items() if name in rows}
    for k, (region, shape) in enumerate(zip(scene.regions, shapes)):
        if shape.group is not None:
            owner[k] = np.isin(np.arange(len(found)), member(path, solid, shape.group, f"region {region.name!r}", "cells"))
    refuse_overlap(scene.regions, owner)
    picked = owner.any(axis=0)
    permutation = (cell_perm_gmsh if path.suffix == ".msh" else cell_perm_vtk)(to_type(kind), found.shape[1])
    cells = found[picked][:, permutation]
    groups = boundary_groups(blocks, cells[:, : len(basix.geometry(basix.CellType[kind]))], kind, scene.gdim)
    wanted = [(f"support {support.name!r}", support.where) for support in scene.supports]
    wanted += [(f"the {load.kind}", load.where) for load in scene.loads if load.where is not None]
    for who, where in wanted:
        if isinstance(where, str):
            member(path, groups, where, who, "facets")
    points = blocks.points[:, : scene.gdim]
    if scene.gdim == 2 and np.ptp(blocks.points[:, 2]) > 1e-9 * np.ptp(points):
        raise Mistake(f"{path}: the mesh of this plane scene does not lie in a plane z = constant")
    check(path, points, cells, kind, order)
    used = np.unique(cells)
    place = np.full(len(points), -1)
    place[used] = np.arange(len(used))
    kept = {key: place[nodes[np.all(place[nodes] >= 0, axis=1)]] for key, nodes in groups.items()}
    made = compact(points, cells, kind, owner.argmax(axis=0)[picked])
    return Cells(made.points, made.cells, kind, made.regions, {k: v for k, v in kept.items() if len(v)}, order)


def member(path: Path, groups: dict[str, Array], name: str, who: str, what: str) -> Array:
    """The group of that name, or a ``Mistake`` that says which there are."""
    if name in groups:
        return groups[name]
    if groups:
        raise Mistake(f"{path}: {who} wants the group {name!r} of {what}; the file has {', '.join(sorted(groups))}")
    raise Mistake(
        f"{path}: {who} wants the group {name!r} of {what}, but the file has none;"
        " in Gmsh add Physical groups with names and save the mesh again"
    )


# --- the two readers --------------------------------------------------------------------------------------------------
def read_msh(path: Path) -> Blocks:
    """Read a Gmsh .msh file of any version, its groups being the physical ones; those without name are called by number."""
    try:
        with path.open("rb") as file:
            head = file.read(64)
    except OSError as error:
        raise Mistake(f"{path}: {error.strerror}; give the path of a mesh file") from None
    # Gmsh would run anything else as a script
    if not head.startswith(b"$MeshFormat"):
        raise Mistake(f"{path}: this is not a Gmsh mesh; save it with 'gmsh -3 -format msh4 model.geo' or gmsh.write")
    with gmsh_model("file") as gmsh:
        try:
            gmsh.merge(str(path))
        except Exception as error:
            raise Mistake(f"{path}: Gmsh cannot read it ({error}); save the mesh again") from None
        tags, xyz, _ = gmsh.model.mesh.getNodes()
        if len(tags) == 0:
            raise Mistake(f"{path}: the mesh has no nodes; mesh the model before saving it")
        place = np.zeros(int(tags.max()) + 1, np.int64)
        place[tags] = np.arange(len(tags))
        blocks = Blocks(xyz.reshape(-1, 3))
        rows = {}
        for code, numbers, nodes in zip(*gmsh.model.mesh.getElements()):
            name = GMSH.get(int(code), gmsh.model.mesh.getElementProperties(code)[0])
            blocks.cells[name] = place[nodes.astype(np.int64)].reshape(len(numbers), -1)
            rows[name] = numbers
        for dim, tag in gmsh.model.getPhysicalGroups():
            group = blocks.groups.setdefault(gmsh.model.getPhysicalName(dim, tag) or str(tag), {})
            for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, tag):
                for code, numbers, _ in zip(*gmsh.model.mesh.getElements(dim, entity)):
                    name = GMSH.get(int(code), "")
                    if name:
                        found = np.flatnonzero(np.isin(rows[name], numbers))
                        group[name] = np.union1d(group.get(name, found), found)
    return blocks


def read_meshio(path: Path) -> Blocks:
    """Read any format of meshio that needs no HDF5: its groups are cell sets and ``gmsh:physical`` numbers with their names."""
    import meshio

    try:
        if path.suffix in (".h5m", ".med", ".hmf", ".h5", ".cgns") or b'Format="HDF"' in path.read_bytes():
            # h5py and dolfinx bring two HDF5 libraries, which crash in one process
            raise Mistake(
                f"{path}: its data are HDF5, which is not read; convert it: meshio convert {path.name} {path.stem}.vtu"
            )
        mesh = meshio.read(path)
    except Mistake:
        raise
    except OSError as error:
        raise Mistake(f"{path}: {error.strerror or error}; give the path of a mesh file") from None
    except (Exception, SystemExit) as error:
        raise Mistake(
            f"{path}: meshio cannot read it ({str(error) or type(error).__name__}); save it as .msh or .vtu"
        ) from None
    points = np.zeros((len(mesh.points), 3))
    points[:, : mesh.points.shape[1]] = mesh.points
    blocks = Blocks(points, point_groups={k: np.asarray(v, np.int64) for k, v in mesh.point_sets.items()})
    names = {int(tag): key for key, (tag, _) in mesh.field_data.items()}
    for k, block in enumerate(mesh.cells):
        before = blocks.cells.get(block.type, np.empty((0, block.data.shape[1]), np.int64))
        blocks.cells[block.type] = np.concatenate([before, block.data])
        found = {key: rows[k] for key, rows in mesh.cell_sets.items() if rows[k] is not None and not key.startswith("gmsh:")}
        if "gmsh:physical" in mesh.cell_data:
            tags = mesh.cell_data["gmsh:physical"][k]
            found |= {names.get(int(tag), str(tag)): np.flatnonzero(tags == tag) for tag in np.unique(tags)}
        for key, rows in found.items():
            group = blocks.groups.setdefault(key, {})
            group[block.type] = np.union1d(group.get(block.type, []), np.asarray(rows) + len(before)).astype(np.int64)
    return blocks


def cell_shape(path: Path, blocks: Blocks, gdim: int) -> tuple[str, str, int]:
    """meshio's name, the shape and the order of the cells of dimension gdim. Raises ``Mistake`` if there is not just one."""
    names = [name for name in blocks.cells if name in SHAPES and SHAPES[name][2] == gdim]
    if not names:
        have = ", ".join(sorted(blocks.cells)) or "no cells at all"
        raise Mistake(f"{path}: a {gdim}D scene wants cells ({' or '.join(CELLS[gdim])}, order 1 or 2), the file has {have}")
    if len(names) > 1:
        raise Mistake(f"{path}: mixes {' and '.join(sorted(names))} cells; mesh it again with one shape and order")
    return names[0], *SHAPES[names[0]][:2]


def boundary_groups(blocks: Blocks, vertices: Array, kind: str, gdim: int) -> dict[str, Array]:
    """Name -> vertices (k, nodes) of the facets of each group; of a group of points, the boundary facets between them."""
    table = facet_vertices(kind)
    groups: dict[str, list[Array]] = {}
    for name, parts in blocks.groups.items():
        for shape, rows in parts.items():
            if SHAPES.get(shape, ("", 0, 0))[2] == gdim - 1:
                groups.setdefault(name, []).append(blocks.cells[shape][rows][:, : table.shape[1]])
    if blocks.point_groups:
        facets = vertices[:, table].reshape(-1, table.shape[1])
        outer = np.ones(len(facets), bool)
        outer[paired_facets(facets).ravel()] = False
        for name, nodes in blocks.point_groups.items():
            picked = facets[outer & np.isin(facets, nodes).all(axis=1)]
            if len(picked):
                groups.setdefault(name, []).append(picked)
    return {name: np.concatenate(parts) for name, parts in groups.items()}


# --- is it a mesh -----------------------------------------------------------------------------------------------------
def check(path: Path, points: Array, cells: Array, kind: str, order: int) -> None:
    """Raise ``Mistake``, with their number and the first one's place, if cells are flat, folded or lie on a neighbour.

    Flat or folded: the Jacobian at the nodes is zero (below 1e-10 of the cube of the cell's extent, or its square in 2D) or
    changes its sign. On a neighbour: two cells lie on the same side of the facet that they share. The sense in which a file
    numbers the nodes of a cell does not matter.
    """
    gdim = points.shape[1]
    element = basix.create_element(basix.ElementFamily.P, basix.CellType[kind], order, basix.LagrangeVariant.equispaced)
    slopes = element.tabulate(1, element.points)[1:, :, :, 0]
    x = points[cells]
    jacobian = np.linalg.det(np.einsum("dqn,cni->cqid", slopes, x))
    flat = np.abs(jacobian).min(axis=1) < 1e-10 * np.ptp(x, axis=1).max(axis=1) ** gdim
    folded = jacobian.min(axis=1) * jacobian.max(axis=1) < 0
    complain(path, "flat", flat, x)
    complain(path, "folded (the Jacobian changes its sign inside)", folded, x)
    table = facet_vertices(kind)
    facets = cells[:, table].reshape(-1, table.shape[1])
    pairs = paired_facets(facets)
    middle = x.mean(axis=1)
    corner = points[np.sort(facets[pairs[:, 0]], axis=1)]
    edges = corner[:, 1:gdim] - corner[:, :1]
    sides = [
        np.linalg.det(np.concatenate([edges, (middle[c] - corner[:, 0])[:, None]], axis=1)) for c in (pairs // len(table)).T
    ]
    overlapping = np.zeros(len(cells), bool)
    overlapping[pairs[sides[0] * sides[1] >= 0, 0] // len(table)] = True
    complain(path, "on top of a neighbour (the mesh is folded there)", overlapping, x)


def complain(path: Path, what: str, bad: Array, x: Array) -> None:
    """Mistake if any cell is bad; x : (cells, nodes, gdim) the nodes of each."""
    if bad.any():
        place = ", ".join(f"{value:.4g}" for value in x[bad.argmax()].mean(axis=0))
        cells = f"{bad.sum()} cells are" if bad.sum() > 1 else "1 cell is"
        raise Mistake(f"{path}: {cells} {what}, the first one around ({place}); mend the mesh")
