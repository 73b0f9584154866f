"""Finite elements in space: exact fields that every element must reproduce, and the iterative solver of large systems."""

from __future__ import annotations

import numpy as np
import pytest
from blocks import RUBBER, STEEL, Array, block, driven, last, solved

from geofem import Box, Load, Material, Probe, Region, Scene, Support
from geofem.core import solvers
from geofem.scenes._parts import any_of, at_least, at_most

ELEMENTS = [("tetrahedron", 1), ("tetrahedron", 2), ("hexahedron", 1), ("hexahedron", 2)]
E, NU = 1000.0, 0.3
LAM, MU = E * NU / ((1 + NU) * (1 - 2 * NU)), E / (2 * (1 + NU))
GRADIENT = 1e-3 * np.array([[1.0, 0.5, -0.3], [0.2, -0.7, 0.4], [0.6, 0.1, 0.9]])
PLACE = (0.4, 0.7, 0.2)
"""Where displacements are compared (m): inside the block, on no face of its cells."""


def quadratic(x: Array) -> Array:
    """A displacement of second order, (3, n)."""
    X, Y, Z = x
    return 1e-3 * np.array([X * X + Y * Z, Y * Y - X * Z, Z * Z + X * Y])


# --- exact fields -----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("cell, order", ELEMENTS)
def test_patch_of_a_linear_field(cell: str, order: int) -> None:
    scene = driven(3, STEEL, lambda x, t: t * GRADIENT @ x, corner=PLACE)
    result = solved(scene, n=2, cell=cell, order=order)
    strain = 0.5 * (GRADIENT + GRADIENT.T)
    stress = LAM * np.trace(strain) * np.eye(3) + 2 * MU * strain  # Hooke
    expected = [stress[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))]
    np.testing.assert_allclose(last(result, "xx", "yy", "zz", "xy", "yz", "xz"), expected, rtol=1e-10)
    np.testing.assert_allclose(last(result, "u0", "u1", "u2"), GRADIENT @ PLACE, rtol=1e-10)


@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
def test_quadratic_elements_reproduce_a_quadratic_field(cell: str) -> None:
    # div sigma = mu lap(u) + (lam + mu) grad(div u) = 1e-3 (2 mu + 2 (lam + mu)) (1, 1, 1), held by a weight
    weight = -1e-3 * (2 * MU + 2 * (LAM + MU)) / STEEL.density
    scene = driven(3, STEEL, lambda x, t: t * quadratic(x), loads=(Load("gravity", (weight,) * 3),), corner=PLACE)
    result = solved(scene, n=2, cell=cell, order=2)
    np.testing.assert_allclose(last(result, "u0", "u1", "u2"), quadratic(np.array(PLACE)), rtol=1e-10)
    # the same weight as a body force per mass
    body = Load("body", lambda x, t: np.full_like(x, weight))
    again = solved(driven(3, STEEL, lambda x, t: t * quadratic(x), loads=(body,), corner=PLACE), n=2, cell=cell, order=2)
    np.testing.assert_allclose(last(again, "u0", "u1", "u2"), quadratic(np.array(PLACE)), rtol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("law", ["neo_hooke", "hencky"])
@pytest.mark.parametrize("cell, order, frame", [("tetrahedron", 2, "total"), ("hexahedron", 1, "updated")])
def test_rigid_rotation_makes_no_stress(law: str, cell: str, order: int, frame: str) -> None:
    def turn(x: Array, t: float) -> Array:
        # Rodrigues: by 90 degrees about the axis (1, 1, 1)
        angle, axis = 0.5 * np.pi * t, np.ones(3) / np.sqrt(3)
        K = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
        return (np.sin(angle) * K + (1 - np.cos(angle)) * K @ K) @ x

    scene = driven(3, Material(law, 1.0, {"E": E, "nu": NU}), turn)
    result = solved(scene, n=2, cell=cell, order=order, frame=frame, tolerance=1e-12)
    # objectivity; rounding of stresses of the size of E
    np.testing.assert_allclose(last(result, "xx", "yy", "zz", "xy", "yz", "xz"), 0.0, atol=1e-10 * E)


@pytest.mark.parametrize("cell, order", ELEMENTS)
def test_traction_pressure_and_weight_of_a_block(cell: str, order: int) -> None:
    pull = Load("traction", (0.0, 0.0, 10.0), where=at_least(2, 1.0))
    result = solved(block(3, STEEL, loads=(pull,)), n=2, cell=cell, order=order)
    np.testing.assert_allclose(last(result, "u0", "u1", "u2"), np.array([-NU, -NU, 1.0]) * 10.0 / E, rtol=1e-10)
    hydrostatic = Load("pressure", 10.0, where=any_of(*(at_least(i, 1.0) for i in range(3))))
    result = solved(block(3, STEEL, loads=(hydrostatic,)), n=2, cell=cell, order=order)
    np.testing.assert_allclose(last(result, "xx", "yy", "zz", "xy"), [-10.0, -10.0, -10.0, 0.0], atol=1e-10)
    np.testing.assert_allclose(last(result, "u0", "u1", "u2"), -10.0 * (1 - 2 * NU) / E, rtol=1e-10)
    # statics: the floor bears the weight, rho g V, whatever the deformation
    floor = (Probe("floor", "reaction", component=2, of="roller_2"),)
    result = solved(block(3, STEEL, loads=(Load("gravity", (0.0, 0.0, -10.0)),), probes=floor), n=2, cell=cell, order=order)
    assert last(result, "floor")[0] == pytest.approx(20.0, rel=1e-10)


def test_following_pressure_is_the_cauchy_stress() -> None:
    # neo-Hookean under all-round pressure p: p = -(mu (l**2 - 1) + lam ln J) / J with J = l**3, at any size of the strain
    stretch = 0.8
    p = -(MU * (stretch**2 - 1) + LAM * np.log(stretch**3)) / stretch**3
    squeezed = block(3, RUBBER, loads=(Load("pressure", p, where=any_of(*(at_least(i, 1.0) for i in range(3)))),))
    for frame in ("total", "updated"):
        result = solved(squeezed, n=1, cell="hexahedron", order=1, frame=frame)
        np.testing.assert_allclose(last(result, "u0", "u1", "u2"), stretch - 1, rtol=1e-7)
        np.testing.assert_allclose(last(result, "xx", "yy", "zz"), -p, rtol=1e-7)


def test_layers_of_two_materials_carry_one_stress() -> None:
    layers = tuple(
        Region(
            f"layer{i}",
            Box((0.0, 0.0, float(i)), (1.0, 1.0, i + 1.0)),
            Material("linear_elastic", 1.0, {"E": young, "nu": 0.0}),
        )
        for i, young in enumerate((100.0, 1000.0))
    )
    probes = [Probe(f"stress{i}", "stress", at=(0.4, 0.3, i + 0.6), component=2) for i in range(2)]
    scene = Scene(
        name="layers",
        regions=layers,
        length=1.0,
        supports=tuple(Support(f"roller_{i}", at_most(i, 0.0), (i,)) for i in range(3)),
        loads=(Load("traction", (0.0, 0.0, -5.0), where=at_least(2, 2.0)),),
        probes=(*probes, Probe("top", "displacement", at=(0.5, 0.5, 2.0), component=2)),
        plane="solid",
        strain="small",
    )
    for cell in ("tetrahedron", "hexahedron"):
        result = solved(scene, n=2, cell=cell, order=1)
        np.testing.assert_allclose(last(result, "stress0", "stress1"), -5.0, rtol=1e-10)
        assert last(result, "top")[0] == pytest.approx(-5 / 100 - 5 / 1000, rel=1e-10)


# --- the iterative solver ---------------------------------------------------------------------------------------------
def bent(material: Material = STEEL, shear: float = 1.0) -> Scene:
    """A block clamped at one face and sheared at the opposite one."""
    clamp = (Support("clamp", at_most(0, 0.0), (0, 1, 2)),)
    return block(3, material, clamp, (Load("traction", (0.0, shear, 0.5 * shear), where=at_least(0, 1.0)),))


@pytest.mark.parametrize("cell, order, meshes", [("tetrahedron", 1, (4, 8, 16)), ("hexahedron", 2, (4, 6))])
def test_multigrid_needs_few_iterations_on_any_mesh(
    cell: str, order: int, meshes: tuple, monkeypatch: pytest.MonkeyPatch
) -> None:
    iterations = []
    for n in meshes:
        direct = solved(bent(), n=n, cell=cell, order=order)
        assert direct.work["linear"] == direct.work["newton"]
        with monkeypatch.context() as patch:
            patch.setattr(solvers, "ITERATIVE_DOFS", 0)
            found = solved(bent(), n=n, cell=cell, order=order)
        # the preconditioned residual falls to 1e-10; the condition of the preconditioned system is about 10
        np.testing.assert_allclose(last(found, "u0", "u1", "u2"), last(direct, "u0", "u1", "u2"), rtol=1e-7)
        assert found.work["linear"] > found.work["newton"], "the iterative solver was not asked"
        iterations.append(found.work["linear"] / found.work["newton"])
    # rigid-body modes in the coarse spaces: iterations hardly grow with the mesh
    assert max(iterations) < 40 and iterations[-1] < 1.2 * iterations[-2]


def test_multigrid_serves_newton(monkeypatch: pytest.MonkeyPatch) -> None:
    direct = solved(bent(RUBBER, 50.0), n=3, order=1, cell="hexahedron")
    monkeypatch.setattr(solvers, "ITERATIVE_DOFS", 0)
    found = solved(bent(RUBBER, 50.0), n=3, order=1, cell="hexahedron")
    np.testing.assert_allclose(last(found, "u0", "u1", "u2"), last(direct, "u0", "u1", "u2"), rtol=1e-7)
    assert found.work["newton"] == direct.work["newton"] < found.work["linear"]
