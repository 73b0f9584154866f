"""Cracks that end on each other and cross: the parts between them move on their own, whatever the mesh."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import geofem
from geofem import methods, scenes
from geofem.methods.xfem import geometry, junctions
from geofem.scene import Box, Crack, Material, Probe, Region, Scene, Support

SQUARE = Region("square", Box((0.0, 0.0), (1.0, 1.0)), Material("linear_elastic", 1.0, {"E": 1.0, "nu": 0.3}))


def all_around(x):
    return (x[0] < 1e-9) | (x[0] > 1 - 1e-9) | (x[1] < 1e-9) | (x[1] > 1 - 1e-9)


def held(cracks, motion):
    """The unit square with cracks, moved as told all around."""
    supports = tuple(Support(f"u{i}", all_around, (i,), lambda x, t, i=i: motion(x, t)[i]) for i in range(2))
    return Scene("held", (SQUARE,), 1.0, supports, cracks=tuple(map(Crack, cracks)), strain="small")


def far(at, angle):
    return at[0] + 2.0 * np.cos(angle), at[1] + 2.0 * np.sin(angle)


def parted(at, angles):
    """A motion that turns and shifts each sector between rays from a point as a rigid body of its own; angles sorted, 0 to 2 pi."""
    rigid = np.random.default_rng(0).uniform(-1.0, 1.0, (len(angles), 3))

    def motion(x, t):
        u, v, turn = rigid[sector_of(np.asarray(x), at, angles)].T
        return t * np.array([u - turn * x[1], v + turn * x[0]])

    return motion


def sector_of(x, at, angles):
    theta = np.mod(np.arctan2(x[1] - at[1], x[0] - at[0]), 2 * np.pi)
    return np.searchsorted(angles, theta) % len(angles)


def area_of(at, low, high):
    """Area of the sector of the unit square between two rays."""
    corners = [np.mod(np.arctan2(y - at[1], x - at[0]) - low, 2 * np.pi) for x in (0, 1) for y in (0, 1)]
    turn = np.mod(high - low, 2 * np.pi)
    ways = low + np.sort([0.0, turn, *(c for c in corners if c < turn)])
    d = np.array([np.cos(ways), np.sin(ways)])
    d[np.abs(d) < 1e-12] = 1e-12  # along a side
    reach = np.min([np.where(d[i] > 0, 1 - at[i], -at[i]) / d[i] for i in range(2)], axis=0)
    x, y = reach * d
    return 0.5 * np.sum(x[:-1] * y[1:] - x[1:] * y[:-1])


def check_star(at, angles, cracks, n=8, condition=1.2e4, tolerance=1e-8):
    """Each sector moves as a rigid body, exactly; its area is exact; the matrix is as good as one without junctions."""
    angles = np.sort(np.mod(angles, 2 * np.pi))
    motion = parted(at, angles)
    model = methods.get("xfem").build(held(cracks, motion), n=n)
    model.step(1.0)
    # nodes with less than 1e-10 of their support on the other side carry no jump
    assert model.probe(Probe("error", "displacement_error", exact=motion)) < tolerance
    assert abs(model.energy()["internal"]) < tolerance
    body = model.cracked
    assert not len(body.tips.at)
    rule = body.whole[0]
    sector = sector_of(rule.x.T, at, angles)
    for k, (low, high) in enumerate(pairwise([angles[-1] - 2 * np.pi, *angles])):
        assert rule.w[sector == k].sum() == pytest.approx(area_of(at, low, high), rel=1e-9)
    assert body.system.condition() < condition
    return body


T, X, Y = (0.0, 180.0, 90.0), (0.0, 180.0, 90.0, -90.0), (90.0, 210.0, 330.0)


@pytest.mark.parametrize("at", [(0.53, 0.46), (0.5, 0.5), (0.5625, 0.5), (0.5625, 0.5625), (0.5, 0.5 + 1e-9)],
                         ids=("inside", "node", "edge", "diagonal", "nearly"))  # fmt: skip
@pytest.mark.parametrize(("ways", "turn"), [(T, 0.0), (T, 13.0), (X, 0.0), (X, 45.0), (Y, 0.0), ((0.0, 180.0, 20.0), 0.0)],
                         ids=("T", "turned_T", "X", "diagonal_X", "Y", "sharp"))  # fmt: skip
def test_parts_between_cracks_move_as_they_are_told(at, ways, turn):
    angles = np.radians(np.array(ways) + turn)
    ends = [far(at, angle) for angle in angles]
    check_star(at, angles, [(ends[0], at, ends[1]), *((at, end) for end in ends[2:])])


@settings(max_examples=25, deadline=None)
@given(
    st.tuples(st.floats(0.3, 0.7), st.floats(0.3, 0.7)),
    st.lists(st.floats(0.35, 2.0), min_size=3, max_size=5),
    st.floats(0.0, 6.28),
    st.randoms(use_true_random=False),
)
def test_any_star_parts_the_body(at, gaps, turn, random):
    """Any rays from any point, told in any order and direction, two of them as one crack or all apart."""
    angles = turn + np.cumsum(gaps) * 2 * np.pi / sum(gaps)
    ends = [far(at, angle) for angle in angles]
    random.shuffle(ends)
    cracks = [(at, end) if random.random() < 0.5 else (end, at) for end in ends]
    if random.random() < 0.5:
        cracks = [(ends[0], at, ends[1]), *cracks[2:]]
    random.shuffle(cracks)
    check_star(at, angles, cracks)


def test_a_crossing_needs_no_point_of_it():
    at = np.array((0.53, 0.47))
    angles = np.radians([20.0, 200.0, 110.0, 290.0])
    ends = [far(at, angle) for angle in angles]
    check_star(at, angles, [(ends[0], ends[1]), (ends[2], ends[3])])


@pytest.mark.parametrize("n", [4, 7])
def test_each_part_has_three_motions_without_energy(n):
    """Two crossing cracks and one that ends on the first: five parts, so fifteen eigenvalues of the free body are zero."""
    cracks = [((-1.0, 0.43), (2.0, 0.52)), ((0.41, -1.0), (0.37, 2.0)), ((0.81, 2.0), (0.81, 0.43 + 1.81 / 3 * 0.09))]
    model = methods.get("xfem").build(held(cracks, lambda x, t: 0.0 * x), n=n)
    rows, columns, values = model.cracked.system.K.getValuesCSR()
    size = len(rows) - 1
    K = np.zeros((size, size))
    np.add.at(K, (np.repeat(np.arange(size), np.diff(rows)), columns), values)
    d = 1.0 / np.sqrt(np.diag(K))
    eigenvalues = np.linalg.eigvalsh(d[:, None] * K * d)
    assert np.abs(K - K.T).max() < 1e-13
    assert np.count_nonzero(eigenvalues < 1e-10) == 15 and eigenvalues[0] > -1e-12 and eigenvalues[15] > 1e-4


def test_a_block_between_two_cracks_and_two_branches():
    """A branch from crack to crack: both its ends are junctions."""
    cracks = [((-1.0, 0.31), (2.0, 0.29)), ((-1.0, 0.74), (2.0, 0.71)), ((0.52, 0.31 - 1.52 / 150), (0.47, 0.74 - 1.47 / 100))]
    lines = junctions.network(geometry.polylines(tuple(map(Crack, cracks))))
    sectors = junctions.sectors_of(lines)
    assert sectors.joined.tolist() == [[False] * 2, [False] * 2, [True] * 2]

    def motion(x, t):
        x = np.asarray(x)
        low, high = (x[1] < y0 + (x[0] + 1.0) / 3 * (y1 - y0) for y0, y1 in ((0.31, 0.29), (0.74, 0.71)))
        right = x[0] > 0.52 - 0.05 * (x[1] - 0.3) / 0.4254
        return t * np.select([low, ~high, right], [[0.2 - x[1], x[0]], [0.1 + 0 * x[0], 0.3 + 0 * x[0]], [-x[1], x[0] - 0.4]],
                             [0.5 * x[1], 0.2 - 0.5 * x[0]])  # fmt: skip

    model = methods.get("xfem").build(held(cracks, motion), n=9)
    model.step(1.0)
    assert abs(model.energy()["internal"]) < 1e-12


def test_no_tip_functions_at_junctions():
    """A branch inside: tips at its free end and at those of its main, whose discs stay off the junction."""
    cracks = [((0.2, 0.5), (0.8, 0.51)), ((0.5, 0.505), (0.52, 0.8))]
    model = methods.get("xfem").build(held(cracks, lambda x, t: 0.0 * x), n=12)
    body = model.cracked
    np.testing.assert_allclose(body.tips.at, [(0.2, 0.5), (0.8, 0.51), (0.52, 0.8)])
    assert all(r < 0.46 * np.hypot(*(at - (0.5, 0.505))) for r, at in zip(body.radii, body.tips.at))


def test_cracks_joined_end_to_end_are_one():
    points = ((-0.1, 0.45), (0.33, 0.52), (0.62, 0.43))
    one, two = (geometry.polylines(tuple(map(Crack, cracks))) for cracks in ([points], [points[1::-1], points[1:]]))
    np.testing.assert_allclose(junctions.network(two).points[::-1], one.points)


def test_a_crack_that_has_grown_onto_another_one_ends_there():
    lines = geometry.polylines((Crack(((-0.1, 0.5), (0.4, 0.5), (0.55, 0.5))), Crack(((0.55, 0.1), (0.55, 0.9)))))
    joined = junctions.network(lines)
    assert joined.points.tolist() == [[-0.1, 0.5], [0.4, 0.5], [0.55, 0.5], [0.55, 0.1], [0.55, 0.5], [0.55, 0.9]]
    assert junctions.sectors_of(joined).joined.tolist() == [[False, True], [False, False]]


# --- bodies with loads ------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("name", "knobs", "tolerance"),
    [
        ("centre_crack", {"a": 0.3}, 2e-3),
        ("centre_crack", {}, 2e-3),
        ("double_edge", {"a": 0.3}, 3e-3),
        ("double_edge", {}, 2e-3),
        ("cruciform", {"a": 0.3}, 2e-3),
        ("cruciform", {}, 1.5e-3),
        ("branched", {}, 3e-3),
    ],
)
def test_intensity_factors_of_several_tips(name, knobs, tolerance):
    """At n = 40, with 10 000 dofs at most; they were measured up to .17 % off (a = .3: the radius is cut to .45 of the length)."""
    result = geofem.run(name, "xfem", n=40, **knobs)
    assert result.status == "ok" and result.size["dofs"] < 10_000
    for measure, error in result.error.items():
        assert error < tolerance, (measure, error)
    assert result.checks["momentum"] < 1e-10 and result.checks["path"] < 0.003


def test_a_crack_that_grows_onto_another_one_becomes_its_branch():
    """From the side of a plate in tension onto an upright crack: the tip is gone, the junction is there, the other tips go on."""
    scene = scenes.get("edge_crack")(a=0.4)
    scene = replace(scene, cracks=(*scene.cracks, Crack(((0.55, -0.25), (0.56, 0.2)))))
    steps = list(geofem.grow(scene, method="xfem", da=0.1, until=0.25, n=16))
    assert [len(step.tips) for step in steps[:3]] == [3, 3, 2]
    joined = steps[-1].model.cracked.sectors.joined
    assert joined[0].tolist() == [False, True] and not joined[1].any()
    assert steps[2].energy["internal"] > steps[1].energy["internal"]


def test_a_branched_crack_releases_what_its_intensity_factors_say():
    scene = scenes.get("branched")()
    model = methods.get("xfem").build(scene, n=40)
    model.step(1.0)
    for tip in range(3):
        K = model.cracked.intensity(tip)
        assert model.cracked.release(tip) == pytest.approx((K**2).sum() * (1 - 0.3**2), rel=1e-2)
