"""Material point methods: the body is a cloud of points, and momentum is solved for on a grid that forgets."""

from __future__ import annotations

from geofem import materials
from geofem.methods.mpm.kernels import SCHEMES
from geofem.methods.mpm.model import ExplicitMpm
from geofem.mistake import Mistake, unknown
from geofem.scene import MeshFile, Scene


class LinearMpm:
    """The method ``mpm-linear``: hat functions, explicit in time, in plane strain (Sulsky, Chen & Schreyer 1994).

    Where it ends: points that cross the borders of cells feel a jump of the gradient, so that the error of large motions
    grows as the grid is refined; a body stretched beyond ``ppc`` falls apart.
    """

    name = "mpm-linear"

    def refuses(self, scene: Scene) -> str | None:
        if scene.plane != "plane_strain":
            return f"{self.name} works in plane strain only, not in {scene.plane}"
        if any(load.kind in ("traction", "pressure") for load in scene.loads):
            return f"{self.name} takes no boundary traction yet"
        if any(isinstance(region.shape, MeshFile) for region in scene.regions):
            return f"{self.name} fills boxes, polygons and rings with points, not mesh files"
        if any(isinstance(support.where, str) for support in scene.supports):
            return f"{self.name} needs supports as predicates of position, not as groups of a mesh file"
        if scene.cracks:
            return f"{self.name} has no cracks"
        if scene.collapse or scene.weakening is not None:
            return f"{self.name} does not search for a collapse load"
        if not all(region.material.density > 0 for region in scene.regions):
            return f"{self.name} is explicit and needs a density in every region"
        from mpi4py import MPI

        return f"{self.name} runs on one rank" if MPI.COMM_WORLD.size > 1 else None

    def build(
        self,
        scene: Scene,
        *,
        n: int = 8,
        ppc: int = 2,
        flip: float | None = None,
        scheme: str = "musl",
        cfl: float = 0.3,
        damping: float | None = None,
        load_steps: int = 1,
        tolerance: float = 1e-4,
        sort_after: float = 1.0,
    ) -> ExplicitMpm:
        """The model of a scene.

        n : cells across the scene's length. ppc : points per cell in each direction.
        flip : share of FLIP in the update of velocities: 1 keeps the energy and the noise, 0 (PIC) damps both; by default
            1, and 0.99 in a scene without inertia.
        scheme : when the stress is updated: usf first, usl last, musl last with velocities mapped anew.
        cfl : step times (wave speed + largest speed) over the size of a cell.
        damping : local damping, the share of the out-of-balance force that acts against the motion (Cundall 1987); by default
            0, and 0.7 in a scene without inertia.
        load_steps : loads at which a scene without inertia is brought to rest, that is to a kinetic energy below ``tolerance``
            times the work of the loads. The fewer the better where points cross cells: each crossing leaves a strain behind.
        sort_after : the points are put in the order of their cells when they have crossed so many borders each, on average.

        Raises ``Mistake`` for a knob or a material out of range.
        """
        if scheme not in SCHEMES:
            raise unknown("scheme", scheme, SCHEMES)
        for knob, value in (("n", n), ("ppc", ppc), ("load_steps", load_steps)):
            if value != int(value) or value < 1:
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
        for region in scene.regions:
            materials.check(region.material, f"region {region.name}")
        return ExplicitMpm(scene, shape="linear", n=int(n), ppc=int(ppc), flip=flip, scheme=scheme, cfl=cfl, damping=damping,
                           load_steps=int(load_steps), tolerance=tolerance, sort_after=sort_after)  # fmt: skip
