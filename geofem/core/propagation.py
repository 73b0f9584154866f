"""Cracks that grow step by step, whatever the method that solves for their intensity factors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from geofem.core import growth
from geofem.mistake import Breakdown, Mistake
from geofem.scene import Array, Growth, Probe

PROBED = ("KI", "KII", "tip", "load", "cycles")
"""The quantities of probes that cracks know, whatever the method."""
REACH = 1.5
"""Where the next boundary or crack is nearer than this many steps, a tip breaks through to it at once."""
SHORT = 0.1
"""A tip that goes less than this part of the fastest one's way goes straight on: no kinks closer than a mesh can tell."""


class End(NamedTuple):
    """A tip: its crack, whether it is its last point (else its first), its place (2,) m and unit vector ahead (2,)."""

    crack: int
    last: bool
    at: Array
    axis: Array


class Peak(NamedTuple):
    """Where the tension is largest: its value (Pa), place (2,) m and direction (2,), and the outward normal (2,) if on the boundary."""

    stress: float
    at: Array
    direction: Array
    normal: Array | None


class Cracks(Protocol):
    """What a model offers whose cracks can grow. All is collective, and the same on every rank."""

    def paths(self) -> list[Array]:
        """The cracks, polylines (n, 2) m."""

    def ends(self) -> list[End]:
        """Their tips; an end on the boundary or on another crack is none."""

    def factors(self) -> tuple[Array, Array]:
        """K_I and K_II (tips, 2), Pa sqrt(m), and the energy release rate J (tips,), J/m2, in the order of ``ends``."""

    def recut(self, paths: list[Array]) -> None:
        """Put cracks in the place of the present ones, and balance the load anew.

        Raises ``Breakdown`` and leaves the present ones if that fails.
        """

    def walls(self) -> Array:
        """The edges of the boundary (n, 2, 2), m."""

    def peak(self, away: float) -> Peak | None:
        """The largest tension farther than ``away`` (m) from all cracks; None if there is no such place."""


@dataclass(frozen=True)
class Step:
    """Cracks on their way, and where they go next.

    advance : way of the fastest tip so far (m). K : (tips, 2) K_I and K_II, Pa sqrt(m). G : (tips,) energy release rate by the
    J integral (J/m2). tips : (tips, 2) m. angles : (tips,) to their axes, at which they will go on (radian). path : the cracks,
    polylines (n, 2) m. energy : ``kinetic``, ``internal``, ``external`` (J). load : factor on the loads at which the most loaded
    tip moves (or a new crack opens), 1 without ``toughness``. cycles : of the load so far, 0 without ``paris``.
    """

    advance: float
    K: Array
    G: Array
    tips: Array
    angles: Array
    path: list[Array]
    energy: dict[str, float]
    load: float
    cycles: float
    model: Any

    def snapshot(self) -> dict[str, Any]:
        """The deformed body, see ``geofem.methods.Model.snapshot``; pictures draw it. Collective.

        Raises ``Mistake`` if the cracks have gone on.
        """
        if self.model.t != self.advance:
            raise Mistake(f"the cracks have gone on to {self.model.t:g} m: draw a step before you ask for the next")
        return self.model.snapshot()


class Propagation:
    """The law of growth at work on a model.

    cycles : of load so far.
    """

    def __init__(self, law: Growth, cracks: Cracks):
        self.law, self.cracks, self.cycles = law, cracks, 0.0
        self._first = cracks.ends()

    def probe(self, probe: Probe) -> float:
        """The sampled number of a probe, one of ``PROBED``. Collective."""
        if probe.quantity == "load":
            return self.load()
        if probe.quantity == "cycles":
            return self.cycles
        if probe.quantity == "tip":
            started = self._started(probe)
            return float(self.cracks.paths()[started.crack][-1 if started.last else 0, probe.component])
        tip = self.tip(probe)
        return 0.0 if tip is None else float(self.cracks.factors()[0][tip, int(probe.quantity == "KII")])

    def tip(self, probe: Probe) -> int | None:
        """The present number of the tip that started nearest to where the probe is; None if it has stopped. Collective."""
        started = self._started(probe)
        places = [(end.crack, end.last) for end in self.cracks.ends()]
        return places.index((started.crack, started.last)) if (started.crack, started.last) in places else None

    def _started(self, probe: Probe) -> End:
        assert probe.at is not None
        if not self._first:
            raise Mistake(f"probe {probe.name!r}: no crack of the scene ends inside a body; there is no tip")
        return min(self._first, key=lambda end: np.hypot(*(end.at - np.array(probe.at))))

    def kinks(self) -> tuple[Array, Array]:
        """The angle at which each tip would go on (tips,), radian, and its K (tips,), Pa sqrt(m). Collective."""
        found = [growth.kink(self.law.criterion, *K) for K in self.cracks.factors()[0].tolist()]
        angles, K = np.array(found).reshape(-1, 2).T
        return angles, K

    def load(self) -> float:
        """The factor on the loads at which the most loaded tip moves, or a new crack opens before that. Collective."""
        if self.law.toughness is None:
            return 1.0
        K, peak = self.kinks()[1].max(initial=0.0), self._peak()
        opens = self.law.strength / peak.stress if peak is not None and self.law.strength is not None else np.inf
        return min(self.law.toughness / K if K > 0 else np.inf, opens)

    def _peak(self) -> Peak | None:
        """The largest tension where a crack may be born. Collective."""
        peak = self.cracks.peak(self.law.germ) if self.law.germ is not None else None
        return peak if peak is not None and peak.stress > 0 else None

    def step(self, way: float) -> float:
        """Let the fastest tip go that way (m), and return how far it went; a new crack may open before. Collective.

        Raises ``Breakdown``, with the cracks as they were: (arrest) if no tip moves, or one would part the body.
        """
        self._open()
        law, ends = self.law, self.cracks.ends()
        angles, K = self.kinks()
        parts = growth.speeds(law, K)
        if not parts.any():
            raise Breakdown("arrest", at_rest(law, K))
        before = growth.rate(law, K) if law.paris is not None else 1.0
        paths, walls, gone, through = self.cracks.paths(), self.cracks.walls(), 0.0, False
        for tip, angle, part in zip(ends, angles, parts):
            if part > 0.0:
                turn = angle if part >= SHORT else 0.0
                c, s = np.cos(turn), np.sin(turn)
                ahead = np.array([c * tip.axis[0] - s * tip.axis[1], s * tip.axis[0] + c * tip.axis[1]])
                target = tip.at + part * way * ahead
                others = [np.stack([p[:-1], p[1:]], axis=1) for k, p in enumerate(paths) if k != tip.crack]
                # its own last segment is no obstacle
                own = paths[tip.crack][:-1] if tip.last else paths[tip.crack][1:]
                others.append(np.stack([own[:-1], own[1:]], axis=1))
                way_out = reached(tip.at, target, np.concatenate([walls, *others]))
                through |= way_out is not target
                target = way_out
                gone = max(gone, float(np.hypot(*(target - tip.at))))
                paths[tip.crack] = longer(paths[tip.crack], tip, target, replace=part < SHORT)
        try:
            self.cracks.recut(paths)
        except Breakdown as end:
            if not through:
                raise
            raise Breakdown("arrest", f"a crack breaks through, and what it parts is no longer held ({end})") from None
        if law.paris is not None:
            after = growth.rate(law, self.kinks()[1]) or before
            # the geometric mean of the rates at both ends: exact to second order, and for K ~ sqrt(a), m = 4 beyond
            self.cycles += gone / np.sqrt(before * after)
        return way if gone > (1.0 - 1e-9) * way else gone

    def _open(self) -> None:
        """Open a new crack where the tension exceeds the strength. Collective."""
        peak = self._peak()
        if peak is None or self.law.strength is None or peak.stress * self.load() < self.law.strength * (1.0 - 1e-12):
            return
        along = np.array([-peak.direction[1], peak.direction[0]]) * self.law.germ
        paths = self.cracks.paths()
        others = np.concatenate([self.cracks.walls(), *(np.stack([p[:-1], p[1:]], axis=1) for p in paths)])
        if peak.normal is None:
            born = [reached(peak.at, peak.at + side * along, others) for side in (-0.5, 0.5)]
        else:
            inward = -np.sign(along @ peak.normal) * along
            away = peak.at + 1e-6 * inward  # the edge that it starts from is no obstacle
            born = [peak.at, reached(away, peak.at + inward, others)]
        self.cracks.recut([*paths, np.array(born)])

    def now(self, advance: float, energy: dict[str, float], model: Any) -> Step:
        """The present state as a user sees it. Collective."""
        K, G = self.cracks.factors()
        tips = np.array([end.at for end in self.cracks.ends()]).reshape(-1, 2)
        return Step(advance, K, G, tips, self.kinks()[0], self.cracks.paths(), energy, self.load(), self.cycles, model)


def at_rest(law: Growth, K: Array) -> str:
    """Why no tip moves."""
    if not len(K):
        return (
            "no crack has a tip inside the body any more" if law.strength is None else "no tip, and tension below the strength"
        )
    return f"K is at most {K.max():.6g} at all tips, and none moves up to {law.threshold:g}"


def longer(path: Array, end: End, target: Array, replace: bool) -> Array:
    """The polyline with a new end, in the place of its end or after it."""
    if end.last:
        return np.concatenate([path[:-1] if replace else path, target[None]])
    return np.concatenate([target[None], path[1:] if replace else path])


def reached(start: Array, target: Array, edges: Array) -> Array:
    """The target (2,) of a tip, or the first place on the way there, and a little beyond, on one of the edges (n, 2, 2)."""
    way, along = REACH * (target - start), edges[:, 1] - edges[:, 0]
    to = edges[:, 0] - start
    det = way[0] * along[:, 1] - way[1] * along[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (to[:, 0] * along[:, 1] - to[:, 1] * along[:, 0]) / det
        s = (to[:, 0] * way[1] - to[:, 1] * way[0]) / det
    met = np.flatnonzero((det != 0.0) & (t > 0.0) & (t <= 1.0) & (s >= -1e-9) & (s <= 1.0 + 1e-9))
    if not len(met):
        return target
    first = met[t[met].argmin()]
    return edges[first, 0] + s[first] * along[first]
