"""Supports and loads of a scene as Dirichlet conditions and nodal forces."""

from __future__ import annotations

import numpy as np
from dolfinx import fem, la

from geofem.core.forms import Forms
from geofem.core.mesh import Body, facets
from geofem.cost import phase
from geofem.scene import Load, Scene, Support


class DisplacementDofs:
    """The displacement within the unknown of a form: its own space, and where its dofs stand in the unknown.

    index : (dofs,) place of each dof of ``space`` in the array of the unknown, ghosts included. X : (nodes, gdim) reference positions.
    """

    def __init__(self, forms: Forms):
        self.parent = forms.space.sub(0) if forms.template.mixed else forms.space
        if forms.template.mixed:
            self.space, index = self.parent.collapse()
            self.index = np.asarray(index).ravel()
        else:
            self.space = self.parent
            self.index = np.arange(forms.unknown.x.array.size)
        self.X = self.space.tabulate_dof_coordinates()[:, : forms.mesh.geometry.dim].copy()
        self.owned = self.space.dofmap.index_map.size_local * self.space.dofmap.index_map_bs


class Condition:
    """One component of one support: its dofs, their reference positions, and the values they are given."""

    def __init__(self, forms: Forms, displacement: DisplacementDofs, body: Body, support: Support, component: int):
        sub = displacement.parent.sub(component)
        collapsed, parent = sub.collapse()
        mesh = forms.mesh
        where = facets(body, support.where, f"support {support.name!r}")
        dofs = fem.locate_dofs_topological((sub, collapsed), mesh.topology.dim - 1, where)
        self.support, self.component = support, component
        self._parent = np.asarray(parent).ravel()
        self._value = fem.Function(collapsed)
        self._x = collapsed.tabulate_dof_coordinates()[:, : mesh.geometry.dim].T.copy()
        self._space = collapsed
        self.bc = fem.dirichletbc(self._value, dofs, sub)
        indices, owned = self.bc.dof_indices()
        self.dofs = indices[:owned].copy()

    def move_inward(self, part: float) -> None:
        """Ask for values at this part of the way from each node to the middle of the cells around it, on their side of a crack."""
        geometry, nodes = self._space.mesh.geometry, self._space.dofmap.list
        middle = geometry.x[geometry.dofmaps[0][:, :3], : len(self._x)].mean(axis=1)
        total, count = np.zeros_like(self._x.T), np.zeros(self._x.shape[1])
        np.add.at(total, nodes, middle[:, None])
        np.add.at(count, nodes, 1.0)
        self._x += part * (total / count[:, None] - self._x.T).T

    def set(self, t: float, moved: np.ndarray | None = None) -> None:
        """Give the values of time t, less what the mesh has ``moved`` already (an array like the unknown)."""
        if self.support.value is not None:
            self._value.x.array[:] = self.support.value(self._x, t)
        else:
            self._value.x.array[:] = 0.0
        if moved is not None:
            self._value.x.array[:] -= moved[self._parent]


class Loads:
    """The external forces of a scene: dead ones assembled once on the first mesh, others when asked for."""

    def __init__(self, scene: Scene, forms: Forms, body: Body):
        self.scene, self.forms = scene, forms
        gdim = forms.mesh.geometry.dim
        self._dead: list[tuple[Load, np.ndarray]] = []
        self._bodies: list[tuple[Load, fem.Form]] = []
        for load in scene.loads:
            if load.kind == "gravity":
                forms.constants["gravity"].value[:] = np.asarray(load.value, float)[:gdim]
                self._dead.append((load, self._assemble(forms.form("gravity"))))
            elif load.kind == "traction" and load.where is not None:
                forms.constants["traction"].value[:] = np.asarray(load.value, float)[:gdim]
                self._dead.append((load, self._assemble(forms.form("traction", facets(body, load.where, "traction")))))
            elif load.kind == "body":
                forms.need_body()
                self._bodies.append((load, forms.form("body")))
        self._followers = [load for load in scene.loads if load.kind == "pressure"]
        if self._bodies:
            self._points = quadrature_positions(forms)

    def _assemble(self, form: fem.Form) -> np.ndarray:
        vector = la.vector(self.forms.space.dofmap.index_map, self.forms.space.dofmap.index_map_bs)
        fem.assemble_vector(vector.array, form)
        vector.scatter_reverse(la.InsertMode.add)
        return vector.array

    def external(self, t: float) -> np.ndarray:
        """Nodal forces of all loads that do not depend on the displacement at time t; valid at owned dofs."""
        space = self.forms.space
        total = np.zeros((space.dofmap.index_map.size_local + space.dofmap.index_map.num_ghosts) * space.dofmap.index_map_bs)
        with phase("loads"):
            for load, vector in self._dead:
                total += self.scene.amplitude(load, t) * vector
            for load, form in self._bodies:
                self.forms.body.x.array[:] = (self.scene.amplitude(load, t) * load.value(self._points, t)).T.ravel()
                total += self._assemble(form)
        return total

    def set_followers(self, t: float) -> None:
        """Give the pressures in the residual and tangent forms their values of time t."""
        for i, load in enumerate(self._followers):
            self.forms.constants[f"pressure{i}"].value = self.scene.amplitude(load, t) * load.value


def follower_facets(scene: Scene, body: Body) -> list[np.ndarray]:
    """The boundary facets of each pressure of a scene, in the order of ``Loads``."""
    return [facets(body, load.where, "pressure") for load in scene.loads if load.kind == "pressure" and load.where is not None]


def quadrature_positions(forms: Forms) -> np.ndarray:
    """Positions of all quadrature points of the mesh, ghosts included, (gdim, n); of the reference mesh if called at the start."""
    mesh = forms.mesh
    cells = mesh.topology.index_map(mesh.topology.dim)
    nodes = mesh.geometry.x[mesh.geometry.dofmaps[0][: cells.size_local + cells.num_ghosts]][:, :, : mesh.geometry.dim]
    return np.einsum("qk,ckd->dcq", geometry_basis(forms), nodes).reshape(mesh.geometry.dim, -1)


def geometry_basis(forms: Forms) -> np.ndarray:
    """Shape functions of the geometry at the quadrature points, (points, nodes)."""
    element = forms.mesh.ufl_domain().ufl_coordinate_element()
    return element.sub_elements[0].tabulate(0, forms.template.points)[0]
