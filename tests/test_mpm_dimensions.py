"""Material points in space and with axial symmetry: patches, columns, cylinders."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from points import NOTHING, build, finish, run

from geofem.methods.mpm import grid as g
from geofem.methods.mpm.deeds import ALL
from geofem.methods.mpm.model import ExplicitMpm
from geofem.scene import Box, Load, Material, Probe, Region, Scene, Support

Array = np.ndarray
SOLID = [("cpdi", "usl")]


def everywhere(x: Array) -> Array:
    return np.ones(x.shape[1], bool)


def at_mid_step(model: ExplicitMpm) -> float:
    """Energy told for the middle of the last step over that at its end, where the strain grows with time: less half of the work
    of the last step, by the stresses before it."""
    d = model._last_dt / model.t
    return 1 - d + d**2


# --- space --------------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("shape, scheme", SOLID)
def test_patch_in_space(shape: str, scheme: str) -> None:
    """All nodes driven by x = (I + t A) X: every point has F = I + A at the end, and the stress of neo-Hookean rubber.

    The grid moves as v = A X, a field of the reference position, at the nodes; with x for X it is A F^-1 x, which the supports
    do not know: F is met to the square of A.
    """
    A = 0.01 * np.array([[1.0, 2.0, 0.0], [0.0, -1.0, 1.0], [0.5, 0.0, 0.5]])
    E, nu = 1e6, 0.3
    supports = tuple(Support(f"all_{c}", everywhere, (c,), lambda x, t, c=c: t / 0.01 * (A @ x)[c]) for c in range(3))
    scene = Scene(
        name="patch", regions=(Region("b", Box((0.0,) * 3, (1.0,) * 3), Material("neo_hooke", 1000.0, {"E": E, "nu": nu})),),
        length=1.0, supports=supports, plane="solid", dynamic=True, t_end=0.01,
    )  # fmt: skip
    model = finish(build(scene, shape, n=3, scheme=scheme))
    F = model.bodies[0].own("F").reshape(-1, 3, 3)
    exact = np.eye(3) + A
    assert np.abs(F - exact).max() < 0.6 * np.abs(A @ A).max() + 1e-12 * 3
    # affine: all points alike
    assert np.ptp(F, axis=0).max() < 1e-12
    stress = model.snapshot()["stress"]
    assert np.ptp(stress, axis=0).max() < 1e-9 * E
    e = 0.5 * (A + A.T)
    lam, mu = E * nu / (1 + nu) / (1 - 2 * nu), E / 2 / (1 + nu)
    small = lam * np.trace(e) * np.eye(3) + 2 * mu * e
    for k, (i, j) in enumerate([(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2)]):
        assert stress[0, k] == pytest.approx(small[i, j], abs=5 * E * np.abs(A).max() ** 2)
    assert model.energy()["internal"] == pytest.approx(0.5 * np.sum(small * e) * at_mid_step(model), rel=0.03)


@pytest.mark.parametrize("shape, scheme", SOLID)
def test_column_in_space_is_a_bar(shape: str, scheme: str) -> None:
    """nu = 0: a free column on its base swings under gravity as in one dimension: the top moves by -g t^2 / 2 until the wave has
    come from the base, t = H / c, and all of it is the same across the width."""
    E, rho, H, g = 1e6, 1000.0, 2.0, 10.0
    c = np.sqrt(E / rho)
    scene = Scene(
        name="column", regions=(Region("b", Box((0.0,) * 3, (0.5, 0.5, H)), Material("neo_hooke", rho, {"E": E, "nu": 0.0})),),
        length=H, supports=(Support("base", lambda x: x[2] <= 0, (2,)),), loads=(Load("gravity", (0.0, 0.0, -g)),), plane="solid",
        dynamic=True, t_end=2 * H / c, probes=(Probe("top", "displacement", (0.25, 0.25, H), 2),),
    )  # fmt: skip
    model, t, u = run(scene, shape, n=8, scheme=scheme, ppc=1 if shape == "cpdi" else 2)
    early = t < 0.5 * H / c  # the grid's waves run ahead by a cell or two of H / 8
    assert u[early] == pytest.approx(-0.5 * g * t[early] ** 2, rel=0.03, abs=1e-4)
    # the top turns at t = 2 H / c with twice the static settlement, g H^2 / c^2 in all; ends are of first order
    assert u[-1] == pytest.approx(-g * H**2 / c**2, rel=0.08)
    snapshot = model.snapshot()
    assert np.abs(snapshot["displacement"][:, :2]).max() < 2e-3 * abs(u[-1])
    body = model.bodies[0]
    levels = np.round(body.own("X")[:, 2], 6)
    for level in np.unique(levels):
        # alike but for corner nodes that are joined to a neighbour
        assert np.ptp(body.own("x")[levels == level, 2]) < 1e-4 * abs(u[-1])
    assert model.checks()["momentum"] < 1e-12


# --- axial symmetry -----------------------------------------------------------------------------------------------------------
AXIAL = [("gimp", "usl")]


def cylinder(a: float, b: float, **changes: Any) -> Scene:
    keywords: dict[str, Any] = {
        "regions": (Region("b", Box((a, 0.0), (b, 0.5)), Material("neo_hooke", 1000.0, {"E": 1e6, "nu": 0.3})),),
        "supports": (Support("ends", everywhere, (1,)),),
        "loads": (NOTHING,),
    }
    return Scene(name="cylinder", length=1.0, plane="axisymmetric", **(keywords | changes))


@pytest.mark.parametrize("shape, scheme", AXIAL)
def test_hydrostatic_stress_is_in_balance_inside(shape: str, scheme: str) -> None:
    """Nodal forces of a uniform pressure vanish inside: int (grad S . sigma + S sigma_theta / r) r dA = 0 there, to the quadrature's
    second order; at the inner radius r and the outer they are -p r times the height of a node."""
    errors = []
    for n in (4, 8):
        model = build(cylinder(1.0, 3.0), shape, n=n, scheme=scheme)
        body = model.bodies[0]
        body.own("tau")[:, :3] = -1e3
        model.stepper._marks[:, g.BOX : g.BOX + 6 : 2] = g.FAR
        model.stepper._scatter(ALL)
        f = model.grid.nodes[:, 3:5]
        x, y = model.grid.coordinates()
        h = model.h
        inside = (x > 1 + 1.5 * h) & (x < 3 - 1.5 * h) & (y > 1.5 * h) & (y < 0.5 - 1.5 * h) if n == 8 else None
        scale = 1e3 * h * 2.0
        if inside is not None:
            assert inside.any() and np.abs(f[inside]).max() < 1e-9 * scale
        errors.append(abs(f[(x < 2)].sum(axis=0)[0] + 1e3 * 1.0 * 0.5 - 0.0) / 500.0)
        total = f.sum(axis=0)
        # the whole: -p (b - a) L from the hoop, which the pressure on the two faces would hold: p (b - a) L
        assert total[0] == pytest.approx(1e3 * 2.0 * 0.5, rel=1e-12)
        assert total[1] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("shape, scheme", AXIAL)
def test_uniform_radial_expansion(shape: str, scheme: str) -> None:
    """u = e r: the hoop stretch is the radial one, and the stress that of the same plane stretch at all radii."""
    e = 1e-3
    drive = Support("drive", everywhere, (0,), lambda x, t: e * t / 0.01 * x[0])
    scene = cylinder(0.0, 1.0, supports=(Support("ends", everywhere, (1,)), drive), dynamic=True, t_end=0.01)
    model = finish(build(scene, shape, n=4, scheme=scheme))
    F = model.bodies[0].own("F")
    assert F[:, 0] == pytest.approx(1 + e, abs=2 * e**2) and F[:, 4] == pytest.approx(1 + e, abs=2 * e**2)
    assert np.ptp(F[:, 4] - F[:, 0]) < 1e-10 and np.abs(F[:, 1:4] - [0, 0, 1]).max() < 1e-12
    lam, mu = 1e6 * 0.3 / 1.3 / 0.4, 1e6 / 2.6
    stress = model.snapshot()["stress"]
    assert stress[:, 0] == pytest.approx(2 * (lam + mu) * e, rel=0.01) and stress[:, 2] == pytest.approx(stress[:, 0], rel=1e-6)
    assert stress[:, 1] == pytest.approx(2 * lam * e, rel=0.01)
    # per radian: 1/2 sigma : eps times half the area of the disc times its height
    assert model.energy()["internal"] == pytest.approx((lam + mu) * 2 * e**2 * 0.25 * at_mid_step(model), rel=0.02)
    assert model.checks()["volume"] == pytest.approx(2 * e, rel=0.01)
    assert model.checks()["mass"] < 1e-14 and model.checks()["momentum"] < 1e-10


@pytest.mark.parametrize("shape, scheme", AXIAL)
def test_spun_thick_cylinder(shape: str, scheme: str) -> None:
    """A body force b r outwards on a hollow cylinder 1 <= r <= 2 in plane strain, free within and without, at rest (Timoshenko &
    Goodier 1970, art. 32 with E, nu of plane strain): hoop and radial stress in the middle within 3 %."""
    a, b, w = 1.0, 2.0, 3.0  # w: force per mass and radius, (rad/s)^2
    load = Load("body", lambda x, t: np.stack([w * x[0], 0 * x[0]]))
    scene = cylinder(
        a, b, loads=(load,),
        probes=(Probe("rr", "stress", (1.5, 0.25), 0), Probe("hoop", "stress", (1.5, 0.25), 2), Probe("u", "displacement", (1.5, 0.25), 0)),
    )  # fmt: skip
    model, _, _ = run(scene, shape, n=12, scheme=scheme, tolerance=1e-6)
    nu, rho = 0.3 / 0.7, 1000.0  # of plane strain
    r = 1.5
    radial = (3 + nu) / 8 * rho * w * (a**2 + b**2 - a**2 * b**2 / r**2 - r**2)
    hoop = (3 + nu) / 8 * rho * w * (a**2 + b**2 + a**2 * b**2 / r**2 - (1 + 3 * nu) / (3 + nu) * r**2)
    E = 1e6 / (1 - 0.3**2)
    rr, tt, u = (model.probe(probe) for probe in scene.probes)
    assert tt == pytest.approx(hoop, rel=0.03) and rr == pytest.approx(radial, abs=0.03 * hoop)
    assert u == pytest.approx(r * (hoop - nu * radial) / E, rel=0.03)
