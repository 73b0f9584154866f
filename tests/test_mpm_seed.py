"""Where material points begin: volumes, centres, domains; and bodies from mesh files that are really run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest
from points import NOTHING, SOFT, block, build, finish, uniform

from geofem.methods.mpm.seed import Seeds, divide, fill, fill_all, tensor_volumes
from geofem.mistake import Mistake
from geofem.scene import Box, Disc, Material, MeshFile, Polygon, Region, Ring, Scene, Support

MESHES = Path(__file__).parents[1] / "meshes"
Array = np.ndarray


def meshed(path: Path, plane: str, *groups: str | None) -> Scene:
    regions = tuple(Region(str(group), MeshFile(path, group), SOFT) for group in groups)
    return Scene(
        name="meshed", regions=regions, length=1.0, supports=(), plane=plane, dynamic=True, t_end=0.01, loads=(NOTHING,)
    )


def areas(corners: Array) -> Array:
    """Of quadrilaterals (n, 4, 2), positive if they go round counter-clockwise."""
    x, y = corners[..., 0], corners[..., 1]
    return 0.5 * np.sum(x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1), axis=1)


def sound(seeds: Seeds, exact: float) -> None:
    """What all seeds have in common: volumes add up; edges and corners belong to the points and are right-handed."""
    n, d = seeds.points.shape
    assert seeds.exact == pytest.approx(exact, rel=1e-12) and seeds.volumes.sum() == pytest.approx(exact, rel=1e-12)
    assert np.all(seeds.volumes > 0) and np.all(np.linalg.det(seeds.edges) > 0)
    if d == 2:
        assert seeds.corners is not None
        a, b, c, e = np.moveaxis(seeds.corners, 1, 0)
        assert seeds.edges == pytest.approx(0.25 * np.stack([b + c - a - e, c + e - a - b], axis=1), abs=1e-14)
        assert np.all(areas(seeds.corners) > 0)
        scale = np.sqrt(seeds.volumes).max()
        assert np.abs(seeds.corners.mean(axis=1) - seeds.points).max() < 0.2 * scale
    else:
        assert seeds.corners is None
    low, high = seeds.bounds
    assert np.all(seeds.points > low) and np.all(seeds.points < high)


def centre(seeds: Seeds) -> Array:
    return seeds.volumes @ seeds.points / seeds.volumes.sum()


# --- shapes -------------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("shape", [Box((0.1, 0.2), (1.37, 0.9)), Ring((1.0, 2.0), 0.75, 1.25), Disc((1.0, 2.0), 0.7)])
@pytest.mark.parametrize("spacing", [0.07, 0.5, 3.0])
def test_points_fill_boxes_rings_and_discs_exactly(shape, spacing: float) -> None:
    """Volume and centre of mass are the shape's (rounding), whatever the spacing."""
    seeds = fill(shape, spacing)
    low, high = np.array(shape.bounds)
    if isinstance(shape, Box):
        exact = float(np.prod(high - low))
        sound(seeds, exact)
        assert areas(seeds.corners).sum() == pytest.approx(exact, rel=1e-12)
    else:
        inner, outer = (shape.inner, shape.outer) if isinstance(shape, Ring) else (0.0, shape.radius)
        exact = np.pi * (outer**2 - inner**2)
        assert seeds.exact == pytest.approx(exact, rel=1e-13) and seeds.volumes.sum() == pytest.approx(exact, rel=1e-13)
        if spacing < 0.1:
            sound(seeds, exact)
            # chords in place of arcs, which shrink with the square of the spacing; the four middle sectors are coarser
            assert areas(seeds.corners).sum() == pytest.approx(exact, rel=0.02)
            assert np.all(shape.contains(seeds.points.T))
    assert centre(seeds) == pytest.approx((low + high) / 2, rel=1e-13)


def test_points_fill_a_cuboid_exactly() -> None:
    seeds = fill(Box((0.0, -1.0, 2.0), (1.0, 0.5, 2.2)), 0.25)
    sound(seeds, 0.3)
    assert len(seeds.points) == 4 * 6 * 1 and centre(seeds) == pytest.approx([0.5, -0.25, 2.1], rel=1e-13)
    assert seeds.bounds[0] == pytest.approx([0.0, -1.0, 2.0]) and seeds.bounds[1] == pytest.approx([1.0, 0.5, 2.2])


def test_second_moment_of_a_disc() -> None:
    """Points at the centres of mass of their sectors miss the polar moment by the sectors' own, that is by the spacing squared."""
    error = []
    for spacing in (0.1, 0.05):
        seeds = fill(Disc((0.0, 0.0), 1.0), spacing)
        error.append(abs(seeds.volumes @ np.sum(seeds.points**2, axis=1) / (np.pi / 2) - 1))
    assert error[1] < 0.3 * error[0] < 3e-3


def test_a_triangle_is_filled_with_its_own_area() -> None:
    """Squares of a lattice cannot tile it: their volumes are scaled to add up, and the centre converges with the spacing."""
    triangle = Polygon(((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)))
    error = []
    for spacing in (0.1, 0.025):
        seeds = fill(triangle, spacing)
        sound(seeds, 0.5)
        error.append(np.abs(centre(seeds) - 1 / 3).max())
    assert error[1] < 0.5 * error[0] < 0.02


def test_a_quadrilateral_is_divided_by_its_bilinear_map() -> None:
    """Volume and centre are exact at any spacing, and the parts touch: every inner corner belongs to four of them."""
    shape = Polygon(((0.0, 0.0), (4.0, 0.0), (3.0, 1.0), (0.5, 1.5)))
    p = np.array(shape.points)
    exact = areas(p[None])[0]
    triangles = [p[[0, 1, 2]], p[[0, 2, 3]]]
    share = [0.5 * np.linalg.det(np.array([t[1] - t[0], t[2] - t[0]])) for t in triangles]
    middle = sum(s * t.mean(axis=0) for s, t in zip(share, triangles)) / exact
    for spacing in (0.3, 1.0, 5.0):
        seeds = fill(shape, spacing)
        sound(seeds, exact)
        assert centre(seeds) == pytest.approx(middle, rel=1e-12)
        assert areas(seeds.corners) == pytest.approx(seeds.volumes, rel=1e-12)
    seeds = fill(shape, 0.3)
    _, times = np.unique(np.round(seeds.corners.reshape(-1, 2), 9), axis=0, return_counts=True)
    assert np.sum(times == 1) == 4 and set(times) == {1, 2, 4}
    # one with a corner of more than 180 degrees has no such map
    sound(fill(Polygon(((0.0, 0.0), (1.0, 0.0), (0.3, 0.3), (0.0, 1.0))), 0.02), 0.3)


def test_a_polygon_thinner_than_the_spacing_is_a_mistake() -> None:
    with pytest.raises(Mistake, match="raise n or ppc"):
        fill(Polygon(((0.0, 0.0), (1.0, 0.49), (0.0, 0.98), (0.0, 0.6), (0.9, 0.49), (0.0, 0.4))), 1.0)


def test_axial_volumes_are_per_radian() -> None:
    """A ring of 1 <= r <= 3, 2 m high: (9 - 1) / 2 * 2 = 8 m3 per radian, exactly, as radii of points are means of their squares'."""
    scene = Scene(
        name="s", regions=(Region("r", Box((1.0, 0.0), (3.0, 2.0)), SOFT),), length=1.0, supports=(), plane="axisymmetric"
    )
    [seeds] = fill_all(scene, 0.4, True)
    assert seeds.volumes.sum() == pytest.approx(8.0, rel=1e-13) and seeds.exact == pytest.approx(8.0, rel=1e-13)
    [flat] = fill_all(scene, 0.4, False)
    assert seeds.volumes == pytest.approx(flat.volumes * flat.points[:, 0], rel=1e-14)


def test_half_lengths_are_cut_to_what_ugimp_can_hold() -> None:
    """Domains wider than a cell, from bodies that are no multiple of it, still give weights between 0 and 1."""
    scene = block(uniform(1.0, 0.0), regions=(Region("b", Box((0.0, 0.0), (0.7, 0.7)), SOFT),))
    for shape, most in (("gimp", 0.5), ("cpdi", 0.7)):
        model = build(scene, shape, n=2, ppc=1, scheme="usl")
        assert np.abs(model.bodies[0].own("domain")).max() == pytest.approx(most)
    model = finish(build(scene, "gimp", n=2, ppc=1, scheme="usl"))
    assert np.abs(model.snapshot()["stress"]).max() < 1e-4 and model.checks()["momentum"] < 1e-13


# --- meshes -------------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("spacing", [2.0, 0.2])
def test_meshes_of_triangles(spacing: float) -> None:
    """The layer of 5 x 4 m of footing.msh: exact volume and centre, at any spacing; parts of a triangle touch."""
    [seeds] = fill_all(meshed(MESHES / "footing.msh", "plane_strain", "soil"), spacing, False)
    sound(seeds, 20.0)
    assert centre(seeds) == pytest.approx([2.5, -2.0], abs=1e-10)
    assert areas(seeds.corners) == pytest.approx(seeds.volumes, rel=1e-9)
    assert seeds.bounds[0] == pytest.approx([0.0, -4.0], abs=1e-12) and seeds.bounds[1] == pytest.approx([5.0, 0.0], abs=1e-12)


def test_meshes_of_quadratic_triangles() -> None:
    [seeds] = fill_all(meshed(MESHES / "slope.msh", "plane_strain", "soil"), 0.2, False)
    sound(seeds, 1.2 + 1.0)


def test_meshes_of_tetrahedra() -> None:
    """block.msh: clay below z = 0.5 and sand above, 1 m3 each."""
    clay, sand = fill_all(meshed(MESHES / "block.msh", "solid", "clay", "sand"), 0.2, False)
    sound(clay, 1.0)
    sound(sand, 1.0)
    assert clay.points[:, 2].max() < 0.5 < sand.points[:, 2].min()
    # mid-points of the parts of a tetrahedron are not their centres of mass, but nearly so
    assert centre(clay) == pytest.approx([1.0, 0.5, 0.25], abs=0.01)


def write(path: Path, kind: str) -> Path:
    """A block of 2 x 1 (x 1) m of skewed quadrilaterals or hexahedra, in a file of meshio's."""
    if kind == "quad":
        x = np.stack(np.meshgrid([0.0, 0.9, 2.0], [0.0, 0.6, 1.0], indexing="ij"), axis=-1).reshape(-1, 2)
        x[4] += [0.1, -0.05]
        cells = [[3 * i + j, 3 * i + 3 + j, 3 * i + 4 + j, 3 * i + 1 + j] for i in range(2) for j in range(2)]
        x = np.column_stack([x, np.zeros(9)])
    else:
        x = np.stack(np.meshgrid([0.0, 0.9, 2.0], [0.0, 1.0], [0.0, 1.0], indexing="ij"), axis=-1).reshape(-1, 3)
        x[4:8] += [0.05, 0.0, 0.0]
        x[5, 0] += 0.1
        cells = [[4 * i, 4 * i + 4, 4 * i + 6, 4 * i + 2, 4 * i + 1, 4 * i + 5, 4 * i + 7, 4 * i + 3] for i in range(2)]
    meshio.write_points_cells(path, x, [(kind, np.array(cells))])
    return path


@pytest.mark.parametrize("kind", ["quad", "hexahedron"])
def test_meshes_of_meshio(kind: str, tmp_path: Path) -> None:
    path = write(tmp_path / "made.vtu", kind)
    plane = "plane_strain" if kind == "quad" else "solid"
    for spacing in (1.0, 0.25):
        [seeds] = fill_all(meshed(path, plane, None), spacing, False)
        sound(seeds, 2.0)
        assert centre(seeds)[0] == pytest.approx(1.0, abs=1e-9 if kind == "quad" else 0.02)
        assert seeds.bounds[1][0] == 2.0 and seeds.bounds[0][0] == 0.0


def test_volumes_of_bilinear_cells() -> None:
    """A trapezium, and parts of it, by quadrature."""
    x = np.array([[(0.0, 0.0), (2.0, 0.0), (0.0, 1.0), (1.0, 1.0)]])
    assert tensor_volumes(x) == pytest.approx([1.5])
    assert areas(divide(x, 3, 2)).sum() == pytest.approx(1.5)


@pytest.mark.parametrize("shape", ["gimp", "cpdi", "cpdi2"])
def test_a_body_from_a_mesh_file_runs(shape: str) -> None:
    """The soil of footing.msh on its base, pulled at by its weight: the base is held, though mesh nodes are off by rounding."""
    scene = meshed(MESHES / "footing.msh", "plane_strain", "soil")
    base = Support("base", lambda x: x[1] <= -4.0, (0, 1))
    side = Support("side", lambda x: (x[0] <= 0.0) | (x[0] >= 5.0), (0,))
    scene = replace(scene, supports=(base, side), length=4.0, t_end=0.02, initial_velocity=uniform(0.0, -1.0))
    transfer = "apic" if shape == "cpdi2" else "flip"
    model = finish(build(scene, shape, n=4, ppc=2, scheme="usl", transfer=transfer))
    assert model.checks()["momentum"] < 1e-12 and model.checks()["mass"] < 1e-14
    snapshot = model.snapshot()
    # a wave from the base has come sqrt(E (1 - nu) / ...) t = 1.5 m up by then: above, the body falls; below, it rests
    high, low = snapshot["points"][:, 1] > -1.5, snapshot["points"][:, 1] < -3.8
    assert snapshot["velocity"][high, 1] == pytest.approx(-1.0, abs=0.1) and np.abs(snapshot["velocity"][low, 1]).max() < 0.5
    assert np.all(snapshot["stress"][low, 1] < 0)
    assert model.work["steps"] >= 3


def test_a_tetrahedral_body_moves() -> None:
    """clay and sand of block.msh as two laws in space: momentum is kept."""
    scene = meshed(MESHES / "block.msh", "solid", "clay", "sand")
    scene = replace(scene, loads=(), initial_velocity=lambda x: np.stack([1.0 - x[2], x[0], 0 * x[0]]), t_end=0.005)
    regions = [replace(r, material=Material("neo_hooke", d, {"E": 4e6, "nu": 0.3})) for r, d in zip(scene.regions, (1e3, 2e3))]
    model = finish(build(replace(scene, regions=tuple(regions)), "cpdi", n=3, ppc=1, scheme="usl"))
    assert model.checks()["momentum"] < 1e-13 and np.abs(model.snapshot()["stress"]).max() > 1.0
