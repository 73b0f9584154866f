"""What is done at the sites of a point: put mass, momenta and forces to the grid, or get motions from it. See ``shapes``."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

from numba import njit
from numba.core.serialize import dumps

Loop = Callable[..., Any]
MASS, VELOCITY = 0, 1
"""Columns of the grid's nodes. In d dimensions: mass; d momenta, then velocities; d forces, then accelerations, from ``1 + d``
on; d momenta, then velocities behind the strains where these are others, from ``1 + 2 d`` on."""


def inlined(function: Loop) -> Loop:
    """A helper whose code is put in place of the call before types are inferred: twice as fast here as leaving it to LLVM.

    Numba keys its cache on disk by the functions that a kernel closes over, and gives every compiled function a name of its own in
    each process; here the name follows from the function and what it closes over, so that the key stays. The flags of arithmetic
    are those of the kernel that takes the code in (as a set, they would come in another order in each process).
    """
    made = njit(inline="always", error_model="numpy")(function)
    made._set_uuid(hashlib.sha256(dumps(function)).hexdigest())
    return made


class Deed(NamedTuple):
    """What is done at one site: where it is a ``node``, and where it lies in a cell of the ``plane`` or of the ``solid``."""

    node: Loop
    plane: Loop
    solid: Loop


def putting(give: Loop, add: Loop, nodal: bool = False) -> Deed:
    """A deed that adds to the grid. nodal : sites within a cell are resolved to the nodes, for what differs from node to node.

    give : (w, gx, gy, gz, x, y, z, acc) -> what the site at (x, y, z) gets. add : (nodes, n, f, got) adds f times that to node n.
    """

    @inlined
    def node(nodes, n, w, gx, gy, gz, x, y, z, acc):  # type: ignore[no-untyped-def]
        add(nodes, n, 1.0, give(w, gx, gy, gz, x, y, z, acc))
        return acc

    @inlined
    def plane(nodes, n, ny, rx, ry, w, gx, gy, x, y, acc):  # type: ignore[no-untyped-def]
        qx, qy = 1.0 - rx, 1.0 - ry
        if nodal:
            for q in range(4):
                di, dj = q >> 1, q & 1
                f = (rx if di else qx) * (ry if dj else qy)
                add(nodes, n + di * ny + dj, 1.0, give(w * f, gx * f, gy * f, 0.0, x - rx + di, y - ry + dj, 0.0, acc))
            return acc
        got = give(w, gx, gy, 0.0, x, y, 0.0, acc)
        add(nodes, n, qx * qy, got)
        add(nodes, n + 1, qx * ry, got)
        add(nodes, n + ny, rx * qy, got)
        add(nodes, n + ny + 1, rx * ry, got)
        return acc

    @inlined
    def solid(nodes, n, ny, nz, rx, ry, rz, w, gx, gy, gz, x, y, z, acc):  # type: ignore[no-untyped-def]
        got = give(w, gx, gy, gz, x, y, z, acc)
        for q in range(8):
            di, dj, dk = q >> 2, (q >> 1) & 1, q & 1
            f = (rx if di else 1.0 - rx) * (ry if dj else 1.0 - ry) * (rz if dk else 1.0 - rz)
            if nodal:
                got = give(w, gx, gy, gz, x - rx + di, y - ry + dj, z - rz + dk, acc)
            add(nodes, n + (di * ny + dj) * nz + dk, f, got)
        return acc

    return Deed(node, plane, solid)


def getting(zero: tuple[float, ...], read: Loop, take: Loop, nodal: bool = False) -> Deed:
    """A deed that reads the grid. nodal : as for ``putting``.

    zero : the start of what is read. read : (nodes, n, f, values) -> values + f times those of node n.
    take : (values, w, gx, gy, gz, x, y, z, acc) -> acc, with the values at the site at (x, y, z).
    """

    @inlined
    def node(nodes, n, w, gx, gy, gz, x, y, z, acc):  # type: ignore[no-untyped-def]
        return take(read(nodes, n, 1.0, zero), w, gx, gy, gz, x, y, z, acc)

    @inlined
    def plane(nodes, n, ny, rx, ry, w, gx, gy, x, y, acc):  # type: ignore[no-untyped-def]
        qx, qy = 1.0 - rx, 1.0 - ry
        if nodal:
            for q in range(4):
                di, dj = q >> 1, q & 1
                f = (rx if di else qx) * (ry if dj else qy)
                values = read(nodes, n + di * ny + dj, 1.0, zero)
                acc = take(values, w * f, gx * f, gy * f, 0.0, x - rx + di, y - ry + dj, 0.0, acc)
            return acc
        values = read(nodes, n, qx * qy, zero)
        values = read(nodes, n + 1, qx * ry, values)
        values = read(nodes, n + ny, rx * qy, values)
        values = read(nodes, n + ny + 1, rx * ry, values)
        return take(values, w, gx, gy, 0.0, x, y, 0.0, acc)

    @inlined
    def solid(nodes, n, ny, nz, rx, ry, rz, w, gx, gy, gz, x, y, z, acc):  # type: ignore[no-untyped-def]
        values = zero
        for q in range(8):
            di, dj, dk = q >> 2, (q >> 1) & 1, q & 1
            f = (rx if di else 1.0 - rx) * (ry if dj else 1.0 - ry) * (rz if dk else 1.0 - rz)
            if nodal:
                values = read(nodes, n + (di * ny + dj) * nz + dk, 1.0, zero)
                acc = take(values, w * f, gx * f, gy * f, gz * f, x - rx + di, y - ry + dj, z - rz + dk, acc)
            else:
                values = read(nodes, n + (di * ny + dj) * nz + dk, f, values)
        if nodal:
            return acc
        return take(values, w, gx, gy, gz, x, y, z, acc)

    return Deed(node, plane, solid)


# --- the deeds: what is put to and got from a site ---------------------------------------------------------------------------
# Each is written for the plane and for space, as the number of components is part of a compiled function.
ALL, START, FORCES, AGAIN = "all", "start", "forces", "again"
"""What a pass puts: mass, momenta and forces; mass and momenta; forces; momenta once more, for the strains."""


@cache
def make_put(dim: int, what: str, affine: bool) -> Deed:
    """Mass, momenta (affine in space or not) and forces of a point.

    acc : mass; momenta; forces of the point; stresses times -V0 / h; its place in cells; its velocity gradient times mass and h.
    """
    mass, forces, momenta = what in (ALL, START), what in (ALL, FORCES), what in (ALL, START, AGAIN)
    p0, f0 = (1 + 2 * dim if what == AGAIN else VELOCITY), 1 + dim

    if dim == 2:

        @inlined
        def give(w, gx, gy, gz, x, y, z, a):  # type: ignore[no-untyped-def]
            m, px, py, bx, by, xx, yy, xy, sx, sy, c0, c1, c2, c3 = a
            if affine:
                dx, dy = x - sx, y - sy
                return (
                    w * m,
                    w * (px + c0 * dx + c1 * dy),
                    w * (py + c2 * dx + c3 * dy),
                    w * bx + xx * gx + xy * gy,
                    w * by + xy * gx + yy * gy,
                )
            return w * m, w * px, w * py, w * bx + xx * gx + xy * gy, w * by + xy * gx + yy * gy

        @inlined
        def add(nodes, n, f, got):  # type: ignore[no-untyped-def]
            if mass:
                nodes[n, MASS] += f * got[0]
            if momenta:
                nodes[n, p0] += f * got[1]
                nodes[n, p0 + 1] += f * got[2]
            if forces:
                nodes[n, f0] += f * got[3]
                nodes[n, f0 + 1] += f * got[4]

        return putting(give, add, affine)

    @inlined
    def give_solid(w, gx, gy, gz, x, y, z, a):  # type: ignore[no-untyped-def]
        m, px, py, pz, bx, by, bz, xx, yy, zz, xy, yz, xz, sx, sy, sz, c0, c1, c2, c3, c4, c5, c6, c7, c8 = a
        fx, fy, fz = xx * gx + xy * gy + xz * gz, xy * gx + yy * gy + yz * gz, xz * gx + yz * gy + zz * gz
        if affine:
            dx, dy, dz = x - sx, y - sy, z - sz
            qx, qy, qz = c0 * dx + c1 * dy + c2 * dz, c3 * dx + c4 * dy + c5 * dz, c6 * dx + c7 * dy + c8 * dz
            return w * m, w * (px + qx), w * (py + qy), w * (pz + qz), w * bx + fx, w * by + fy, w * bz + fz
        return w * m, w * px, w * py, w * pz, w * bx + fx, w * by + fy, w * bz + fz

    @inlined
    def add_solid(nodes, n, f, got):  # type: ignore[no-untyped-def]
        if mass:
            nodes[n, MASS] += f * got[0]
        if momenta:
            nodes[n, p0] += f * got[1]
            nodes[n, p0 + 1] += f * got[2]
            nodes[n, p0 + 2] += f * got[3]
        if forces:
            nodes[n, f0] += f * got[4]
            nodes[n, f0 + 1] += f * got[5]
            nodes[n, f0 + 2] += f * got[6]

    return putting(give_solid, add_solid, affine)


@cache
def make_get_motion(dim: int, gradient: bool, affine: bool) -> Deed:
    """Velocity, acceleration, and the gradient of the velocity (row by row, or zeros) or its moment about the point.

    acc in the plane: v (2), a (2), gradient (4); affine: + place in cells (2), moment (4), D = sum w d d^T (3), all in cells.
    """
    a0 = 1 + dim
    if dim == 2:

        @inlined
        def read(nodes, n, f, values):  # type: ignore[no-untyped-def]
            vx, vy, ax, ay = values
            return vx + f * nodes[n, 1], vy + f * nodes[n, 2], ax + f * nodes[n, a0], ay + f * nodes[n, a0 + 1]

        if affine:

            @inlined
            def take(values, w, gx, gy, gz, x, y, z, acc):  # type: ignore[no-untyped-def]
                vx, vy, ax, ay, xx, xy, yx, yy, sx, sy, b0, b1, b2, b3, d0, d1, d2 = acc
                p, q, c, d = values
                if gradient:
                    xx, xy, yx, yy = xx + gx * p, xy + gy * p, yx + gx * q, yy + gy * q
                dx, dy = x - sx, y - sy
                wx, wy = w * dx, w * dy
                return (
                    vx + w * p, vy + w * q, ax + w * c, ay + w * d, xx, xy, yx, yy, sx, sy,
                    b0 + wx * p, b1 + wy * p, b2 + wx * q, b3 + wy * q, d0 + wx * dx, d1 + wx * dy, d2 + wy * dy,
                )  # fmt: skip
        elif gradient:

            @inlined
            def take(values, w, gx, gy, gz, x, y, z, acc):  # type: ignore[no-untyped-def]
                vx, vy, ax, ay, xx, xy, yx, yy = acc
                p, q, c, d = values
                return vx + w * p, vy + w * q, ax + w * c, ay + w * d, xx + gx * p, xy + gy * p, yx + gx * q, yy + gy * q
        else:

            @inlined
            def take(values, w, gx, gy, gz, x, y, z, acc):  # type: ignore[no-untyped-def]
                vx, vy, ax, ay, xx, xy, yx, yy = acc
                p, q, c, d = values
                return vx + w * p, vy + w * q, ax + w * c, ay + w * d, xx, xy, yx, yy

        return getting((0.0,) * 4, read, take, affine)

    @inlined
    def read_solid(nodes, n, f, values):  # type: ignore[no-untyped-def]
        vx, vy, vz, ax, ay, az = values
        return (
            vx + f * nodes[n, 1], vy + f * nodes[n, 2], vz + f * nodes[n, 3],
            ax + f * nodes[n, 4], ay + f * nodes[n, 5], az + f * nodes[n, 6],
        )  # fmt: skip

    if affine:

        @inlined
        def take_solid(values, w, gx, gy, gz, x, y, z, acc):  # type: ignore[no-untyped-def]
            (vx, vy, vz, ax, ay, az, xx, xy, xz, yx, yy, yz, zx, zy, zz, sx, sy, sz,
             b0, b1, b2, b3, b4, b5, b6, b7, b8, d0, d1, d2, d3, d4, d5) = acc  # fmt: skip
            p, q, r, c, d, e = values
            if gradient:
                xx, xy, xz = xx + gx * p, xy + gy * p, xz + gz * p
                yx, yy, yz = yx + gx * q, yy + gy * q, yz + gz * q
                zx, zy, zz = zx + gx * r, zy + gy * r, zz + gz * r
            dx, dy, dz = x - sx, y - sy, z - sz
            wx, wy, wz = w * dx, w * dy, w * dz
            return (
                vx + w * p, vy + w * q, vz + w * r, ax + w * c, ay + w * d, az + w * e,
                xx, xy, xz, yx, yy, yz, zx, zy, zz, sx, sy, sz,
                b0 + wx * p, b1 + wy * p, b2 + wz * p, b3 + wx * q, b4 + wy * q, b5 + wz * q, b6 + wx * r, b7 + wy * r, b8 + wz * r,
                d0 + wx * dx, d1 + wx * dy, d2 + wx * dz, d3 + wy * dy, d4 + wy * dz, d5 + wz * dz,
            )  # fmt: skip
    else:

        @inlined
        def take_solid(values, w, gx, gy, gz, x, y, z, acc):  # type: ignore[no-untyped-def]
            vx, vy, vz, ax, ay, az, xx, xy, xz, yx, yy, yz, zx, zy, zz = acc
            p, q, r, c, d, e = values
            if gradient:
                xx, xy, xz = xx + gx * p, xy + gy * p, xz + gz * p
                yx, yy, yz = yx + gx * q, yy + gy * q, yz + gz * q
                zx, zy, zz = zx + gx * r, zy + gy * r, zz + gz * r
            return (
                vx + w * p, vy + w * q, vz + w * r, ax + w * c, ay + w * d, az + w * e,
                xx, xy, xz, yx, yy, yz, zx, zy, zz,
            )  # fmt: skip

    return getting((0.0,) * 6, read_solid, take_solid, affine)


@cache
def make_get_gradient(dim: int, first: int) -> Deed:
    """The velocity in the columns from ``first`` on and its gradient, row by row."""
    if dim == 2:

        @inlined
        def read(nodes, n, f, values):  # type: ignore[no-untyped-def]
            vx, vy = values
            return vx + f * nodes[n, first], vy + f * nodes[n, first + 1]

        @inlined
        def take(values, w, gx, gy, gz, x, y, z, acc):  # type: ignore[no-untyped-def]
            vx, vy, xx, xy, yx, yy = acc
            p, q = values
            return vx + w * p, vy + w * q, xx + gx * p, xy + gy * p, yx + gx * q, yy + gy * q

        return getting((0.0,) * 2, read, take)

    @inlined
    def read_solid(nodes, n, f, values):  # type: ignore[no-untyped-def]
        vx, vy, vz = values
        return vx + f * nodes[n, first], vy + f * nodes[n, first + 1], vz + f * nodes[n, first + 2]

    @inlined
    def take_solid(values, w, gx, gy, gz, x, y, z, acc):  # type: ignore[no-untyped-def]
        vx, vy, vz, xx, xy, xz, yx, yy, yz, zx, zy, zz = acc
        p, q, r = values
        return (
            vx + w * p, vy + w * q, vz + w * r,
            xx + gx * p, xy + gy * p, xz + gz * p, yx + gx * q, yy + gy * q, yz + gz * q, zx + gx * r, zy + gy * r, zz + gz * r,
        )  # fmt: skip

    return getting((0.0,) * 3, read_solid, take_solid)


@cache
def make_get_spread(dim: int) -> Deed:
    """Second moments D = sum w d d^T of the weights about a place. acc in the plane: place in cells (2), xx, xy, yy."""

    @inlined
    def read(nodes, n, f, values):  # type: ignore[no-untyped-def]
        return values

    if dim == 2:

        @inlined
        def take(values, w, gx, gy, gz, x, y, z, acc):  # type: ignore[no-untyped-def]
            sx, sy, xx, xy, yy = acc
            dx, dy = x - sx, y - sy
            return sx, sy, xx + w * dx * dx, xy + w * dx * dy, yy + w * dy * dy

    else:

        @inlined
        def take(values, w, gx, gy, gz, x, y, z, acc):  # type: ignore[no-untyped-def]
            sx, sy, sz, xx, xy, xz, yy, yz, zz = acc
            dx, dy, dz = x - sx, y - sy, z - sz
            wx, wy = w * dx, w * dy
            return sx, sy, sz, xx + wx * dx, xy + wx * dy, xz + wx * dz, yy + wy * dy, yz + wy * dz, zz + w * dz * dz

    return getting((0.0,), read, take, nodal=True)
