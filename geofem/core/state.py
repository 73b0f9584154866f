"""Material history at quadrature points: converged and trial, and the point kernels that lead from one to the other."""

from __future__ import annotations

import numpy as np

from geofem import materials
from geofem.core.forms import Forms
from geofem.cost import phase
from geofem.scene import Scene


class PointState:
    """Stress, tangent and history of all owned quadrature points, region by region.

    ``update`` leads from the converged state to a trial one that belongs to the current unknown, as often as Newton asks;
    ``commit`` makes the trial state the converged one. Stress and tangent go into the quadrature functions of the forms.
    """

    def __init__(self, scene: Scene, forms: Forms):
        self.forms, self.scene = forms, scene
        self.finite = scene.strain == "finite"
        m = 6 if forms.template.gdim == 3 else 4
        self._strain = forms.strain()
        per_cell = len(forms.template.points)
        self._count = forms.owned * per_cell
        size = forms.template.components
        self.laws = [materials.get(region.material.law) for region in scene.regions]
        self._points = [(np.asarray(cells)[:, None] * per_cell + np.arange(per_cell)).ravel() for cells in forms.cells]
        self.history = [law.initial_state(len(points), m) for law, points in zip(self.laws, self._points)]
        self._trial = [h.copy() for h in self.history]
        start = np.zeros(size)
        if self.finite:
            start[[0, 3, 4] if size == 5 else [0, 4, 8]] = 1.0
        self.strain = np.tile(start, (self._count, 1))
        """Converged strain (small) or deformation gradient (finite) at the points, (points, components)."""
        self._trial_strain = self._from_mesh = self.strain.copy()
        self.plastic = 0
        self.elastic_share = 0.0
        """Share of the elastic tangent that replaces the consistent one (small strain), where Newton goes round in circles."""
        self.set_time(0.0)

    def set_time(self, t: float, dt: float = 1.0) -> None:
        """Take the material parameters of time t (strength reduction) and the step for rate-dependent laws."""
        weakening = self.scene.weakening(t) if self.scene.weakening else 1.0
        self._parameters = [law.parameters(region.material, weakening) for law, region in zip(self.laws, self.scene.regions)]
        self._dt = dt

    def update(self) -> bool:
        """Stress and tangent for the current unknown; False where det F <= 0 at a point of this rank."""
        with phase("constitutive"):
            size = self.strain.shape[1]
            # kept for the Cauchy stress: a mesh that has moved on says F = I of it
            self._from_mesh = values = self.forms.evaluate(self._strain)
            stress = self.forms.stress.x.array[: self._count * size].reshape(-1, size)
            tangent = self.forms.tangent.x.array[: self._count * size * size].reshape(-1, size, size)
            self.plastic = 0
            if self.finite:
                updated = self.forms.template.updated
                self._trial_strain = compose(values, self.strain) if updated else values
            else:
                self._trial_strain = values
            for law, points, history, trial, parameters in zip(
                self.laws, self._points, self.history, self._trial, self._parameters
            ):
                whole = len(self.laws) == 1
                now, old = (a if whole else a[points] for a in (self._trial_strain, self.strain))
                s, d = (stress, tangent) if whole else (np.empty((len(points), size)), np.empty((len(points), size, size)))
                if self.finite:
                    plastic = law.finite(now, old, history, parameters, self._dt, s, d, trial)
                    if plastic < 0:
                        return False
                    if self.forms.template.updated:
                        law.push(s, d, old)
                else:
                    assert law.small is not None, "the method refuses laws without small strain"
                    plastic = law.small(now - old, history, parameters, s, d, trial)
                    if self.elastic_share:
                        d *= 1.0 - self.elastic_share
                        d += self.elastic_share * elastic_matrix(parameters, size)
                self.plastic += plastic
                if not whole:
                    stress[points], tangent[points] = s, d
            return True

    def commit(self) -> None:
        """The trial state becomes the converged one."""
        self.strain = self._trial_strain.copy()
        for history, trial in zip(self.history, self._trial):
            history[:] = trial

    def merged_history(self) -> dict[str, np.ndarray]:
        """Converged history of all points in the order of the cells; regions whose laws keep less are padded with zeros."""
        width = max(h.shape[1] for h in self.history)
        merged = np.zeros((self._count, width))
        for points, history in zip(self._points, self.history):
            merged[points, : history.shape[1]] = history
        return {"history": merged}

    def take(self, name: str, values: np.ndarray) -> None:
        """Take up ``strain`` or ``history`` (cells, ...) from a checkpoint."""
        values = values.reshape(self._count, -1)
        if name == "strain":
            self.strain[:] = values
            return
        for points, history in zip(self._points, self.history):
            history[:] = values[points, : history.shape[1]]

    def cauchy(self) -> np.ndarray:
        """Cauchy stress at the points for the last update, (points, 4 or 6)."""
        size = self.strain.shape[1]
        stress = self.forms.stress.x.array[: self._count * size].reshape(-1, size)
        if not self.finite:
            return stress
        return cauchy_from_pk1(stress, self._from_mesh)


def elastic_matrix(parameters: np.ndarray, size: int) -> np.ndarray:
    """Isotropic elastic stiffness (size, size) from parameters that begin with Lame's constants lambda and mu."""
    lam, mu = parameters[:2]
    matrix = np.diag([2.0 * mu] * 3 + [mu] * (size - 3))
    matrix[:3, :3] += lam
    return matrix


def tensors(f: np.ndarray) -> np.ndarray:
    """Gradient vectors (n, 5) or (n, 9) as tensors (n, 3, 3)."""
    if f.shape[1] == 9:
        return f.reshape(-1, 3, 3)
    full = np.zeros((len(f), 3, 3))
    full[:, 0, 0], full[:, 0, 1], full[:, 1, 0], full[:, 1, 1], full[:, 2, 2] = f.T
    return full


def vectors(t: np.ndarray, size: int) -> np.ndarray:
    """The inverse of ``tensors``."""
    if size == 9:
        return t.reshape(-1, 9)
    return np.stack([t[:, 0, 0], t[:, 0, 1], t[:, 1, 0], t[:, 1, 1], t[:, 2, 2]], axis=1)


def compose(step: np.ndarray, base: np.ndarray) -> np.ndarray:
    """F = f F_n of gradient vectors, (n, 5 or 9)."""
    return vectors(tensors(step) @ tensors(base), base.shape[1])


def cauchy_from_pk1(stress: np.ndarray, f: np.ndarray) -> np.ndarray:
    """sigma = P F^T / det F as (xx, yy, zz, xy[, yz, xz]) from vectors of P and F of the same configuration."""
    deformation = tensors(f)
    sigma = tensors(stress) @ deformation.transpose(0, 2, 1) / np.linalg.det(deformation)[:, None, None]
    pairs = [(0, 0), (1, 1), (2, 2), (0, 1)] + ([(1, 2), (0, 2)] if f.shape[1] == 9 else [])
    return np.stack([sigma[:, i, j] for i, j in pairs], axis=1)
