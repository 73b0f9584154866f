"""The weak form of flow over one step, compiled once for an abstract mesh: no mesh of a run compiles anything.

The unknown (u, p) belongs to the time t + theta dt, and all integrals to the configuration that the caller has moved the mesh to.
Equal-order P1 elements take pressure-stabilised Petrov-Galerkin terms (Tezduyar and others 1992, Comput. Methods Appl. Mech. Eng.
95:221-242), which vanish for the exact solution, in the hydrostatic state too; MINI elements (Arnold, Brezzi and Fortin 1984,
Calcolo 21:337-344) need none.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from geofem.core import JIT

ELEMENTS = ("p1p1", "mini")
VISCOSITIES = ("newtonian", "bingham", "mu_i")
CELL = {2: "triangle", 3: "tetrahedron"}
CONSTANTS = (
    "dt",
    "viscosity",
    "density",
    "compliance",
    "tau",
    "source",
    "yield_stress",
    "growth",
    "mu_s",
    "mu_2",
    "I_0",
    "grain",
)
"""``dt`` is that of the unknown, theta dt (s); compliance 1 / K (1/Pa), 0 if incompressible; source: relative volume made (1/s);
growth: exponent m of Papanastasiou (s); grain: d sqrt(rho_s) (kg^1/2 m^-1/2)."""
LEAST_RATE = 1e-6
"""Shear rate (1/s) added in squares, so that what stands still has a viscosity."""
MOST = 1e6
"""The viscosity of grains at rest is capped at so many times density h^2 / dt: more only spoils the condition."""

THIN = 1e-6
"""Less viscosity than so many times density h^2 / dt is as good as none to a preconditioner."""


@dataclass(frozen=True)
class FlowForms:
    """Compiled forms of one kind of flow; what they are made of is told by ``bind``.

    matrix, residual : tangent with the viscosity frozen, and a(w, .) - L(.) at w. power : scalar form (W): dissipation by
    viscosity and by the stabilisation. scales : what preconditioners weigh by, at each dof: of a velocity its mass over dt and its
    spring (N s/m), of a pressure its volume over twice the viscosity (m3/Pa s).
    """

    domain: Any
    element: Any
    w: Any
    w0: Any
    constants: dict[str, Any]
    gravity: Any
    spring: Any
    pull: Any
    matrix: Any
    residual: Any
    power: Any
    scales: Any
    springs: bool

    def bind(self, form: Any, space: Any, functions: dict[str, Any], constants: dict[str, Any], spaces: int) -> fem.Form:
        """The form on a mesh: no compilation. functions : w, w0 and, if there are springs, spring, pull."""
        coefficients = {getattr(self, name): function for name, function in functions.items()}
        named = {self.constants[name]: constants[name] for name in self.constants} | {self.gravity: constants["gravity"]}
        cells = np.arange(space.mesh.topology.index_map(space.mesh.topology.dim).size_local, dtype=np.int32)
        return fem.create_form(form, [space] * spaces, space.mesh, {fem.IntegralType.cell: [(1, cells)]}, coefficients, named)


@cache
def flow_forms(gdim: int, element: str, viscosity: str, springs: bool) -> FlowForms:
    """Compile the forms. springs : whether nodes may be tied to walls (``spring``, ``pull``), see ``FluidSystem``. Collective."""
    cell = CELL[gdim]
    linear = basix.ufl.element("Lagrange", cell, 1)
    domain = ufl.Mesh(basix.ufl.element("Lagrange", cell, 1, shape=(gdim,)))
    if element == "p1p1":
        mixed = basix.ufl.element("Lagrange", cell, 1, shape=(gdim + 1,))
    else:
        bubble = basix.ufl.element("Bubble", cell, gdim + 1)
        mixed = basix.ufl.mixed_element(
            [basix.ufl.blocked_element(basix.ufl.enriched_element([linear, bubble]), (gdim,)), linear]
        )
    space = ufl.FunctionSpace(domain, mixed)
    w, w0 = ufl.Coefficient(space), ufl.Coefficient(space)
    spring = ufl.Coefficient(ufl.FunctionSpace(domain, basix.ufl.element("Lagrange", cell, 1, shape=(gdim, gdim))))
    pull = ufl.Coefficient(ufl.FunctionSpace(domain, basix.ufl.element("Lagrange", cell, 1, shape=(gdim,))))
    c = {name: ufl.Constant(domain) for name in CONSTANTS}
    gravity = ufl.Constant(domain, shape=(gdim,))

    def split(f: Any) -> tuple[Any, Any]:
        return ufl.as_vector([f[i] for i in range(gdim)]), f[gdim]

    trial, test = ufl.TrialFunction(space), ufl.TestFunction(space)
    (u, p), (v, q), (uk, pk), (u0, p0) = (split(f) for f in (trial, test, w, w0))
    dx = ufl.Measure("dx", domain=domain, metadata={"quadrature_degree": 2 if element == "p1p1" else 6})(1)
    nodes = ufl.Measure("dx", domain=domain, metadata={"quadrature_rule": "vertex", "quadrature_degree": 1})(1)
    h = ufl.sqrt(2 * ufl.CellVolume(domain)) if gdim == 2 else (6 * ufl.CellVolume(domain)) ** (1 / 3)
    rate = ufl.sym(ufl.grad(uk))
    mu = effective_viscosity(viscosity, c, rate, pk, h)
    rho = c["density"] * (1 + c["compliance"] * p0)
    dt = c["dt"]
    stabilised = element == "p1p1"
    tau = c["tau"] / ufl.sqrt((2 / dt) ** 2 + (4 * mu / rho / h**2) ** 2)

    def left(u: Any, p: Any, v: Any, q: Any) -> Any:
        form = (
            rho / dt * ufl.inner(u, v)
            + 2 * mu * ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v)))
            - p * ufl.div(v)
            + q * ufl.div(u)
            + c["compliance"] / dt * p * q
        ) * dx
        if stabilised:
            form += tau / rho * ufl.dot(ufl.grad(q), rho / dt * u + ufl.grad(p)) * dx
        if springs:
            form += ufl.dot(spring * u, v) * nodes
        return form

    right = (ufl.inner(rho / dt * u0 + rho * gravity, v) + (c["source"] + c["compliance"] / dt * p0) * q) * dx
    if stabilised:
        right += tau / rho * ufl.dot(ufl.grad(q), rho / dt * u0 + rho * gravity) * dx
    if springs:
        right += ufl.dot(pull, v) * nodes
    if gdim == 3:
        # the volume is a cubic of time where nodes move straight: over the step the divergence is tr G + (theta dt)^2 det G
        right -= q * dt**2 * ufl.det(ufl.grad(uk)) * dx
    residual = left(uk, pk, v, q) - right
    power = 2 * mu * ufl.inner(rate, rate) * dx
    if stabilised:
        power += tau / rho * ufl.dot(ufl.grad(pk), rho / dt * (uk - u0) + ufl.grad(pk) - rho * gravity) * dx

    least = THIN * rho * h**2 / dt
    scales = (rho / dt * sum(v) + q / (2 * ufl.max_value(mu, least))) * dx
    if springs:
        scales += sum(spring[i, i] * v[i] for i in range(gdim)) * nodes

    def compiled(form: Any) -> Any:
        return fem.compile_form(MPI.COMM_WORLD, form, jit_options=JIT)

    matrix, residual, power, scales = (compiled(form) for form in (left(u, p, v, q), residual, power, scales))
    return FlowForms(domain, mixed, w, w0, c, gravity, spring, pull, matrix, residual, power, scales, springs)


def effective_viscosity(viscosity: str, c: dict[str, Any], rate: Any, p: Any, h: Any) -> Any:
    """The viscosity (Pa s) at a rate of deformation and a pressure.

    bingham : mu + tau_y (1 - exp(-m g)) / g, g = sqrt(2 D:D) (Papanastasiou 1987, J. Rheol. 31:385-404).
    mu_i : mu(I) p / g, I = g d / sqrt(p / rho_s) (Jop, Forterre and Pouliquen 2006, Nature 441:727-730); no strength in tension.
    """
    if viscosity == "newtonian":
        return c["viscosity"]
    g = ufl.sqrt(2 * ufl.inner(rate, rate) + LEAST_RATE**2)
    if viscosity == "bingham":
        return c["viscosity"] + c["yield_stress"] * (1 - ufl.exp(-c["growth"] * g)) / g
    pressure = ufl.max_value(p, 0.0)
    # mu(I) p with I = g grain / sqrt(p), written without dividing by p or g
    flow = g * c["grain"]
    strength = (c["mu_s"] + (c["mu_2"] - c["mu_s"]) * flow / (c["I_0"] * ufl.sqrt(pressure) + flow)) * pressure
    return c["viscosity"] + 1 / (g / (strength + 1e-12 * c["density"]) + c["dt"] / (MOST * c["density"] * h**2))
