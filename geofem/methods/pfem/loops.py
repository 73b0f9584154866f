"""The boundary in the plane as closed loops that may be reconnected: contour surgery (Dritschel 1988).

A loop is linked slots: slot s stands for the edge from node[s] to node[nxt[s]], with the body on its left; node[s] = -1 is a
slot that is no longer used. Slots rather than nodes, as two corners of the bodies may meet in one node.
All that changes the topology is one deed: two edges a -> b and c -> d that face each other become a -> d and c -> b.
Across a gap this joins fronts, across a neck it cuts it, of two neighbouring edges it leaves out the corner between them, and
where two edges cross it uncrosses them.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from geofem.scene import Array

kernel = njit(cache=True, error_model="numpy")


@kernel
def cross(x, a, b, c):  # type: ignore[no-untyped-def]
    """Twice the area of the triangle of nodes a, b, c, positive if it runs counter-clockwise."""
    return (x[b, 0] - x[a, 0]) * (x[c, 1] - x[a, 1]) - (x[b, 1] - x[a, 1]) * (x[c, 0] - x[a, 0])


@kernel
def inside_corner(x, p, i, n, dx, dy):  # type: ignore[no-untyped-def]
    """Whether the direction (dx, dy) from node i points into the body, whose boundary runs p -> i -> n."""
    ux, uy, wx, wy = x[n, 0] - x[i, 0], x[n, 1] - x[i, 1], x[p, 0] - x[i, 0], x[p, 1] - x[i, 1]
    if ux * wy - uy * wx >= 0.0:
        return ux * dy - uy * dx > 0.0 and dx * wy - dy * wx > 0.0
    return not (wx * dy - wy * dx >= 0.0 and dx * uy - dy * ux >= 0.0)


@kernel
def link(x, facets):  # type: ignore[no-untyped-def]
    """The slots of boundary facets (k, 2): node, nxt, prv, each (k,). Where loops touch in a node, bodies stay apart."""
    k = len(facets)
    node, nxt, prv = facets[:, 0].copy(), np.full(k, -1), np.full(k, -1)
    first, more = np.full(len(x), -1), np.full(k, -1)  # the slots that leave each node
    for s in range(k):
        more[s] = first[node[s]]
        first[node[s]] = s
    for s in range(k):
        i = facets[s, 1]
        px, py = x[node[s], 0] - x[i, 0], x[node[s], 1] - x[i, 1]
        best, pick = 1e300, -1
        t = first[i]
        while t >= 0:
            nx, ny = x[facets[t, 1], 0] - x[i, 0], x[facets[t, 1], 1] - x[i, 1]
            angle = np.arctan2(nx * py - ny * px, nx * px + ny * py)  # of the body between the two edges
            angle = angle if angle > 0 else angle + 2 * np.pi
            if prv[t] < 0 and angle < best:
                best, pick = angle, t
            t = more[t]
        nxt[s] = pick
        if pick >= 0:
            prv[pick] = s
    return node, nxt, prv


@kernel
def tally(x, node, nxt):  # type: ignore[no-untyped-def]
    """The loop of each slot (k,), and of each loop its area (m2, negative for a hole) and the number of its slots."""
    loop, areas, counts = np.full(len(node), -1), [0.0 for _ in range(0)], [0 for _ in range(0)]
    for s in range(len(node)):
        if node[s] < 0 or loop[s] >= 0:
            continue
        area, count, t, o = 0.0, 0, s, node[s]
        while loop[t] < 0:
            loop[t] = len(areas)
            area += 0.5 * cross(x, o, node[t], node[nxt[t]])
            count += 1
            t = nxt[t]
        areas.append(area)
        counts.append(count)
    return loop, np.array(areas), np.array(counts)


@kernel
def winding(x, node, nxt, loop, but, px, py):  # type: ignore[no-untyped-def]
    """How often the loops, except the one numbered ``but``, run round a point."""
    w = 0
    for s in range(len(node)):
        if node[s] < 0 or loop[s] == but:
            continue
        a, b = node[s], node[nxt[s]]
        side = (x[b, 0] - x[a, 0]) * (py - x[a, 1]) - (px - x[a, 0]) * (x[b, 1] - x[a, 1])
        if x[a, 1] <= py and x[b, 1] > py and side > 0:
            w += 1
        elif x[a, 1] > py and x[b, 1] <= py and side < 0:
            w -= 1
    return w


@kernel
def cut_each_other(x, a, b, c, d):  # type: ignore[no-untyped-def]
    """Whether the edges a b and c d cross within both of them; edges that share a node do not."""
    if a == c or a == d or b == c or b == d:
        return False
    if max(x[a, 0], x[b, 0]) < min(x[c, 0], x[d, 0]) or max(x[c, 0], x[d, 0]) < min(x[a, 0], x[b, 0]):
        return False
    if max(x[a, 1], x[b, 1]) < min(x[c, 1], x[d, 1]) or max(x[c, 1], x[d, 1]) < min(x[a, 1], x[b, 1]):
        return False
    return cross(x, a, b, c) * cross(x, a, b, d) < 0.0 and cross(x, c, d, a) * cross(x, c, d, b) < 0.0


@kernel
def crosses(x, node, nxt, a, b):  # type: ignore[no-untyped-def]
    """Whether the edge between nodes a and b crosses any edge of the boundary."""
    for s in range(len(node)):
        if node[s] >= 0 and cut_each_other(x, a, b, node[s], node[nxt[s]]):
            return True
    return False


def by_left_end(x: Array, node: Array, nxt: Array) -> tuple[Array, Array, float]:
    """The used slots in the order of the left ends of their edges, these ends, and the width of the widest edge (m)."""
    used = np.flatnonzero(node >= 0)
    one, two = x[node[used], 0], x[node[nxt[used]], 0]
    left = np.minimum(one, two)
    order = np.argsort(left, kind="stable")
    return used[order], left[order], float(np.abs(one - two).max(initial=0.0))


def first_crossing(x: Array, node: Array, nxt: Array) -> tuple[int, int]:
    """Two slots whose edges cross each other, (-1, -1) if none do."""
    slots, left, _ = by_left_end(x, node, nxt)
    return look_for_crossing(x, node, nxt, slots, left)


@kernel
def look_for_crossing(x, node, nxt, slots, left):  # type: ignore[no-untyped-def]
    for k in range(len(slots)):
        a, b = node[slots[k]], node[nxt[slots[k]]]
        right = max(x[a, 0], x[b, 0])
        for l in range(k + 1, len(slots)):
            if left[l] > right:
                break
            if cut_each_other(x, a, b, node[slots[l]], node[nxt[slots[l]]]):
                return slots[k], slots[l]
    return -1, -1


@kernel
def change(x, node, nxt, s, t):  # type: ignore[no-untyped-def]
    """The area (m2) that ``reconnect`` would add."""
    a, b, c, d = node[s], node[nxt[s]], node[t], node[nxt[t]]
    return 0.5 * (cross(x, a, d, c) + cross(x, a, c, b))


@kernel
def reconnect(node, nxt, prv, s, t):  # type: ignore[no-untyped-def]
    """a -> b (slot s) and c -> d (slot t) become a -> d and c -> b; what encloses nothing is dropped."""
    after_s, after_t = nxt[s], nxt[t]
    nxt[s], prv[after_t] = after_t, s
    nxt[t], prv[after_s] = after_s, t
    for r in (s, t):
        if node[r] >= 0 and nxt[nxt[r]] == r:  # one edge forth and back, or a lone node
            node[nxt[r]] = -1
            node[r] = -1


@kernel
def pick_facing(x, node, nxt, prv, s, t, sign):  # type: ignore[no-untyped-def]
    """Of the two edges at slot s the one to reconnect with the edge t, -1 if none may be: no crossing, nothing in between.

    sign : 1 to add the area between them, -1 to take it away.
    """
    best, least = -1, 1e300
    for e in (prv[s], s):
        if e == t:
            continue
        a, b, c, d = node[e], node[nxt[e]], node[t], node[nxt[t]]
        one, two = sign * cross(x, a, d, c), sign * cross(x, a, c, b)
        if one < 0.0 or two < 0.0:  # the four-sided piece in between is folded along this diagonal: try the other
            one, two = sign * cross(x, a, d, b), sign * cross(x, d, c, b)
        area = one + two
        if one < 0.0 or two < 0.0 or area >= least:
            continue
        if crosses(x, node, nxt, a, d) or crosses(x, node, nxt, c, b):
            continue
        clear = True
        for r in range(len(node)):
            i = node[r]
            if i < 0 or i == a or i == b or i == c or i == d:
                continue
            if sign * cross(x, a, d, i) > 0 and sign * cross(x, d, c, i) > 0 and sign * cross(x, c, b, i) > 0:
                if sign * cross(x, b, a, i) > 0:
                    clear = False
                    break
        if clear:
            best, least = e, area
    return best


def nearest(x: Array, v: Array, node: Array, nxt: Array, prv: Array, reach: Array) -> tuple[Array, Array, Array]:
    """What each corner of the boundary faces within ``reach`` (n,) (m), through the outside and through the body.

    Returns for the two of them, outside first, (2, k): the slot of the edge (-1: none so near), its distance (m, reach if none),
    and the speed (m/s) at which it comes nearer.
    """
    return look_around(x, v, node, nxt, prv, reach, *by_left_end(x, node, nxt))


@kernel
def look_around(x, v, node, nxt, prv, reach, slots, left, widest):  # type: ignore[no-untyped-def]
    k = len(node)
    slot, distance, closing = np.full((2, k), -1), np.empty((2, k)), np.zeros((2, k))
    for s in range(k):
        i = node[s]
        if i < 0:
            continue
        distance[0, s] = distance[1, s] = reach[i]
        l = np.searchsorted(left, x[i, 0] - reach[i] - widest)
        while l < len(slots) and left[l] <= x[i, 0] + reach[i]:
            e = slots[l]
            l += 1
            a, b = node[e], node[nxt[e]]
            if a == i or b == i or max(x[a, 1], x[b, 1]) < x[i, 1] - reach[i] or min(x[a, 1], x[b, 1]) > x[i, 1] + reach[i]:
                continue
            ex, ey = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1]
            share = ((x[i, 0] - x[a, 0]) * ex + (x[i, 1] - x[a, 1]) * ey) / (ex * ex + ey * ey)
            share = min(max(share, 0.0), 1.0)
            dx, dy = x[a, 0] + share * ex - x[i, 0], x[a, 1] + share * ey - x[i, 1]
            gap = np.sqrt(dx * dx + dy * dy)
            side = 1 if inside_corner(x, node[prv[s]], i, node[nxt[s]], dx, dy) else 0
            if gap >= distance[side, s] or (cross(x, a, b, i) > 0.0) != (side == 1):
                continue
            neighbour = (nxt[s] == e and share == 0.0) or (nxt[e] == prv[s] and share == 1.0)
            if neighbour:  # merely the length of its own edge
                continue
            slot[side, s], distance[side, s] = e, gap
            ux = v[i, 0] - (1 - share) * v[a, 0] - share * v[b, 0]
            uy = v[i, 1] - (1 - share) * v[a, 1] - share * v[b, 1]
            closing[side, s] = (ux * dx + uy * dy) / gap if gap > 0.0 else 0.0
    return slot, distance, closing
