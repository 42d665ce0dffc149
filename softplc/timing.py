"""The time grid of a task, the record of one scan, and the task's statistics: pure, no clock."""

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np


@dataclass(frozen=True, slots=True)
class Scan:
    """One scan of one task. Times in seconds on the monotonic clock; `timestamp` is ns UTC.

    `dt` is measured start to start; in a task's first scan it is the period. `overruns` counts the slots
    missed since start.
    """

    number: int
    start: float
    timestamp: int
    dt: float
    period: float
    overruns: int

    @property
    def jitter(self) -> float:
        """Deviation of the measured interval from the period, seconds."""
        return self.dt - self.period


def next_deadline(start: float, period: float, now: float) -> tuple[float, int]:
    """Next slot on the grid start + k·period after now, and its number k."""
    slot = math.floor((now - start) / period) + 1
    deadline = start + slot * period
    if deadline <= now:  # rounding put the slot at or before now
        slot += 1
        deadline = start + slot * period
    return deadline, slot


class Percentiles(NamedTuple):
    """Summary of a window of durations, in seconds; `max` is over all time."""

    p50: float
    p95: float
    p99: float
    max: float


class Window:
    """The last n durations in a ring, with percentiles on demand."""

    def __init__(self, size: int = 1024) -> None:
        self._ring = np.zeros(size)
        self._count = 0
        self._max = 0.0

    def add(self, seconds: float) -> None:
        """Record one duration."""
        self._ring[self._count % len(self._ring)] = seconds
        self._count += 1
        self._max = max(self._max, seconds)

    def percentiles(self) -> Percentiles:
        """Percentiles of what the ring holds; zeros before the first duration."""
        if not self._count:
            return Percentiles(0.0, 0.0, 0.0, 0.0)
        held = self._ring[: min(self._count, len(self._ring))]
        p50, p95, p99 = np.percentile(held, (50, 95, 99))
        return Percentiles(float(p50), float(p95), float(p99), self._max)


class TaskStatistics:
    """Measured Δt, jitter (absolute) and execution time of one task, and its overruns."""

    def __init__(self, window: int = 1024) -> None:
        self.dt = Window(window)
        self.jitter = Window(window)
        self.execution = Window(window)
        self.scans = 0
        self.overruns = 0

    def add(self, scan: Scan, execution: float) -> None:
        """Record one finished scan."""
        if scan.number:  # the first scan has no interval to measure
            self.dt.add(scan.dt)
            self.jitter.add(abs(scan.jitter))
        self.execution.add(execution)
        self.scans += 1
        self.overruns = scan.overruns


class Deadlines:
    """Whether a task keeps up with its grid, from the last hundred slots.

    It is overloaded from five missed slots on, and keeps up again when one is left at the most.
    """

    def __init__(self, slots: int = 100, most: int = 5, few: int = 1) -> None:
        self.overloaded = False
        self._missed: deque[bool] = deque(maxlen=slots)
        self._slots, self._most, self._few = slots, most, few
        self._count = 0

    def add(self, missed: int) -> None:
        """A scan is complete, and so many slots went by before the next."""
        if missed == 0 and self._count == 0:
            return
        self._missed.extend([True] * min(missed, self._slots) + [False])
        self._count = sum(self._missed)
        self.overloaded = self._count > (self._few if self.overloaded else self._most - 1)
