"""What all ways of tessellating share: the smallest cell, and the finished answer."""

from __future__ import annotations

import numpy as np

from geofem.methods.pfem.tessellation import Tessellation, simplices
from geofem.scene import Array

FLAT = 1e-12
"""A cell below this volume, in units of its nodes' mean size, is none: what is left of it is rounding."""


def mean_size(size: Array, cells: Array) -> Array:
    """The spacing (m) that the nodes of each cell ought to have, (m,)."""
    return size[cells].mean(axis=1)


def finished(cells: Array, old: Tessellation | None) -> Tessellation:
    """The tessellation of these cells, of positive volume and in their order."""
    facets = simplices.boundary(cells, simplices.neighbours(cells))
    same = np.full(len(cells), -1, np.int64) if old is None else simplices.parents(cells, old.cells)
    return Tessellation(cells, facets, same)
