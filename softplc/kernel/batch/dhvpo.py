"""The discrete hybrid Van der Pol oscillator on arrays: `kernel.reference.dhvpo`, one row for each oscillator."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Numbers = NDArray[Any]  # float64[n]


class DhvpoBatch:
    """n oscillators of (12). All parameters above zero, arrays[n]."""

    def __init__(self, *, alpha: ArrayLike, mu: ArrayLike, rho: ArrayLike, kappa: ArrayLike) -> None:
        self.alpha: Numbers = np.array(alpha, np.float64)
        self.mu: Numbers = np.array(mu, np.float64)
        self.rho: Numbers = np.array(rho, np.float64)
        self.kappa: Numbers = np.array(kappa, np.float64)

    def f(self, x1: Numbers, x2: Numbers, dt: Numbers) -> tuple[Numbers, Numbers]:
        """Explicit Euler, (13)."""
        mu2 = self.mu * self.mu
        acceleration = -self.alpha * ((x1 * x1 + x2 * x2 / mu2) - self.rho * self.rho) * x2 - mu2 * x1
        return (x1 + x2 * dt, x2 + acceleration * dt)

    def jacobian(self, x1: Numbers, x2: Numbers, dt: Numbers) -> tuple[Any, Any, Any, Any]:
        """(27)."""
        mu2 = self.mu * self.mu
        a10 = (-2.0 * self.alpha * x1 * x2 - mu2) * dt
        a11 = (
            1.0
            + (-self.alpha * (x1 * x1) - 3.0 * self.alpha * (x2 * x2) / mu2 + self.alpha * (self.rho * self.rho)) * dt
        )
        return (1.0, dt, a10, a11)

    def surface(self, x1: Numbers) -> tuple[Any, Any]:
        """The surface is at 0, the oscillator above it."""
        return 0.0, 1.0
