"""Spectral decompositions of symmetric tensors, and what their derivatives need where eigenvalues meet."""

from __future__ import annotations

import math

from geofem.materials.kinematics import Floats, helper

SAME = 1e-7
"""Relative distance below which two principal stresses count as one: there the limit, whose error grows with the square
of the distance, is better than the quotient, whose rounding error grows with the inverse."""


@helper
def eigen_plane(xx: float, yy: float, xy: float) -> Floats:
    """Eigenvalues p >= q of a 2 x 2 tensor, and (cos 2a, sin 2a) for the angle a from x to the axis of p."""
    mean = 0.5 * (xx + yy)
    half = 0.5 * (xx - yy)
    radius = math.sqrt(half * half + xy * xy)
    if radius > 0.0:
        return mean + radius, mean - radius, half / radius, xy / radius
    return mean, mean, 1.0, 0.0


@helper
def half_angle(cos2: float, sin2: float) -> tuple[float, float]:
    """(cos a, sin a) from (cos 2a, sin 2a), without cancellation."""
    if cos2 >= 0.0:
        cos = math.sqrt(0.5 * (1.0 + cos2))
        return cos, 0.5 * sin2 / cos
    sin = math.sqrt(0.5 * (1.0 - cos2))
    return 0.5 * sin2 / sin, sin


@helper
def jacobi_rotation(app: float, aqq: float, apq: float) -> tuple[float, float, float]:
    """(cos, sin, tan) of the rotation that annuls apq (Golub and Van Loan 2013, algorithm 8.5.1)."""
    if apq == 0.0:
        return 1.0, 0.0, 0.0
    tau = 0.5 * (aqq - app) / apq
    tan = math.copysign(1.0, tau) / (abs(tau) + math.sqrt(1.0 + tau * tau))
    cos = 1.0 / math.sqrt(1.0 + tan * tan)
    return cos, tan * cos, tan


@helper
def eigen_solid(xx: float, yy: float, zz: float, xy: float, yz: float, xz: float) -> tuple[Floats, Floats]:
    """Eigenvalues p >= q >= r of a 3 x 3 tensor and the 9 components of their unit vectors, one after the other.

    Cyclic Jacobi rotations: exact to rounding for repeated eigenvalues too; 3 to 5 sweeps.
    """
    ux, uy, uz, vx, vy, vz, wx, wy, wz = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
    enough = 1e-34 * (xx * xx + yy * yy + zz * zz + xy * xy + yz * yz + xz * xz)
    for _ in range(12):
        if xy * xy + yz * yz + xz * xz <= enough:
            break
        c, s, t = jacobi_rotation(xx, yy, xy)
        xx, yy, xy, xz, yz = xx - t * xy, yy + t * xy, 0.0, c * xz - s * yz, s * xz + c * yz
        ux, uy, uz, vx, vy, vz = (
            c * ux - s * vx,
            c * uy - s * vy,
            c * uz - s * vz,
            s * ux + c * vx,
            s * uy + c * vy,
            s * uz + c * vz,
        )
        c, s, t = jacobi_rotation(xx, zz, xz)
        xx, zz, xz, xy, yz = xx - t * xz, zz + t * xz, 0.0, c * xy - s * yz, s * xy + c * yz
        ux, uy, uz, wx, wy, wz = (
            c * ux - s * wx,
            c * uy - s * wy,
            c * uz - s * wz,
            s * ux + c * wx,
            s * uy + c * wy,
            s * uz + c * wz,
        )
        c, s, t = jacobi_rotation(yy, zz, yz)
        yy, zz, yz, xy, xz = yy - t * yz, zz + t * yz, 0.0, c * xy - s * xz, s * xy + c * xz
        vx, vy, vz, wx, wy, wz = (
            c * vx - s * wx,
            c * vy - s * wy,
            c * vz - s * wz,
            s * vx + c * wx,
            s * vy + c * wy,
            s * vz + c * wz,
        )
    if yy > xx:
        xx, yy, ux, uy, uz, vx, vy, vz = yy, xx, vx, vy, vz, ux, uy, uz
    if zz > yy:
        yy, zz, vx, vy, vz, wx, wy, wz = zz, yy, wx, wy, wz, vx, vy, vz
    if yy > xx:
        xx, yy, ux, uy, uz, vx, vy, vz = yy, xx, vx, vy, vz, ux, uy, uz
    return (xx, yy, zz), (ux, uy, uz, vx, vy, vz, wx, wy, wz)


@helper
def shear_ratio(sa: float, sb: float, ra: float, rb: float, daa: float, dab: float, dba: float, dbb: float, G: float) -> float:
    """(ra - rb) / (sa - sb), returned over trial principal stresses: the shear modulus between two axes over G.

    d.. is the derivative of the returned stresses by the principal strains; where the trial stresses meet the
    quotient's limit is (daa - dab - dba + dbb) / 4 G.
    """
    if abs(sa - sb) > SAME * (abs(sa) + abs(sb)):
        return (ra - rb) / (sa - sb)
    return 0.25 * (daa - dab - dba + dbb) / G


@helper
def log_slope(ea: float, eb: float, la: float, lb: float) -> float:
    """(ea - eb) / (la - lb) for logarithmic strains e = ln(l) / 2, down to la = lb."""
    x = (la - lb) / lb
    if abs(x) > 1e-3:
        return (ea - eb) / (la - lb)
    return 0.5 / lb * (1.0 - x * (0.5 - x * (1.0 / 3.0 - x * (0.25 - x * 0.2))))
