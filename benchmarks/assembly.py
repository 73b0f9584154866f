"""How fast the stiffness matrix of linear elasticity is filled, beside NGSolve and scikit-fem.

uv run --group bench python benchmarks/assembly.py        (the peers that are not installed are left out)

All in one process on one thread: process CPU seconds, the least of several rounds in which the contenders take turns. Meshes of
the unit square and cube with as many cells, the same quadrature, full matrices without boundary conditions. What is timed:

geofem      ``Matrix.assemble``: the entries; the pattern and the compiled form are there before.
NGSolve     ``BilinearForm.Assemble`` a second time: memory and pattern are there before. ``form`` is a symbolic form on
            ``VectorH1``, ``blocks`` the same on ``H1(dim=d)``, whose entries are d x d blocks, and ``compiled`` this one turned
            into machine code by the C++ compiler, the fastest found. Its older integrator ``BFI("elasticity")`` takes as long,
            but in release 6.2.2608 its matrix now and then fails the test below, mostly in order 1.
scikit-fem  ``assemble`` to CSR with the basis made before; ``entries`` without the conversion to CSR, which it makes anew at
            every assembly and which the others do not need.

Each matrix must give the exact energy of a displacement that its space holds, so that all are matrices of the same problem.
"""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import geofem.core  # noqa: F401 - caps the threads before numpy is loaded

# isort: split
import numpy as np
from dolfinx import mesh
from mpi4py import MPI

from geofem.core.forms import Forms, Template
from geofem.core.solvers import Matrix
from geofem.methods.lagrangian import quadrature_degree
from geofem.scene import Material

ROUNDS = 9
E, NU = 1000.0, 0.3
LAM, MU = E * NU / ((1 + NU) * (1 - 2 * NU)), E / (2 * (1 + NU))
CASES = [("triangle", 2, 150), ("triangle", 1, 250), ("quadrilateral", 2, 100), ("tetrahedron", 1, 24), ("tetrahedron", 2, 12)]
"""Cell, order, cells along an edge."""
EXACT = {1: 2.5 * MU + 2 * LAM, 2: 11 / 6 * MU + 1.5 * LAM}
"""Energy of u = (x + y, y, 0) and of u = (x^2, x y, 0): the integral of mu e:e + lam/2 tr(e)^2 over the unit square or cube."""

Contender = tuple[int, Callable[[], object], float]
"""Degrees of freedom, the assembly to be timed, and the energy that the matrix gives."""


def displacement(order: int, x: np.ndarray) -> np.ndarray:
    """The displacement of ``EXACT`` at points x (d, ...)."""
    first = (x[0] + x[1], x[1]) if order == 1 else (x[0] ** 2, x[0] * x[1])
    return np.stack([*first, *([0 * x[0]] if len(x) == 3 else [])])


def degree(cell: str, order: int) -> int:
    """Of the quadrature that integrates the stiffness exactly on straight cells."""
    return quadrature_degree(order, cell == "quadrilateral", reduced=False, strain="small")


def ours(cell: str, order: int, n: int) -> dict[str, Contender]:
    kind = getattr(mesh.CellType, cell)
    if cell == "tetrahedron":
        domain = mesh.create_unit_cube(MPI.COMM_SELF, n, n, n, kind)
    else:
        domain = mesh.create_unit_square(MPI.COMM_SELF, n, n, kind)
    template = Template(
        cell=cell,
        geometry=domain.ufl_domain().ufl_coordinate_element(),
        order=order,
        plane="solid" if cell == "tetrahedron" else "plane_strain",
        strain="small",
        laws=("linear_elastic",),
        mixed=False,
        updated=False,
        degree=degree(cell, order),
    )
    forms = Forms(domain, template, np.zeros(len(domain.geometry.dofmaps[0]), np.int32))
    forms.set_parameters([Material("linear_elastic", parameters={"E": E, "nu": NU})])
    matrix = Matrix(forms.form("tangent"))
    matrix.assemble()
    gdim = template.gdim
    forms.unknown.interpolate(lambda x: displacement(order, x[:gdim]))
    u, force = matrix.mat.createVecs()
    u.array[:] = forms.unknown.x.array
    matrix.mat.mult(u, force)
    return {"geofem": (u.size, matrix.assemble, 0.5 * u.dot(force))}


def ngsolve(cell: str, order: int, n: int) -> dict[str, Contender]:
    # NGSolve calls its compiler script by name
    os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    import ngsolve as ng
    from ngsolve.meshes import MakeStructured2DMesh, MakeStructured3DMesh

    solid = cell == "tetrahedron"
    if solid:
        domain = MakeStructured3DMesh(hexes=False, nx=n, ny=n, nz=n)
    else:
        domain = MakeStructured2DMesh(quads=cell == "quadrilateral", nx=n, ny=n)
    d = 3 if solid else 2

    def contender(space: ng.FESpace, compiled: bool = False) -> Contender:
        u, v = space.TnT()
        strain, virtual = ng.Sym(ng.grad(u)), ng.Sym(ng.grad(v))
        form = ng.BilinearForm(space)
        work = ng.InnerProduct(2 * MU * strain + LAM * ng.Trace(strain) * ng.Id(d), virtual)
        if compiled:
            with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
                work = work.Compile(realcompile=True, wait=True)
        form += work * ng.dx
        form.Assemble()
        field = ng.GridFunction(space)
        plane = (ng.x + ng.y, ng.y) if order == 1 else (ng.x**2, ng.x * ng.y)
        field.Set(ng.CF((*plane, *([0] if solid else []))))
        energy = 0.5 * ng.InnerProduct((form.mat * field.vec).Evaluate(), field.vec)
        return field.vec.FV().NumPy().size, form.Assemble, energy

    blocks = ng.H1(domain, order=order, dim=d)
    return {
        "NGSolve form": contender(ng.VectorH1(domain, order=order)),
        "NGSolve blocks": contender(blocks),
        "NGSolve compiled": contender(blocks, compiled=True),
    }


def scikit_fem(cell: str, order: int, n: int) -> dict[str, Contender]:
    import skfem
    from skfem.models.elasticity import linear_elasticity

    grid = np.linspace(0, 1, n + 1)
    kinds = {
        ("triangle", 1): (skfem.MeshTri, skfem.ElementTriP1),
        ("triangle", 2): (skfem.MeshTri, skfem.ElementTriP2),
        ("quadrilateral", 2): (skfem.MeshQuad, skfem.ElementQuad2),
        ("tetrahedron", 1): (skfem.MeshTet, skfem.ElementTetP1),
        ("tetrahedron", 2): (skfem.MeshTet, skfem.ElementTetP2),
    }
    shape, element = kinds[cell, order]
    domain = shape.init_tensor(*[grid] * (3 if cell == "tetrahedron" else 2))
    basis = skfem.Basis(domain, skfem.ElementVector(element()), intorder=degree(cell, order))
    form = linear_elasticity(LAM, MU)
    u = np.zeros(basis.N)
    for i in range(domain.dim()):
        dofs = basis.split_indices()[i]
        u[dofs] = displacement(order, basis.doflocs[:, dofs])[i]
    energy = 0.5 * u @ (form.assemble(basis) @ u)
    return {
        "scikit-fem": (basis.N, lambda: form.assemble(basis), energy),
        "scikit-fem entries": (basis.N, lambda: form.coo_data(basis), energy),
    }


def main() -> None:
    makers = [ours]
    makers += [peer for module, peer in (("ngsolve", ngsolve), ("skfem", scikit_fem)) if find_spec(module)]
    for cell, order, n in CASES:
        contenders = {name: entry for make in makers for name, entry in make(cell, order, n).items()}
        least = dict.fromkeys(contenders, np.inf)
        for _ in range(ROUNDS):
            for name, (_, assemble, _) in contenders.items():
                start = time.process_time()
                assemble()
                least[name] = min(least[name], time.process_time() - start)
        print(f"\n{cell} of order {order}, {n} along an edge, {contenders['geofem'][0]} dofs")
        for name, (dofs, _, energy) in contenders.items():
            error = abs(energy / EXACT[order] - 1)
            # rounding: sums of up to 4 million entries, and NGSolve's projection of the displacement
            assert dofs == contenders["geofem"][0] and error < 1e-9, (name, dofs, error)
            ratio = least[name] / least["geofem"]
            print(
                f"  {name:20s} {least[name] * 1e3:8.1f} ms  {ratio:5.1f} x geofem   error of the energy {error:.0e}", flush=True
            )


if __name__ == "__main__":
    main()
