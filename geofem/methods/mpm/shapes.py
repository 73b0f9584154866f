"""Shape functions: which nodes a material point tells of itself and hears from, and with what weights.

A point knows of the grid through *sites*: the nodes around it, or the corners of its domain, between whose four (eight) nodes
fields are interpolated by hats. Every site has a weight w = S_p and a gradient g = grad S_p; a shape is a factory ``over(dim)``
that turns what is done at a site, a ``Deed``, into the loop over the sites of one point,

    acc = loop(nodes, lattice, at, domain, F, p, acc)

Gradients and places are measured in cells. All passes of the method are written once, as deeds, and compiled for each shape.

Per direction, with s a coordinate in cells and l half the size of the point's domain in cells:

=========== ======================================================================== ===================================
hat         1 - |s|                                                                  Sulsky, Chen & Schreyer 1994
gimp        mean of the hat over s - l ... s + l, l as in the reference configuration  Bardenhagen & Kober 2004 (uGIMP)
cpgimp      the same, l stretched with F                                             Bardenhagen & Kober 2004 (cpGIMP)
bspline2, 3 quadratic and cubic B-splines; nodes beyond the grid's edge are made       Steffen, Kirby & Berzins 2008
            from those within by linear extrapolation
cpdi        hats interpolated over the parallelogram of the domain from its corners    Sadeghirad et al. 2011
cpdi2       the same over a quadrilateral whose corners are carried by the grid        Sadeghirad et al. 2013
=========== ======================================================================== ===================================
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import floor, sqrt
from typing import Any

from geofem.methods.mpm.deeds import Deed, Loop, inlined


@dataclass(frozen=True)
class Shape:
    """One shape.

    over : (dim) -> (deed) -> loop, see above.
    reach : the nodes of a point along an axis are those from floor(s - reach) to floor(s + reach) + 1; where the domain
        ``spread``s, half its extent along the axis takes the place of ``reach``.
    pad : nodes that the grid needs beyond the room.
    domain : what ``Points.domain`` holds of a point: "half" the half lengths (dim) in the reference configuration;
        "edges" the half edge vectors there (dim * dim, one after the other); "corners" the present corners (4 x, y).
    spread : the domain has any size, as it stretches with the deformation.
    ends : the functions change at the edge of the room, beyond which no point may go.
    """

    name: str
    over: Callable[[int], Callable[[Deed], Loop]]
    reach: float = 0.0
    pad: int = 0
    domain: str = "half"
    spread: bool = False
    ends: bool = False


# --- weights along one direction ----------------------------------------------------------------------------------------
@inlined
def hat(s: float, l: float, edge: int, last: int) -> Any:
    """The two linear hat functions at s."""
    first = int(s)
    r = s - first
    return first, (1.0 - r, r), (-1.0, 1.0)


@inlined
def gimp(s: float, l: float, edge: int, last: int) -> Any:
    """The three hats averaged over s - l ... s + l, l <= 1/2."""
    first = int(s + 0.5) - 1
    r = s - first
    per = 0.5 / l
    a, c = max(0.0, 1.0 - r + l), max(0.0, 1.0 - r - l)
    d, e = max(0.0, r + l - 1.0), max(0.0, r - l - 1.0)
    low, high = (c - a) * per, (d - e) * per
    left, right = -0.5 * (a + c) * low, 0.5 * (d + e) * high
    return first, (left, 1.0 - left - right, right), (low, -low - high, high)


@inlined
def bspline2(s: float, l: float, edge: int, last: int) -> Any:
    """The three quadratic B-splines at s; at the ends ``edge`` and ``last`` of the grid a hat takes over."""
    first = int(s + 0.5) - 1
    r = s - first
    a, b = 1.5 - r, r - 0.5
    left, right = 0.5 * a * a, 0.5 * b * b
    w, d = (left, 1.0 - left - right, right), (-a, a - b, b)
    if first < edge:  # the node beyond the edge is 2 times that on it less the next
        return first, (0.0, w[1] + 2.0 * w[0], w[2] - w[0]), (0.0, d[1] + 2.0 * d[0], d[2] - d[0])
    if first + 2 > last:
        return first, (w[0] - w[2], w[1] + 2.0 * w[2], 0.0), (d[0] - d[2], d[1] + 2.0 * d[2], 0.0)
    return first, w, d


@inlined
def bspline3(s: float, l: float, edge: int, last: int) -> Any:
    """The four cubic B-splines at s; at the ends ``edge`` and ``last`` of the grid as for the quadratic ones."""
    first = int(s) - 1
    r = s - first - 1.0
    q = 1.0 - r
    a, z = q * q * q / 6.0, r * r * r / 6.0
    b, y = 2.0 / 3.0 - r * r * (1.0 - 0.5 * r), 2.0 / 3.0 - q * q * (1.0 - 0.5 * q)
    da, dz = -0.5 * q * q, 0.5 * r * r
    db, dy = r * (1.5 * r - 2.0), q * (2.0 - 1.5 * q)
    if first < edge and first + 3 > last:  # a room of one cell has a node beyond each end
        return first, (0.0, b + 2.0 * a - z, y + 2.0 * z - a, 0.0), (0.0, db + 2.0 * da - dz, dy + 2.0 * dz - da, 0.0)
    if first < edge:
        return first, (0.0, b + 2.0 * a, y - a, z), (0.0, db + 2.0 * da, dy - da, dz)
    if first + 3 > last:
        return first, (a, b - z, y + 2.0 * z, 0.0), (da, db - dz, dy + 2.0 * dz, 0.0)
    return first, (a, b, y, z), (da, db, dy, dz)


@inlined
def averaged(u: float, l: float) -> tuple[float, float]:
    """Weight and slope of the hat at distance u averaged over u - l ... u + l, for any l."""
    a, b = min(max(u - l, -1.0), 1.0), min(max(u + l, -1.0), 1.0)
    # the two sides apart and without differences of like numbers: a weight that rounds to nothing beside a slope that does not
    # would leave a node with a force and no mass
    c, d, e, f = max(a, 0.0), max(b, 0.0), max(-b, 0.0), max(-a, 0.0)
    right, left = (d - c) * (1.0 - 0.5 * (c + d)), (f - e) * (1.0 - 0.5 * (e + f))
    return (0.5 / l) * (right + left), (0.5 / l) * (abs(a) - abs(b))


# --- loops over the sites -------------------------------------------------------------------------------------------------
def product(weights: Callable[..., Any], count: int) -> Callable[[int], Callable[[Deed], Loop]]:
    """Tensor product of ``weights`` with a fixed number of nodes per direction."""

    def of_dimension(dim: int) -> Callable[[Deed], Loop]:
        def over(deed: Deed) -> Loop:
            visit = deed.node
            if dim == 2:

                @inlined
                def loop(nodes, lattice, at, domain, F, p, acc):  # type: ignore[no-untyped-def]
                    x0, y0, _, per_h, nx, ny, _, base, pad = lattice
                    i, wx, dx = weights((at[p, 0] - x0) * per_h, domain[p, 0], pad, nx - 1 - pad)
                    j, wy, dy = weights((at[p, 1] - y0) * per_h, domain[p, 1], pad, ny - 1 - pad)
                    for a in range(count):
                        row = (i + a) * ny + j - base
                        for b in range(count):
                            acc = visit(
                                nodes, row + b, wx[a] * wy[b], dx[a] * wy[b], wx[a] * dy[b], 0.0, i + a, j + b, 0.0, acc
                            )
                    return acc

            else:

                @inlined
                def loop(nodes, lattice, at, domain, F, p, acc):  # type: ignore[no-untyped-def]
                    x0, y0, z0, per_h, nx, ny, nz, base, pad = lattice
                    i, wx, dx = weights((at[p, 0] - x0) * per_h, domain[p, 0], pad, nx - 1 - pad)
                    j, wy, dy = weights((at[p, 1] - y0) * per_h, domain[p, 1], pad, ny - 1 - pad)
                    k, wz, dz = weights((at[p, 2] - z0) * per_h, domain[p, 2], pad, nz - 1 - pad)
                    for a in range(count):
                        for b in range(count):
                            row = ((i + a) * ny + j + b) * nz + k - base
                            w, gx, gy = wx[a] * wy[b], dx[a] * wy[b], wx[a] * dy[b]
                            for c in range(count):
                                acc = visit(
                                    nodes, row + c, w * wz[c], gx * wz[c], gy * wz[c], w * dz[c], i + a, j + b, k + c, acc
                                )
                    return acc

            return loop

        return over

    return of_dimension


def spans(dim: int) -> Callable[[Deed], Loop]:
    """Tensor product of averaged hats whose domain is stretched with F and reaches any number of nodes.

    The half length along axis a is that of the reference configuration times |F e_a|, the stretch of the edge along it.
    """

    def over(deed: Deed) -> Loop:
        visit = deed.node
        if dim == 2:

            @inlined
            def loop(nodes, lattice, at, domain, F, p, acc):  # type: ignore[no-untyped-def]
                x0, y0, _, per_h, _, ny, _, base, _ = lattice
                lx = domain[p, 0] * sqrt(F[p, 0] * F[p, 0] + F[p, 2] * F[p, 2])
                ly = domain[p, 1] * sqrt(F[p, 1] * F[p, 1] + F[p, 3] * F[p, 3])
                sx, sy = (at[p, 0] - x0) * per_h, (at[p, 1] - y0) * per_h
                low, high = floor(sy - ly), floor(sy + ly)
                for i in range(floor(sx - lx), floor(sx + lx) + 2):
                    wx, dx = averaged(sx - i, lx)
                    for j in range(low, high + 2):
                        wy, dy = averaged(sy - j, ly)
                        acc = visit(nodes, i * ny + j - base, wx * wy, dx * wy, wx * dy, 0.0, i, j, 0.0, acc)
                return acc

        else:

            @inlined
            def loop(nodes, lattice, at, domain, F, p, acc):  # type: ignore[no-untyped-def]
                x0, y0, z0, per_h, _, ny, nz, base, _ = lattice
                lx = domain[p, 0] * sqrt(F[p, 0] ** 2 + F[p, 3] ** 2 + F[p, 6] ** 2)
                ly = domain[p, 1] * sqrt(F[p, 1] ** 2 + F[p, 4] ** 2 + F[p, 7] ** 2)
                lz = domain[p, 2] * sqrt(F[p, 2] ** 2 + F[p, 5] ** 2 + F[p, 8] ** 2)
                sx, sy, sz = (at[p, 0] - x0) * per_h, (at[p, 1] - y0) * per_h, (at[p, 2] - z0) * per_h
                for i in range(floor(sx - lx), floor(sx + lx) + 2):
                    wx, dx = averaged(sx - i, lx)
                    for j in range(floor(sy - ly), floor(sy + ly) + 2):
                        wy, dy = averaged(sy - j, ly)
                        for k in range(floor(sz - lz), floor(sz + lz) + 2):
                            wz, dz = averaged(sz - k, lz)
                            n = (i * ny + j) * nz + k - base
                            acc = visit(nodes, n, wx * wy * wz, dx * wy * wz, wx * dy * wz, wx * wy * dz, i, j, k, acc)
                return acc

        return loop

    return over


def parallelograms(dim: int) -> Callable[[Deed], Loop]:
    """CPDI: the mean over a parallelogram (parallelepiped) of the function that interpolates the hats at its corners.

    With half edges r_a = F R_a (in cells) and signs s_a of a corner its function has the mean 2^-dim and the mean gradient
    2^-dim sum s_a grad xi_a, where grad xi_a is the dual basis of the r_a (Sadeghirad, Brannon & Burghardt 2011, eqs. 22-24).
    """

    def over(deed: Deed) -> Loop:
        plane, solid = deed.plane, deed.solid
        if dim == 2:

            @inlined
            def loop(nodes, lattice, at, domain, F, p, acc):  # type: ignore[no-untyped-def]
                x0, y0, _, per_h, _, ny, _, base, _ = lattice
                ux = F[p, 0] * domain[p, 0] + F[p, 1] * domain[p, 1]
                uy = F[p, 2] * domain[p, 0] + F[p, 3] * domain[p, 1]
                vx = F[p, 0] * domain[p, 2] + F[p, 1] * domain[p, 3]
                vy = F[p, 2] * domain[p, 2] + F[p, 3] * domain[p, 3]
                sx, sy = (at[p, 0] - x0) * per_h, (at[p, 1] - y0) * per_h
                scale = 0.25 / (ux * vy - uy * vx)
                for a in (-1.0, 1.0):
                    for b in (-1.0, 1.0):
                        hx, hy = scale * (a * vy - b * uy), scale * (b * ux - a * vx)
                        cx, cy = sx + a * ux + b * vx, sy + a * uy + b * vy
                        i, j = int(cx), int(cy)
                        acc = plane(nodes, i * ny + j - base, ny, cx - i, cy - j, 0.25, hx, hy, cx, cy, acc)
                return acc

        else:

            @inlined
            def loop(nodes, lattice, at, domain, F, p, acc):  # type: ignore[no-untyped-def]
                x0, y0, z0, per_h, _, ny, nz, base, _ = lattice
                ux, uy, uz = moved(F, p, domain[p, 0], domain[p, 1], domain[p, 2])
                vx, vy, vz = moved(F, p, domain[p, 3], domain[p, 4], domain[p, 5])
                wx, wy, wz = moved(F, p, domain[p, 6], domain[p, 7], domain[p, 8])
                sx, sy, sz = (at[p, 0] - x0) * per_h, (at[p, 1] - y0) * per_h, (at[p, 2] - z0) * per_h
                ax, ay, az = vy * wz - vz * wy, vz * wx - vx * wz, vx * wy - vy * wx
                bx, by, bz = wy * uz - wz * uy, wz * ux - wx * uz, wx * uy - wy * ux
                cx, cy, cz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
                scale = 0.125 / (ux * ax + uy * ay + uz * az)
                for a in (-1.0, 1.0):
                    for b in (-1.0, 1.0):
                        for c in (-1.0, 1.0):
                            hx, hy, hz = a * ax + b * bx + c * cx, a * ay + b * by + c * cy, a * az + b * bz + c * cz
                            px, py, pz = (
                                sx + a * ux + b * vx + c * wx,
                                sy + a * uy + b * vy + c * wy,
                                sz + a * uz + b * vz + c * wz,
                            )
                            i, j, k = int(px), int(py), int(pz)
                            n = (i * ny + j) * nz + k - base
                            acc = solid(
                                nodes, n, ny, nz, px - i, py - j, pz - k,
                                0.125, scale * hx, scale * hy, scale * hz, px, py, pz, acc,
                            )  # fmt: skip
                return acc

        return loop

    return over


@inlined
def moved(F: Any, p: int, x: float, y: float, z: float) -> Any:
    """F_p times the vector (x, y, z)."""
    return (
        F[p, 0] * x + F[p, 1] * y + F[p, 2] * z,
        F[p, 3] * x + F[p, 4] * y + F[p, 5] * z,
        F[p, 6] * x + F[p, 7] * y + F[p, 8] * z,
    )


def quadrilaterals(dim: int) -> Callable[[Deed], Loop]:
    """CPDI2: the mean over a quadrilateral of the bilinear function that interpolates the hats at its four carried corners.

    With J_c = det(d x / d xi) at corner c, N_c N_d integrated by the tensor product gives the mean of corner function c as
    (4 J_c + 2 J_next + J_opposite + 2 J_last) / 9 A, and its mean gradient is (y_next - y_last, x_last - x_next) / 2 A
    (Sadeghirad, Brannon & Guilkey 2013). Corners are numbered counter-clockwise.
    """
    assert dim == 2

    def over(deed: Deed) -> Loop:
        plane = deed.plane

        @inlined
        def loop(nodes, lattice, at, domain, F, p, acc):  # type: ignore[no-untyped-def]
            x0, y0, _, per_h, _, ny, _, base, _ = lattice
            d = domain[p]
            area = 0.5 * ((d[4] - d[0]) * (d[7] - d[3]) - (d[6] - d[2]) * (d[5] - d[1]))
            per_area = 0.5 / (area * per_h)
            for c in range(4):
                o, a, q, z = 2 * c, 2 * ((c + 1) & 3), 2 * ((c + 2) & 3), 2 * ((c + 3) & 3)
                hx, hy = per_area * (d[a + 1] - d[z + 1]), per_area * (d[z] - d[a])
                own, after = turn(d, o, a, z), turn(d, a, q, o)
                opposite, before = turn(d, q, z, a), turn(d, z, o, q)
                weight = (4.0 * own + 2.0 * after + opposite + 2.0 * before) / (36.0 * area)
                cx, cy = (d[o] - x0) * per_h, (d[o + 1] - y0) * per_h
                i, j = int(cx), int(cy)
                acc = plane(nodes, i * ny + j - base, ny, cx - i, cy - j, weight, hx, hy, cx, cy, acc)
            return acc

        return loop

    return over


@inlined
def turn(d: Any, at: int, after: int, before: int) -> float:
    """Twice the area of the triangle that the corner ``at`` spans with its neighbours."""
    return (d[after] - d[at]) * (d[before + 1] - d[at + 1]) - (d[before] - d[at]) * (d[after + 1] - d[at + 1])


SHAPES = {
    shape.name: shape
    for shape in (
        Shape("hat", product(hat, 2)),
        Shape("gimp", product(gimp, 3), reach=0.5, pad=1),
        Shape("cpgimp", spans, pad=2, spread=True),
        Shape("cpdi", parallelograms, pad=2, domain="edges", spread=True),
        Shape("cpdi2", quadrilaterals, pad=2, domain="corners", spread=True),
        Shape("bspline2", product(bspline2, 3), reach=0.5, pad=1, ends=True),
        Shape("bspline3", product(bspline3, 4), reach=1.0, pad=1, ends=True),
    )
}


# --- the extent of domains -------------------------------------------------------------------------------------------------
def make_extent(shape: Shape, dim: int) -> Loop:
    """(at, domain, F, p, per_h) -> half the extent (cells) of the box around the domain of point p, along three axes."""
    kind = shape.domain if shape.spread else "fixed"
    fixed = shape.reach

    @inlined
    def extent(at, domain, F, p, per_h):  # type: ignore[no-untyped-def]
        if kind == "fixed":
            return fixed, fixed, fixed
        if dim == 2:
            if kind == "half":
                return (
                    domain[p, 0] * sqrt(F[p, 0] * F[p, 0] + F[p, 2] * F[p, 2]),
                    domain[p, 1] * sqrt(F[p, 1] * F[p, 1] + F[p, 3] * F[p, 3]),
                    0.0,
                )
            if kind == "edges":
                return (
                    abs(F[p, 0] * domain[p, 0] + F[p, 1] * domain[p, 1]) + abs(F[p, 0] * domain[p, 2] + F[p, 1] * domain[p, 3]),
                    abs(F[p, 2] * domain[p, 0] + F[p, 3] * domain[p, 1]) + abs(F[p, 2] * domain[p, 2] + F[p, 3] * domain[p, 3]),
                    0.0,
                )
            x, y, d = at[p, 0], at[p, 1], domain[p]
            return (
                per_h * max(abs(d[0] - x), abs(d[2] - x), abs(d[4] - x), abs(d[6] - x)),
                per_h * max(abs(d[1] - y), abs(d[3] - y), abs(d[5] - y), abs(d[7] - y)),
                0.0,
            )
        if kind == "half":
            return (
                domain[p, 0] * sqrt(F[p, 0] ** 2 + F[p, 3] ** 2 + F[p, 6] ** 2),
                domain[p, 1] * sqrt(F[p, 1] ** 2 + F[p, 4] ** 2 + F[p, 7] ** 2),
                domain[p, 2] * sqrt(F[p, 2] ** 2 + F[p, 5] ** 2 + F[p, 8] ** 2),
            )
        ux, uy, uz = moved(F, p, domain[p, 0], domain[p, 1], domain[p, 2])
        vx, vy, vz = moved(F, p, domain[p, 3], domain[p, 4], domain[p, 5])
        wx, wy, wz = moved(F, p, domain[p, 6], domain[p, 7], domain[p, 8])
        return abs(ux) + abs(vx) + abs(wx), abs(uy) + abs(vy) + abs(wy), abs(uz) + abs(vz) + abs(wz)

    return extent
