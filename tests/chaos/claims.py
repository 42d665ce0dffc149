"""What the rows of the chaos suite measure and hold against limits, in one size or another."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.chaos.rig import KINDS, PERIOD, Rig

DETECTED = 0.25  # seconds, and not less than two scans: by then a source that is gone is not Good any more
BACK = 1.0  # seconds: 99 of 100 sources that are back are Good by then
REPORTED = 2 * PERIOD  # sampling and publishing of a subscription
UNREPORTED = 0.5  # seconds: silence, two looks at the values and a report's time in between
LATE = 1.2  # seconds that the short form allows instead, and STARVED times the longest gap between two scans
STARVED = 4.0  # what keeps our scans from running keeps the PLCs from it too, and their reports are late for it


@dataclass(frozen=True)
class Size:
    """How much of each fault; `strict`: hold times against their limits."""

    strict: bool
    resets: int
    outages: tuple[float, ...]
    repeats: int

    @property
    def detected(self) -> float:
        return DETECTED if self.strict else LATE


SHORT = Size(strict=False, resets=4, outages=(0.7,), repeats=1)
LONG = Size(strict=True, resets=1000, outages=(1.0, 10.0), repeats=40)


def milliseconds(values: Sequence[float]) -> str:
    """Median, 99th percentile and largest."""
    if len(values) < 3:
        return "/".join(f"{value * 1e3:.0f}" for value in values) + " ms"
    p50, p99 = np.percentile(values, (50, 99))
    return f"p50 {p50 * 1e3:.0f}, p99 {p99 * 1e3:.0f}, max {max(values) * 1e3:.0f} ms"


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def slack(rig: Rig, start: float, limit: float) -> float:
    """Seconds that the short form adds to its limits for the machine's sake; the long form's are less, and stay."""
    if limit < LATE:
        return 0.0
    longest = max((scan.dt for scan in rig.scans if scan.start >= start), default=PERIOD)
    return STARVED * max(longest - 2.0 * PERIOD, 0.0)


def never_old(rig: Rig, start: float, limit: float, kinds: Sequence[str] = KINDS) -> None:
    limit += slack(rig, start, limit)
    for kind in kinds:
        wrong = rig.stale(kind, start, limit + REPORTED)
        assert not wrong, f"{kind}: {len(wrong)} values were Good and old or wrong, as {wrong[0]}"


def until_noticed(rig: Rig, kind: str, start: float, end: float) -> float:
    """Seconds from `start` to the last scan before `end` that was Good."""
    return max((seen.start - start for seen in rig.since(start, kind) if seen.good and seen.start < end), default=0.0)


def noticed(rig: Rig, start: float, end: float, size: Size) -> str:
    """Nothing Good longer than allowed after `start`; how long it was, for each kind."""
    times = {kind: until_noticed(rig, kind, start, end) for kind in KINDS}
    limit = size.detected + slack(rig, start, size.detected)
    for kind, seconds in times.items():
        assert seconds <= limit, f"{kind}: still Good {seconds * 1e3:.0f} ms after the fault"
    return "last Good after " + ", ".join(f"{kind} {seconds * 1e3:.0f} ms" for kind, seconds in times.items())
