"""Between two steps: nodes added and removed, the boundary changed, and the cells made anew, with all of it accounted for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from geofem.methods.pfem.budget import Budget, lumped, volumes
from geofem.methods.pfem.cloud import Cloud
from geofem.methods.pfem.contact import Contact
from geofem.methods.pfem.loops import first_crossing, kernel, link, nearest
from geofem.methods.pfem.openings import leaving, let_out
from geofem.methods.pfem.skin import collapse, give_back, lengths, split, swept
from geofem.methods.pfem.surface import Rules, change_boundary
from geofem.methods.pfem.tessellation import Tessellation, Tessellator
from geofem.methods.pfem.tessellation.simplices import parents, quality
from geofem.scene import Array


@kernel
def short_edges(x, size, cells, fine):  # type: ignore[no-untyped-def]
    """Edges of cells below ``fine`` sizes: (k, 2) nodes, an edge as often as it has cells, and lengths (k,) in sizes."""
    count, corners = 0, cells.shape[1]
    edges, lengths = np.empty((64, 2), np.int64), np.empty(64)
    for c in range(len(cells)):
        for k in range(corners):
            for l in range(k):
                a, b = cells[c, k], cells[c, l]
                square = 0.0
                for d in range(x.shape[1]):
                    square += (x[a, d] - x[b, d]) ** 2
                length = np.sqrt(square) / (0.5 * (size[a] + size[b]))
                if length < fine:
                    if count == len(lengths):
                        edges, lengths = np.concatenate((edges, edges)), np.concatenate((lengths, lengths))
                    edges[count, 0], edges[count, 1], lengths[count] = min(a, b), max(a, b), length
                    count += 1
    return edges[:count], lengths[:count]


@kernel
def spare(short, removable, n):  # type: ignore[no-untyped-def]
    """Nodes (n,) bool to remove so that of each short edge (k, 2), in this order, one end goes; no two that are neighbours."""
    gone, kept = np.zeros(n, np.bool_), np.zeros(n, np.bool_)
    for k in range(len(short)):
        a, b = short[k]
        if gone[a] or gone[b]:
            continue
        if removable[b] and not kept[b]:
            gone[b], kept[a] = True, True
        elif removable[a] and not kept[a]:
            gone[a], kept[b] = True, True
    return gone


def beside(x: Array, size: Array, who: Array, facets: Array, room: float) -> Array:
    """Which of the nodes (n,) bool ``who`` are nearer to a boundary edge (k, 2) than ``room`` sizes, (n,) bool."""
    ends = x[facets, 0]
    left = ends.min(axis=1)
    order = np.argsort(left, kind="stable")
    return look_beside(x, room * size, who, facets[order], left[order], float(np.ptp(ends, axis=1).max(initial=0.0)))


@kernel
def look_beside(x, near, who, facets, left, widest):  # type: ignore[no-untyped-def]
    found = np.zeros(len(x), np.bool_)
    for i in range(len(x)):
        reach = near[i]
        k = np.searchsorted(left, x[i, 0] - reach - widest)
        while who[i] and not found[i] and k < len(left) and left[k] <= x[i, 0] + reach:
            a, b = facets[k]
            k += 1
            ex, ey, dx, dy = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[i, 0] - x[a, 0], x[i, 1] - x[a, 1]
            share = min(max((dx * ex + dy * ey) / max(ex * ex + ey * ey, 1e-300), 0.0), 1.0)
            found[i] = (dx - share * ex) ** 2 + (dy - share * ey) ** 2 < reach**2
    return found


@kernel
def apart(cells, n):  # type: ignore[no-untyped-def]
    """Rows (m,) bool of cells, taken in their order, no two of which share a facet."""
    taken, marked = np.zeros(len(cells), np.bool_), np.zeros(n, np.bool_)
    for c in range(len(cells)):
        shared = 0
        for i in cells[c]:
            shared += marked[i]
        if shared < cells.shape[1] - 1:
            taken[c] = True
            for i in cells[c]:
                marked[i] = True
    return taken


def removable(cloud: Cloud, cells: Array, facets: Array, held: Array, rules: Rules) -> Array:
    """Interior nodes (n,) bool that are too near to others or to the boundary."""
    inner = np.zeros(cloud.n, bool)
    inner[cells] = True
    inner[facets] = False
    inner &= cloud.carried == 0
    if not rules.boundary:
        inner &= ~held.any(axis=1)
    short, length = short_edges(cloud.x, cloud.size, cells, rules.fine)
    gone = spare(short[np.argsort(length, kind="stable")], inner, cloud.n)
    if rules.boundary:
        gone |= beside(cloud.x, cloud.size, inner, facets, rules.beside)
    return gone


@kernel
def spread(x, size, cells, volumes, big, fine):  # type: ignore[no-untyped-def]
    """Volumes (m,) of cells over that of one that is ``big`` (in sizes); 0 with no room for a node ``fine`` sizes from others."""
    corners, gdim = cells.shape[1], x.shape[1]
    excess = np.zeros(len(cells))
    for c in range(len(cells)):
        h = 0.0
        for i in cells[c]:
            h += size[i] / corners
        if volumes[c] <= big * h**gdim:
            continue
        least = 1e300
        for i in cells[c]:
            square = 0.0
            for d in range(gdim):
                middle = 0.0
                for j in cells[c]:
                    middle += x[j, d] / corners
                square += (x[i, d] - middle) ** 2
            least = min(least, square)
        if least > (fine * h) ** 2:
            excess[c] = volumes[c] / (big * h**gdim)
    return excess


def too_big(cloud: Cloud, cells: Array, rules: Rules) -> Array:
    """Rows of the cells that get a node in their middle, no two of them neighbours."""
    regular = np.sqrt(3) / 4 if cloud.x.shape[1] == 2 else np.sqrt(2) / 12
    excess = spread(cloud.x, cloud.size, cells, volumes(cloud.x, cells), rules.big * regular, rules.fine)
    rows = np.flatnonzero(excess > 1)
    rows = rows[np.argsort(-excess[rows], kind="stable")]
    return rows[apart(cells[rows], cloud.n)]


@dataclass
class Carried:
    """Mass and momentum (1 + gdim columns), by ids: of_nodes (n, 1 + gdim) at x (n, gdim), flying ones too, and of_cells
    (m, 1 + gdim) to tell which of the cells are as they were. The density is 1 where the nodes have none (field ``density``)."""

    id: Array
    x: Array
    of_nodes: Array
    cells: Array
    of_cells: Array

    @classmethod
    def of(cls, cloud: Cloud, cells: Array) -> Carried:
        amount = np.column_stack([np.ones(cloud.n), cloud.v])
        if "density" in cloud.fields:
            amount *= cloud.fields["density"][:, None]
        share = volumes(cloud.x, cells)[:, None] * amount[cells].mean(axis=1)
        return cls(cloud.id, cloud.x, lumped(cloud, cells)[:, None] * amount, cloud.id[cells], share)


def balance(cloud: Cloud, tessellation: Tessellation, before: Carried, links: Array, blocked: Array) -> None:
    """Change velocities so that each patch of cells that were made anew has the momentum that was there before, and densities, where
    nodes have them, so that it has the mass.

    A patch is cells, old and new, that hang together by nodes; what vanished whole belongs to that of the nearest node.
    links (k, 2): ids of nodes that belong to one patch. blocked (n, gdim) bool: components that obstacles prescribe.
    """
    now = Carried.of(cloud, tessellation.cells)
    old, new = np.ones(len(before.cells), bool), np.ones(len(now.cells), bool)
    same = np.flatnonzero(tessellation.parents >= 0)
    same = same[(before.of_cells[tessellation.parents[same]] == now.of_cells[same]).all(axis=1)]
    old[tessellation.parents[same]], new[same] = False, False
    groups = [before.cells[old], now.cells[new]]
    n = cloud.next_id
    pairs = np.concatenate([np.column_stack([g[:, 0], g[:, k]]) for g in groups for k in range(1, g.shape[1])] + [links])

    def joined() -> tuple[int, Array]:
        return connected_components(coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n)), directed=False)

    def summed(whole: Carried, column: int) -> Array:
        who = touched[whole.id]
        return np.bincount(patch[whole.id[who]], whole.of_nodes[who, column], patches)

    touched = np.zeros(n, bool)
    touched[pairs] = True
    patches, patch = joined()
    gone = (summed(now, 0) <= 0.0) & (summed(before, 0) > 0.0)
    if gone.any():
        lost, alive = np.flatnonzero(gone[patch[before.id]] & touched[before.id]), np.flatnonzero(now.of_nodes[:, 0] > 0.0)
        nearest_alive = alive[cKDTree(now.x[alive]).query(before.x[lost])[1]]
        pairs = np.concatenate([pairs, np.column_stack([before.id[lost], now.id[nearest_alive]])])
        touched[pairs] = True
        patches, patch = joined()
    mine = patch[cloud.id]
    if "density" in cloud.fields:
        ratio = summed(before, 0) / np.maximum(summed(now, 0), 1e-300)
        cloud.fields["density"] *= np.where(touched[cloud.id], ratio[mine], 1.0)
        now = Carried.of(cloud, tessellation.cells)
    mass = now.of_nodes[:, 0]
    for d in range(cloud.x.shape[1]):
        takes = touched[cloud.id] & ~blocked[:, d] & (mass > 0)
        total = np.bincount(mine[takes], mass[takes], patches)
        change = (summed(before, 1 + d) - summed(now, 1 + d)) / np.where(total > 0, total, 1.0)
        cloud.v[takes, d] += change[mine[takes]]


def tessellate(cloud: Cloud, old: Tessellation, tessellator: Tessellator, rules: Rules) -> Tessellation:
    """The new cells; what flies has none, unless the tessellator finds the boundary anew."""
    if not rules.boundary:
        return tessellator(cloud.x, cloud.size, old)
    grounded = np.flatnonzero(cloud.carried == 0)
    number = np.cumsum(cloud.carried == 0) - 1
    # Without the old cells: nodes that the boundary has passed over are to be left outside.
    bare = Tessellation(np.zeros((0, 3), np.int64), number[old.facets], old.parents[:0])
    new = tessellator(cloud.x[grounded], cloud.size[grounded], bare)
    cells = grounded[new.cells]
    return Tessellation(cells, grounded[new.facets], parents(cells, old.cells))


def refused(x: Array, facets: Array, new: Tessellation) -> Array:
    """Place and area (1, 3) that the cells lack of what the boundary (k, 2) enclosed, (0, 3) if they have it all.

    For where edges run into each other none of which was found to cross, the tessellator has the last word.
    """
    a, b = x[facets[:, 0]], x[facets[:, 1]]
    lacking = 0.5 * float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()) - float(volumes(x, new.cells).sum())
    key = len(x)
    lost = facets[~np.isin(facets @ [key, 1], new.facets @ [key, 1])]
    if len(lost) == 0:
        return np.zeros((0, 3))
    return np.array([[*x[lost].mean(axis=(0, 1)), lacking]])


def remesh(
    cloud: Cloud,
    tessellation: Tessellation,
    obstacles: Contact,
    tessellator: Tessellator,
    rules: Rules,
    budget: Budget,
    dt: float,
) -> Tessellation:
    """New nodes, boundary and cells after a step; dt (s) is the step to come. Mutates the cloud.

    ``parents`` of the answer are rows of the tessellation that was given. What has passed an outlet goes. Volume is kept but for what
    the budget says, momentum patch by patch (components at obstacles excepted), and so is the mass of nodes that have a density
    (field ``density``).
    """
    booked = budget.total()
    before, flying = Carried.of(cloud, tessellation.cells), cloud.carried > 0
    facets, useless, links = tessellation.facets, np.zeros(cloud.n, bool), np.zeros((0, 2), np.int64)
    ids, x = cloud.id, cloud.x
    left = useless
    if leaving(cloud, obstacles):
        facets, left, lost = let_out(cloud, tessellation.cells, facets, obstacles, budget)
        before.of_cells[:, 1:] -= lost
        np.subtract.at(before.of_nodes[:, 1:], tessellation.cells, lost[:, None] / 3)
        before.of_nodes[left[: len(flying)] & flying] = 0.0
    if rules.boundary:
        facets, useless, links = change_boundary(cloud, facets, obstacles, rules, dt, budget)
    elif rules.skin:
        facets = split(cloud, facets, rules.coarse)
        facets, useless = collapse(cloud, facets, obstacles.held(cloud), rules.fine)
    else:
        budget.owed = budget.owed[:0]
    links = cloud.id[links]
    useless[: len(left)] |= left
    gone = useless | removable(cloud, tessellation.cells, facets, obstacles.held(cloud), rules)
    whole = ~(gone | (cloud.carried > 0))[tessellation.cells].any(axis=1)
    rows = np.flatnonzero(whole)
    number = np.cumsum(~gone) - 1
    cloud.keep(~gone)
    old = Tessellation(number[tessellation.cells[rows]], number[facets], rows)
    new = tessellate(cloud, old, tessellator, rules)
    big = too_big(cloud, new.cells, rules)
    if len(big):
        corners = new.cells[big]
        cloud.add(corners, np.full(corners.shape, 1 / corners.shape[1]))
        new = tessellate(cloud, Tessellation(old.cells, new.facets, rows), tessellator, rules)
    if rules.boundary:
        budget.owed = np.concatenate([budget.owed, refused(cloud.x, old.facets, new)])
        # Nodes that the boundary has passed over go.
        used = cloud.carried > 0
        used[new.cells] = True
        number = np.cumsum(used) - 1
        cloud.keep(used)
        new = Tessellation(number[new.cells], number[new.facets], new.parents)
    new = Tessellation(new.cells, new.facets, np.append(rows, -1)[new.parents])  # -1 stays -1
    touch = obstacles.touch(cloud)
    if rules.skin:
        places = np.zeros((cloud.next_id, 3))
        places[ids], places[cloud.id] = x, cloud.x
        due = swept(places, ids[tessellation.facets], cloud.id[new.facets]) * [1, 1, 1, -1]
        give_back(cloud, new.cells, new.facets, touch.count, np.concatenate([budget.owed, due]), budget)
    balance(cloud, new, before, links, (np.abs(touch.normals) > 0.1).any(axis=1))
    budget.book("resample", budget.look(cloud, new.cells) - (budget.total() - booked))
    return new


def needs(cloud: Cloud, tessellation: Tessellation, rules: Rules, budget: Budget, dt: float) -> bool:
    """Whether anything asks for ``remesh``: bad or big cells, edges, fronts that meet within dt (s), volume owed or flying."""
    x, cells, facets = cloud.x, tessellation.cells, tessellation.facets
    if (quality(x, cells) < rules.quality).any() or len(short_edges(x, cloud.size, cells, rules.fine)[0]):
        return True
    if len(too_big(cloud, cells, rules)):
        return True
    if rules.skin:
        owed = float(np.abs(budget.owed[:, -1]).sum())
        return bool((lengths(cloud, facets) > rules.coarse).any()) or owed > 1e-9 * float((cloud.size**3).max())
    if not rules.boundary:
        return False
    a, b = facets.T
    length = np.linalg.norm(x[a] - x[b], axis=1) / (0.5 * (cloud.size[a] + cloud.size[b]))
    if (
        (length > rules.coarse).any()
        or (cloud.carried > 0).any()
        or np.abs(budget.owed[:, 2]).sum() > 1e-9 * (cloud.size**2).max()
    ):
        return True
    node, nxt, prv = link(x, facets)
    speed = np.linalg.norm(cloud.v - cloud.v[a].mean(axis=0), axis=1)[a].max(initial=0.0)
    reach = np.minimum(rules.gap * cloud.size + 2 * dt * speed, 1.5 * cloud.size)
    slot, distance, closing = nearest(x, cloud.v, node, nxt, prv, reach)
    near = np.minimum(distance[0] - dt * closing[0], distance[1]) < rules.gap * cloud.size[node]
    return bool(near.any()) or first_crossing(x, node, nxt)[0] >= 0
