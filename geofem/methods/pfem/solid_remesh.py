"""New nodes and triangles for solids when the mesh asks for them: on rank 0, and then the same everywhere.

History around nodes stays with its nodes, and a new node has the mean of those it was made from. History in triangles is copied where
the triangle is the same, else taken from the nearest old one, or averaged by way of the nodes, which wipes it out in time. Mass stays
with its nodes too: grains that have come apart fill more volume with it, which is no reason to have more.
"""

from __future__ import annotations

import numpy as np

from geofem.core.mpi import on_root
from geofem.cost import phase
from geofem.methods.pfem import resample, transfer
from geofem.methods.pfem.budget import Budget, lumped
from geofem.methods.pfem.cloud import Cloud
from geofem.methods.pfem.contact import Obstacles
from geofem.methods.pfem.solid_body import Body
from geofem.methods.pfem.solid_laws import History
from geofem.methods.pfem.surface import Rules
from geofem.methods.pfem.tessellation import Tessellation
from geofem.methods.pfem.tessellation.constrained import Constrained
from geofem.scene import Array

TRANSFERS = ("copy", "average")
GROWTH = 0.15
"""Around rigid bodies the spacing grows by this part of the distance from them."""
SOLID = Rules(drop=0.05, neck=0.02)
"""Grains part and solids tear by no criterion but the loss of all width."""


class Remesher:
    """Looks after the mesh of a body, and counts what it did.

    h : spacing (m) beside rigid bodies. transfer : of history in triangles, copy or average.
    """

    def __init__(self, body: Body, h: float, transfer: str):
        self.body, self.h, self.transfer = body, h, transfer
        self.count = 0
        gravity = sum((np.array(load.value)[:2] for load in body.scene.loads if load.kind == "gravity"), np.zeros(2))
        self.obstacles = Obstacles(body.scene, body.cloud)
        self.budget = Budget(gravity)
        self.tessellator = Constrained()
        self.tessellation = Tessellation(body.cells, body.facets, np.full(len(body.cells), -1))

    def look(self, t: float, dt: float) -> bool:
        """Mend the mesh at t if it needs that; dt (s) is the step to come. Returns whether it was. Collective."""
        with phase("remesh"):
            body, cloud = self.body, self.body.cloud
            self.obstacles.follow(t, dt)
            if self.obstacles.rigids:
                near = np.min([rigid.reach(cloud.x)[0] for rigid in self.obstacles.rigids], axis=0)
                cloud.size = self.h + GROWTH * np.maximum(near, 0.0)
            made = body.comm.bcast(on_root(body.comm, lambda: self._mended(dt)))
            if made is None:
                return False
            body.cloud, self.tessellation, history, mass = made
            body.renew(self.tessellation.cells, self.tessellation.facets, history, mass)
            self.count += 1
            return True

    def _mended(self, dt: float) -> tuple[Cloud, Tessellation, History, Array] | None:
        body, cloud = self.body, self.body.cloud
        if not resample.needs(cloud, self.tessellation, SOLID, self.budget, dt):
            return None
        cloud.fields["held"] = self._touching(cloud)
        history, old = body.history, self.tessellation
        volume = lumped(cloud, old.cells)
        cloud.fields["density"] = np.divide(body.mass, volume, out=np.zeros(cloud.n), where=volume > 0)
        if body.nodal:
            cloud.fields |= {"F": history.F, "state": history.state}
        elif self.transfer == "average":
            for name, values in (("F", history.F), ("state", history.state)):
                cloud.fields[name] = transfer.to_nodes(values, old.cells, body.triangles.volume, cloud.n)[0]
        places = cloud.x[old.cells].mean(axis=1)
        self.budget.look(cloud, old.cells)
        new = resample.remesh(cloud, old, self.obstacles, self.tessellator, SOLID, self.budget, dt)
        mass = cloud.fields.pop("density") * lumped(cloud, new.cells)
        if body.nodal:
            return cloud, new, History(cloud.fields.pop("F"), cloud.fields.pop("state"), cloud.region), mass
        if self.transfer == "copy":
            centres = cloud.x[new.cells].mean(axis=1)
            F, state = (transfer.copied(a, new.parents, places, centres) for a in (history.F, history.state))
        else:
            F, state = (cloud.fields.pop(name)[new.cells].mean(axis=1) for name in ("F", "state"))
        return cloud, new, History(F, state, cloud.region[new.cells[:, 0]]), mass

    def resume(self) -> None:
        """Take up a body whose cells were restored."""
        self.tessellation = Tessellation(self.body.cells, self.body.facets, np.full(len(self.body.cells), -1))

    def _touching(self, cloud: Cloud) -> Array:
        """(n, obstacles) 1 where a boundary node lies on an obstacle, to within what the contact's penalty lets it sink in."""
        on = np.zeros((cloud.n, len(self.obstacles.solids)))
        edge = np.unique(self.tessellation.facets)
        for o, solid in enumerate(self.obstacles.solids):
            distance = solid.reach(cloud.x[edge])[0]
            on[edge, o] = distance < 0.01 * cloud.size[edge]
        return on
