"""The boundary of bodies in space: edges split and collapsed, and volume given back, alone and in a dam that breaks."""

from __future__ import annotations

import numpy as np
import pytest

from geofem import methods, scenes
from geofem.methods.pfem.budget import Amount, Budget
from geofem.methods.pfem.cloud import Cloud
from geofem.methods.pfem.contact import Obstacles
from geofem.methods.pfem.resample import needs, remesh
from geofem.methods.pfem.skin import collapse, give_back, lengths, split, swept
from geofem.methods.pfem.surface import Rules
from geofem.methods.pfem.tessellation import Tessellation
from geofem.methods.pfem.tessellation.alpha import AlphaShape
from geofem.methods.pfem.tessellation.inside import InsideBody
from geofem.methods.pfem.tessellation.simplices import quality, volumes
from geofem.methods.pfem.tessellation.winding import enclosed_volume
from geofem.scene import Array, Box, Material, Region, Scene, Wall

BODY = (Region("body", Box((0, 0, 0), (1, 1, 1)), Material("water")),)
FLOOR = Wall("floor", lambda x: x[2] <= 0, (0, 0, 1))
SCENE = Scene("cube", BODY, 1.0, (), plane="solid", walls=(FLOOR,))


def cube(n: int) -> tuple[Cloud, Tessellation]:
    """Jittered nodes of the unit cube and its cells."""
    x = np.stack(np.meshgrid(*3 * [np.linspace(0, 1, n + 1)], indexing="ij"), axis=-1).reshape(-1, 3)
    inner = ((x > 0) & (x < 1)).all(axis=1)
    x[inner] += np.random.default_rng(0).uniform(-0.1, 0.1, (inner.sum(), 3)) / n
    cloud = Cloud.at_rest(x, np.full(len(x), 1 / n))
    return cloud, AlphaShape(1.5, backend="qhull")(x, cloud.size, None)


def closed(facets: Array) -> bool:
    """Whether each edge is run through as often forth as back."""
    n = facets.max() + 1
    a, b = facets.ravel(), np.roll(facets, -1, axis=1).ravel()
    return bool((np.sort(a * n + b) == np.sort(b * n + a)).all())


def test_long_edges_are_split_and_short_ones_collapsed() -> None:
    cloud, mesh = cube(3)
    obstacles = Obstacles(SCENE, cloud)
    cloud.x *= [2.5, 0.7, 0.25]
    volume = enclosed_volume(cloud.x, mesh.facets)
    facets = split(cloud, mesh.facets, 1.5)
    assert lengths(cloud, facets).max() <= 1.5 and closed(facets)
    assert enclosed_volume(cloud.x, facets) == pytest.approx(volume, rel=1e-13)
    held = obstacles.held(cloud)
    on_floor = held[:, 0] & np.isin(np.arange(cloud.n), facets)
    assert on_floor.sum() > 16 and (held[:, 0] == (cloud.x[:, 2] == 0)).all()
    kept, gone = collapse(cloud, facets, held, 0.45)
    assert gone.sum() > 10 and closed(kept) and not np.isin(np.flatnonzero(gone), kept).any()
    assert (lengths(cloud, kept) < 0.45).sum() < 0.8 * (lengths(cloud, facets) < 0.45).sum()  # no two neighbours at once
    assert cloud.x[kept, 2].min() == 0 and enclosed_volume(cloud.x, kept) == pytest.approx(volume, rel=0.1)
    change = swept(cloud.x, facets, kept)
    assert change[:, 3].sum() == pytest.approx(enclosed_volume(cloud.x, kept) - volume, rel=1e-10)


@pytest.mark.parametrize("share", [1e-4, -1e-4, 0.5])
def test_volume_is_given_back_to_the_free_surface_near_by_or_owed(share: float) -> None:
    cloud, mesh = cube(4)
    touch, budget = Obstacles(SCENE, cloud).touch(cloud), Budget(np.array([0.0, 0.0, -9.81]))
    before = cloud.x.copy()
    give_back(cloud, mesh.cells, mesh.facets, touch.count, np.array([[1.0, 0.5, 0.9, share]]), budget)
    given = share - budget.owed[:, 3].sum()
    assert volumes(cloud.x, mesh.cells).sum() - 1 == pytest.approx(given, rel=1e-10) and volumes(cloud.x, mesh.cells).min() > 0
    assert budget.of["restore"].volume == pytest.approx(given)
    moved = (cloud.x != before).any(axis=1)
    assert not moved[touch.count > 0].any() and not moved[np.setdiff1d(np.arange(cloud.n), mesh.facets)].any()
    if share < 0.1:
        assert given == share and np.linalg.norm(before[moved] - [1.0, 0.5, 0.9], axis=1).max() < 0.5
    else:
        assert 0 < given < share


def test_a_body_that_is_drawn_out_keeps_its_volume_and_has_no_needles() -> None:
    cloud, mesh = cube(3)
    obstacles, rules, budget = Obstacles(SCENE, cloud), Rules(boundary=False, skin=True), Budget(np.zeros(3))
    start, shapes = Amount.of(cloud, mesh.cells, budget.gravity).volume, []
    for _ in range(40):
        cloud.x *= np.exp([0.03, 0.0, -0.03])
        if needs(cloud, mesh, rules, budget, 0.1):
            mesh = remesh(cloud, mesh, obstacles, InsideBody(backend="qhull"), rules, budget, 0.1)
        shapes.append(quality(cloud.x, mesh.cells))
        now = Amount.of(cloud, mesh.cells, budget.gravity).volume
        assert now + budget.owed[:, 3].sum() == pytest.approx(start, rel=1e-11)
    assert np.mean([(q < 0.1).mean() for q in shapes]) < 0.02
    assert abs(budget.owed[:, 3].sum()) < 1e-3


def test_a_dam_in_space_breaks_without_losing_volume_or_iterations() -> None:
    """Measured to T = 3.5, 4 cells across: volume 4e-5 (1e-2 without), 3 iterations a step."""
    scene = scenes.get("dam_break")(setup="solid")
    model = methods.get("pfem").build(scene, n=4)
    end = 3.5 * np.sqrt(scene.length / (2 * 9.81))
    while model.t < end:
        model.step(model.dt())
    checks = model.checks()
    assert abs(checks["volume"]) < 1e-4 and abs(checks["volume_restore"]) > 1e-4
    assert model.work["newton"] < 5 * model.work["steps"] and model.work["cuts"] < 3
