"""Clamped plate with a crack from its side, sheared at its end: both modes at once, from a paper that many compare with.

Set-up. A plate of 7 x 16 in, E = 30e6 psi, nu = 0.25, plane strain, small strain; clamped at its foot, with a uniform
shear traction of 1 psi along its top. A crack of 3.5 in runs from the left side at mid height, where the bending opens it.

Measured. The stress intensity factors `KI` and `KII` (psi sqrt(in)).

Reference. Overkill: own finite elements of third order, strongly refined; Yau, Wang and Corten (1980) give 34.0 and 4.55.

What must fail. Finite elements on uniform meshes; in particular the smaller factor, K_II, depends on where it is taken.

Length. The width of the plate, 7 in; cells may shrink towards the tip. With xfem, n = 70, grading = 1.5 and radius = 2.4 give
both factors within 0.1 % with less than 20 000 dofs; the defaults are 0.11 % off there.
"""

from __future__ import annotations

from geofem.reference import reference
from geofem.scene import Crack, Load, Material, Measure, Polygon, Probe, Region, Scene, Support
from geofem.scenes._parts import at_least, at_most

WIDTH, HEIGHT, DEPTH = 7.0, 16.0, 3.5
E, NU = 30e6, 0.25
CORNERS = ((0.0, 0.0), (WIDTH, 0.0), (WIDTH, 0.5 * HEIGHT), (WIDTH, HEIGHT), (0.0, HEIGHT))
"""The middle of a side is a corner of an unstructured mesh, which a plain rectangle would not get."""


def scene() -> Scene:
    """Knobs

    none.
    """
    tip = (DEPTH, 0.5 * HEIGHT)
    return Scene(
        name="shear_edge_crack",
        regions=(Region("plate", Polygon(CORNERS), Material("linear_elastic", 1.0, {"E": E, "nu": NU})),),
        length=WIDTH,
        supports=(Support("foot", at_most(1, 0.0), (0, 1)),),
        loads=(Load("traction", (1.0, 0.0), where=at_least(1, HEIGHT)),),
        cracks=(Crack(((-1.0, tip[1]), tip)),),
        probes=(Probe("KI", "KI", at=tip), Probe("KII", "KII", at=tip)),
        measures=(
            Measure("KI", "psi sqrt(in)", lambda h: float(h["KI"][-1]), reference=reference("c02_shear_edge_crack", "KI")),
            Measure("KII", "psi sqrt(in)", lambda h: float(h["KII"][-1]), reference=reference("c02_shear_edge_crack", "KII")),
        ),
        strain="small",
        singular=(tip,),
        dimensionless=True,
    )
