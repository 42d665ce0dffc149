"""The axis between end stops on arrays: `kernel.reference.end_stops`, one row for each axis."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Numbers = NDArray[Any]  # float64[n]


class EndStopsBatch:
    """n axes of constant velocity; `lower` and `upper` are infinite where there is no stop. Arrays[n]."""

    def __init__(self, *, kappa: ArrayLike, lower: ArrayLike, upper: ArrayLike) -> None:
        self.kappa: Numbers = np.array(kappa, np.float64)
        self.lower: Numbers = np.array(lower, np.float64)
        self.upper: Numbers = np.array(upper, np.float64)

    def f(self, x1: Numbers, x2: Numbers, dt: Numbers) -> tuple[Numbers, Numbers]:
        """Constant velocity."""
        return (x1 + x2 * dt, x2)

    def jacobian(self, x1: Numbers, x2: Numbers, dt: Numbers) -> tuple[Any, Any, Any, Any]:
        """[[1, Δt], [0, 1]]."""
        return (1.0, dt, 0.0, 1.0)

    def surface(self, x1: Numbers) -> tuple[Numbers, Numbers]:
        """The nearer stop and its side: +1 the lower, −1 the upper."""
        lower = x1 - self.lower <= self.upper - x1
        return np.where(lower, self.lower, self.upper), np.where(lower, 1.0, -1.0)
