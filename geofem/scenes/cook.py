"""Cook's membrane: a tapered panel, clamped at the left and sheared at the right; bending and near incompressibility.

Set-up. The quadrangle (0, 0), (48, 44), (48, 60), (0, 44), dimensionless; clamped at x = 0; a shear force F is spread
evenly over the right edge as a dead traction. Five variants: A: plane stress, E = 1, nu = 1/3, F = 1; B: plane strain,
E = 1.12499998125, nu = 0.499999975, F = 1; C: plane strain, E = 250, nu = 0.4999, F = 100; D: neo-Hookean, plane
strain, finite strain, E = 240.565, nu = 0.4999, F = 100; E: as D with nu = 0.3. A to C are linear elastic at small
strain.

Measured. `uy`: the vertical displacement of the middle of the right edge, (48, 52). The corner (48, 60) is not used:
its displacement gradient is singular under the traction.

Reference. Overkill: own finite elements of high order on meshes refined towards the corners; the uncertainty of each
value is with its source. Another nu than the variant's has none.

What must fail. Linear triangles and quadrilaterals in displacement form lock in B, C and D: the answer is far too low
on any mesh that one would like to pay for. Material points with linear shape functions lock alike, and their pressure
shows a checkerboard. Uniform meshes of any order converge slowly in the end, as the corners are singular.

Length. The clamped edge, 44: n cells across it mean a mapped mesh of n x n cells.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from geofem.reference import reference
from geofem.scene import Box, Load, Material, Measure, Polygon, Probe, Reference, Region, Scene, Support
from geofem.scenes._parts import at_least, at_most, check_choice, check_number

CORNERS = ((0.0, 0.0), (48.0, 44.0), (48.0, 60.0), (0.0, 44.0))
RIGHT_EDGE = 16.0


@dataclass(frozen=True)
class Variant:
    E: float
    nu: float
    F: float
    law: str = "linear_elastic"
    plane: str = "plane_strain"


VARIANTS = {
    "A": Variant(1.0, 1 / 3, 1.0, plane="plane_stress"),
    "B": Variant(1.12499998125, 0.499999975, 1.0),
    "C": Variant(250.0, 0.4999, 100.0),
    "D": Variant(240.565, 0.4999, 100.0, law="neo_hooke"),
    "E": Variant(240.565, 0.3, 100.0, law="neo_hooke"),
}


def scene(*, variant: str = "A", nu: float | None = None) -> Scene:
    """Knobs

    variant : material and load, ``A`` to ``E``; default ``A``.
    nu : Poisson's ratio, 0 to 0.5, with the shear modulus of the variant; by default the variant's own.
    """
    check_choice("cook", "variant", variant, VARIANTS)
    v = VARIANTS[variant]
    known: Reference | None = reference("v06_cook", f"{variant}_uy")
    if nu is not None and nu != v.nu:
        check_number("cook", "nu", nu, 0.0, 0.5)
        v = replace(v, E=v.E / (1 + v.nu) * (1 + nu), nu=nu)
        known = None
    return Scene(
        name="cook",
        regions=(Region("membrane", Polygon(CORNERS), Material(v.law, 1.0, {"E": v.E, "nu": v.nu})),),
        length=44.0,
        supports=(Support("clamp", at_most(0, 0.0), (0, 1)),),
        loads=(Load("traction", (0.0, v.F / RIGHT_EDGE), where=at_least(0, 48.0)),),
        probes=(Probe("uy", "displacement", at=(48.0, 52.0), component=1),),
        measures=(Measure("uy", "-", lambda history: float(history["uy"][-1]), reference=known),),
        plane=v.plane,
        strain="finite" if v.law == "neo_hooke" else "small",
        singular=CORNERS,
        room=Box((-11.0, -11.0), (66.0, 88.0)),
        dimensionless=True,
        knobs={"variant": variant, "nu": nu},
    )
