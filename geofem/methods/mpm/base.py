"""What the explicit and the implicit solver have in common: bodies on a grid that is divided among the ranks, and their answers."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

from geofem.cost import phase
from geofem.methods.mpm import answers, parallel, setting
from geofem.methods.mpm.contact import Contact
from geofem.methods.mpm.kind import Kind
from geofem.methods.mpm.shapes import SHAPES
from geofem.methods.mpm.watch import Splitter, Watch
from geofem.scene import Probe, Scene


class PointModel:
    """Material points on a background grid of spacing h (m).

    A solver says how far points bear on each other within one of its steps (``_halo``), lays out the nodes of its window of the grid
    (``_lay_out``), and knows the reactions of what holds the nodes (``_nodal_reaction``).
    """

    balance: answers.Balance
    slabs: parallel.Slabs

    def __init__(self, scene: Scene, kind: Kind, h: float, ppc: int, split: float):
        self.scene, self.kind, self.shape, self.h, self.comm = scene, kind, SHAPES[kind.shape], h, MPI.COMM_WORLD
        self.t = 0.0
        self.grid, self.bodies, seeds, self._bounds = setting.make_bodies(scene, kind, h, ppc)
        self.mass = sum(float(body.own("mass").sum()) for body in self.bodies)
        self.splitter, self.watch = Splitter(kind, self.shape, split), Watch(scene, self.shape)
        self._contacts = [Contact(rigid, k) for k, rigid in enumerate(scene.rigids)]
        self._places = answers.Places(scene, seeds, self.comm)

    # --- ranks --------------------------------------------------------------------------------------------------------
    def _halo(self) -> int:
        """Cells around a slab whose points can bear on its points within a step."""
        raise NotImplementedError

    def _lay_out(self, last: int) -> None:
        """The nodes of the window of the grid that ends before the row ``last``, and the conditions on them."""
        raise NotImplementedError

    def _divide(self) -> None:
        """Cut the grid into slabs, keep the points of this rank's slab and copies around it, and lay out its window of the grid."""
        self.slabs, last = setting.divide(self.comm, self.grid, self.bodies, self._halo())
        self._lay_out(last)
        self._exchange()

    def _extent(self) -> float:
        """Half the largest extent of a domain (cells) on any rank."""
        own = max((self.splitter.extent(body, self.h) for body in self.bodies), default=0.0)
        return self.comm.allreduce(own, op=MPI.MAX)

    def _exchange(self) -> None:
        """Hand over points that have left the rank's slab, and copies of those that bear on its points. Collective."""
        if self.comm.size == 1:
            return
        with phase("exchange"):
            if self.shape.spread and (halo := self._halo()) > self.slabs.halo:
                self.slabs = parallel.Slabs(self.comm, self.slabs.bounds, halo)
                self.grid.first, last = self.slabs.window(self.grid.shape[0])
                self._lay_out(last)
            for body in self.bodies:
                parallel.exchange(body, setting.rows_of(body, self.grid), self.slabs)

    # --- what the model tells -----------------------------------------------------------------------------------------
    def _nodal_reaction(self, name: str, component: int) -> float:
        """The force (N) that a support or a wall exerted on the bodies in the last step, at this rank's own nodes."""
        raise NotImplementedError

    def probe(self, probe: Probe) -> float:
        """The value of a probe now. Collective."""
        if probe.quantity == "reaction":
            assert probe.of is not None
            own = self._nodal_reaction(probe.of, probe.component)
            own += sum(float(c.force[probe.component]) for c in self._contacts if c.rigid.name == probe.of)
            return self.comm.allreduce(own)
        return self._places.probe(probe, self.bodies, self.t)

    def snapshot(self) -> dict[str, Any]:
        """Points where they are now, in the order of their numbers, region after region; on rank 0."""
        return answers.snapshot(self.bodies, self.kind, self.h, self._contacts, self.comm)
