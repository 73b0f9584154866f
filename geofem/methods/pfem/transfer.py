"""Values of cells (stress, plastic strain) from one tessellation of the same nodes to the next.

Two ways. ``copied`` leaves a cell that still has its three nodes what it has, and gives a new one that of the nearest old cell: an error
of first order in the few cells that changed. ``averaged`` goes by way of the nodes, all cells, at each change: twice a mean over
the neighbours, so that it spreads whatever it carries; it is here to show that, and for smooth fields.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from geofem.scene import Array


def copied(values: Array, parents: Array, old_centroids: Array, centroids: Array) -> Array:
    """Values (m, ...) of the new cells: those of the same cell before, or of the nearest old one where there is none.

    values : (k, ...) of the old cells. parents : (m,) as in ``Tessellation``. old_centroids : (k, gdim), where the old cells are
    now, at the present places of their nodes (m). centroids : (m, gdim) of the new cells (m).
    """
    source = parents.copy()
    new = np.flatnonzero(parents < 0)
    if len(new):
        source[new] = cKDTree(old_centroids).query(centroids[new])[1]
    return values[source]


def to_nodes(values: Array, cells: Array, volumes: Array, nodes: int) -> tuple[Array, Array]:
    """The mean (nodes, c), by volume, of the values (m, c) of the cells around each node, and which nodes have cells, (nodes,) bool.

    Nodes that have none get zeros.
    """
    weights = np.bincount(cells.ravel(), np.repeat(volumes, cells.shape[1]), nodes)
    sums = np.zeros((nodes, values.shape[1]))
    for corner in cells.T:
        np.add.at(sums, corner, values * volumes[:, None])
    known = weights > 0.0
    sums[known] /= weights[known, None]
    return sums, known


def averaged(values: Array, old_cells: Array, old_volumes: Array, cells: Array, nodes: int) -> Array:
    """Values (m, ...) of the new cells: the mean over their nodes of the mean over the old cells around each, by volume.

    values : (k, ...) of the old cells (k, gdim + 1), whose volumes are ``old_volumes`` (k,). A node that no old cell has does not count.
    nodes : their number. Raises ``ValueError`` if no node of a new cell was in an old one.
    """
    means, known = to_nodes(values.reshape(len(values), -1), old_cells, old_volumes, nodes)
    count = known[cells].sum(axis=1)
    if np.any(count == 0):
        raise ValueError("a new cell has no node in common with the old ones")
    mean = means[cells].sum(axis=1) / count[:, None]
    return mean.reshape(len(cells), *values.shape[1:])
