"""The alpha shape: the classical way to tell the body from the gaps between its nodes."""

from __future__ import annotations

from dataclasses import dataclass

from geofem.methods.pfem.tessellation import Tessellation, simplices
from geofem.methods.pfem.tessellation.backends import delaunay
from geofem.methods.pfem.tessellation.common import FLAT, finished, mean_size
from geofem.scene import Array


@dataclass(frozen=True)
class AlphaShape:
    """The Delaunay cells whose circumradius is below ``alpha`` times their nodes' mean size (Edelsbrunner and Mucke 1994).

    It knows nothing of the body that the nodes were, so a dent wider than alpha opens and a gap narrower than it closes:
    volume is made and lost in each step (Franci and Cremonesi 2017).

    alpha : 1.1 to 1.5 is usual. sliver : in space, cells of a lower ``simplices.quality`` are dropped too.
    backend : see ``backends.delaunay``.
    """

    alpha: float = 1.2
    sliver: float = 0.0
    backend: str = "auto"

    def __call__(self, x: Array, size: Array, old: Tessellation | None) -> Tessellation:
        """See ``Tessellator``."""
        cells = delaunay(x, self.backend)
        spacing = mean_size(size, cells)
        kept = simplices.circumradii(x, cells) < self.alpha * spacing
        kept &= simplices.volumes(x, cells) > FLAT * spacing ** x.shape[1]
        if x.shape[1] == 3 and self.sliver > 0:
            kept &= simplices.quality(x, cells) >= self.sliver
        return finished(cells[kept], old)
