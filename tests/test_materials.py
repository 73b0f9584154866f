"""Materials: what is refused, and the small-strain kernels against the theory of plasticity."""

from __future__ import annotations

import math
import os
import subprocess
import sys

import numpy as np
import pytest
from scipy.optimize import nnls

from geofem import materials
from geofem.mistake import Mistake
from geofem.scene import Material

E, NU = 1000.0, 0.3
PARAMETERS = {
    "linear_elastic": {"E": E, "nu": NU},
    "von_mises": {"E": E, "nu": NU, "k": 1.0},
    "tresca": {"E": E, "nu": NU, "c": 1.0},
    "mohr_coulomb": {"E": E, "nu": NU, "c": 1.0, "phi": 28.0, "psi": 11.0},
    "drucker_prager": {"E": E, "nu": NU, "c": 1.0, "phi": 28.0, "psi": 11.0},
}
PLASTIC = [law for law in PARAMETERS if law != "linear_elastic"]
PAIRS = [(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2)]


def vector(law, **changes):
    """The kernels' parameters of the law's test material, with changes."""
    return materials.get(law).parameters(Material(law, 0.0, PARAMETERS[law] | changes))


def small(law, dstrain, state, par):
    """(stress, tangent, new_state, number of plastic points)."""
    n, m = dstrain.shape
    stress, tangent, new = np.empty((n, m)), np.empty((n, m, m)), np.empty_like(state)
    return stress, tangent, new, materials.get(law).small(dstrain, state, par, stress, tangent, new)


def strains(n, m, seed, size=3e-3):
    """Random strain increments (n, m), a few times the yield strain in size; plane strain if m = 4."""
    de = np.random.default_rng(seed).normal(size=(n, m)) * size
    if m == 4:
        de[:, 2] = 0.0
    return de


def tensors(stress):
    """Stress vectors (n, m) as (n, 3, 3)."""
    full = np.zeros((len(stress), 3, 3))
    for k, (i, j) in enumerate(PAIRS[: stress.shape[1]]):
        full[:, i, j] = full[:, j, i] = stress[:, k]
    return full


def yield_function(law, stress, par):
    """How far stresses (n, m) lie outside the yield surface, and the stresses it is made of; from the textbooks' formulas."""
    s = np.linalg.eigvalsh(tensors(stress))[:, ::-1]
    mean = s.mean(1)
    root_j2 = np.sqrt(0.5 * ((s - mean[:, None]) ** 2).sum(1))
    if law == "von_mises":
        return root_j2 - PARAMETERS[law]["k"], root_j2
    if law == "drucker_prager":
        return root_j2 + par[2] * mean - par[4], root_j2 + np.abs(mean)
    c, phi = PARAMETERS[law]["c"], math.radians(PARAMETERS[law].get("phi", 0.0))
    return 0.5 * (s[:, 0] - s[:, 2]) + 0.5 * (s[:, 0] + s[:, 2]) * math.sin(phi) - c * math.cos(phi), np.abs(s).max(1) + c


def difference_error(answer, tangent, x, step):
    """Largest difference between tangent (n, g, g) and central differences of answer(x) -> (value, tangent), over E.

    Points within a step of a kink are left out: those whose own tangents at the two ends differ by more than 1e-3 E,
    where a smooth law's differ by about E step / yield strain = 1e-4 E or less. At most 1 % of the points may be.
    """
    error, kinked = np.zeros(len(x)), np.zeros(len(x), bool)
    for j in range(x.shape[1]):
        ends = [answer(x + sign * step * np.eye(x.shape[1])[j]) for sign in (1.0, -1.0)]
        slope = (ends[0][0] - ends[1][0]) / (2 * step)
        error = np.maximum(error, np.abs(slope - tangent[:, :, j]).max(1) / E)
        kinked |= np.abs(ends[0][1] - ends[1][1]).max((1, 2)) > 1e-3 * E
    assert kinked.mean() < 0.01
    return error[~kinked].max()


# --- what is refused --------------------------------------------------------------------------------------------------------
MC = PARAMETERS["mohr_coulomb"]


@pytest.mark.parametrize(
    ("material", "message"),
    [
        (Material("trecsa", 0.0, PARAMETERS["tresca"]), "unknown law .*soil.* 'trecsa': did you mean 'tresca'"),
        (Material("tresca", 0.0, {"E": 1.0, "nu": 0.3, "cu": 1.0}), "unknown parameter of tresca .* 'cu'"),
        (Material("tresca", 0.0, {"E": 1.0, "nu": 0.3}), "tresca lacks its parameter c "),
        (Material("hencky", 0.0, {"E": 0.0, "nu": 0.3}), "E = 0 Pa must be positive"),
        (Material("hencky", 0.0, {"E": math.nan, "nu": 0.3}), "E = nan must be a finite number"),
        (Material("hencky", 0.0, {"E": 1.0, "nu": "0.3"}), "nu = '0.3' must be a finite number"),
        (Material("hencky", 0.0, {"E": 1.0, "nu": 0.5}), "nu = 0.5 is incompressible; use formulation=mixed"),
        (Material("hencky", 0.0, {"E": 1.0, "nu": 0.6}), "nu = 0.6 must lie between -1 and 0.5"),
        (Material("hencky", 0.0, {"E": 1.0, "nu": -1.0}), "nu = -1 must lie between -1 and 0.5"),
        (Material("hencky", -1.0, {"E": 1.0, "nu": 0.3}), "density = -1 kg/m3 must not be negative"),
        (Material("tresca", 0.0, {"E": 1.0, "nu": 0.3, "c": 0.0}), "c = 0 .* must be positive"),
        (Material("von_mises", 0.0, {"E": 1.0, "nu": 0.3, "k": -2.0}), "k = -2 .* must be positive"),
        (Material("mohr_coulomb", 0.0, MC | {"c": -1.0}), "c = -1 .* must not be negative"),
        (Material("mohr_coulomb", 0.0, MC | {"phi": 90.0}), "phi = 90 degrees must lie in"),
        (Material("mohr_coulomb", 0.0, MC | {"psi": 30.0}), "psi = 30 degrees must lie between 0 and phi = 28"),
        (Material("drucker_prager", 0.0, MC | {"c": 0.0, "phi": 0.0, "psi": 0.0}), "has no strength"),
        (Material("newtonian", 0.0, {"mu": 1.0, "K": 0.0}), "K = 0 Pa must be positive"),
        (Material("newtonian", 0.0, {"mu": -1.0, "K": 1.0}), "mu = -1 .* must not be negative"),
    ],
)  # fmt: skip
def test_bad_material_is_a_mistake_in_one_line(material, message):
    with pytest.raises(Mistake, match=message) as caught:
        materials.check(material, "soil")
    assert "soil" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_sound_materials_pass():
    for law, parameters in PARAMETERS.items():
        materials.check(Material(law, 2000.0, parameters), "soil")
    materials.check(Material("mohr_coulomb", 0.0, {"E": E, "nu": NU, "c": 0.0, "phi": 30.0}), "dry sand, psi left out")
    materials.check(Material("neo_hooke", 0.0, {"E": E, "nu": 0.5}), "rubber", incompressible_ok=True)


def test_listing_laws_loads_no_compiler():
    code = "import sys, geofem.materials; print({'numba', 'dolfinx', 'scipy', 'ufl'} & set(sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip() == "set()"


def test_registry_tells_what_the_kernels_can_do():
    for name, law in materials.LAWS.items():
        kernels = materials.get(name)
        assert (kernels.small is not None, kernels.finite is not None) == (law.small, law.finite)
        assert (kernels.energy is None) == law.history


def test_compiled_kernels_are_found_again_by_another_process(tmp_path):
    """Closures must not keep numba from its cache: the second process compiles no kernel."""
    code = (
        "import numpy as np; from geofem.materials.plastic import von_mises_returned, von_mises_tangent\n"
        "from geofem.materials.plane import small_plane\n"
        "k = small_plane(von_mises_returned, von_mises_tangent); z = np.zeros((1, 4))\n"
        "k(z, z, np.ones(3), z, np.zeros((1, 4, 4)), z); print(sum(k.stats.cache_misses.values()))"
    )
    env = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    runs = [subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=env) for _ in range(2)]
    assert [run.stdout.strip() for run in runs] == ["1", "0"]


# --- small strain -----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("m", [4, 6])
@pytest.mark.parametrize("law", PARAMETERS)
def test_small_tangent_is_the_derivative_of_the_stress(law, m):
    """From a stressed state. 1e-7: rounding, 1e-16 stress / (E step), and curvature, (step / yield strain)^2, are 1e-9."""
    n, par = 2000, vector(law)
    _, _, state, _ = small(law, strains(n, m, 1), np.zeros((n, m)), par)
    de = strains(n, m, 2)
    _, tangent, _, plastic = small(law, de, state, par)
    assert law == "linear_elastic" or 0.5 * n < plastic < n
    assert difference_error(lambda x: small(law, x, state, par)[:2], tangent, de, 1e-8) < 1e-7


@pytest.mark.parametrize("m", [4, 6])
@pytest.mark.parametrize("law", PLASTIC)
def test_stress_never_leaves_the_yield_surface(law, m):
    """After ten random steps, elastic and plastic, to within rounding of the return (1e-11 of the stresses)."""
    n, par, state = 2000, vector(law), np.zeros((2000, m))
    for seed in range(10):
        stress, _, state, plastic = small(law, strains(n, m, seed), state, par)
        outside, size = yield_function(law, stress, par)
        assert np.max(outside / size) < 1e-11
        assert np.array_equal(stress, state)
        assert np.sum(outside > -1e-11 * size) >= plastic


@pytest.mark.parametrize(("phi", "psi"), [(28.0, 11.0), (28.0, 28.0), (40.0, 0.0), (0.0, 0.0), (0.5, 0.25)])
def test_mohr_coulomb_return_obeys_the_flow_rule(phi, psi):
    """The plastic strain is a sum, with factors >= 0, of the flow directions of the planes that the stress lies on (Koiter
    1953): this fixes the region, plane, edge or apex. 1e-9 of the strain: rounding of the return over the strain.
    Without dilation no flow leads to the apex; stresses beyond it are put there all the same and not judged here."""
    n = 3000
    par = vector("mohr_coulomb", phi=phi, psi=psi)
    stiffness = par[0] * np.ones((3, 3)) + 2 * par[1] * np.eye(3)
    trial = strains(n, 6, 3, 5e-3)
    trial[:, :3] += np.random.default_rng(4).normal(size=(n, 1)) * 5e-3
    stress, _, _, plastic = small("mohr_coulomb", trial, np.zeros((n, 6)), par)
    trial[:, 3:] *= 0.5
    strain, r = (np.linalg.eigvalsh(tensors(x))[:, ::-1] for x in (trial, stress))
    flow = (1 + math.sin(math.radians(psi))) / (1 - math.sin(math.radians(psi)))
    tried = {"plane": 0, "edge a = b": 0, "edge b = c": 0, "apex": 0}
    for e, s in zip(strain, r):
        left = e - np.linalg.solve(stiffness, s)
        size = np.linalg.norm(e)
        if np.linalg.norm(left) < 1e-11:
            continue
        upper, lower = s[0] - s[1] < 1e-9 * E * size, s[1] - s[2] < 1e-9 * E * size
        tried["apex" if upper and lower else "edge a = b" if upper else "edge b = c" if lower else "plane"] += 1
        if upper and lower and psi == 0.0:
            continue
        planes = [(i, j) for i, j in ((0, 2), (0, 1), (1, 2), (2, 0), (1, 0), (2, 1)) if upper and lower or i < j]
        active = [p for p in planes if par[2] * s[p[0]] - s[p[1]] > par[3] - 1e-9 * E * size]
        directions = np.zeros((3, len(active)))
        for column, (i, j) in enumerate(active):
            directions[i, column], directions[j, column] = flow, -1.0
        assert nnls(directions, left)[1] < 1e-9 * size
    assert sum(tried.values()) == plastic
    assert min(count for region, count in tried.items() if region != "apex") > 20
    assert (tried["apex"] > 20) == (phi > 1.0)


def test_drucker_prager_returns_to_its_cone_and_to_its_apex():
    """Along the flow direction, (s / 2 sqrt(J2) + B / 3 I), onto the cone; where that passes the axis, to the apex k / A."""
    n, par = 2000, vector("drucker_prager")
    G, A, B, k, K = par[1:6]
    de = strains(n, 6, 5)
    stress, _, _, plastic = small("drucker_prager", de, np.zeros((n, 6)), par)
    mean = stress[:, :3].mean(1)
    deviator = tensors(stress) - mean[:, None, None] * np.eye(3)
    root_j2 = np.sqrt(0.5 * (deviator**2).sum((1, 2)))
    at_apex = root_j2 < 1e-9
    assert np.allclose(mean[at_apex], k / A, rtol=1e-12)
    trial_mean = K * de[:, :3].sum(1)
    multiplier = (trial_mean - mean) / (B * K)
    on_cone = ~at_apex & (multiplier > 1e-9)
    de[:, 3:] *= 0.5
    trial = 2 * G * (tensors(de) - de[:, :3].mean(1)[:, None, None] * np.eye(3))
    returned = deviator * (1.0 + G * multiplier / np.where(at_apex, 1.0, root_j2))[:, None, None]
    assert np.abs(trial - returned)[on_cone].max() < 1e-11 * E  # rounding of a stress of E x strain, over B
    assert at_apex.sum() + on_cone.sum() == plastic and min(at_apex.sum(), on_cone.sum()) > 50


@pytest.mark.parametrize("psi", [28.0, 11.0, 0.0])
def test_drucker_prager_fails_like_mohr_coulomb_in_plane_strain(psi):
    """Pure plane shear at constant in-plane stress strain is driven until the stress rests: radius = c cos phi - mean sin phi.

    The stress comes to rest exponentially in the strain; 200 yield strains leave less than 1e-6.
    """
    par, state = vector("drucker_prager", psi=psi, phi=28.0), np.array([[-5.0, -5.0, -3.0, 0.0]])
    # Dilation at rest, volumetric strain = shear strain x sin psi, keeps the stress from rising on and on.
    for _ in range(2000):
        shear = 1e-4
        spread = 0.5 * shear * math.sin(math.radians(psi))
        _, _, state, _ = small("drucker_prager", np.array([[spread, spread, 0.0, shear]]), state, par)
    x, y, z, s = state[0]
    radius, mean = math.hypot(0.5 * (x - y), s), 0.5 * (x + y)
    phi = math.radians(28.0)
    assert radius == pytest.approx(math.cos(phi) - mean * math.sin(phi), rel=1e-6)


def test_tresca_is_mohr_coulomb_without_friction():
    de, zero = strains(1000, 6, 6), np.zeros((1000, 6))
    tresca = small("tresca", de, zero, vector("tresca"))
    mohr_coulomb = small("mohr_coulomb", de, zero, vector("mohr_coulomb", phi=0.0, psi=0.0))
    assert np.array_equal(tresca[0], mohr_coulomb[0])


@pytest.mark.parametrize("law", PARAMETERS)
def test_plane_kernel_is_the_solid_kernel_without_shear_across(law):
    """Two codes, the same physics: to rounding of E x strain (1e-14) and of the tangent through its eigenvectors (1e-10 E:
    the rounding of the axes where principal stresses come close)."""
    keep, n, par = [0, 1, 2, 3], 2000, vector(law)
    state, de = np.zeros((n, 6)), np.zeros((n, 6))
    for seed in (7, 8):
        de[:, :4] = np.random.default_rng(seed).normal(size=(n, 4)) * 3e-3  # with strain across: axial symmetry
        plane = small(law, de[:, :4].copy(), state[:, :4].copy(), par)
        solid = small(law, de, state, par)
        state = solid[2]
        assert np.abs(solid[0][:, :4] - plane[0]).max() < 1e-14 * E
        assert np.abs(solid[0][:, 4:]).max() < 1e-14 * E
        assert np.abs(solid[1][:, keep][:, :, keep] - plane[1]).max() < 1e-10 * E
        assert solid[3] == plane[3]


@pytest.mark.parametrize("law", PLASTIC)
@pytest.mark.parametrize("strain", [(0.004, -0.001, -0.001), (0.0015, 0.0015, -0.0025), (-0.002, 0.005, -0.002)])
def test_tangent_is_right_where_principal_stresses_meet(law, strain):
    """Triaxial compression and extension: the axes of two equal stresses are any, the tangent is not."""
    par, de = vector(law), np.zeros((1, 6))
    de[0, :3] = strain
    stress, tangent, _, plastic = small(law, de, np.zeros((1, 6)), par)
    assert plastic == 1
    assert difference_error(lambda x: small(law, x, np.zeros((1, 6)), par)[:2], tangent, de, 1e-8) < 1e-7


def test_nan_stays_visible():
    """A method that has broken down must see it in the stress."""
    for law in PARAMETERS:
        for m in (4, 6):
            stress = small(law, np.full((1, m), np.nan), np.zeros((1, m)), vector(law))[0]
            assert np.isnan(stress).all()


def test_point_at_rest_on_the_yield_surface_answers_elastically():
    for law in PLASTIC:
        par, zero = vector(law), np.zeros((500, 6))
        _, _, state, plastic = small(law, strains(500, 6, 9), zero, par)
        assert plastic > 100
        stress, _, _, again = small(law, zero, state, par)
        assert again == 0
        assert np.array_equal(stress, state)


@pytest.mark.parametrize("law", ["von_mises", "tresca", "mohr_coulomb", "drucker_prager"])
def test_weakening_divides_the_strength(law):
    """Strength reduction: c / F, tan phi / F and tan psi / F. To rounding of tan and its inverse."""
    weakened = materials.get(law).parameters(Material(law, 0.0, PARAMETERS[law]), 1.7)
    reduced = {
        name: value / 1.7 if name in ("c", "k") else math.degrees(math.atan(math.tan(math.radians(value)) / 1.7))
        for name, value in PARAMETERS[law].items()
        if name in ("c", "k", "phi", "psi")
    }
    assert np.allclose(weakened, vector(law, **reduced), rtol=1e-13)


@pytest.mark.parametrize("m", [4, 6])
def test_elastic_energy_is_half_stress_times_strain(m):
    de = strains(100, m, 10, 1e-3)
    par = vector("linear_elastic")
    stress, _, state, _ = small("linear_elastic", de, np.zeros((100, m)), par)
    energy = materials.get("linear_elastic").elastic_energy(state, par, m, False)
    assert np.allclose(energy, 0.5 * (stress * de).sum(1), rtol=1e-12)  # rounding: energies of both signs' parts cancel


def test_wave_speed_is_that_of_a_laterally_held_bar():
    modulus = E * (1 - NU) / ((1 + NU) * (1 - 2 * NU))
    assert materials.get("hencky").wave_speed(vector("linear_elastic"), 2.0) == pytest.approx(math.sqrt(modulus / 2), rel=1e-14)
    assert materials.get("newtonian").wave_speed(np.array([0.1, 2e9, 7.0, 0.0]), 1000.0) == pytest.approx(
        math.sqrt(2e6), rel=1e-14
    )
