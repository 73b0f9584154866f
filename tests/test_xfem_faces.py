"""The faces of cracks: their rule, pressures on them, and what tractions and forces do to intensity factors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_xfem import built, parted, plain

import geofem
from geofem import methods, scenes
from geofem.mistake import Mistake
from geofem.scene import Cohesion, Crack, Load
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


# --- what is refused --------------------------------------------------------------------------------------------------
def test_cracks_that_make_no_sense_are_said():
    points = ((0.0, 0.0), (1.0, 0.0))
    for data in ({"friction": -0.1}, {"friction": 0.3, "cohesion": Cohesion(1.0, 1.0)}):
        with pytest.raises(Mistake, match="friction"):
            Crack(points, **data)
    with pytest.raises(Mistake, match="energy"):
        Cohesion(1.0, 0.0)
