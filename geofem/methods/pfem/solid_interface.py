"""Contact between bodies by the mesh between them: Delaunay triangles that join a boundary edge of one body to a node of another.

The height of such a triangle is the gap. Where it is less than ``GAP`` times the spacing, a spring pushes node and edge apart, along the
edge's normal and split between its ends by where the node stands: momentum and angular momentum stay (Oliver and others 2009, the
contact domain, CMAME 198:2591-2606, of whose constraint this is the penalty form). There is no friction.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from geofem.methods.pfem.cloud import Cloud
from geofem.methods.pfem.solid_domains import OPTIONS
from geofem.methods.pfem.tessellation.backends import delaunay
from geofem.scene import Array

GAP, NEAR, LEAST = 0.2, 2.5, 0.1
"""In sizes: the gap below which bodies push, and the longest side of a triangle that counts; and the part of that gap at which the
springs stiffen no more."""


def contact_elements(cloud: Cloud, facets: Array) -> Array:
    """Rows (a, b, c) of boundary edges a b and nodes c of other bodies in front of them, (k, 3); none for a single body."""
    edge = np.unique(facets)
    if len(np.unique(cloud.region[edge])) < 2:
        return np.zeros((0, 3), np.int64)
    cells = edge[delaunay(cloud.x[edge])]
    region = cloud.region[cells]
    out = []
    known = {(int(a), int(b)) for a, b in facets}
    size = cloud.size[cells].mean(axis=1)
    longest = np.max(np.linalg.norm(cloud.x[cells] - cloud.x[np.roll(cells, 1, axis=1)], axis=2), axis=1)
    mixed = (region.min(axis=1) != region.max(axis=1)) & (longest < NEAR * size)
    for cell in cells[mixed]:
        for k in range(3):
            a, b, c = (int(cell[(k + j) % 3]) for j in range(3))
            # the body is to the left of its edge, and so the other one's node to the right of it
            if (b, a) in known:
                out.append((b, a, c))
    return np.array(out, np.int64).reshape(-1, 3)


@njit(**OPTIONS)
def add_contact(elements: Array, x: Array, u: Array, stiffness: Array, size: Array, force: Array) -> None:
    """Add the springs to the nodal forces (n, 2) that are taken off; they stiffen as the gap closes."""
    for e in range(len(elements)):
        a, b, c = elements[e, 0], elements[e, 1], elements[e, 2]
        ax, ay = x[a, 0] + u[a, 0], x[a, 1] + u[a, 1]
        tx, ty = x[b, 0] + u[b, 0] - ax, x[b, 1] + u[b, 1] - ay
        dx, dy = x[c, 0] + u[c, 0] - ax, x[c, 1] + u[c, 1] - ay
        length = np.sqrt(tx * tx + ty * ty)
        nx, ny = ty / length, -tx / length
        gap, open_gap = dx * nx + dy * ny, GAP * size[c]
        depth = open_gap - gap
        s = min(max((dx * tx + dy * ty) / length**2, 0.0), 1.0)
        if depth > 0.0:
            push = stiffness[c] * depth * open_gap / max(gap, LEAST * open_gap)
            force[c, 0] -= push * nx
            force[c, 1] -= push * ny
            force[a, 0] += (1.0 - s) * push * nx
            force[a, 1] += (1.0 - s) * push * ny
            force[b, 0] += s * push * nx
            force[b, 1] += s * push * ny
