"""What holds nodes that hardly any material is told of: a penalty on jumps of the gradient across the faces of cells around them.

A point that reaches a node with a sliver of its domain gives it next to no stiffness, and the condition of the tangent grows without
bound. The ghost penalty (Burman 2010; Coombs 2023 for material points) adds, over the faces F of such cells,

    gamma h E  sum_F int [[grad du . n]] [[grad dv . n]] dF,

which is nothing for a linear field, so that neither rigid motions nor patch tests feel it. On a lattice the jump across the face
between two cells is the second difference of the nodes along the normal, divided by h.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, csr_array

from geofem.scene import Array

LIGHT = 0.1
"""Nodes that carry less than this share of a cell's volume are held by the penalty."""


def light_faces(cover: Array, active: Array, first: int, end: int) -> list[tuple[int, Array]]:
    """Faces between two active cells whose nodes include a light one: (axis, low cells (n, dim) before the face).

    cover : volume by that of a cell, of the nodes of a window. active : flags of the cells of that window. first, end : rows of low
    cells that this rank takes.
    """
    dim = cover.ndim
    light = (cover > 0.0) & (cover < LIGHT)
    out = []
    for axis in range(dim):
        # the last nodes of an axis are the low ones of no cell
        low = tuple(slice(0, -2) if c == axis else slice(0, -1) for c in range(dim))
        high = tuple(slice(1, -1) if c == axis else slice(0, -1) for c in range(dim))
        both = active[low] & active[high]
        near = np.zeros_like(both)
        for offset in offsets(dim, axis):
            part = tuple(slice(o, o + n) for o, n in zip(offset, both.shape))
            near |= light[part]
        cells = np.argwhere(both & near)
        out.append((axis, cells[(cells[:, 0] >= first) & (cells[:, 0] < end)]))
    return out


def offsets(dim: int, axis: int) -> list[tuple[int, ...]]:
    """The nodes of the two cells beside a face, from the low node of the first: three along the axis, two along the others."""
    return [tuple(index) for index in np.ndindex(*(3 if c == axis else 2 for c in range(dim)))]


def ghost_stiffness(
    faces: list[tuple[int, Array]], dof_of_node: Array, dim: int, factor: float, h: float, radius: Array | None
) -> tuple[Array, Array, Array]:
    """Rows, columns and values of the penalty on scalar local dof blocks; factor : gamma E (Pa). dof_of_node : of a window, dim axes.

    radius : of the window's rows of nodes with axial symmetry. Values are in N/m, per metre of thickness or per radian.
    """
    line = np.array([[2.0, 1.0], [1.0, 2.0]]) / 6.0
    second = np.array([1.0, -2.0, 1.0])
    rows, columns, values = [np.empty(0, np.int64)], [np.empty(0, np.int64)], [np.empty(0)]
    for axis, cells in faces:
        block: Array = np.ones((1, 1))
        for c in range(dim):
            block = np.kron(block, np.outer(second, second) if c == axis else line)
        nodes = [dof_of_node[tuple((cells + np.array(o)).T)] for o in offsets(dim, axis)]
        dofs = np.stack(nodes, axis=1) if len(cells) else np.empty((0, len(block)), np.int64)
        m = len(block)
        rows.append(np.repeat(dofs, m, axis=1).ravel())
        columns.append(np.tile(dofs, (1, m)).ravel())
        # gamma h E (1 / h)^2 times the face's area h^(dim - 1)
        size = np.full(len(cells), factor * h ** (dim - 2))
        if radius is not None:
            size *= radius[cells[:, 0]] + h * (1.0 if axis == 0 else 0.5)
        values.append(np.outer(size, block.ravel()).ravel())
    return np.concatenate(rows), np.concatenate(columns), np.concatenate(values)


def as_matrix(rows: Array, columns: Array, values: Array, blocks: int) -> csr_array:
    """The penalty as a sparse matrix over local dof blocks, for forces."""
    return csr_array(coo_array((values, (rows, columns)), shape=(blocks, blocks)))
