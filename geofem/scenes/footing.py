"""Strip footing on clay, undrained: Prandtl's bearing capacity 2 + pi, or no limit load at all for elements that lock.

Set-up. A rough rigid footing of width B on weightless Tresca soil, cu = 1 Pa, E = 1000 cu, nu = 0.3, plane strain; the
right half only, 2.5 B wide and 2 B deep, base fixed, sides on rollers. The footing is pushed down by 0.03 B, well past
the onset of flow. Small strain by default; at finite strain the same settlement changes the load little.

Measured. `Nc`: the largest load in the run by B cu.

Reference. Exact (Prandtl 1920): 2 + pi = 5.14159, rough and smooth.

What must fail. Linear quadrilaterals lock: 25 to 40 % too high without a plateau; quadratic ones with full integration
end 13 % high. All others converge as the cell size only, whatever their order, because of the singular point at the
edge of the footing: grading cells towards it buys more than order. Pushed deep at finite strain, a mesh that follows
the material tangles at the edge; material points with linear shape functions show a checkerboard of pressure.

Length. The half width B/2.
"""

from __future__ import annotations

import numpy as np

from geofem.reference import reference
from geofem.scene import Box, History, Material, Measure, Probe, Region, Scene, Support
from geofem.scenes._parts import all_of, at_least, at_most, check_choice, check_number

CU = 1.0
SETTLEMENT = 0.03
"""Last settlement of the footing, as a fraction of its width."""


def scene(*, B: float = 2.0, strain: str = "small") -> Scene:
    """Knobs

    B : width of the footing (m); default 2. The domain grows with it, and Nc does not depend on it.
    strain : ``small`` or ``finite``; default ``small``.
    """
    check_number("footing", "B", B, 1e-3, 1e3)
    check_choice("footing", "strain", strain, ("small", "finite"))
    half, width, depth = 0.5 * B, 2.5 * B, 2.0 * B
    under = all_of(at_least(1, 0.0), at_most(0, half))

    def capacity(history: History) -> float:
        return float(np.max(-history["load"])) / (half * CU)

    return Scene(
        name="footing",
        regions=(
            Region(
                "ground",
                Box((0.0, -depth), (width, 0.0)),
                Material("tresca", 1000.0, {"E": 1000.0 * CU, "nu": 0.3, "c": CU}),
            ),
        ),
        length=half,
        supports=(
            Support("footing", under, (1,), lambda x, t: 0 * x[1] - SETTLEMENT * B * t),
            Support("roughness", under, (0,)),
            Support("symmetry", at_most(0, 0.0), (0,)),
            Support("side", at_least(0, width), (0,)),
            Support("base", at_most(1, -depth), (0, 1)),
        ),
        probes=(
            Probe("load", "reaction", component=1, of="footing"),
            Probe("settlement", "displacement", at=(0.0, 0.0), component=1),
        ),
        measures=(Measure("Nc", "-", capacity, reference=reference("g02_footing", "Nc")),),
        strain=strain,
        singular=((half, 0.0),),
        room=Box((0.0, -depth), (width, half)),
        at=lambda t: {"settlement": SETTLEMENT * B * t},
        savings={"symmetry": 0.5},
        knobs={"B": B, "strain": strain},
    )
