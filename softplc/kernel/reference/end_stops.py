"""An axis of constant velocity between end stops: the model that machines need.

| letter | meaning | variable | tag | unit |
|---|---|---|---|---|
| x(1), x(2) | position, velocity | x1, x2 | Position, Velocity | u, u/s |
| κ | restitution: 0 stops dead, 1 loses nothing | kappa | Restitution | 1 |
| | the stops, infinite where there is none | lower, upper | LowerStop, UpperStop | u |
"""

import math
from dataclasses import dataclass

from softplc.kernel.reference.covariance import Matrix
from softplc.kernel.reference.ducekf import Vector


@dataclass(frozen=True, slots=True)
class EndStops:
    """x⁺ = (x1 + x2·Δt, x2) between `lower` and `upper`."""

    kappa: float
    lower: float = -math.inf
    upper: float = math.inf

    def f(self, x1: float, x2: float, dt: float) -> Vector:
        """Constant velocity."""
        return (x1 + x2 * dt, x2)

    def jacobian(self, x1: float, x2: float, dt: float) -> Matrix:
        """The same everywhere: [[1, Δt], [0, 1]]."""
        return (1.0, dt, 0.0, 1.0)

    def surface(self, x1: float) -> tuple[float, float]:
        """The nearer stop and its side: +1 the lower, −1 the upper."""
        if x1 - self.lower <= self.upper - x1:
            return self.lower, 1.0
        return self.upper, -1.0
