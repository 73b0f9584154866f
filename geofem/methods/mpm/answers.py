"""What a run asks of material points: balances, probes and the picture of the bodies."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from mpi4py import MPI

from geofem.core.sampling import quantile
from geofem.methods.mpm import grid as g
from geofem.methods.mpm.contact import Contact
from geofem.methods.mpm.kind import Kind
from geofem.methods.mpm.points import Body, weights_around
from geofem.methods.mpm.seed import Seeds
from geofem.methods.mpm.shapes import SHAPES
from geofem.scene import Array, Probe, Scene


class Balance:
    """Energies (J) and momentum (N s) of all ranks' points, carried along step by step.

    Velocities belong to the middle of a step, places and stresses to its end (with update stress first to its beginning). spent : the
    work of the stresses was summed up; else all laws tell their stored energy.
    """

    def __init__(self, bodies: list[Body], mass: float, spent: bool, stress_first: bool):
        self.mass, self.spent, self.stress_first = mass, spent, stress_first
        self.kept = slice(1, 3) if bodies[0].kind.axial else slice(0, 3)  # a radial momentum is changed by the hoop stress
        v = np.concatenate([body.own("v") for body in bodies])
        m = np.concatenate([body.own("mass") for body in bodies])
        self.kinetic = self.start = float(0.5 * m @ np.sum(v**2, axis=1))
        self.momentum = np.zeros(3)
        self.momentum[: v.shape[1]] = m @ v
        self.internal = self.external = 0.0
        self.last = np.array([self.kinetic, 0.0, 0.0])
        """Kinetic energy before the last step, work of the stresses and of the loads in it."""
        self.largest_kinetic, self.largest_work = self.kinetic, 0.0
        self.impulse = np.zeros(3)
        self.volume = sum(float(body.own("volume").sum()) for body in bodies)

    def add(self, sums: Array) -> None:
        """Carry on by the sums of one step."""
        self.last[:] = self.kinetic, sums[g.STRAIN_WORK], sums[g.WORK]
        self.kinetic = float(sums[g.KINETIC])
        self.internal += float(sums[g.STRAIN_WORK])
        self.external += float(sums[g.WORK])
        self.impulse += sums[g.IMPULSE : g.IMPULSE + 3]
        self.largest_kinetic = max(self.largest_kinetic, self.kinetic)
        self.largest_work = max(self.largest_work, abs(self.external))

    def stored(self, bodies: list[Body], comm: MPI.Intracomm) -> float:
        """The energy stored in elastic bodies at the end of the step (J). Collective."""
        own = 0.0
        for body in bodies:
            assert body.law.energy is not None
            own += float(body.own("volume") @ body.law.energy(body.own("F"), body.par)) if body.n else 0.0
        return float(comm.allreduce(own))

    def energy(self, stored: float | None = None, strain_work: float | None = None) -> dict[str, float]:
        """The three at one instant, so that their sum drifts by dt squared and not by dt: the middle of the last step or, with
        update stress first, its beginning. stored : the energy at its end, and strain_work : the work of the stresses in it, where
        these were not summed up (J)."""
        before, done, work = self.last.tolist()
        internal = self.internal if stored is None else stored
        if self.stress_first:
            return {"kinetic": 0.5 * (before + self.kinetic), "internal": internal, "external": self.external - work}
        done = done if strain_work is None else strain_work
        return {"kinetic": self.kinetic, "internal": internal - 0.5 * done, "external": self.external - 0.5 * work}

    @property
    def exploded(self) -> bool:
        """More than twice the energy is there that was ever put in (stored energy apart, which is never negative); nan is not."""
        return self.kinetic + self.internal - self.external - self.start > self.start + self.largest_work

    def checks(self, bodies: list[Body], comm: MPI.Intracomm) -> dict[str, float | None]:
        """See ``Model.checks``. Collective."""
        mass, volume, momentum = 0.0, 0.0, np.zeros(3)
        for body in bodies:
            m, v = body.own("mass"), body.own("v")
            mass += float(m.sum())
            volume += float(body.own("volume") @ body.jacobian())
            momentum[: v.shape[1]] += m @ v
        mass, volume, momentum = comm.allreduce(mass), comm.allreduce(volume), comm.allreduce(momentum)
        scale = math.sqrt(2.0 * self.mass * self.largest_kinetic) or 1.0
        return {
            "mass": abs(mass / self.mass - 1.0),
            "momentum": float(np.linalg.norm((momentum - self.momentum - self.impulse)[self.kept])) / scale,
            "volume": volume / self.volume - 1.0,
        }

    def state(self) -> Array:
        head = [self.kinetic, self.internal, self.external, self.largest_kinetic, self.largest_work]
        return np.array([*head, *self.impulse, *self.last])

    def restore(self, state: Array) -> None:
        self.kinetic, self.internal, self.external, self.largest_kinetic, self.largest_work = state[:5].tolist()
        self.impulse[:], self.last[:] = state[5:8], state[8:]


class Places:
    """Values at material points that a scene's probes ask for, on any number of ranks."""

    def __init__(self, scene: Scene, seeds: list[Seeds], comm: MPI.Intracomm):
        self.comm, self.small = comm, scene.strain == "small"
        self.seeds = seeds
        self.at: dict[tuple[float, ...], tuple[int, Array, Array]] = {}

    def around(self, at: tuple[float, ...]) -> tuple[int, Array, Array]:
        """The body of a reference position, the numbers of the points around it, and their weights."""
        if at not in self.at:
            nearest = [float(np.min(np.linalg.norm(s.points - np.array(at), axis=1))) for s in self.seeds]
            k = int(np.argmin(nearest))
            self.at[at] = (k, *weights_around(self.seeds[k].points, at))
        return self.at[at]

    def probe(self, probe: Probe, bodies: list[Body], t: float) -> float:
        """The value of a probe, but for reactions. Collective."""
        c = probe.component
        if probe.quantity == "mean_velocity":
            sums = sum(np.array([float(b.own("mass") @ b.own("v")[:, c]), float(b.own("mass").sum())]) for b in bodies)
            momentum, mass = self.comm.allreduce(sums)
            return momentum / mass
        if probe.quantity == "largest_speed":
            own = max(float(np.sum(b.own("v") ** 2, axis=1).max(initial=0.0)) for b in bodies)
            return math.sqrt(self.comm.allreduce(own, op=MPI.MAX))
        if probe.quantity == "volume":
            return float(self.comm.allreduce(sum(float(b.own("volume") @ b.jacobian()) for b in bodies)))
        if probe.exact is not None:
            return self._error(probe, bodies, t)
        if probe.quantity == "quantile":
            x = self._all([body.own("x")[:, c] for body in bodies])
            return quantile(x, self._all([body.own("mass") for body in bodies]), probe.share)
        assert probe.at is not None
        k, ids, weights = self.around(probe.at)
        if probe.quantity == "stress" and c >= bodies[k].arrays["tau"].shape[1]:
            return 0.0
        return float(weights @ self._values(bodies[k], ids, probe.quantity, c))

    def _error(self, probe: Probe, bodies: list[Body], t: float) -> float:
        """Root mean square over all points, weighed by volume for pressures and by mass for vectors."""
        assert probe.exact is not None
        sums = np.zeros(2)
        for body in bodies:
            at, weight = body.own("x"), body.own("mass")
            if probe.quantity == "pressure_error":
                found, weight = -body.stress()[:, :3].mean(axis=1)[None], body.own("volume") * body.jacobian()
            elif probe.quantity == "velocity_error":
                found = body.own("v").T
            else:
                found, at = (at - body.own("X")).T, body.own("X")
            sums += weight @ np.sum((found - probe.exact(at.T, t)) ** 2, axis=0), weight.sum()
        square, total = self.comm.allreduce(sums)
        return math.sqrt(square / total)

    def _values(self, body: Body, ids: Array, quantity: str, c: int) -> Array:
        """A field at the points of some numbers."""
        born = body.own("id") % body.born  # of a point that was split, its parts tell the mean
        found = np.flatnonzero(np.isin(born, ids))
        if quantity == "displacement":
            values = body.own("x")[found, c] - body.own("X")[found, c]
        elif quantity == "velocity":
            values = body.own("v")[found, c]
        else:
            values = body.stress()[found, c]
        mass = body.own("mass")[found]
        out = np.zeros((2, len(ids)))
        order = np.argsort(ids)
        np.add.at(out.T, order[np.searchsorted(ids, born[found], sorter=order)], np.column_stack([mass * values, mass]))
        out = self.comm.allreduce(out) if self.comm.size > 1 else out
        return out[0] / out[1]

    def _all(self, parts: list[Array]) -> Array:
        """Values of all bodies on all ranks."""
        own = np.concatenate(parts)
        return np.concatenate(self.comm.allgather(own)) if self.comm.size > 1 else own


def domains(body: Body, kind: Kind, h: float) -> dict[str, Array]:
    """Half edges (n, d d) or corners (n, 8) of the present domains of own points, for pictures."""
    shape, d = SHAPES[kind.shape], body.arrays["X"].shape[1]
    place, F = body.own("domain"), body.own("F")
    if shape.domain == "corners":
        return {"corners": place}
    full = F.reshape(-1, 3, 3) if d == 3 else F[:, :4].reshape(-1, 2, 2)
    if shape.domain == "edges":
        return {"edges": h * np.einsum("nij,naj->nai", full, place.reshape(-1, d, d)).reshape(len(place), d * d)}
    half = h * place * (np.linalg.norm(full, axis=1) if shape.spread else 1.0)
    return {"edges": (half[:, :, None] * np.eye(d)).reshape(len(place), d * d)}


def snapshot(bodies: list[Body], kind: Kind, h: float, contacts: list[Contact], comm: MPI.Intracomm) -> dict[str, Any]:
    """See ``ExplicitMpm.snapshot``. Collective."""
    parts = []
    for k, body in enumerate(bodies):
        x, X = body.own("x"), body.own("X")
        fields = {
            "id": body.own("id"), "x": x, "displacement": x - X, "velocity": body.own("v"), "stress": body.stress(),
            "mass": body.own("mass"), "region": np.full(body.n, k), **domains(body, kind, h),
        }  # fmt: skip
        parts.append({name: np.array(values) for name, values in fields.items()})
    told = comm.gather(parts) if comm.size > 1 else [parts]
    if told is None:
        return {}
    out: dict[str, Any] = {}
    for name in parts[0]:
        out[name] = []
    for k in range(len(bodies)):
        ids = np.concatenate([rank[k]["id"] for rank in told])
        order = np.argsort(ids, kind="stable")
        for name in out:
            out[name].append(np.concatenate([rank[k][name] for rank in told])[order])
    out = {name: np.concatenate(values) for name, values in out.items()}
    del out["id"]
    x = out.pop("x")
    points = np.zeros((len(x), 3))
    points[:, : x.shape[1]] = x
    out |= {"points": points, "cells": np.arange(len(x))[:, None], "cell": "vertex"}
    if contacts:
        gap = np.full((1, 2), np.nan)
        out["rigid"] = np.concatenate([part for contact in contacts for part in (contact.points, contact.points[:1], gap)][:-1])
    return out
