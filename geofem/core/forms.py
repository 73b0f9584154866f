"""The weak forms of the momentum balance, compiled once on an abstract mesh and re-created on any mesh without JIT.

A ``Template`` holds all that generated code depends on; ``compiled`` turns it into forms once per process; ``Forms`` puts them
on a mesh. Parameters are constants of the form, so that a new value never compiles anything. Integrals carry the number of
their region (``dx(1)``, ``dx(2)``): with a plain ``dx`` dolfinx ignores the list of cells it is given.

The unknown is the displacement u counted from the configuration of the mesh: the reference one (total Lagrangian, ``base`` is
not used) or the last converged one (updated Lagrangian, ``base`` holds F of that configuration at the quadrature points).
The mixed form carries the pressure divided by the shear modulus, which keeps the blocks of its matrix of one size.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import basix
import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from mpi4py import MPI
from ufl.algorithms import strip_variables
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives

from geofem.core import JIT
from geofem.cost import phase
from geofem.materials import ufl_energy
from geofem.scene import Material

UFL_LAWS = ("linear_elastic", "neo_hooke")
"""Laws whose energy UFL differentiates; all others go through point kernels and quadrature functions."""


@dataclass(frozen=True)
class Template:
    """All that the generated code depends on.

    cell : triangle, quadrilateral, tetrahedron, hexahedron. geometry : coordinate element of the mesh. order : of the displacement.
    plane : as in ``Scene``. strain : small or finite. laws : per region, the UFL law or "points".
    mixed : a pressure field of one order less. updated : updated Lagrangian. degree : of the quadrature.
    followers : number of pressures that follow the boundary, integrated by ``ds(1)``, ``ds(2)``, ...
    """

    cell: str
    geometry: Any
    order: int
    plane: str
    strain: str
    laws: tuple[str, ...]
    mixed: bool
    updated: bool
    degree: int
    followers: int = 0

    @property
    def gdim(self) -> int:
        return 3 if self.plane == "solid" else 2

    @property
    def components(self) -> int:
        """Length of the strain vector (small) or of the deformation gradient vector (finite) at a point."""
        if self.strain == "small":
            return 6 if self.gdim == 3 else 4
        return 9 if self.gdim == 3 else 5

    @property
    def element(self) -> Any:
        displacement = basix.ufl.element("Lagrange", self.cell, self.order, shape=(self.gdim,))
        if not self.mixed:
            return displacement
        return basix.ufl.mixed_element([displacement, basix.ufl.element("Lagrange", self.cell, self.order - 1)])

    def quadrature_element(self, shape: tuple[int, ...]) -> Any:
        return basix.ufl.quadrature_element(self.cell, value_shape=shape, scheme="default", degree=self.degree)

    @property
    def points(self) -> np.ndarray:
        """Quadrature points on the reference cell, (n, tdim)."""
        return basix.make_quadrature(getattr(basix.CellType, self.cell), self.degree)[0]

    @property
    def weights(self) -> np.ndarray:
        return basix.make_quadrature(getattr(basix.CellType, self.cell), self.degree)[1]


# --- kinematics, on any mesh ------------------------------------------------------------------------------------------
def small_strain(u: Any, x: Any, plane: str) -> Any:
    """Strain vector (xx, yy, zz, 2xy) or (xx, yy, zz, 2xy, 2yz, 2xz)."""
    g = ufl.grad(u)
    if plane == "solid":
        return ufl.as_vector([g[0, 0], g[1, 1], g[2, 2], g[0, 1] + g[1, 0], g[1, 2] + g[2, 1], g[0, 2] + g[2, 0]])
    hoop = u[0] / x[0] if plane == "axisymmetric" else 0 * u[0]
    return ufl.as_vector([g[0, 0], g[1, 1], hoop, g[0, 1] + g[1, 0]])


def gradient(u: Any, x: Any, plane: str) -> Any:
    """Displacement gradient as a 3 x 3 tensor."""
    g = ufl.grad(u)
    if plane == "solid":
        return g
    hoop = u[0] / x[0] if plane == "axisymmetric" else 0 * u[0]
    return ufl.as_tensor([[g[0, 0], g[0, 1], 0], [g[1, 0], g[1, 1], 0], [0, 0, hoop]])


def as_vector(h: Any, plane: str) -> Any:
    """A 3 x 3 tensor as the vector of point kernels: (xx, xy, yx, yy, zz), or 9 row-major components."""
    if plane == "solid":
        return ufl.as_vector([h[i, j] for i in range(3) for j in range(3)])
    return ufl.as_vector([h[0, 0], h[0, 1], h[1, 0], h[1, 1], h[2, 2]])


def as_tensor(f: Any, plane: str) -> Any:
    """The inverse of ``as_vector``."""
    if plane == "solid":
        return ufl.as_tensor([[f[3 * i + j] for j in range(3)] for i in range(3)])
    return ufl.as_tensor([[f[0], f[1], 0], [f[2], f[3], 0], [0, 0, f[4]]])


def strain_vector(u: Any, x: Any, template: Template) -> Any:
    """What a point kernel takes: the small strain, or F of the current state relative to the mesh's configuration."""
    if template.strain == "small":
        return small_strain(u, x, template.plane)
    return as_vector(ufl.Identity(3) + gradient(u, x, template.plane), template.plane)


# --- compiled once ----------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Symbols:
    """The coefficients and constants of the abstract forms, to be mapped to data on a mesh."""

    mesh: Any
    space: Any
    unknown: Any
    base: Any
    stress: Any
    tangent: Any
    body: Any
    constants: dict[str, Any]


@cache
def symbols(template: Template) -> Symbols:
    domain = ufl.Mesh(template.geometry)
    space = ufl.FunctionSpace(domain, template.element)
    m = template.components

    def quadrature(*shape: int) -> Any:
        return ufl.Coefficient(ufl.FunctionSpace(domain, template.quadrature_element(shape)))

    names = [f"{p}{i}" for i in range(len(template.laws)) for p in ("lam", "mu", "inv_lam", "density")]
    names += [f"pressure{i}" for i in range(template.followers)]
    constants = {name: ufl.Constant(domain) for name in names}
    constants["traction"] = ufl.Constant(domain, shape=(template.gdim,))
    constants["gravity"] = ufl.Constant(domain, shape=(template.gdim,))
    finite_size = 9 if template.gdim == 3 else 5
    return Symbols(domain, space, ufl.Coefficient(space), quadrature(finite_size), quadrature(m), quadrature(m, m),
                   quadrature(template.gdim), constants)  # fmt: skip


def abstract_form(template: Template, kind: str) -> Any:
    """The UFL form of that kind; a region i is integrated by ``dx(i + 1)``, loaded facets by ``ds(1)``."""
    s = symbols(template)
    x = ufl.SpatialCoordinate(s.mesh)
    test, trial = ufl.TestFunction(s.space), ufl.TrialFunction(s.space)
    split = ufl.split if template.mixed else lambda w: (w, None)
    (u, p), (v, _) = split(s.unknown), split(test)
    weight = x[0] if template.plane == "axisymmetric" else 1.0
    base = as_tensor(s.base, template.plane) if template.updated else ufl.Identity(3)
    f = ufl.Identity(3) + gradient(u, x, template.plane)

    def dx(region: int, degree: int = template.degree) -> Any:
        return ufl.Measure("dx", domain=s.mesh, metadata={"quadrature_degree": degree, "quadrature_scheme": "default"})(
            region + 1
        )

    def everywhere(integrand: Callable[[int], Any], degree: int = template.degree) -> Any:
        return sum(
            (integrand(i) * weight * dx(i, degree) for i in range(1, len(template.laws))), integrand(0) * weight * dx(0, degree)
        )

    def density(i: int) -> Any:
        # rho of the mesh's configuration: mass is counted in the reference one
        return s.constants[f"density{i}"] / (ufl.det(base) if template.updated else 1.0)

    def energy(i: int) -> Any:
        lam, mu, inv_lam = (s.constants[f"{p_}{i}"] for p_ in ("lam", "mu", "inv_lam"))
        deformation = f * base if template.strain == "finite" else f
        if template.mixed:
            stored = ufl_energy.energy_mixed(template.laws[i], deformation, mu * p, inv_lam, mu)
        else:
            stored = ufl_energy.energy(template.laws[i], deformation, lam, mu)
        return stored / (ufl.det(base) if template.updated else 1.0)

    def conjugate(w: Any) -> Any:
        # the virtual strain that point kernels' stress works on
        if template.strain == "small":
            return small_strain(w, x, template.plane)
        return as_vector(gradient(w, x, template.plane), template.plane)

    def ds(facets: int) -> Any:
        return ufl.Measure("ds", domain=s.mesh, metadata={"quadrature_degree": load_degree, "quadrature_scheme": "default"})(
            facets + 1
        )

    def pressure(i: int) -> Any:
        normal = ufl.FacetNormal(s.mesh)
        normal = ufl.as_vector([*(normal[k] for k in range(template.gdim)), *([0] if template.gdim == 2 else [])])
        pushed = ufl.det(f) * ufl.inv(f).T * normal if template.strain == "finite" else normal
        return (
            s.constants[f"pressure{i}"]
            * ufl.inner(ufl.as_vector([pushed[k] for k in range(template.gdim)]), v)
            * weight
            * ds(i)
        )

    load_degree = 2 * template.order
    if kind in ("residual", "tangent"):
        if template.laws[0] == "points":
            inner = everywhere(
                lambda i: ufl.inner(s.stress if kind == "residual" else s.tangent * conjugate(trial), conjugate(v))
            )
        else:
            inner = ufl.derivative(everywhere(energy), s.unknown, test)
            inner = inner if kind == "residual" else ufl.derivative(inner, s.unknown, trial)
        outer = [pressure(i) for i in range(template.followers)]
        return sum(outer if kind == "residual" else [ufl.derivative(p_, s.unknown, trial) for p_ in outer], inner)
    if kind == "energy":
        return everywhere(energy)
    if kind == "mass":
        # with gravity assembled once, on the reference mesh: F of the mesh would impose its own, fewer, quadrature points
        du = split(trial)[0]
        return everywhere(lambda i: s.constants[f"density{i}"] * ufl.inner(du, v), load_degree)
    if kind == "gravity":
        return everywhere(lambda i: s.constants[f"density{i}"] * ufl.inner(s.constants["gravity"], v), load_degree)
    if kind == "body":
        return everywhere(lambda i: density(i) * ufl.inner(s.body, v))
    if kind == "weight":
        return everywhere(density)
    if kind == "volume":
        return everywhere(lambda i: ufl.det(f) if template.strain == "finite" else ufl.tr(f) - 2)
    if kind == "traction":
        return ufl.inner(s.constants["traction"], v) * weight * ds(0)
    raise KeyError(kind)


def cauchy_vector(template: Template, law: str, unknown: Any, base: Any, lam: Any, mu: Any, inv_lam: Any) -> Any:
    """Cauchy stress (xx, yy, zz, xy[, yz, xz]) of a UFL law at the unknown on a mesh of its own."""
    u, p = ufl.split(unknown) if template.mixed else (unknown, None)
    x = ufl.SpatialCoordinate(ufl.domain.extract_unique_domain(unknown))
    f = ufl.Identity(3) + gradient(u, x, template.plane)
    f = ufl.variable(f * as_tensor(base, template.plane) if template.updated else f)
    stored = ufl_energy.energy_mixed(law, f, mu * p, inv_lam, mu) if template.mixed else ufl_energy.energy(law, f, lam, mu)
    stress = ufl.diff(stored, f)
    if template.strain == "finite":
        stress = stress * f.T / ufl.det(f)
    pairs = [(0, 0), (1, 1), (2, 2), (0, 1)] + ([(1, 2), (0, 2)] if template.gdim == 3 else [])
    components = [stress[i, j] for i, j in pairs]
    if template.plane == "plane_stress":
        # the Lame constants of plane stress give the stresses in the plane; there is none across it
        components[2] = 0 * components[2]
    vector = ufl.as_vector(components)
    # a variable's label is counted up in each process and enters FFCx's signature: left in, every run would compile anew
    return strip_variables(apply_derivatives(apply_algebra_lowering(vector)))


@cache
def compiled(template: Template, kind: str) -> Any:
    with phase("jit"):
        return fem.compile_form(MPI.COMM_WORLD, abstract_form(template, kind), jit_options=dict(JIT))


class Forms:
    """The forms of a template on a mesh: spaces, data, and ``form(kind)`` made on demand without JIT.

    Parameters
    ----------
    mesh, template : where and what.
    regions : (cells,) number of the region of each cell, ghosts included.
    followers : per following pressure, the local facets it acts on.
    """

    def __init__(self, mesh: Mesh, template: Template, regions: np.ndarray, followers: Sequence[np.ndarray] = ()):
        self.mesh, self.template = mesh, template
        self.space = fem.functionspace(mesh, template.element)
        self.unknown = fem.Function(self.space)
        owned = mesh.topology.index_map(mesh.topology.dim).size_local
        self.cells = [np.flatnonzero(regions[:owned] == i).astype(np.int32) for i in range(len(template.laws))]
        self.owned = owned
        self.followers = list(followers)
        s = symbols(template)
        self.constants = {name: fem.Constant(mesh, np.zeros(c.ufl_shape)) for name, c in s.constants.items()}
        self._coefficients: dict[Any, fem.Function] = {s.unknown: self.unknown}
        if template.updated:
            self.base = self._quadrature_function(s.base)
            identity = np.eye(3).ravel() if template.gdim == 3 else np.array([1.0, 0.0, 0.0, 1.0, 1.0])
            self.base.x.array[:] = np.tile(identity, self.base.x.array.size // identity.size)
        if template.laws[0] == "points":
            self.stress = self._quadrature_function(s.stress)
            self.tangent = self._quadrature_function(s.tangent)

    def _quadrature_function(self, symbol: Any) -> fem.Function:
        function = fem.Function(fem.functionspace(self.mesh, symbol.ufl_function_space().ufl_element()))
        self._coefficients[symbol] = function
        return function

    def set_parameters(self, materials: Sequence[Material]) -> None:
        """Give the constants of the forms the densities and, for UFL laws, the Lame parameters of the regions' materials."""
        for i, material in enumerate(materials):
            self.constants[f"density{i}"].value = material.density
            if self.template.laws[i] == "points":
                continue
            E, nu = material.parameters["E"], material.parameters["nu"]
            mu = E / (2.0 * (1.0 + nu))
            inv_lam = (1.0 + nu) * (1.0 - 2.0 * nu) / (E * nu) if nu else np.inf
            lam = 1.0 / inv_lam if inv_lam else np.inf
            if self.template.plane == "plane_stress":
                lam = 2.0 * lam * mu / (lam + 2.0 * mu)
            for name, value in ("mu", mu), ("lam", lam), ("inv_lam", inv_lam):
                self.constants[f"{name}{i}"].value = value

    def need_body(self) -> None:
        """Make ``body``, the body force per mass at the quadrature points (m/s2)."""
        if not hasattr(self, "body"):
            self.body = self._quadrature_function(symbols(self.template).body)

    def form(self, kind: str, facets: np.ndarray | None = None) -> fem.Form:
        """The form of that kind on this mesh; ``facets`` (local indices) for those that integrate over the boundary."""
        code = compiled(self.template, kind)
        domains: dict[fem.IntegralType, list[tuple[int, np.ndarray]]] = {}
        if facets is None:
            domains[fem.IntegralType.cell] = [(i + 1, cells) for i, cells in enumerate(self.cells)]
        loaded = [facets] if facets is not None else self.followers if kind in ("residual", "tangent") else []
        if loaded:
            exterior = fem.IntegralType.exterior_facet
            entities = [fem.compute_integration_domains(exterior, self.mesh.topology, np.asarray(f, np.int32)) for f in loaded]
            domains[exterior] = [(i + 1, e) for i, e in enumerate(entities)]
        s = symbols(self.template)
        rank = len(code.ufl_form.arguments())
        constants = {s.constants[name]: value for name, value in self.constants.items()}
        return fem.create_form(code, [self.space] * rank, self.mesh, domains, self._coefficients, constants)

    def strain(self, points: np.ndarray | None = None) -> fem.Expression:
        """The expression of the strain vector of point kernels, at the quadrature points unless others are named."""
        u = ufl.split(self.unknown)[0] if self.template.mixed else self.unknown
        return self.expression(strain_vector(u, ufl.SpatialCoordinate(self.mesh), self.template), points)

    def cauchy(self) -> list[fem.Expression]:
        """The expressions of the Cauchy stress of the regions' UFL laws."""
        base = getattr(self, "base", None)
        return [
            self.expression(
                cauchy_vector(
                    self.template, law, self.unknown, base, *(self.constants[f"{name}{i}"] for name in ("lam", "mu", "inv_lam"))
                )
            )
            for i, law in enumerate(self.template.laws)
        ]

    def strain_at_vertices(self) -> fem.Expression:
        """The expression of ``strain`` at the vertices of the cells, where they tangle first."""
        return self.strain(basix.geometry(getattr(basix.CellType, self.template.cell)))

    def expression(self, expression: Any, points: np.ndarray | None = None) -> fem.Expression:
        with phase("jit"):
            return fem.Expression(expression, self.template.points if points is None else points, jit_options=dict(JIT))

    def evaluate(self, expression: fem.Expression) -> np.ndarray:
        """An expression at the quadrature points of all owned cells, (owned cells * points, components)."""
        values = expression.eval(self.mesh, np.arange(self.owned, dtype=np.int32))
        return values.reshape(-1, expression.ufl_expression.ufl_shape[0])
