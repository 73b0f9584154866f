"""From nodes to cells: what every way of tessellating the bodies takes and gives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from geofem.scene import Array


@dataclass(frozen=True)
class Tessellation:
    """Cells on numbered nodes.

    cells : (m, gdim + 1) int64 nodes of each cell, of positive volume.
    facets : (k, gdim) int64 nodes of the boundary facets; in the plane the body is to the left of each, in space the normal by the
        right-hand rule points out of it.
    parents : (m,) int64 the cell of the tessellation before that has the same nodes, -1 if it has none.

    Nodes of no cell are fine: they fly. All arrays are in an order that depends on the nodes alone, not on chance.
    """

    cells: Array
    facets: Array
    parents: Array


class Tessellator(Protocol):
    """A way to tessellate; serial, called on rank 0 only."""

    def __call__(self, x: Array, size: Array, old: Tessellation | None) -> Tessellation:
        """The cells of the nodes ``x`` (n, gdim), whose spacing ought to be ``size`` (n,) (m).

        old : the cells that the same nodes had before they moved; None at the start, when a boundary is not known.

        Raises ``Mistake`` in one line for nodes that no triangulation can have (fewer than gdim + 1, not finite, all on a line).
        Duplicates, collinear points and isolated ones are no error: a node that ends in no cell flies.
        """
