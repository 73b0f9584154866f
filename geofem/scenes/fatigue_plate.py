"""Plate that fatigues: the cycles a crack from its side takes to grow, against the integral of Paris' law.

Set-up. A steel plate 100 mm wide and 300 mm high, E = 200 GPa, nu = 0.3, plane strain, small strain, with a crack of 20 mm
from the left side at mid height. A tension of 50 MPa at both ends pulsates from zero; the plate is held along short pieces of
its sides at the lower right corner. The crack grows by da/dN = C dK^m with C = 1e-11 and m = 3 (m per cycle, MPa sqrt(m)).

Measured. The `cycles` until the crack is 40 mm deep, and KI there.

Reference. Exact integral of Paris' law with the factor of Gross and Srawley (1964) and Brown and Srawley (1966), K = sigma
sqrt(pi a) (1.12 - 0.231 s + 10.55 s^2 - 21.72 s^3 + 30.39 s^4), s = a / W: good to 0.5 % in K, so that cycles are known within 1.5 %.

What must fail. Steps that hold the rate of their beginning count too many cycles, by the half of what it grows in a step.

Length. The width of the plate, 0.1 m; cells may shrink towards the tip at the end.
"""

from __future__ import annotations

import math

import numpy as np

from geofem.scene import Crack, Growth, Load, Material, Measure, Polygon, Probe, Reference, Region, Scene, Support
from geofem.scenes._parts import all_of, at_least, at_most, check_number

E, NU = 200e9, 0.3
W, H = 0.1, 0.3
FIRST, LAST = 0.02, 0.04
STRESS = 50e6
C = 1e-11
"""Of Paris' law, for K in MPa sqrt(m)."""
PIECE = 0.025
"""Length of the sides that are held at the corner (m)."""
SOURCE = "Paris' law integrated with the polynomial of Gross and Srawley (1964), Brown and Srawley (1966): K within 0.5 %"


def intensity(a: np.ndarray | float) -> np.ndarray | float:
    """K_I (Pa sqrt(m)) of a crack of depth a (m): Gross and Srawley 1964, Brown and Srawley 1966."""
    s = a / W
    return STRESS * np.sqrt(math.pi * a) * (1.12 - 0.231 * s + 10.55 * s**2 - 21.72 * s**3 + 30.39 * s**4)


def lifetime(m: float) -> float:
    """The cycles from the first to the last depth, by Gauss's rule."""
    x, w = np.polynomial.legendre.leggauss(20)
    a = 0.5 * (FIRST + LAST) + 0.5 * (LAST - FIRST) * x
    return float(0.5 * (LAST - FIRST) * w @ (1.0 / (C * (1e-6 * intensity(a)) ** m)))


def scene(*, m: float = 3.0) -> Scene:
    """Knobs

    m : exponent of Paris' law, 2 to 5; default 3.
    """
    check_number("fatigue_plate", "m", m, 2.0, 5.0)
    low, high = -0.5 * H, 0.5 * H
    corners = ((0.0, low), (W - PIECE, low), (W, low), (W, low + PIECE), (W, high), (0.0, high))
    bottom, top, right = at_most(1, low), at_least(1, high), at_least(0, W)
    tip = (FIRST, 0.0)
    return Scene(
        name="fatigue_plate",
        regions=(Region("plate", Polygon(corners), Material("linear_elastic", 7850.0, {"E": E, "nu": NU})),),
        length=W,
        supports=(
            Support("corner_x", all_of(right, at_most(1, low + PIECE)), (0,)),
            Support("corner_y", all_of(bottom, at_least(0, W - PIECE)), (1,)),
        ),
        loads=(Load("traction", (0.0, STRESS), where=top), Load("traction", (0.0, -STRESS), where=bottom)),
        cracks=(Crack(((-0.01, 0.0), tip)),),
        growth=Growth(LAST - FIRST, paris=(C * 1e-6**m, m)),
        probes=(Probe("KI", "KI", at=tip), Probe("cycles", "cycles")),
        measures=(
            Measure("cycles", "-", lambda h: float(h["cycles"][-1]), reference=Reference("exact", SOURCE, lifetime(m))),
            Measure(
                "KI", "Pa sqrt(m)", lambda h: float(h["KI"][-1]), reference=Reference("exact", SOURCE, float(intensity(LAST)))
            ),
        ),
        strain="small",
        singular=((LAST, 0.0),),
        knobs={"m": m},
    )
