"""Deeds on the loops of the boundary (see ``loops``): fronts that meet, necks that part, short edges, volume given back."""

from __future__ import annotations

import numpy as np

from geofem.methods.pfem.loops import change, cross, crosses, first_crossing, kernel, nearest, pick_facing, reconnect
from geofem.scene import Array

MERGE, SEPARATE, RESAMPLE = 0, 1, 2
"""Kinds of events."""
Event = tuple[float, float, float, float]
"""Kind, area (m2) that was added, and the place x, y (m)."""
CONTACT = 0.02
"""Fronts nearer than this part of the size are joined, and necks thinner are cut, however they move."""


FOLD = 1e-3
"""An angle (rad) below which two edges of the boundary lie on each other; an edge that much shorter than the next is none."""


def uncross(x: Array, node: Array, nxt: Array, prv: Array) -> list[Event]:
    """Reconnect edges that cross each other until none do; the boundary gets shorter each time, so it ends."""
    events = []
    s, t = first_crossing(x, node, nxt)
    while s >= 0:
        events.append((float(MERGE), change(x, node, nxt, s, t), *x[node[s]]))
        reconnect(node, nxt, prv, s, t)
        s, t = first_crossing(x, node, nxt)
    return events


@kernel
def unfold(x, node, nxt, prv):  # type: ignore[no-untyped-def]
    """Leave out corners where the boundary turns back on itself, as where nodes overtook each other on a wall. Returns events."""
    events = [(0.0, 0.0, 0.0, 0.0) for _ in range(0)]
    done = False
    while not done:
        done = True
        for s in range(len(node)):
            if node[s] < 0:
                continue
            p, i, n = node[prv[s]], node[s], node[nxt[s]]
            ax, ay, bx, by = x[p, 0] - x[i, 0], x[p, 1] - x[i, 1], x[n, 0] - x[i, 0], x[n, 1] - x[i, 1]
            a, b = np.hypot(ax, ay), np.hypot(bx, by)
            if min(a, b) < FOLD * max(a, b) or (ax * bx + ay * by > 0.0 and abs(ax * by - ay * bx) < FOLD * a * b):
                events.append((float(RESAMPLE), -0.5 * cross(x, p, i, n), x[i, 0], x[i, 1]))
                reconnect(node, nxt, prv, prv[s], s)
                done = False
    return events


@kernel
def share_obstacle(held, a, b):  # type: ignore[no-untyped-def]
    """Whether both nodes are held by one obstacle, held (n, k)."""
    for o in range(held.shape[1]):
        if held[a, o] and held[b, o]:
            return True
    return False


def join_and_part(
    x: Array, v: Array, size: Array, region: Array, held: Array, node: Array, nxt: Array, prv: Array, reach: Array, dt: float,
    gap: float, neck: float,
) -> list[Event]:  # fmt: skip
    """Join fronts that close in on each other, cut necks that get thinner, nearest first.

    Fronts are joined below the distance ``gap`` and necks cut below the width ``neck``, both in sizes; fronts that will be half
    as near within dt (s) are joined at once. reach (n,): how far to look (m).
    """
    events: list[Event] = []
    for _ in range(10):
        slot, distance, closing = nearest(x, v, node, nxt, prv, reach)
        h = size[np.maximum(node, 0)]
        limit = np.array([[gap], [neck]]) * h
        near = (distance < CONTACT * h) | (closing > 0) & (distance < limit)
        near[0] |= (closing[0] > 0) & (distance[0] - dt * closing[0] < 0.5 * gap * h)
        side, s = np.nonzero(near & (slot >= 0) & (node >= 0))
        order = np.argsort(distance[side, s] / h[s], kind="stable")
        side, s = side[order], s[order]
        more = rejoin(x, region, held, node, nxt, prv, side, s, slot[side, s])
        if not more:
            break
        events += more
    return events


@kernel
def rejoin(x, region, held, node, nxt, prv, sides, corners, edges):  # type: ignore[no-untyped-def]
    """Reconnect, in this order, corners (slots) and the edges (slots) that they face on their sides, where nothing forbids it."""
    events = [(0.0, 0.0, 0.0, 0.0) for _ in range(0)]
    for k in range(len(sides)):
        side, s, t = sides[k], corners[k], edges[k]
        if node[s] < 0 or node[t] < 0 or node[s] == node[t] or node[s] == node[nxt[t]]:
            continue
        i, a, b = node[s], node[t], node[nxt[t]]
        if side == 0 and (region[i] != region[a] or share_obstacle(held, a, b)):
            continue
        e = pick_facing(x, node, nxt, prv, s, t, 1.0 if side == 0 else -1.0)
        if e < 0 or (side == 0 and share_obstacle(held, node[e], node[nxt[e]])):
            continue
        events.append((float(MERGE if side == 0 else SEPARATE), change(x, node, nxt, e, t), x[i, 0], x[i, 1]))
        reconnect(node, nxt, prv, e, t)
    return events


def collapse(
    x: Array, size: Array, level: Array, tangent: Array, held: Array, node: Array, nxt: Array, prv: Array, fine: float
) -> tuple[list[tuple[int, int]], list[Event]]:
    """Shrink edges shorter than ``fine`` sizes to a node where the area stays what it was; the shortest first.

    level (n,): by how many obstacles a node is held; tangent (n, 2) along which it may slide if by one. Where an obstacle leaves
    no choice the area changes. Returns pairs of nodes (kept, dropped), and events.
    """
    used = np.flatnonzero(node >= 0)
    i, j = node[used], node[nxt[used]]
    length = np.linalg.norm(x[i] - x[j], axis=1)
    short = length < fine * 0.5 * (size[i] + size[j])
    order = np.argsort(length[short], kind="stable")
    uses = np.bincount(i, minlength=len(x))
    return shrink(x, size, level, tangent, held, node, nxt, prv, uses, used[short][order])


@kernel
def shrink(x, size, level, tangent, held, node, nxt, prv, uses, short):  # type: ignore[no-untyped-def]
    """Collapse the edges of the slots ``short`` in this order; uses (n,): how many corners each node makes."""
    pairs = [(0, 0) for _ in range(0)]
    events = [(0.0, 0.0, 0.0, 0.0) for _ in range(0)]
    for s in short:
        if node[s] < 0:
            continue
        i, j, p, n = node[s], node[nxt[s]], node[prv[s]], node[nxt[nxt[s]]]
        if uses[i] != 1 or uses[j] != 1 or p == n or p == j:
            continue
        length = np.hypot(x[j, 0] - x[i, 0], x[j, 1] - x[i, 1])
        cx, cy = x[n, 0] - x[p, 0], x[n, 1] - x[p, 1]
        area = cross(x, p, i, j) + cross(x, p, j, n)
        mx, my = 0.5 * (x[i, 0] + x[j, 0]), 0.5 * (x[i, 1] + x[j, 1])
        keep = i if level[i] >= level[j] else j
        drop = i + j - keep
        h = 0.5 * (size[i] + size[j])
        if level[keep] == 0:
            c = cx * cx + cy * cy
            if c < (0.1 * h) ** 2:
                continue
            move = (area - ((mx - x[p, 0]) * cy - (my - x[p, 1]) * cx)) / c
            qx, qy = mx + move * cy, my - move * cx
        elif level[keep] == 1:
            if level[drop] == 1:
                if not share_obstacle(held, i, j):
                    continue
                if share_obstacle(held, p, i) and share_obstacle(held, p, j):
                    keep, drop = j, i
            straight = level[drop] == 1 and (
                (keep == j and share_obstacle(held, p, keep)) or (keep == i and share_obstacle(held, keep, n))
            )
            qx, qy = x[keep, 0], x[keep, 1]
            tx, ty = tangent[keep, 0], tangent[keep, 1]
            slope = tx * cy - ty * cx
            if not straight and abs(slope) > 0.3 * np.hypot(cx, cy):
                move = (area - ((qx - x[p, 0]) * cy - (qy - x[p, 1]) * cx)) / slope
                qx, qy = qx + move * tx, qy + move * ty
        else:
            if level[drop] > 1 and length > FOLD * h:
                continue
            qx, qy = x[keep, 0], x[keep, 1]
        if (qx - mx) ** 2 + (qy - my) ** 2 > (0.5 * length + 0.3 * h) ** 2:
            continue
        ox, oy = x[keep, 0], x[keep, 1]
        x[keep, 0], x[keep, 1] = qx, qy
        # Take the dropped corner out of the loop, and put it back if the new edges cross others.
        u = s if drop == i else nxt[s]
        before, after = prv[u], nxt[u]
        nxt[before], prv[after] = after, before
        node[u] = -1
        fold = (qx - x[p, 0]) * (x[n, 0] - qx) + (qy - x[p, 1]) * (x[n, 1] - qy) < -0.9 * np.hypot(
            qx - x[p, 0], qy - x[p, 1]
        ) * np.hypot(x[n, 0] - qx, x[n, 1] - qy)
        if fold or crosses(x, node, nxt, p, keep) or crosses(x, node, nxt, keep, n):
            x[keep, 0], x[keep, 1] = ox, oy
            node[u], nxt[before], prv[after] = drop, u, u
            continue
        pairs.append((keep, drop))
        uses[keep] = uses[drop] = uses[p] = uses[n] = 2  # once each
        events.append((float(RESAMPLE), 0.5 * (cross(x, p, keep, n) - area), qx, qy))
    return pairs, events


@kernel
def give(x, node, nxt, prv, room, start, area):  # type: ignore[no-untyped-def]
    """Move corners outwards along their normals until the loop's area has grown by ``area`` (m2, inwards if negative).

    Begins at slot ``start`` and goes on both ways until there is room for twice the area and for eight corners; room (n,): how far
    (m) each node may go, 0 if not at all, from which is taken what it goes. Returns the area that found no room, 0 if all did.
    """
    count, one = 1, nxt[start]
    while one != start:
        count, one = count + 1, nxt[one]
    slots, spaces, total = [start for _ in range(0)], [0.0 for _ in range(0)], 0.0
    left, right = prv[start], start
    while len(slots) < count and (len(slots) < 8 or total < 2.0 * abs(area)):
        if len(slots) % 2 == 0:
            one, right = right, nxt[right]
        else:
            one, left = left, prv[left]
        i, p, n = node[one], node[prv[one]], node[nxt[one]]
        slots.append(one)
        spaces.append(0.5 * room[i] * np.hypot(x[n, 0] - x[p, 0], x[n, 1] - x[p, 1]))
        total += spaces[-1]
    rest = area
    for one, space in zip(slots, spaces):
        i, p, n = node[one], node[prv[one]], node[nxt[one]]
        chord = np.hypot(x[n, 0] - x[p, 0], x[n, 1] - x[p, 1])
        if space == 0.0 or chord < 1e-3 * room[i]:
            continue
        part = area * (space / total) if total > abs(area) else np.sign(area) * space
        move = 2.0 * part / chord  # with the chord as the moves before have left it, so that the sum is exact
        x[i, 0] += move * (x[n, 1] - x[p, 1]) / chord
        x[i, 1] -= move * (x[n, 0] - x[p, 0]) / chord
        rest -= part
        room[i] = max(room[i] - abs(move), 0.0)
    return rest if abs(rest) > 1e-13 * abs(area) else 0.0
