"""Finite elements on a mesh that is carried with the material: total and updated Lagrangian, quasi-static and dynamic."""

from __future__ import annotations

from mpi4py import MPI

from geofem import materials
from geofem.core import mesh as meshes
from geofem.core.forms import UFL_LAWS, Template
from geofem.methods import conforming
from geofem.methods.conforming.model import ConformingModel
from geofem.methods.lagrangian_model import LagrangianModel
from geofem.mistake import Mistake
from geofem.scene import Scene

CELLS = {"triangle": 2, "quadrilateral": 2, "tetrahedron": 3, "hexahedron": 3}
TENSOR = ("quadrilateral", "hexahedron")
ISOCHORIC = ("von_mises", "tresca", "mohr_coulomb", "drucker_prager")
"""Laws whose plastic flow locks elements that cannot keep their volume."""


class Fem:
    """Finite elements: Lagrange triangles, quadrilaterals, tetrahedra and hexahedra of order 1 to 3."""

    name = "fem"

    def refuses(self, scene: Scene) -> str | None:
        """Why this method cannot solve the scene, in a sentence; None if it can."""
        if scene.walls or scene.rigids:
            return "fem has no contact with walls or rigid bodies; use a material point method"
        if scene.inlets or scene.outlets:
            return "fem has no inlets and outlets; use pfem"
        if scene.cracks or scene.growth:
            return conforming.refuses(scene)
        if any(region.material.parameters.get("surface_tension") for region in scene.regions):
            return "fem has no surface tension; use pfem"
        if unknown := {probe.quantity for probe in scene.probes} & {
            "largest_speed",
            "pressure_error",
            "velocity_error",
            "volume",
        }:
            return f"fem does not measure {', '.join(sorted(unknown))}"
        laws = {region.material.law for region in scene.regions}
        if scene.plane == "plane_stress" and laws != {"linear_elastic"}:
            return "plane stress is there for linear_elastic only; use plane_strain"
        if scene.strain == "small" and (other := laws - {"linear_elastic", *ISOCHORIC}):
            return f"{', '.join(sorted(other))} is a law of finite strain, and the scene's strain is small"
        return None

    def build(
        self,
        scene: Scene,
        *,
        n: int = 8,
        order: int = 2,
        cell: str | None = None,
        formulation: str = "displacement",
        frame: str = "total",
        quadrature: str | None = None,
        grading: float | None = None,
        steps: int | None = None,
        rho_inf: float = 1.0,
        tolerance: float | None = None,
        quarter_point: bool | None = None,
        da: float | None = None,
    ) -> LagrangianModel | ConformingModel:
        """Discretise a scene.

        Parameters
        ----------
        n : cells across the scene's own length.
        order : of the displacement, 1 to 3 (2 at most on quadrilaterals and hexahedra).
        cell : triangle or quadrilateral, tetrahedron or hexahedron; by default simplices, and quadrilaterals for plastic laws.
        formulation : displacement, or mixed (displacement and a pressure of one order less, Taylor and Hood 1973).
        frame : total or updated (the mesh moves with the material; for finite strain).
        quadrature : full, or reduced (one point less per direction on quadrilaterals and hexahedra; the default for plastic laws).
        grading : exponent with which cells shrink towards the scene's singular points, and the tips of its cracks; 1 is uniform,
            2 the default for plastic laws, 3 with cracks.
        steps : load steps of a static scene (1 if it is linear, else 4), or time steps per period (25 n).
        rho_inf : spectral radius of generalised-alpha at infinite frequency; 1 damps nothing.
        tolerance : out-of-balance force relative to the forces that balance; 1e-9, and 1e-5 for plastic laws.
        quarter_point : of the cells around a crack tip, put the nodes on the sides to it at a quarter (Barsoum 1976); with cracks
            the default for orders 2 and 3.
        da : way of the fastest tip in a step (m), where cracks grow; a twentieth of the scene's length of growth by default. Each
            step has a mesh of its own.

        Bodies with cracks have linear elastic triangles that follow them; formulation, frame and the like stay as they are.

        Raises ``Mistake`` for knobs that do not fit the scene or each other.
        """
        if scene.cracks:
            self._check(scene, n, order, "triangle", "displacement", "total", grading or 1.0, steps)
            check_element(order, "triangle", quadrature)
            if (cell or "triangle", formulation, frame) != ("triangle", "displacement", "total"):
                raise Mistake(f"scene {scene.name} has cracks: leave the knobs cell, formulation and frame as they are")
            if scene.growth is not None and (steps is not None or not (da is None or da > 0)):
                raise Mistake(
                    f"knobs da = {da} and steps = {steps}: where cracks grow, each step is of da > 0 (m); leave steps"
                )
            if scene.growth is None and da is not None:
                raise Mistake(f"knob da = {da:g}: no crack of scene {scene.name} grows; give it a Growth, or use geofem.grow")
            return conforming.build(scene, n, order, grading, quarter_point, steps, da)
        for name, value in (("quarter_point", quarter_point), ("da", da)):
            if value is not None:
                raise Mistake(f"knob {name} = {value}: scene {scene.name} has no crack")
        plastic = any(region.material.law in ISOCHORIC for region in scene.regions)
        if cell is None:
            cell = (
                ("quadrilateral" if plastic else "triangle")
                if scene.gdim == 2
                else ("hexahedron" if plastic else "tetrahedron")
            )
        grading = grading if grading is not None else (2.0 if plastic else 1.0)
        self._check(scene, n, order, cell, formulation, frame, grading, steps)
        check_element(order, cell, quadrature)

        mixed = formulation == "mixed"
        for region in scene.regions:
            materials.check(region.material, f"region {region.name!r}", incompressible_ok=mixed)
        all_ufl = all(region.material.law in UFL_LAWS for region in scene.regions)
        updated = frame == "updated"
        body = meshes.build(MPI.COMM_WORLD, scene, n=n, cell=cell, grading=grading, geometry_order=order if updated else 1)
        # a mesh file brings cells of its own
        cell = body.mesh.topology.cell_name()
        check_element(order, cell, quadrature)
        quadrature = quadrature or ("reduced" if plastic and cell in TENSOR else "full")
        if updated and body.mesh.geometry.cmaps[0].degree != order:
            raise Mistake(
                f"knob frame = 'updated': the mesh file has cells of order {body.mesh.geometry.cmaps[0].degree}; use that order"
            )
        template = Template(
            cell=cell,
            geometry=body.mesh.ufl_domain().ufl_coordinate_element(),
            order=order,
            plane=scene.plane,
            strain=scene.strain,
            laws=tuple(region.material.law if all_ufl else "points" for region in scene.regions),
            mixed=mixed,
            updated=updated,
            degree=quadrature_degree(order, cell in TENSOR, quadrature == "reduced", scene.strain),
            followers=sum(load.kind == "pressure" for load in scene.loads),
        )
        linear = scene.strain == "small" and all_ufl
        if steps is None:
            steps = 25 * n if scene.dynamic else 1 if linear else 4
        tolerance = tolerance or (1e-5 if plastic else 1e-9)
        return LagrangianModel(scene, template, body, steps, rho_inf, tolerance, plastic)

    def _check(self, scene: Scene, n: int, order: int, cell: str, formulation: str, frame: str, grading: float,
               steps: int | None) -> None:  # fmt: skip
        """Raise ``Mistake`` for the first knob that cannot be."""
        choices = {
            "cell": (cell, tuple(CELLS)),
            "formulation": (formulation, ("displacement", "mixed")),
            "frame": (frame, ("total", "updated")),
        }
        for name, (value, known) in choices.items():
            if value not in known:
                raise Mistake(f"knob {name} = {value!r}: choose from {', '.join(known)}")
        if not isinstance(n, int) or n < 1:
            raise Mistake(f"knob n = {n}: the number of cells across the scene's length is a whole number, at least 1")
        if steps is not None and (not isinstance(steps, int) or steps < 1):
            raise Mistake(f"knob steps = {steps}: give a whole number, at least 1")
        fitting = [name for name, dimension in CELLS.items() if dimension == scene.gdim]
        if cell not in fitting:
            raise Mistake(f"knob cell = {cell!r}: scene {scene.name} is {scene.gdim}D; choose {' or '.join(fitting)}")
        if formulation == "mixed" and order < 2:
            raise Mistake("knob order = 1: the mixed form needs order 2 or 3, its pressure is one order less")
        if formulation == "mixed" and not all(region.material.law in UFL_LAWS for region in scene.regions):
            raise Mistake(f"knob formulation = 'mixed': is there for {' and '.join(UFL_LAWS)} only")
        if formulation == "mixed" and any(region.material.parameters["nu"] <= 0 for region in scene.regions):
            raise Mistake("knob formulation = 'mixed': needs Poisson's ratio above 0; use the displacement form")
        if frame == "updated" and scene.strain == "small":
            raise Mistake(
                f"knob frame = 'updated': scene {scene.name} has small strains, where the mesh does not move; use 'total'"
            )
        if not grading >= 1:
            raise Mistake(f"knob grading = {grading}: is an exponent of at least 1 (uniform cells)")


def check_element(order: int, cell: str, quadrature: str | None) -> None:
    """Raise ``Mistake`` for a combination that is no element."""
    top = 2 if cell in TENSOR else 3
    if order not in range(1, top + 1):
        raise Mistake(f"knob order = {order}: {cell}s come in orders 1 to {top}")
    if quadrature not in (None, "full", "reduced"):
        raise Mistake(f"knob quadrature = {quadrature!r}: choose from full, reduced")
    if quadrature == "reduced" and cell not in TENSOR:
        raise Mistake(
            f"knob quadrature = 'reduced': is for quadrilaterals and hexahedra; {cell}s have no rule of one point less"
        )


def quadrature_degree(order: int, tensor: bool, reduced: bool, strain: str) -> int:
    """Degree of exactness of the rule: order + 1 Gauss points per direction on tensor cells (one less if reduced).

    On simplices 2 (order - 1) integrates the stiffness of a linear law exactly; finite strains take two degrees more.
    """
    if tensor:
        return 2 * order - 1 if reduced else 2 * order
    return max(1, 2 * (order - 1)) + (2 if strain == "finite" and order > 1 else 0)
