"""Strip footing on clay, undrained: Prandtl's bearing capacity 2 + pi, or no limit load at all for elements that lock.

Set-up. A rough rigid footing of width B on weightless Tresca soil, cu = 1 Pa, E = 1000 cu, nu = 0.3, plane strain; the
right half only, 2.5 B wide and 2 B deep, base fixed, sides on rollers. The footing is pushed down by `depth` B, 0.03 by
default: well past the onset of flow. Small strain by default; at finite strain the same settlement changes the load
little. Pushed deeper than that, at finite strain, it is a rigid block that the ground touches and may part from, and the
ground is 5 B wide and 4 B deep.

Measured. `Nc`: the largest load in the run by B cu; when pushed deep, the mean load over the last tenth of the way.

Reference. Exact (Prandtl 1920): 2 + pi = 5.14159, rough and smooth. When pushed deep there is none: the trench above the
footing stands open and the ground has heaved beside it. Prandtl's value remains a lower bound, and a strip buried at z
bears 1 + 0.2 z / B times it (Skempton 1951).

What must fail. Linear quadrilaterals lock: 25 to 40 % too high without a plateau; quadratic ones with full integration
end 13 % high. All others converge as the cell size only, whatever their order, because of the singular point at the
edge of the footing: grading cells towards it buys more than order. Pushed deep at finite strain, a mesh that follows
the material tangles at the edge; material points with linear shape functions show a checkerboard of pressure.

Length. The half width B/2.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from geofem.mistake import Mistake
from geofem.reference import reference
from geofem.scene import Box, History, Material, Measure, Polygon, Probe, Region, Rigid, Scene, Support
from geofem.scenes._parts import all_of, at_least, at_most, check_choice, check_number

CU = 1.0
SETTLEMENT = 0.03
"""Settlement of the footing by its width to which it is a support on the ground's surface; deeper, it is a block."""


def scene(*, B: float = 2.0, strain: str = "small", depth: float = SETTLEMENT) -> Scene:
    """Knobs

    B : width of the footing (m); default 2. The domain grows with it, and Nc does not depend on it.
    strain : ``small`` or ``finite``; default ``small``.
    depth : last settlement of the footing by its width, dimensionless; default 0.03. More than that asks for strain ``finite``.
    """
    check_number("footing", "B", B, 1e-3, 1e3)
    check_choice("footing", "strain", strain, ("small", "finite"))
    check_number("footing", "depth", depth, 1e-3, 1.0)
    if depth > SETTLEMENT and strain == "small":
        raise Mistake(f"scene footing: depth = {depth:g} is more than {SETTLEMENT:g}, so set strain to finite")
    shallow = on_surface(B, strain, depth)
    return shallow if depth <= SETTLEMENT else pushed_deep(shallow, B, depth)


def ground(width: float, depth: float) -> Region:
    clay = Material("tresca", 1000.0, {"E": 1000.0 * CU, "nu": 0.3, "c": CU})
    return Region("ground", Box((0.0, -depth), (width, 0.0)), clay)


def around(width: float, depth: float) -> tuple[Support, ...]:
    """What holds the ground on its other sides."""
    return (
        Support("symmetry", at_most(0, 0.0), (0,)),
        Support("side", at_least(0, width), (0,)),
        Support("base", at_most(1, -depth), (0, 1)),
    )


def on_surface(B: float, strain: str, settlement: float) -> Scene:
    """The footing as a support that holds on to the surface; ``settlement`` by its width."""
    half, width, depth = 0.5 * B, 2.5 * B, 2.0 * B
    under = all_of(at_least(1, 0.0), at_most(0, half))

    def capacity(history: History) -> float:
        return float(np.max(-history["load"])) / (half * CU)

    return Scene(
        name="footing",
        regions=(ground(width, depth),),
        length=half,
        supports=(
            Support("footing", under, (1,), lambda x, t: 0 * x[1] - settlement * B * t),
            Support("roughness", under, (0,)),
            *around(width, depth),
        ),
        probes=(
            Probe("load", "reaction", component=1, of="footing"),
            Probe("settlement", "displacement", at=(0.0, 0.0), component=1),
        ),
        measures=(Measure("Nc", "-", capacity, reference=reference("g02_footing", "Nc")),),
        strain=strain,
        singular=((half, 0.0),),
        room=Box((0.0, -depth), (width, half)),
        at=lambda t: {"settlement": settlement * B * t},
        savings={"symmetry": 0.5},
        knobs={"B": B, "strain": strain, "depth": settlement},
    )


def pushed_deep(shallow: Scene, B: float, settlement: float) -> Scene:
    """The footing as a rough rigid block that the ground touches; what is left of the scene is as with ``on_surface``."""
    half, width, depth = 0.5 * B, 5.0 * B, 4.0 * B
    height = (settlement + 0.5) * B

    def capacity(history: History) -> float:
        last = np.asarray(history["t"]) >= 0.9
        if not last.any():
            raise ValueError("the run ended before the last tenth of the way")
        return float(np.mean(-np.asarray(history["load"])[last])) / (half * CU)

    block = Polygon(((-half, 0.0), (half, 0.0), (half, height), (-half, height)))
    return replace(
        shallow,
        regions=(ground(width, depth),),
        supports=around(width, depth),
        measures=(Measure("Nc", "-", capacity, reference=reference("g08_deep_footing", "Nc")),),
        rigids=(Rigid("footing", block, lambda t: (0.0, -settlement * B * t), math.inf),),
        room=Box((0.0, -depth), (width, B)),
    )
