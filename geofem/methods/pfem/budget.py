"""What every kind of change did to the volume, momentum and energy of the bodies."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numba import njit

from geofem.methods.pfem.cloud import Cloud
from geofem.methods.pfem.tessellation.simplices import volumes
from geofem.scene import Array

KINDS = ("lagrangian", "wall", "resample", "merge", "separate", "restore", "inflow", "outflow")
OPEN = ("inflow", "outflow")
"""Kinds that are no errors: what came in and left."""


def node_volumes(x: Array, cells: Array) -> Array:
    """The share (n,) that each of the nodes x (n, gdim) has in its cells (m2 or m3)."""
    return shares(volumes(x, cells) / cells.shape[1], cells, np.zeros(len(x)))


def lumped(cloud: Cloud, cells: Array) -> Array:
    """Volume (n,) of each node: its share of its cells, or what it carries when it flies."""
    return node_volumes(cloud.x, cells) + cloud.carried


@njit(cache=True, error_model="numpy")
def shares(part, cells, total):  # type: ignore[no-untyped-def]
    for c in range(len(cells)):
        for i in cells[c]:
            total[i] += part[c]
    return total


@njit(cache=True, error_model="numpy")
def half_square(v, cells, volume):  # type: ignore[no-untyped-def]
    """Integral of v.v / 2 over cells (m, gdim + 1) of these volumes (m,), exact for v (n, gdim) linear in each."""
    corners, total = cells.shape[1], 0.0
    for c in range(len(cells)):
        for d in range(v.shape[1]):
            first, second = 0.0, 0.0
            for i in cells[c]:
                first += v[i, d]
                second += v[i, d] ** 2
            total += volume[c] * (first * first + second)
    return 0.5 * total / (corners * (corners + 1))


@dataclass(frozen=True)
class Amount:
    """Integrals over the bodies and all that flies, per unit of density.

    volume (m2 or m3), momentum (gdim,) = int v, kinetic = int v.v/2, potential = -int g.x.
    """

    volume: float
    momentum: Array
    kinetic: float
    potential: float

    @classmethod
    def of(cls, cloud: Cloud, cells: Array, gravity: Array) -> Amount:
        """What there is now; gravity (gdim,) (m/s2)."""
        volume = volumes(cloud.x, cells)
        m = shares(volume / cells.shape[1], cells, cloud.carried.copy())
        # Sums rather than products of matrices, which BLAS would share out among threads.
        momentum = (m[:, None] * cloud.v).sum(axis=0)
        flying = 0.5 * float((cloud.carried * (cloud.v**2).sum(axis=1)).sum())
        kinetic = half_square(cloud.v, cells, volume) + flying
        return cls(float(m.sum()), momentum, kinetic, -float((m * (cloud.x * gravity).sum(axis=1)).sum()))

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
    the free surface near by. inflow, outflow : what came in through inlets and left
    through outlets. owed (k, gdim + 1) : places and volumes that could not be given back yet.
    gravity : (gdim,) (m/s2), for the potential energy.
    now : what there was when the books were last kept; every change that is booked is one since then.
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
        self.owed = self.owed if len(self.owed) else np.zeros((0, len(self.gravity) + 1))
        self.now = nothing = Amount(0.0, np.zeros(len(self.gravity)), 0.0, 0.0)
        for kind in KINDS:
            self.of.setdefault(kind, nothing)

    def look(self, cloud: Cloud, cells: Array) -> Amount:
        """Take what there is now; returns the change since it was last done."""
        before, self.now = self.now, Amount.of(cloud, cells, self.gravity)
        return self.now - before

    def book(self, kind: str, change: Amount) -> None:
        """Add a change to those of its kind."""
        self.of[kind] = self.of[kind] + change

    def made(self, volume: float, at: Array) -> Amount:
        """The amount that a volume (m2) of no momentum at a place (gdim,) is."""
        return Amount(volume, np.zeros(len(self.gravity)), 0.0, -volume * float(self.gravity @ at))

    def passed(self) -> Amount:
        """What came in less what left."""
        return self.of["inflow"] + self.of["outflow"]

    def total(self) -> Amount:
        """All changes since the start."""
        total = self.of[KINDS[0]]
        for kind in KINDS[1:]:
            total = total + self.of[kind]
        return total
