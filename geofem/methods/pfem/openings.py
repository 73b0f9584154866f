"""What comes in through inlets and leaves through outlets between two steps, booked as ``inflow`` and ``outflow``.

Inlet: the row of nodes on it is put back to where it was before the step, and so takes new material in behind the old; the cells in
front grow, and get new nodes as others do. Outlet: the body is clipped at its plane; the new nodes on the plane take the values that
the step gave to this place, so that nothing is carried back into the body.
"""

from __future__ import annotations

import numpy as np

from geofem.methods.pfem.budget import Amount, Budget, volumes
from geofem.methods.pfem.cloud import Cloud
from geofem.methods.pfem.contact import ON, Contact, Outflow
from geofem.methods.pfem.loops import link, tally
from geofem.methods.pfem.tessellation import Tessellation
from geofem.mistake import Breakdown, Mistake
from geofem.scene import Array

Part = tuple[Array, Array]
"""Volumes (k,) (m2) of parts of cells, and the integrals (k, 4) of the velocity (2,), of v.v / 2 and of -g.x over them."""


# --- in ---------------------------------------------------------------------------------------------------------------
def fill(cloud: Cloud, obstacles: Contact) -> bool:
    """Give the nodes on the inlets their velocities at t = 0; returns whether they had others.

    Raises ``Mistake`` where no body lies on an inlet.
    """
    jumped = False
    for inlet in obstacles.inlets:
        on = cloud.fields["held"][:, inlet.column] > 0.5
        if on.sum() < 2:
            raise Mistake(f"inlet {inlet.plane.name}: no side of a body lies on it; the body that it feeds must begin there")
        v = inlet.speeds(cloud.x[on], 0.0)
        jumped |= bool(np.abs(v - cloud.v[on]).max() > 1e-12 * np.abs(v).max())
        cloud.v[on] = v
    return jumped


def let_in(cloud: Cloud, mesh: Tessellation, obstacles: Contact, t: float, budget: Budget) -> None:
    """Put the nodes of inlets back. Raises ``Breakdown`` where the stream has torn off an inlet.

    What came in is the strip between the row and where it had gone. The edges that lead from its ends to the free surface cut or
    bulge its corners by a little more, as chords of a curve do: the free surface near by owes that.
    """
    for inlet in obstacles.inlets:
        on = cloud.fields["held"][:, inlet.column] > 0.999
        if on.sum() < 2:
            raise Breakdown("fracture", f"the stream tore off the inlet {inlet.plane.name}")
        cloud.fields["held"][:, inlet.column] = on  # what lies between a node on the inlet and another is not on it
        a, b = mesh.facets[on[mesh.facets].all(axis=1)].T
        one, two = cloud.x[b] - cloud.X[a], cloud.x[a] - cloud.X[b]
        strip = 0.5 * float((one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]).sum())
        cloud.x[on] = cloud.X[on]
        cloud.v[on] = inlet.speeds(cloud.x[on], t)
        change = budget.look(cloud, mesh.cells)
        at, excess = cloud.X[on].mean(axis=0), change.volume - strip
        if abs(excess) > 1e-12 * float(cloud.size[on].max()) ** 2:
            budget.book("resample", budget.made(excess, at))
            budget.owed = np.concatenate([budget.owed, [[*at, -excess]]])
            change -= budget.made(excess, at)
        budget.book("inflow", change)


# --- out --------------------------------------------------------------------------------------------------------------
def leaving(cloud: Cloud, obstacles: Contact) -> bool:
    """Whether any node has passed an outlet."""
    return any(bool(outlet.beyond(cloud).any()) for outlet in obstacles.outlets)


def let_out(cloud: Cloud, cells: Array, facets: Array, obstacles: Contact, budget: Budget) -> tuple[Array, Array, Array]:
    """Clip the bodies at the outlets. Mutates the cloud, but drops no node.

    cells (m, 3), facets (k, 2) : after the step. Returns the new facets, the nodes (n,) bool that have left, and what momentum left
    with each of the cells, (m, 2). Raises ``Breakdown`` when nothing is left.
    """
    lost = np.zeros((len(cells), 2))
    left = np.zeros(cloud.n, bool)
    for outlet in obstacles.outlets:
        beyond = outlet.beyond(cloud)
        if not beyond.any():
            continue
        height = outlet.plane.height(cloud.x)
        height = np.where(beyond, height, np.maximum(height, 0.0))
        rows = np.flatnonzero(beyond[cells].any(axis=1))
        volume, integrals = part_beyond(cloud, cells[rows], height, budget.gravity)
        lost[rows] += integrals[:, :2]
        flown = cloud.carried * beyond
        gone = Amount(
            float(volume.sum()), integrals[:, :2].sum(axis=0), float(integrals[:, 2].sum()), float(integrals[:, 3].sum())
        )
        square, depth = (cloud.v**2).sum(axis=1), (cloud.x * budget.gravity).sum(axis=1)
        gone += Amount(float(flown.sum()), flown @ cloud.v, 0.5 * float(flown @ square), -float(flown @ depth))
        budget.book("outflow", Amount(0.0, np.zeros(2), 0.0, 0.0) - gone)
        cloud.carried[beyond] = 0.0
        facets = clipped(cloud, cells[rows], facets, outlet, beyond, height)
        left = np.concatenate([left | beyond, np.zeros(cloud.n - len(left), bool)])
    if len(facets) == 0:
        raise Breakdown("volume", "all of the material has left through the outlets")
    return facets, left, lost


def means(x: Array, v: Array, gravity: Array) -> Array:
    """Means (k, 4) of v, v.v / 2 and -g.x over triangles with corners x (k, 3, 2) and velocities v (k, 3, 2)."""
    kinetic = ((v.sum(axis=1) ** 2).sum(axis=1) + (v * v).sum(axis=(1, 2))) / 24
    return np.column_stack([v.mean(axis=1), kinetic, -(x.mean(axis=1) * gravity).sum(axis=1)])


def part_beyond(cloud: Cloud, cells: Array, height: Array, gravity: Array) -> Part:
    """The parts of cells (k, 3) where the height (n,) over the outlet is negative."""
    area = volumes(cloud.x, cells)
    whole = area[:, None] * means(cloud.x[cells], cloud.v[cells], gravity)
    below = height[cells] < 0
    count = below.sum(axis=1)
    # One corner is alone on its side of the plane: first that one, then the two others.
    alone = np.where(count == 1, below.argmax(axis=1), (~below).argmax(axis=1))
    turned = np.take_along_axis(cells, (alone[:, None] + np.arange(3)) % 3, axis=1)
    s = height[turned]
    share = s[:, :1] / np.where(s[:, :1] == s[:, 1:], 1.0, s[:, :1] - s[:, 1:])  # of the two edges from it, up to the plane
    x, v = cloud.x[turned], cloud.v[turned]
    for field in (x, v):
        field[:, 1:] = field[:, :1] + share[:, :, None] * (field[:, 1:] - field[:, :1])
    corner = area * share.prod(axis=1)
    tip = corner[:, None] * means(x, v, gravity)
    every, sign = (count > 1).astype(float), np.array([0.0, 1.0, -1.0, 0.0])[count]
    return every * area + sign * corner, every[:, None] * whole + sign[:, None] * tip


def clipped(cloud: Cloud, cells: Array, facets: Array, outlet: Outflow, beyond: Array, height: Array) -> Array:
    """The facets of the bodies without what is beyond the outlet. Adds the new nodes on its plane to the cloud.

    cells (k, 3) : those that reach beyond. Where the boundary passes the plane it gets a node; those of its nodes that are
    farther out go back to the plane at right angles.
    """
    inside = height > ON * cloud.size
    node, nxt, prv = link(cloud.x, facets)
    loop = tally(cloud.x, node, nxt)[0]
    kept = np.zeros(loop.max() + 1, bool)
    kept[loop[inside[node]]] = True  # loops with no node inside have left
    enter, leave = node.copy(), node.copy()  # the nodes that stand for that of a slot, towards the one before and the one after
    out = np.flatnonzero(beyond[node] & kept[loop])
    ends = [(s, way) for way in (prv, nxt) for s in out if inside[node[way[s]]]]
    if ends:
        slots = np.array([s for s, _ in ends])
        pairs = np.array([(node[s], node[way[s]]) for s, way in ends])
        s = height[pairs]
        share = s[:, 0] / (s[:, 0] - s[:, 1])
        new = place(cloud, outlet, pairs, np.column_stack([1 - share, share]))
        # the crossing before a node stands for it, unless there is one after it too
        before = np.array([way is prv for _, way in ends])
        enter[slots[before]] = leave[slots[before]] = new[before]
        leave[slots[~before]] = new[~before]
        lone = np.setdiff1d(slots[~before], slots[before])
        enter[lone] = leave[lone]
    feet = np.setdiff1d(out, slots if ends else out[:0])
    if len(feet):
        at = cloud.x[node[feet]].copy()
        at[:, outlet.plane.axis] = outlet.plane.place
        rows, weights = around(cloud.x[cells], at)
        enter[feet] = leave[feet] = place(cloud, outlet, cells[rows], weights, at)
    stay = kept[loop]
    edges = np.column_stack([leave[stay], enter[nxt[stay]]])
    tips = np.flatnonzero(stay & (enter != leave))
    return np.concatenate([edges, np.column_stack([enter[tips], leave[tips]])])


def place(cloud: Cloud, outlet: Outflow, parents: Array, weights: Array, at: Array | None = None) -> Array:
    """New nodes on the outlet, interpolated as in ``Cloud.add`` and put ``at`` (k, 2) if given. Returns their numbers."""
    new = cloud.add(parents, weights)
    if at is not None:
        cloud.x[new] = at
    cloud.x[new, outlet.plane.axis] = outlet.plane.place
    cloud.fields["held"][new, outlet.column] = 1.0
    return new


def around(corners: Array, at: Array) -> tuple[Array, Array]:
    """For places (k, 2) the rows (k,) of the cells (m, 3, 2) that hold them, and weights (k, 3); of the nearest if none does."""
    edge = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
    inner = np.einsum("mij,kmj->kmi", np.linalg.pinv(edge), at[:, None] - corners[None, :, 0])
    weights = np.concatenate([1.0 - inner.sum(axis=2, keepdims=True), inner], axis=2)
    rows = weights.min(axis=2).argmax(axis=1)
    best = np.clip(weights[np.arange(len(at)), rows], 0.0, 1.0)
    return rows, best / best.sum(axis=1, keepdims=True)
