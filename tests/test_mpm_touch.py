"""Material points touch walls and rigid bodies: Coulomb's friction, lift-off, forces by elasticity."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from points import NOTHING, block, build, finish, uniform

from geofem.methods.mpm import GimpMpm
from geofem.methods.mpm.contact import Contact
from geofem.scene import Box, Load, Polygon, Probe, Rigid, Scene, Support, Wall

SHAPES = [("hat", "musl"), ("gimp", "usl"), ("cpdi", "usl")]
G = 10.0


def on_floor(v: float, friction: float, t_end: float, tilt: float = 0.0, ramp: float = 0.0) -> Scene:
    """A block on a floor that is tilted, or gravity is: by the angle whose tangent is ``tilt``."""
    pull = G * np.array([tilt, -1.0]) / np.hypot(tilt, 1.0)
    gravity = Load("gravity", tuple(pull.tolist()), amplitude=lambda t: min(1.0, t / ramp) if ramp else 1.0)
    floor = Wall("floor", lambda x: x[1] <= 0, (0.0, 1.0), friction)
    probes = tuple(Probe(f"v{c}", "mean_velocity", component=c) for c in range(2))
    return block(
        uniform(v, 0.0), t_end, walls=(floor,), loads=(gravity, NOTHING), probes=probes, room=Box((-0.5, -0.5), (1.5, 1.5))
    )


@pytest.mark.parametrize("shape, scheme", SHAPES)
def test_a_sliding_block_is_slowed_by_mu_times_the_normal_force(shape: str, scheme: str) -> None:
    """In every step the wall's force along is mu times that across, to rounding; on average that is mu g.

    It slides so fast that no node comes to rest for a moment, as the block shears and bounces.
    """
    mu, t_end = 0.3, 0.2
    model = build(on_floor(2.0, mu, t_end), shape, n=6, scheme=scheme)
    along, across = (Probe("R", "reaction", of="floor", component=c) for c in range(2))
    while model.t < t_end * (1 - 1e-12):
        model.step(min(model.dt(), t_end - model.t))
        assert model.probe(along) == pytest.approx(-mu * model.probe(across), rel=1e-9, abs=1e-9)
    vx, vy = (model.probe(probe) for probe in model.scene.probes)
    weight = G * (t_end - 0.5 * model._last_dt)  # velocities are those of the middle of the last step
    assert vx - 2.0 == pytest.approx(-mu * (vy + weight), rel=1e-9)
    assert vx == pytest.approx(2.0 - mu * G * t_end, rel=0.05)
    assert model.checks()["momentum"] < 1e-12


@pytest.mark.parametrize("shape, scheme", SHAPES)
def test_smooth_slides_on_and_rough_stops(shape: str, scheme: str) -> None:
    """A smooth floor keeps the momentum along it; with mu = 0.5 the block comes to rest after v^2 / 2 mu g, and stays there."""
    model = finish(build(on_floor(0.5, 0.0, 0.1), shape, n=6, scheme=scheme))
    assert model.probe(model.scene.probes[0]) == pytest.approx(0.5, rel=1e-12)
    model = finish(build(on_floor(0.5, 0.5, 0.25), shape, n=6, scheme=scheme))
    # elastic: the block goes on shearing by about v sqrt(rho / G) H, a few millimetres
    assert model.bodies[0].own("x").mean() - model.bodies[0].own("X").mean() == pytest.approx(0.5 * 0.025, abs=0.004)
    assert abs(model.probe(model.scene.probes[0])) < 0.1
    rough = finish(build(on_floor(0.5, np.inf, 0.1), shape, n=6, scheme=scheme))
    low = rough.bodies[0].own("X")[:, 1] < 0.1
    assert np.abs((rough.bodies[0].own("x") - rough.bodies[0].own("X"))[low, 0]).max() < 0.005


@pytest.mark.parametrize("shape, scheme", SHAPES)
def test_a_block_on_an_incline_slides_beyond_the_angle_of_friction(shape: str, scheme: str) -> None:
    """mu = 0.5: it sticks at a slope of 0.4 and slides at one of 0.6 with g (sin - mu cos)."""
    way = {}
    for tilt in (0.4, 0.6):
        model = finish(build(on_floor(0.0, 0.5, 0.4, tilt, ramp=0.1), shape, n=4, scheme=scheme))
        way[tilt] = float(np.mean((model.bodies[0].own("x") - model.bodies[0].own("X"))[:, 0]))
    # friction and weight grow together in the ramp of .1 s
    cos = 1 / np.hypot(0.6, 1.0)
    slides = G * cos * (0.6 - 0.5) * (0.3**2 / 2 + 0.1 / 2 * 0.3 + 0.1**2 / 6)
    # waves in the block let parts of its base stick now and then, where friction is below mu N: it goes somewhat farther
    assert 0.97 * slides < way[0.6] < 1.2 * slides
    assert way[0.4] < 0.006 < 0.2 * slides


@pytest.mark.parametrize("shape, scheme", SHAPES)
def test_lift_off_costs_no_force(shape: str, scheme: str) -> None:
    """A block that leaves a wall, however rough, does so with all of its momentum."""
    scene = replace(on_floor(0.0, np.inf, 0.05), loads=(NOTHING,), initial_velocity=uniform(0.3, 2.0))
    model = finish(build(scene, shape, n=6, scheme=scheme))
    assert np.all(model.balance.impulse == 0.0) and model.work["steps"] > 10
    assert model.probe(scene.probes[1]) == pytest.approx(2.0, rel=1e-12)
    assert np.abs(model.snapshot()["stress"]).max() < 1e-5


# --- rigid bodies -------------------------------------------------------------------------------------------------------------
def plate(motion: Any, friction: float = 0.0) -> Rigid:
    return Rigid("plate", Polygon(((-0.5, 1.0), (1.5, 1.0), (1.5, 1.6), (-0.5, 1.6))), motion, friction)


FORCE = tuple(Probe(f"F{c}", "reaction", of="plate", component=c) for c in range(2))
BASE = Support("base", lambda x: x[1] <= 0, (1,))


@pytest.mark.parametrize("shape, scheme", SHAPES)
def test_a_plate_compresses_a_block_by_its_plane_strain_modulus(shape: str, scheme: str) -> None:
    """At rest the plate's force is E / (1 - nu^2) times the strain, and the base's is the same.

    The block sinks into the plate by the shortening of one cell, and the force acts on the points of the uppermost layer.
    """
    E, nu = 4e6, 0.3
    down = plate(lambda t: (0.0, -0.004 * t))
    inside = tuple(Probe(f"u{y}", "displacement", (0.5, y), 1) for y in (0.25, 0.75, 1.0))
    base = Probe("R", "reaction", of="base", component=1)
    scene = block(None, t_end=1.0, supports=(BASE,), rigids=(down,), probes=(*FORCE, base, *inside))
    n = 6
    model = finish(build(replace(scene, dynamic=False), shape, n=n, scheme=scheme, tolerance=1e-6))
    fx, fy, held, low, high, top = (model.probe(probe) for probe in model.scene.probes)
    assert fy == pytest.approx(E / (1 - nu**2) * (high - low) / 0.5, rel=0.02)
    assert held == pytest.approx(-fy, rel=0.01) and abs(fx) < 1e-6 * abs(fy)
    stiffness = E * (1 - nu) / (1 + nu) / (1 - 2 * nu) * n
    assert top == pytest.approx(-0.004 - fy / stiffness, rel=0.04)


@pytest.mark.parametrize("shape, scheme", SHAPES)
def test_friction_of_a_plate_is_capped(shape: str, scheme: str) -> None:
    """A plate that is pressed on and drawn along drags with mu times its normal force, by Newton's third law against its motion."""
    mu = 0.3
    path = plate(lambda t: (0.02 * max(0.0, t - 0.3) / 0.7, -0.004 * min(1.0, t / 0.3)), mu)
    clamp = replace(BASE, components=(0, 1))
    scene = replace(block(None, t_end=1.0, supports=(clamp,), rigids=(path,), probes=FORCE), dynamic=False)
    model = finish(build(scene, shape, n=4, scheme=scheme, passages=60.0))
    fx, fy = (model.probe(probe) for probe in FORCE)
    assert fy < 0 and 0.95 * mu * abs(fy) < fx <= mu * abs(fy) * (1 + 1e-9)
    # held within the cone the plate sticks: a tenth of a millimetre of shear takes less than mu N
    path = plate(lambda t: (1e-4 * max(0.0, t - 0.3) / 0.7, -0.004 * min(1.0, t / 0.3)), mu)
    model = finish(build(replace(scene, rigids=(path,)), shape, n=4, scheme=scheme, tolerance=1e-5))
    fx, fy = (model.probe(probe) for probe in FORCE)
    assert 0 < fx < 0.3 * mu * abs(fy)


@pytest.mark.parametrize("shape, scheme", SHAPES)
def test_a_plate_lets_go(shape: str, scheme: str) -> None:
    """Pushed in and drawn back within .04 s: a force while it is in, none to pull; its work stays in the block, but for losses."""
    stroke = plate(lambda t: (0.0, -0.01 * np.sin(np.pi * min(t / 0.04, 1.5))))
    scene = block(None, 0.06, supports=(BASE,), rigids=(stroke,), probes=FORCE)
    model = build(scene, shape, n=6, scheme=scheme)
    forces = []
    while model.t < scene.t_end * (1 - 1e-12):
        model.step(min(model.dt(), scene.t_end - model.t))
        forces.append([model.probe(probe) for probe in FORCE])
    fx, fy = np.array(forces).T
    assert np.all(fy <= 0.0) and fy.min() < -1e4 and np.all(fy[-5:] == 0.0)
    assert np.abs(fx).max() < 1e-6 * np.abs(fy).max()
    assert model.checks()["momentum"] < 1e-12
    # the grid dissipates what it cannot see of so short a stroke, less with finer cells, and never adds to it
    energy = model.energy()
    assert 0.6 * energy["external"] < energy["kinetic"] + energy["internal"] < 1.01 * energy["external"]


@pytest.mark.parametrize("shape, scheme", SHAPES)
def test_a_smooth_face_pushes_along_its_normal(shape: str, scheme: str) -> None:
    """A wedge with a face of 3 : 1 on the block's corner: the force is normal to the face, to rounding."""
    wedge = Rigid("plate", Polygon(((0.5, 1.2), (1.6, 0.8333333333333334), (1.6, 1.6))), lambda t: (0.0, -2.0 * t))
    scene = block(None, 0.02, supports=(BASE,), rigids=(wedge,), probes=FORCE)
    model = finish(build(scene, shape, n=6, scheme=scheme))
    fx, fy = (model.probe(probe) for probe in FORCE)
    assert fy < -100.0 and fx == pytest.approx(fy / 3.0, rel=1e-9)
    assert model.checks()["momentum"] < 1e-12


@pytest.mark.parametrize("knobs", [{"passages": 30.0}, {"solver": "implicit", "load_steps": 8}])
def test_each_rigid_body_keeps_its_own_grip(knobs: dict[str, Any]) -> None:
    """A rough plate is pressed on and drawn along; a second rigid body that touches nothing takes nothing from its friction."""
    drawn = plate(lambda t: (1e-4 * max(0.0, t - 0.3) / 0.7, -0.004 * min(1.0, t / 0.3)), np.inf)
    apart = Rigid("apart", Polygon(((1.4, -0.5), (1.9, -0.5), (1.9, 0.5), (1.4, 0.5))))
    clamp = replace(BASE, components=(0, 1))
    scene = replace(block(None, t_end=1.0, supports=(clamp,), rigids=(drawn,), probes=FORCE, loads=()), dynamic=False)
    forces = []
    for rigids in ((drawn,), (drawn, apart), (apart, drawn)):
        model = finish(GimpMpm().build(replace(scene, rigids=rigids), n=4, **knobs))
        forces.append([model.probe(probe) for probe in FORCE])
    assert forces[0][0] > 50.0
    assert forces[1] == pytest.approx(forces[0], rel=1e-9) and forces[2] == pytest.approx(forces[0], rel=1e-9)


def test_a_long_domain_passes_by_a_corner() -> None:
    """A sheared domain beside a corner lies behind both faces that meet there, and yet apart; shifted, it overlaps by its own side."""
    corner = Contact(Rigid("corner", Polygon(((0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)))), 0)
    scene = replace(block(None, room=Box((-4.0, -4.0), (8.0, 8.0))), rigids=(corner.rigid,), dynamic=False)
    body = build(scene, "cpdi", n=1, ppc=1).bodies[0]
    # a needle along (1, -1) of 2 by 0.1, its middle at a distance d from the corner
    body.arrays["domain"][0] = (0.7, -0.7, 0.035, 0.035)
    for d, touches in ((0.06, False), (0.045, True)):
        body.own("x")[0] = -d / np.sqrt(2.0)
        body.force[:] = 0.0
        force = corner.touch(body, 1.0, 1.0, 1.0)
        assert bool(np.any(force)) == touches
    assert force[0] == pytest.approx(force[1]) and force[0] < 0.0
