"""The exact field of a straight crack in an infinite body under pressure or tension, as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geofem.scene import Array, Box

POINTS = 400
"""Norms are sums over so many points along each side of a box: 1e-4 is plenty for what errors are divided by."""


@dataclass(frozen=True)
class PressurisedCrack:
    """A crack of half length 1 at the origin under a unit pressure in plane strain (Westergaard 1939; Sneddon 1946).

    With Z = z / sqrt(z^2 - 1) - 1 and Y = sqrt(z^2 - 1) - z, its integral, in the frame of the crack,
    2 mu u = (1 - 2 nu) Re Y - y Im Z and 2 mu v = 2 (1 - nu) Im Y - y Re Z.

    angle : of the crack to x (radian). mu : shear modulus (Pa). nu : Poisson's ratio. tension : uniform stress across the crack
    that is added (Pa); with 1, the faces are free.
    """

    angle: float
    mu: float
    nu: float
    tension: float

    @property
    def rotation(self) -> Array:
        c, s = np.cos(self.angle), np.sin(self.angle)
        return np.array([[c, -s], [s, c]])

    @property
    def uniform(self) -> Array:
        """Displacement gradient (2, 2) of the tension, in the frame of the crack."""
        return self.tension / (2.0 * self.mu) * np.diag([-self.nu, 1.0 - self.nu])

    def displacement(self, x: Array) -> Array:
        """Displacement (2, n) of the points x (2, n), m."""
        local = self.rotation.T @ x
        z = local[0] + 1j * local[1]
        root = np.sqrt(z - 1.0) * np.sqrt(z + 1.0)
        Y, Z = root - z, z / root - 1.0
        u = np.array([(1 - 2 * self.nu) * Y.real - z.imag * Z.imag, 2 * (1 - self.nu) * Y.imag - z.imag * Z.real])
        return self.rotation @ (u / (2.0 * self.mu) + self.uniform @ local)

    def gradient(self, x: Array) -> Array:
        """Displacement gradient (2, 2, n) at the points x (2, n)."""
        local = self.rotation.T @ x
        z = local[0] + 1j * local[1]
        y, root = z.imag, np.sqrt(z - 1.0) * np.sqrt(z + 1.0)
        Z, slope = z / root - 1.0, -1.0 / root**3
        k, m = 1 - 2 * self.nu, 2 * (1 - self.nu)
        g = np.array(
            [
                [k * Z.real - y * slope.imag, -k * Z.imag - Z.imag - y * slope.real],
                [m * Z.imag - y * slope.real, m * Z.real - Z.real + y * slope.imag],
            ]
        )
        g = g / (2.0 * self.mu) + self.uniform[:, :, None]
        return np.einsum("ia,abn,jb->ijn", self.rotation, g, self.rotation)

    def opening(self, x: Array) -> Array:
        """Opening (n,) of the crack at points x (2, n) of it, m."""
        along = self.rotation[:, 0] @ x
        return 2.0 * (1.0 - self.nu) / self.mu * np.sqrt(np.maximum(1.0 - along**2, 0.0))

    def norms(self, box: Box) -> tuple[float, float, float]:
        """The square root of the strain energy in a box (J per metre), and the root mean squares of |u| over it and of the
        opening along the crack (m)."""
        middles = (np.arange(POINTS) + 0.5) / POINTS
        (x0, y0), (x1, y1) = box.low, box.high
        x, y = x0 + middles * (x1 - x0), y0 + middles * (y1 - y0)
        square = (self.displacement(np.stack(np.meshgrid(x, y)).reshape(2, -1)) ** 2).sum(axis=0).mean()
        # the energy is half the work on the boundary and on the faces
        work = (1.0 - self.tension) * np.pi * (1.0 - self.nu) / self.mu
        lam = 2.0 * self.mu * self.nu / (1.0 - 2.0 * self.nu)
        for i, along, ends, step in ((0, y, (x0, x1), (y1 - y0) / POINTS), (1, x, (y0, y1), (x1 - x0) / POINTS)):
            for end, sign in zip(ends, (-1.0, 1.0)):
                at = np.stack([np.full(POINTS, end), along] if i == 0 else [along, np.full(POINTS, end)])
                g = self.gradient(at)
                stress = self.mu * (g + g.transpose(1, 0, 2))[:, i]
                stress[i] += lam * (g[0, 0] + g[1, 1])
                work += sign * step * float((stress * self.displacement(at)).sum())
        return float((0.5 * work) ** 0.5), float(square**0.5), float(2.0 * (1.0 - self.nu) / self.mu * (2.0 / 3.0) ** 0.5)
