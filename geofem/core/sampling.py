"""Values of finite element fields at material points, the same on every number of ranks."""

from __future__ import annotations

import math

import numpy as np
from dolfinx import geometry
from mpi4py import MPI

from geofem.core.conditions import DisplacementDofs
from geofem.core.forms import Forms
from geofem.mistake import Mistake
from geofem.scene import Array


class MaterialPoint:
    """Where a material point sits: a cell of one rank and its place in the reference cell; made on the reference mesh."""

    def __init__(self, forms: Forms, displacement: DisplacementDofs, at: tuple[float, ...], name: str):
        self.forms = forms
        mesh = forms.mesh
        self.comm = mesh.comm
        x = np.zeros((1, 3))
        x[0, : len(at)] = at
        cell, reference = self._find(mesh, x)
        claims = self.comm.allgather(cell >= 0)
        if not any(claims):
            raise Mistake(f"probe {name!r}: the point {tuple(at)} lies outside the mesh; give a point of the body")
        self.mine = claims.index(True) == self.comm.rank
        self.cell, self.reference = cell, reference
        if self.mine:
            element = forms.template.element.sub_elements[0] if forms.template.mixed else forms.template.element
            self.basis = element.sub_elements[0].tabulate(0, reference)[0][0]
            self.nodes = displacement.space.dofmap.list[cell]
            self.gdim = mesh.geometry.dim

    def _find(self, mesh: geometry.Mesh, x: np.ndarray) -> tuple[int, np.ndarray]:
        tree = geometry.bb_tree(mesh, mesh.topology.dim, padding=1e-9)
        candidates = geometry.compute_collisions_points(tree, x)
        colliding = geometry.compute_colliding_cells(mesh, candidates, x).links(0)
        owned = mesh.topology.index_map(mesh.topology.dim).size_local
        colliding = colliding[colliding < owned]
        if not len(colliding):
            return -1, np.zeros((1, mesh.topology.dim))
        nodes = mesh.geometry.x[mesh.geometry.dofmaps[0][colliding[0]], : mesh.geometry.dim]
        return int(colliding[0]), mesh.geometry.cmaps[0].pull_back(x[:, : mesh.geometry.dim], nodes)

    def vector(self, field: np.ndarray, component: int) -> float:
        """A component of a field over the displacement's dofs, ghosts included."""
        local = float(self.basis @ field[self.nodes * self.gdim + component]) if self.mine else 0.0
        return self.comm.allreduce(local, op=MPI.SUM)

    def from_quadrature(self, values: np.ndarray, component: int) -> float:
        """A quadrature field (points, components), extended linearly from the points of the cell (their mean if too few)."""
        local = 0.0
        if self.mine:
            points = self.forms.template.points
            own = values[self.cell * len(points) : (self.cell + 1) * len(points), component]
            if len(points) > points.shape[1]:
                matrix = np.c_[np.ones(len(points)), points]
                local = float(np.linalg.lstsq(matrix, own, rcond=None)[0] @ np.r_[1.0, self.reference[0]])
            else:
                local = float(own.mean())
        return self.comm.allreduce(local, op=MPI.SUM)


def quantile(x: Array, mass: Array, share: float) -> float:
    """The value of x (N,) below which ``share`` of the mass lies, interpolated between points."""
    if share >= 1.0:
        return float(x.max())
    # only the top needs to be in order where the share is close to one
    top = np.arange(len(x))
    beyond = (1.0 - share) * mass.sum()
    count = int(min(len(x), 2 + math.ceil(4.0 * (1.0 - share) * len(x))))
    if count < len(x):
        candidates = np.argpartition(x, len(x) - count)[len(x) - count :]
        if mass[candidates].sum() > 1.5 * beyond:
            top = candidates
    order = top[np.argsort(-x[top], kind="stable")]
    below = np.cumsum(mass[order]) - 0.5 * mass[order]
    return float(np.interp(beyond, below, x[order]))
