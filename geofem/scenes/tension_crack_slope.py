"""Tension crack behind the crest of a rock slope: how far water may rise in it before it runs on.

Set-up. A slope of height H = 60 m in rock of 2600 kg/m3, E = 10 GPa, nu = 0.25, plane strain, small strain, under its weight;
the base is fixed 60 m below the toe, the sides are on rollers, 90 m in front of the toe and 150 m behind the crest. A vertical
crack stands where and as deep as a slope that fails along a plane of the angle psi_p = 35 degrees is weakest (Hoek and Bray
1981): H ((cot psi_f cot psi_p)^(1/2) - cot psi_f) behind the crest and H (1 - (cot psi_f tan psi_p)^(1/2)) deep, psi_f being
the angle of the slope. From t = 0 to 1 water rises in it from the tip to the ground and presses on its faces; where they touch,
they do so without friction. Give the method some steps: each is a water level.

Measured. `KI` (Pa sqrt(m)) at the tip and `opening` of the mouth (m) with the crack full of water, and `critical`: height of the
water above the tip (m) at which K_I reaches the toughness.

Reference. Overkill: this method on a finer mesh in more steps, as no figures were published. Shallow cracks in level ground,
under water alone, have K_I = .6825 rho g a (pi a)^(1/2) (Tada, Paris and Irwin 1973), as the tests check.

What must fail. Without contact the faces of the dry crack run through each other, and water has to undo a negative K_I
before the crack opens: the critical level comes out too high. Without the terms of weight and of pressure on the faces, K
depends on the ring.

Length. The height of the slope, 60 m; cells shrink towards the tip and the toe, which are marked as singular.
"""

from __future__ import annotations

import math

import numpy as np

from geofem.reference import reference, table
from geofem.scene import Array, Crack, History, Load, Material, Measure, Polygon, Probe, Reference, Region, Scene, Support
from geofem.scenes._parts import at_least, at_most, check_choice, check_number

H, PLANE = 60.0, math.radians(35.0)
FRONT, BACK, BELOW = 90.0, 150.0, 60.0
"""Ground in front of the toe, behind the crest and below the toe (m)."""
ROCK, WATER, GRAVITY = 2600.0, 1000.0, 9.81
E, NU = 10e9, 0.25


def first(t: Array, values: Array, level: float) -> float:
    """Where values first reach a level, between the samples; nan if they never do."""
    above = np.flatnonzero(values >= level)
    if not len(above) or not above[0]:
        return math.nan
    k = int(above[0])
    return float(t[k - 1] + (level - values[k - 1]) / (values[k] - values[k - 1]) * (t[k] - t[k - 1]))


def scene(*, slope: float = 75.0, toughness: float = 5e5, contact: bool = True) -> Scene:
    """Knobs

    slope : angle of the slope, 60 to 85 degrees; default 75.
    toughness : K_Ic of the rock (Pa sqrt(m)), 1e4 to 1e8; default 5e5.
    contact : whether the faces feel each other; default True.
    """
    check_number("tension_crack_slope", "slope", slope, 60.0, 85.0)
    check_number("tension_crack_slope", "toughness", toughness, 1e4, 1e8)
    check_choice("tension_crack_slope", "contact", contact, (True, False))
    steep, flat = math.tan(math.radians(slope)), math.tan(PLANE)
    crest, depth = H / steep, H * (1.0 - math.sqrt(flat / steep))
    tip = (crest + H * (1.0 / math.sqrt(steep * flat) - 1.0 / steep), H - depth)
    left, right = -FRONT, crest + BACK
    corners = ((left, -BELOW), (right, -BELOW), (right, H), (crest, H), (0.0, 0.0), (left, 0.0))

    def water(x: Array, t: float) -> Array:
        return WATER * GRAVITY * np.maximum(tip[1] + t * depth - x[1], 0.0)

    def critical(h: History) -> float:
        return depth * first(h["t"], h["KI"], toughness)

    def known(name: str) -> Reference | None:
        key = f"slope{slope:g}_{name}" + (f"_{toughness:g}" if name == "critical" else "")
        return reference("tension_crack_slope", key) if contact and key in table("tension_crack_slope") else None

    return Scene(
        name="tension_crack_slope",
        regions=(Region("rock", Polygon(corners), Material("linear_elastic", ROCK, {"E": E, "nu": NU})),),
        length=H,
        supports=(
            Support("base_x", at_most(1, -BELOW), (0,)),
            Support("base_y", at_most(1, -BELOW), (1,)),
            Support("front", at_most(0, left), (0,)),
            Support("back", at_least(0, right), (0,)),
        ),
        loads=(Load("gravity", (0.0, -GRAVITY), amplitude=lambda t: 1.0),),
        cracks=(Crack(((tip[0], H + 1.0), tip), pressure=water, friction=0.0 if contact else None),),
        probes=(
            Probe("KI", "KI", at=tip),
            Probe("KII", "KII", at=tip),
            Probe("opening", "opening", at=(tip[0], H)),
        ),
        measures=(
            Measure("KI", "Pa sqrt(m)", lambda h: float(h["KI"][-1]), reference=known("KI")),
            Measure("opening", "m", lambda h: float(h["opening"][-1]), reference=known("opening")),
            Measure("critical", "m", critical, reference=known("critical")),
        ),
        strain="small",
        singular=(tip, (0.0, 0.0)),
        knobs={"slope": slope, "toughness": toughness, "contact": contact},
    )
