"""The generalised-alpha method for second-order systems (Chung and Hulbert 1993, J. Appl. Mech. 60, 371-375)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geofem.mistake import Mistake


@dataclass(frozen=True)
class GeneralisedAlpha:
    """Second-order accurate, unconditionally stable for linear systems, with high-frequency damping set by one number.

    rho_inf : spectral radius at infinite frequency, 0 to 1; 1 is the trapezoidal rule, which keeps the energy of a linear system.
    """

    rho_inf: float = 1.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.rho_inf <= 1.0:
            raise Mistake(f"knob rho_inf = {self.rho_inf:g}: the spectral radius lies between 0 and 1")

    @property
    def alpha_m(self) -> float:
        return (2.0 * self.rho_inf - 1.0) / (self.rho_inf + 1.0)

    @property
    def alpha_f(self) -> float:
        return self.rho_inf / (self.rho_inf + 1.0)

    @property
    def gamma(self) -> float:
        return 0.5 - self.alpha_m + self.alpha_f

    @property
    def beta(self) -> float:
        return 0.25 * (1.0 - self.alpha_m + self.alpha_f) ** 2

    def acceleration(self, du: np.ndarray, v: np.ndarray, a: np.ndarray, dt: float) -> np.ndarray:
        """Acceleration at the end of the step that the displacement increment du implies (their eq. 14)."""
        return (du - dt * v) / (self.beta * dt * dt) - (0.5 / self.beta - 1.0) * a

    def velocity(self, v: np.ndarray, a: np.ndarray, a_new: np.ndarray, dt: float) -> np.ndarray:
        """Velocity at the end of the step (their eq. 15)."""
        return v + dt * ((1.0 - self.gamma) * a + self.gamma * a_new)

    def mass_factor(self, dt: float) -> float:
        """Weight of the mass matrix in the tangent."""
        return (1.0 - self.alpha_m) / (self.beta * dt * dt)
