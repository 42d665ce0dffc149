"""The experiment of the AOI paper: a ramp–hold–ramp–hold with evenly spread noise on it, equation (23).

The paper gives the time step and the noise. Slope and durations are ours.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]

DT = 0.05  # s, the paper's
NOISE = 2.0  # u, the paper's: evenly spread over ±2
R = NOISE * NOISE / 3.0  # u², the variance of such noise
SLOPE = 10.0  # u/s
SCANS = 300  # of a segment: 15 s


@dataclass(frozen=True, slots=True)
class Waveform:
    """The truth and what was measured of it, one entry for each scan: t in s, position and measured in u."""

    t: Numbers
    position: Numbers
    velocity: Numbers
    measured: Numbers


def ramp_hold(seed: int) -> Waveform:
    """Four segments of 300 scans, at 10 u/s and at rest in turns; the noise is that of numpy's default_rng(seed)."""
    scan = np.arange(4 * SCANS)
    velocity = np.where(scan // SCANS % 2 == 0, SLOPE, 0.0)
    position = np.cumsum(velocity * DT)
    noise = np.random.default_rng(seed).uniform(-NOISE, NOISE, len(scan))
    return Waveform(position=position, velocity=velocity, measured=position + noise, t=np.asarray((scan + 1) * DT))


def settled(segment: int) -> slice:
    """The scans of the second half of segment 0…3, when the transient is over."""
    return slice(segment * SCANS + SCANS // 2, (segment + 1) * SCANS)


def whole(segment: int) -> slice:
    """All scans of segment 0…3."""
    return slice(segment * SCANS, (segment + 1) * SCANS)


def both(first: int, second: int) -> NDArray[np.intp]:
    """The scans of the second halves of two segments: 0 and 2 are the ramps, 1 and 3 the holds."""
    scans = np.arange(4 * SCANS)
    return np.concatenate([scans[settled(first)], scans[settled(second)]])
