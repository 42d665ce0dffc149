"""Which process is stuck: it lives, and does not do what it is there for."""

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import structlog

from softplc.app.process import Child
from softplc.clock import Clock

GATEWAY_LIMIT: Final = 10.0  # seconds; a client with a huge request stalls an asyncua loop for 2 s
SCAN_LIMIT: Final = 5.0  # seconds, or three periods if longer
START_LIMIT: Final = 120.0  # seconds from the start of a process until it is ready
_LOOK: Final = 0.5  # seconds between two looks

log = structlog.get_logger(__name__)


@dataclass(slots=True)
class Sign:
    """A counter that moves while a process is well. `what` is missing when it stands still for `limit` seconds."""

    what: str
    read: Callable[[], int]
    limit: float
    _last: int | None = None
    _still: float = 0.0

    def look(self, elapsed: float) -> float:
        """Seconds for which it has stood still; `elapsed` is the time since the last look."""
        now = self.read()
        self._still = 0.0 if now != self._last else self._still + elapsed
        self._last = now
        return self._still

    def forget(self) -> None:
        """The process is a new one."""
        self._last, self._still = None, 0.0


@dataclass(slots=True)
class Guard:
    """Looks at one process. Time is what the looks themselves add up to: who looks late was held up as well.

    So nothing is killed because the machine slept, or the supervisor, or everybody, was stopped: each look counts for
    a second at the most.
    """

    child: Child
    signs: Sequence[Sign]
    _starting: float = 0.0
    _seen: object = None

    def look(self, elapsed: float) -> tuple[str, float] | None:
        """What is missing and for how long, when it is longer than the limit."""
        elapsed = min(elapsed, 2.0 * _LOOK)
        if self.child.process is not self._seen:
            self._seen, self._starting = self.child.process, 0.0
            for sign in self.signs:
                sign.forget()
        if self.child.ready is None or not self.child.ready.done():
            self._starting += elapsed
            return ("it is not ready", self._starting) if self._starting > START_LIMIT else None
        for sign in self.signs:
            still = sign.look(elapsed)
            if still > sign.limit:
                return sign.what, still
        return None


async def guard(guards: Sequence[Guard], clock: Clock) -> None:
    """Kill what is stuck, until cancelled; whoever watches the processes starts them anew."""
    last = clock.monotonic()
    while True:
        await clock.sleep_until(last + _LOOK)
        await asyncio.sleep(0)  # who died meanwhile is seen first
        now = clock.monotonic()
        for each in guards:
            missing = each.look(now - last)
            if missing is not None and each.child.alive:
                what, seconds = missing
                log.error("process stuck, killed", child=each.child.name, what=what, seconds=round(seconds, 1))
                each.child.kill()
        last = now
