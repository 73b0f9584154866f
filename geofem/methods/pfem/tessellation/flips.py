"""Edges that a triangulation of the plane must have, put in by flips; numba, serial.

Each missing edge is made by exchanging the diagonals of convex quadrilaterals that it crosses (Sloan 1993), then the triangles
around are made Delaunay again by flips (Lawson 1977), which leave the edges that were put in alone. The result is the
constrained Delaunay triangulation. On which side of a line a node lies is decided exactly.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from geofem.scene import Array

ROUNDING = 2.0**-53


@njit(cache=True, error_model="numpy")
def turn(x: Array, a: int, b: int, c: int) -> float:
    """Positive where c is to the left of the line from a to b, negative to the right, zero exactly on it.

    The determinant's sign is certain beyond Shewchuk's (1997) bound on its rounding; below, its six products are summed up
    without any.
    """
    left = (x[a, 0] - x[c, 0]) * (x[b, 1] - x[c, 1])
    right = (x[a, 1] - x[c, 1]) * (x[b, 0] - x[c, 0])
    if abs(left - right) > (3.0 + 16.0 * ROUNDING) * ROUNDING * (abs(left) + abs(right)):
        return left - right
    # the digits of a sum: numbers that do not overlap, the smallest first
    digits = np.zeros(12)
    n = 0
    for i, j, sign in ((a, b, 1.0), (b, c, 1.0), (c, a, 1.0), (b, a, -1.0), (c, b, -1.0), (a, c, -1.0)):
        p, q = sign * x[i, 0], x[j, 1]
        product = p * q
        p_high, q_high = p * 134217729.0, q * 134217729.0
        p_high, q_high = p_high - (p_high - p), q_high - (q_high - q)
        p_low, q_low = p - p_high, q - q_high
        rest = p_low * q_low - (((product - p_high * q_high) - p_low * q_high) - p_high * q_low)
        for term in (rest, product):
            for k in range(n):
                total = term + digits[k]
                part = total - term
                digits[k] = (term - (total - part)) + (digits[k] - part)
                term = total
            digits[n] = term
            n += 1
    for k in range(n - 1, -1, -1):
        if digits[k] != 0.0:
            return digits[k]
    return 0.0


@njit(cache=True, error_model="numpy")
def in_circle(x: Array, a: int, b: int, c: int, d: int) -> bool:
    """Is d inside the circle through the vertices of a triangle, beyond doubt? Shewchuk's (1997) bound on rounding."""
    ax, ay = x[a, 0] - x[d, 0], x[a, 1] - x[d, 1]
    bx, by = x[b, 0] - x[d, 0], x[b, 1] - x[d, 1]
    cx, cy = x[c, 0] - x[d, 0], x[c, 1] - x[d, 1]
    aa, bb, cc = ax * ax + ay * ay, bx * bx + by * by, cx * cx + cy * cy
    value = aa * (bx * cy - cx * by) + bb * (cx * ay - ax * cy) + cc * (ax * by - bx * ay)
    size = aa * (abs(bx * cy) + abs(cx * by)) + bb * (abs(cx * ay) + abs(ax * cy)) + cc * (abs(ax * by) + abs(bx * ay))
    return value > (10.0 + 96.0 * ROUNDING) * ROUNDING * size


@njit(cache=True, error_model="numpy", inline="always")
def place(cells: Array, c: int, node: int) -> int:
    """The local number of a node in a triangle that has it."""
    if cells[c, 0] == node:
        return 0
    return 1 if cells[c, 1] == node else 2


@njit(cache=True, error_model="numpy", inline="always")
def opposite(cells: Array, c: int, p: int, q: int) -> int:
    """The local number of the node of a triangle that is neither p nor q."""
    j = 0
    while cells[c, j] == p or cells[c, j] == q:
        j += 1
    return j


@njit(cache=True, error_model="numpy")
def facet_of(cells: Array, across: Array, some: Array, p: int, q: int) -> tuple[int, int]:
    """A triangle with the nodes p and q, and which of its edges joins them; -1, -1 if p and q are not joined."""
    start = some[p]
    for backward in range(2):
        c = start
        while c >= 0:
            i = place(cells, c, p)
            if cells[c, (i + 1) % 3] == q:
                return c, (i + 2) % 3
            if cells[c, (i + 2) % 3] == q:
                return c, (i + 1) % 3
            c = across[c, (i + 1 + backward) % 3]
            if c == start:
                return -1, -1
    return -1, -1


@njit(cache=True, error_model="numpy")
def flip(cells: Array, across: Array, marks: Array, some: Array, c: int, k: int) -> None:
    """Exchange the diagonal of the two triangles that share edge k of triangle c, a convex quadrilateral."""
    u = across[c, k]
    r, p, q = cells[c, k], cells[c, (k + 1) % 3], cells[c, (k + 2) % 3]
    j = opposite(cells, u, p, q)
    s = cells[u, j]
    beside_q, mark_q = across[c, (k + 1) % 3], marks[c, (k + 1) % 3]  # across q r
    beside_p, mark_p = across[c, (k + 2) % 3], marks[c, (k + 2) % 3]  # across r p
    # u is s, q, p
    under_p, under_mark_p = across[u, (j + 1) % 3], marks[u, (j + 1) % 3]  # across p s
    under_q, under_mark_q = across[u, (j + 2) % 3], marks[u, (j + 2) % 3]  # across s q
    cells[c, 0], cells[c, 1], cells[c, 2] = r, p, s
    across[c, 0], across[c, 1], across[c, 2] = under_p, u, beside_p
    marks[c, 0], marks[c, 1], marks[c, 2] = under_mark_p, 0, mark_p
    cells[u, 0], cells[u, 1], cells[u, 2] = r, s, q
    across[u, 0], across[u, 1], across[u, 2] = under_q, beside_q, c
    marks[u, 0], marks[u, 1], marks[u, 2] = under_mark_q, mark_q, 0
    for other, was, now in ((under_p, u, c), (beside_q, c, u)):
        if other >= 0:
            for i in range(3):
                if across[other, i] == was:
                    across[other, i] = now
    some[r], some[p], some[s], some[q] = c, c, c, u


@njit(cache=True, error_model="numpy")
def mark(cells: Array, across: Array, marks: Array, some: Array, p: int, q: int) -> None:
    """Hold the edge from p to q: 1 in the triangle on its left, -1 in that on its right; once each way, it is let go."""
    c, k = facet_of(cells, across, some, p, q)
    sign = 1 if cells[c, (k + 1) % 3] == p else -1
    if marks[c, k] == -sign:
        sign = 0
    marks[c, k] = sign
    u = across[c, k]
    if u >= 0:
        for j in range(3):
            if across[u, j] == c:
                marks[u, j] = -sign


@njit(cache=True, error_model="numpy")
def crossed(x: Array, cells: Array, across: Array, marks: Array, some: Array, a: int, b: int, path: Array) -> tuple[int, int]:
    """The next node on the way from a straight to b, and how many edges lie across the way to it; path takes their nodes.

    The node is -1 where there is no such way: it would leave the triangulation, or cross an edge that is held.
    """
    n = 0
    c, k = -1, -1
    start = some[a]
    for backward in range(2):
        t = start
        while t >= 0:
            i = place(cells, t, a)
            p, q = cells[t, (i + 1) % 3], cells[t, (i + 2) % 3]
            if p == b or q == b:
                return b, 0
            beside_p, beside_q = turn(x, a, p, b), turn(x, a, q, b)
            if beside_p == 0.0 and ahead(x, a, p, b):
                return p, 0
            if beside_q == 0.0 and ahead(x, a, q, b):
                return q, 0
            if beside_p > 0.0 and beside_q < 0.0:
                c, k = t, i
                break
            t = across[t, (i + 1 + backward) % 3]
            if t == start:
                break
        if c >= 0:
            break
    while c >= 0:
        if marks[c, k] != 0:
            return -1, 0
        p, q = cells[c, (k + 1) % 3], cells[c, (k + 2) % 3]
        path[n, 0], path[n, 1] = p, q
        n += 1
        c = across[c, k]
        if c < 0:
            break
        s = cells[c, opposite(cells, c, p, q)]
        side = turn(x, a, b, s)
        if s == b or side == 0.0:
            return s, n
        # p is to the right of the way and q to its left: leave through the edge that joins s to the one of the other side
        k = place(cells, c, q if side > 0.0 else p)
    return -1, 0


@njit(cache=True, error_model="numpy", inline="always")
def ahead(x: Array, a: int, p: int, b: int) -> bool:
    """Does p, on the line through a and b, lie on the same side of a as b?"""
    return (x[p, 0] - x[a, 0]) * (x[b, 0] - x[a, 0]) + (x[p, 1] - x[a, 1]) * (x[b, 1] - x[a, 1]) > 0.0


@njit(cache=True, error_model="numpy")
def clear(x: Array, cells: Array, across: Array, marks: Array, some: Array, a: int, b: int, queue: Array, n: int) -> bool:
    """Flip the n edges (in queue) across a free way from a to b until a and b are joined; whether that came to an end."""
    made = np.empty((n, 2), np.int64)
    count, head, waiting = 0, 0, n
    for _ in range(8 * n * n + 64):
        if waiting == 0:
            break
        p, q = queue[head, 0], queue[head, 1]
        head = (head + 1) % n
        waiting -= 1
        c, k = facet_of(cells, across, some, p, q)
        r = cells[c, k]
        u = across[c, k]
        s = cells[u, opposite(cells, u, p, q)]
        if turn(x, r, s, p) * turn(x, r, s, q) < 0.0:
            flip(cells, across, marks, some, c, k)
            if r != a and r != b and s != a and s != b and turn(x, a, b, r) * turn(x, a, b, s) < 0.0:
                p, q = r, s
            else:
                made[count, 0], made[count, 1] = r, s
                count += 1
                continue
        tail = (head + waiting) % n
        queue[tail, 0], queue[tail, 1] = p, q
        waiting += 1
    for e in range(count):
        if not ((made[e, 0] == a and made[e, 1] == b) or (made[e, 0] == b and made[e, 1] == a)):
            smooth(x, cells, across, marks, some, a, b, made[e, 0], made[e, 1])
    return waiting == 0


@njit(cache=True, error_model="numpy")
def smooth(x: Array, cells: Array, across: Array, marks: Array, some: Array, a: int, b: int, p: int, q: int) -> None:
    """Flip the edge from p to q, and those around it, wherever that makes the triangles Delaunay; a to b is left alone."""
    stack = np.empty((64, 2), np.int64)
    stack[0, 0], stack[0, 1] = p, q
    n = 1
    while n > 0:
        n -= 1
        p, q = stack[n, 0], stack[n, 1]
        c, k = facet_of(cells, across, some, p, q)
        if c < 0 or across[c, k] < 0 or marks[c, k] != 0 or (p == a and q == b) or (p == b and q == a):
            continue
        u = across[c, k]
        r, p, q = cells[c, k], cells[c, (k + 1) % 3], cells[c, (k + 2) % 3]
        s = cells[u, opposite(cells, u, p, q)]
        if not in_circle(x, r, p, q, s) or not turn(x, r, s, p) * turn(x, r, s, q) < 0.0:
            continue
        flip(cells, across, marks, some, c, k)
        if n + 4 > len(stack):
            longer = np.empty((2 * len(stack), 2), np.int64)
            for i in range(n):
                longer[i, 0], longer[i, 1] = stack[i, 0], stack[i, 1]
            stack = longer
        for v, w in ((r, p), (p, s), (s, q), (q, r)):
            stack[n, 0], stack[n, 1] = v, w
            n += 1


@njit(cache=True, error_model="numpy")
def hold(x: Array, cells: Array, across: Array, edges: Array) -> tuple[Array, Array]:
    """Put the edges (k, 2) into a Delaunay triangulation, in place.

    Returns marks (m, 3), 1 where the triangle is to the left of the held edge and -1 to its right, 0 for all other edges;
    and which edges (k,) could not be held in full, since they cross one that was before, or end in no triangle. A node on
    an edge divides it; an edge that is given once each way has the body on both sides, and is free.
    """
    marks = np.zeros(cells.shape, np.int8)
    some = np.full(len(x), -1, np.int64)
    for c in range(len(cells)):
        for k in range(3):
            some[cells[c, k]] = c
    refused = np.zeros(len(edges), np.bool_)
    path = np.empty((2 * len(cells), 2), np.int64)
    for e in range(len(edges)):
        a, b = edges[e, 0], edges[e, 1]
        if some[a] < 0 or some[b] < 0:
            refused[e] = True
            continue
        while a != b:
            end, n = crossed(x, cells, across, marks, some, a, b, path)
            if end < 0 or (n > 0 and not clear(x, cells, across, marks, some, a, end, path, n)):
                refused[e] = True
                break
            mark(cells, across, marks, some, a, end)
            a = end
    return marks, refused


@njit(cache=True, error_model="numpy")
def sides(cells: Array, across: Array, marks: Array) -> Array:
    """On which side of the held edges each triangle lies: 1 on the left, -1 on the right, 0 where they do not agree.

    The outside of the triangulation is on the right.
    """
    out = np.zeros(len(cells), np.int8)
    part = np.full(len(cells), -1, np.int64)
    queue = np.empty(len(cells), np.int64)
    for seed in range(len(cells)):
        if part[seed] >= 0:
            continue
        queue[0] = seed
        part[seed] = seed
        n, done = 1, 0
        left, right = False, False
        while done < n:
            c = queue[done]
            done += 1
            for k in range(3):
                left |= marks[c, k] > 0
                right |= marks[c, k] < 0
                u = across[c, k]
                if marks[c, k] == 0:
                    if u < 0:
                        right = True
                    elif part[u] < 0:
                        part[u] = seed
                        queue[n] = u
                        n += 1
        side = int(left) - int(right)
        for i in range(n):
            out[queue[i]] = side
    return out
