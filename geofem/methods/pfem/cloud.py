"""The nodes of the bodies: where they are and what they carry, the same on every rank."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from geofem.scene import Array


@dataclass
class Cloud:
    """Nodes and what they carry.

    x : (n, gdim) present positions (m). X : (n, gdim) reference positions (m); those of a new node are interpolated.
    v : (n, gdim) velocities (m/s). p : (n,) pressures (Pa).
    size : (n,) the spacing that the nodes ought to have here (m).
    region : (n,) int64 the body.
    carried : (n,) volume (m2 or m3) that a flying node carries; 0 for nodes of the mesh.
    id : (n,) int64, never used twice. fields : further (n, ...) arrays, interpolated like v.
    """

    x: Array
    X: Array
    v: Array
    p: Array
    size: Array
    region: Array
    carried: Array
    id: Array
    next_id: int
    fields: dict[str, Array] = field(default_factory=dict)

    @classmethod
    def at_rest(cls, x: Array, size: Array, region: Array | None = None) -> Cloud:
        """Nodes at their reference positions, at rest, without pressure."""
        n = len(x)
        region = np.zeros(n, np.int64) if region is None else np.asarray(region, np.int64)
        return cls(x.copy(), x.copy(), np.zeros_like(x), np.zeros(n), size.copy(), region, np.zeros(n), np.arange(n), n)

    @property
    def n(self) -> int:
        return len(self.x)

    NAMES = ("x", "X", "v", "p", "size", "region", "carried", "id")

    def keep(self, kept: Array) -> None:
        """Drop all nodes but those, by mask or by number."""
        for name in self.NAMES:
            setattr(self, name, getattr(self, name)[kept])
        self.fields = {name: values[kept] for name, values in self.fields.items()}

    def add(self, parents: Array, weights: Array) -> Array:
        """New nodes, interpolated: parents (k, j) nodes, weights (k, j) that sum up to one. Returns their numbers (k,)."""
        first = parents[:, 0]

        def mixed(values: Array) -> Array:
            return np.einsum("kj,kj...->k...", weights, values[parents])

        for name in ("x", "X", "v", "p", "size"):
            setattr(self, name, np.concatenate([getattr(self, name), mixed(getattr(self, name))]))
        self.fields = {name: np.concatenate([values, mixed(values)]) for name, values in self.fields.items()}
        self.region = np.concatenate([self.region, self.region[first]])
        self.carried = np.concatenate([self.carried, np.zeros(len(parents))])
        self.id = np.concatenate([self.id, self.next_id + np.arange(len(parents))])
        self.next_id += len(parents)
        return np.arange(self.n - len(parents), self.n)
