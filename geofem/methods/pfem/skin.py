"""The boundary in space between two steps: long edges split, short ones collapsed, and volume given back to the free surface.

The boundary is closed triangles, which share nodes and need not be a manifold where bodies touch in a node or an edge.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from geofem.methods.pfem.budget import Budget
from geofem.methods.pfem.cloud import Cloud
from geofem.methods.pfem.loops import kernel
from geofem.methods.pfem.tessellation.simplices import six_volumes
from geofem.scene import Array

ROOM = 0.1
"""A node goes no farther than this part of its size, and of the least height of its cells, when it takes volume."""
SHARERS = 8
"""At least so many nodes share a volume that is given back."""


def lengths(cloud: Cloud, facets: Array) -> Array:
    """Of the edges of facets (k, 3), from each node to the next, in sizes (k, 3)."""
    a, b = facets, np.roll(facets, -1, axis=1)
    return np.linalg.norm(cloud.x[a] - cloud.x[b], axis=2) / (0.5 * (cloud.size[a] + cloud.size[b]))


def split(cloud: Cloud, facets: Array, coarse: float) -> Array:
    """Put nodes in the middle of edges longer than ``coarse`` sizes until there are none: the volume stays. Returns the new facets.

    An edge waits until it is the longest of all facets that it has (Rivara 1984), so that no facet is cut twice at a time.
    """
    while True:
        length = lengths(cloud, facets)
        edge = length.argmax(axis=1)
        rows = np.arange(len(facets))
        if not (length[rows, edge] > coarse).any():
            return facets
        a, b, c = (facets[rows, (edge + k) % 3] for k in range(3))
        every = np.sort(np.stack([facets, np.roll(facets, -1, axis=1)], axis=2), axis=2) @ np.array([cloud.n, 1])
        keys, inverse = np.unique(every, return_inverse=True)
        inverse = inverse.reshape(every.shape)
        longest = np.bincount(inverse[rows, edge], minlength=len(keys)) == np.bincount(inverse.ravel(), minlength=len(keys))
        cut = longest[inverse[rows, edge]] & (length[rows, edge] > coarse)
        if not cut.any():  # edges of equal length in a ring
            cut = (inverse[rows, edge] == inverse[length.max(axis=1).argmax(), edge[length.max(axis=1).argmax()]]) & (edge >= 0)
        chosen, which = np.unique(inverse[rows, edge][cut], return_inverse=True)
        ends = np.stack(np.divmod(keys[chosen], cloud.n), axis=1)
        middle = cloud.add(ends, np.full(ends.shape, 0.5))[which]
        a, b, c = a[cut], b[cut], c[cut]
        halves = [np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)]
        facets = np.concatenate([facets[~cut], *halves])


def collapse(cloud: Cloud, facets: Array, held: Array, fine: float) -> tuple[Array, Array]:
    """Shrink edges shorter than ``fine`` sizes to the end that more obstacles hold, the shortest first.

    held (n, k): who is held by what. Returns the new facets, and the nodes (n,) bool that are in none of them any more.
    """
    length = lengths(cloud, facets)
    row, k = np.nonzero(length < fine)
    order = np.argsort(length[row, k], kind="stable")
    pairs = np.stack([facets[row, k], facets[row, (k + 1) % 3]], axis=1)[order]
    facets = facets.copy()
    gone = shrink(np.ascontiguousarray(cloud.x), facets, held, pairs)
    return facets[facets[:, 0] >= 0], gone


@kernel
def shrink(x, facets, held, pairs):  # type: ignore[no-untyped-def]
    """Collapse the edges ``pairs`` (j, 2), in this order, no two that share a neighbour; facets that go get -1. Returns who went."""
    gone, near = np.zeros(len(x), np.bool_), np.zeros(len(x), np.bool_)
    link = np.zeros(len(x), np.int64)
    for p in range(len(pairs)):
        for turn in range(2):
            keep, drop = pairs[p, turn], pairs[p, 1 - turn]
            if near[keep] or near[drop]:
                break
            legal = True
            for o in range(held.shape[1]):
                legal &= held[keep, o] or not held[drop, o]
            link[:] = 0
            for f in range(len(facets)):
                has_keep = has_drop = False
                for i in range(3):
                    has_keep |= facets[f, i] == keep
                    has_drop |= facets[f, i] == drop
                for i in range(3):
                    if facets[f, 0] >= 0:
                        link[facets[f, i]] |= (1 if has_keep else 0) + (2 if has_drop else 0)
                if has_drop and not has_keep and facets[f, 0] >= 0:
                    legal &= upright(x, facets[f], drop, keep)
            shared = -2  # the two ends themselves
            for i in range(len(x)):
                shared += link[i] == 3
            if not legal or shared != 2:  # else facets would fold, or two sheets be glued to each other
                continue
            gone[drop] = True
            for i in range(len(x)):
                near[i] |= link[i] > 0
            for f in range(len(facets)):
                has_keep = has_drop = False
                for i in range(3):
                    has_keep |= facets[f, i] == keep
                    has_drop |= facets[f, i] == drop
                if has_keep and has_drop:
                    facets[f, :] = -1
                elif has_drop:
                    for i in range(3):
                        if facets[f, i] == drop:
                            facets[f, i] = keep
            break
    return gone


@kernel
def upright(x, facet, drop, keep):  # type: ignore[no-untyped-def]
    """Whether a facet looks the same way as before once its node ``drop`` is at ``keep``."""
    before, after = np.zeros(3), np.zeros(3)
    for i in range(3):
        j = (i + 1) % 3
        a, b = facet[i], facet[j]
        c, d = (keep if a == drop else a), (keep if b == drop else b)
        for k in range(3):
            l, m = (k + 1) % 3, (k + 2) % 3
            before[k] += x[a, l] * x[b, m] - x[a, m] * x[b, l]
            after[k] += x[c, l] * x[d, m] - x[c, m] * x[d, l]
    return (before * after).sum() > 0.3 * np.sqrt((before**2).sum() * (after**2).sum())


def swept(x: Array, old: Array, new: Array) -> Array:
    """Places and volumes (j, 4) between two boundaries (k, 3) of the nodes x (n, 3), one for each part in which they differ.

    A volume is positive where the new boundary encloses more.
    """
    n = len(x)
    key = np.array([n * n, n, 1])
    old_keys, new_keys = (np.sort(facets, axis=1) @ key for facets in (old, new))
    lost, gained = old[~np.isin(old_keys, new_keys)], new[~np.isin(new_keys, old_keys)]
    changed = np.concatenate([lost, gained])
    if not len(changed):
        return np.zeros((0, 4))
    pairs = np.concatenate([changed[:, :2], changed[:, 1:]])
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    parts = connected_components(graph, directed=False)[1][changed[:, 0]]
    _, part, counts = np.unique(parts, return_inverse=True, return_counts=True)
    corners = x[changed]
    centre = corners.mean(axis=1)
    middle = np.stack([np.bincount(part, centre[:, k]) for k in range(3)], axis=1) / counts[:, None]
    a, b, c = (corners[:, k] - middle[part] for k in range(3))
    volume = np.einsum("kd,kd->k", a, np.cross(b, c)) / 6
    volume[: len(lost)] *= -1
    return np.column_stack([middle, np.bincount(part, volume)])


def give_back(cloud: Cloud, cells: Array, facets: Array, level: Array, due: Array, budget: Budget) -> None:
    """Move nodes of the free surface along their normals until the volumes (m3) that are due (j, 4) near by are given back.

    level (n,): by how many obstacles a node is held; held ones stay. What finds no room is owed.
    """
    x = np.ascontiguousarray(cloud.x)
    room = np.minimum(ROOM * cloud.size, ROOM * least_height(x, cells))
    free = np.zeros(cloud.n, bool)
    free[facets] = True
    room[(level > 0) | ~free] = 0.0
    order = np.argsort(facets.ravel(), kind="stable")
    starts = np.searchsorted(facets.ravel()[order], np.arange(cloud.n + 1))
    owed = []
    for *at, volume in due:
        rest = float(give(x, facets, starts, order // 3, room, np.array(at), volume))
        budget.book("restore", budget.made(volume - rest, np.array(at)))
        if rest:
            owed.append((*at, rest))
    cloud.x = x
    budget.owed = np.array(owed).reshape(-1, 4)


@kernel
def least_height(x, cells):  # type: ignore[no-untyped-def]
    """Of each node (n,) the least distance from the opposite facet of its cells (m); inf without cells."""
    least = np.full(len(x), np.inf)
    for c in range(len(cells)):
        six = six_volumes(x, cells[c, 0], cells[c, 1], cells[c, 2], cells[c, 3])
        for k in range(4):
            p, q, r = x[cells[c, (k + 1) % 4]], x[cells[c, (k + 2) % 4]], x[cells[c, (k + 3) % 4]]
            twice = np.sqrt((np.cross(q - p, r - p) ** 2).sum())
            least[cells[c, k]] = min(least[cells[c, k]], six / max(twice, 1e-300))
    return least


@kernel
def area(x, facets, around, i):  # type: ignore[no-untyped-def]
    """d volume / d x of node i (3,) (m2): a third of the vector area of its facets, whatever its own place is."""
    total, size = np.zeros(3), 0.0
    for f in around:
        a, b, c = facets[f]
        normal = np.cross(x[b] - x[a], x[c] - x[a]) / 6.0
        total += normal
        size += np.sqrt((normal**2).sum())
    if (total**2).sum() < 0.25 * size**2:  # a spike, or where bodies touch
        total[:] = 0.0
    return total


@kernel
def give(x, facets, starts, around, room, at, volume):  # type: ignore[no-untyped-def]
    """Share the volume (m3) among the nearest nodes that have room, from which is taken what they go. Returns what found none."""
    free = np.flatnonzero(room > 0.0)
    order = np.argsort(((x[free] - at) ** 2).sum(axis=1))
    nodes, spaces, total = np.empty(len(free), np.int64), np.empty(len(free)), 0.0
    count = 0
    for i in free[order]:
        if count >= SHARERS and total >= 2.0 * abs(volume):
            break
        normal = area(x, facets, around[starts[i] : starts[i + 1]], i)
        nodes[count], spaces[count] = i, room[i] * np.sqrt((normal**2).sum())
        total += spaces[count]
        count += 1
    rest = volume
    for k in range(count):
        i = nodes[k]
        normal = area(x, facets, around[starts[i] : starts[i + 1]], i)
        size = np.sqrt((normal**2).sum())
        if size == 0.0 or spaces[k] == 0.0:
            continue
        part = volume * (spaces[k] / total) if total > abs(volume) else np.sign(volume) * spaces[k]
        x[i] += part / size * (normal / size)  # with the area as the moves before have left it, so that the sum is exact
        rest -= part
        room[i] = max(room[i] - abs(part) / size, 0.0)
    return rest if abs(rest) > 1e-13 * abs(volume) else 0.0
