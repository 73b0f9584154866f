"""Materials at finite strain: tangents, objectivity, energies, exact solutions, and the UFL twins of the kernels."""

from __future__ import annotations

import math

import numpy as np
import pytest
import ufl
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit
from test_materials import NU, PAIRS, PLASTIC, E, difference_error, small, yield_function
from test_materials import PARAMETERS as SMALL
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives

from geofem import materials
from geofem.materials import ufl_energy
from geofem.materials.kinematics import matrices
from geofem.mistake import Mistake
from geofem.scene import Material

PARAMETERS = SMALL | {"hencky": {"E": E, "nu": NU}, "neo_hooke": {"E": E, "nu": NU}, "newtonian": {"mu": 1.0, "K": E}}
HYPERELASTIC = ["linear_elastic", "hencky", "neo_hooke"]
UNIT = {5: np.array([1.0, 0.0, 0.0, 1.0, 1.0]), 9: np.eye(3).ravel()}
POINTS = 1500


def vector(law, **changes):
    return materials.get(law).parameters(Material(law, 0.0, PARAMETERS[law] | changes))


def finite(law, F, F_old, state, par, dt=0.1):
    """(P, A, new_state, number of plastic points or -1 - i)."""
    n, g = F.shape
    P, A, new = np.empty((n, g)), np.empty((n, g, g)), np.zeros_like(state)
    return P, A, new, materials.get(law).finite(F, F_old, state, par, dt, P, A, new)


def flat(full, g):
    """Tensors (n, 3, 3) as vectors (n, g)."""
    return full.reshape(-1, 9)[:, [0, 1, 3, 4, 8] if g == 5 else range(9)].copy()


def motion(law, g, n=POINTS, seed=0):
    """Deformation gradients F after F_old, a random elastic state at F_old, and the parameters.

    F_old is far from the identity, the step a few yield strains.
    """
    random = np.random.default_rng(seed)
    kernels = materials.get(law)
    state = kernels.initial_state(n, 4 if g == 5 else 6)
    state += random.normal(size=state.shape) * 5e-4
    F_old = UNIT[g] + random.normal(size=(n, g)) * 0.12
    return F_old + random.normal(size=(n, g)) * 2e-3, F_old, state, vector(law)


@pytest.mark.parametrize("g", [5, 9])
@pytest.mark.parametrize("law", PARAMETERS)
def test_finite_tangent_is_the_derivative_of_the_stress(law, g):
    """1e-7: rounding, 1e-16 P / (E step) with P up to E / 3, and curvature, (step / distance between principal strains)^2,
    stay below 2e-8 together at this step."""
    F, F_old, state, par = motion(law, g)
    _, A, _, plastic = finite(law, F, F_old, state, par)
    assert law not in PLASTIC or 0.3 * POINTS < plastic <= POINTS
    assert difference_error(lambda x: finite(law, x, F_old, state, par)[:2], A, F, 3e-8) < 1e-7


@pytest.mark.parametrize("g", [5, 9])
@pytest.mark.parametrize("law", [*PLASTIC, "hencky"])
def test_finite_tangent_is_right_where_stretches_meet(law, g):
    """Equal stretches to within 0, 1e-12, 1e-9, 1e-6 and 1e-3, elastic and plastic."""
    state, par = materials.get(law).initial_state(1, 4 if g == 5 else 6), vector(law)
    for stretches in ((1.0, 1.0, 1.0), (0.999, 1.0018, 0.999), (1.0015, 1.0, 1.0015), (1.0015, 1.0015, 1.0)):
        for gap in (0.0, 1e-12, 1e-9, 1e-6, 1e-3):
            F = flat(np.diag(np.array(stretches) * [1.0, 1.0 + gap, 1.0 - gap])[None], g)
            A = finite(law, F, UNIT[g][None], state, par)[1]
            error = difference_error(lambda x: finite(law, x, UNIT[g][None], state, par)[:2], A, F, 1e-8)
            assert error < 1e-6  # rounding of a shorter step, 1e-16 / 1e-8, times a few operations


@settings(max_examples=25, deadline=None)
@given(st.floats(-math.pi, math.pi), st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda a: np.linalg.norm(a) > 0.1))
@pytest.mark.parametrize("law", [law for law in PARAMETERS if law != "linear_elastic"])
def test_stress_turns_with_the_material(law, angle, axis):
    """Objectivity: P(Q F) = Q P(F) and b_e turns alike, for any rotation Q after the step. Rounding of E x strain."""
    for g in (5, 9):
        F, F_old, state, par = motion(law, g, n=20)
        x, y, z = (0.0, 0.0, 1.0) if g == 5 else np.array(axis) / np.linalg.norm(axis)
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        Q = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross  # Rodrigues 1840
        P, _, new, plastic = finite(law, F, F_old, state, par)
        turned, _, new_turned, plastic_turned = finite(law, flat(Q @ matrices(F), g), F_old, state, par)
        assert np.abs(matrices(turned) - Q @ matrices(P)).max() < 1e-12 * E
        assert plastic == plastic_turned
        if state.size:
            assert np.abs(elastic_b(new_turned) - Q @ elastic_b(new) @ Q.T).max() < 1e-13


def elastic_b(state):
    b = np.zeros((len(state), 3, 3)) + np.eye(3)
    for k, (i, j) in enumerate(PAIRS[: state.shape[1]]):
        b[:, i, j] = b[:, j, i] = state[:, k] + (i == j)
    return b


@pytest.mark.parametrize("law", ["hencky", "neo_hooke", *PLASTIC, "newtonian"])
def test_cauchy_stress_is_symmetric(law):
    for g in (5, 9):
        F, F_old, state, par = motion(law, g)
        tau = matrices(finite(law, F, F_old, state, par)[0]) @ np.swapaxes(matrices(F), 1, 2)
        assert np.abs(tau - np.swapaxes(tau, 1, 2)).max() < 1e-14 * E  # rounding of a stress of about E


@pytest.mark.parametrize("g", [5, 9])
@pytest.mark.parametrize("law", HYPERELASTIC)
def test_stress_is_the_derivative_of_the_energy(law, g):
    """Central differences with a step of 1e-5: step^2 and rounding / step, 1e-10 E both, times up to 5."""
    F, F_old, state, par = motion(law, g, n=300)
    energy = materials.get(law).energy
    P = finite(law, F, F_old, state, par)[0]
    step = 1e-5
    for j in range(g):
        move = np.zeros(g)
        move[j] = step
        slope = (energy(F + move, par) - energy(F - move, par)) / (2 * step)
        assert np.abs(slope - P[:, j]).max() < 5e-9 * E


@pytest.mark.parametrize("g", [5, 9])
@pytest.mark.parametrize("law", PLASTIC)
def test_path_of_finite_strain_stays_on_the_yield_surface_and_dissipates(law, g):
    """The Kirchhoff stress stays admissible (1e-11: rounding of the return), and the plastic part of each step,
    tau : (e_trial - e) in logarithmic elastic strains, dissipates (Simo 1992)."""
    m, n = (4, 400) if g == 5 else (6, 400)
    random = np.random.default_rng(5)
    par, state, F_old = vector(law), materials.get(law).initial_state(n, m), np.tile(UNIT[g], (n, 1))
    for _ in range(20):
        step = np.eye(3) + matrices(random.normal(size=(n, g)) * 2e-3)
        if g == 5:
            step[:, 2, 2] = 1.0
        F = flat(step @ matrices(F_old), g)
        P, _, new, _ = finite(law, F, F_old, state, par)
        full = matrices(P) @ np.swapaxes(matrices(F), 1, 2)
        tau = np.stack([full[:, i, j] for i, j in PAIRS[:m]], axis=1)
        outside, size = yield_function(law, tau, par)
        assert np.max(outside / size) < 1e-11
        trial = step @ elastic_b(state) @ np.swapaxes(step, 1, 2)
        lost = logarithm(trial) - logarithm(elastic_b(new))
        assert (full * lost).sum((1, 2)).min() > -1e-12  # rounding of stress (10 Pa) x strain
        F_old, state = F, new
    assert np.abs(F_old - UNIT[g]).max() > 0.02


def logarithm(b):
    """ln(b) / 2."""
    values, axes = np.linalg.eigh(b)
    return axes @ (0.5 * np.log(values)[:, :, None] * np.swapaxes(axes, 1, 2))


@pytest.mark.parametrize("law", ["linear_elastic", "hencky", "neo_hooke", *PLASTIC])
def test_finite_strain_tends_to_small_strain(law):
    """P(I + t H) = sigma(t sym H) + O(t^2): the error falls with t^2; the strength is scaled with t so that flow goes on."""
    H = np.random.default_rng(6).normal(size=(200, 9))
    strain = np.stack([H[:, 3 * i + j] + (H[:, 3 * j + i] if i != j else 0.0) for i, j in PAIRS], axis=1)
    errors = []
    for t in (1e-4, 1e-5):
        par = vector(law, **{name: 500.0 * t for name in ("k", "c") if name in PARAMETERS[law]})
        twin = law if law in SMALL else "linear_elastic"
        state = materials.get(law).initial_state(200, 6)
        sigma, _, _, plastic = small(twin, t * strain, np.zeros((200, 6)), par)
        P = finite(law, UNIT[9] + t * H, np.tile(UNIT[9], (200, 1)), state, par)[0]
        assert law not in PLASTIC or plastic > 50
        errors.append(np.abs(P[:, [0, 4, 8, 1, 5, 2]] - sigma).max() / E)
    assert errors[1] < 1e-8
    assert errors[1] < 0.02 * errors[0] or errors[0] < 1e-15  # t^2 would be 0.01


@pytest.mark.parametrize("g", [5, 9])
@pytest.mark.parametrize("law", PARAMETERS)
def test_point_kernel_agrees_with_the_batch_kernel(law, g):
    """tau = P F^T (linear elasticity, which knows one configuration: tau = P), and the same new state. To rounding: the
    compiler inlines the law into each and may order its sums anew."""
    point = materials.get(law).point

    @njit(cache=True)
    def loop(F, F_old, state, par, dt, tau, new):
        plastic = 0
        for n in range(len(F)):
            plastic += point(F[n], F_old[n], state[n], par, dt, tau[n], new[n])
        return plastic

    F, F_old, state, par = motion(law, g)
    P, _, new, plastic = finite(law, F, F_old, state, par)
    tau, new_point = np.empty((POINTS, 4 if g == 5 else 6)), np.zeros_like(state)
    assert loop(F, F_old, state, par, 0.1, tau, new_point) == plastic
    full = matrices(P) @ np.swapaxes(matrices(F), 1, 2) if law != "linear_elastic" else matrices(P)
    assert np.abs(np.stack([full[:, i, j] for i, j in PAIRS[: tau.shape[1]]], axis=1) - tau).max() < 1e-14 * E
    assert np.allclose(new, new_point, rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("g", [5, 9])
@pytest.mark.parametrize("law", PARAMETERS)
def test_inverted_point_is_named(law, g):
    """The first point with det F <= 0; Hooke's law, geometrically linear, takes any deformation."""
    F, F_old, state, par = motion(law, g, n=5)
    F[3:, : 2 if g == 5 else 3] *= -1.0  # the first row: det F < 0
    assert finite(law, F, F_old, state, par)[3] == (0 if law == "linear_elastic" else -4)
    tau, new = np.zeros(4 if g == 5 else 6), np.zeros(state.shape[1])
    assert materials.get(law).point(F[3], F_old[3], state[3], par, 0.1, tau, new) == (0 if law == "linear_elastic" else -1)
    F[3] = np.nan
    assert finite(law, F, F_old, state, par)[3] == (0 if law == "linear_elastic" else -4)


@pytest.mark.parametrize("g", [5, 9])
@pytest.mark.parametrize("law", ["neo_hooke", "tresca"])
def test_push_gives_stress_and_tangent_on_the_intermediate_configuration(law, g):
    """P_n = P Fn^T / det Fn as a function of f, F = f Fn, and A_n its derivative by f. 1e-7: see the tangent test."""
    F, Fn, state, par = motion(law, g, n=500)
    f = flat(matrices(F) @ np.linalg.inv(matrices(Fn)), g)

    def pushed(f):
        P, A, _, _ = finite(law, flat(matrices(f) @ matrices(Fn), g), Fn, state, par)
        materials.get(law).push(P, A, Fn)
        return P, A

    P_n, A_n = pushed(f)
    expected = matrices(finite(law, F, Fn, state, par)[0]) @ np.swapaxes(matrices(Fn), 1, 2)
    expected /= np.linalg.det(matrices(Fn))[:, None, None]
    assert np.abs(matrices(P_n) - expected).max() < 1e-13 * E
    assert difference_error(pushed, A_n, f, 3e-8) < 1e-7


# --- exact solutions --------------------------------------------------------------------------------------------------------
def test_hencky_stress_of_a_stretched_bar():
    """tau = 2 G ln(stretch) + lambda ln J along each axis, for stretches far from 1."""
    stretch = np.array([2.0, 0.7, 1.1])
    lam, G = vector("hencky")
    P = finite("hencky", np.diag(stretch).reshape(1, 9), UNIT[9][None], np.zeros((1, 0)), np.array([lam, G]))[0]
    exact = (2 * G * np.log(stretch) + lam * np.log(stretch.prod())) / stretch
    assert np.allclose(np.diag(P.reshape(3, 3)), exact, rtol=1e-14)


def test_von_mises_in_isochoric_plane_strain_carries_exactly_its_shear_strength():
    """Pure shear, stretches s and 1/s: whatever the steps, tau = +k, -k, 0 once it flows; and as much in reverse."""
    par, state, old = vector("von_mises"), np.zeros((1, 4)), 1.0
    for s in (1.5, 3.0, 2.9, 1.0, 0.2):
        F, F_old = (np.array([[a, 0.0, 0.0, 1 / a, 1.0]]) for a in (s, old))
        P, _, state, plastic = finite("von_mises", F, F_old, state, par)
        assert plastic == 1
        k = math.copysign(1.0, s - old)
        assert np.allclose(P[0] * F[0], [k, 0.0, 0.0, -k, 0.0], atol=1e-14 * E)  # rounding of E x logarithmic strain
        old = s


def test_newtonian_fluid_in_simple_shear_and_in_rigid_rotation():
    """Shear stress = viscosity x shear rate, exactly, for any step of simple shear; none in a rotation; p = K (1/J - 1)."""
    mu, K, dt = 3.0, 50.0, 0.2
    for g in (5, 9):
        par, state, unit = vector("newtonian", mu=mu, K=K), np.zeros((1, 0)), UNIT[g][None]
        shear = np.array([[[1.0, 0.4, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]])
        tau = matrices(finite("newtonian", flat(shear, g), unit, state, par, dt)[0]) @ shear.swapaxes(1, 2)
        assert tau[0, 0, 1] == pytest.approx(mu * 0.4 / dt, rel=1e-14)
        c, s, J = math.cos(2.0), math.sin(2.0), 1.1
        turn = np.array([[[c, -s, 0], [s, c, 0], [0, 0, 1.0]]])
        F = turn * J ** (1 / 3)
        tau = matrices(
            finite("newtonian", flat(F, g), flat(np.eye(3)[None] * J ** (1 / 3), g), state, par, dt)[0]
        ) @ F.swapaxes(1, 2)
        assert np.allclose(tau, -J * K * (1 / J - 1) * np.eye(3), atol=1e-12 * K)


def test_elastic_energy_of_the_state_is_that_of_hencky():
    """As long as nothing flows, the energy stored in b_e is the energy of the deformation, after any number of steps."""
    for g, m in ((5, 4), (9, 6)):
        par = vector("von_mises", k=1e9)
        state, F_old = np.zeros((50, m)), np.tile(UNIT[g], (50, 1))
        for seed in range(5):
            F = F_old + np.random.default_rng(seed).normal(size=(50, g)) * 0.03
            _, _, state, plastic = finite("von_mises", F, F_old, state, par)
            assert plastic == 0
            F_old = F
        stored = materials.get("von_mises").elastic_energy(state, par, m, True)
        assert np.allclose(stored, materials.get("hencky").energy(F, par), rtol=1e-11)


# --- UFL twins --------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("law", ["linear_elastic", "neo_hooke"])
def test_ufl_energy_is_the_kernels_energy(law):
    """Energy and stress at random deformations; the mixed energy at its stationary p, and with lambda infinite."""
    lam, G = par = vector(law)
    for F in UNIT[9] + np.random.default_rng(8).normal(size=(5, 1, 9)) * 0.15:
        tensor = ufl.variable(ufl.as_matrix(F.reshape(3, 3).tolist()))
        expression = ufl_energy.energy(law, tensor, lam, G)
        value = materials.get(law).energy(F, par)[0]
        assert apply_algebra_lowering(expression)(()) == pytest.approx(value, rel=1e-12)
        P = apply_derivatives(apply_algebra_lowering(ufl.diff(expression, tensor)))
        stress = [P[i, j](()) for i in range(3) for j in range(3)]
        assert np.allclose(stress, finite(law, F, UNIT[9][None], np.zeros((1, 6)), par)[0][0], atol=1e-12 * E)
        volume = np.trace(F.reshape(3, 3)) - 3 if law == "linear_elastic" else np.log(np.linalg.det(F.reshape(3, 3)))
        mixed = ufl_energy.energy_mixed(law, tensor, lam * volume, 1 / lam, G)
        assert apply_algebra_lowering(mixed)(()) == pytest.approx(value, rel=1e-12)
        limit = ufl_energy.energy_mixed(law, tensor, 7.0, 0.0, G)
        assert apply_algebra_lowering(limit)(()) == pytest.approx(value - 0.5 * lam * volume**2 + 7.0 * volume, rel=1e-10)


def test_ufl_energy_of_a_law_without_one_is_a_mistake():
    with pytest.raises(Mistake, match="'hencky'"):
        ufl_energy.energy("hencky", ufl.Identity(3), 1.0, 1.0)
