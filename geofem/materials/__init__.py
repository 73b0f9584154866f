"""Material laws by name: what each needs, whether a material is sound, and its point kernels, loaded when asked for.

Stresses and strains are vectors of m components: m = 4 in the plane and with axial symmetry (xx, yy, zz, xy), m = 6 in
space (xx, yy, zz, xy, yz, xz); shear strains are engineering strains. A deformation gradient is a vector of g
components: g = 5 (xx, xy, yx, yy, zz; zz = 1 in plane strain, the hoop stretch with axial symmetry) or g = 9 (row by row).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from types import MappingProxyType

import numpy as np

from geofem.mistake import Mistake, unknown
from geofem.scene import Material

Array = np.ndarray


@dataclass(frozen=True)
class Law:
    """What a law is and what it asks for: ``parameters`` by their meaning and unit, ``optional`` ones by default and meaning.

    small, finite : whether the law knows small strains, finite strains. history : whether the answer at finite strain
    depends on the path. module : the module of geofem.materials where its kernels live.
    """

    name: str
    summary: str
    module: str
    parameters: Mapping[str, str]
    optional: Mapping[str, tuple[float, str]] = field(default_factory=lambda: MappingProxyType({}))
    small: bool = True
    finite: bool = True
    history: bool = False


@dataclass(frozen=True)
class Kernels:
    """The numba kernels of one law; N points, m and g as in the module's text, s = ``state_size(m)``.

    small : (dstrain (N, m), state (N, s), par, stress (N, m), tangent (N, m, m), new_state (N, s)) -> number of plastic points.
        The converged stress is state[:, :m]. None if the law has no small-strain form.
    finite : (F (N, g), F_old (N, g), state (N, s), par, dt, P (N, g), A (N, g, g), new_state (N, s)) -> number of plastic
        points, or -1 - i if point i is the first with det F <= 0. P is the first Piola-Kirchhoff stress and A = dP/dF.
        The state is the elastic left Cauchy-Green tensor less the identity, by its m tensor components; where a material
        without tension has opened, its volume is the gap and its stress is none.
    point : (F (g,), F_old (g,), state (s,), par, dt, tau (m,), new_state (s,)) -> 1 if plastic, 0 if not, -1 if det F <= 0.
        Writes the Kirchhoff stress. To be called from compiled loops, which may close over it and still be cached by numba.
    parameters : (material, weakening=1.0) -> par. The strength (c, k, mu_s, mu_2 and tan phi, tan psi) is divided by ``weakening``.
    wave_speed : (par, density) -> speed of compression waves (m/s) at rest.
    stretched_speed : (F (N, g), par, density) -> a bound on it (m/s) over deformed points, as they are now, for laws that stiffen.
    energy : (F (N, g), par) -> (N,) stored energy per reference volume (J/m3), for hyperelastic laws.
    elastic_energy : (state (N, s), par, m, finite) -> (N,) stored energy (J/m3) of an elastic state, for laws with a state.
    push : (P (N, g), A (N, g, g), Fn (N, g)) -> None: P and A from the reference configuration to configuration n, in place.
    """

    parameters: Callable[..., Array]
    state_size: Callable[[int], int]
    small: Callable[..., int] | None
    finite: Callable[..., int]
    point: Callable[..., int]
    wave_speed: Callable[[Array, float], float]
    push: Callable[..., None]
    energy: Callable[[Array, Array], Array] | None = None
    elastic_energy: Callable[[Array, Array, int, bool], Array] | None = None
    stretched_speed: Callable[[Array, Array, float], float] | None = None

    def initial_state(self, n: int, m: int) -> Array:
        """(n, s): no stress, no strain."""
        return np.zeros((n, self.state_size(m)))


ELASTIC = {"E": "Young's modulus, Pa", "nu": "Poisson's ratio"}
FRICTION = ELASTIC | {"c": "cohesion, Pa", "phi": "friction angle, degrees"}
DILATION = {
    "psi": (0.0, "dilation angle, degrees"),
    "gap": (0.0, "1: what has opened in tension closes before it resists again (c = 0, finite strain); 0: it resists at once"),
}
TAIT = {
    "gamma": (1.0, "exponent of Tait's equation of state, 7 for water"),
    "cavitation": (-math.inf, "least pressure, Pa; 0 for a free surface without tension"),
}
SURFACE = {"surface_tension": (0.0, "surface tension, N/m")}

LAWS: dict[str, Law] = {
    law.name: law
    for law in (
        Law("linear_elastic", "Hooke's law, geometrically linear", "elastic", ELASTIC),
        Law("hencky", "Hooke's law between Kirchhoff stress and logarithmic strain", "hencky", ELASTIC, small=False),
        Law("neo_hooke", "compressible neo-Hookean solid", "elastic", ELASTIC, small=False),
        Law("von_mises", "perfectly plastic, sqrt(J2) <= k", "plastic",
            ELASTIC | {"k": "strength in simple shear, Pa"}, history=True),
        Law("tresca", "perfectly plastic, largest shear stress <= c", "plastic",
            ELASTIC | {"c": "undrained shear strength, Pa"}, history=True),
        Law("mohr_coulomb", "perfectly plastic, shear stress <= c + pressure tan phi", "plastic",
            FRICTION, DILATION, history=True),
        Law("drucker_prager", "perfectly plastic cone that fails like Mohr-Coulomb in plane strain", "plastic",
            FRICTION, DILATION, history=True),
        Law("mu_i", "dense granular flow, shear stress <= mu(I) pressure, no tension", "granular",
            ELASTIC | {"mu_s": "friction coefficient at rest", "mu_2": "friction coefficient of fast flow",
                       "I_0": "inertial number halfway between them", "d": "grain diameter, m"},
            {"rho_s": (2500.0, "density of the grains, kg/m3")}, small=False, history=True),
        Law("newtonian", "viscous, weakly compressible fluid", "fluid",
            {"mu": "viscosity, Pa s", "K": "bulk modulus, Pa"}, TAIT | SURFACE, small=False, history=True),
        Law("bingham", "viscous, weakly compressible fluid that flows where its shear stress exceeds tau_y", "fluid",
            {"mu": "plastic viscosity, Pa s", "tau_y": "yield stress, Pa", "K": "bulk modulus, Pa"},
            {"m": (100.0, "time of regularisation, s: creep at rest has the viscosity mu + m tau_y")} | TAIT,
            small=False, history=True),
    )
}  # fmt: skip


def values(material: Material) -> dict[str, float]:
    """The parameters of a material, defaults filled in."""
    return {name: default for name, (default, _) in LAWS[material.law].optional.items()} | dict(material.parameters)


def lame(E: float, nu: float) -> tuple[float, float]:
    """Lamé's constants (lambda, mu) in Pa; lambda is infinite for nu = 1/2."""
    return (math.inf if nu == 0.5 else E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))), 0.5 * E / (1.0 + nu)


def check(material: Material, where: str, incompressible_ok: bool = False) -> None:
    """Raise ``Mistake`` if the material's law, parameters or density cannot be; ``where`` names it in the message.

    incompressible_ok : allow nu = 1/2, for formulations with a pressure field of their own.
    """
    if material.law not in LAWS:
        raise unknown(f"law ({where})", material.law, LAWS)
    law = LAWS[material.law]
    for name in material.parameters:
        if name not in law.parameters and name not in law.optional:
            raise unknown(f"parameter of {law.name} ({where})", name, [*law.parameters, *law.optional])
    for name, meaning in law.parameters.items():
        if name not in material.parameters:
            raise Mistake(f"{where}: {law.name} lacks its parameter {name} ({meaning}); give it in Material(parameters=...)")
    for name, value in [("density", material.density), *material.parameters.items()]:
        if isinstance(value, bool) or not isinstance(value, (int, float, np.number)) or not math.isfinite(value):
            raise Mistake(f"{where}: {name} = {value!r} must be a finite number")
    if material.density < 0:
        raise Mistake(f"{where}: density = {material.density:g} kg/m3 must not be negative")
    given = values(material)
    for name in ("E", "K"):
        if name in given and given[name] <= 0:
            raise Mistake(f"{where}: {name} = {given[name]:g} Pa must be positive")
    for name, unit in (("mu", "Pa s"), ("surface_tension", "N/m"), ("tau_y", "Pa"), ("m", "s")):
        if given.get(name, 0.0) < 0:
            raise Mistake(f"{where}: {name} = {given[name]:g} {unit} must not be negative")
    if "gamma" in given:
        check_pressure(given["gamma"], given["cavitation"], where)
    if "mu_s" in given:
        check_grains(given, where)
    if "nu" in given:
        check_poisson(given["nu"], where, incompressible_ok)
    if "phi" in given:
        check_friction(given["c"], given["phi"], given["psi"], where)
        check_gap(given["gap"], given["c"], where)
    else:
        for name in ("c", "k"):
            if name in given and given[name] <= 0:
                raise Mistake(f"{where}: {name} = {given[name]:g} Pa ({law.parameters[name]}) must be positive")


def check_poisson(nu: float, where: str, incompressible_ok: bool) -> None:
    if nu == 0.5 and not incompressible_ok:
        raise Mistake(f"{where}: nu = 0.5 is incompressible; use formulation=mixed, or nu < 0.5")
    if not -1 < nu <= 0.5:
        raise Mistake(f"{where}: nu = {nu:g} must lie between -1 and 0.5")


def check_friction(c: float, phi: float, psi: float, where: str) -> None:
    if c < 0:
        raise Mistake(f"{where}: c = {c:g} Pa must not be negative")
    if not 0 <= phi < 90:
        raise Mistake(f"{where}: phi = {phi:g} degrees must lie in [0, 90)")
    if not 0 <= psi <= phi:
        raise Mistake(f"{where}: psi = {psi:g} degrees must lie between 0 and phi = {phi:g}")
    if c == 0 and phi == 0:
        raise Mistake(f"{where}: has no strength; give c > 0 or phi > 0")


def check_gap(gap: float, c: float, where: str) -> None:
    if gap not in (0.0, 1.0):
        raise Mistake(f"{where}: gap = {gap:g} must be 0 or 1")
    if gap and c > 0:
        raise Mistake(f"{where}: gap = 1 is for materials without cohesion; give c = 0")


def check_pressure(gamma: float, cavitation: float, where: str) -> None:
    if gamma <= 0:
        raise Mistake(f"{where}: gamma = {gamma:g} must be positive")
    if cavitation > 0:
        raise Mistake(f"{where}: cavitation = {cavitation:g} Pa must not be positive: the fluid starts at pressure 0")


def check_grains(given: Mapping[str, float], where: str) -> None:
    for name, unit in (("mu_s", ""), ("I_0", ""), ("d", " m"), ("rho_s", " kg/m3")):
        if given[name] <= 0:
            raise Mistake(f"{where}: {name} = {given[name]:g}{unit} must be positive")
    if given["mu_2"] < given["mu_s"]:
        raise Mistake(f"{where}: mu_2 = {given['mu_2']:g} must not be below mu_s = {given['mu_s']:g}")


def get(law: str) -> Kernels:
    """The kernels of a law; imports numba. Raises ``Mistake`` if there is no such law."""
    if law not in LAWS:
        raise unknown("law", law, LAWS)
    return import_module(f"geofem.materials.{LAWS[law].module}").KERNELS[law]
