"""Slope stability by strength reduction: the factor of safety of three slopes of 2:1.

Set-up. A slope of height H = 1 m, two horizontal to one vertical, unit weight 1 N/m3, plane strain; base fixed, sides
on rollers. Up to t = 1 gravity is turned on; from then on the strength, c and tan(phi), is divided by t until no
equilibrium is found. Three cases, after Griffiths and Lane 1999:
`ex1`: c = 0.05 gamma H, phi = 20 degrees, E = 500 gamma H, nu = 0.3, the toe on a firm base, 1.2 H of ground behind the
crest;
`ex2`: the same soil with 0.5 H of ground below the toe and 1.2 H in front;
`undrained`: Tresca, cu = 0.25 gamma H, nu = 0.49, 1 H of ground below the toe, 1.5 H in front and behind.

Measured. `FoS`: the factor by which the strength was divided at collapse.

Reference. Brackets of limit analysis (own lower and upper bounds): 1.375 to 1.398, 1.355 to 1.368, 1.410 to 1.466; they
hold for associated flow, and for a dilation angle of zero are a good guide. The error is the distance to the bracket.

What must fail. Linear triangles are too stiff: the factor of safety comes out high. A run that stops converging for
another reason gives a value that is too low. Explicit material points see collapse as motion: where it is said to begin
depends on the cell size and the damping; but they alone, with PFEM, can follow the slide.

Length. The height of the slope, 1 m.
"""

from __future__ import annotations

from dataclasses import dataclass

from geofem.mistake import Mistake
from geofem.reference import reference
from geofem.scene import Load, Material, Measure, Polygon, Probe, Region, Scene, Support
from geofem.scenes._parts import any_of, at_least, at_most, check_choice, check_number

H, CREST = 1.0, 2.0
"""Height of the slope, and the distance from the toe (0, 0) to below the crest (m)."""
WEAKEST = 2.5
"""The run ends at this factor if the slope has not failed."""


@dataclass(frozen=True)
class Case:
    """depth of ground below the toe, front and back of the slope (m)."""

    depth: float
    front: float
    back: float
    law: str
    E: float
    nu: float
    strength: dict[str, float]


C_PHI = {"c": 0.05, "phi": 20.0}
CASES = {
    "ex1": Case(0.0, 0.0, 1.2, "mohr_coulomb", 500.0, 0.3, C_PHI),
    "ex2": Case(0.5, 1.2, 1.2, "mohr_coulomb", 500.0, 0.3, C_PHI),
    "undrained": Case(1.0, 1.5, 1.5, "tresca", 500.0, 0.49, {"c": 0.25}),
}


def outline(case: Case) -> Polygon:
    """The ground. On a firm base it has four corners and a fifth one below the crest, so that no one takes it for the image
    of a square: n by n cells of such a map would be long ones."""
    right = CREST + case.back
    top = ((right, H), (CREST, H), (0.0, 0.0))
    if case.depth == 0:
        return Polygon(((CREST, 0.0), (right, 0.0), *top))
    return Polygon(((-case.front, -case.depth), (right, -case.depth), *top, (-case.front, 0.0)))


def scene(*, case: str = "ex1", psi: float = 0.0) -> Scene:
    """Knobs

    case : ``ex1``, ``ex2`` (c and phi) or ``undrained`` (Tresca); default ``ex1``.
    psi : dilation angle (degrees), at most phi and zero for ``undrained``; default 0.
    """
    check_choice("slope", "case", case, CASES)
    ground = CASES[case]
    check_number("slope", "psi", psi, 0.0, 20.0)
    if psi > 0 and ground.law == "tresca":
        raise Mistake("scene slope: case undrained flows at constant volume, so leave psi at 0")
    dilation = {"psi": psi} if ground.law == "mohr_coulomb" else {}
    right = CREST + ground.back
    sides = at_least(0, right) if case == "ex1" else any_of(at_most(0, -ground.front), at_least(0, right))
    return Scene(
        name="slope",
        regions=(
            Region(
                "ground",
                outline(ground),
                Material(ground.law, 1.0, {"E": ground.E, "nu": ground.nu, **ground.strength, **dilation}),
            ),
        ),
        length=H,
        supports=(
            Support("base", at_most(1, -ground.depth), (0, 1)),
            Support("sides", sides, (0,)),
        ),
        loads=(Load("gravity", (0.0, -1.0), amplitude=lambda t: min(t, 1.0)),),
        probes=(Probe("crest", "displacement", at=(CREST, H), component=1),),
        measures=(Measure("FoS", "-", lambda history: float(history["t"][-1]), reference=reference("g03_slope", case)),),
        strain="small",
        t_end=WEAKEST,
        singular=((0.0, 0.0),),
        collapse=True,
        weakening=lambda t: max(1.0, t),
        knobs={"case": case, "psi": psi},
    )
