"""The write half of a link: what waits to be written into its source, the newest value of each tag and no other.

Nothing is queued: a newer value takes the place of one that still waits. A value is written while it is valid or not
at all: `until` says how long that is, so that what a process held while it was stopped, or the machine asleep, is not
written afterwards. Each request takes what waits at that moment, as much as the device takes in one; reading has its
turn in between.
"""

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice

import structlog

from softplc.clock import Clock
from softplc.errors import LinkError
from softplc.interfaces import Driver
from softplc.log_limit import LogLimit
from softplc.sample import StatusCode, is_bad, status_name

_PAUSE_FIRST = 1.0  # seconds after a write that cost the connection; longer each time, so that reading goes on
_PAUSE_MOST = 60.0

log = structlog.get_logger("softplc.link")


@dataclass(frozen=True, slots=True)
class Written:
    """The answer to a write: what was written, the raw StatusCode, and the monotonic time of the answer."""

    value: float
    status: int
    at: float


class Writing:
    """What one link writes. Counts since start: values `written`, `errors`, and `mismatches` that were read back.

    `fail(driver, reason)` is called when a write cost the connection. `answers` has the newest answer for each
    position.
    """

    def __init__(
        self,
        name: str,
        names: Sequence[str],
        clock: Clock,
        timeout: float,
        fail: Callable[[Driver, str], None],
    ) -> None:
        self.written = self.errors = self.mismatches = 0
        self.answers: dict[int, Written] = {}
        self._name, self._names, self._clock, self._timeout, self._fail = name, names, clock, timeout, fail
        self._pending: dict[int, tuple[float, float]] = {}
        self._under_way: set[int] = set()
        self._task: asyncio.Task[None] | None = None
        self._pause = 0.0
        self._from = float("-inf")
        self._limit = LogLimit()

    def put(self, position: int, value: float, until: float) -> None:
        """Have a value written; one that is still waiting is replaced by it."""
        self._pending[position] = value, until

    def pending(self, position: int) -> bool:
        """A value was put and nothing was done about it yet."""
        return position in self._pending

    def waiting(self, position: int) -> bool:
        """A value was put and the source has not answered yet."""
        return position in self._pending or position in self._under_way

    def withdraw(self, position: int) -> bool:
        """A value that was put and not written yet is not to be written any more; whether there was one."""
        return self._pending.pop(position, None) is not None

    def flush(self, driver: Driver | None, turn: asyncio.Lock) -> None:
        """Start writing what was put, unless a write is under way; without a driver it is dropped and counted.

        A device that does not answer writes costs the connection each time, so writing pauses longer and longer.
        """
        if not self._pending:
            return
        if driver is None:
            self.errors += len(self._pending)
            self._pending.clear()
        elif self._clock.monotonic() < self._from:
            return  # what was put waits, and newer values replace it
        elif self._task is None or self._task.done():
            self._task = asyncio.create_task(self._write(driver, turn), name=f"write {self._name}")

    def drop(self) -> None:
        """The connection is gone, and with it everything that waited."""
        if self._task is not None and not self._task.done():
            self._task.cancel()
        self._task = None
        self._pending.clear()
        self._under_way.clear()

    def mismatch(self, position: int, wrote: float, found: float) -> None:
        """Another value was read back than was written."""
        self.mismatches += 1
        self._tell(
            "warning", "written value reads back different", tag=self._names[position], wrote=wrote, found=found
        )

    def match(self, position: int) -> None:
        """What is read back is what was written, again."""
        self._tell("info", "written value reads back as written again", tag=self._names[position])

    async def _write(self, driver: Driver, turn: asyncio.Lock) -> None:
        """Write until nothing valid waits any more."""
        while await self._write_some(driver, turn):
            pass

    async def _write_some(self, driver: Driver, turn: asyncio.Lock) -> bool:
        values: dict[int, float] = {}
        try:
            async with asyncio.timeout(self._timeout), turn:
                values = self._take(driver.writes_at_once)
                if not values:  # withdrawn, or not valid any more
                    return False
                statuses = await driver.write(values)
            self._note(values, statuses)
        except (LinkError, TimeoutError) as error:
            self._lose(driver, values, str(error) or f"write not confirmed within {self._timeout:g} s")
            self._pause = min(max(2.0 * self._pause, _PAUSE_FIRST), _PAUSE_MOST)
            self._from = self._clock.monotonic() + self._pause
            self._tell("warning", "writing pauses", seconds=self._pause)
            return False
        except Exception as error:  # a driver's defect is this link's fault alone
            self._tell("exception", "driver failed to write")
            self._lose(driver, values, repr(error))
            return False
        finally:
            self._under_way.clear()
        self._pause = 0.0
        return True

    def _take(self, most: int) -> dict[int, float]:
        """The newest values, now that it is our turn. What is not valid any more stays until a newer one comes."""
        now = self._clock.monotonic()
        valid = (position for position, (_, until) in self._pending.items() if now <= until)
        values = {position: self._pending[position][0] for position in islice(valid, most)}
        for position in values:
            del self._pending[position]
        self._under_way = set(values)
        return values

    def _lose(self, driver: Driver, values: dict[int, float], reason: str) -> None:
        self.errors += max(len(values), 1)
        self._fail(driver, reason)

    def _note(self, values: dict[int, float], statuses: dict[int, int]) -> None:
        now = self._clock.monotonic()
        for position, value in values.items():
            status, failed = statuses[position], is_bad(statuses[position])
            before = self.answers.get(position)
            self.written += not failed
            self.errors += failed
            if status != (StatusCode.GOOD if before is None else before.status):
                event = "write refused" if failed else "write accepted again"
                self._tell("warning", event, tag=self._names[position], status=status_name(status))
            self.answers[position] = Written(value, status, now)

    def _tell(self, level: str, event: str, **fields: object) -> None:
        room = self._limit.ask(self._clock.monotonic())
        if room is not None:
            getattr(log, level)(event, source=self._name, **fields, **room)
