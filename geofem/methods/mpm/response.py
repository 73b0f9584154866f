"""Stress and tangent of all material points of a rank for trial increments of a load step, with or without the volumetric cure."""

from __future__ import annotations

import numpy as np

from geofem.core.state import compose, tensors
from geofem.methods.mpm import tangent
from geofem.methods.mpm.kind import Kind
from geofem.methods.mpm.points import Body
from geofem.methods.mpm.table import Groups
from geofem.scene import Array


class Response:
    """The points of all bodies, one body after the other, from the start of a load step on.

    volume : (N,) at the start of the step (m3). stress : (N, g) first Piola-Kirchhoff stress with respect to the start, cure included.
    H : (N, g + 1, g + 1) its tangent. D : see ``tangent.make_average``.
    """

    def __init__(self, bodies: list[Body], kind: Kind, groups: Groups):
        self.bodies, self.kind, self.groups = bodies, kind, groups
        self.small, self.g = kind.small, 5 if kind.dim == 2 else 9
        self.d = 3 if kind.axial else kind.dim
        self.F = np.concatenate([body.own("F") for body in bodies])
        N = len(self.F)
        reference = np.concatenate([body.own("volume") for body in bodies])
        self.volume = reference if self.small else reference * np.concatenate([body.jacobian() for body in bodies])
        self.stress, self.D = np.zeros((N, self.g)), np.zeros((N, self.g))
        self.P, self.A = np.zeros((N, self.g)), np.zeros((N, self.g, self.g))
        self._identity = np.array([1.0, 0, 0, 1, 1] if self.g == 5 else np.eye(3).ravel())
        self.m = 4 if self.g == 5 else 6
        self.plastic = 0
        sizes = np.cumsum([0] + [body.n for body in bodies])
        self._parts = [slice(a, b) for a, b in zip(sizes[:-1], sizes[1:])]
        self._trial = [np.zeros_like(body.own("state")) for body in bodies]
        self.new_F = self.F

    def _per_cell(self, values: Array) -> tuple[Array, Array]:
        """Sums of values (N,) over the cells, and these at the points."""
        groups = self.groups
        sums = np.add.reduceat(values[groups.points], groups.start[:-1]) if len(values) else values
        at = np.empty_like(values)
        at[groups.points] = np.repeat(sums, np.diff(groups.start))
        return sums, at

    def update(self, G: Array, dt: float) -> bool:
        """Stresses for displacement gradients G (N, g); False if a point would be turned inside out, or nothing is known of it."""
        f = G if self.small else G + self._identity
        seen = f
        if self.kind.cure:
            j = self._volume_ratio(f)
            if not self.small and not np.all(j > 0.0):
                return False
            cells = self._per_cell(self.volume)[1]
            self.theta = self._per_cell(self.volume * j)[1] / cells
            N, g = f.shape
            self.T = np.empty((N, g, g + 1))
            tangent.make_average(g, self.d, self.small)(f, self.theta, self.T, self.D)
            seen = self._averaged(f, j)
        self.f = f
        if not self._laws(seen, dt):
            return False
        self.stress = self.P
        if self.kind.cure:
            both = np.einsum("na,nab->nb", self.P, self.T)
            self.ratio = self._per_cell(self.volume * both[:, self.g])[1] / cells
            self.stress = both[:, : self.g] + self.ratio[:, None] * self.D
        return True

    def _volume_ratio(self, f: Array) -> Array:
        """det f over the averaged components, or tr f at small strain."""
        diagonal = [0, 3, 4][: self.d] if self.g == 5 else [0, 4, 8]
        if self.small:
            return f[:, diagonal].sum(axis=1)
        if self.g == 9:
            return np.linalg.det(f.reshape(-1, 3, 3))
        return (f[:, 0] * f[:, 3] - f[:, 1] * f[:, 2]) * (f[:, 4] if self.d == 3 else 1.0)

    def _averaged(self, f: Array, j: Array) -> Array:
        seen = f.copy()
        last = 4 if self.g == 5 and self.d == 2 else self.g
        if self.small:
            diagonal = [0, 3, 4][: self.d] if self.g == 5 else [0, 4, 8]
            seen[:, diagonal] += ((self.theta - j) / self.d)[:, None]
        else:
            seen[:, :last] *= ((self.theta / j) ** (1.0 / self.d))[:, None]
        return seen

    def _laws(self, seen: Array, dt: float) -> bool:
        """P and A of every body for what its law sees."""
        self.plastic = 0
        self.new_F = self.F + seen if self.small else compose(seen, self.F)
        for body, part, trial in zip(self.bodies, self._parts, self._trial):
            if not body.n:
                continue
            F, P, A = self.F[part], self.P[part], self.A[part]
            if self.small:
                assert body.law.small is not None
                M = strain_of_gradient(self.g)
                stress, moduli = np.empty((body.n, self.m)), np.empty((body.n, self.m, self.m))
                plastic = body.law.small(seen[part] @ M.T, body.own("state"), body.par, stress, moduli, trial)
                P[:], A[:] = stress @ M, M.T @ moduli @ M
            else:
                plastic = body.law.finite(self.new_F[part], F, body.own("state"), body.par, dt, P, A, trial)
                if plastic < 0:
                    return False
                body.law.push(P, A, F)
            self.plastic += plastic
        return bool(np.isfinite(self.P).all())

    def linearise(self) -> Array:
        """The tangent H (N, g + 1, g + 1) of the last update."""
        if not self.kind.cure:
            return self.A
        H = np.empty((len(self.A), self.g + 1, self.g + 1))
        tangent.make_chain(self.g, self.d, self.small)(self.f, self.theta, self.ratio, self.T, self.D, self.P, self.A, H)
        return H

    def commit(self) -> None:
        """Make the last update the state of the points."""
        size = self.m
        pairs = [(0, 0), (1, 1), (2, 2), (0, 1)] + ([(1, 2), (0, 2)] if size == 6 else [])
        for body, part, trial in zip(self.bodies, self._parts, self._trial):
            body.own("state")[:] = trial
            body.own("F")[:] = self.new_F[part]
            P = tensors(self.P[part])
            if not self.small:
                # what the law saw of the step turns the stress with respect to its start into that of Kirchhoff
                seen = tensors(self.new_F[part]) @ np.linalg.inv(tensors(self.F[part]))
                P = P @ seen.transpose(0, 2, 1) * np.linalg.det(tensors(self.F[part]))[:, None, None]
            body.own("tau")[:] = np.stack([P[:, i, j] for i, j in pairs], axis=1) if body.n else 0.0


def strain_of_gradient(g: int) -> Array:
    """M (m, g): the strain vector of a displacement gradient."""
    if g == 5:
        M = np.zeros((4, 5))
        M[0, 0] = M[1, 3] = M[2, 4] = M[3, 1] = M[3, 2] = 1.0
        return M
    M = np.zeros((6, 9))
    M[0, 0] = M[1, 4] = M[2, 8] = M[3, 1] = M[3, 3] = M[4, 5] = M[4, 7] = M[5, 2] = M[5, 6] = 1.0
    return M
