"""Materials that flow: the mu(I) rheology, the gap that cohesionless material leaves, and the fluid's equation of state."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit
from test_materials import NU, PAIRS, E, difference_error
from test_materials_finite import UNIT, elastic_b, flat, logarithm

from geofem import materials
from geofem.materials.kinematics import matrices
from geofem.mistake import Mistake
from geofem.scene import Material

GRAINS = {"E": E, "nu": NU, "mu_s": 0.38, "mu_2": 0.64, "I_0": 0.28, "d": 0.01, "rho_s": 2.0}
SAND = {"E": E, "nu": NU, "c": 0.0, "phi": 30.0, "gap": 1.0}
WATER = {"mu": 1.0, "K": E, "gamma": 7.0, "cavitation": 0.0}
MUD = WATER | {"tau_y": 20.0, "m": 5.0}
PARAMETERS = {"mu_i": GRAINS, "drucker_prager": SAND, "mohr_coulomb": SAND, "newtonian": WATER, "bingham": MUD}
TENSIONLESS = ["mu_i", "drucker_prager", "mohr_coulomb"]
BULK = E / (3 * (1 - 2 * NU))
G = 0.5 * E / (1 + NU)


def vector(law, **changes):
    return materials.get(law).parameters(Material(law, 0.0, PARAMETERS[law] | changes))


def finite(law, F, F_old, state, dt=0.1, par=None):
    """(Kirchhoff stress (N, 3, 3), P, A, new_state, number of plastic points)."""
    n, g = F.shape
    P, A, new = np.empty((n, g)), np.empty((n, g, g)), np.zeros_like(state)
    plastic = materials.get(law).finite(F, F_old, state, vector(law) if par is None else par, dt, P, A, new)
    return matrices(P) @ np.swapaxes(matrices(F), 1, 2), P, A, new, plastic


def start(law, g, n=1):
    """(F, state) without deformation."""
    return np.tile(UNIT[g], (n, 1)), materials.get(law).initial_state(n, 4 if g == 5 else 6)


def diagonal(x, y, z, g):
    return flat(np.diag([x, y, z])[None], g)


def squeezed(law, g, n, seed=0, strain=2e-3):
    """(F, F_old, state): points under pressures of up to 10 strain K, then sheared by steps of about ``strain``."""
    random = np.random.default_rng(seed)
    m = 4 if g == 5 else 6
    state = np.zeros((n, m))
    state[:, :3] = -10 * strain * random.uniform(0.02, 1.0, size=(n, 1))
    state[:, 3:] = strain * random.normal(size=(n, m - 3))
    F_old = UNIT[g] + random.normal(size=(n, g)) * 0.12
    return F_old + random.normal(size=(n, g)) * strain, F_old, state


def invariants(tau):
    """(p, sqrt(J2)) of stresses (N, 3, 3)."""
    mean = np.trace(tau, axis1=1, axis2=2) / 3
    return -mean, np.sqrt(0.5 * ((tau - mean[:, None, None] * np.eye(3)) ** 2).sum((1, 2)))


def friction(rate, p, law=GRAINS):
    """mu(I) from the paper's formula."""
    inertial = rate * law["d"] / np.sqrt(np.maximum(p, 1e-300) / law["rho_s"])
    return law["mu_s"] + (law["mu_2"] - law["mu_s"]) / (1 + law["I_0"] / np.maximum(inertial, 1e-300))


# --- what is refused --------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("law", "changes", "message"),
    [
        ("mu_i", {"mu_s": 0.0}, "mu_s = 0 must be positive"),
        ("mu_i", {"mu_2": 0.3}, "mu_2 = 0.3 must not be below mu_s = 0.38"),
        ("mu_i", {"I_0": -1.0}, "I_0 = -1 must be positive"),
        ("mu_i", {"d": 0.0}, "d = 0 m must be positive"),
        ("mu_i", {"rho_s": 0.0}, "rho_s = 0 kg/m3 must be positive"),
        ("mu_i", {"mu_x": 0.0}, "unknown parameter of mu_i"),
        ("drucker_prager", {"gap": 0.5}, "gap = 0.5 must be 0 or 1"),
        ("mohr_coulomb", {"c": 1.0}, "gap = 1 is for materials without cohesion"),
        ("newtonian", {"gamma": 0.0}, "gamma = 0 must be positive"),
        ("newtonian", {"cavitation": 1.0}, "cavitation = 1 Pa must not be positive"),
        ("newtonian", {"cavitation": -math.inf}, "cavitation = -inf must be a finite number"),
        ("newtonian", {"surface_tension": -1.0}, "surface_tension = -1 N/m must not be negative"),
        ("newtonian", {"tau_y": 1.0}, "unknown parameter of newtonian"),
        ("bingham", {"tau_y": -1.0}, "tau_y = -1 Pa must not be negative"),
        ("bingham", {"m": -1.0}, "m = -1 s must not be negative"),
    ],
)
def test_bad_flow_material_is_a_mistake(law, changes, message):
    with pytest.raises(Mistake, match=message):
        materials.check(Material(law, 0.0, PARAMETERS[law] | changes), "heap")


def test_sound_flow_materials_pass():
    for law, parameters in PARAMETERS.items():
        materials.check(Material(law, 1500.0, parameters), "heap")
    materials.check(Material("newtonian", 1000.0, {"mu": 0.0, "K": 1e6}), "water, defaults left out")


# --- mu(I) ------------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("g", [5, 9])
@pytest.mark.parametrize("dt", [1e-4, 0.1, 1e6])
def test_mu_i_tangent_is_the_derivative_of_the_stress(g, dt):
    """Elastic, flowing and open points, from fast to slow flow. 1e-6: rounding, 1e-16 P / (E step), is 4e-8; the curvature is that
    of a cone, (step / elastic strain)^2, and a point whose pressure has all but gone has 1e-7 of it."""
    F, F_old, state = squeezed("mu_i", g, 1500)
    state[:200, :3] += 0.01
    tau, _, A, _, plastic = finite("mu_i", F, F_old, state, dt)
    open_ = np.all(tau == 0.0, axis=(1, 2)).sum()
    assert 20 < open_ < plastic - 200 and plastic < 1450
    assert difference_error(lambda x: finite("mu_i", x, F_old, state, dt)[1:3], A, F, 1e-8) < 1e-6


@settings(max_examples=50, deadline=None, derandomize=True)
@given(st.floats(-8, 4), st.floats(-4, -2), st.floats(0.38, 2.0), st.floats(0.01, 1.0))
def test_mu_i_friction_is_that_of_the_plastic_shear_rate(log_dt, log_strain, high, I_0):
    """q = mu(I) p to rounding (1e-12), I from the plastic strain of the step itself: what the deviator of the logarithmic
    elastic strain lost, through 8 decades of the rate; points below mu_s p are elastic."""
    dt, law = 10.0**log_dt, GRAINS | {"mu_2": high, "I_0": I_0}
    F, F_old, state = squeezed("mu_i", 9, 100, strain=10.0**log_strain)
    par = vector("mu_i", mu_2=high, I_0=I_0)
    tau, _, _, new, plastic = finite("mu_i", F, F_old, state, dt, par)
    step = matrices(F) @ np.linalg.inv(matrices(F_old))
    trial = logarithm(step @ elastic_b(state) @ np.swapaxes(step, 1, 2))
    lost = trial - logarithm(elastic_b(new))
    closed = np.trace(trial, axis1=1, axis2=2) < 0
    p, q = invariants(tau)
    rate = np.sqrt(2 * (lost**2).sum((1, 2))) / dt
    limit = p * friction(rate, p, law)
    # The plastic strain is known to rounding of a strain of 1, which the slope of mu(I) p carries into the stress.
    slope = (high - law["mu_s"]) * p / np.maximum(rate * dt + I_0 / law["d"] * np.sqrt(np.maximum(p, 0) / 2) * dt, 1e-16)
    flows = closed & (rate * dt > 1e-13)
    assert 0 < flows.sum() <= plastic
    assert np.all(np.abs(q - limit)[flows] <= 1e-11 * p[flows] + 1e-14 * slope[flows] + 1e-15 * E)
    assert np.all((q <= law["mu_s"] * p * (1 + 1e-11) + 1e-15 * E)[closed & ~flows])
    assert np.all(np.abs(np.trace(lost, axis1=1, axis2=2)) < 1e-14)  # flow without change of volume


@pytest.mark.parametrize("g", [5, 9])
@pytest.mark.parametrize("rate", [0.01, 1.0, 100.0])
def test_mu_i_in_steady_simple_shear_has_the_friction_of_its_rate(g, rate):
    """Under a pressure p, sheared by 1 in steps of 1e-3: shear stress / p = mu(I) with I = rate d / sqrt(p / rho_s). The elastic
    strain, p / E = 1e-5, and the step turn the principal axes by as much: 1e-4 of the stress."""
    p = 1e-5 * E
    F, state = start("mu_i", g)
    F_old = F
    F = F * math.exp(-p / BULK / 3)
    _, _, _, state, _ = finite("mu_i", F, F_old, state)
    shear = np.eye(3)[None].copy()
    shear[0, 0, 1] = 1e-3
    for _ in range(1000):
        F, F_old = flat(shear @ matrices(F), g), F
        tau, _, _, state, plastic = finite("mu_i", F, F_old, state, 1e-3 / rate)
        assert plastic == 1
    assert invariants(tau)[0] == pytest.approx(p, rel=1e-9)
    assert invariants(tau)[1] / p == pytest.approx(friction(rate, p), rel=1e-4)
    assert tau[0, 0, 1] / p == pytest.approx(friction(rate, p), rel=1e-4)


def test_mu_i_flowing_infinitely_slowly_is_drucker_prager_without_dilation():
    """sqrt(J2) <= mu_s p: A = mu_s, k = 0, B = 0 in Drucker-Prager's parameters; and infinitely fast, with A = mu_2."""
    for dt, mu in ((1e30, GRAINS["mu_s"]), (1e-30, GRAINS["mu_2"])):
        cone = vector("drucker_prager")
        cone[2:5], cone[6] = (mu, 0.0, 0.0), 1.0 / G
        F, F_old, state = squeezed("mu_i", 9, 500)
        tau, _, A, new, plastic = finite("mu_i", F, F_old, state, dt)
        expected = finite("drucker_prager", F, F_old, state, dt, cone)
        assert np.abs(tau - expected[0]).max() < 1e-12 * E
        assert np.abs(new - expected[3]).max() < 1e-12
        if dt > 1.0:
            assert np.abs(A - expected[2]).max() < 1e-9 * E
            assert plastic == expected[4]


def test_mu_i_answers_hydrostatic_pressure_elastically():
    """tau = K ln J, whatever the rate, there and back."""
    F_old, state = start("mu_i", 9)
    for stretch in (0.99, 0.9, 0.95, 1.0):
        F = diagonal(stretch, stretch, stretch, 9)
        tau, _, _, state, plastic = finite("mu_i", F, F_old, state, 1e-3)
        assert plastic == 0
        assert np.allclose(tau, 3 * BULK * math.log(stretch) * np.eye(3), atol=1e-13 * E)
        F_old = F


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.floats(-math.pi, math.pi), st.sampled_from([5, 9]), st.integers(0, 100))
def test_mu_i_turns_with_the_material(angle, g, seed):
    """P(Q F) = Q P(F), and b_e turns alike; open points too. Rounding of E x strain."""
    F, F_old, state = squeezed("mu_i", g, 50, seed)
    state[:10, :3] += 0.01
    c, s = math.cos(angle), math.sin(angle)
    Q = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    _, P, _, new, plastic = finite("mu_i", F, F_old, state)
    _, turned, _, new_turned, plastic_turned = finite("mu_i", flat(Q @ matrices(F), g), F_old, state)
    assert np.abs(matrices(turned) - Q @ matrices(P)).max() < 1e-12 * E
    assert np.abs(elastic_b(new_turned) - Q @ elastic_b(new) @ Q.T).max() < 1e-13
    assert plastic == plastic_turned


@pytest.mark.parametrize("law", TENSIONLESS)
@pytest.mark.parametrize("g", [5, 9])
def test_random_path_dissipates(law, g):
    """tau : (e_trial - e) in logarithmic elastic strains is not negative, and the stored energy never more than the trial's."""
    m, n = (4, 400) if g == 5 else (6, 400)
    random = np.random.default_rng(5)
    par, (F_old, state) = vector(law), start(law, g, n)
    energy = materials.get(law).elastic_energy
    opened = flowed = 0
    for _ in range(20):
        step = np.eye(3) + matrices(random.normal(size=(n, g)) * 2e-3)
        if g == 5:
            step[:, 2, 2] = 1.0
        F = flat(step @ matrices(F_old), g)
        tau, _, _, new, plastic = finite(law, F, F_old, state)
        trial = step @ elastic_b(state) @ np.swapaxes(step, 1, 2)
        lost = logarithm(trial) - logarithm(elastic_b(new))
        assert (tau * lost).sum((1, 2)).min() > -1e-12  # rounding of stress (10 Pa) x strain
        full = trial - np.eye(3)
        trial_state = np.stack([full[:, i, j] for i, j in PAIRS[:m]], axis=1)
        shut = np.trace(logarithm(trial), axis1=1, axis2=2) <= 0
        assert np.all((energy(trial_state, par, m, True) - energy(new, par, m, True))[shut] > -1e-12)
        free = np.all(tau == 0.0, axis=(1, 2))
        assert np.all(energy(new, par, m, True)[free] < 1e-12)
        opened, flowed = opened + free.sum(), flowed + plastic - free.sum()
        F_old, state = F, new
    assert opened > 1000 and flowed > 1000


# --- the gap ----------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("law", TENSIONLESS)
@pytest.mark.parametrize("g", [5, 9])
def test_opened_material_resists_only_when_it_is_back_at_its_density(law, g):
    """Stretched along x, y and by shear to J = 1.5 in steps, no stress; then squeezed: none until J = 1, then K ln J
    if the last step is a squeeze from all sides."""
    F_old, state = start(law, g)
    energy = materials.get(law).elastic_energy
    for x, y in ((1.1, 1.0), (1.2, 1.05), (1.2, 1.25), (1.1, 1.1), (1.01, 1.0), (1.0, 1.0000001)):
        F = diagonal(x, y, 1.0, g)
        F[0, 1] = 0.3 * (x - 1.0)
        tau, _, A, state, plastic = finite(law, F, F_old, state)
        assert np.all(tau == 0.0) and np.all(A == 0.0) and plastic == 1
        J = np.linalg.det(matrices(F))[0]
        assert np.trace(logarithm(elastic_b(state))[0]) == pytest.approx(math.log(J), abs=1e-13)
        assert energy(state, vector(law), state.shape[1], True)[0] == 0.0
        F_old = F
    strain = -1e-3
    F = F * (math.exp(strain) / np.linalg.det(matrices(F))[0]) ** (1 / 3)
    tau, _, _, state, _ = finite(law, F, F_old, state)
    assert np.allclose(tau, BULK * strain * np.eye(3), atol=1e-12 * E)
    assert energy(state, vector(law), state.shape[1], True)[0] == pytest.approx(0.5 * BULK * strain**2, rel=1e-9)


@pytest.mark.parametrize("law", ["drucker_prager", "mohr_coulomb"])
def test_without_gap_the_law_is_as_ever(law):
    """gap = 0 forgets the opening: after the same stretch the first squeeze meets resistance; within the cone both agree."""
    par = vector(law, gap=0.0)
    F_old, state = start(law, 5)
    F = diagonal(1.2, 1.0, 1.0, 5)
    _, _, _, state, _ = finite(law, F, F_old, state, par=par)
    tau = finite(law, diagonal(1.19, 1.0, 1.0, 5), F, state, par=par)[0]
    assert invariants(tau)[0] > 1e-3 * E
    F, F_old, state = squeezed(law, 5, 500)
    with_gap, without = finite(law, F, F_old, state), finite(law, F, F_old, state, par=par)
    assert np.array_equal(with_gap[0], without[0]) and np.array_equal(with_gap[2], without[2])


@pytest.mark.parametrize("law", TENSIONLESS)
def test_point_at_rest_without_stress_answers_elastically(law):
    """The first tangent of a method that starts from rest is not zero."""
    F, state = start(law, 5)
    tau, _, A, new, plastic = finite(law, F, F, state)
    assert plastic == 0 and np.all(tau == 0.0) and np.all(new == 0.0)
    assert A[0, 0, 0] == pytest.approx(BULK + 4 / 3 * G, rel=1e-14)


# --- both kernels -----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("g", [5, 9])
@pytest.mark.parametrize("law", PARAMETERS)
def test_point_kernel_of_flow_agrees_with_the_batch_kernel(law, g):
    """Points closed and open; to rounding, as for the other laws."""
    point = materials.get(law).point

    @njit(cache=True)
    def loop(F, F_old, state, par, dt, tau, new):
        plastic = 0
        for n in range(len(F)):
            plastic += point(F[n], F_old[n], state[n], par, dt, tau[n], new[n])
        return plastic

    F, F_old, state = squeezed(law, g, 500)
    state = state[:, : materials.get(law).state_size(state.shape[1])].copy()
    state[:100, :3] += 0.01
    full, _, _, new, plastic = finite(law, F, F_old, state)
    tau, new_point = np.empty((500, 4 if g == 5 else 6)), np.zeros_like(state)
    assert loop(F, F_old, state, vector(law), 0.1, tau, new_point) == plastic
    assert np.abs(np.stack([full[:, i, j] for i, j in PAIRS[: tau.shape[1]]], axis=1) - tau).max() < 1e-13 * E
    assert np.allclose(new, new_point, rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("law", TENSIONLESS)
def test_plane_flow_is_the_solid_flow_without_shear_across(law):
    F, F_old, state = squeezed(law, 5, 500)
    state[:100, :3] += 0.01
    plane = finite(law, F, F_old, state)
    wide = np.pad(state, ((0, 0), (0, 2)))
    solid = finite(law, flat(matrices(F), 9), flat(matrices(F_old), 9), wide)
    keep = [0, 1, 3, 4, 8]
    assert np.abs(plane[0] - solid[0]).max() < 1e-13 * E
    assert np.abs(plane[2] - solid[2][:, keep][:, :, keep]).max() < 1e-9 * E
    assert np.abs(plane[3] - solid[3][:, :4]).max() < 1e-13
    assert plane[4] == solid[4]


def test_nan_stays_visible_in_flow():
    for law in PARAMETERS:
        point = materials.get(law).point
        for component in range(5):
            F, state = start(law, 5)
            bad, tau = F[0].copy(), np.zeros(4)
            bad[component] = np.nan
            assert point(bad, F[0], state[0], vector(law), 0.1, tau, np.zeros(state.shape[1])) == -1 or np.isnan(tau).any()


# --- the fluid's pressure ---------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("g", [5, 9])
@pytest.mark.parametrize(("gamma", "cavitation"), [(7.0, 0.0), (7.0, -50.0), (1.0, 0.0), (1.4, -1e9)])
def test_tangent_of_the_fluid_is_the_derivative_of_its_stress(g, gamma, cavitation):
    """With Tait's exponent, points that cavitate and points that do not. 1e-6: the seventh power is that much stiffer."""
    random = np.random.default_rng(3)
    par = vector("newtonian", gamma=gamma, cavitation=cavitation)
    F_old = UNIT[g] + random.normal(size=(500, g)) * 0.05
    F, state = F_old + random.normal(size=(500, g)) * 2e-3, np.zeros((500, 0))
    _, _, A, _, _ = finite("newtonian", F, F_old, state, 0.1, par)
    assert difference_error(lambda x: finite("newtonian", x, F_old, state, 0.1, par)[1:3], A, F, 1e-7) < 1e-6


@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.floats(0.5, 2.0), st.floats(0.5, 8.0), st.floats(-1000.0, 0.0))
def test_pressure_is_taits_and_never_below_cavitation(J, gamma, cavitation):
    """tau = -J p at rest; p = K / gamma (J^-gamma - 1), down to ``cavitation``. To rounding of the power and of K."""
    F = UNIT[9][None] * J ** (1 / 3)
    par = vector("newtonian", gamma=gamma, cavitation=cavitation)
    tau = finite("newtonian", F, F, np.zeros((1, 0)), 0.1, par)[0]
    p = max(E / gamma * (J**-gamma - 1.0), cavitation)
    assert np.allclose(tau[0], -J * p * np.eye(3), rtol=1e-13, atol=1e-13 * E)


def test_fluid_without_options_is_linear_in_the_density_and_carries_tension():
    par = materials.get("newtonian").parameters(Material("newtonian", 0.0, {"mu": 1.0, "K": E}))
    for J in (0.8, 1.0, 1.3):
        F = UNIT[9][None] * J ** (1 / 3)
        tau = finite("newtonian", F, F, np.zeros((1, 0)), 0.1, par)[0]
        assert np.allclose(tau[0], E * (J - 1.0) * np.eye(3), rtol=1e-13, atol=1e-13 * E)


def test_cavitating_fluid_stays_viscous():
    """The bound is on the pressure: a sheared spray still feels its viscosity."""
    F_old = UNIT[5][None] * np.array([1.2, 1.0, 1.0, 1.0, 1.0])
    F = F_old.copy()
    F[0, 1] = 0.1
    tau = finite("newtonian", F, F_old, np.zeros((1, 0)), 0.2)[0]
    assert tau[0, 0, 1] == pytest.approx(WATER["mu"] * 1.2 * 0.1 / 0.2, rel=1e-13)
    assert np.trace(tau[0]) == pytest.approx(0.0, abs=1e-12)


# --- the yield stress of a fluid --------------------------------------------------------------------------------------------
@pytest.mark.parametrize("g", [5, 9])
@pytest.mark.parametrize("m", [1e-6, 1.0, 100.0])
def test_tangent_of_a_bingham_fluid_is_the_derivative_of_its_stress(g, m):
    """From steps within the yield stress to fast flow. 3e-6: eta turns over within a rate of 1 / m, and 1e-8 / (dt / m) of it is seen."""
    random = np.random.default_rng(4)
    par = vector("bingham", m=m, gamma=1.0, cavitation=-1e9)
    F_old = UNIT[g] + random.normal(size=(500, g)) * 0.05
    step = random.normal(size=(500, g)) * np.geomspace(1e-4, 1e-1, 500)[:, None]
    F, state = F_old + step, np.zeros((500, 0))
    _, _, A, _, _ = finite("bingham", F, F_old, state, 0.5, par)
    assert difference_error(lambda x: finite("bingham", x, F_old, state, 0.5, par)[1:3], A, F, 1e-8) < 3e-6


@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.floats(1e-9, 1e3), st.floats(0.0, 1e3))
def test_bingham_fluid_bears_mu_g_and_its_yield_stress(rate, m):
    """In simple shear at the rate g: tau = mu g + tau_y (1 - exp(-m g)), for any step."""
    dt = 0.1
    F = UNIT[5][None] + np.array([0.0, rate * dt, 0.0, 0.0, 0.0])
    tau = finite("bingham", F, UNIT[5][None], np.zeros((1, 0)), dt, vector("bingham", m=m, cavitation=-1e9))[0]
    # the Almansi strain of a large shear has normal parts: its second invariant is not that of simple shear alone
    square = 0.5 * rate**4 * dt**2 * (2 / 3)
    g = math.hypot(rate, math.sqrt(square))
    eta = MUD["mu"] + MUD["tau_y"] * -math.expm1(-m * g) / g
    assert tau[0, 0, 1] == pytest.approx(eta * rate, rel=1e-10)
