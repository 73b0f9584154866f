"""A smooth wedge is pressed into clay: plastic flow at any depth with an exact answer, the displaced lip included.

Set-up. A rigid smooth wedge of semi-angle `beta` sinks by d = 1 m into weightless Tresca soil, k = 1 Pa, G = Ir k, nu =
0.45, plane strain; it starts with its tip on the surface, so that at any time the picture is the same but for its size.
The right half only, between rollers, on a fixed base, three times as wide and twice as deep as the half width of the
contact and its lip at the end, and at least 10 d and 6 d.

Measured. `p_over_k`: the mean pressure on the wedge by k. The force F on the half wedge grows in proportion to the depth z;
its slope dF/dz, by least squares over all of the way but the first fifth, is divided by the half width of contact per depth. In an
exact solution any part of the way gives the same. Through a grid the force goes up in steps from cell to cell, of 0.02 of the last one
at 8 cells: a slope over four fifths of the way is known to 3 % then, over the second half to 8 %.

Reference. Exact for rigid-plastic soil (Hill, Lee and Tupper 1947): p = 2 k (1 + psi), where psi solves cos(2 beta - psi) =
cos psi / (1 + sin psi). The contact is z / (cos beta - sin(beta - psi)) long, as the soil that the wedge displaces lies
beside it as a lip with a straight surface. Elasticity makes the soil softer by a share of the order of 1 / Ir.

What must fail. A mesh that follows the material tangles at the tip and at the lip after a small part of the way. Contact
through a grid is felt one cell early, so that the force is that of a wedge deeper by up to a cell: an error that the slope
takes out, but for its steps from cell to cell.

Length. The depth of the tip at the end, d: n cells over it.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from geofem.reference import reference
from geofem.scene import Box, History, Material, Measure, Polygon, Probe, Region, Rigid, Scene, Support
from geofem.scenes._parts import at_least, at_most, check_number

DEPTH, STRENGTH, NU = 1.0, 1.0, 0.45


def fan_angle(beta: float) -> float:
    """Angle psi (rad) of the fans beside a wedge of semi-angle beta (rad): cos(2 beta - psi) = cos psi / (1 + sin psi)."""
    low, high = 0.0, beta  # the difference of both sides is negative at 0 and positive at beta
    for _ in range(60):
        psi = 0.5 * (low + high)
        if math.cos(2 * beta - psi) < math.cos(psi) / (1 + math.sin(psi)):
            low = psi
        else:
            high = psi
    return 0.5 * (low + high)


def pressure(beta: float) -> float:
    """Mean contact pressure over k."""
    return 2 * (1 + fan_angle(beta))


def contact_length(beta: float) -> float:
    """Length of the contact on one side over the depth of the tip; the lip's surface is as long, at beta - psi to the level."""
    return 1 / (math.cos(beta) - math.sin(beta - fan_angle(beta)))


def scene(*, beta: float = 45.0, Ir: float = 500.0) -> Scene:
    """Knobs

    beta : semi-angle of the wedge (degrees), 15 to 75; default 45.
    Ir : rigidity index G / k, dimensionless; default 500.
    """
    check_number("wedge", "beta", beta, 15.0, 75.0)
    check_number("wedge", "Ir", Ir, 50.0, 1e5)
    angle = math.radians(beta)
    length, psi = contact_length(angle), fan_angle(angle)
    half = length * math.sin(angle)  # half width of the contact over the depth
    lip = length * math.cos(angle - psi)  # width of the lip over the depth
    width, depth = max(10.0, 3 * (half + lip)) * DEPTH, max(6.0, 2 * (half + lip)) * DEPTH
    side, up = 1.5 * half * DEPTH, 1.5 * length * math.cos(angle) * DEPTH

    def pressure_over_strength(history: History) -> float:
        z = DEPTH * np.asarray(history["t"])
        if z[-1] < 0.5 * DEPTH:
            raise ValueError("the run ended before half the depth")
        last = z >= 0.2 * DEPTH
        if last.sum() < 2:  # a run in a single step tells its end only: the slope of the whole way
            last = z >= 0
        slope = float(np.polyfit(z[last], -np.asarray(history["load"])[last], 1)[0])
        return slope / (half * STRENGTH)

    return Scene(
        name="wedge",
        regions=(
            Region(
                "ground",
                Box((0.0, -depth), (width, 0.0)),
                Material("tresca", 1000.0, {"E": 2 * Ir * STRENGTH * (1 + NU), "nu": NU, "c": STRENGTH}),
            ),
        ),
        length=DEPTH,
        supports=(
            Support("symmetry", at_most(0, 0.0), (0,)),
            Support("side", at_least(0, width), (0,)),
            Support("base", at_most(1, -depth), (0, 1)),
        ),
        probes=(
            Probe("load", "reaction", component=1, of="wedge"),
            Probe("top", "quantile", component=1, share=1.0),
        ),
        measures=(
            Measure(
                "p_over_k",
                "-",
                pressure_over_strength,
                reference=replace(reference("g01_wedge", "p_over_k"), value=pressure(angle)),
            ),
        ),
        rigids=(Rigid("wedge", Polygon(((0.0, 0.0), (side, up), (-side, up))), lambda t: (0.0, -DEPTH * t)),),
        room=Box((0.0, -depth), (width, DEPTH)),
        at=lambda t: {"depth": DEPTH * t},
        savings={"symmetry": 0.5},
        knobs={"beta": beta, "Ir": Ir},
    )
