"""Material point methods: the body is a cloud of points, and momentum is solved for on a grid that forgets."""

from __future__ import annotations

import inspect
from typing import Any

from geofem import materials
from geofem.methods.mpm.implicit import ImplicitMpm
from geofem.methods.mpm.kind import SCHEMES
from geofem.methods.mpm.model import ExplicitMpm
from geofem.mistake import Mistake, unknown
from geofem.scene import Scene

TRANSFERS = ("flip", "pic", "apic", "xpic")
SOLVERS = ("explicit", "implicit")
ONLY = {
    "explicit": (
        "transfer", "flip", "xpic", "scheme", "cfl", "damping", "small_mass", "passages", "sort_after", "threads", "dt_control",
    ),
    "implicit": ("ghost",),
}  # fmt: skip
"""Knobs that say something to one solver only."""
GHOST, GHOST_PLASTIC = 0.03, 1e-3
"""Default of the knob ``ghost``. Elastic bodies: the condition of their slivers. What flows strains by several per cent in a step,
at which 0.03 times an elastic modulus is many times the strength: a wedge in clay met 1.6 cells of soil that is not there."""


class Mpm:
    """What all material point methods share; a subclass names its shape functions."""

    name = "mpm"
    kernels = {"": ""}
    """What the knob ``kernel`` may say -> the shape functions; the first is the default."""
    scheme = "usl"
    small_mass = 1e-2

    def refuses(self, scene: Scene) -> str | None:
        """Why this method cannot solve the scene, in a sentence; None if it can."""
        if scene.plane == "plane_stress":
            return f"{self.name} works in plane strain, axial symmetry and space, not in plane stress"
        if any(load.kind in ("traction", "pressure") for load in scene.loads):
            return f"{self.name} takes no boundary traction yet"
        if any(isinstance(support.where, str) for support in scene.supports):
            return f"{self.name} needs supports as predicates of position, not as groups of a mesh file"
        if scene.cracks or scene.growth:
            return f"{self.name} has no cracks"
        if scene.collapse:
            return f"{self.name} does not search for a collapse load"
        if scene.inlets or scene.outlets:
            return f"{self.name} has no inlets and outlets; use pfem"
        if scene.rigids and scene.plane != "plane_strain":
            return f"{self.name} touches rigid bodies in plane strain only"
        if any(region.material.parameters.get("surface_tension") for region in scene.regions):
            return f"{self.name} has no surface tension; use pfem"
        if not all(region.material.density > 0 for region in scene.regions):
            return f"{self.name} is explicit and needs a density in every region"
        return None

    def build(
        self,
        scene: Scene,
        *,
        n: int = 8,
        ppc: int = 2,
        kernel: str | None = None,
        transfer: str = "flip",
        flip: float | None = None,
        xpic: int = 2,
        scheme: str | None = None,
        cfl: float = 0.3,
        damping: float | None = None,
        small_mass: float | None = None,
        cure: str = "none",
        split: float = 0.0,
        load_steps: int | None = None,
        passages: float | None = None,
        tolerance: float | None = None,
        sort_after: float = 1.0,
        threads: int = 1,
        dt_control: str = "courant",
        solver: str = "explicit",
        ghost: float | None = None,
    ) -> ExplicitMpm | ImplicitMpm:
        """The model of a scene.

        n : cells across the scene's length. ppc : points per cell in each direction.
        kernel : of mpm-gimp uniform (domains keep their size) or contiguous (they stretch with the points); of mpm-bspline
            quadratic or cubic.
        transfer : flip (the grid's acceleration is added), pic (its velocity is taken), apic (and its gradient: Jiang et al. 2015),
            xpic (flip without what the grid does not see: Hammerquist and Nairn 2017).
        flip : share of flip in its blend with pic: 1 keeps the energy and the noise; by default 1, and 0.99 in a scene without
            inertia. xpic : its order m; 1 is pic, and flip the limit.
        scheme : when the stress is updated: usf first, usl last, musl last with velocities mapped anew.
        cfl : step times (wave speed + largest speed) over the size of a cell; the wave speed is that of the deformed material.
        damping : local damping, the share of the out-of-balance force that acts against the motion (Cundall 1987); by default
            0, and 0.7 in a scene without inertia.
        small_mass : nodes with less than this share of a point's mass move as one with their heaviest neighbour.
        cure : none, or cell: volumetric strain and mean stress are averaged over the points of a cell, against locking.
        split : a point is split in two when its domain is longer than so many cells; 0 never.
        load_steps : (explicit: 1) loads at which a scene without inertia is brought to rest, that is to a kinetic energy below
            ``tolerance`` (1e-4) times the work of the loads. The fewer the better where points cross cells: each crossing leaves a strain.
        passages : push the load on steadily instead, all of it in so many passages of a wave through the body.
        sort_after : the points are put in the order of their cells when they have crossed so many borders each, on average.
        threads : of the passes over points and nodes.
        dt_control : courant (see ``cfl``), or nodal: ``cfl`` is the share of the critical step, which is bounded node by node every
            few steps and falls where a body barely reaches a node, for an extra half of the work.
        solver : explicit, or implicit for a scene without inertia: Newton's method on the active cells of the grid, in ``load_steps``
            (10) steps, to an out-of-balance force of ``tolerance`` (1e-9, plastic laws 1e-5) times the forces that balance. The
            other knobs of both solvers are n, ppc, kernel, cure and split.
        ghost : (implicit) stiffness of the penalty on jumps of the gradient around nodes that carry next to nothing, as a share of
            the material's (see ``ghost``); by default 0.03, and 0.001 with plastic laws, as what flows meets the penalty of an
            elastic body and not that of its strength. 0 for none.

        Raises ``Mistake`` for a knob or a material out of range.
        """
        told = dict(locals())
        if solver not in SOLVERS:
            raise unknown("solver", solver, SOLVERS)
        self._refuse_idle(told)
        implicit, plastic = solver == "implicit", any(materials.LAWS[r.material.law].history for r in scene.regions)
        if implicit and scene.dynamic:
            raise Mistake(
                f"{self.name}: solver=implicit is for bodies at rest, and scene {scene.name} is in motion; use explicit"
            )
        load_steps = load_steps if load_steps is not None else (10 if implicit else 1)
        if tolerance is None:
            tolerance = (1e-5 if plastic else 1e-9) if implicit else 1e-4
        ghost = ghost if ghost is not None else (GHOST_PLASTIC if plastic else GHOST)
        kernel = kernel or next(iter(self.kernels))
        if kernel not in self.kernels:
            raise unknown(f"kernel of {self.name}", kernel, self.kernels)
        scheme = scheme or self.scheme
        if scheme not in SCHEMES:
            raise unknown("scheme", scheme, SCHEMES)
        if transfer not in TRANSFERS:
            raise unknown("transfer", transfer, TRANSFERS)
        if cure not in ("none", "cell"):
            raise unknown("cure", cure, ("none", "cell"))
        if dt_control not in ("courant", "nodal"):
            raise unknown("dt_control", dt_control, ("courant", "nodal"))
        for knob, value in (("n", n), ("ppc", ppc), ("load_steps", load_steps), ("xpic", xpic), ("threads", threads)):
            if not isinstance(value, int | float) or value != int(value) or value < 1:
                raise Mistake(f"{self.name}: {knob} = {value!r} must be a whole number from 1 on")
        if flip is None:
            flip = 1.0 if scene.dynamic else 0.99
        if not 0 <= flip <= 1:
            raise Mistake(f"{self.name}: flip = {flip:g} must lie in [0, 1]")
        if not (cfl > 0 and tolerance > 0 and sort_after > 0):
            raise Mistake(f"{self.name}: cfl, tolerance and sort_after must be positive")
        if damping is None:
            damping = 0.0 if scene.dynamic else 0.7
        if not 0 <= damping < 1:
            raise Mistake(f"{self.name}: damping = {damping:g} must lie in [0, 1)")
        small_mass = self.small_mass if small_mass is None else small_mass
        if not 0 <= small_mass <= 0.5:
            raise Mistake(f"{self.name}: small_mass = {small_mass:g} must lie in [0, 0.5]")
        if split != 0 and not split > 0.5:
            raise Mistake(f"{self.name}: split = {split:g} must be 0 (never) or more than half a cell")
        if passages is not None and not passages > 0:
            raise Mistake(f"{self.name}: passages = {passages:g} must be positive")
        for region in scene.regions:
            materials.check(region.material, f"region {region.name}")
        if implicit:
            if not ghost >= 0:
                raise Mistake(f"{self.name}: ghost = {ghost:g} must not be negative")
            return ImplicitMpm(
                scene, shape=self.kernels[kernel], n=int(n), ppc=int(ppc), cure=cure == "cell", split=split,
                load_steps=int(load_steps), tolerance=tolerance, penalty=ghost, plastic=plastic,
            )  # fmt: skip
        return ExplicitMpm(
            scene, shape=self.kernels[kernel], n=int(n), ppc=int(ppc), transfer="flip" if transfer == "pic" else transfer,
            flip=0.0 if transfer == "pic" else flip, order=int(xpic), scheme=scheme, cfl=cfl, damping=damping,
            small_mass=small_mass, cure=cure == "cell", split=split, load_steps=int(load_steps), passages=passages,
            tolerance=tolerance, sort_after=sort_after, threads=int(threads), dt_control=dt_control,
        )  # fmt: skip

    def _refuse_idle(self, told: dict[str, Any]) -> None:
        """Raises ``Mistake`` if a knob is set that the chosen solver does not know."""
        solver = told["solver"]
        other = next(name for name in SOLVERS if name != solver)
        for knob in ONLY[other]:
            if told[knob] != inspect.signature(Mpm.build).parameters[knob].default:
                raise Mistake(
                    f"{self.name}: {knob} = {told[knob]!r} says nothing to solver={solver}; leave it out, or set solver={other}"
                )


class LinearMpm(Mpm):
    """``mpm-linear``: hat functions (Sulsky, Chen & Schreyer 1994).

    Where it ends: points that cross the borders of cells feel a jump of the gradient, so that the error of large motions
    grows as the grid is refined; a body stretched beyond ``ppc`` falls apart.
    """

    name = "mpm-linear"
    kernels = {"linear": "hat"}
    scheme = "musl"
    small_mass = 1e-4


class GimpMpm(Mpm):
    """``mpm-gimp``: hats averaged over the domain of each point (Bardenhagen & Kober 2004)."""

    name = "mpm-gimp"
    kernels = {"uniform": "gimp", "contiguous": "cpgimp"}


class CpdiMpm(Mpm):
    """``mpm-cpdi``: hats interpolated over parallelograms that deform with the points (Sadeghirad, Brannon & Burghardt 2011)."""

    name = "mpm-cpdi"
    kernels = {"parallelogram": "cpdi"}


class Cpdi2Mpm(Mpm):
    """``mpm-cpdi2``: hats interpolated over quadrilaterals that keep touching (Sadeghirad, Brannon & Guilkey 2013)."""

    name = "mpm-cpdi2"
    kernels = {"quadrilateral": "cpdi2"}

    def refuses(self, scene: Scene) -> str | None:
        return super().refuses(scene) or ("mpm-cpdi2 has quadrilaterals, not hexahedra" if scene.gdim == 3 else None)


class BsplineMpm(Mpm):
    """``mpm-bspline``: quadratic or cubic B-splines (Steffen, Kirby & Berzins 2008)."""

    name = "mpm-bspline"
    kernels = {"quadratic": "bspline2", "cubic": "bspline3"}
