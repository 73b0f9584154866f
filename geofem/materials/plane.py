"""From a law in principal space to its kernels in the plane and with axial symmetry (m = 4, g = 5): zz is a principal axis.

A law is a pair of helpers, for principal trial stresses a >= b >= c:
returned(a, b, c, par, dt) -> (region, ra, rb, rc) with region 0 for elastic;
tangent(region, a, b, c, par, dt) -> the derivatives of (ra, rb, rc) by the trial strains, row by row, a tuple of 9.
par starts with Lamé's constants (lambda, G). dt is the step (s) for laws that depend on the rate; infinite at small strain,
which knows no rate.

Region ``OPEN`` is a gap: the stress is what ``returned`` says, usually none, but at finite strain the elastic state keeps
the whole change of volume, without shear, so that the gap has to close before the material resists again.
"""

from __future__ import annotations

import math

import numpy as np

from geofem.materials.kinematics import Array, Floats, Kernel, det_plane, helper, inverse_plane, kernel
from geofem.materials.principal import eigen_plane, half_angle, log_slope, shear_ratio

Stresses = tuple[int, float, float, float]
OPEN = 9


@helper
def trial_plane(F: Array, F_old: Array, state: Array, history: bool) -> Floats:
    """The elastic trial left Cauchy-Green tensor (xx, yy, zz, xy): f b_e f^T with f = F F_old^-1, or F F^T without history."""
    if not history:
        return F[0] * F[0] + F[1] * F[1], F[2] * F[2] + F[3] * F[3], F[4] * F[4], F[0] * F[2] + F[1] * F[3]
    i0, i1, i2, i3, i4 = inverse_plane(F_old)
    f0, f1 = F[0] * i0 + F[1] * i2, F[0] * i1 + F[1] * i3
    f2, f3 = F[2] * i0 + F[3] * i2, F[2] * i1 + F[3] * i3
    f4 = F[4] * i4
    bx, by, bz, bs = 1.0 + state[0], 1.0 + state[1], 1.0 + state[2], state[3]
    return (
        f0 * f0 * bx + f1 * f1 * by + 2.0 * f0 * f1 * bs,
        f2 * f2 * bx + f3 * f3 * by + 2.0 * f2 * f3 * bs,
        f4 * f4 * bz,
        f0 * f2 * bx + f1 * f3 * by + (f0 * f3 + f1 * f2) * bs,
    )


def in_plane(returned: Kernel, tangent: Kernel) -> tuple[Kernel, Kernel]:
    """The law for principal stresses p >= q of the plane and z across it: sorted, answered, and put back."""

    @helper
    def respond(p: float, q: float, z: float, par: Array, dt: float) -> Stresses:
        """(region, rp, rq, rz)."""
        if z >= p:
            a, b, c = z, p, q
        elif z <= q:
            a, b, c = p, q, z
        else:
            a, b, c = p, z, q
        region, ra, rb, rc = returned(a, b, c, par, dt)
        if z >= p:
            return region, rb, rc, ra
        if z <= q:
            return region, ra, rb, rc
        return region, ra, rc, rb

    @helper
    def stiffness(region: int, p: float, q: float, z: float, par: Array, dt: float) -> Floats:
        """Derivatives of (rp, rq, rz), row by row."""
        if z >= p:
            a, b, c = z, p, q
        elif z <= q:
            a, b, c = p, q, z
        else:
            a, b, c = p, z, q
        aa, ab, ac, ba, bb, bc, ca, cb, cc = tangent(region, a, b, c, par, dt)
        if z >= p:
            return bb, bc, ba, cb, cc, ca, ab, ac, aa
        if z <= q:
            return aa, ab, ac, ba, bb, bc, ca, cb, cc
        return aa, ac, ab, ca, cc, cb, ba, bc, bb

    return respond, stiffness


def small_plane(returned: Kernel, tangent: Kernel) -> Kernel:
    """The small-strain batch kernel of a principal-space law (see ``Kernels.small``)."""
    respond, stiffness = in_plane(returned, tangent)

    @kernel
    def small(dstrain: Array, state: Array, par: Array, stress: Array, tangents: Array, new_state: Array) -> int:
        lam, G = par[0], par[1]
        plastic = 0
        for n in range(dstrain.shape[0]):
            dx, dy, dz, ds = dstrain[n, 0], dstrain[n, 1], dstrain[n, 2], dstrain[n, 3]
            volume = lam * (dx + dy + dz)
            x = state[n, 0] + volume + 2.0 * G * dx
            y = state[n, 1] + volume + 2.0 * G * dy
            z = state[n, 2] + volume + 2.0 * G * dz
            s = state[n, 3] + G * ds
            p, q, cos2, sin2 = eigen_plane(x, y, s)
            region, rp, rq, rz = respond(p, q, z, par, math.inf)
            D = tangents[n]
            if region == 0:
                for i in range(3):
                    for j in range(3):
                        D[i, j] = lam
                    D[i, i] += 2.0 * G
                    D[i, 3] = D[3, i] = 0.0
                D[3, 3] = G
            else:
                plastic += 1
                pp, pq, pz, qp, qq, qz, zp, zq, zz = stiffness(region, p, q, z, par, math.inf)
                shear = G * shear_ratio(p, q, rp, rq, pp, pq, qp, qq, G)
                # Strains in the principal frame: e_p = cc e_x + ss e_y + cs g, e_q = ss e_x + cc e_y - cs g,
                # g_pq = 2 cs (e_y - e_x) + cos2 g. Stresses turn back by the transpose.
                cc, ss, cs = 0.5 * (1.0 + cos2), 0.5 * (1.0 - cos2), 0.5 * sin2
                px, py, ps = pp * cc + pq * ss, pp * ss + pq * cc, (pp - pq) * cs
                qx, qy, qs = qp * cc + qq * ss, qp * ss + qq * cc, (qp - qq) * cs
                a, b = 4.0 * shear * cs * cs, 2.0 * shear * cs * cos2
                D[0, 0], D[0, 1], D[0, 2] = cc * px + ss * qx + a, cc * py + ss * qy - a, cc * pz + ss * qz
                D[1, 0], D[1, 1], D[1, 2] = ss * px + cc * qx - a, ss * py + cc * qy + a, ss * pz + cc * qz
                D[2, 0], D[2, 1], D[2, 2] = zp * cc + zq * ss, zp * ss + zq * cc, zz
                D[0, 3], D[1, 3], D[2, 3] = cc * ps + ss * qs - b, ss * ps + cc * qs + b, (zp - zq) * cs
                D[3, 0], D[3, 1], D[3, 2] = cs * (px - qx) - b, cs * (py - qy) + b, cs * (pz - qz)
                D[3, 3] = cs * (ps - qs) + shear * cos2 * cos2
                mean, radius = 0.5 * (rp + rq), 0.5 * (rp - rq)
                x, y, z, s = mean + radius * cos2, mean - radius * cos2, rz, radius * sin2
            stress[n, 0] = new_state[n, 0] = x
            stress[n, 1] = new_state[n, 1] = y
            stress[n, 2] = new_state[n, 2] = z
            stress[n, 3] = new_state[n, 3] = s
        return plastic

    return small


def finite_plane(returned: Kernel, tangent: Kernel, history: bool) -> tuple[Kernel, Kernel]:
    """The finite-strain batch kernel of a principal-space law and its point kernel (see ``Kernels.finite``, ``Kernels.point``).

    The law holds between the principal Kirchhoff stresses and logarithmic elastic strains; the plastic flow is
    integrated by the exponential map, which leaves the small-strain return mapping as it is (Simo 1992, CMAME 99:61-112).
    """
    respond, stiffness = in_plane(returned, tangent)

    @helper
    def answer(F: Array, F_old: Array, state: Array, par: Array, dt: float, new_state: Array) -> Floats:
        """Return mapping at a point; writes the new state. Returns the region, the in-plane frame (cos2, sin2), and
        stretches squared l, logarithmic strains e, trial stresses s and Kirchhoff stresses r along p, q, z."""
        lam, G = par[0], par[1]
        bx, by, lz, bs = trial_plane(F, F_old, state, history)
        lp, lq, cos2, sin2 = eigen_plane(bx, by, bs)
        ep, eq, ez = 0.5 * math.log(lp), 0.5 * math.log(lq), 0.5 * math.log(lz)
        volume = lam * (ep + eq + ez)
        sp, sq, sz = volume + 2.0 * G * ep, volume + 2.0 * G * eq, volume + 2.0 * G * ez
        region, rp, rq, rz = respond(sp, sq, sz, par, dt)
        if history:
            if region == 0:
                new_state[0], new_state[1], new_state[2], new_state[3] = bx - 1.0, by - 1.0, lz - 1.0, bs
            else:
                if region == OPEN:
                    vp = vq = vz = math.exp(2.0 / 3.0 * (ep + eq + ez))
                else:
                    mean = lam / (3.0 * lam + 2.0 * G) * (rp + rq + rz)
                    vp, vq, vz = math.exp((rp - mean) / G), math.exp((rq - mean) / G), math.exp((rz - mean) / G)
                centre, radius = 0.5 * (vp + vq) - 1.0, 0.5 * (vp - vq)
                new_state[0], new_state[1] = centre + radius * cos2, centre - radius * cos2
                new_state[2], new_state[3] = vz - 1.0, radius * sin2
        return region, cos2, sin2, lp, lq, ep, eq, sp, sq, sz, rp, rq, rz

    @kernel
    def finite(F: Array, F_old: Array, state: Array, par: Array, dt: float, P: Array, A: Array, new_state: Array) -> int:
        G = par[1]
        plastic = 0
        # pp, qq, pq, qp: the products (axis) x (axis pulled back by F^-1) over the components (xx, xy, yx, yy).
        pp, qq, pq, qp = np.empty(4), np.empty(4), np.empty(4), np.empty(4)
        for n in range(F.shape[0]):
            if not det_plane(F[n]) > 0.0:
                return -1 - n
            region, cos2, sin2, lp, lq, ep, eq, sp, sq, sz, rp, rq, rz = answer(F[n], F_old[n], state[n], par, dt, new_state[n])
            plastic += region > 0
            dpp, dpq, dpz, dqp, dqq, dqz, dzp, dzq, dzz = stiffness(region, sp, sq, sz, par, dt)
            # Derivative of the shear stress between p and q by the trial left Cauchy-Green tensor.
            h = 2.0 * G * shear_ratio(sp, sq, rp, rq, dpp, dpq, dqp, dqq, G) * log_slope(ep, eq, lp, lq)
            i0, i1, i2, i3, w = inverse_plane(F[n])
            cos, sin = half_angle(cos2, sin2)
            px, py, qx, qy = cos * i0 + sin * i1, cos * i2 + sin * i3, cos * i1 - sin * i0, cos * i3 - sin * i2
            pp[0], pp[1], pp[2], pp[3] = cos * px, cos * py, sin * px, sin * py
            qq[0], qq[1], qq[2], qq[3] = -sin * qx, -sin * qy, cos * qx, cos * qy
            pq[0], pq[1], pq[2], pq[3] = cos * qx, cos * qy, sin * qx, sin * qy
            qp[0], qp[1], qp[2], qp[3] = -sin * px, -sin * py, cos * px, cos * py
            for i in range(4):
                a = (dpp - rp) * pp[i] + dqp * qq[i]
                b = dpq * pp[i] + (dqq - rq) * qq[i]
                c = h * lq * pq[i] + (h * lq - rq) * qp[i]
                d = (h * lp - rp) * pq[i] + h * lp * qp[i]
                for j in range(4):
                    A[n, i, j] = a * pp[j] + b * qq[j] + c * pq[j] + d * qp[j]
                A[n, i, 4] = (dpz * pp[i] + dqz * qq[i]) * w
                A[n, 4, i] = (dzp * pp[i] + dzq * qq[i]) * w
                P[n, i] = rp * pp[i] + rq * qq[i]
            A[n, 4, 4] = (dzz - rz) * w * w
            P[n, 4] = rz * w
        return plastic

    @helper
    def point(F: Array, F_old: Array, state: Array, par: Array, dt: float, tau: Array, new_state: Array) -> int:
        if not det_plane(F) > 0.0:
            return -1
        region, cos2, sin2, _, _, _, _, _, _, _, rp, rq, rz = answer(F, F_old, state, par, dt, new_state)
        mean, radius = 0.5 * (rp + rq), 0.5 * (rp - rq)
        tau[0], tau[1], tau[2], tau[3] = mean + radius * cos2, mean - radius * cos2, rz, radius * sin2
        return 1 if region > 0 else 0

    return finite, point
