"""The write half of a link: what waits to be written into its source, the newest value of each tag and no other.

Nothing is queued: a newer value takes the place of one that still waits. A value is written while it is valid or not
at all: `until` says how long that is, so that what a process held while it was stopped, or the machine asleep, is not
written afterwards. Each request takes what waits at that moment, as much as the device takes in one; reading has its
turn in between.
"""

import asyncio
from collections.abc import Callable, Sequence

import numpy as np
import structlog
from numpy.typing import NDArray

from softplc.clock import Clock
from softplc.errors import LinkError
from softplc.interfaces import Driver, Positions
from softplc.log_limit import LogLimit
from softplc.sample import StatusCode, status_name

_PAUSE_FIRST = 1.0  # seconds after a write that cost the connection; longer each time, so that reading goes on
_PAUSE_MOST = 60.0
_BAD = np.uint32(StatusCode.BAD)

Numbers = NDArray[np.float64]
Flags = NDArray[np.bool_]

log = structlog.get_logger("softplc.link")


class Slots:
    """What waits to be written and what became of it, by position. Arrays[n] that stay the same objects.

    `pending`: a value was put and nothing was done about it yet; `under_way`: the source has not answered yet.
    `values` are valid `until` this monotonic time. Of the newest answer to each position: how many there were,
    `answers`; what was written, `answered`; its raw StatusCode, `statuses`; its monotonic time, `times`.
    """

    def __init__(self, n: int) -> None:
        self.pending: Flags = np.zeros(n, np.bool_)
        self.under_way: Flags = np.zeros(n, np.bool_)
        self.values: Numbers = np.zeros(n)
        self.until: Numbers = np.zeros(n)
        self.answers: NDArray[np.int64] = np.zeros(n, np.int64)
        self.answered: Numbers = np.zeros(n)
        self.statuses: NDArray[np.uint32] = np.full(n, StatusCode.GOOD, np.uint32)
        self.times: Numbers = np.zeros(n)

    def part(self, start: int, stop: int) -> "Slots":
        """Some of them, in the same memory."""
        part = Slots(0)
        for name, array in vars(self).items():
            setattr(part, name, array[start:stop])
        return part

    def put(self, positions: Positions, values: Numbers, until: float) -> None:
        """Have values written; those that are still waiting are replaced by them."""
        self.values[positions] = values
        self.until[positions] = until
        self.pending[positions] = True


class Writing:
    """What one link writes: `slots`. Counts since start: values `written`, `errors`, and `mismatches` read back.

    `fail(driver, reason)` is called when a write cost the connection.
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
        self.slots = Slots(len(names))
        self._name, self._names, self._clock, self._timeout, self._fail = name, names, clock, timeout, fail
        self._next = 0  # the position whose turn it is, where a request does not take all
        self._task: asyncio.Task[None] | None = None
        self._pause = 0.0
        self._from = float("-inf")
        self._limit = LogLimit()

    def __len__(self) -> int:
        return len(self._names)

    def flush(self, driver: Driver | None, turn: asyncio.Lock) -> None:
        """Start writing what was put, unless a write is under way; without a driver it is dropped and counted.

        A device that does not answer writes costs the connection each time, so writing pauses longer and longer.
        """
        if not self.slots.pending.any():
            return
        if driver is None:
            self.errors += int(np.count_nonzero(self.slots.pending))
            self.slots.pending.fill(False)
        elif self._clock.monotonic() < self._from:
            return  # what was put waits, and newer values replace it
        elif self._task is None or self._task.done():
            self._task = asyncio.create_task(self._write(driver, turn), name=f"write {self._name}")

    def drop(self) -> None:
        """The connection is gone, and with it everything that waited."""
        if self._task is not None and not self._task.done():
            self._task.cancel()
        self._task = None
        self.slots.pending.fill(False)
        self.slots.under_way.fill(False)

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
        positions = np.zeros(0, np.intp)
        try:
            async with asyncio.timeout(self._timeout), turn:
                positions = self._take(driver.writes_at_once)
                if not positions.size:  # withdrawn, or not valid any more
                    return False
                values = self.slots.values[positions]
                statuses = await driver.write(positions, values)
            self._note(positions, values, statuses)
        except (LinkError, TimeoutError) as error:
            self._lose(driver, len(positions), str(error) or f"write not confirmed within {self._timeout:g} s")
            self._pause = min(max(2.0 * self._pause, _PAUSE_FIRST), _PAUSE_MOST)
            self._from = self._clock.monotonic() + self._pause
            self._tell("warning", "writing pauses", seconds=self._pause)
            return False
        except Exception as error:  # a driver's defect is this link's fault alone
            self._tell("exception", "driver failed to write")
            self._lose(driver, len(positions), repr(error))
            return False
        finally:
            self.slots.under_way.fill(False)
        self._pause = 0.0
        return True

    def _take(self, most: int) -> Positions:
        """Whose newest values are written, now that it is our turn: as many as the device takes, each in its turn.

        What is not valid any more stays until a newer value comes.
        """
        slots = self.slots
        ready = (slots.pending & (self._clock.monotonic() <= slots.until)).nonzero()[0]
        if ready.size > most:
            begin = ready.searchsorted(self._next) % ready.size
            ready = ready[begin : begin + most]
        if ready.size:
            self._next = int(ready[-1]) + 1
        slots.pending[ready] = False
        slots.under_way[ready] = True
        return ready

    def _lose(self, driver: Driver, values: int, reason: str) -> None:
        self.errors += max(values, 1)
        self._fail(driver, reason)

    def _note(self, positions: Positions, values: Numbers, statuses: NDArray[np.uint32]) -> None:
        slots, failed = self.slots, int(np.count_nonzero(statuses >= _BAD))
        self.written += len(positions) - failed
        self.errors += failed
        for one in (statuses != slots.statuses[positions]).nonzero()[0]:
            event = "write refused" if statuses[one] >= _BAD else "write accepted again"
            self._tell("warning", event, tag=self._names[positions[one]], status=status_name(int(statuses[one])))
        slots.answers[positions] += 1
        slots.answered[positions] = values
        slots.statuses[positions] = statuses
        slots.times[positions] = self._clock.monotonic()

    def _tell(self, level: str, event: str, **fields: object) -> None:
        room = self._limit.ask(self._clock.monotonic())
        if room is not None:
            getattr(log, level)(event, source=self._name, **fields, **room)
