"""Expansion of a cylindrical cavity in clay, undrained: large plastic strain with an exact answer.

Set-up. A thick cylinder from a0 = 1 m to `outer`, as a strip in the (r, z) plane between rollers (plane strain);
Tresca, cu = 1 Pa, G = Ir cu, nu = 0.499, finite strain. The wall is pushed outwards from a0 to `expansion` times a0.
The soil outside the strip is replaced by the pressure that an infinite elastic medium bears there, G (a**2 - a0**2) /
r**2: without it the answer would be low by Ir (a**2 - a0**2) / outer**2, 4 % at the default.

Measured. `p_over_cu`: the pressure at the wall divided by cu, from the force on the wall at its current radius.

Reference. Exact for an incompressible soil (Gibson and Anderson 1961): 1 + ln(Ir (1 - (a0/a)**2)). Two small terms are
left out: elasticity in logarithmic strain (0.14 % at most), and nu below 1/2, which takes ln(2 - 2 nu) off, 0.04 %.

What must fail. Fully integrated linear triangles and quadrilaterals lock in the isochoric plastic flow: the pressure is
too high and keeps rising. The wall is stretched by `expansion` around and squeezed as much across: the domains of CPDI
distort.

Length. The first radius of the wall, a0 = 1 m; the strip is an eighth of it high.
"""

from __future__ import annotations

import math
from dataclasses import replace

from geofem.mistake import Mistake
from geofem.reference import reference
from geofem.scene import Box, History, Load, Material, Measure, Probe, Region, Scene, Support
from geofem.scenes._parts import any_of, at_least, at_most, check_number

A0, CU, NU = 1.0, 1.0, 0.499
HEIGHT = A0 / 8


def scene(*, Ir: float = 50.0, expansion: float = 2.0, outer: float = 30.0) -> Scene:
    """Knobs

    Ir : rigidity index G / cu, dimensionless; default 50.
    expansion : last radius of the wall by the first, dimensionless; default 2.
    outer : outer radius of what is modelled (m); default 30. It must lie in the elastic part.
    """
    check_number("cavity", "Ir", Ir, 5.0, 1000.0)
    check_number("cavity", "expansion", expansion, 1.01, 4.0)
    check_number("cavity", "outer", outer, 2.0, 1000.0)
    plastic = math.sqrt(Ir * (expansion**2 - 1)) * A0  # here the elastic shear stress G (a**2 - a0**2) / r**2 is cu
    if outer < 1.05 * plastic:
        raise Mistake(
            f"scene cavity: the plastic zone reaches r = {plastic:.3g} m, so set outer to {1.05 * plastic:.3g} m or more"
        )
    G = Ir * CU

    def wall(t: float) -> float:
        return A0 * (1 + (expansion - 1) * t)

    def outside(t: float) -> float:
        """Pressure of the infinite medium per area before loading: what lies at ``outer`` moves to r and its circle grows."""
        grown = wall(t) ** 2 - A0**2
        r = math.sqrt(outer**2 + grown)
        return G * grown / r**2 * (r / outer)

    def pressure(history: History) -> float:
        return float(history["wall_force"][-1]) / (wall(float(history["t"][-1])) * HEIGHT * CU)

    exact = replace(reference("v07_cavity", "p_over_cu"), value=1 + math.log(Ir * (1 - expansion**-2)))
    return Scene(
        name="cavity",
        regions=(
            Region(
                "strip",
                Box((A0, 0.0), (outer, HEIGHT)),
                Material("tresca", 1000.0, {"E": 2 * G * (1 + NU), "nu": NU, "c": CU}),
            ),
        ),
        length=A0,
        supports=(
            Support("wall", at_most(0, A0), (0,), lambda x, t: 0 * x[0] + wall(t) - A0),
            Support("rollers", any_of(at_most(1, 0.0), at_least(1, HEIGHT)), (1,)),
        ),
        loads=(Load("traction", (-1.0, 0.0), where=at_least(0, outer), amplitude=outside),),
        probes=(Probe("wall_force", "reaction", component=0, of="wall"),),
        measures=(Measure("p_over_cu", "-", pressure, reference=exact),),
        plane="axisymmetric",
        room=Box((A0, 0.0), (outer + A0, HEIGHT)),
        at=lambda t: {"expansion": wall(t) / A0},
        knobs={"Ir": Ir, "expansion": expansion, "outer": outer},
    )
