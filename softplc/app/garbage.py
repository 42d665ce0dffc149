"""The garbage collector's work, done where no scan waits for it."""

import asyncio
import gc
from typing import Final

from softplc.clock import Clock
from softplc.timing import Scan

_YOUNG: Final = 10_000  # objects more than at the last collection: time for the next
_EVERY: Final = 20  # collections of one generation, then one of the next
_AT_LATEST: Final = 500_000  # so many objects are not left lying about, slack or no slack


def freeze_garbage() -> None:
    """Collect once, then hide all that is left from the collector; a full collection over it costs 100 ms."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 100)


class Slack:
    """Collects between scans instead of within them.

    The automatic collector strikes wherever an allocation crosses its threshold, as often as not between a sample
    and its output. With this one it is off, and `after` collects when the time to the next scan allows it.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._took = [0.0, 0.0, 0.0]  # seconds that the last collection of each generation needed
        gc.disable()

    def after(self, scan: Scan) -> None:
        """To be called when a scan is done; what there is to collect is collected when everyone else had a turn."""
        if gc.get_count()[0] > _YOUNG:
            asyncio.get_running_loop().call_soon(self._collect, scan.start + scan.period)

    def _collect(self, deadline: float) -> None:
        young, middle, old = gc.get_count()
        if young <= _YOUNG:
            return
        generation = 2 if old > _EVERY else 1 if middle > _EVERY else 0
        now = self._clock.monotonic()
        if now + 2.0 * self._took[generation] < deadline or young > _AT_LATEST:
            gc.collect(generation)
            self._took[generation] = self._clock.monotonic() - now
