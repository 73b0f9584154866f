"""Cracks in a mesh that knows nothing of them: exact fields, intensity factors, conditioning, loads, ranks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import geofem
from geofem import methods, scenes
from geofem.mistake import Mistake
from geofem.scene import Box, Crack, Load, Material, Polygon, Probe, Region, Scene, Support


def built(name, n=20, **knobs):
    """A scene and its model, solved."""
    method = {k: knobs.pop(k) for k in ("enrichment", "radius", "grading", "steps") if k in knobs}
    scene = scenes.get(name)(**knobs)
    model = methods.get("xfem").build(scene, n=n, **method)
    while model.t < scene.t_end:
        model.step(model.dt())
    return scene, model


def errors(scene, model):
    history = {probe.name: [model.probe(probe)] for probe in scene.probes} | {"t": [model.t]}
    return {m.name: m.error(history) if m.error else m.value(history) for m in scene.measures}


def plain(crack, value):
    """The unit square, held all around."""
    sides = ("x", 0), ("y", 1)
    return Scene(
        name="plain",
        regions=(Region("square", Box((0.0, 0.0), (1.0, 1.0)), Material("linear_elastic", 1.0, {"E": 1.0, "nu": 0.3})),),
        length=1.0,
        supports=tuple(
            Support(
                name,
                lambda x: (x[0] < 1e-9) | (x[0] > 1 - 1e-9) | (x[1] < 1e-9) | (x[1] > 1 - 1e-9),
                (i,),
                lambda x, t, i=i: value(x, t)[i],
            )
            for name, i in sides
        ),
        cracks=(Crack(tuple(crack)),),
        strain="small",
    )


def parted(crack):
    """A motion that turns and shifts the body above the crack, the + side, and the one below as two rigid bodies."""
    from geofem.methods.xfem import geometry

    lines = geometry.polylines((Crack(tuple(crack)),))

    def motion(x, t):
        up = np.array([geometry.side(*p, lines, 0, 0.0) for p in np.asarray(x).T]) > 0
        return t * np.where(up, [0.3 - 0.2 * x[1], 1.0 + 0.2 * x[0]], [0.5 * x[1], -0.1 - 0.5 * x[0]])

    return motion


# --- exact solutions --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "crack",
    [
        ((-0.1, 0.45), (1.1, 0.52)),
        ((-0.1, 0.45), (0.33, 0.52), (0.36, 0.4), (1.1, 0.43)),
        ((-0.1, 0.5), (1.1, 0.5)),
        ((-0.1, -0.1), (1.1, 1.1)),
        ((0.0, 0.5), (1.0, 0.5)),
        ((0.0, 0.45), (0.5, 0.5), (1.0, 0.6)),
        ((1.1, 0.45), (-0.1, 0.52)),
    ],
    ids=("straight", "kinked", "edges", "diagonal", "from_node_to_node", "kinked_on_a_node", "backwards"),
)
def test_two_halves_move_apart_as_they_are_told(crack):
    """A crack from side to side: each half turns and shifts as a rigid body, which the jump functions represent exactly."""
    motion = parted(crack)
    model = methods.get("xfem").build(plain(crack, motion), n=10)
    model.step(1.0)
    assert model.probe(Probe("error", "displacement_error", exact=motion)) < 1e-11
    assert abs(model.energy()["internal"]) < 1e-13  # rounding of x K x


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(st.floats(0.02, 0.98), st.floats(0.1, 0.9)), min_size=2, max_size=7), st.integers(3, 9))
def test_any_polyline_parts_the_body(points, n):
    """The same with any number of kinks in any cell, some of them sharper than a right angle."""
    inner = sorted({round(x, 3): round(y, 3) for x, y in points}.items())
    crack = ((-0.1, inner[0][1]), *inner, (1.1, inner[-1][1]))
    motion = parted(crack)
    model = methods.get("xfem").build(plain(crack, motion), n=n)
    model.step(1.0)
    # a node whose support holds less than 1e-10 on its other side carries no jump
    assert model.probe(Probe("error", "displacement_error", exact=motion)) < 1e-5


def test_energy_error_falls_like_the_cell_size():
    first, second = (errors(*built("williams", n)) for n in (20, 40))
    assert np.log2(first["energy"] / second["energy"]) > 1.0
    assert np.log2(first["L2"] / second["L2"]) > 1.9
    assert second["energy"] < 0.0448 and abs(second["KI"] - 1) < 1.1e-3 and abs(second["KII"]) < 1e-3


@pytest.mark.parametrize(
    ("enrichment", "energy", "dofs"),
    [("heaviside", 0.32, 922), ("topological", 0.19, 946), ("branches", 0.085, 1306), ("corrected", 0.074, 1546)],
)
def test_other_enrichments(enrichment, energy, dofs):
    """Bounds: measured .306, .168, .083 and .072."""
    scene, model = built("williams", enrichment=enrichment)
    assert errors(scene, model)["energy"] < energy and model.size()["dofs"] == dofs


@pytest.mark.parametrize(
    "tip", [(0.5, 0.5), (0.525, 0.5), (0.5, 0.51), (0.525, 0.525)], ids=("node", "edge", "upright", "diagonal")
)
def test_tips_and_cracks_on_nodes_and_edges(tip):
    scene, model = built("williams", tip=tip)
    found = errors(scene, model)
    assert found["energy"] < 0.11 and abs(found["KI"] - 1) < 0.01
    assert model.cracked.system.condition() < 1.2e4


@pytest.mark.parametrize("delta", [1e-3, 1e-6, 1e-9, 1e-12])
def test_cells_that_are_hardly_cut(delta):
    scene, model = built("williams", tip=(0.5037, 0.5 + 0.05 * delta))
    found = errors(scene, model)
    assert found["energy"] < 0.11 and abs(found["KI"] - 1) < 0.01
    assert model.cracked.system.condition() < 1.2e4


@settings(max_examples=15, deadline=None)
@given(st.floats(0.3, 0.7), st.floats(0.35, 0.65), st.floats(-20.0, 20.0), st.floats(-1.0, 1.0))
def test_any_tip_at_any_angle(x, y, angle, KII):
    scene, model = built("williams", tip=(x, y), angle=angle, KII=KII)
    found = errors(scene, model)
    assert abs(found["KI"] - 1) < 0.01 and abs(found["KII"] - KII) < 0.01
    assert model.cracked.system.condition() < 1.2e4


# --- bodies with loads ------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("name", "knobs", "tolerance"),
    [
        ("edge_crack", {"n": 30}, 6e-3),
        ("edge_crack", {"n": 30, "a": 0.3, "H": 4.0}, 6e-3),
        ("shear_edge_crack", {"n": 30}, 9e-3),
        ("inclined_crack", {"n": 40, "beta": 15.0}, 5e-3),
        ("inclined_crack", {"n": 40, "beta": 60.0}, 5e-3),
    ],
)
def test_intensity_factors_of_the_references(name, knobs, tolerance):
    result = geofem.run(name, "xfem", **knobs)
    assert result.status == "ok"
    for measure, error in result.error.items():
        assert error < tolerance, (measure, error)
    assert result.checks["momentum"] < 1e-10 and result.checks["path"] < 0.01


def test_intensity_factors_do_not_depend_on_the_ring():
    _, model = built("edge_crack", 40)
    first, second = (model.cracked.intensity(0, r)[0] for r in (0.2, 0.3))
    assert first == pytest.approx(second, rel=3e-3)


def test_two_edge_cracks():
    """Plate of width 2 with a crack of 0.5 from either side: F = 1.16925 by own finite elements of third order (1e-3)."""
    scene = scenes.get("edge_crack")(a=0.3, H=6.0)
    corners = ((-1.0, -3.0), (0.75, -3.0), (1.0, -3.0), (1.0, -2.75), (1.0, 3.0), (-1.0, 3.0))
    scene = replace(
        scene,
        regions=(replace(scene.regions[0], shape=Polygon(corners)),),
        cracks=(Crack(((-1.1, 0.0), (-0.5, 0.0))), Crack(((1.1, 0.0), (0.5, 0.0)))),
        singular=((-0.5, 0.0), (0.5, 0.0)),
    )
    model = methods.get("xfem").build(scene, n=24)
    model.step(1.0)
    assert len(model.cracked.tips.at) == 2
    for tip in range(2):
        first, second = model.cracked.intensity(tip) / np.sqrt(np.pi * 0.5)
        assert first == pytest.approx(1.16925, rel=1e-2) and abs(second) < 1e-2


def test_energy_release_is_that_of_the_intensity_factors():
    _, model = built("inclined_crack", 40, beta=30.0)
    for tip in range(2):
        assert model.cracked.release(tip) == pytest.approx((model.cracked.intensity(tip) ** 2).sum() * (1 - 0.3**2), rel=1.5e-2)


def test_without_cracks_it_is_the_finite_element_method():
    patch = geofem.run("patch", "xfem", n=3)
    assert patch.status == "ok" and max(patch.error.values()) < 1e-10
    ours, theirs = geofem.run("cook", "xfem", n=6, grading=1.0), geofem.run("cook", "fem", n=6, order=1)
    assert ours.qoi["uy"] == pytest.approx(theirs.qoi["uy"], rel=1e-10)


def test_a_run_goes_on_from_its_state():
    scene = scenes.get("williams")()
    first, second = (methods.get("xfem").build(scene, n=10, steps=2) for _ in range(2))
    first.step(0.5)
    second.restore(first.state())
    for model in (first, second):
        model.step(0.5)
    assert second.t == first.t and second.work == first.work
    assert second.energy() == pytest.approx(first.energy(), rel=1e-12)


def test_a_load_in_two_steps_gives_what_one_gives():
    one, two = (geofem.run("williams", "xfem", n=12, steps=s) for s in (1, 2))
    assert two.qoi["KI"] == pytest.approx(one.qoi["KI"], rel=1e-10)
    assert two.history["external"][-1] == pytest.approx(two.history["internal"][-1], rel=1e-10)


def test_a_point_above_the_crack_rises_and_one_below_sinks():
    scene, model = built("edge_crack", 20)
    up, down = (model.probe(Probe("u", "displacement", at=(0.05, y), component=1)) for y in (1e-6, -1e-6))
    assert up - down > 1.0


LOADS = {
    "gravity": Load("gravity", (0.0, -9.81)),
    "body": Load("body", lambda x, t: np.array([0 * x[0], -9.81 + 0 * x[0]])),
    "traction": Load("traction", (0.0, 3.0), where=lambda x: x[0] < 1e-9),
}


@pytest.mark.parametrize("kind", LOADS)
def test_loads_do_the_work_of_both_halves(kind):
    """Where two halves move as rigid bodies, loads do the work that their resultants on each do, exactly."""
    crack = ((-0.1, 0.45), (0.33, 0.52), (0.36, 0.4), (1.1, 0.43))
    motion = parted(crack)
    scene = plain(crack, motion)
    model = methods.get("xfem").build(replace(scene, loads=(LOADS[kind],)), n=10)
    free = methods.get("xfem").build(scene, n=10)
    free.step(1.0)
    work = model.cracked.system.dot(model.cracked.force(1.0), free.cracked.x[model.cracked.numbering.local_owned])
    if kind == "traction":
        mouth = 0.45 + 0.1 / 0.43 * 0.07
        exact = 3.0 * ((1 - mouth) * 1.0 - 0.1 * mouth)
    else:
        rule = free.cracked.cutter.rule(np.arange(len(free.cracked.grid.T)))
        exact = -9.81 * float(rule.w @ motion(rule.x.T, 1.0)[1])
    assert work == pytest.approx(exact, rel=1e-10)


def test_the_stress_at_a_point_far_from_the_crack():
    _, model = built("inclined_crack", 20, beta=0.0)
    assert model.probe(Probe("s", "stress", at=(3.0, 12.0), component=1)) == pytest.approx(1.0, rel=0.02)


def test_a_picture_shows_the_crack_open():
    _, model = built("edge_crack", 20, grading=1.0)
    shown = model.snapshot()
    x = shown["points"][:, :2] - shown["displacement"]
    corners = x[shown["cells"]]
    double = np.linalg.det(corners[:, 1:] - corners[:, :1])
    assert 0.5 * double.sum() == pytest.approx(2.0, rel=1e-12) and (double > 0).all()
    mouth = np.hypot(*(x - (0.0, 0.0)).T) < 1e-9
    assert np.ptp(shown["displacement"][mouth, 1]) > 3.0
    assert shown["stress"].shape == (len(shown["cells"]), 4)


# --- what is refused --------------------------------------------------------------------------------------------------
def test_what_xfem_cannot_do_is_said():
    scene = scenes.get("williams")()
    xfem = methods.get("xfem")
    assert "small strains" in xfem.refuses(replace(scene, strain="finite"))
    assert "plane" in xfem.refuses(replace(scene, plane="axisymmetric"))
    for knobs in ({"enrichment": "all"}, {"n": 0}, {"radius": -1.0}, {"grading": 0.5}, {"steps": 0}):
        with pytest.raises(Mistake, match=next(iter(knobs))):
            xfem.build(scene, **knobs)


@pytest.mark.parametrize("tip", [(0.5, 0.5), (0.499, 0.5), (0.5, 0.499), (0.501, 0.501)])
@pytest.mark.parametrize("enrichment", ["modes", "heaviside"])
def test_coarse_meshes_and_tips_near_a_node(tip, enrichment):
    """Bounds: measured up to .21; without tip functions .44 on the node, where a crack that ended a cell earlier gave .95."""
    scene, model = built("williams", 8, tip=tip, enrichment=enrichment)
    limit = 0.23 if enrichment == "modes" else 0.5 if tip == (0.5, 0.5) else 1.0
    assert errors(scene, model)["energy"] < limit
