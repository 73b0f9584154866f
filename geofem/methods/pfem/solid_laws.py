"""What the materials answer on smoothing domains, small or finite strain, by the point kernels of ``geofem.materials``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geofem import materials
from geofem.scene import Array, Scene

ENGINEERING = np.array([[1, 0, 0, 0], [0, 0, 0, 1], [0, 0, 0, 0], [0, 1, 1, 0]], float)
"""Strain (xx, yy, zz, xy) of a gradient (xx, xy, yx, yy)."""


@dataclass
class History:
    """What the material remembers at d domains.

    F : (d, 5) deformation gradient; of laws with a path only its volume, as a stretch that is the same in all directions of the plane.
    state : (d, 4) of the law. region : (d,) whose material.
    """

    F: Array
    state: Array
    region: Array

    @classmethod
    def at_rest(cls, region: Array) -> History:
        F = np.zeros((len(region), 5))
        F[:, [0, 3, 4]] = 1.0
        return cls(F, np.zeros((len(region), 4)), region)

    @property
    def volume(self) -> Array:
        """(d,) det F."""
        return (self.F[:, 0] * self.F[:, 3] - self.F[:, 1] * self.F[:, 2]) * self.F[:, 4]


@dataclass
class Answer:
    """Stresses on the last configuration: P (d, 4) and their derivatives A (d, 4, 4) by the gradient, and the history to be.

    valid : False where a domain has turned inside out.
    """

    P: Array
    A: Array
    F: Array
    state: Array
    valid: bool


class Laws:
    """The materials of a scene's regions."""

    def __init__(self, scene: Scene):
        self.scene = scene
        self.small = scene.strain == "small"
        self.laws = [materials.get(region.material.law) for region in scene.regions]
        self.path = [materials.LAWS[region.material.law].history for region in scene.regions]
        self.weaken(0.0)

    def weaken(self, t: float) -> None:
        """Take the strength of time t."""
        by = self.scene.weakening(t) if self.scene.weakening is not None else 1.0
        self.par = [law.parameters(region.material, by) for law, region in zip(self.laws, self.scene.regions)]

    @property
    def lame(self) -> Array:
        """(regions, 2): Lamé's constants."""
        return np.array([par[:2] for par in self.par])

    @property
    def density(self) -> Array:
        return np.array([region.material.density for region in self.scene.regions])

    def respond(self, history: History, gradient: Array, dt: float) -> Answer:
        """The answer to gradients (d, 4) of the displacement since the last configuration, in a step dt (s)."""
        d = len(gradient)
        out = Answer(np.zeros((d, 4)), np.zeros((d, 4, 4)), history.F.copy(), np.zeros((d, 4)), True)
        for k in range(len(self.laws)):
            which = np.flatnonzero(history.region == k) if len(self.laws) > 1 else slice(None)
            (self._small if self.small else self._finite)(k, which, history, gradient, dt, out)
        return out

    def _small(self, k: int, which: Array | slice, history: History, gradient: Array, dt: float, out: Answer) -> None:
        dstrain = gradient[which] @ ENGINEERING.T
        stress, tangent, new = np.empty_like(dstrain), np.empty((len(dstrain), 4, 4)), np.empty((len(dstrain), 4))
        kernel = self.laws[k].small
        assert kernel is not None
        kernel(dstrain, np.ascontiguousarray(history.state[which]), self.par[k], stress, tangent, new)
        out.P[which] = stress @ ENGINEERING
        out.A[which] = np.einsum("ai,dab,bj->dij", ENGINEERING, tangent, ENGINEERING)
        out.state[which] = new

    def _finite(self, k: int, which: Array | slice, history: History, gradient: Array, dt: float, out: Answer) -> None:
        law, old = self.laws[k], np.ascontiguousarray(history.F[which])
        F = stretched(gradient[which], old)
        size = law.state_size(4)
        state, new = np.ascontiguousarray(history.state[which][:, :size]), np.zeros((len(F), size))
        P, A = np.zeros((len(F), 5)), np.zeros((len(F), 5, 5))
        if law.finite(F, old, state, self.par[k], dt, P, A, new) < 0:
            out.valid = False
            return
        law.push(P, A, old)
        out.P[which], out.A[which] = P[:, :4], A[:, :4, :4]
        out.state[which, :size] = new
        out.F[which] = volume_only(F) if self.path[k] else F

    def elastic(self, region: Array) -> Array:
        """Stiffness (d, 4, 4) of Hooke's law between gradients and stresses."""
        return hooke(self.lame)[region]

    def cauchy(self, history: History) -> Array:
        """Cauchy stress (d, 4): xx, yy, zz, xy, of the state as it is."""
        if self.small:
            return history.state.copy()
        answer = self.respond(history, np.zeros((len(history.F), 4)), 0.0)
        lame = self.lame[history.region]
        plane = 0.5 * lame[:, 0] / (lame[:, 0] + lame[:, 1])
        zz = np.where(np.array(self.path)[history.region], self._across(history), plane * (answer.P[:, 0] + answer.P[:, 3]))
        return np.column_stack([answer.P[:, 0], answer.P[:, 3], zz, answer.P[:, 1]])

    def _across(self, history: History) -> Array:
        """Stress across the plane of laws with a path, from the elastic logarithmic strain."""
        b = 1.0 + history.state[:, :3]
        volume = 0.5 * np.log(np.maximum((b[:, 0] * b[:, 1] - history.state[:, 3] ** 2) * b[:, 2], 1e-300))
        lame = self.lame[history.region]
        return np.where(
            volume < 0, (lame[:, 0] * volume + lame[:, 1] * np.log(np.maximum(b[:, 2], 1e-300))) / history.volume, 0.0
        )

    def energy(self, history: History, volume: Array) -> Array:
        """(d,) stored energy of hyperelastic laws (J/m), nothing for others; volume (d,) as it is now (m2)."""
        out = np.zeros(len(volume))
        for k, law in enumerate(self.laws):
            if law.energy is not None:
                which = history.region == k
                out[which] = volume[which] / history.volume[which] * law.energy(history.F[which], self.par[k])
        return out


def hooke(lame: Array) -> Array:
    """(k, 4, 4) from Lamé's constants (k, 2), for gradients (xx, xy, yx, yy)."""
    identity = np.array([1.0, 0.0, 0.0, 1.0])
    symmetric = np.array([[2.0, 0, 0, 0], [0, 1, 1, 0], [0, 1, 1, 0], [0, 0, 0, 2.0]])
    return lame[:, :1, None] * np.outer(identity, identity) + lame[:, 1:, None] * symmetric


def stretched(gradient: Array, F: Array) -> Array:
    """(I + gradient) F in the plane, (d, 5)."""
    xx, xy, yx, yy = (1.0 + gradient[:, 0]), gradient[:, 1], gradient[:, 2], (1.0 + gradient[:, 3])
    return np.column_stack(
        [
            xx * F[:, 0] + xy * F[:, 2],
            xx * F[:, 1] + xy * F[:, 3],
            yx * F[:, 0] + yy * F[:, 2],
            yx * F[:, 1] + yy * F[:, 3],
            F[:, 4],
        ]
    )


def volume_only(F: Array) -> Array:
    """A stretch that is the same in all directions of the plane, of the same volume as F (d, 5)."""
    out = np.zeros_like(F)
    out[:, 0] = out[:, 3] = np.sqrt(F[:, 0] * F[:, 3] - F[:, 1] * F[:, 2])
    out[:, 4] = F[:, 4]
    return out
