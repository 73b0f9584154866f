"""Laws by which cracks grow, from the intensity factors of their tips alone: which way a tip turns, whether it moves, how fast.

The ways differ by a few degrees, and only where K_II is large: a path that has turned to K_II = 0 is the same for all.

hoop : where the hoop stress ahead of the tip is largest (Erdogan and Sih 1963).
energy : where a kinked tip releases most energy, K of the kink by Amestoy and Leblond (1992).
symmetry : where a kinked tip has no K_II (Goldstein and Salganik 1974), K of the kink likewise; explicit, as no step is repeated.

A kink of the angle pi m to the axis, of a length that vanishes, has the factors k_i = F_ij(m) K_j whatever the body.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.polynomial import Polynomial

from geofem.scene import CRITERIA, Array, Growth

PI = math.pi
TOGETHER = 0.01
"""Under load control, tips whose K is within this part of the largest move with it: K is not known better."""
NEWTON = 30
"""Iterations for a kink; less than ten do from the angle of the largest hoop stress, which is some degrees off."""


def even(*coefficients: float) -> Polynomial:
    """The polynomial of the even powers of m."""
    return Polynomial([c for pair in zip(coefficients, [0.0] * len(coefficients)) for c in pair])


def odd(*coefficients: float) -> Polynomial:
    """The polynomial of the odd powers of m."""
    return Polynomial([c for pair in zip([0.0] * len(coefficients), coefficients) for c in pair])


# Amestoy and Leblond 1992; the numbers are their fits of higher terms
F11 = even(
    1.0, -3 * PI**2 / 8, PI**2 - 5 * PI**4 / 128, PI**2 / 9 - 11 * PI**4 / 72 + 119 * PI**6 / 15360,
    5.07790, -2.88312, -0.0925, 2.996, -4.059, 1.63, 4.1,
)  # fmt: skip
F12 = odd(
    -3 * PI / 2, 10 * PI / 3 + PI**3 / 16, -2 * PI - 133 * PI**3 / 180 + 59 * PI**5 / 1280,
    12.313906, -7.32433, 1.5793, 4.0216, -6.915, 4.21, 4.56,
)  # fmt: skip
F21 = odd(
    PI / 2, -4 * PI / 3 - PI**3 / 48, -2 * PI / 3 + 13 * PI**3 / 30 - 59 * PI**5 / 3840,
    -6.176023, 4.44112, -1.5340, -2.0700, 4.684, -3.95, -1.32,
)  # fmt: skip
F22 = even(
    1.0, -4 - 3 * PI**2 / 8, 8 / 3 + 29 * PI**2 / 18 - 5 * PI**4 / 128,
    -32 / 15 - 4 * PI**2 / 9 - 1159 * PI**4 / 7200 + 119 * PI**6 / 15360,
    10.58254, -4.78511, -1.8804, 7.280, -7.591, 0.25, 12.5,
)  # fmt: skip


def hoop(KI: float, KII: float) -> float:
    """The angle (radian) to the axis where the hoop stress is largest."""
    return 2.0 * math.atan2(-2.0 * KII, KI + math.hypot(KI, math.sqrt(8.0) * KII)) if KI or KII else 0.0


def kinked(KI: float, KII: float) -> tuple[Polynomial, Polynomial]:
    """The factors of a short kink as polynomials of its angle over pi."""
    return F11 * KI + F12 * KII, F21 * KI + F22 * KII


def kink(criterion: str, KI: float, KII: float) -> tuple[float, float]:
    """The angle (radian) to its axis at which a tip goes on, and the K of the straight crack that is as near to growing.

    K is that of the kinked tip: the largest hoop stress times sqrt(2 pi r), or sqrt(k_I^2 + k_II^2), which is sqrt(E' G).
    Faces that are pressed together, K_I < 0, count as closed: K_I = 0.
    """
    assert criterion in CRITERIA, criterion
    KI = max(KI, 0.0)
    angle = hoop(KI, KII)
    if criterion == "hoop":
        half = 0.5 * angle
        return angle, math.cos(half) ** 3 * KI - 1.5 * math.cos(half) * math.sin(angle) * KII
    k1, k2 = kinked(KI, KII)
    zero = k2 if criterion == "symmetry" else (k1 * k1 + k2 * k2).deriv()
    slope, m = zero.deriv(), angle / PI
    for _ in range(NEWTON):
        change = float(zero(m) / slope(m)) if KII else 0.0
        m -= change
        if abs(change) < 1e-14:
            break
    return PI * m, float(np.hypot(k1(m), k2(m)))


def speeds(law: Growth, K: Array) -> Array:
    """How far the tips go, as parts of the way of the fastest, from the K of ``kink`` (tips,); all zero if none moves.

    Without toughness and Paris' law, all tips that move at all go the same way.
    """
    moves = (K > law.threshold) & (K > 0.0)
    if law.toughness is not None:
        moves &= K >= (1.0 - TOGETHER) * K.max(initial=0.0)
    rate = (K / (K.max(initial=0.0) or 1.0)).clip(0.0) ** law.paris[1] if law.paris is not None else np.ones(len(K))
    return np.where(moves, rate, 0.0) / (rate[moves].max(initial=0.0) or 1.0)


def rate(law: Growth, K: Array) -> float:
    """How far the fastest tip goes in a cycle (m), by Paris' law; K is its range, as loads fall back to zero."""
    assert law.paris is not None
    C, m = law.paris
    return float(C * K.max(initial=0.0) ** m)
