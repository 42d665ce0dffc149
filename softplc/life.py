"""Proof of life beyond the connection: a program's heartbeat, timestamps that move, a source's clock beside ours.

A server may answer for ever while the PLC's program stands still. A heartbeat is a tag that the program changes for
as long as it runs: what it is changed to does not matter, so it may count, roll over, or toggle. Stamps are the
source timestamps of a source that stamps every sample, changed or not.

Only time between answers counts, and of a pause between two answers no more than half the limit: an outage, or a scan
that came late, says nothing about the program. What stood still before an outage stands still after it, until it
moves. Pure: no clock, no I/O; times in monotonic seconds, `utc` in ns.
"""

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from softplc.sample import Reason, StatusCode, is_bad
from softplc.tags import NO_TIMESTAMP, Image

LOST_AFTER: Final = 3.0
"""Times the limit after which the samples are Bad."""
AHEAD: Final = 1.0
"""Seconds that a source timestamp may be ahead of our clock before it is worth a word."""
_MOST_OF_A_PAUSE: Final = 0.5  # of the limit
_BAD: Final = np.uint32(StatusCode.BAD)
_EARLIEST: Final = np.iinfo(np.int64).min


class Heartbeat:
    """The tag at a position of the readings, which has to change within `timeout` seconds."""

    def __init__(self, position: int, timeout: float) -> None:
        self.position = position
        self._timeout = timeout
        self._value = math.nan
        self._looked = math.nan
        self._still = 0.0

    @property
    def stopped(self) -> bool:
        """It stood still for the timeout."""
        return self._still >= self._timeout

    @property
    def lost(self) -> bool:
        """It stood still for LOST_AFTER times as long."""
        return self._still >= LOST_AFTER * self._timeout

    def look(self, value: float, status: int, now: float) -> None:
        """Take its newest sample. A Bad one and NaN are no change, nor is the first value after them."""
        if not math.isnan(self._looked):
            self._still += min(now - self._looked, _MOST_OF_A_PAUSE * self._timeout)
        self._looked = now
        if is_bad(status) or math.isnan(value) or value == self._value:
            return
        if not math.isnan(self._value):
            self._still = 0.0
        self._value = value

    def pause(self) -> None:
        """The link is down: time does not count until the next sample."""
        self._looked = math.nan


class Stamps:
    """Source timestamps of `n` readings; `limits` are seconds that one may stand still, by position.

    `skew` is the newest timestamp that moved minus our own time when its sample arrived, in seconds, not smoothed:
    the age of the sample and its way are in it. NaN before the first. `backwards` is the position and the seconds by
    which a timestamp of the last look went back, None where none did.
    """

    def __init__(self, n: int, limits: Mapping[int, float]) -> None:
        self.skew = math.nan
        self.backwards: tuple[int, float] | None = None
        self._last: NDArray[np.int64] = np.full(n, NO_TIMESTAMP, np.int64)
        self._where = np.array(sorted(limits), np.intp)
        self._limits = np.array([limits[position] for position in sorted(limits)])
        self._still = np.zeros(len(limits))
        self._looked = math.nan

    @property
    def ahead(self) -> bool:
        """The source's clock is ahead of ours by more than AHEAD."""
        return self.skew > AHEAD

    def look(self, samples: Image, now: float, utc: int) -> None:
        """Take the newest samples."""
        stamps = samples.source_timestamps
        moved = stamps != self._last
        if len(self._where):
            if not math.isnan(self._looked):
                self._still += np.minimum(now - self._looked, _MOST_OF_A_PAUSE * self._limits)
            self._looked = now
            self._still[moved[self._where]] = 0.0
        self.backwards = None
        if moved.any():
            self._compare(samples, moved, now, utc)
            np.copyto(self._last, stamps)

    def frozen(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Positions whose timestamp stood still for its limit, and for LOST_AFTER times as long."""
        still, limits = self._still, self._limits
        return self._where[still >= limits], self._where[still >= LOST_AFTER * limits]

    def pause(self) -> None:
        """The link is down: time does not count until the next samples."""
        self._looked = math.nan

    def _compare(self, samples: Image, moved: NDArray[np.bool_], now: float, utc: int) -> None:
        stamps, last = samples.source_timestamps, self._last
        fresh = moved & (samples.statuses < _BAD) & (stamps != NO_TIMESTAMP)
        if not fresh.any():
            return
        newest = int(np.where(fresh, stamps, _EARLIEST).argmax())
        arrived = utc - round((now - float(samples.arrivals[newest])) * 1e9)
        self.skew = (int(stamps[newest]) - arrived) / 1e9
        back = fresh & (stamps < last) & (last != NO_TIMESTAMP)
        if back.any():
            position = int(back.argmax())
            self.backwards = position, (int(last[position]) - int(stamps[position])) / 1e9


class Life:
    """What is known of one source; either part may be missing."""

    def __init__(self, heartbeat: Heartbeat | None = None, stamps: Stamps | None = None) -> None:
        self.heartbeat, self.stamps = heartbeat, stamps

    def look(self, samples: Image, now: float, utc: int) -> None:
        """Take the newest samples of the source."""
        if self.heartbeat is not None:
            position = self.heartbeat.position
            self.heartbeat.look(float(samples.values[position]), int(samples.statuses[position]), now)
        if self.stamps is not None:
            self.stamps.look(samples, now, utc)

    def pause(self) -> None:
        """The link is down."""
        for part in (self.heartbeat, self.stamps):
            if part is not None:
                part.pause()

    def lower(self, inputs: Image, start: int, stop: int, answered: bool) -> None:
        """Give latched samples `start` to `stop` the status and the cause that they deserve.

        Samples that are left from an earlier scan, because nothing was answered in this one, have a cause already.
        """
        stamps, heartbeat = self.stamps, self.heartbeat
        if stamps is not None:
            frozen, lost = stamps.frozen()
            _lower(inputs, start + (frozen if answered else lost), start + lost, Reason.STAMP_FROZEN)
        if heartbeat is not None and heartbeat.stopped:
            every = np.arange(start, stop)
            lost = every if heartbeat.lost else every[:0]
            _lower(inputs, every if answered else lost, lost, Reason.PROGRAM_STOPPED)

    def tags(self, connected: bool) -> tuple[float, ...]:
        """What is published after a source's other tags: Heartbeat and Skew, as far as they are there."""
        told: tuple[float, ...] = ()
        if self.heartbeat is not None:
            told += (float(connected and not self.heartbeat.stopped),)
        return told if self.stamps is None else (*told, self.stamps.skew)


def _lower(inputs: Image, doubtful: NDArray[np.intp], lost: NDArray[np.intp], cause: Reason) -> None:
    """Good becomes Uncertain, what is Uncertain stays what it was; what is lost becomes Bad; Bad stays."""
    statuses = inputs.statuses
    known = doubtful[statuses[doubtful] < _BAD]
    inputs.causes[known] = cause
    good = known[statuses[known] < np.uint32(StatusCode.UNCERTAIN)]
    statuses[good] = StatusCode.UNCERTAIN_LAST_USABLE_VALUE
    gone = lost[statuses[lost] < _BAD]
    statuses[gone] = StatusCode.BAD_OUT_OF_SERVICE
    inputs.values[gone] = np.nan
