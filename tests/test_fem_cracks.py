"""Cracks in meshes that conform to them: parted nodes, quarter-point cells, intensity factors, ranks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import geofem
from geofem import methods, scenes
from geofem.mistake import Mistake
from geofem.scene import Box, Crack, Growth, Load, Material, MeshFile, Polygon, Probe, Region, Scene, Support


def solved(scene, n=8, **knobs):
    model = methods.get("fem").build(scene, n=n, **knobs)
    while model.t < scene.t_end:
        model.step(model.dt())
    return model


def plain(cracks, value=None):
    """The unit square, held all around."""

    def side(x):
        return (x[0] < 1e-9) | (x[0] > 1 - 1e-9) | (x[1] < 1e-9) | (x[1] > 1 - 1e-9)

    return Scene(
        name="plain",
        regions=(Region("square", Box((0.0, 0.0), (1.0, 1.0)), Material("linear_elastic", 1.0, {"E": 1.0, "nu": 0.3})),),
        length=1.0,
        supports=tuple(
            Support(name, side, (i,), None if value is None else lambda x, t, i=i: value(x, t)[i])
            for i, name in enumerate("xy")
        ),
        cracks=tuple(Crack(points) for points in cracks),
        strain="small",
    )


# --- the mesh ---------------------------------------------------------------------------------------------------------
def test_parts_between_cracks_move_as_they_are_told():
    """A kinked crack from side to side and one that ends on it: three rigid bodies, which meet in one place."""

    def motion(x, t):
        up = x[1] > np.interp(x[0], [0.0, 0.4, 1.0], [0.45, 0.55, 0.5])
        right = x[0] > 0.4
        low = np.where(right, [0.5 * x[1], -0.1 - 0.5 * x[0]], [0.1 + 0 * x[0], -0.2 + 0 * x[0]])
        return t * np.where(up, [0.3 - 0.2 * x[1], 1.0 + 0.2 * x[0]], low)

    model = solved(plain([((0.0, 0.45), (0.4, 0.55), (1.0, 0.5)), ((0.4, -0.2), (0.4, 0.55))], motion), n=6)
    assert not model.ends()
    assert model.probe(Probe("error", "displacement_error", exact=motion)) < 1e-9
    assert abs(model.energy()["internal"]) < 1e-13


def test_which_ends_are_tips():
    """Of two inner cracks that cross, four; none of one that ends on another, on the boundary or outside."""
    cross = [((0.2, 0.2), (0.7, 0.8)), ((0.2, 0.7), (0.8, 0.3))]
    model = methods.get("fem").build(plain(cross), n=6)
    assert [(tip.crack, tip.last) for tip in model.ends()] == [(0, False), (0, True), (1, False), (1, True)]
    np.testing.assert_allclose(model.ends()[1].axis, np.array([0.5, 0.6]) / np.hypot(0.5, 0.6))
    others = [((-0.1, 0.5), (0.3, 0.5), (0.8, 0.45)), ((0.3, 0.5), (0.4, 0.2)), ((1.0, 0.9), (0.7, 0.9))]
    model = methods.get("fem").build(plain(others), n=6)
    assert [(tip.crack, tip.last) for tip in model.ends()] == [(0, True), (1, True), (2, True)]
    # as far as the kink, the other crack and the boundary
    assert [tip.clear for tip in model.cracked.tips] == pytest.approx([0.2, 0.2, 0.1])


def test_a_picture_shows_the_crack_open():
    model = solved(scenes.get("edge_crack")())
    shown = model.snapshot()
    x = shown["points"][:, :2] - shown["displacement"]
    corners = x[shown["cells"][:, :3]]
    double = np.linalg.det(corners[:, 1:] - corners[:, :1])
    assert 0.5 * np.abs(double).sum() == pytest.approx(2.0, rel=1e-12)
    mouth = np.hypot(*(x - (0.0, 0.0)).T) < 1e-9
    assert mouth.sum() == 2 and np.ptp(shown["displacement"][mouth, 1]) > 3.0


# --- accuracy ---------------------------------------------------------------------------------------------------------
def test_quarter_points_give_the_square_root():
    """On uniform cells they make the energy error less than half and that of K less than a quarter (measured .40, .13)."""
    with_them, without = (geofem.run("williams", "fem", n=16, grading=1.0, quarter_point=flag) for flag in (True, False))
    assert with_them.size == without.size
    assert with_them.error["energy"] < 0.45 * without.error["energy"]
    assert with_them.error["KI"] < 0.25 * without.error["KI"]


def test_graded_meshes_keep_an_order_that_uniform_ones_lose():
    """Energy and K; measured 1.5 and 3 with n, where half and one are left on uniform cells."""
    coarse, fine = (geofem.run("williams", "fem", n=n, KII=0.5) for n in (8, 32))
    assert np.log(coarse.error["energy"] / fine.error["energy"]) / np.log(4) > 1.3
    assert np.log(coarse.error["KI"] / fine.error["KI"]) / np.log(4) > 2.5
    assert fine.error["energy"] < 0.01 and fine.error["KI"] < 1e-4 and fine.error["KII"] < 1e-4


@pytest.mark.parametrize(
    ("name", "knobs"),
    [
        ("edge_crack", {}),
        ("edge_crack", {"a": 0.3, "H": 4.0}),
        ("shear_edge_crack", {}),
        ("inclined_crack", {"beta": 15.0}),
        ("inclined_crack", {"beta": 60.0}),
    ],
)
def test_intensity_factors_of_the_references(name, knobs):
    result = geofem.run(name, "fem", n=24, **knobs)
    assert result.status == "ok" and result.size["dofs"] < 8000
    for measure, error in result.error.items():
        assert error < 1e-3, (measure, error)
    assert result.checks["momentum"] < 1e-10 and result.checks["path"] < 2e-4


def test_cubics_reach_the_uncertainty_of_the_reference():
    result = geofem.run("edge_crack", "fem", n=16, order=3, grading=5.0)
    assert result.error["F"] < 2e-4


def test_two_methods_agree_at_any_angle():
    """Within the error of the coarser one, about half a percent (``test_xfem``)."""
    ours, theirs = (geofem.run("inclined_crack", method, n=n, beta=-37.0) for method, n in (("fem", 20), ("xfem", 40)))
    for name in ("KI", "KII"):
        assert ours.qoi[name] == pytest.approx(theirs.qoi[name], rel=6e-3)


def test_two_edge_cracks():
    """Plate of width 2 with a crack of 0.5 from either side: F = 1.16925 by own finite elements of third order (1e-3)."""
    scene = scenes.get("edge_crack")(a=0.3, H=6.0)
    corners = ((-1.0, -3.0), (0.75, -3.0), (1.0, -3.0), (1.0, -2.75), (1.0, 3.0), (-1.0, 3.0))
    scene = replace(
        scene,
        regions=(replace(scene.regions[0], shape=Polygon(corners)),),
        cracks=(Crack(((-1.1, 0.0), (-0.5, 0.0))), Crack(((1.1, 0.0), (0.5, 0.0)))),
    )
    model = solved(scene, n=16)
    for tip in range(2):
        first, second = model.cracked.intensity(tip) / np.sqrt(np.pi * 0.5)
        assert first == pytest.approx(1.16925, rel=3e-3) and abs(second) < 2e-3


def test_energy_release_is_that_of_the_intensity_factors():
    model = solved(scenes.get("inclined_crack")(beta=30.0), n=16)
    for tip in range(2):
        assert model.cracked.release(tip) == pytest.approx((model.cracked.intensity(tip) ** 2).sum() * (1 - 0.3**2), rel=3e-3)


def test_a_crack_in_two_regions_of_one_material():
    """The boundary between the regions runs along the ligament and through the crack's mouth; it changes nothing."""
    scene = scenes.get("edge_crack")()
    material = scene.regions[0].material
    low = Polygon(((0.0, -1.0), (0.75, -1.0), (1.0, -1.0), (1.0, -0.75), (1.0, 0.0), (0.0, 0.0)))
    parts = (Region("low", low, material), Region("high", Box((0.0, 0.0), (1.0, 1.0)), material))
    model = solved(replace(scene, regions=parts), n=24)
    assert model.cracked.intensity(0)[0] == pytest.approx(2.82545 * np.sqrt(np.pi * 0.5), rel=1e-3)


def test_a_run_goes_on_from_its_state():
    first, second = (methods.get("fem").build(scenes.get("williams")(), n=6, steps=2) for _ in range(2))
    first.step(0.5)
    second.restore(first.state())
    for model in (first, second):
        model.step(0.5)
    assert second.t == first.t and second.work == first.work
    assert second.energy() == pytest.approx(first.energy(), rel=1e-12)
    np.testing.assert_allclose(second.factors()[0], first.factors()[0], rtol=1e-11, atol=1e-11)


def test_forces_of_mass_inside_the_ring():
    """A plate that hangs by its top, cracked at its side: J of wide and of narrow rings, and of K (without the term 3 % off)."""
    scene = scenes.get("edge_crack")()
    top = Support("top", lambda x: x[1] > 1 - 1e-9, (0, 1))
    model = solved(replace(scene, supports=(top,), loads=(Load("gravity", (0.0, -1.0)),)), n=20)
    K, G = model.factors()
    assert G[0] == pytest.approx((K[0] ** 2).sum() * (1 - 0.3**2), rel=2e-3)
    assert model.checks()["path"] < 1e-3


def test_a_growing_crack_is_meshed_anew_and_releases_what_J_says():
    """Edge crack in tension, straight; and the same path as of xfem in shear, where K_II has gone after the first kink."""
    steps = list(geofem.grow("edge_crack", "fem", n=12, a=0.3, da=0.05, until=0.2))
    assert [step.advance for step in steps] == pytest.approx([0.0, 0.05, 0.1, 0.15, 0.2])
    assert steps[-1].tips[0] == pytest.approx((0.5, 0.0), abs=1e-3)
    assert steps[-1].K[0, 0] == pytest.approx(2.82545 * np.sqrt(np.pi * 0.5), rel=5e-3)
    for before, after in zip(steps, steps[1:]):
        gain = (after.energy["external"] - before.energy["external"]) - (after.energy["internal"] - before.energy["internal"])
        assert gain == pytest.approx(0.5 * (before.G + after.G)[0] * 0.05, rel=0.02)
    assert steps[-1].model.work == {"steps": 4, "remeshes": 4}
    ours, theirs = (list(geofem.grow("shear_edge_crack", m, n=n, da=0.35, until=0.7)) for m, n in (("fem", 12), ("xfem", 30)))
    np.testing.assert_allclose(ours[-1].path[0], theirs[-1].path[0], atol=3e-3)
    assert np.abs(ours[0].angles) == pytest.approx(np.radians(14.69), abs=5e-3)


def test_growth_compiles_nothing(tmp_path):
    from geofem import cost

    for step in geofem.grow("edge_crack", "fem", n=8, a=0.3, da=0.05, until=0.1):
        if step.advance == 0.0:
            cost.CLOCK.reset()
    assert cost.CLOCK.seconds["jit"] < 0.01


# --- what is refused --------------------------------------------------------------------------------------------------
def test_what_fem_cannot_do_with_cracks_is_said():
    scene, fem = scenes.get("williams")(), methods.get("fem")
    assert fem.refuses(scene) is None
    assert "plane" in fem.refuses(replace(scene, plane="axisymmetric"))
    assert "at rest" in fem.refuses(replace(scene, dynamic=True))
    assert "small strains" in fem.refuses(replace(scene, strain="finite"))
    assert "mesh file" in fem.refuses(replace(scene, regions=(replace(scene.regions[0], shape=MeshFile("x.msh")),)))
    born = Growth(length=1.0, strength=1.0, germ=0.1)
    assert "no new cracks" in fem.refuses(replace(scene, growth=born))
    for knobs, word in (
        ({"da": 0.1}, "da"),
        ({"quarter_point": True, "order": 1}, "quarter_point"),
        ({"order": 4}, "order"),
        ({"grading": 0.5}, "grading"),
        ({"formulation": "mixed"}, "formulation"),
        ({"cell": "quadrilateral"}, "cell"),
    ):
        with pytest.raises(Mistake, match=word):
            fem.build(scene, **knobs)
    with pytest.raises(Mistake, match="no crack"):
        fem.build(scenes.get("cook")(), quarter_point=True)
    through = replace(scene, cracks=(Crack(((-0.1, 0.5), (1.1, 0.5))),))
    with pytest.raises(Mistake, match="there is no tip"):
        solved(through).probe(scene.probes[0])
