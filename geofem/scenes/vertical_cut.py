"""Vertical cut in clay, undrained: how high it can stand, where textbooks give the slip circle's 3.83.

Set-up. A cut of height H = 1 m in Tresca soil, cu = 1 Pa, E = 1000 cu, nu = 0.49 (so that the ground is nearly
hydrostatic at rest), plane strain; base fixed, sides on rollers. Gravity grows until no equilibrium is found; t is
gamma H / cu itself. The soil bears tension up to its strength: no tension cut-off.

Measured. `N`: gamma H / cu at collapse.

Reference. Bracket of limit analysis, 3.7752 <= N <= 3.7776 (Kammoun, Pastor, Smaoui and Pastor 2010); a slip circle
gives only the upper bound 3.8313, 1.4 % high. The error is the distance to the bracket.

What must fail. Elements that lock stand too high, linear triangles above all. A run that stops converging for another
reason than collapse gives a value that is too low: non-convergence is not failure of the ground. After collapse only
methods that outlive large strain (MPM, PFEM) can go on.

Length. The height of the cut, 1 m.
"""

from __future__ import annotations

from geofem.reference import reference
from geofem.scene import Load, Material, Measure, Polygon, Probe, Region, Scene, Support
from geofem.scenes._parts import any_of, at_least, at_most, check_number

H, CU = 1.0, 1.0


def scene(*, front: float = 1.2, back: float = 2.2, depth: float = 0.8) -> Scene:
    """Knobs

    front : ground in front of the cut, by its height, dimensionless; default 1.2.
    back : ground behind the cut, by its height, dimensionless; default 2.2. The slip surface comes up within 1.
    depth : ground below the toe, by its height, dimensionless; default 0.8.
    """
    check_number("vertical_cut", "front", front, 0.2, 10.0)
    check_number("vertical_cut", "back", back, 1.2, 10.0)
    check_number("vertical_cut", "depth", depth, 0.2, 10.0)
    left, right, bottom = -front * H, back * H, -depth * H
    corners = ((left, bottom), (right, bottom), (right, H), (0.0, H), (0.0, 0.0), (left, 0.0))
    return Scene(
        name="vertical_cut",
        regions=(Region("ground", Polygon(corners), Material("tresca", 1.0, {"E": 1000.0 * CU, "nu": 0.49, "c": CU})),),
        length=H,
        supports=(
            Support("base", at_most(1, bottom), (0, 1)),
            Support("sides", any_of(at_most(0, left), at_least(0, right)), (0,)),
        ),
        loads=(Load("gravity", (0.0, -1.0), amplitude=lambda t: t),),
        probes=(Probe("crest", "displacement", at=(0.0, H), component=1),),
        measures=(Measure("N", "-", lambda history: float(history["t"][-1]), reference=reference("g04_vertical_cut", "N")),),
        strain="small",
        t_end=5.0,
        singular=((0.0, 0.0),),
        collapse=True,
        knobs={"front": front, "back": back, "depth": depth},
    )
