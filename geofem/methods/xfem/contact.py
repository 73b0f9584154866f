"""Faces that touch, rub or hold together: their tractions as multipliers, found in a small dense system.

Tractions are piecewise linear between stations along a crack, COARSE cells apart: with one station in each cell they would
oscillate, as the jump of the basis cannot follow them; on a mesh coarser than the body's they do not (Girault and Glowinski
1995). A law holds at each station between the traction there and the mean of the jump under the station's hat function,
g = A x. With M the lengths of the hats and r a stiffness, balance is

    (K + A' M r A) x = f + A' M (z - 2 t(z) + r s),   z = t + r (g - s),

s being the slip before the step (augmented Lagrangian, Alart and Curnier 1991). The matrix is symmetric, positive definite and
always the same, whatever touches, slips or softens; its solutions for unit tractions leave an equation for z at the
stations alone, which Newton's method with backtracking solves.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from mpi4py import MPI
from scipy.sparse import csr_array

from geofem.methods.xfem.facelaw import law_of, respond
from geofem.methods.xfem.faces import Faces
from geofem.methods.xfem.system import Numbering, System
from geofem.mistake import Breakdown
from geofem.scene import Array, Crack

COARSE = 3.0
"""Stations are so many cells apart."""
ITERATIONS, HALVINGS = 60, 12
TOLERANCE = 1e-12
"""Error of jumps relative to those of the loads, with which Newton's iteration ends."""
STALLED = 1e-9
"""The error at which it may end when it falls no further: rounding."""


class Stations(NamedTuple):
    """The same on every rank: crack (m,), arc (m,) length from its first point (m), and length (m,) of the hat function (m)."""

    crack: Array
    arc: Array
    length: Array


class Contact:
    """The tractions between the faces of some cracks. Made collectively.

    stations : see there. A : (2 m, all dofs) of the means of the jump, normal and along, on every rank. r : (m,) Pa/m.
    z, slip, worst : state, see above; (m, 2), (m,) and (m,) the largest opening so far (m).
    traction : (m, 2) that holds the faces together (Pa).
    """

    def __init__(
        self, faces: Faces, cracks: dict[int, Crack], size: Array, modulus: float, numbering: Numbering, comm: MPI.Intracomm
    ):
        self.faces, self.comm, self.numbering = faces, comm, numbering
        self._points = np.flatnonzero(np.isin(faces.crack, list(cracks)))
        cells = np.repeat(faces.rule.cells, np.diff(faces.rule.start))[self._points]
        mine = np.stack([faces.crack, faces.arc, faces.rule.w])[:, self._points]
        every = np.concatenate(comm.allgather(np.concatenate([mine, size[cells][None]]).T))
        crack, arc = self._place(every)
        self._hats = self._hat_functions(crack, arc)
        weights = faces.rule.w[self._points]
        length = comm.allreduce(self._hats.T @ weights, op=MPI.SUM)
        self.stations = Stations(crack, arc, length)
        rows = (2 * self._points[:, None] + np.arange(2)).ravel()
        spread = csr_array(np.kron((self._hats.T * weights / length[:, None]), np.eye(2)))
        local = (spread @ faces.jump[rows]).tocoo()
        parts = comm.allgather((local.row, numbering.to_global[local.col], local.data))
        row, column, value = (np.concatenate(part) for part in zip(*parts))
        self.A = csr_array((value, (row, column)), shape=(2 * len(arc), numbering.total))
        self._own = self.A[:, numbering.first : numbering.first + numbering.owned]
        self.law = law_of([cracks[c] for c in crack.tolist()])
        self.r = np.maximum(modulus / length, 2.0 * self.law.strength / self.law.spent)
        self.z, self.traction = np.zeros((len(arc), 2)), np.zeros((len(arc), 2))
        self.slip, self.worst = np.zeros(len(arc)), np.zeros(len(arc))

    @staticmethod
    def _place(points: Array) -> tuple[Array, Array]:
        """Crack and arc of the stations; points : (n, 4) crack, arc, weight and size of the cell of all points of the faces."""
        cracks, arcs = [], []
        for c in np.unique(points[:, 0]):
            arc, weight, size = points[points[:, 0] == c][:, 1:].T
            order = np.argsort(arc)
            parts = (weight / (COARSE * size))[order]
            along = np.cumsum(parts) - 0.5 * parts
            spans = max(1, int(parts.sum() + 0.5))
            found = np.interp(parts.sum() * np.arange(spans + 1) / spans, along, arc[order])
            cracks.append(np.full(spans + 1, c))
            arcs.append(found)
        return np.concatenate(cracks).astype(np.int64), np.concatenate(arcs)

    def _hat_functions(self, crack: Array, arc: Array) -> Array:
        """The hat functions of the stations at this rank's points, (n, m)."""
        hats = np.zeros((len(self._points), len(arc)))
        for c in np.unique(crack):
            of, here = np.flatnonzero(crack == c), np.flatnonzero(self.faces.crack[self._points] == c)
            for k, unit in zip(of, np.eye(len(of))):
                hats[here, k] = np.interp(self.faces.arc[self._points[here]], arc[of], unit)
        return hats

    # --- in the global system -------------------------------------------------------------------------------------
    @property
    def _weights(self) -> Array:
        return np.repeat(self.stations.length, 2)

    def springs(self) -> tuple[Array, Array, Array]:
        """A' M r A in the rows of this rank: global rows, columns and values."""
        block = (self._own.T @ (self.A * (self._weights * np.repeat(self.r, 2))[:, None])).tocoo()
        return block.row + self.numbering.first, block.col, block.data

    def means(self, owned: Array) -> Array:
        """The means of the jump (m, 2), m; owned : dofs of this rank. Collective."""
        return self.comm.allreduce(self._own @ owned, op=MPI.SUM).reshape(-1, 2)

    def force(self, traction: Array) -> Array:
        """The forces at owned dofs with which tractions (m, 2) resist opening."""
        return self._own.T @ (self._weights * traction.ravel())

    def spring_force(self, owned: Array) -> Array:
        """What the springs in the matrix add to the internal forces. Collective."""
        return self.force(self.r[:, None] * self.means(owned))

    def prepare(self, system: System, held: int) -> None:
        """The means of the jump for unit tractions at each station. Collective; one solution each."""
        owned, zero = system.numbering.local_owned, np.zeros(held)
        columns = []
        for unit in np.eye(2 * len(self.r)):
            columns.append(self.means(system.solve(self.force(unit.reshape(-1, 2)), zero)[owned]).ravel())
        self.flexibility = np.array(columns).T

    # --- the step -------------------------------------------------------------------------------------------------
    def solve(self, system: System, force: Array, values: Array) -> Array:
        """All local dofs in balance with the owned forces; the state moves on. See ``System.solve``. Collective.

        Raises ``Breakdown`` (newton) where no balance is found.
        """
        free = self.means(system.solve(force, values)[system.numbering.local_owned])
        z = self._newton(free)
        t = respond(z, self.law, self.r, self.worst)[0]
        offset = np.stack([np.zeros_like(self.slip), self.slip], axis=1)
        x = system.solve(force + self.force(z - 2.0 * t + self.r[:, None] * offset), values)
        jump = (z - t) / self.r[:, None] + offset
        holds = self.law.strength > 0.0
        self.worst = np.where(holds, np.maximum(self.worst, np.hypot(np.maximum(jump[:, 0], 0.0), jump[:, 1])), 0.0)
        self.slip = np.where(self.law.friction > 0.0, jump[:, 1], 0.0)
        self.z, self.traction = z, t
        return x

    def _newton(self, free: Array) -> Array:
        """z where the jumps of the body are those of the law; free : (m, 2) the jumps without it."""
        z, F, r = self.z.copy(), self.flexibility, np.repeat(self.r, 2)
        offset = np.stack([np.zeros_like(self.slip), self.slip], axis=1).ravel()
        base = free.ravel() + F @ (r * offset) - offset

        def evaluate(z: Array) -> tuple[Array, Array, float]:
            t, slope = respond(z, self.law, self.r, self.worst)
            left = base + F @ (z - 2.0 * t).ravel() - (z - t).ravel() / r
            return left, slope, float(np.linalg.norm(left))

        if not z.any():
            # begin with faces that hold together: with all of them open, a body cut in two would float
            z = np.linalg.solve(F, base).reshape(-1, 2)
        left, slope, norm = evaluate(z)
        scale = np.linalg.norm(base) or 1.0
        for _ in range(ITERATIONS):
            if norm <= TOLERANCE * scale:
                return z
            T = np.zeros_like(F)
            for i in range(2):
                for j in range(2):
                    T[i::2, j::2] = np.diag(slope[:, i, j])
            identity = np.eye(len(F))
            try:
                change = np.linalg.solve(F @ (identity - 2.0 * T) - (identity - T) / r[:, None], -left).reshape(-1, 2)
            except np.linalg.LinAlgError:
                break
            length, before = 1.0, norm
            for _ in range(HALVINGS):
                trial = z + length * change
                left, slope, norm = evaluate(trial)
                if norm < before:
                    break
                length *= 0.5
            if norm >= before and before <= STALLED * scale:
                return z
            z = trial
        if norm <= STALLED * scale:
            return z
        raise Breakdown("newton", f"the faces of cracks find no balance: jumps {norm:.1e} m off, of {scale:.1e} m")

    # --- what it came to ------------------------------------------------------------------------------------------
    def at_points(self) -> Array:
        """The traction (n, 2) that holds the faces together at all points of the faces, Pa."""
        out = np.zeros((len(self.faces.crack), 2))
        out[self._points] = self._hats @ self.traction
        return out

    def dissipated(self) -> float:
        """What cohesion has spent (J)."""
        return float(self.stations.length @ (0.5 * self.law.strength * np.minimum(self.worst, self.law.spent)))

    def state(self) -> Array:
        """All that the next step depends on, (m, 4), the same on every rank."""
        return np.column_stack([self.z, self.slip, self.worst])

    def restore(self, state: Array) -> None:
        self.z, self.slip, self.worst = state[:, :2].copy(), state[:, 2].copy(), state[:, 3].copy()
