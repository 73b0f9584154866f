"""The boundary of moving bodies without a solver: nodes follow given velocities, and nothing may get lost."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geofem.methods.pfem.budget import KINDS, Amount, Budget
from geofem.methods.pfem.cloud import Cloud
from geofem.methods.pfem.contact import Obstacles
from geofem.methods.pfem.loops import first_crossing, link, tally
from geofem.methods.pfem.resample import needs, remesh
from geofem.methods.pfem.surface import Rules
from geofem.methods.pfem.tessellation.alpha import AlphaShape
from geofem.methods.pfem.tessellation.constrained import Constrained
from geofem.scene import Box, Material, Polygon, Region, Rigid, Scene, Support, Wall

BODY = (Region("body", Box((0, 0), (1, 1)), Material("water")),)
FLOOR = Wall("floor", lambda x: x[1] <= 0, (0, 1))


def disc(centre, radius, h):
    """Nodes of a disc, about h apart."""
    angle = np.arange(int(np.ceil(2 * np.pi * radius / h))) * h / radius
    angle *= 2 * np.pi / (angle[-1] + h / radius)
    k = int(radius / h) + 2
    i, j = (g.ravel() for g in np.meshgrid(np.arange(-k, k + 1), np.arange(-k, k + 1)))
    inner = np.column_stack([h * (i + 0.5 * (j % 2)), 0.87 * h * j])
    inner = inner[np.linalg.norm(inner, axis=1) < radius - 0.6 * h]
    return np.concatenate([radius * np.column_stack([np.cos(angle), np.sin(angle)]), inner]) + centre


def block(low, high, h):
    """Nodes of a rectangle, on a square lattice."""
    i, j = (np.linspace(a, b, round((b - a) / h) + 1) for a, b in zip(low, high))
    return np.stack(np.meshgrid(i, j), -1).reshape(-1, 2)


class Run:
    """Bodies on their way; after each step all of the bookkeeping is checked."""

    def __init__(self, x, h, walls=(), supports=(), gravity=(0.0, 0.0), velocity=None, rules=None):
        self.scene = Scene("motion", BODY, 1.0, tuple(supports), walls=tuple(walls))
        self.cloud = Cloud.at_rest(x, np.full(len(x), h))
        if velocity is not None:
            self.cloud.v = velocity(x)
        self.rules, self.tessellator = rules or Rules(), Constrained(backend="qhull")
        self.obstacles = Obstacles(self.scene, self.cloud)
        self.mesh = self.tessellator(self.cloud.x, self.cloud.size, None)
        self.budget = Budget(np.array(gravity))
        self.t = 0.0
        self.begin()

    def begin(self):
        """What there is now is the start of the books."""
        self.budget.look(self.cloud, self.mesh.cells)
        self.start = self.budget.now

    def amount(self):
        return Amount.of(self.cloud, self.mesh.cells, self.budget.gravity)

    def step(self, dt, velocity=None):
        cloud = self.cloud
        if velocity is None:
            cloud.x = cloud.x + dt * cloud.v + 0.5 * dt**2 * self.budget.gravity
            cloud.v = cloud.v + dt * self.budget.gravity
        else:
            middle = cloud.x + 0.5 * dt * velocity(cloud.x, self.t)
            cloud.v = velocity(middle, self.t + 0.5 * dt)
            cloud.x = cloud.x + dt * cloud.v
        self.t += dt
        self.budget.book("lagrangian", self.budget.look(cloud, self.mesh.cells))
        self.obstacles.clip(cloud, self.mesh.cells, self.budget)
        if needs(cloud, self.mesh, self.rules, self.budget, dt):
            moved, owed = self.amount(), self.budget.owed[:, 2].sum()
            self.mesh = remesh(cloud, self.mesh, self.obstacles, self.tessellator, self.rules, self.budget, dt)
            now = self.amount()
            scale = self.start.volume
            assert abs(now.volume - moved.volume + self.budget.owed[:, 2].sum() - owed) < 1e-12 * scale
            if not self.scene.walls:
                assert np.abs(now.momentum - moved.momentum).max() < 1e-12 * scale * max(1.0, np.abs(cloud.v).max())
        self.check()

    def check(self):
        cloud, change, booked = self.cloud, self.amount() - self.start, self.budget.total()
        assert change.volume == pytest.approx(booked.volume, abs=1e-12 * self.start.volume)
        for name in ("momentum", "kinetic", "potential"):
            assert getattr(change, name) == pytest.approx(getattr(booked, name), abs=1e-11)
        # Every node is in a cell or carries volume, and its neighbours are turned the right way.
        used = np.zeros(cloud.n, bool)
        used[self.mesh.cells] = True
        assert (used != (cloud.carried > 0)).all()
        assert len(np.unique(cloud.id)) == cloud.n
        assert all(len(a) == cloud.n for a in (cloud.X, cloud.v, cloud.p, cloud.size, cloud.region, *cloud.fields.values()))

    def share(self, kind):
        return self.budget.of[kind].volume / self.start.volume


def vortex(period):
    """The single vortex that turns back at half time (Rider and Kothe 1998)."""

    def velocity(x, t):
        a, b = np.pi * x.T
        swirl = np.column_stack([-(np.sin(a) ** 2) * np.sin(2 * b), np.sin(b) ** 2 * np.sin(2 * a)])
        return swirl * np.cos(np.pi * t / period)

    return velocity


def test_a_filament_is_drawn_out_and_rolled_up_again():
    run = Run(disc((0.5, 0.75), 0.15, 0.03), 0.03)
    first = run.cloud.n
    for _ in range(60):
        run.step(1 / 30, vortex(2.0))
    assert all(run.share(kind) == pytest.approx(0, abs=1e-12) for kind in KINDS if kind != "lagrangian")
    assert run.cloud.next_id > first + 20
    hull = run.cloud.x[np.unique(run.mesh.facets)] - (0.5, 0.75)
    assert np.linalg.norm(hull, axis=1) == pytest.approx(0.15, abs=0.01)


@settings(max_examples=4, deadline=None)
@given(st.floats(-0.15, 0.15), st.floats(0.0, 2 * np.pi), st.floats(0.02, 0.5))
def test_two_drops_become_one_without_volume(offset, turn, courant):
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, -s], [s, c]])
    x = np.concatenate([disc((-0.15, 0), 0.12, 0.03), disc((0.15, offset), 0.12, 0.03)]) @ rotation.T
    left = np.arange(len(x)) < len(x) // 2
    run = Run(x, 0.03, velocity=lambda x: np.where(left, 1.0, -1.0)[:, None] * rotation[:, 0])
    while run.t < 0.08:
        run.step(0.03 * courant)
    assert run.share("merge") > 1e-4
    assert run.share("merge") + run.share("restore") == pytest.approx(-run.budget.owed[:, 2].sum(), abs=1e-12)
    assert first_crossing(run.cloud.x, *link(run.cloud.x, run.mesh.facets)[:2])[0] == -1


def test_a_neck_parts():
    run = Run(disc((0, 0), 0.3, 0.05), 0.05)

    def pull(x, t):
        return np.column_stack([np.sin(6 * x[:, 0]) / 6, -np.cos(6 * x[:, 0]) * x[:, 1]])

    while run.t < 3.6:
        run.step(0.03, pull)
    assert run.share("separate") < 0


def test_a_flying_node_comes_back_with_all_that_it_carries():
    run = Run(block((0, 0), (1, 0.3), 0.05), 0.05, walls=[FLOOR])
    cloud = run.cloud
    drop = cloud.add(np.array([[0]]), np.array([[1.0]]))
    cloud.x[drop], cloud.carried[drop], cloud.v[drop] = (0.52, 0.5), 5e-4, (1.0, -2.0)
    cloud.fields["held"][drop] = 0.0
    run.begin()
    while (cloud.carried > 0).any():
        run.step(0.01)
        assert run.t < 0.3
    now = run.amount()
    assert now.volume == pytest.approx(run.start.volume, rel=1e-13)
    assert now.momentum == pytest.approx(run.start.momentum, rel=1e-12)
    assert cloud.x[np.unique(run.mesh.facets), 1].max() > 0.3


def test_a_piece_too_small_for_a_mesh_flies():
    x = np.concatenate([disc((0, 0), 0.3, 0.05), [(0.5, 0), (0.52, 0), (0.5, 0.02)]])
    run = Run(x, 0.05, velocity=lambda x: np.column_stack([0 * x[:, 0], np.where(x[:, 0] > 0.4, 1.0, 0.0)]))
    run.step(0.001)
    flies = run.cloud.carried > 0
    assert run.cloud.carried[flies] == pytest.approx([2e-4])
    assert run.cloud.v[flies][0] == pytest.approx([0, 1])
    assert run.cloud.x[flies][0] == pytest.approx([0.5 + 0.02 / 3, 0.001 + 0.02 / 3])


def test_a_drop_lands_on_the_floor_and_in_a_corner():
    walls = [FLOOR, Wall("left", lambda x: x[0] <= 0, (1, 0))]
    run = Run(disc((0.13, 0.13), 0.1, 0.02), 0.02, walls=walls, velocity=lambda x: np.full(x.shape, -1.0))
    for _ in range(15):
        run.step(0.008)
    assert run.cloud.x.min() >= 0.0
    touch = run.obstacles.touch(run.cloud)
    low = run.cloud.x == 0
    assert (touch.count == low.sum(axis=1)).all() and low.any(axis=0).all()
    assert (run.cloud.v[low] == 0).all()
    assert run.budget.of["wall"].momentum.min() > 0


def test_walls_and_supports_in_one_place_hold_once():
    base = Support("base", lambda x: x[1] <= 0, (0, 1))
    side = Support("side", lambda x: x[0] <= 0, (0,))
    rough = Wall("rough", lambda x: (x[1] <= 0) & (x[0] > 0.5), (0, 1), friction=0.3)
    run = Run(block((0, 0), (1, 0.5), 0.125), 0.125, walls=[rough], supports=[base, side])
    touch, x = run.obstacles.touch(run.cloud), run.cloud.x
    assert (touch.count == np.where(x[:, 1] == 0, 2, np.where(x[:, 0] == 0, 1, 0))).all()
    assert run.obstacles.held(run.cloud).sum(axis=0).tolist() == [4, 9, 9, 5]


def test_who_pulls_at_a_wall_is_let_go_and_held_again_when_it_comes_back():
    run = Run(block((0, 0), (1, 0.5), 0.125), 0.125, walls=[FLOOR])
    cloud, force = run.cloud, np.zeros_like(run.cloud.x)
    low = cloud.x[:, 1] == 0
    force[low, 1] = np.where(cloud.x[low, 0] < 0.3, -1.0, 1.0)
    let = run.obstacles.release(cloud, force, run.mesh.cells, run.budget)
    assert (let == (low & (cloud.x[:, 0] < 0.3))).all()
    cloud.v[let, 1] = 0.1
    run.begin()
    run.step(0.001)
    assert not run.obstacles.held(cloud)[let].any() and cloud.x[let, 1] == pytest.approx(1e-4)
    cloud.v[let, 1] = -0.1
    run.budget.of = Budget((0, 0)).of
    run.begin()
    run.step(0.001)
    assert run.obstacles.held(cloud)[let].all() and (cloud.x[let, 1] == 0).all()


@settings(max_examples=5, deadline=None)
@given(st.floats(0.15, 0.2), st.floats(-0.1, 0.1))
def test_bodies_that_overlap_become_one_of_the_same_volume(distance, offset):
    """As after a step that was too long: nothing but the moved boundaries tells that they overlap."""
    x = np.concatenate([disc((0, 0), 0.12, 0.03), disc((0.3, offset), 0.12, 0.03)])
    run = Run(x, 0.03)
    right = np.isin(np.arange(len(x)), np.arange(len(x) // 2, len(x)))
    run.cloud.x[right, 0] -= 0.3 - distance
    run.begin()
    for _ in range(3):
        run.step(0.001)
    assert run.share("merge") < -1e-4
    assert run.amount().volume + run.budget.owed[:, 2].sum() == pytest.approx(run.start.volume, rel=1e-12)
    node, nxt, _ = link(run.cloud.x, run.mesh.facets)
    assert tally(run.cloud.x, node, nxt)[1].min() > 0  # one loop, no hole
    assert first_crossing(run.cloud.x, node, nxt) == (-1, -1)


def test_a_trapped_hole_is_filled_when_it_is_small():
    """A ring that closes in: its hole shrinks below a tenth of a cell, and the last of it is given back outside."""
    angle = np.arange(24) * np.pi / 12
    rings = [r * np.column_stack([np.cos(angle + r), np.sin(angle + r)]) for r in (0.2, 0.25, 0.3, 0.35)]
    run = Run(np.concatenate(rings), 0.06, rules=Rules(gap=1e-3))

    def inwards(x, t):
        square = (x**2).sum(axis=1, keepdims=True)
        return -0.03 * x / np.maximum(square, 1e-4)

    while run.t < 0.8:
        run.step(0.02, inwards)
    node, nxt, _ = link(run.cloud.x, run.mesh.facets)
    assert tally(run.cloud.x, node, nxt)[1].min() > 0
    assert run.share("merge") > 0


@pytest.mark.parametrize("gdim", [2, 3])
def test_where_the_boundary_is_found_anew_nodes_come_and_go_inside(gdim):
    h = 0.25
    x = np.stack(np.meshgrid(*[np.linspace(0, 1, 5)] * gdim, indexing="ij"), -1).reshape(-1, gdim)
    inner = (np.abs(x - 0.5) < 0.49).all(axis=1)
    x[inner] += np.random.default_rng(1).uniform(-0.05, 0.05, (inner.sum(), gdim))
    cloud = Cloud.at_rest(x, np.full(len(x), h))
    cloud.v = x[:, ::-1].copy()
    body = (Region("body", Box((0,) * gdim, (1,) * gdim), Material("water")),)
    floor = Wall("floor", lambda x: x[-1] <= 0, (0,) * (gdim - 1) + (1,))
    scene = Scene("box", body, 1.0, (), plane="solid" if gdim == 3 else "plane_strain", walls=(floor,))
    obstacles, rules, budget = Obstacles(scene, cloud), Rules(boundary=False), Budget(np.zeros(gdim))
    alpha = AlphaShape(1.5, backend="qhull")
    mesh = alpha(cloud.x, cloud.size, None)
    budget.look(cloud, mesh.cells)
    start = budget.now
    cloud.size[:] = 0.7 * h
    mesh = remesh(cloud, mesh, obstacles, lambda x, size, old: alpha(x, np.full(len(x), h), old), rules, budget, 0.1)
    assert cloud.n > len(x)
    more = cloud.n
    cloud.size[:] = 2.5 * h
    mesh = remesh(cloud, mesh, obstacles, lambda x, size, old: alpha(x, np.full(len(x), 2 * h), old), rules, budget, 0.1)
    assert cloud.n < more
    now = Amount.of(cloud, mesh.cells, budget.gravity)
    assert (now - start).volume == pytest.approx(budget.total().volume, abs=1e-12)
    assert now.volume == pytest.approx(start.volume, rel=1e-12)
    assert now.momentum[:-1] == pytest.approx(start.momentum[:-1], rel=1e-12)
    assert obstacles.touch(cloud).normals.shape == (cloud.n, gdim, gdim)


def test_a_rigid_body_pushes_nodes_out_and_on():
    box = Rigid("box", Polygon(((-1.0, -0.2), (0.0, -0.2), (0.0, 0.7), (-1.0, 0.7))), motion=lambda t: (0.1 * t, 0.0))
    scene = Scene("push", BODY, 1.0, (), rigids=(box,))
    cloud = Cloud.at_rest(block((0, 0), (1, 0.5), 0.125), np.full(45, 0.125))
    obstacles, budget = Obstacles(scene, cloud), Budget(np.zeros(2))
    left = cloud.X[:, 0] == 0
    assert (obstacles.held(cloud)[:, 0] == left).all()
    obstacles.follow(0.5, 0.1)
    cells = Constrained(backend="qhull")(cloud.x, cloud.size, None).cells
    budget.look(cloud, cells)
    moved = obstacles.clip(cloud, cells, budget)
    assert moved[left] == pytest.approx(np.tile([0.05, 0.0], (5, 1))) and (moved[~left] == 0).all()
    assert cloud.v[left] == pytest.approx(np.tile([0.1, 0.0], (5, 1)))
    touch = obstacles.touch(cloud)
    assert (touch.normals[left, 0] == [1, 0]).all() and touch.speed[left, 0] == pytest.approx(0.1)
    assert budget.of["wall"].volume == pytest.approx(-0.025) and budget.owed[:, 2].sum() == pytest.approx(0.025)
    outside, normals = obstacles.solids[0].reach(np.array([[0.35, 1.1], [0.3, 0.1], [-0.4, 0.69]]))
    assert outside == pytest.approx([0.5, 0.25, -0.01])
    assert normals == pytest.approx(np.array([[0.6, 0.8], [1, 0], [0, 1]]))


def test_a_face_that_stands_on_a_wall_cannot_be_touched():
    block = Rigid("block", Polygon(((0.5, 0.0), (0.8, 0.0), (0.8, 0.4), (0.5, 0.4))))
    scene = Scene("block", BODY, 1.0, (), walls=(FLOOR,), rigids=(block,))
    cloud = Cloud.at_rest(np.array([(0.0, 0.0), (0.51, 0.0), (0.79, 0.01), (0.65, 0.39)]), np.full(4, 0.1))
    obstacles = Obstacles(scene, cloud)
    obstacles.clip(cloud, np.zeros((0, 3), np.int64), Budget(np.zeros(2)))
    assert cloud.x == pytest.approx(np.array([(0, 0), (0.5, 0), (0.8, 0.01), (0.65, 0.4)]))
    assert obstacles.touch(cloud).count.tolist() == [1, 2, 1, 1]
