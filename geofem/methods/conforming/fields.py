"""Displacements and their gradients at chosen points of the cells of a mesh, with polar rules in those around a tip."""

from __future__ import annotations

from typing import NamedTuple

import basix
import numpy as np
from dolfinx import fem

from geofem.core.neartip import modes
from geofem.materials.kinematics import kernel
from geofem.methods.conforming.mesh import Tip
from geofem.scene import Array

POLAR = 8
"""Gauss points per direction in the cells around a tip."""


class Points(NamedTuple):
    """Points of cells: cell (n,), x (n, 2) m, weights w (n,) m2, displacement u (n, 2) m and its gradient g (n, 2, 2)."""

    cell: Array
    x: Array
    w: Array
    u: Array
    g: Array


class Fields:
    """Evaluates the functions of a Lagrange space on triangles.

    X : (cells, 3, 2) corners (m).
    """

    def __init__(self, space: fem.FunctionSpace, tips: tuple[Tip, ...]):
        self.geometry = space.mesh.geometry
        self._map = space.mesh.ufl_domain().ufl_coordinate_element().sub_elements[0]
        self._element = space.ufl_element().sub_elements[0]
        self._nodes = space.dofmap.list
        self.X = self.geometry.x[self.geometry.dofmaps[0][:, :3], :2]
        # the corner at which a cell has a tip, 3 where it has none
        self._apex = np.full(len(self.X), 3)
        for tip in tips:
            at = np.hypot(*(self.X - tip.at).T).T == 0.0
            self._apex[at.any(axis=1)] = at.argmax(axis=1)[at.any(axis=1)]

    def at_points(self, cells: Array, u: Array, degree: int) -> Points:
        """All at the points of a rule of that degree in the cells (m,); u : (nodes, 2), ghosts included."""
        parts = []
        for apex in range(4):
            here = cells[self._apex[cells] == apex]
            xi, weight = polar_rule(apex) if apex < 3 else basix.make_quadrature(basix.CellType.triangle, degree)
            parts.append(self._evaluate(here, xi, weight, u))
        return Points(*(np.concatenate(column) for column in zip(*parts)))

    def _evaluate(self, cells: Array, xi: Array, weight: Array, u: Array) -> Points:
        shape, basis = self._map.tabulate(1, xi), self._element.tabulate(1, xi)
        nodes, values = self.geometry.x[self.geometry.dofmaps[0][cells], :2], u[self._nodes[cells]]
        x, slope = np.einsum("qk,cki->cqi", shape[0], nodes), np.einsum("aqk,cki->cqia", shape[1:], nodes)
        double = slope[..., 0, 0] * slope[..., 1, 1] - slope[..., 0, 1] * slope[..., 1, 0]
        back = np.empty_like(slope)
        back[..., 0, 0], back[..., 1, 1] = slope[..., 1, 1] / double, slope[..., 0, 0] / double
        back[..., 0, 1], back[..., 1, 0] = -slope[..., 0, 1] / double, -slope[..., 1, 0] / double
        g = np.einsum("aqk,cki,cqaj->cqij", basis[1:], values, back, optimize=True)
        w = weight * np.abs(double)
        at = np.einsum("qk,cki->cqi", basis[0], values)
        return Points(np.repeat(cells, len(xi)), x.reshape(-1, 2), w.ravel(), at.reshape(-1, 2), g.reshape(-1, 2, 2))


def polar_rule(apex: int) -> tuple[Array, Array]:
    """Points (n, 2) and weights (n,) on the reference triangle by which 1 / r is integrated around a corner (Duffy 1982)."""
    gauss, weight = np.polynomial.legendre.leggauss(POLAR)
    gauss, weight = 0.5 * (gauss + 1.0), 0.5 * weight
    s, t = (a.ravel() for a in np.meshgrid(gauss, gauss, indexing="ij"))
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    p, q, r = corners[[apex, (apex + 1) % 3, (apex + 2) % 3]]
    return p + (s * (1.0 - t))[:, None] * (q - p) + (s * t)[:, None] * (r - p), np.outer(weight, weight).ravel() * s


@kernel
def modes_at(x: Array, at: Array, axis: Array, kappa: float) -> Array:
    """Gradients (n, 2, 2, 2) of 2 mu times the displacement of both modes, K = 1, of a straight crack at the points x (n, 2)."""
    u, g = np.empty((2, 2)), np.empty((x.shape[0], 2, 2, 2))
    for k in range(x.shape[0]):
        dx, dy = x[k, 0] - at[0], x[k, 1] - at[1]
        theta = np.arctan2(dy * axis[0] - dx * axis[1], dx * axis[0] + dy * axis[1])
        modes(np.hypot(dx, dy), theta, axis[0], axis[1], kappa, u, g[k])
    return g
