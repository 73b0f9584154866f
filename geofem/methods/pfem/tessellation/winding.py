"""How often a closed boundary goes round a point, in the plane and in space; numba, serial.

The boundary alone tells where the body is: also where its cells have turned inside out, or some are not there any more.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from geofem.core.locate import fill_bins
from geofem.scene import Array


def enclosed_volume(x: Array, facets: Array) -> float:
    """The area (m2) or volume (m3) inside of a boundary (k, gdim), oriented as a ``Tessellation``'s (Gauss's theorem)."""
    corners = x[facets] - x.mean(axis=0)
    return float(np.linalg.det(corners).sum()) / (2 if x.shape[1] == 2 else 6)


def winding(x: Array, facets: Array, points: Array) -> Array:
    """How often the boundary (k, gdim) goes round each point (j, gdim): 1 inside a body, 2 where two overlap, 0 outside.

    A ray from the point along the last axis counts the facets that it leaves through, less those that it enters by. No facet is
    missed and none counted twice at their common edges, as both decide with the same numbers.
    """
    if len(facets) == 0 or len(points) == 0:
        return np.zeros(len(points), np.int64)
    corners = np.ascontiguousarray(x[facets])
    shadow = np.zeros((len(facets), x.shape[1], 2))
    shadow[..., : x.shape[1] - 1] = corners[..., :-1]
    low, high = shadow.min(axis=1), shadow.max(axis=1)
    corner = low.min(axis=0)
    spans = high.max(axis=0) - corner
    width = max(float((high - low).mean(axis=0).max()), float(spans.max()) / 1000, 1e-300)
    counts = (spans / width).astype(np.int64) + 1
    starts, members = fill_bins(low, high, corner, width, counts)
    return wind(corners, facets, np.ascontiguousarray(points), corner, width, counts, starts, members)


@njit(cache=True, error_model="numpy", inline="always")
def passed(a: Array, b: Array, a_first: bool, p: Array) -> int:
    """1 if a ray from p along the second axis leaves a body through its edge from a to b, -1 if it enters, 0 if it misses."""
    if not (min(a[0], b[0]) <= p[0] < max(a[0], b[0])):
        return 0
    # always from the same end, so that both facets at an edge get the same number
    if a_first:
        side = (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])
        below = (side < 0.0) == (b[0] > a[0])
    else:
        side = (a[0] - b[0]) * (p[1] - b[1]) - (a[1] - b[1]) * (p[0] - b[0])
        below = (side < 0.0) == (a[0] > b[0])
    if side == 0.0 or not below:
        return 0
    return 1 if b[0] < a[0] else -1


@njit(cache=True, error_model="numpy")
def wind(
    corners: Array, facets: Array, points: Array, corner: Array, width: float, counts: Array, starts: Array, members: Array
) -> Array:
    """See ``winding``; facets in bins by their shadow along the last axis."""
    gdim = points.shape[1]
    out = np.zeros(len(points), np.int64)
    for j in range(len(points)):
        p = points[j]
        bin_ = 0
        beyond = False
        for d in range(2):
            k = int(np.floor((p[d] - corner[d]) / width)) if d < gdim - 1 else 0
            beyond |= k < 0 or k >= counts[d]
            bin_ = bin_ * counts[d] + k
        if beyond:
            continue
        for i in range(starts[bin_], starts[bin_ + 1]):
            f = members[i]
            c = corners[f]
            if gdim == 2:
                out[j] += passed(c[0], c[1], facets[f, 0] < facets[f, 1], p)
                continue
            turns = 0
            for k in range(3):
                m = (k + 1) % 3
                turns += passed(c[k], c[m], facets[f, k] < facets[f, m], p)
            if turns != 0:
                ux, uy, uz = c[1, 0] - c[0, 0], c[1, 1] - c[0, 1], c[1, 2] - c[0, 2]
                vx, vy, vz = c[2, 0] - c[0, 0], c[2, 1] - c[0, 1], c[2, 2] - c[0, 2]
                wx, wy, wz = p[0] - c[0, 0], p[1] - c[0, 1], p[2] - c[0, 2]
                height = wx * (uy * vz - uz * vy) + wy * (uz * vx - ux * vz) + wz * (ux * vy - uy * vx)
                if height * turns < 0.0:
                    out[j] += turns
    return out
