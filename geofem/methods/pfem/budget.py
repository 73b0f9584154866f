"""What every kind of change did to the volume, momentum and energy of the bodies."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import factorial

import numpy as np

from geofem.methods.pfem.cloud import Cloud
from geofem.scene import Array

KINDS = ("lagrangian", "wall", "resample", "merge", "separate", "restore")


def volumes(x: Array, cells: Array) -> Array:
    """Signed volumes (m2 or m3) of simplices, x (n, gdim), cells (m, gdim + 1)."""
    edges = x[cells[:, 1:]] - x[cells[:, :1]]
    if x.shape[1] == 2:
        return 0.5 * (edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0])
    return np.linalg.det(edges) / factorial(x.shape[1])


def lumped(cloud: Cloud, cells: Array) -> Array:
    """Volume (n,) of each node: its share of its cells, or what it carries when it flies."""
    share = np.repeat(volumes(cloud.x, cells) / cells.shape[1], cells.shape[1])
    return np.bincount(cells.ravel(), share, cloud.n) + cloud.carried


@dataclass(frozen=True)
class Amount:
    """Integrals over the bodies and all that flies, per unit of density.

    volume (m2 or m3), momentum (gdim,) = int v, kinetic = int v.v/2 with lumped masses, potential = -int g.x.
    """

    volume: float
    momentum: Array
    kinetic: float
    potential: float

    @classmethod
    def of(cls, cloud: Cloud, cells: Array, gravity: Array) -> Amount:
        """What there is now; gravity (gdim,) (m/s2)."""
        m = lumped(cloud, cells)
        kinetic = 0.5 * float(m @ (cloud.v**2).sum(axis=1))
        return cls(float(m.sum()), m @ cloud.v, kinetic, -float(m @ cloud.x @ gravity))

    def __sub__(self, other: Amount) -> Amount:
        return Amount(
            self.volume - other.volume,
            self.momentum - other.momentum,
            self.kinetic - other.kinetic,
            self.potential - other.potential,
        )

    def __add__(self, other: Amount) -> Amount:
        return Amount(
            self.volume + other.volume,
            self.momentum + other.momentum,
            self.kinetic + other.kinetic,
            self.potential + other.potential,
        )


@dataclass
class Budget:
    """Changes summed up by kind since the start, per unit of density.

    lagrangian : the steps of the solver. wall : nodes put back onto an obstacle, momentum given to it.
    resample : nodes added and removed, and the new connectivity. merge : cells between fronts that met, and overlaps.
    separate : thin parts cut away. restore : the volume that merge, separate and wall made, taken back from or given to
    the free surface near by. owed (k, gdim + 1) : places and volumes that could not be given back yet.
    gravity : (gdim,) (m/s2), for the potential energy.
    jolted : set where velocities jumped (nodes caught by an obstacle or let go, fronts joined or cut) and so are not solenoidal.
    The trapezoidal rule would carry the jump on for ever, with its sign alternating from step to step: who steps with
    theta = 1/2 takes one step of theta = 1, and sets it back.
    """

    gravity: Array
    of: dict[str, Amount] = field(default_factory=dict)
    owed: Array = field(default_factory=lambda: np.zeros((0, 3)))
    jolted: bool = False

    def __post_init__(self) -> None:
        self.gravity = np.asarray(self.gravity, float)
        for kind in KINDS:
            self.of.setdefault(kind, Amount(0.0, np.zeros(len(self.gravity)), 0.0, 0.0))

    def book(self, kind: str, change: Amount) -> None:
        """Add a change to those of its kind."""
        self.of[kind] = self.of[kind] + change

    def made(self, volume: float, at: Array) -> Amount:
        """The amount that a volume (m2) of no momentum at a place (gdim,) is."""
        return Amount(volume, np.zeros(len(self.gravity)), 0.0, -volume * float(self.gravity @ at))

    def total(self) -> Amount:
        """All changes since the start."""
        total = self.of[KINDS[0]]
        for kind in KINDS[1:]:
            total = total + self.of[kind]
        return total
