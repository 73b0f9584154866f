"""The body without its cracks: its mesh, material and stiffness, which growing cracks leave as they are."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from dolfinx import mesh

from geofem.core.forms import Forms, Template
from geofem.core.mesh import Body
from geofem.core.neartip import kolosov
from geofem.cost import phase
from geofem.methods.xfem.grid import Grid, boundary_edges
from geofem.methods.xfem.system import StandardBlock
from geofem.scene import Array, Region


class Intact:
    """A meshed body and the stiffness of its standard dofs. Made collectively.

    lam, mu : (cells,) Lame constants (Pa) in the plane. kappas : (regions,) Kolosov's constants. boundary : (facets, 2) nodes of
    this rank's part of the boundary.
    """

    def __init__(self, template: Template, body: Body, regions: tuple[Region, ...]):
        self.body, self.plane, self.comm = body, template.plane, body.mesh.comm
        self.forms = Forms(body.mesh, template, body.regions)
        self.forms.set_parameters([region.material for region in regions])
        self.space = self.forms.space
        self.grid = Grid(self.space, body.regions)
        constants = [self.forms.constants[f"{name}{i}"].value for name in ("lam", "mu") for i in range(len(regions))]
        self.lam, self.mu = np.array(constants, float).reshape(2, -1)[:, self.grid.region]
        self.kappas = np.array([kolosov(region.material.parameters["nu"], template.plane) for region in regions])
        with phase("assembly"):
            self.standard = StandardBlock(self.forms.form("tangent"), self.grid)
        self.boundary = boundary_edges(self.grid, mesh.exterior_facet_indices(body.mesh.topology))

    @cached_property
    def walls(self) -> Array:
        """The edges of the boundary on all ranks (n, 2, 2), m. Collective."""
        return np.concatenate(self.comm.allgather(self.grid.X[self.boundary]))
