"""Stored energies in UFL for the variational core: the twins of ``geofem.materials.elastic``. Imports ufl only.

F is the full 3 x 3 deformation gradient, with the stretch across the plane in 2D. Energies are per reference volume
(J/m3); lam and mu are Lamé's constants (Pa), each a number or a ``fem.Constant``.
"""

from __future__ import annotations

from typing import Any

import ufl

from geofem.mistake import unknown

Expression = Any
"""A UFL expression, a ``fem.Constant`` or a number."""

LAWS = ("linear_elastic", "neo_hooke")


def strain(F: Expression) -> Expression:
    """The small strain sym F - I."""
    return ufl.sym(F) - ufl.Identity(3)


def shear_part(law: str, F: Expression, mu: Expression) -> tuple[Expression, Expression]:
    """The energy without its lambda term, and the volume change of that term: (mu e:e, tr e) or
    (mu/2 (F:F - 3 - 2 ln J), ln J). Raises ``Mistake`` for a law without an energy here."""
    if law == "linear_elastic":
        e = strain(F)
        return mu * ufl.inner(e, e), ufl.tr(e)
    if law == "neo_hooke":
        logJ = ufl.ln(ufl.det(F))
        return 0.5 * mu * (ufl.inner(F, F) - 3 - 2 * logJ), logJ
    raise unknown("law with an energy", law, LAWS)


def energy(law: str, F: Expression, lam: Expression, mu: Expression) -> Expression:
    """Stored energy with lambda/2 tr^2 e or lambda/2 ln^2 J for the change of volume (Bonet and Wood 2008, eq. 6.27)."""
    shear, volume = shear_part(law, F, mu)
    return shear + 0.5 * lam * volume**2


def energy_mixed(law: str, F: Expression, p: Expression, inv_lam: Expression, mu: Expression) -> Expression:
    """The same with a field p = lambda tr e or lambda ln J (Pa, tension positive) of its own; inv_lam = 1/lambda may be 0.

    Stationary in the deformation and in p; p is a part of the mean stress, not all of it. (Legendre transform of
    ``energy`` in the volume change.)
    """
    shear, volume = shear_part(law, F, mu)
    return shear + p * volume - 0.5 * inv_lam * p**2
