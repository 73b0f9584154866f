"""Elastic finite elements in the plane and in axisymmetry against exact answers and references.

``patch``, ``cook``, ``column`` and ``cantilever`` are run as a user runs them; small blocks have polynomial answers that every
element must meet to rounding.
"""

from __future__ import annotations

import gc
import weakref
from dataclasses import replace

import numpy as np
import pytest
from blocks import RUBBER, STEEL, block, last, solved

from geofem import Box, Load, Material, Polygon, Probe, Region, Scene, Support, runner, scenes
from geofem.scenes._parts import any_of, at_least, at_most

ELEMENTS = [("triangle", 1), ("triangle", 2), ("triangle", 3), ("quadrilateral", 1), ("quadrilateral", 2)]
SQUARE_WITH_A_FIFTH_CORNER = Polygon(((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.4, 1.0), (0.0, 1.0)))
"""A square that Gmsh meshes, irregularly; of four corners it would get a grid."""


# --- consistency ------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "motion, frame", [("strain", "total"), *((m, f) for m in ("rotation", "shear") for f in ("total", "updated"))]
)
@pytest.mark.parametrize("cell, order", ELEMENTS)
def test_irregular_patch_reproduces_a_homogeneous_motion(motion: str, frame: str, cell: str, order: int) -> None:
    scene = scenes.get("patch")(motion=motion)
    irregular = replace(scene, regions=(replace(scene.regions[0], shape=SQUARE_WITH_A_FIFTH_CORNER),))
    result = solved(irregular, n=3, cell=cell, order=order, frame=frame, tolerance=1e-13)
    # rounding of stresses of the size of E, through a rotation and a few solutions
    assert max(result.error.values()) < 1e-10


def test_irregular_patch_is_irregular() -> None:
    scene = scenes.get("patch")(motion="strain")
    irregular = replace(scene, regions=(replace(scene.regions[0], shape=SQUARE_WITH_A_FIFTH_CORNER),))
    assert solved(irregular, n=3).size["cells"] != solved(scene, n=3).size["cells"]


# --- references -------------------------------------------------------------------------------------------------------
def test_cook_p2_meets_its_reference() -> None:
    assert solved("cook", variant="A", n=32, order=2).error["uy"] < 1e-3


@pytest.mark.parametrize("cell, order, quadrature", [*((c, o, "full") for c, o in ELEMENTS), ("quadrilateral", 2, "reduced")])
def test_every_element_converges_on_cook(cell: str, order: int, quadrature: str) -> None:
    errors = [solved("cook", variant="A", n=n, cell=cell, order=order, quadrature=quadrature).error["uy"] for n in (4, 8, 16)]
    # the singular corners hold all elements back to an order near 1.1 at best: a third off with every halving is less
    assert errors[1] < 0.67 * errors[0] and errors[2] < 0.67 * errors[1]
    assert errors[2] < (0.03 if order == 1 else 1e-3)


@pytest.mark.parametrize("variant", "BCD")
def test_mixed_elements_do_not_lock_where_linear_triangles_do(variant: str) -> None:
    assert solved("cook", variant=variant, n=16, formulation="mixed").error["uy"] < 0.01
    assert solved("cook", variant=variant, n=16, order=1).error["uy"] > 0.2


@pytest.mark.parametrize("law, n, tolerance", [("hencky", 16, 1e-3), ("neo_hooke", 16, 1e-3), ("linear", 4, 1e-12)])
def test_column_settles_by_the_integral_of_its_stretch(law: str, n: int, tolerance: float) -> None:
    # the linear solution is quadratic in the height: P2 has it to rounding
    result = solved("column", law=law, n=n)
    assert result.error["settlement"] < tolerance
    assert result.qoi["base_stress"] == pytest.approx(-40e3, rel=tolerance)


@pytest.mark.parametrize("load", ["tip", "self_weight"])
@pytest.mark.parametrize("P", [1, 5, 10])
def test_slender_cantilever_is_the_elastica(load: str, P: float) -> None:
    # stretch and shear, which the elastica leaves out, are of the order of the slenderness squared, 1e-4
    assert solved("cantilever", load=load, P=P, n=1, order=2).error["tip"] < 1e-3


# --- exact answers of blocks ------------------------------------------------------------------------------------------
def test_plane_stress_is_free_across() -> None:
    pulled = block(2, STEEL, loads=(Load("traction", (10.0, 0.0), where=at_least(0, 1.0)),), plane="plane_stress")
    result = solved(pulled, n=2)
    # u = sigma / E (x, -nu y), Hooke; rounding only
    np.testing.assert_allclose(last(result, "u0", "u1"), [0.01, -0.003], rtol=1e-11)
    np.testing.assert_allclose(last(result, "xx", "yy", "zz", "xy"), [10.0, 0.0, 0.0, 0.0], atol=1e-10)


@pytest.mark.parametrize("cell, order", ELEMENTS)
def test_uniform_pressure_gives_uniform_stress(cell: str, order: int) -> None:
    pressed = block(2, STEEL, loads=(Load("pressure", 10.0, where=any_of(at_least(0, 1.0), at_least(1, 1.0))),))
    result = solved(pressed, n=2, cell=cell, order=order)
    # plane strain: zz = nu (xx + yy), strain (1 + nu)(1 - 2 nu) p / E
    np.testing.assert_allclose(last(result, "xx", "yy", "zz", "xy"), [-10.0, -10.0, -6.0, 0.0], atol=1e-10)
    np.testing.assert_allclose(last(result, "u0", "u1"), -0.0052, rtol=1e-11)


@pytest.mark.parametrize("frame", ["total", "updated"])
@pytest.mark.parametrize("material", [RUBBER, Material("hencky", 1.0, {"E": 1000.0, "nu": 0.3})], ids=lambda m: m.law)
def test_follower_pressure_is_the_cauchy_stress_and_its_resultant_depends_on_the_ends_only(
    frame: str, material: Material
) -> None:
    ends = tuple(
        Probe(f"{s}{i}", "displacement", at=(x, 1.0), component=i) for s, x in (("left", 0.0), ("right", 1.0)) for i in (0, 1)
    )
    reactions = tuple(Probe(f"force{i}", "reaction", component=i, of="clamp") for i in (0, 1))
    lopsided = Load("pressure", 300.0, where=lambda x: (x[1] >= 1.0 - 1e-9) | (x[0] >= 1.0 - 1e-9))
    clamp = (Support("clamp", at_most(1, 0.0), (0, 1)),)
    end = (Probe("foot0", "displacement", at=(1.0, 0.0), component=0),)
    result = solved(block(2, material, clamp, (lopsided,), probes=(*ends, *reactions, *end)), n=3, frame=frame)
    # the curve runs from the foot of the right side, which is held, up and along the top to its left end
    along = np.array([0.0, 1.0]) + last(result, "left0", "left1") - np.array([1.0, 0.0])
    # force of a pressure on a curve: -p times the integral of its normal, which is its chord turned by 90 degrees
    pushed = -300.0 * np.array([along[1], -along[0]])
    np.testing.assert_allclose(last(result, "force0", "force1"), -pushed, rtol=1e-8)
    assert abs(last(result, "left0")[0]) > 0.1, "the chord must have turned for this test to tell a dead load from a follower"


def test_layers_of_two_materials_carry_one_stress() -> None:
    soft, hard = (Material("linear_elastic", 1.0, {"E": E, "nu": 0.0}) for E in (100.0, 1000.0))
    base = block(2, STEEL, loads=(Load("traction", (0.0, -5.0), where=at_least(1, 2.0)),))
    probes = (
        Probe("top", "displacement", at=(0.5, 2.0), component=1),
        *(Probe(f"stress{k}", "stress", at=(0.4, y), component=1) for k, y in enumerate((0.3, 1.7))),
    )
    layers = tuple(Region(name, Box((0.0, y), (1.0, y + 1.0)), m) for name, y, m in (("soft", 0.0, soft), ("hard", 1.0, hard)))
    for cell, order in ELEMENTS:
        result = solved(replace(base, regions=layers, probes=probes), n=2, cell=cell, order=order)
        np.testing.assert_allclose(last(result, "stress0", "stress1"), -5.0, rtol=1e-10)
        # springs in series: 5 / 100 + 5 / 1000
        assert last(result, "top")[0] == pytest.approx(-0.055, rel=1e-10)


# --- thick cylinder ---------------------------------------------------------------------------------------------------
def cylinder(nu: float, law: str = "linear_elastic") -> Scene:
    """A thick cylinder 1 <= r <= 2 between rollers under an inner pressure of 1, in the (r, z) plane."""
    return Scene(
        name="cylinder",
        regions=(Region("wall", Box((1.0, 0.0), (2.0, 0.25)), Material(law, 1.0, {"E": 1000.0, "nu": nu})),),
        length=1.0,
        supports=(Support("rollers", any_of(at_most(1, 0.0), at_least(1, 0.25)), (1,)),),
        loads=(Load("pressure", 1.0, where=at_most(0, 1.0)),),
        probes=(
            Probe("wall", "displacement", at=(1.0, 0.1), component=0),
            *(Probe(name, "stress", at=(1.53, 0.11), component=k) for name, k in (("radial", 0), ("hoop", 2))),
        ),
        plane="axisymmetric",
        strain="small" if law == "linear_elastic" else "finite",
    )


def lame_wall(nu: float) -> float:
    """Displacement of the inner wall (Lame 1852): (1 + nu) / E p a**2 / (b**2 - a**2) ((1 - 2 nu) a + b**2 / a)."""
    return (1 + nu) / 1000.0 / 3.0 * ((1 - 2 * nu) + 4.0)


@pytest.mark.parametrize(
    "nu, formulation", [(0.0, "displacement"), (0.3, "displacement"), (0.3, "mixed"), (0.4999, "mixed"), (0.5, "mixed")]
)
def test_thick_cylinder_is_lames(nu: float, formulation: str) -> None:
    coarse, fine = (solved(cylinder(nu), n=n, formulation=formulation) for n in (8, 16))
    errors = [abs(last(result, "wall")[0] / lame_wall(nu) - 1) for result in (coarse, fine)]
    # nodal displacements converge at order 3 at least; the triangles next to the point differ from mesh to mesh, hence 2.5
    assert errors[1] < 1e-5 and errors[1] < errors[0] / 2**2.5
    # stresses are extrapolated within one cell, at order 2: (1/16)**2
    radial, hoop = ((1 - s * 4 / 1.53**2) / 3 for s in (1, -1))
    np.testing.assert_allclose(last(fine, "radial", "hoop"), [radial, hoop], atol=0.004)


# --- agreement of formulations ----------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "name, knobs",
    [
        ("cook", {"variant": "E", "n": 4}),
        ("cook", {"variant": "E", "n": 4, "cell": "quadrilateral", "order": 1}),
        ("cook", {"variant": "D", "n": 4, "formulation": "mixed"}),
        ("column", {"law": "neo_hooke", "n": 4}),
        ("column", {"law": "hencky", "n": 4}),
        ("cantilever", {"P": 5, "slenderness": 10, "n": 1}),
    ],
)
def test_updated_is_total_lagrangian(name: str, knobs: dict) -> None:
    total, updated = (solved(name, frame=frame, tolerance=1e-11, **knobs) for frame in ("total", "updated"))
    for qoi, value in total.qoi.items():
        assert updated.qoi[qoi] == pytest.approx(value, rel=1e-9), qoi  # the same equations: tolerance of Newton


@pytest.mark.parametrize("material", [RUBBER, replace(RUBBER, law="hencky")], ids=lambda m: m.law)
def test_stress_of_a_sheared_block_is_the_same_in_both_frames(material: Material) -> None:
    clamp = (Support("clamp", at_most(1, 0.0), (0, 1)),)
    sheared = block(2, material, clamp, (Load("traction", (200.0, 0.0), where=at_least(1, 1.0)),))
    total, updated = (last(solved(sheared, n=2, frame=frame), "xx", "yy", "zz", "xy") for frame in ("total", "updated"))
    np.testing.assert_allclose(updated, total, rtol=1e-7, atol=1e-7)


def test_laws_of_finite_strain_differ_by_the_strain_squared() -> None:
    found = []
    for stress in (8.0, 4.0):
        load = (Load("traction", (stress, 0.5 * stress), where=at_least(0, 1.0)),)
        # a shear needs the left side clamped
        clamp = (Support("clamp", at_most(0, 0.0), (0, 1)),)
        small = last(solved(block(2, STEEL, clamp, load), n=2), "u0", "u1")
        laws = [replace(STEEL, law=law) for law in ("hencky", "neo_hooke")]
        found.append([np.abs(last(solved(block(2, law, clamp, load), n=2), "u0", "u1") - small).max() for law in laws])
    # the difference to linear elasticity is quadratic in the load; the next term, cubic, is of the size of the strain, 1 %
    order = np.log2(np.array(found[0]) / found[1])
    np.testing.assert_allclose(order, 2.0, atol=0.1)


# --- what a run leaves behind -----------------------------------------------------------------------------------------
def test_runs_leave_no_model_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    # MPI has about two thousand communicators: kept models use them up within a hundred runs, and the process is aborted
    models: list[weakref.ref] = []
    start = runner.Run.__init__

    def noted(self: runner.Run, scene: Scene, model: object, *args: object) -> None:
        models.append(weakref.ref(model))
        start(self, scene, model, *args)

    monkeypatch.setattr(runner.Run, "__init__", noted)
    solved("cook", variant="E", n=2)
    solved("beam_drop", n=1, steps=2, frame="updated")
    gc.collect()
    assert [model() for model in models] == [None, None]
