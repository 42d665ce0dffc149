"""A feed hosts one publisher in the gateway: newest snapshot only, at its own interval, never delaying anyone."""

import structlog

from softplc.clock import Clock
from softplc.interfaces import Publisher
from softplc.timing import next_deadline

log = structlog.get_logger(__name__)


class Feed:
    """Calls one publisher at `start` + k·`interval` (monotonic s); slots that it misses are dropped and counted.

    Feeds with one start and interval have their turns one right after the other: what one of them tells its clients
    of a task that died, the other does too.
    """

    def __init__(self, name: str, publisher: Publisher, clock: Clock, interval: float, start: float) -> None:
        self.name = name
        self.dropped = 0
        self.errors = 0
        self._publisher, self._clock, self._interval, self._start = publisher, clock, interval, start

    async def run(self) -> None:
        """Publish until cancelled. A publisher's failure is logged once for each new text, and tried again."""
        slot, told = 0, ""
        deadline = self._start
        while True:
            await self._clock.sleep_until(deadline)
            try:
                await self._publisher.publish()
            except Exception as error:  # one publisher's defect must not silence the others
                self.errors += 1
                if repr(error) != told:
                    told = repr(error)
                    log.exception("publisher failed", publisher=self.name)
            previous = slot
            deadline, slot = next_deadline(self._start, self._interval, self._clock.monotonic())
            self.dropped += slot - previous - 1
