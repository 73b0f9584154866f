"""Meshes: right in area, conforming, graded by the law, the same on any number of ranks; files read, and refused when unsound."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import meshio
import numpy as np
import pytest
from conftest import LAUNCHER, start
from hypothesis import given, settings
from hypothesis import strategies as st
from mpi4py import MPI

from geofem.core import JIT, meshfile, meshing
from geofem.core.mesh import Body, build, facets
from geofem.mistake import Mistake
from geofem.scene import Box, Load, Material, MeshFile, Polygon, Region, Ring, Scene, Support, Where

# isort: split
import basix
import ufl
from dolfinx import fem

MESHES = Path(__file__).parents[1] / "meshes"
SOIL = Material("linear")
COOK = Polygon(((0, 0), (48, 44), (48, 60), (0, 44)))
SLOPE = Polygon(((0, -1), (4.2, -1), (4.2, 0), (3.2, 0), (1.2, 1), (0, 1)))
ROUNDING = 1e-11
"""Sums of some hundred to thousand products of numbers of size one."""


def scene(
    *shapes: object, length: float = 1.0, singular: tuple = (), solid: bool = False, where: tuple[Where, ...] = ()
) -> Scene:
    return Scene(
        "sketch", tuple(Region(f"r{i}", shape, SOIL) for i, shape in enumerate(shapes)), length,
        tuple(Support(str(i), w, (0,)) for i, w in enumerate(where)), singular=singular, plane="solid" if solid else "plane_strain",
    )  # fmt: skip


def made(case: Scene, **how: object) -> Body:
    return build(MPI.COMM_SELF, case, **{"n": 4, **how})


def volumes(body: Body) -> list[float]:
    """Area or volume of each region."""
    dx = ufl.Measure("dx", body.mesh, subdomain_data=[(k, np.flatnonzero(body.regions == k)) for k in range(3)])
    one = fem.Constant(body.mesh, 1.0)
    found = [fem.assemble_scalar(fem.form(one * dx(k), jit_options=JIT)) for k in range(3)]
    return [value for value in found if value]


def area_of(body: Body, found: np.ndarray) -> float:
    """Length or area of some boundary facets."""
    ends = fem.compute_integration_domains(fem.IntegralType.exterior_facet, body.mesh.topology, np.sort(found))
    ds = ufl.Measure("ds", body.mesh, subdomain_data=[(1, ends)])
    return fem.assemble_scalar(fem.form(fem.Constant(body.mesh, 1.0) * ds(1), jit_options=JIT))


def shoelace(shape: Polygon) -> float:
    x, y = np.array(shape.points).T
    return float(0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def is_conforming(cells: meshing.Cells) -> bool:
    """No facet belongs to three cells, and no node lies twice."""
    table = meshing.facet_vertices(cells.kind)
    rows = np.sort(cells.cells[:, table].reshape(-1, table.shape[1]), axis=1)
    once = len(np.unique(cells.points.round(9), axis=0)) == len(cells.points)
    return once and bool(np.unique(rows, axis=0, return_counts=True)[1].max() <= 2)


# --- generated --------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
@pytest.mark.parametrize(
    ("shapes", "areas"),
    [
        ([Box((0, 0), (2, 1))], [2]),
        ([Box((0, 0), (1, 1)), Box((0, 1), (1, 1.5))], [1, 0.5]),
        ([Box((0, 0), (1, 1)), Box((2, 0.5), (3, 1.5))], [1, 1]),
        ([Polygon(((0, 0), (2, 0), (2, 1), (0, 1)))], [2]),
        ([SLOPE], [shoelace(SLOPE)]),
        ([Polygon(((0, 0), (1, 0), (1, 1))), Polygon(((0, 0), (1, 1), (0, 1)))], [0.5, 0.5]),
        ([SLOPE, Box((0, -3), (4.2, -1))], [shoelace(SLOPE), 8.4]),
    ],
)
def test_regions_have_their_areas(cell: str, shapes: list, areas: list[float]) -> None:
    body = made(scene(*shapes), cell=cell)
    assert np.allclose(volumes(body), areas, rtol=ROUNDING)


@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
def test_layers_of_a_block_have_their_volumes(cell: str) -> None:
    body = made(scene(Box((0, 0, 0), (2, 1, 1)), Box((0, 0, 1), (2, 1, 1.5)), solid=True), cell=cell)
    assert np.allclose(volumes(body), [2, 1], rtol=ROUNDING)
    assert area_of(body, facets(body, lambda x: x[2] <= 0, "base")) == pytest.approx(2, rel=ROUNDING)


def test_n_is_the_number_of_cells_across_the_length() -> None:
    assert len(made(scene(Box((0, 0), (3, 1)), length=1.0), n=4, cell="quadrilateral").regions) == 12 * 4
    assert len(made(scene(Box((0, 0), (3, 1)), length=3.0), n=4, cell="quadrilateral").regions) == 4 * 1
    assert len(made(scene(COOK, length=44.0), n=8, cell="quadrilateral").regions) == 64
    rotated = Polygon(((0, 0), (2, 2), (1, 3), (-1, 1)))
    assert len(made(scene(rotated, length=2**0.5), n=4, cell="quadrilateral").regions) == 8 * 4


def test_cooks_membrane_is_the_bilinear_image_of_a_grid() -> None:
    cells = meshing.generate(scene(COOK), 4, "quadrilateral", 1.0)
    s = np.linspace(0, 1, 5)
    expected = {(round(48 * a, 9), round((1 - b) * 44 * a + b * (44 + 16 * a), 9)) for a in s for b in s}
    assert {(round(x, 9), round(y, 9)) for x, y in cells.points} == expected


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral", "tetrahedron", "hexahedron"])
def test_sides_lie_exactly_where_the_scene_puts_them(cell: str) -> None:
    """So that predicates without a tolerance find them, whatever the numbers."""
    gdim = 2 if cell in meshing.CELLS[2] else 3
    low, high = (-0.1, 0.3, 1 / 3)[:gdim], (0.7, 1.1, 1.7)[:gdim]
    for grading in (1.0, 2.3):
        body = made(scene(Box(low, high), singular=((0.2, *high[1:]),), solid=gdim == 3), n=7, cell=cell, grading=grading)
        for d in range(gdim):
            side = np.prod([high[k] - low[k] for k in range(gdim) if k != d])
            for where in (lambda x, d=d: x[d] <= low[d]), (lambda x, d=d: x[d] >= high[d]):
                assert area_of(body, facets(body, where, "side")) == pytest.approx(side, rel=ROUNDING)


def test_sides_of_an_unstructured_mesh_lie_exactly_too() -> None:
    shape = Polygon(((0.1, -0.7), (4.3, -0.7), (4.3, 0.3), (3.2, 0.3), (1.2, 1.1), (0.1, 1.1)))
    body = made(scene(shape), n=7)
    for where, length in (lambda x: x[0] <= 0.1, 1.8), (lambda x: x[1] >= 1.1, 1.1), (lambda x: x[1] <= -0.7, 4.2):
        assert area_of(body, facets(body, where, "side")) == pytest.approx(length, rel=ROUNDING)


@settings(max_examples=60, deadline=None)
@given(
    length=st.floats(0.1, 100),
    places=st.lists(st.floats(0, 1), max_size=3),
    breaks=st.lists(st.floats(0, 1), max_size=2),
    cells=st.integers(1, 60),
    grading=st.floats(1, 3),
)
def test_grid_lines_grow_hold_every_knot_and_keep_their_number(
    length: float, places: list[float], breaks: list[float], cells: int, grading: float
) -> None:
    poles, knots = [length * p for p in places], [0.0, length, *(length * b for b in breaks)]
    lines = meshing.axis(knots, length, cells, poles, grading)
    assert np.all(np.diff(lines) > 0)
    wanted = np.array([*poles, *knots])
    gap = np.abs(wanted[:, None] - lines).min(axis=1)
    assert gap.max() <= 1e-9 * length  # nearer ones count as one
    assert {0.0, length} <= set(lines)
    # each of at most six parts rounds its number by less than one; a pole has n cells within the length on either side
    assert cells - 6 <= len(lines) - 1 <= cells * max(1, 2 * len(poles)) + 6


def test_grading_is_the_power_law() -> None:
    """Grid lines at length (k / n)**g from the singular point; footing: x about its edge, y about the surface."""
    lines = meshing.axis([0, 5], 1.0, 3, [1.0], 2.0)
    u = np.sign(lines - 1) * np.sqrt(np.abs(lines - 1))  # n = 3 steps to the left and, as the root of 4 is 2, 6 to the right
    assert np.allclose(u, np.arange(-3, 7) / 3, rtol=0, atol=1e-14)
    body = made(scene(Box((0, -4), (5, 0)), singular=((1.0, 0.0),)), n=3, grading=2.0, cell="quadrilateral")
    assert len(body.regions) == 9 * 6
    y = np.unique(body.mesh.geometry.x[:, 1])
    assert np.allclose(y, -4 * (np.arange(6, -1, -1) / 6) ** 2, rtol=0, atol=1e-13)


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_an_unstructured_mesh_is_graded_by_the_same_law(cell: str) -> None:
    """Cell size by distance from the singular point, within a factor of two, and the point itself is a node."""
    n, grading, tip = 16, 2.0, np.array([3.2, 0.0])
    cells = meshing.generate(scene(SLOPE, singular=((3.2, 0.0),)), n, cell, grading)
    x = cells.points[cells.cells]
    size = np.sqrt(np.ptp(x, axis=1).prod(axis=1))
    distance = np.linalg.norm(x.mean(axis=1) - tip, axis=1)
    assert np.linalg.norm(cells.points - tip, axis=1).min() < 1e-14
    law = grading / n * distance**0.5
    away = distance > 0.2
    assert 0.5 < np.median(size[away] / law[away]) < 2.0
    assert size.min() < 0.2 / n


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_every_cell_is_sound_and_turns_the_same_way(cell: str) -> None:
    for case in (
        scene(SLOPE, singular=((3.2, 0.0), (1.0, -0.5))), scene(COOK, singular=((0, 44),)), scene(Ring((1, 2), 0.5, 1.5)),
        scene(SLOPE, Box((4.2, -1), (5, 0)), Ring((5.5, 0), 0.2, 0.4)), scene(Box((0, 0), (1, 1)), Box((1, 0), (2, 0.5))),
    ):  # fmt: skip
        cells = meshing.generate(case, 6, cell, 1.5)
        meshfile.check(Path("made"), cells.points, cells.cells, cells.kind, 1)
        x = cells.points[cells.cells]
        a, b = x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]
        assert np.all(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] > 0)
        assert is_conforming(cells)


def test_a_crossed_polygon_overlapping_regions_and_wrong_dimensions_are_mistakes() -> None:
    for case, how, word in (
        (scene(Box((0, 0), (1, 1)), Box((0.5, 0), (2, 1))), {}, "'r0' and 'r1' overlap"),
        (scene(SLOPE, Box((4, -1), (5, 0))), {}, "'r0' and 'r1' overlap"),
        (scene(Polygon(((0, 0), (2, 0), (2, 2), (1, -1), (0, 2)))), {}, "cross"),
        (scene(Box((0, 0), (1, 1))), {"cell": "hexahedron"}, "triangle or quadrilateral"),
        (scene(Box((0, 0), (1, 1)), solid=True), {"cell": "hexahedron"}, "3D scene"),
        (scene(Box((0, 0), (1, 1))), {"n": 0}, "n >= 1"),
        (scene(Box((0, 0), (1, 1))), {"grading": 0.5}, "grading >= 1"),
    ):
        with pytest.raises(Mistake, match=word) as caught:
            made(case, **how)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_curved_cells_of_a_ring_approach_its_area_at_their_order(cell: str) -> None:
    """The area's error is O(h**2) with straight cells, O(h**4) with quadratic ones (Ciarlet and Raviart 1972)."""
    exact = np.pi * (2**2 - 1)
    for order, rate in (1, 2.0), (2, 4.0):
        error = [
            abs(sum(volumes(made(scene(Ring((3, 1), 1, 2)), n=n, cell=cell, geometry_order=order))) / exact - 1)
            for n in (8, 16)
        ]
        assert np.log2(error[0] / error[1]) == pytest.approx(rate, abs=0.01)


@pytest.mark.parametrize("order", [2, 3])
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral", "tetrahedron", "hexahedron"])
def test_a_geometry_of_higher_order_is_the_same_body(cell: str, order: int) -> None:
    solid = cell in meshing.CELLS[3]
    case = scene(*(Box((0, 0, k)[: 2 + solid], (2, 1, k + 1)[: 2 + solid]) for k in range(1 + solid)), solid=solid)
    straight, curved = made(case, n=2, cell=cell), made(case, n=2, cell=cell, geometry_order=order)
    assert curved.mesh.geometry.cmap.degree == order
    assert np.allclose(volumes(curved), volumes(straight), rtol=ROUNDING)
    centre = [
        body.mesh.geometry.x[body.mesh.geometry.dofmaps[0]].mean(axis=1)[np.argsort(body.original_cells)]
        for body in (straight, curved)
    ]
    assert np.allclose(*centre, rtol=0, atol=1e-14)  # original_cells names the same cell


# --- facets -----------------------------------------------------------------------------------------------------------
def test_a_predicate_that_picks_nothing_is_a_mistake() -> None:
    body = made(scene(Box((0, 0), (1, 1))))
    with pytest.raises(Mistake, match="support 'base': picks no facet"):
        facets(body, lambda x: x[1] < -1, "support 'base'")
    with pytest.raises(Mistake, match="there is no group of facets 'base'"):
        facets(body, "base", "support 'base'")


def test_only_the_boundary_is_picked() -> None:
    body = made(scene(Box((0, 0), (1, 1)), Box((1, 0), (2, 1))), cell="quadrilateral")
    assert len(facets(body, lambda x: x[0] >= 0, "all")) == 2 * (8 + 4)


# --- files ------------------------------------------------------------------------------------------------------------
def from_file(name: str | Path, *groups: str | None, solid: bool = False, where: tuple[str, ...] = ()) -> Scene:
    return scene(*(MeshFile(MESHES / name, group) for group in groups), solid=solid, where=where)


@pytest.mark.parametrize(
    ("name", "groups", "areas", "sides"),
    [
        ("footing.msh", ("soil",), [20], {"base": 5, "side": 4, "surface": 4, "footing": 1, "symmetry": 4}),
        ("slope.msh", (None,), [2.2], {"base": 3.2, "face": 5**0.5, "crest": 1.2, "back": 1}),
        ("block.msh", ("sand", "clay"), [1, 1], {"base": 2, "top": 2}),
        ("plate.inp", ("rubber", "steel"), [1, 1], {"left": 1, "right": 1}),
        ("plate.inp", ("steel",), [1], {"left": 1}),
    ],
)
@pytest.mark.parametrize("order", [1, 2])
def test_files_bring_their_regions_and_their_named_sides(
    name: str, groups: tuple, areas: list[float], sides: dict[str, float], order: int
) -> None:
    body = made(from_file(name, *groups, solid=name == "block.msh"), geometry_order=order)
    assert np.allclose(volumes(body), areas, rtol=ROUNDING)
    assert {side: pytest.approx(area_of(body, facets(body, side, side)), rel=ROUNDING) for side in body.groups} == sides


def test_a_quadratic_file_keeps_its_order() -> None:
    assert made(from_file("slope.msh", None)).mesh.geometry.cmap.degree == 2


@pytest.mark.parametrize("kind", ["quad9", "hexahedron27", "triangle6", "tetra10"])
@pytest.mark.parametrize("suffix", [".msh", ".vtu"])
def test_quadratic_cells_of_both_readers_keep_their_shape(tmp_path: Path, kind: str, suffix: str) -> None:
    """The unit cell, its nodes bent by a quadratic map of known area: a wrong order of the nodes would change it."""
    shape, _, gdim = meshfile.SHAPES[kind]
    order = meshfile.cell_perm_vtk(meshfile.to_type(shape), int("".join(filter(str.isdigit, kind))))
    element = basix.create_element(basix.ElementFamily.P, basix.CellType[shape], 2, basix.LagrangeVariant.equispaced)
    x = np.zeros((len(order), 3))
    x[order, :gdim] = element.points
    x[:, 0] += 0.3 * x[:, 1] * (1 - x[:, 1])  # a shear: it leaves the volume as it is
    meshio.Mesh(x, [(kind, np.arange(len(x))[None])]).write(
        tmp_path / f"one{suffix}", file_format={".msh": "gmsh", ".vtu": "vtu"}[suffix]
    )
    body = made(scene(MeshFile(tmp_path / f"one{suffix}"), solid=gdim == 3))
    exact = {"triangle": 1 / 2, "tetrahedron": 1 / 6}.get(shape, 1.0)
    assert np.allclose(volumes(body), exact, rtol=ROUNDING)


def test_groups_of_a_converted_file_go_by_their_numbers(tmp_path: Path) -> None:
    mesh = meshio.read(MESHES / "footing.msh")
    mesh.cell_sets, mesh.field_data = {}, {}
    mesh.write(tmp_path / "footing.vtu")
    body = made(scene(MeshFile(tmp_path / "footing.vtu", "6")))
    assert np.allclose(volumes(body), [20], rtol=ROUNDING)
    assert area_of(body, facets(body, "4", "footing")) == pytest.approx(1, rel=ROUNDING)


def write(path: Path, points: list, *cells: tuple[str, list], **more: object) -> MeshFile:
    meshio.Mesh(np.array(points, float), list(cells), **more).write(path)
    return MeshFile(path)


SQUARE = [[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0.5]]
FAN = [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]


def test_numbering_a_cell_the_other_way_round_is_no_fault(tmp_path: Path) -> None:
    cells = [FAN[0], FAN[1][::-1], FAN[2], FAN[3][::-1]]
    assert np.allclose(volumes(made(scene(write(tmp_path / "fan.vtk", [[*p, 0] for p in SQUARE], ("triangle", cells))))), [1])


@pytest.mark.parametrize(
    ("points", "cells", "word"),
    [
        ([*SQUARE[:4], [0.5, -0.5]], [("triangle", FAN)], "on top of a neighbour"),
        ([*SQUARE[:4], [0.5, 0.0]], [("triangle", FAN)], "1 cell is flat"),
        ([[0, 0], [1, 0], [0.2, 0.2], [0, 1]], [("quad", [[0, 1, 2, 3]])], "folded"),
        ([[0, 0], [1, 0], [0, 1], [1, 1]], [("quad", [[0, 1, 2, 3]])], "folded"),
        (SQUARE, [("triangle", FAN[:2]), ("quad", [[0, 1, 2, 3]])], "mixes quad and triangle"),
        (SQUARE, [("line", [[0, 1]])], "the file has line"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 1]], [("triangle", [[0, 1, 2]])], "does not lie in a plane"),
    ],
)
def test_unsound_meshes_are_mistakes_that_say_what_and_where(tmp_path: Path, points: list, cells: list, word: str) -> None:
    path = tmp_path / "bad.vtk"
    points = [[*p, 0.0] if len(p) == 2 else p for p in points]
    with pytest.raises(Mistake, match=word) as caught:
        made(scene(write(path, points, *cells)))
    text = str(caught.value)
    assert text.startswith(str(path)) and "\n" not in text


def test_a_missing_group_is_named_with_those_that_there_are(tmp_path: Path) -> None:
    with pytest.raises(Mistake, match="footing.msh: region 'r0' wants the group 'clay' of cells; the file has soil"):
        made(from_file("footing.msh", "clay"))
    with pytest.raises(Mistake, match="support '0' wants the group 'bottom' of facets; the file has base, footing, side"):
        made(from_file("footing.msh", "soil", where=("bottom",)))
    with pytest.raises(Mistake, match="but the file has none; in Gmsh add Physical groups"):
        made(scene(write(tmp_path / "bare.vtk", [[*p, 0] for p in SQUARE], ("triangle", FAN)), where=("base",)))
    load = Scene("s", from_file("footing.msh", "soil").regions, 1.0, (), (Load("traction", (0, -1), "top"),))
    with pytest.raises(Mistake, match="the traction wants the group 'top' of facets"):
        made(load)
    with pytest.raises(Mistake, match="'r0' and 'r1' overlap"):
        made(from_file("footing.msh", "soil", None))
    with pytest.raises(Mistake, match="must all be groups of the same file"):
        made(scene(MeshFile(MESHES / "footing.msh"), Box((0, 0), (1, 1))))


def test_a_file_that_is_no_mesh_is_a_mistake_and_never_run(tmp_path: Path) -> None:
    script = tmp_path / "model.msh"
    script.write_text(f'SystemCall "touch {tmp_path / "ran"}";\n')
    text, nothing = tmp_path / "mesh.vtu", tmp_path / "nothing.msh"
    text.write_text("no xml")
    hdf = tmp_path / "mesh.xdmf"
    hdf.write_text('<Xdmf><DataItem Format="HDF">mesh.h5:/x</DataItem></Xdmf>')
    unknown, cut = tmp_path / "mesh.abc", tmp_path / "cut.msh"
    unknown.write_text("?")
    cut.write_bytes((MESHES / "footing.msh").read_bytes()[:1500])
    for path, word in (
        (script, "not a Gmsh mesh"), (text, "cannot read it"), (nothing, "No such file"), (hdf, "HDF5"), (unknown, "cannot read it"),
        (cut, "cut.msh"),
    ):  # fmt: skip
        with pytest.raises(Mistake, match=word) as caught:
            made(scene(MeshFile(path)))
        assert "\n" not in str(caught.value)
    assert not (tmp_path / "ran").exists()


def test_gmsh_of_the_caller_stays_open() -> None:
    import gmsh

    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.add("mine")
        gmsh.model.geo.addPoint(0, 0, 0)
        made(scene(SLOPE))
        gmsh.model.setCurrent("mine")
        gmsh.model.geo.synchronize()
        assert len(gmsh.model.getEntities(0)) == 1
    finally:
        gmsh.finalize()


# --- ranks ------------------------------------------------------------------------------------------------------------
RANKS = """
import json, sys
from pathlib import Path
import geofem.core
from geofem.core.mesh import build, facets
from geofem.core.mpi import gather_by_id
from geofem.scene import *
import numpy as np, ufl
from dolfinx import fem
from mpi4py import MPI
comm, soil = MPI.COMM_WORLD, Material("linear")
slope = Polygon(((0, -1), (4.2, -1), (4.2, 0), (3.2, 0), (1.2, 1), (0, 1)))
cases = [
    ("slope", [slope], dict(n=4, grading=2.0), ((3.2, 0.0),)),
    ("slope Q2", [slope], dict(n=4, cell="quadrilateral", geometry_order=2), ()),
    ("layers", [Box((0, 0), (1, 1)), Box((0, 1), (1, 1.5))], dict(n=4, geometry_order=3), ()),
    ("ring", [Ring((0, 0), 1, 2)], dict(n=4, geometry_order=2), ()),
    ("file", [MeshFile(Path("meshes/footing.msh"), "soil")], dict(n=1, geometry_order=2), ()),
    ("file P2", [MeshFile(Path("meshes/slope.msh"), "soil")], dict(n=1), ()),
]
out = {}
for name, shapes, how, singular in cases:
    scene = Scene(name, tuple(Region(str(i), s, soil) for i, s in enumerate(shapes)), 1.0, (), singular=singular)
    body = build(comm, scene, **how)
    cells = body.mesh.topology.index_map(2)
    assert cells.num_ghosts == 0 and len(body.regions) == cells.size_local == len(body.original_cells)
    nodes = body.mesh.geometry.x[body.mesh.geometry.dofmaps[0]]
    whole = gather_by_id(comm, body.original_cells, nodes, cells.size_global)
    regions = gather_by_id(comm, body.original_cells, body.regions, cells.size_global)
    left = facets(body, lambda x: np.hypot(x[0], x[1] + 1) <= 3, "left")
    out[name] = [
        comm.allreduce(fem.assemble_scalar(fem.form(fem.Constant(body.mesh, 1.0) * ufl.dx, jit_options=geofem.core.JIT))),
        body.mesh.geometry.index_map().size_global,
        {k: comm.allreduce(len(v)) for k, v in sorted(body.groups.items())}, comm.allreduce(len(left)),
    ]
    if comm.rank == 0:
        np.savez(f"{sys.argv[-1]}_{name}.npz", nodes=whole, regions=regions)
if comm.rank == 0:
    print(json.dumps(out))
"""


@pytest.mark.mpi
def test_the_mesh_does_not_depend_on_the_number_of_ranks(mpirun: Callable[..., str], tmp_path: Path) -> None:
    """Same cells with the same nodes in the same order under the same number, same regions, same groups, same area."""
    script = tmp_path / "script.py"
    script.write_text(RANKS)
    one, two, three = (json.loads(mpirun(n, str(script), str(tmp_path / str(n)))) for n in (1, 2, 3))
    for n, other in (2, two), (3, three):
        assert other.keys() == one.keys()
        for name, (area, *rest) in one.items():
            assert other[name][0] == pytest.approx(area, rel=ROUNDING)  # summed in another order
            assert other[name][1:] == rest, name
            with np.load(tmp_path / f"1_{name}.npz") as a, np.load(tmp_path / f"{n}_{name}.npz") as b:
                assert np.array_equal(a["regions"], b["regions"])
                # nodes of higher order are computed in whichever cell of theirs comes last
                assert np.allclose(a["nodes"], b["nodes"], rtol=0, atol=1e-14)


CHECKPOINT = """
import sys
from pathlib import Path
import geofem.core
from geofem.core import io, snapshot
from geofem.core.mesh import build
from geofem.core.mpi import gather_by_id
from geofem.result import write_npz
from geofem.scene import *
import basix.ufl, numpy as np
from dolfinx import fem
from mpi4py import MPI
comm, path = MPI.COMM_WORLD, Path(sys.argv[-1])
scene = Scene("s", (Region("r", Polygon(((0, -1), (4.2, -1), (4.2, 0), (3.2, 0), (1.2, 1), (0, 1))), Material("linear")),), 1.0, ())
field = lambda x: np.stack([np.sin(5 * x[0]) * x[1], x[0] - x[1] ** 2])
worst = 0.0
for order in 1, 2, 3:
    body = build(comm, scene, n=4, geometry_order=order)
    V = fem.functionspace(body.mesh, ("Lagrange", order, (2,)))
    Q = fem.functionspace(body.mesh, basix.ufl.quadrature_element("triangle", value_shape=(), degree=4))
    x, X = V.tabulate_dof_coordinates()[:, :2], Q.tabulate_dof_coordinates()[:, :2]
    u, owned = field(x.T).T, V.dofmap.index_map.size_local
    q = field(X.T)[0][Q.dofmap.list]
    file = path.with_name(f"{path.stem}{order}.npz")
    if sys.argv[-2] == "write":
        table = snapshot.gather_nodes(comm, x[:owned], u[:owned])
        cells = gather_by_id(comm, body.original_cells, q, body.mesh.topology.index_map(2).size_global)
        if comm.rank == 0:
            write_npz(file, {"u": table, "q": cells})
    else:
        arrays = io.load_checkpoint(file)
        worst = max(worst, np.abs(snapshot.scatter_nodes(arrays["u"], x) - u).max(), np.abs(arrays["q"][body.original_cells] - q).max())
worst = comm.allreduce(worst, op=MPI.MAX)
if comm.rank == 0:
    print(worst)
"""


@pytest.mark.mpi
@pytest.mark.parametrize(("writers", "readers"), [(1, 2), (3, 1)])
def test_a_checkpoint_is_taken_up_by_another_number_of_ranks(
    mpirun: Callable[..., str], tmp_path: Path, writers: int, readers: int
) -> None:
    """Nodal fields by reference position, point history by cell: each value where it belongs, for every order."""
    script = tmp_path / "script.py"
    script.write_text(CHECKPOINT)
    mpirun(writers, str(script), "write", str(tmp_path / "c"))
    # the fields vary by 10 a unit of length; positions of the two runs differ by rounding
    assert float(mpirun(readers, str(script), "read", str(tmp_path / "c"))) < 1e-12


FAILING = """
import geofem.core
from geofem.core import mpi
from geofem.core.mpi import on_root
from geofem.mistake import Mistake
from mpi4py import MPI
import sys
mpi.install_abort_hook()
comm = MPI.COMM_WORLD
def work():
    raise Mistake("n is too small; give a larger one")
if sys.argv[-1] == "root":
    on_root(comm, work)
elif sys.argv[-1] == "mistake" and comm.rank == comm.size - 1:
    work()
elif sys.argv[-1] == "bug" and comm.rank == comm.size - 1:
    1 / 0
comm.Barrier()
"""


@pytest.mark.mpi
@pytest.mark.parametrize("ranks", [1, 2])
@pytest.mark.parametrize(
    ("how", "status", "word"), [("root", 2, "n is too small"), ("mistake", 2, "n is too small"), ("bug", 1, "ZeroDivision")]
)
def test_one_failing_rank_ends_them_all(tmp_path: Path, ranks: int, how: str, status: int, word: str) -> None:
    """The other rank waits at a barrier: without the hook this would never end."""
    script = tmp_path / "script.py"
    script.write_text(FAILING)
    done = start(str(LAUNCHER), "-n", str(ranks), sys.executable, str(script), how, timeout=120)
    assert done.returncode == status
    assert done.stderr.count(word) == 1
    assert how == "bug" or "Traceback" not in done.stderr
