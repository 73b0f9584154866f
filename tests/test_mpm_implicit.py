"""The implicit solver of the material point methods: exact answers, its rate of convergence, and the ways in which it ends."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import geofem
from geofem import methods
from geofem.methods.mpm.implicit import ImplicitMpm
from geofem.mistake import Breakdown, Mistake
from geofem.result import Result
from geofem.runner import prepare
from geofem.scene import Box, Load, Material, Polygon, Probe, Region, Rigid, Scene, Support, Wall
from geofem.scenes import axial, column, footing, patch, wedge

KERNELS = [("mpm-linear", {}), ("mpm-gimp", {}), ("mpm-gimp", {"kernel": "contiguous"}), ("mpm-cpdi", {}), ("mpm-cpdi2", {}),
           ("mpm-bspline", {})]  # fmt: skip
SOFT = Material("hencky", 80.0, {"E": 1e4, "nu": 0.3})


def build(scene: Scene, method: str = "mpm-gimp", **knobs: Any) -> ImplicitMpm:
    prepare()
    model = methods.get(method).build(scene, solver="implicit", **knobs)
    assert isinstance(model, ImplicitMpm)
    return model


def run(scene: Scene | str, method: str = "mpm-gimp", **knobs: Any) -> Result:
    return geofem.run(scene, method=method, solver="implicit", **knobs)


def to_end(model: ImplicitMpm) -> ImplicitMpm:
    while model.t < model.scene.t_end * (1 - 1e-12):
        model.step(min(model.dt(), model.scene.t_end - model.t))
    return model


# --- exact answers ------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("method", "knobs"), KERNELS[:-1])
def test_patch_of_constant_strain(method, knobs):
    """Not with splines: next to an edge within the grid they feel its traction at nodes that a support there does not hold."""
    scene = replace(patch.scene(), plane="plane_strain")
    model = to_end(build(scene, method, n=5, load_steps=1, **knobs))
    exact = 1e-3 * (model.bodies[0].own("X") @ np.array([[1.0, 0.5], [0.5, 1.0]]))
    error = model.bodies[0].own("x") - model.bodies[0].own("X") - exact
    assert np.abs(error).max() < 1e-12
    assert np.ptp(model.bodies[0].own("tau"), axis=0).max() < 1e-7 * 1e3  # of 1e3 Pa


@pytest.mark.parametrize(("kernel", "tolerance"), [("mpm-gimp", 0.015), ("mpm-cpdi", 0.005)])
def test_column_settles_as_the_exact_one(kernel, tolerance):
    """Uniform domains see the compressed column's cells unevenly: 1.1 % at n = 16, half of it at 32."""
    result = run("column", kernel, n=16)
    assert result.status == "ok" and result.error["settlement"] < tolerance
    assert result.savings["active_grid"] < 0.2


def test_cubic_splines_in_a_room_of_one_cell():
    """Both ends of the room are within reach of every point: a column without Poisson's effect is the same however thin it is."""
    tops = []
    for width in (0.25, 0.5):
        scene = Scene(
            "thin", (Region("column", Box((0.0, 0.0), (width, 1.0)), Material("hencky", 80.0, {"E": 1e4, "nu": 0.0})),), 1.0,
            (Support("base", lambda x: x[1] <= 0, (1,)), Support("sides", lambda x, w=width: (x[0] <= 0) | (x[0] >= w), (0,))),
            loads=(Load("gravity", (0.0, -10.0)),), room=Box((0.0, 0.0), (width, 1.25)),
        )  # fmt: skip
        model = to_end(build(scene, "mpm-bspline", kernel="cubic", n=4, load_steps=1, ghost=0.0))
        tops.append(model.bodies[0].own("x")[:, 1].max())
    assert tops[0] == pytest.approx(tops[1], rel=1e-9)


@pytest.mark.slow
def test_wedge_bears_what_hill_says():
    """The exact solution of a large penetration, at 6 cells over the depth: 1 % too high."""
    result = run("wedge", "mpm-cpdi", n=6, load_steps=60, cure="cell")
    assert result.status == "ok" and result.error["p_over_k"] < 0.05


@pytest.mark.slow  # the explicit passes take their time to compile
def test_dynamic_relaxation_finds_the_same_settlement():
    found = [
        geofem.run("column", method="mpm-cpdi", n=8, solver=solver).qoi["settlement"] for solver in ("implicit", "explicit")
    ]
    assert found[0] == pytest.approx(found[1], rel=2e-3)


@pytest.mark.slow  # the loops in space take their time to compile
def test_column_in_space():
    flat = column.scene()
    solid = replace(
        flat, plane="solid",
        regions=(Region("column", Box((0.0, 0.0, 0.0), (12.5, 50.0, 12.5)), flat.regions[0].material),),
        supports=(
            Support("base", lambda x: x[1] <= 0, (1,)),
            Support("x", lambda x: (x[0] <= 0) | (x[0] >= 12.5), (0,)),
            Support("z", lambda x: (x[2] <= 0) | (x[2] >= 12.5), (2,)),
        ),
        loads=(Load("gravity", (0.0, -10.0, 0.0)),),
        probes=(Probe("top_uy", "displacement", (6.25, 50.0, 6.25), 1), Probe("base_stress", "stress", (6.25, 0.0, 6.25), 1)),
    )  # fmt: skip
    thick = replace(
        flat, regions=(Region("column", Box((0.0, 0.0), (12.5, 50.0)), flat.regions[0].material),),
        supports=(flat.supports[0], Support("x", lambda x: (x[0] <= 0) | (x[0] >= 12.5), (0,))),
    )  # fmt: skip
    tops = [
        to_end(build(scene, "mpm-cpdi", n=4, load_steps=3, ghost=0.0)).bodies[0].own("x")[:, 1].max()
        for scene in (solid, thick)
    ]
    assert tops[0] == pytest.approx(tops[1], rel=1e-9)


@pytest.mark.parametrize("cure", ["none", "cell"])
def test_thick_cylinder(cure):
    """u = A r + B / r with u = u0 at the inner face and no stress at the outer one."""
    inner, outer, u0, nu = 1.0, 2.0, 1e-3, 0.3
    scene = Scene(
        "cylinder",
        (Region("ring", Box((inner, 0.0), (outer, 0.25)), Material("linear_elastic", 1.0, {"E": 1e6, "nu": nu})),),
        1.0,
        (
            Support("inner", lambda x: x[0] <= inner, (0,), lambda x, t: u0 * t + 0 * x[0]),
            Support("ends", lambda x: (x[1] <= 0) | (x[1] >= 0.25), (1,)),
        ),
        probes=(Probe("outer", "displacement", (outer, 0.125), 0), Probe("push", "reaction", component=0, of="inner")),
        plane="axisymmetric",
        strain="small",
    )
    # no radial stress at b: A = (1 - 2 nu) B / b^2
    B = u0 / (1 / inner + (1 - 2 * nu) * inner / outer**2)
    A = (1 - 2 * nu) * B / outer**2
    result = run(scene, n=16, load_steps=1, cure=cure)
    assert result.history["outer"][-1] == pytest.approx(A * outer + B / outer, rel=5e-3)
    shear = 1e6 / 2 / (1 + nu)
    # per radian: the radius times the radial stress over the height
    push = 2 * shear * (B / inner**2 - A / (1 - 2 * nu)) * inner * 0.25
    assert result.history["push"][-1] == pytest.approx(push, rel=2e-2)


# --- Newton, ranks, restart -----------------------------------------------------------------------------------------------
@pytest.mark.parametrize("cure", ["none", "cell"])
@pytest.mark.parametrize("method", ["mpm-gimp", "mpm-cpdi"])
def test_newton_converges_quadratically(method, cure):
    """A block that hangs from one side: the tangent is that of the forces, with the cure as well."""
    scene = Scene(
        "hanging", (Region("block", Box((0.0, 0.0), (2.0, 1.0)), SOFT),), 1.0,
        (Support("clamp", lambda x: x[0] <= 0, (0, 1)),), loads=(Load("gravity", (0.0, -8.0)),), room=Box((-1.0, -3.0), (3.0, 2.0)),
    )  # fmt: skip
    model = build(scene, method, n=4, load_steps=4, cure=cure, tolerance=1e-12)
    norms: list[float] = []
    system = model._system()
    evaluate = system.evaluate

    def watched():
        found = evaluate()
        free = np.delete(found.force, system.held) if hasattr(system, "held") else found.force
        if found.scale > 0.0:
            norms.append(float(np.linalg.norm(free) / found.scale))
        return found

    system.evaluate = watched
    model._solve(system, 0.25, 0.25)
    last = [n for n in norms if n > 1e-13][-3:]
    assert len(norms) < 10
    # the exponent of the last iterations above rounding
    assert min(norms) < 1e-12 and math.log(last[-1]) < 1.6 * math.log(last[-2])


RANKS = """
import json, geofem
from mpi4py import MPI
kn = dict(solver="implicit", n=8, load_steps=1, tolerance=1e-12)
found = [geofem.run("column", method=m, **kn).qoi["settlement"] for m in ("mpm-gimp", "mpm-cpdi")]
found.append(geofem.run("footing", method="mpm-gimp", **kn | dict(n=2, load_steps=2, cure="cell")).qoi["Nc"])
if MPI.COMM_WORLD.rank == 0:
    print("found", json.dumps(found))
"""


@pytest.mark.mpi
@pytest.mark.slow
def test_ranks_agree(mpirun):
    one, two, three = (
        json.loads(next(line for line in mpirun(ranks, RANKS).splitlines() if line.startswith("found"))[6:])
        for ranks in (1, 2, 3)
    )
    assert two == pytest.approx(one, rel=1e-10) and three == pytest.approx(one, rel=1e-10)


def test_restart_goes_on_as_before():
    scene = column.scene()
    whole = to_end(build(scene, "mpm-cpdi", n=8, load_steps=4))
    half = build(scene, "mpm-cpdi", n=8, load_steps=4)
    half.step(half.dt())
    half.step(half.dt())
    again = build(scene, "mpm-cpdi", n=8, load_steps=4)
    again.restore(half.state())
    to_end(again)
    assert np.array_equal(again.bodies[0].own("x"), whole.bodies[0].own("x"))
    assert again.energy() == whole.energy()
    assert again.energy()["internal"] == pytest.approx(again.energy()["external"], rel=0.05)


def test_a_scene_in_motion_is_refused():
    with pytest.raises(Mistake, match="bodies at rest"):
        methods.get("mpm-gimp").build(axial.scene(), solver="implicit")


@pytest.mark.parametrize(
    ("solver", "knob"),
    [
        ("implicit", {"scheme": "musl"}),
        ("implicit", {"flip": 1.0}),
        ("implicit", {"threads": 2}),
        ("explicit", {"ghost": 0.01}),
    ],
)
def test_knobs_of_the_other_solver_are_refused(solver, knob):
    name = next(iter(knob))
    with pytest.raises(Mistake, match=f"mpm-gimp: {name} = .* says nothing to solver={solver}; leave it out"):
        methods.get("mpm-gimp").build(column.scene(), solver=solver, **knob)


# --- walls and rigid bodies ---------------------------------------------------------------------------------------------
def resting(friction: float, push: float = 0.0) -> Scene:
    """A block with its weight on a wall, pushed along it by a share of its weight."""
    return Scene(
        "resting", (Region("block", Box((0.0, 0.0), (2.0, 1.0)), Material("linear_elastic", 100.0, {"E": 1e5, "nu": 0.0})),), 1.0,
        (Support("stop", lambda x: x[0] >= 2.0, (0,)),), loads=(Load("gravity", (10.0 * push, -10.0)),),
        probes=(Probe("lift", "reaction", component=1, of="floor"), Probe("rub", "reaction", component=0, of="floor"),
                Probe("stop", "reaction", component=0, of="stop")),
        walls=(Wall("floor", lambda x: x[1] <= 0, (0.0, 1.0), friction),), strain="small",
    )  # fmt: skip


@pytest.mark.parametrize(("friction", "rub"), [(0.0, 0.0), (0.1, -200.0)])
def test_wall_carries_the_weight_and_rubs(friction, rub):
    history = run(resting(friction, 0.5), n=4, load_steps=1).history
    assert history["lift"][-1] == pytest.approx(2000.0)
    assert history["rub"][-1] == pytest.approx(rub, abs=1.0)
    assert history["stop"][-1] == pytest.approx(-1000.0 - rub, abs=1.0)


def test_wall_lets_go():
    """Pulled upwards by a support, the block leaves the wall and hangs."""
    block = resting(0.0)
    lift = Support("top", lambda x: x[1] >= 1.0, (0, 1), lambda x, t: 0.01 * t + 0 * x[0])
    scene = replace(block, supports=(lift,), loads=(), probes=block.probes[:2])
    assert np.abs(run(scene, n=4, load_steps=2).history["lift"]).max() < 1e-9


@pytest.mark.parametrize("friction", [0.0, math.inf])
def test_rigid_plate_presses_as_hooke_says(friction):
    """E u / H of a layer without Poisson's effect, less what the points sink into the plate: a share h / H of it at most."""
    E, sink, n = 1e5, 1e-3, 4
    scene = Scene(
        "layer", (Region("layer", Box((0.0, 0.0), (1.0, 1.0)), Material("hencky", 100.0, {"E": E, "nu": 0.0})),), 1.0,
        (Support("base", lambda x: x[1] <= 0, (1,)), Support("left", lambda x: x[0] <= 0, (0,))),
        probes=(Probe("load", "reaction", component=1, of="plate"),),
        rigids=(Rigid("plate", Polygon(((-0.5, 1.0), (1.5, 1.0), (1.5, 1.5), (-0.5, 1.5))), lambda t: (0.0, -sink * t), friction),),
    )  # fmt: skip
    result = run(scene, "mpm-cpdi", n=n, load_steps=1)
    force = -result.history["load"][-1]
    assert E * sink / (1 + 1 / n) * 0.99 < force < E * sink * 1.01
    assert result.work["newton"] < 8


def test_rough_footing_goes_on_where_its_side_lets_go():
    """At 0.05 B points come to touch the footing's rough side, with next to no pressure."""
    model = to_end(build(footing.scene(strain="finite", depth=0.1), "mpm-cpdi", n=4, load_steps=8, cure="cell"))
    assert model.work["cuts"] == 0


def test_newton_starts_from_the_flow_of_the_last_step():
    scene = replace(wedge.scene(), t_end=0.5)
    going, resting = (build(scene, n=2, load_steps=10, cure="cell", tolerance=1e-8) for _ in range(2))
    to_end(going)
    while resting.t < scene.t_end * (1 - 1e-12):
        resting._rate[:] = 0.0
        resting.step(resting.dt())
    assert going.work["newton"] < 0.7 * resting.work["newton"]
    assert going.probe(scene.probes[0]) == pytest.approx(resting.probe(scene.probes[0]), rel=1e-4)


# --- how it ends ----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("method", "knobs"), KERNELS[:-1])
def test_points_too_far_apart_leave_the_grid_a_null_space(method, knobs):
    """A bar whose points were pulled apart evenly: beyond a stretch of ppc there are fewer of them along it than nodes."""
    bar = Scene(
        "bar", (Region("bar", Box((0.0, 0.0), (4.0, 1.0)), Material("neo_hooke", 1000.0, {"E": 1e5, "nu": 0.0})),), 1.0,
        (Support("left", lambda x: x[0] <= 0, (0,)), Support("bottom", lambda x: x[1] <= 0, (1,))),
        loads=(Load("body", lambda x, t: 0.01 * np.array([x[0], 0 * x[0]])),), room=Box((-1.0, -1.0), (14.0, 2.0)),
    )  # fmt: skip
    for stretch, singular in ((1.9, False), (2.2, True)):
        model = build(bar, method, n=4, ppc=2, load_steps=1, **knobs)
        body = model.bodies[0]
        body.own("x")[:, 0] *= stretch
        body.own("F")[:, 0] = stretch
        body.own("state")[:] = 0.0
        if model.shape.domain == "corners":
            body.own("domain")[:, 0::2] *= stretch
        body.settle()
        if singular:
            with pytest.raises(Breakdown) as end:
                model.step(1.0)
            assert end.value.cause == "nullspace"
        else:
            system = model._system()
            system.load[:, 0] = 1e-6
            model.limits.follow(0.0, 0.0)
            model.limits.apply(system)
            system.evaluate()
            system.linearise()
            system.solver.solve(np.ones(system.owned))
            assert system.solver.least > 1e-5


def test_footing_locks_without_the_cure():
    """Nc = 2 + pi; hats lock in isochoric flow, and means over the cells do not."""
    locked, cured = (run("footing", "mpm-linear", n=8, load_steps=4, cure=cure).error["Nc"] for cure in ("none", "cell"))
    assert locked > 0.2 and cured < 0.06


def test_penalty_bounds_the_condition_of_slivers():
    """A block that reaches 1e-6 of a cell beyond a row of nodes."""
    sliver = Scene(
        "sliver", (Region("block", Box((0.0, 0.0), (1.0, 1.0)), SOFT),), 1.0,
        (Support("base", lambda x: x[1] <= 0, (0, 1)),), loads=(Load("gravity", (0.0, -1.0)),),
    )  # fmt: skip
    condition = []
    for ghost in (0.0, 0.03):
        model = build(sliver, "mpm-cpdi", n=4, load_steps=1, ghost=ghost)
        model.bodies[0].own("x")[:, 1] += 2.5e-7
        model.bodies[0].settle()
        system = model._system()
        model.limits.follow(0.0, 0.0)
        model.limits.apply(system)
        system.evaluate()
        system.linearise()
        size = system.matrix.mat.size[0]
        full = system.matrix.mat.getValues(range(size), range(size))
        condition.append(np.linalg.cond(np.delete(np.delete(full, system.held, 0), system.held, 1)))
    assert condition[0] > 1e6 and condition[1] < 1e5


@pytest.mark.parametrize("cure", ["none", "cell"])
@pytest.mark.parametrize("plane", ["plane_strain", "axisymmetric", "solid"])
def test_tangent_is_the_derivative_of_the_forces(plane, cure):
    dim = 3 if plane == "solid" else 2
    scene = Scene(
        "bent", (Region("block", Box((1.0,) * dim, (2.0,) * dim), SOFT),), 1.0, (Support("base", lambda x: x[1] <= 1, (0, 1)),),
        plane=plane, room=Box((0.0,) * dim, (3.0,) * dim),
    )  # fmt: skip
    model = build(scene, "mpm-cpdi", n=2, load_steps=1, cure=cure, ghost=0.0)
    system = model._system()
    rng = np.random.default_rng(1)
    system.hold(np.empty(0, int), np.empty(0))
    free = np.repeat(system.reached[system.node_of_dof], dim)
    u = np.where(free, 0.1 * rng.random(free.size), 0.0)
    way = np.where(free, rng.random(free.size) - 0.5, 0.0)
    forces = []
    for e in (-1e-6, 0.0, 1e-6):
        system.unknown.x.array[:] = u + e * way
        forces.append(system.evaluate().force.copy())
        if e == 0.0:
            system.linearise()
    x, y = system.matrix.mat.createVecs()
    x.array[:] = way
    system.matrix.mat.mult(x, y)
    slope = (forces[2] - forces[0]) / 2e-6
    assert np.abs(y.array - slope)[free].max() < 1e-6 * np.abs(slope).max()
