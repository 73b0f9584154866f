"""The faces of cracks: their rule, pressures on them, and what tractions and forces do to intensity factors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_xfem import built, parted, plain

import geofem
from geofem import methods, scenes
from geofem.methods.xfem.facelaw import law_of, respond
from geofem.mistake import Mistake
from geofem.scene import Cohesion, Crack, Growth, Load, Material, Probe, Support
from geofem.scenes._tip import TipField

E, NU = 1.0, 0.3
MU = E / (2 * (1 + NU))
LAM = 2 * MU * NU / (1 - 2 * NU)
TIP = (0.5037, 0.5071)


# --- the rule ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "crack",
    [
        ((-0.1, 0.45), (0.33, 0.52), (0.36, 0.4), (1.1, 0.43)),
        ((-0.1, 0.5), (1.1, 0.5)),
        ((1.1, 0.5), (-0.1, 0.5)),
        ((-0.1, -0.1), (1.1, 1.1)),
        ((0.0, 0.45), (0.5, 0.5), (1.0, 0.6)),
    ],
    ids=("kinked", "edges", "edges_backwards", "diagonal", "kinked_on_a_node"),
)
def test_the_jump_of_two_halves_that_move_apart(crack):
    motion = parted(crack)
    model = methods.get("xfem").build(plain(crack, motion), n=10)
    model.step(1.0)
    faces = model.cracked.faces
    clipped = np.clip(np.array(crack), 0.0, 1.0)
    if crack[0] == (-0.1, 0.45):
        clipped[[0, -1], 1] = 0.45 + 0.1 / 0.43 * 0.07, 0.4 + 0.64 / 0.74 * 0.03
    assert faces.rule.w.sum() == pytest.approx(np.hypot(*np.diff(clipped, axis=0).T).sum(), rel=1e-13)
    x = faces.rule.x.T
    up = np.array([0.3 - 0.2 * x[1], 1.0 + 0.2 * x[0]])
    down = np.array([0.5 * x[1], -0.1 - 0.5 * x[0]])
    np.testing.assert_allclose(faces.vectors(faces.jumps(model.cracked.x)), (up - down).T, atol=1e-12)
    # a pressure does work on the opening
    pressure = 1.0 + x[0]
    exact = float(faces.rule.w @ (pressure * np.einsum("ni,in->n", faces.normal, (up - down))))
    assert faces.force(np.stack([pressure, 0 * pressure], axis=1)) @ model.cracked.x == pytest.approx(exact, rel=1e-12)


def test_the_jump_of_the_modes_at_their_tip():
    scene, model = built("williams", n=20, KII=0.5)
    faces, body = model.cracked.faces, model.cracked
    assert faces.rule.w.sum() == pytest.approx(TIP[0], rel=1e-13)
    field = TipField(TIP, 0.0, 1.0, 0.5, MU, NU)
    off = np.array([[0.0], [1e-12]])
    exact = (field.displacement(faces.rule.x.T + off) - field.displacement(faces.rule.x.T - off)).T[:, ::-1]
    square = lambda d: float(faces.rule.w @ (d**2).sum(axis=1))  # noqa: E731
    assert square(faces.jumps(body.x) - exact) < 0.02**2 * square(exact)


# --- intensity factors and T ------------------------------------------------------------------------------------------
def loaded():
    """The near field of a tip with a force of mass along the crack, whose faces then bear a pressure that grows along them."""
    field, b = TipField(TIP, 0.0, 1.0, 0.4, MU, NU), 3.0

    def motion(x, t):
        u = field.displacement(np.asarray(x))
        return t * np.array([u[0] - b * x[0] ** 2 / 2 / (LAM + 2 * MU), u[1]])

    crack = Crack(((-0.1, TIP[1]), TIP), pressure=lambda x, t: t * LAM / (LAM + 2 * MU) * b * x[0])
    return replace(plain(crack.points, motion), cracks=(crack,), loads=(Load("gravity", (b, 0.0)),)), -b * TIP[0]


def test_intensity_factors_under_a_force_of_mass_and_pressure():
    """Measured, on two rings: .9 % of K, .7 % of T, 2.2 % of J; without either term K_I is 6 and 40 % wrong, J by half or more."""
    scene, tension = loaded()
    model = methods.get("xfem").build(scene, n=20)
    model.step(1.0)
    body = model.cracked
    for radius in (None, 0.15):
        np.testing.assert_allclose(body.intensity(0, radius), (1.0, 0.4), atol=0.012)
        assert body.tension(0, radius) == pytest.approx(tension, rel=0.01)
        assert body.release(0, radius) == pytest.approx(1.16 * (1 - NU**2), rel=0.03)
    body.scene = replace(scene, loads=())
    assert abs(body.intensity(0)[0] - 1.0) > 0.03
    body.scene = scene
    body.traction[:] = 0.0
    assert abs(body.intensity(0)[0] - 1.0) > 0.3


def test_T_of_a_uniform_stress_along_the_crack():
    crack = ((-0.1, 0.52), (0.5037, 0.52))
    scene = plain(crack, lambda x, t: t * np.array([1.0 * x[0], -NU / (1 - NU) * x[1]]))
    for angle in (0.0, 30.0):
        c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        turned = tuple((0.5 + c * (x - 0.5) - s * (y - 0.5), 0.5 + s * (x - 0.5) + c * (y - 0.5)) for x, y in crack)

        def motion(x, t, c=c, s=s):
            a, b = t * (c * x[0] + s * x[1]), -NU / (1 - NU) * t * (c * x[1] - s * x[0])
            return np.array([c * a - s * b, s * a + c * b])

        model = methods.get("xfem").build(replace(plain(turned, motion), singular=scene.singular), n=10)
        model.step(1.0)
        assert model.cracked.tension(0) == pytest.approx(E / (1 - NU**2), rel=1e-5)


@pytest.mark.parametrize("by", ["pressure", "tension"])
def test_a_pressurised_crack_opens_as_sneddon_says(by):
    """Measured: K_I .0012, T .0022, opening .0066; by superposition a tension gives the same K and opening."""
    result = geofem.run("hydraulic_fracture", "xfem", n=20, by=by)
    assert result.status == "ok" and result.checks["path"] < 2e-3
    assert result.error["KI"] < 2e-3 and abs(result.qoi["KII"]) < 3e-3
    assert result.error["T"] < 4e-3 and result.error["opening"] < 0.01
    assert result.error["energy"] < 0.1 and result.error["L2"] < 0.01


def test_pressure_gives_what_tension_does():
    factors = [geofem.run("hydraulic_fracture", "xfem", n=12, by=by).qoi["KI"] for by in ("pressure", "tension")]
    assert factors[0] == pytest.approx(factors[1], rel=1e-6)


def test_the_opening_error_falls_like_the_square_of_the_cell_size():
    first, second = (geofem.run("hydraulic_fracture", "xfem", n=n).error["opening"] for n in (12, 24))
    assert np.log2(first / second) > 1.8


def test_K_of_a_shallow_crack_full_of_water():
    """F = .6825 for an edge crack in a half plane under a pressure that grows linearly (Tada, Paris and Irwin 1973); measured .6739."""
    scene = block(((0.5, 1.0), (0.5, 0.975)), pressure=lambda x, t: t * (1.0 - x[1]) / 0.025)
    model = methods.get("xfem").build(replace(scene, singular=((0.5, 0.975),)), n=32)
    model.step(1.0)
    K = model.cracked.intensity(0)
    assert K[0] == pytest.approx(0.6825 * np.sqrt(np.pi * 0.025), rel=0.02) and abs(K[1]) < 0.01 * K[0]


def test_a_tension_crack_opens_when_water_has_risen():
    """With contact K_I is zero up to half the depth; without, faces overlap and the critical level comes out higher."""
    found = [geofem.run("tension_crack_slope", "xfem", n=16, steps=8, contact=contact) for contact in (True, False)]
    touching, overlapping = (run.history for run in found)
    assert np.abs(touching["KI"][1:5]).max() < 2e4 < -overlapping["KI"][1:5].max()
    assert overlapping["opening"][1] < -4e-3 and np.abs(touching["opening"][1:5]).max() < 1e-4
    assert found[0].qoi["critical"] < found[1].qoi["critical"] - 1.0
    assert found[0].checks["path"] < 0.01


# --- pressure on the boundary -----------------------------------------------------------------------------------------
def test_a_pressure_is_a_traction_against_the_normal():
    scene = scenes.get("edge_crack")()
    top = scene.loads[0].where
    crack = replace(scene.cracks[0], points=((0.41, -1.2), (0.43, 1.2)))  # cuts the loaded edge
    held = replace(scene, cracks=(crack,), supports=scene.supports)
    forces = []
    for load in (Load("traction", (0.0, -2.0), where=top), Load("pressure", 2.0, where=top)):
        model = methods.get("xfem").build(replace(held, loads=(load,)), n=8)
        forces.append(model.cracked.force(0.7))
    np.testing.assert_allclose(forces[1], forces[0], atol=1e-13)
    assert np.abs(forces[0]).max() > 0.01


# --- contact and friction ---------------------------------------------------------------------------------------------
def block(points, loads=(), supports=(), **data):
    """The unit square on rollers on three sides."""
    rollers = (
        Support("base", lambda x: x[1] < 1e-9, (1,)),
        Support("left", lambda x: x[0] < 1e-9, (0,)),
        Support("right", lambda x: x[0] > 1 - 1e-9, (0,)),
    )
    return replace(
        plain(points, None), supports=(*rollers, *supports), loads=tuple(loads), cracks=(Crack(tuple(points), **data),)
    )


@pytest.mark.parametrize(
    ("crack", "friction"),
    [
        (((-0.1, 0.5), (1.1, 0.5)), 0.0),
        (((-0.1, 0.47), (1.1, 0.53)), 0.0306),  # what rollers leave to friction on this slope
        (((-0.1, 0.45), (1.1, 0.52)), 0.5),
        (((0.0, 0.45), (0.5, 0.5), (1.0, 0.55)), 0.5),
    ],
    ids=("along_edges", "nearly_sliding", "sloping", "through_a_node"),
)
def test_a_closed_crack_transmits_uniform_stress(crack, friction):
    """To rounding, though the crack parts the body: without contact its upper part would float."""
    model = methods.get("xfem").build(
        block(crack, [Load("pressure", 1.0, where=lambda x: x[1] > 1 - 1e-9)], friction=friction), n=10
    )
    model.step(1.0)
    n = model.cracked.faces.normal[0]
    sigma = np.diag([-NU / (1 - NU), -1.0])
    exact = n @ sigma @ n, n @ sigma @ (n[1], -n[0])
    assert abs(exact[1]) <= -friction * exact[0] + 1e-12
    np.testing.assert_allclose(
        model.cracked.contact.traction, np.broadcast_to(exact, model.cracked.contact.traction.shape), atol=1e-11
    )
    assert model.probe(Probe("s", "stress", at=(0.5, 0.4), component=1)) == pytest.approx(-1.0, abs=1e-11)
    checks = model.checks()
    assert checks["overlap"] < 1e-13 and checks["momentum"] < 1e-12


def pressed(friction, beta=45.0, n=40, **knobs):
    """The inclined crack under a compression of 1."""
    scene = scenes.get("inclined_crack")(beta=beta)
    loads = tuple(replace(load, value=(0.0, -load.value[1])) for load in scene.loads)
    model = methods.get("xfem").build(
        replace(scene, loads=loads, cracks=(Crack(scene.cracks[0].points, friction=friction),)), n=n, **knobs
    )
    model.step(1.0)
    return model


def test_without_contact_the_faces_overlap_and_K_is_that_of_tension():
    """The failure: faces run through each other by nine tenths of the crack's length, and K_I is negative."""
    model = pressed(None)
    assert model.checks()["overlap"] > 0.8
    assert model.cracked.factors[0][0, 0] == pytest.approx(-0.89429, rel=5e-3)


@pytest.mark.parametrize(("beta", "friction"), [(45.0, 0.0), (45.0, 0.3), (30.0, 0.3)])
def test_K_of_a_closed_crack_with_friction(beta, friction):
    """K_I = 0 and K_II = (tau - mu sigma_n) sqrt(pi a) in an infinite plate (Steif 1984); this plate adds .3 %."""
    model = pressed(friction, beta)
    c, s = np.cos(np.radians(beta)), np.sin(np.radians(beta))
    K = model.cracked.factors[0]
    np.testing.assert_allclose(K[:, 1], -(s * c - friction * c * c) * np.sqrt(np.pi), rtol=0.008)
    np.testing.assert_allclose(K[:, 0], 0.0, atol=0.01)
    assert model.checks()["overlap"] < 2e-3
    # no oscillation: with stations in each cell the pressure scatters by 10 %
    traction = model.cracked.contact.traction
    np.testing.assert_allclose(traction[:, 0], -c * c, rtol=0.03)
    np.testing.assert_allclose(traction[:, 1], friction * traction[:, 0], atol=1e-12)


def test_faces_stick_where_friction_exceeds_the_slope():
    model = pressed(1.02)
    assert np.abs(model.cracked.factors[0]).max() < 0.003
    assert np.abs(model.cracked.faces.jumps(model.cracked.x)).max() < 3e-3


def test_faces_slip_back_only_after_friction_has_turned():
    """Sheared to and fro at constant compression: the traction goes round a loop whose height is twice the friction."""
    top = lambda x: x[1] > 1 - 1e-9  # noqa: E731
    scene = block(((-0.1, 0.5), (1.1, 0.5)), [Load("pressure", 1.0, where=top, amplitude=lambda t: 1.0)], friction=0.4)
    pull = Support("pull", lambda x: top(x), (0,), lambda x, t: np.full(x.shape[1], 40.0 * np.interp(t, [0, 1, 3], [0, 1, -1])))
    hold = Support("hold", lambda x: x[1] < 1e-9, (0,))
    free = replace(scene, supports=(scene.supports[0], hold, pull), t_end=3.0)
    model = methods.get("xfem").build(free, n=6, steps=6)
    found = []
    while model.t < 3.0:
        model.step(0.5)
        found.append((model.probe(Probe("f", "reaction", of="pull", component=0)), model.cracked.contact.slip.mean()))
    force = np.array(found)[:, 0]
    np.testing.assert_allclose(force[[0, 1, 3, 4, 5]], (0.4, 0.4, -0.4, -0.4, -0.4), rtol=1e-9)
    assert found[1][1] > found[0][1] > 5.0 > found[5][1]


# --- cohesion ---------------------------------------------------------------------------------------------------------
def pulled(pull, steps, points=((-0.1, 0.47), (1.1, 0.53)), n=8, **knobs):
    """A square of E = 100 that is pulled apart along a crack of strength 1 and energy .02."""
    top = Support("top", lambda x: x[1] > 1 - 1e-9, (1,), lambda x, t: np.full(x.shape[1], pull(t)))
    scene = block(points, supports=(top,), cohesion=Cohesion(1.0, 0.02))
    stiff = Material("linear_elastic", 1.0, {"E": 100.0, "nu": NU})
    scene = replace(scene, regions=(replace(scene.regions[0], material=stiff),), supports=(*scene.supports[:2], top))
    scene = replace(scene, probes=(Probe("pull", "reaction", of="top", component=1),))
    return methods.get("xfem").build(scene, n=n, steps=steps, enrichment="heaviside", **knobs)


PEAK = (1 - NU**2) / 100.0
"""Elongation at which the stress is the strength."""


def test_a_plate_pulled_apart_bears_the_strength_and_spends_the_energy():
    model = pulled(lambda t: 5.0 * PEAK * t, 40, points=((-0.1, 0.5), (1.1, 0.5)))
    forces = []
    for _ in range(40):
        model.step(1 / 40)
        forces.append(model.probe(Probe("pull", "reaction", of="top", component=1)))
    assert forces[7] == pytest.approx(1.0, rel=1e-9) and max(forces) == forces[7] and abs(forces[-1]) < 1e-9
    assert model.cracked.contact.dissipated() == pytest.approx(0.02, rel=1e-12)
    assert model.energy()["external"] == pytest.approx(0.02, rel=3e-3) and model.energy()["internal"] < 1e-12
    assert model.checks()["momentum"] < 1e-11


def test_a_crack_that_slopes_spends_the_energy_of_its_length():
    model = pulled(lambda t: 0.06 * t, 12)
    for _ in range(12):
        model.step(1 / 12)
    assert model.cracked.contact.dissipated() == pytest.approx(0.02 * np.hypot(1.0, 0.05), rel=1e-12)


def test_what_has_opened_closes_along_the_way_to_the_origin_and_bears_pressure():
    path = lambda t: np.interp(t, [0, 1, 2, 3], [0, 0.02, -0.005, 0.02])  # noqa: E731
    model = replace_end(pulled(path, 12), 3.0)
    found = {}
    while model.t < 2.99:
        model.step(0.25)
        found[round(model.t, 2)] = model.probe(Probe("pull", "reaction", of="top", component=1))
    assert found[2.0] == pytest.approx(-0.005 / PEAK, rel=5e-3)  # nearly as an uncracked block: touching faces slide
    assert found[3.0] == pytest.approx(found[1.0], rel=1e-9) and 0.3 < found[1.0] < 0.9
    assert found[1.25] == pytest.approx(0.01375 / 0.02 * found[1.0], rel=1e-3)  # straight to the origin


def replace_end(model, t_end):
    model.scene = replace(model.scene, t_end=t_end)
    return model


def test_a_run_with_a_memory_goes_on_from_its_state():
    first, second = (pulled(lambda t: np.interp(t, [0, 0.5, 1.0], [0, 0.02, 0.01]), 4) for _ in range(2))
    first.step(0.25)
    first.step(0.25)
    second.restore(first.state())
    for model in (first, second):
        model.step(0.25)
    assert second.cracked.contact.dissipated() == pytest.approx(first.cracked.contact.dissipated(), rel=1e-12)
    np.testing.assert_allclose(second.cracked.x, first.cracked.x, atol=1e-13)


def test_tangents_of_the_laws():
    """By differences, at random states of contact, stick, slip, and cohesion rigid, softening, unloading and spent."""
    random = np.random.default_rng(3)
    z = random.normal(size=(400, 2)) * 2.0
    kinds = [Crack(((0, 0), (1, 0)), friction=0.4), Crack(((0, 0), (1, 0)), cohesion=Cohesion(1.0, 0.5))]
    law = law_of([kinds[k % 2] for k in range(400)])
    worst = np.where(random.random(400) < 0.5, 0.0, random.random(400)) * (law.strength > 0)
    t, slope = respond(z, law, np.full(400, 2.5), worst)
    for j in range(2):
        step = 1e-7 * np.eye(2)[j]
        slopes = (
            respond(z + step, law, np.full(400, 2.5), worst)[0] - respond(z - step, law, np.full(400, 2.5), worst)[0]
        ) / 2e-7
        np.testing.assert_allclose(slope[:, :, j], slopes, atol=1e-5)
    opening = np.hypot(*((z - t) / 2.5).T)[law.strength > 0]
    assert (opening == 0).any() and (opening > 1.0).any() and ((0 < opening) & (opening < 1.0)).any()


# --- what is refused --------------------------------------------------------------------------------------------------
def test_cracks_that_make_no_sense_are_said():
    points = ((0.0, 0.0), (1.0, 0.0))
    for data in ({"friction": -0.1}, {"friction": 0.3, "cohesion": Cohesion(1.0, 1.0)}):
        with pytest.raises(Mistake, match="friction"):
            Crack(points, **data)
    with pytest.raises(Mistake, match="energy"):
        Cohesion(1.0, 0.0)
    scene = block(((0.2, 0.5), (0.8, 0.5)), cohesion=Cohesion(1.0, 1.0))
    with pytest.raises(Mistake, match="heaviside"):
        methods.get("xfem").build(scene, n=4)
    assert "memory" in methods.get("xfem").refuses(replace(scene, growth=Growth(0.1)))
