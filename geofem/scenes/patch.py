"""Patch test: a homogeneous motion imposed on the boundary must give the same exact stress everywhere inside.

Set-up. A unit square (m), E = 1 MPa, nu = 0.25; the whole boundary follows one of three motions:
`strain`: u = 1e-3 (x + y/2, y + x/2), small strain, plane stress; `rotation`: a rigid turn by 90 degrees about the
centre;
`shear`: simple shear, u = (gamma y, 0) with gamma = 1. The last two are finite motions of a neo-Hookean body in plane
strain.

Measured. The Cauchy stresses `stress_xx` and `stress_xy` (Pa) at the worst of four points inside.

Reference. Exact: 1333.33 and 400 Pa for `strain` (MacNeal and Harder 1985), zero for `rotation` (objectivity), mu
gamma**2 and mu gamma = 400 kPa for `shear`. Where the exact stress is zero, the error is relative to E.

What must fail. No mesh method may: a finite element that misses the patch test by more than rounding has a bug or does
not converge. Material points whose domains do not tile the cells make quadrature errors that do not vanish with the
cell size; particle sums without correction do not reproduce even a constant strain.

Length. The side of the square, 1 m.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from geofem.reference import reference
from geofem.scene import Array, Box, History, Material, Measure, Probe, Reference, Region, Scene, Support
from geofem.scenes._parts import any_of, at_least, at_most, check_choice

E, NU = 1e6, 0.25
INSIDE = ((0.21, 0.13), (0.73, 0.29), (0.64, 0.71), (0.33, 0.82))
"""Points (m) that lie on no edge of a regular mesh, where the stress of a method may jump."""
STRESSES = {"stress_xx": 0, "stress_xy": 3}


def displacement(motion: str, x: Array, t: float) -> Array:
    """Displacement (2, n) of the points x (2, n) at the load factor t (m)."""
    X, Y = x
    if motion == "strain":
        return 1e-3 * t * np.array([X + 0.5 * Y, Y + 0.5 * X])
    if motion == "shear":
        return t * np.array([Y, 0 * Y])
    c, s = np.cos(0.5 * np.pi * t), np.sin(0.5 * np.pi * t)
    dx, dy = X - 0.5, Y - 0.5
    return np.array([c * dx - s * dy - dx, s * dx + c * dy - dy])


def worst_of(stress: str, exact: Reference) -> Callable[[History], float]:
    """The stress at that one of the points where it is furthest from the exact one."""
    assert exact.value is not None

    def value(history: History) -> float:
        found = np.array([history[f"{stress}_{k}"][-1] for k in range(len(INSIDE))])
        return float(found[np.abs(found - exact.value).argmax()])

    return value


def measure(stress: str, motion: str) -> Measure:
    exact = reference("v01_patch", f"{motion}.{stress}")
    value = worst_of(stress, exact)
    if exact.value:
        return Measure(stress, "Pa", value, reference=exact)
    return Measure(stress, "Pa", value, error=lambda history: abs(value(history)) / E, reference=exact)


def scene(*, motion: str = "strain") -> Scene:
    """Knobs

    motion : ``strain`` (small, plane stress), ``rotation`` (by 90 degrees) or ``shear`` (gamma = 1); default ``strain``.
    """
    check_choice("patch", "motion", motion, ("strain", "rotation", "shear"))
    small = motion == "strain"
    boundary = any_of(at_most(0, 0.0), at_least(0, 1.0), at_most(1, 0.0), at_least(1, 1.0))
    supports = tuple(
        Support(f"boundary_{'xy'[i]}", boundary, (i,), lambda x, t, i=i: displacement(motion, x, t)[i])  # type: ignore[misc]
        for i in range(2)
    )
    return Scene(
        name="patch",
        regions=(
            Region(
                "square",
                Box((0.0, 0.0), (1.0, 1.0)),
                Material("linear_elastic" if small else "neo_hooke", 1000.0, {"E": E, "nu": NU}),
            ),
        ),
        length=1.0,
        supports=supports,
        probes=tuple(
            Probe(f"{name}_{k}", "stress", at=point, component=component)
            for name, component in STRESSES.items()
            for k, point in enumerate(INSIDE)
        ),
        measures=tuple(measure(name, motion) for name in STRESSES),
        plane="plane_stress" if small else "plane_strain",
        strain="small" if small else "finite",
        room=Box((-0.5, -0.5), (2.5, 1.5)),
        knobs={"motion": motion},
    )
