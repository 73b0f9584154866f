"""The material points of a body as arrays, in the order of the grid's cells, and those of other ranks that it needs beside them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from geofem import materials
from geofem.methods.mpm.kind import Answer, Cloud
from geofem.methods.mpm.seed import Seeds
from geofem.methods.mpm.shapes import SHAPES
from geofem.mistake import Breakdown
from geofem.scene import Array, Material

KEPT = ("X", "x", "v", "C", "spread", "F", "tau", "state", "mass", "volume", "domain", "grip", "id", "key")
"""What a point takes along to another rank and into a checkpoint."""
NEIGHBOURS = 9
SHIFT = 1 << 31
"""Keys are cell * SHIFT + number, both below it: an order that does not depend on where a point is stored."""


class Body:
    """One region's points on this rank: ``n`` of its own, then copies of others' points near its cells.

    All arrays of ``Cloud``, and: spread (N, 3 or 6) see ``parts.make_keep_moments`` (apic only); grip (N, d rigids) friction force
    held by each rigid body (N); id (N,) number that a point was born with; key (N,) its place in the common order of all ranks.
    Arrays are longer than the points they hold.
    """

    def __init__(self, seeds: Seeds, material: Material, par: Array, kind: Any, domain: str, h: float, rigids: int):
        law = materials.get(material.law)
        self.law, self.par, self.kind = law, par, kind
        self.answer = Answer(law.point, materials.LAWS[material.law].history, law.state_size(4) > 0)
        self.exact, self.density = seeds.exact, material.density
        N, d = seeds.points.shape
        m, g = (4, 5) if d == 2 else (6, 9)
        if domain == "corners":
            assert seeds.corners is not None
            place = seeds.corners.reshape(N, -1)
        elif domain == "edges":
            place = seeds.edges.reshape(N, -1) / h
        else:
            place = np.abs(seeds.edges).sum(axis=1) / h
            if not SHAPES[kind.shape].spread:
                place = np.minimum(place, 0.5)  # no more than these shapes' nodes can tell of
        affine = {"apic": d * d, "xpic": d}.get(kind.transfer, 0)
        self._identity = [1.0, 0.0, 0.0, 1.0, 1.0] if d == 2 else [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
        self.arrays: dict[str, Array] = {
            "X": seeds.points.copy(),
            "x": seeds.points.copy(),
            "v": np.zeros((N, d)),
            "C": np.zeros((N, affine)),
            "spread": np.zeros((N, 3 * (d - 1) if kind.transfer == "apic" else 0)),
            "F": np.tile(self._identity, (N, 1)),
            "tau": np.zeros((N, m)),
            "state": np.ascontiguousarray(law.initial_state(N, m), float),
            "mass": seeds.volumes * material.density,
            "volume": seeds.volumes.copy(),
            "domain": np.ascontiguousarray(place, float),
            "grip": np.zeros((N, d * rigids)),
            "id": np.arange(N),
            "key": np.arange(N),
        }
        self.born = N
        self.n = self.N = N
        self._order = np.empty(0, np.int64)
        self._widen(N)
        self._cloud: Cloud | None = None

    # --- arrays -------------------------------------------------------------------------------------------------------
    def _widen(self, size: int) -> None:
        """Room for ``size`` points, and the arrays that only live within a step."""
        d, kind = self.arrays["X"].shape[1], self.kind
        self.capacity = size
        for name, array in self.arrays.items():
            new = np.zeros((size, *array.shape[1:]), array.dtype)
            new[: min(len(array), size)] = array[:size]
            self.arrays[name] = new
        self.force = np.zeros((size if kind.loaded else 0, d))
        self.increment = np.zeros((size if kind.cure else 0, d * d + (1 if kind.axial else 0)))
        apart = not kind.small and (kind.scheme == "musl" or kind.cure)
        self._at = self.arrays["x"].copy() if apart else None
        self._stretch = None
        if kind.small:
            self._stretch = np.tile(self._identity, (size, 1))
        elif kind.scheme == "usf" and SHAPES[kind.shape].spread:
            self._stretch = self.arrays["F"].copy()

    def make_room(self, size: int) -> None:
        if size > self.capacity:
            self._widen(max(size, self.capacity + self.capacity // 4))
        self._cloud = None

    @property
    def cloud(self) -> Cloud:
        """The points as the passes see them, copies included."""
        if self._cloud is None:
            a, N = self.arrays, self.N
            at = a["X"] if self.kind.small else a["x"] if self._at is None else self._at
            self._cloud = Cloud(
                X=a["X"][:N], x=a["x"][:N], at=at[:N], v=a["v"][:N], C=a["C"][:N], F=a["F"][:N], L=self.increment[:N],
                tau=a["tau"][:N], state=a["state"][:N], mass=a["mass"][:N], volume=a["volume"][:N], force=self.force[:N],
                domain=a["domain"][:N], stretch=self.stretch[:N], order=self._order, per_density=1.0 / self.density,
            )  # fmt: skip
        return self._cloud

    @property
    def stretch(self) -> Array:
        """The deformation gradient of the domains on the grid of this step."""
        return self.arrays["F"] if self._stretch is None else self._stretch

    def own(self, name: str) -> Array:
        """An array of this rank's own points."""
        return self.arrays[name][: self.n]

    def settle(self) -> None:
        """The points' new places and domains are those on the grid of the next step."""
        if self._at is not None:
            self._at[: self.N] = self.arrays["x"][: self.N]
        if self._stretch is not None and not self.kind.small:
            self._stretch[: self.N] = self.arrays["F"][: self.N]

    def reorder(self) -> None:
        """Let the points, copies included, add to the grid in the order of their keys."""
        self._order = np.argsort(self.arrays["key"][: self.N], kind="stable")
        self._cloud = None

    # --- the common order -----------------------------------------------------------------------------------------------
    def sort(self, cell: Array) -> None:
        """Put the own points, in the cells ``cell`` (n,), in the order of their cells, and those of a cell in that of their numbers."""
        if not self.n:
            return
        if max(int(cell.max()), int(self.arrays["id"][: self.n].max())) >= SHIFT:
            raise Breakdown("volume", "more cells or points than the order of points can tell apart (2**31)")
        key = self.arrays["key"]
        key[: self.n] = cell * SHIFT + self.arrays["id"][: self.n]
        order = np.argsort(key[: self.n], kind="stable")
        for name in KEPT:
            permute(self.arrays[name][: self.n].reshape(self.n, -1), order)
        self.settle()

    def remove(self, which: Array) -> None:
        """Take own points out, ``which`` (n,) bool; copies are dropped."""
        stay = ~which
        for name in KEPT:
            kept = self.arrays[name][: self.n][stay]
            self.arrays[name][: len(kept)] = kept
        self.n = self.N = int(stay.sum())
        self._cloud = None

    def add(self, fields: dict[str, Array], own: bool) -> None:
        """Append points, as own ones (no copies may be there) or as copies."""
        count = len(fields["id"])
        self.make_room(self.N + count)
        for name in KEPT:
            self.arrays[name][self.N : self.N + count] = fields[name]
        self.N += count
        if own:
            self.n = self.N
        self._cloud = None

    def pick(self, which: Array) -> dict[str, Array]:
        """Fields of some points."""
        return {name: self.arrays[name][which] for name in KEPT}

    # --- what can be asked ------------------------------------------------------------------------------------------------
    def jacobian(self) -> Array:
        """det F (n,) of the own points."""
        F = self.own("F")
        if F.shape[1] == 5:
            return (F[:, 0] * F[:, 3] - F[:, 1] * F[:, 2]) * F[:, 4]
        return np.linalg.det(F.reshape(-1, 3, 3))

    def stress(self) -> Array:
        """Cauchy stress (n, m) of the own points (Pa)."""
        tau = self.own("tau")
        return tau if self.kind.small else tau / self.jacobian()[:, None]


@njit(cache=True)
def permute(rows: Any, order: Any) -> None:
    """Put the rows of an array in a new order, in place."""
    old = rows.copy()
    for p in range(len(order)):
        for k in range(rows.shape[1]):
            rows[p, k] = old[order[p], k]


def weights_around(X: Array, at: tuple[float, ...]) -> tuple[Array, Array]:
    """The points (k,) of X (n, d) nearest to a reference position and weights (k,) that extrapolate a field there.

    The weights belong to the plane that fits the nearest points best (least squares), so that a linear field is met exactly; points
    as far off as the last one count too.
    """
    distance = np.linalg.norm(X - np.array(at), axis=1)
    reach = np.sort(distance)[min(NEIGHBOURS * (X.shape[1] - 1), len(X)) - 1]
    near = np.flatnonzero(distance <= reach * (1 + 1e-9))
    plane = np.column_stack([np.ones(len(near)), X[near] - np.array(at)])
    return near, np.linalg.pinv(plane, rcond=1e-9)[0]
