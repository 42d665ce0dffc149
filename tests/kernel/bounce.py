"""A body between two stops, exact to rounding: what is true, sampled scan by scan."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Truth:
    """Arrays[scans]: position, velocity, whether an impact happened since the last scan."""

    x: NDArray[np.float64]
    v: NDArray[np.float64]
    contact: NDArray[np.bool_]

    @property
    def impacts(self) -> list[int]:
        return np.flatnonzero(self.contact).tolist()


def bounce(
    scans: int,
    dt: float,
    *,
    kappa: float,
    lower: float = 0.0,
    upper: float = math.inf,
    x: float = 1.0,
    v: float = -1.0,
) -> Truth:
    """Constant velocity between the stops, v → −κv at each; at most one impact in a scan is asked for."""
    positions, velocities, contacts = [], [], []
    for _ in range(scans):
        x, touched = x + v * dt, False
        for limit, beyond in ((lower, x < lower), (upper, x > upper)):
            if beyond:
                x, v, touched = limit - kappa * (x - limit), -kappa * v, True
        positions.append(x)
        velocities.append(v)
        contacts.append(touched)
    return Truth(np.array(positions), np.array(velocities), np.array(contacts))
