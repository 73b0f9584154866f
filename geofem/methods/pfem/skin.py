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
        if not (length > coarse).any():
            return facets
        ends = np.sort(np.stack([facets, np.roll(facets, -1, axis=1)], axis=2), axis=2)
        keys, first, edges, uses = np.unique(
            ends @ np.array([cloud.n, 1]), return_index=True, return_inverse=True, return_counts=True
        )
        edges = edges.reshape(facets.shape)
        rank = np.empty(len(keys), np.int64)
        rank[np.argsort(length.ravel()[first], kind="stable")] = np.arange(len(keys))  # no two are equally long
        longest = rank[edges].argmax(axis=1)
        rows = np.arange(len(facets))
        edge = edges[rows, longest]
        cut = (np.bincount(edge, minlength=len(keys)) == uses)[edge] & (length[rows, longest] > coarse)
        chosen, which = np.unique(edge[cut], return_inverse=True)
        parents = np.stack(np.divmod(keys[chosen], cloud.n), axis=1)
        middle = cloud.add(parents, np.full(parents.shape, 0.5))[which]
        a, b, c = (facets[rows, (longest + k) % 3][cut] for k in range(3))
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
def vector_area(x, a, b, c):  # type: ignore[no-untyped-def]
    """Twice the vector area (m2) of a triangle, and its length."""
    ux, uy, uz = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
    vx, vy, vz = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return nx, ny, nz, np.sqrt(nx * nx + ny * ny + nz * nz)


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
            for i in range(len(x)):
                link[i] = 0
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
                    for i in range(3):
                        facets[f, i] = -1
                elif has_drop:
                    for i in range(3):
                        if facets[f, i] == drop:
                            facets[f, i] = keep
            break
    return gone


@kernel
def upright(x, facet, drop, keep):  # type: ignore[no-untyped-def]
    """Whether a facet looks much the same way as before once its node ``drop`` is at ``keep``."""
    a, b, c = facet[0], facet[1], facet[2]
    ux, uy, uz, before = vector_area(x, a, b, c)
    vx, vy, vz, after = vector_area(x, keep if a == drop else a, keep if b == drop else b, keep if c == drop else c)
    return ux * vx + uy * vy + uz * vz > 0.3 * before * after


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
        free = np.flatnonzero(room > 0)
        near = free[np.argsort(((x[free] - at) ** 2).sum(axis=1), kind="stable")]
        rest = float(give(x, facets, starts, order // 3, room, near, volume))
        budget.book("restore", budget.made(float(volume) - rest, np.array(at)))
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
            twice = vector_area(x, cells[c, (k + 1) % 4], cells[c, (k + 2) % 4], cells[c, (k + 3) % 4])[3]
            least[cells[c, k]] = min(least[cells[c, k]], six / max(twice, 1e-300))
    return least


@kernel
def slope(x, facets, around):  # type: ignore[no-untyped-def]
    """d volume / d x of a node (m2), a third of the vector area of its facets ``around``, wherever it is; and its length, or 0."""
    nx, ny, nz, total = 0.0, 0.0, 0.0, 0.0
    for f in around:
        x1, y1, z1, size = vector_area(x, facets[f, 0], facets[f, 1], facets[f, 2])
        nx, ny, nz, total = nx + x1 / 6, ny + y1 / 6, nz + z1 / 6, total + size / 6
    size = np.sqrt(nx * nx + ny * ny + nz * nz)
    return nx, ny, nz, size if size > 0.5 * total else 0.0  # none of a spike, or where bodies touch


@kernel
def give(x, facets, starts, around, room, near, volume):  # type: ignore[no-untyped-def]
    """Share the volume (m3) among the first of the nodes ``near`` (k,) that have room; what they go is taken from it.

    Returns what found none.
    """
    spaces, total, count = np.empty(len(near)), 0.0, 0
    for i in near:
        if count >= SHARERS and total >= 2.0 * abs(volume):
            break
        spaces[count] = room[i] * slope(x, facets, around[starts[i] : starts[i + 1]])[3]
        total += spaces[count]
        count += 1
    rest = volume
    for k in range(count):
        i = near[k]
        # as the moves before have left it, so that the sum is exact
        nx, ny, nz, size = slope(x, facets, around[starts[i] : starts[i + 1]])
        if size == 0.0 or spaces[k] == 0.0:
            continue
        part = volume * (spaces[k] / total) if total > abs(volume) else np.sign(volume) * spaces[k]
        way = part / size**2
        x[i, 0], x[i, 1], x[i, 2] = x[i, 0] + way * nx, x[i, 1] + way * ny, x[i, 2] + way * nz
        rest -= part
        room[i] = max(room[i] - abs(part) / size, 0.0)
    return rest if abs(rest) > 1e-13 * abs(volume) else 0.0
