"""The exact near field of a crack tip, as plain arrays: displacement, gradient, and their norms over a box."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geofem.scene import Array, Box, Point


@dataclass(frozen=True)
class TipField:
    """The field of a straight crack with intensity factors KI, KII (Pa sqrt(m)) in plane strain (Williams 1957).

    at : the tip (m). angle : of the axis ahead of it to x (radian). mu : shear modulus (Pa). nu : Poisson's ratio.
    """

    at: Point
    angle: float
    KI: float
    KII: float
    mu: float
    nu: float

    def polar(self, x: Array) -> tuple[Array, Array]:
        """Distance to the tip and angle to the axis, -pi to pi, of the points x (2, n)."""
        dx, dy = x[0] - self.at[0], x[1] - self.at[1]
        c, s = np.cos(self.angle), np.sin(self.angle)
        return np.hypot(dx, dy), np.arctan2(c * dy - s * dx, c * dx + s * dy)

    def shape(self, theta: Array) -> tuple[Array, Array]:
        """What multiplies sqrt(r) in the displacement, (2, n) in the frame of the axis, and its derivative by theta."""
        k = 3.0 - 4.0 * self.nu
        c, s, ch, sh = np.cos(theta), np.sin(theta), np.cos(theta / 2), np.sin(theta / 2)
        scale = 1.0 / (2.0 * self.mu * np.sqrt(2.0 * np.pi))
        f = self.KI * np.array([ch * (k - c), sh * (k - c)])
        f = f + self.KII * np.array([sh * (k + 2 + c), -ch * (k - 2 + c)])
        d = self.KI * np.array([-sh / 2 * (k - c) + ch * s, ch / 2 * (k - c) + sh * s])
        d = d + self.KII * np.array([ch / 2 * (k + 2 + c) - sh * s, sh / 2 * (k - 2 + c) + ch * s])
        return scale * f, scale * d

    @property
    def rotation(self) -> Array:
        c, s = np.cos(self.angle), np.sin(self.angle)
        return np.array([[c, -s], [s, c]])

    def displacement(self, x: Array) -> Array:
        """Displacement (2, n) of the points x (2, n), m."""
        r, theta = self.polar(x)
        return self.rotation @ (np.sqrt(r) * self.shape(theta)[0])

    def gradient(self, x: Array) -> Array:
        """Displacement gradient (2, 2, n) at the points x (2, n)."""
        r, theta = self.polar(x)
        f, d = self.shape(theta)
        c, s = np.cos(theta), np.sin(theta)
        local = np.array([0.5 * f * c - d * s, 0.5 * f * s + d * c]) / np.sqrt(r)
        return np.einsum("ia,ban,jb->ijn", self.rotation, local, self.rotation)

    def norms(self, box: Box) -> tuple[float, float]:
        """The square roots of the strain energy (J per metre) and of the integral of |u|^2 over a box around the tip.

        Energy density goes like 1 / r and |u|^2 like r, so that the integrals along each ray are known.
        """
        (x0, y0), (x1, y1) = box.low, box.high
        corners = [np.arctan2(y - self.at[1], x - self.at[0]) - self.angle for x in (x0, x1) for y in (y0, y1)]
        ends = np.sort([-np.pi, np.pi, *(np.mod(np.array(corners) + np.pi, 2 * np.pi) - np.pi)])
        gauss, weight = np.polynomial.legendre.leggauss(40)
        energy = square = 0.0
        for low, high in zip(ends, ends[1:]):
            theta, w = 0.5 * (low + high) + 0.5 * (high - low) * gauss, 0.5 * (high - low) * weight
            direction = np.array([np.cos(theta + self.angle), np.sin(theta + self.angle)])
            with np.errstate(divide="ignore"):
                reach = np.min(
                    [np.where(d > 0, b - a, l - a) / d for d, a, l, b in zip(direction, self.at, box.low, box.high)], axis=0
                )
            g = self.gradient(np.array(self.at)[:, None] + direction)
            strain = 0.5 * (g + g.transpose(1, 0, 2))
            lam = 2.0 * self.mu * self.nu / (1.0 - 2.0 * self.nu)
            density = self.mu * (strain**2).sum(axis=(0, 1)) + 0.5 * lam * (strain[0, 0] + strain[1, 1]) ** 2
            energy += float(w @ (density * reach))
            square += float(w @ ((self.shape(theta)[0] ** 2).sum(axis=0) * reach**3 / 3.0))
        return energy**0.5, square**0.5
