"""The boundary in the plane between two steps: edges split and collapsed, fronts joined, necks cut, drops let fly and caught."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geofem.methods.pfem.budget import Budget
from geofem.methods.pfem.cloud import Cloud
from geofem.methods.pfem.contact import Contact
from geofem.methods.pfem.loops import first_crossing, link, nearest, tally, winding
from geofem.methods.pfem.surgery import MERGE, RESAMPLE, SEPARATE, Event, collapse, give, join_and_part, uncross, unfold
from geofem.scene import Array


@dataclass(frozen=True)
class Rules:
    """When nodes are added and removed, and the boundary changes; lengths in sizes (the spacing that nodes ought to have).

    coarse : a boundary edge longer than that is split. fine : a boundary edge shorter than that is collapsed, and an interior
        node with such an edge is removed.
    big : a cell that has more than this many times the volume of the regular one gets a node in its middle.
    beside : an interior node nearer than that to a boundary edge is removed.
    gap : fronts of one body or of two of the same region that are nearer and close in on each other are joined.
    neck : a part thinner than that which gets thinner is cut.
    drop : a piece of less area (in sizes squared) flies: one node that carries it. hole : a smaller hole is filled.
    catch : what flies is caught by a boundary so near that it approaches.
    quality : the mesh is made anew when a cell is worse, see ``simplices.quality``.
    boundary : False leaves the boundary alone, for tessellators that find it anew each time, and in space.
    skin : in space, the edges of the boundary are split and collapsed, and volume is given back to it.
    """

    coarse: float = 1.5
    fine: float = 0.45
    big: float = 1.7
    beside: float = 0.25
    gap: float = 0.2
    neck: float = 0.1
    drop: float = 0.3
    hole: float = 0.1
    catch: float = 0.7
    quality: float = 0.3
    boundary: bool = True
    skin: bool = False


@dataclass
class Loops:
    """Slots of the boundary, see ``loops``; each (k,)."""

    node: Array
    nxt: Array
    prv: Array

    @classmethod
    def of(cls, x: Array, facets: Array) -> Loops:
        return cls(*link(np.ascontiguousarray(x), np.ascontiguousarray(facets)))

    def facets(self) -> Array:
        """The edges, (k, 2)."""
        used = np.flatnonzero(self.node >= 0)
        return np.column_stack([self.node[used], self.node[self.nxt[used]]])


def split(cloud: Cloud, facets: Array, coarse: float) -> Array:
    """Put nodes in the middle of boundary edges longer than ``coarse`` sizes until there are none. Returns the new facets."""
    while True:
        a, b = facets.T
        long = np.linalg.norm(cloud.x[a] - cloud.x[b], axis=1) > coarse * 0.5 * (cloud.size[a] + cloud.size[b])
        if not long.any():
            return facets
        pairs = facets[long]
        middle = cloud.add(pairs, np.full(pairs.shape, 0.5))
        halves = [np.column_stack([pairs[:, 0], middle]), np.column_stack([middle, pairs[:, 1]])]
        facets = np.concatenate([facets[~long], *halves])


def change_boundary(
    cloud: Cloud, facets: Array, obstacles: Contact, rules: Rules, dt: float, budget: Budget
) -> tuple[Array, Array, Array]:
    """All that happens to the boundary. Mutates the cloud, but drops no node.

    Returns the new facets (k, 2), the nodes (n,) bool that are of no use any more, and pairs of nodes (j, 2) that gave each other
    volume, whose momenta are to be balanced together.
    """
    facets = split(cloud, facets, rules.coarse)
    touch = obstacles.touch(cloud, outlets=True)
    held, level = obstacles.held(cloud), touch.count
    tangent = np.column_stack([-touch.normals[:, 0, 1], touch.normals[:, 0, 0]])
    x, v = np.ascontiguousarray(cloud.x), np.ascontiguousarray(cloud.v)
    loops = Loops.of(x, facets)
    useless = np.zeros(cloud.n, bool)
    arrays = (loops.node, loops.nxt, loops.prv)
    events = [*unfold(x, *arrays), *uncross(x, *arrays), *unfold(x, *arrays)]
    speed = np.linalg.norm(v - v[facets[:, 0]].mean(axis=0), axis=1)
    reach = np.minimum(max(rules.gap, rules.neck) * cloud.size + 2 * dt * speed[facets].max(initial=0.0), 1.5 * cloud.size)
    events += join_and_part(x, v, cloud.size, cloud.region, held, *arrays, reach, dt, rules.gap, rules.neck)
    events += drop_loops(cloud, x, loops, rules, useless)
    pairs, more = collapse(x, cloud.size, level, tangent, held, *arrays, rules.fine)
    events += more
    average(cloud, level, held, np.array(pairs, np.int64).reshape(-1, 2), useless)
    cloud.x = x
    for kind, name in ((MERGE, "merge"), (SEPARATE, "separate"), (RESAMPLE, "resample")):
        for k, area, *at in events:
            if k == kind:
                budget.book(name, budget.made(area, np.array(at)))
    due = np.array([(*at, -area) for _, area, *at in events]).reshape(-1, 3)
    links = give_back(cloud, loops, rules, level, useless, np.concatenate([budget.owed, due]), budget)
    budget.jolted |= len(links) > 0 or any(kind != RESAMPLE for kind, *_ in events)
    return loops.facets(), useless, links


def average(cloud: Cloud, level: Array, held: Array, pairs: Array, useless: Array) -> None:
    """Nodes that were collapsed: the kept one carries the mean of both where both are equally free."""
    kept, dropped = pairs.T
    useless[dropped] = True
    like = (held[kept] == held[dropped]).all(axis=1)
    kept, dropped = kept[like], dropped[like]
    for values in (cloud.X, cloud.v, cloud.p, cloud.size, *(cloud.fields[name] for name in cloud.fields)):
        values[kept] = 0.5 * (values[kept] + values[dropped])


def round_about(loops: Loops, slot: int) -> Array:
    """The slots of a loop in their order, from this one on."""
    slots = [slot]
    while loops.nxt[slots[-1]] != slot:
        slots.append(int(loops.nxt[slots[-1]]))
    return np.array(slots)


def drop_loops(cloud: Cloud, x: Array, loops: Loops, rules: Rules, useless: Array) -> list[Event]:
    """Loops that are not to be: overlaps left by uncrossing, small holes, and small pieces, which fly from now on."""
    events: list[Event] = []
    loop, areas, _ = tally(x, loops.node, loops.nxt)
    uses = np.bincount(loops.node[loops.node >= 0], minlength=cloud.n)
    for number in np.argsort(areas)[:-1]:  # the largest body stays, whatever it is
        slots = round_about(loops, int(np.flatnonzero(loop == number)[0]))
        nodes, area = loops.node[slots], areas[number]
        legal = winding(x, loops.node, loops.nxt, loop, number, *x[nodes[0]]) == (0 if area > 0 else 1)
        small = abs(area) < (rules.drop if area > 0 else rules.hole) * cloud.size[nodes].mean() ** 2
        if legal and (not small or (uses[nodes] > 1).any()):
            continue
        if legal and area > 0:
            fly(cloud, x, nodes, area)
            useless[nodes[1:]] = True
        else:
            events.append((float(MERGE), -area, *x[nodes].mean(axis=0)))
        loops.node[slots] = -1
    return events


def fly(cloud: Cloud, x: Array, nodes: Array, area: float) -> None:
    """The first of the nodes (k,) round a piece carries it from now on: its area (m2), its centre and its mean velocity."""
    a, b = x[nodes] - x[nodes[0]], np.roll(x[nodes], -1, axis=0) - x[nodes[0]]
    twice = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    one = nodes[0]
    cloud.v[one] = cloud.v[nodes].mean(axis=0)
    x[one] += (twice[:, None] * (a + b)).sum(axis=0) / (6 * area)
    cloud.carried[one] = area
    cloud.fields["held"][one] = 0.0


def near_edge(x: Array, facets: Array, point: Array) -> tuple[int, float, Array]:
    """The facet (k, 2) nearest to a point (2,), its distance (m) and the unit vector (2,) towards it."""
    a, edge = x[facets[:, 0]], x[facets[:, 1]] - x[facets[:, 0]]
    share = np.einsum("kd,kd->k", point - a, edge) / np.maximum((edge**2).sum(axis=1), 1e-300)
    way = a + np.clip(share, 0, 1)[:, None] * edge - point
    length = np.linalg.norm(way, axis=1)
    k = int(length.argmin())
    return k, float(length[k]), way[k] / max(length[k], 1e-300)


def give_back(cloud: Cloud, loops: Loops, rules: Rules, level: Array, useless: Array, due: Array, budget: Budget) -> Array:
    """Catch what flies, and give back the volume (m2) that is due (k, 3: place and volume), to the free surface near by.

    A node of the free surface goes at most a tenth of its size, and a quarter of the way to what it faces; what finds no room
    is owed, or flies on. Returns pairs of a flying node and one of the boundary that took some of it.
    """
    node, nxt, prv = loops.node, loops.nxt, loops.prv
    if not len(due) and not (cloud.carried > 0).any():
        return np.zeros((0, 2), np.int64)
    before, carried = cloud.x.copy(), cloud.carried.copy()
    used = np.flatnonzero(node >= 0)
    _, distance, _ = nearest(cloud.x, cloud.v, node, nxt, prv, 0.5 * cloud.size)
    room = np.zeros(cloud.n)
    room[node[used]] = np.minimum(0.1 * cloud.size[node[used]], 0.25 * distance[:, used].min(axis=0))
    room[(level > 0) | (np.bincount(node[used], minlength=cloud.n) > 1)] = 0.0

    def put(at: Array, volume: float) -> float:
        """Returns what found no room."""
        free = used[room[node[used]] > 0]
        while abs(volume) > 0 and len(free):
            start = free[((cloud.x[node[free]] - at) ** 2).sum(axis=1).argmin()]
            rest = float(give(cloud.x, node, nxt, prv, room, start, volume))
            if rest == volume:
                break
            volume = rest
            free = used[room[node[used]] > 0]
        return volume

    links, owed, given = [], [], []
    facets, loop = loops.facets(), tally(cloud.x, node, nxt)[0]
    for f in np.flatnonzero(carried > 0):
        k, gap, way = near_edge(cloud.x, facets, cloud.x[f])
        a, b = facets[k]
        within = winding(cloud.x, node, nxt, loop, -2, *cloud.x[f]) > 0
        closing = (cloud.v[f] - 0.5 * (cloud.v[a] + cloud.v[b])) @ way > 0
        if within or (gap < rules.catch * cloud.size[f] and closing):
            cloud.carried[f] = put(cloud.x[f], carried[f])
            links.append((f, a))
    for *at, volume in due:
        rest = put(np.array(at), volume)
        owed += [(*at, rest)] if rest else []
        given.append((np.array(at), volume - rest))
    if first_crossing(cloud.x, node, nxt)[0] >= 0:  # too much at once for these fronts: another time
        cloud.x, cloud.carried, budget.owed = before, carried, due
        return np.zeros((0, 2), np.int64)
    useless[(carried > 0) & (cloud.carried == 0)] = True
    budget.owed = np.array(owed).reshape(-1, 3)
    for at, volume in given:
        budget.book("restore", budget.made(volume, at))
    return np.array(links, np.int64).reshape(-1, 2)
