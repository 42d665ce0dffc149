"""A link hosts one driver for one task: time limits, back-off, a new driver for each attempt.

It never raises into the scan. A source that cannot be reached is BadNoCommunication on its tags; a reply that is
not there in time leaves the earlier samples as UncertainLastUsableValue, and the request stays outstanding, so
that there are never two.

Good is what was asked for and answered within one scan. Of a reply that comes in a later scan nobody knows when the
device took the values: it is thrown away and the device asked again, unless it is late every time. A device that
kept two scans in a row waiting in vain is off-scan: it is asked as before, but no scan waits for it until it answers
in time again, so that its neighbours' samples are as fresh as ever.
"""

import asyncio
import contextlib
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import structlog

from softplc.clock import Clock
from softplc.errors import LinkError
from softplc.interfaces import Driver
from softplc.life import Life
from softplc.link_log import Told
from softplc.link_write import Writing
from softplc.log_limit import LogLimit
from softplc.sample import StatusCode
from softplc.tags import Image

_BACK_OFF_FIRST = 0.05  # seconds
_BACK_OFF_MOST = 0.5  # from one attempt to the next, so that a source that is back is Good within a second
_OFF_SCAN_AFTER = 2  # scans in a row that waited in vain
_CLOSE_LIMIT = 1.0

log = structlog.get_logger(__name__)


@dataclass(slots=True)
class LinkStatistics:
    """What a link counts since start; `read_time` is the last successful read's duration in seconds.

    `off_scan`: no scan waits for the device, because it did not answer in time. `slow_path`: messages and values that
    the driver could not decode all at once.
    """

    connected: bool = False
    off_scan: bool = False
    reads: int = 0
    read_errors: int = 0
    reconnects: int = 0
    slow_path: int = 0
    read_time: float = 0.0
    last_read: float = field(default=float("nan"))


class Link:
    """One source of one task. `samples` holds what the driver delivered last, one entry for each reading."""

    def __init__(
        self,
        name: str,
        make_driver: Callable[[], Driver],
        readings: Sequence[str],
        writings: Sequence[str],
        clock: Clock,
        timeout: float,
        connect_timeout: float,
        life: Life | None = None,
    ) -> None:
        self.name = name
        self.life = life or Life()
        self.statistics = LinkStatistics()
        self.samples = Image(len(readings))
        self._make_driver = make_driver
        self.writing = Writing(name, writings, clock, timeout, self._fail)
        self._readings = readings
        self._clock = clock
        self._timeout, self._connect_timeout = timeout, connect_timeout
        self._incoming = Image(len(readings))
        self._driver: Driver | None = None
        self._lost = asyncio.Event()
        self._turn = asyncio.Lock()  # one outstanding request for each connection
        self._read: asyncio.Task[None] | None = None
        self._patience = 0.0  # seconds that the scan waits for a reply
        self._missed = 0  # scans in a row that waited in vain
        self._answered = False  # what this scan asked was answered
        self._late = False  # the outstanding read was asked for in an earlier scan
        self._slow_before = 0  # slow_path of the connections before this one
        self._slow = False  # the last reply was late, and so was the one before
        self._closing: set[asyncio.Task[None]] = set()
        self._told = Told(name, clock)
        self._defects = LogLimit()

    async def run(self) -> None:
        """Connect, stay until the link is lost, back off, connect again; until cancelled."""
        back_off = _BACK_OFF_FIRST
        try:
            while True:
                begun, reads = self._clock.monotonic(), self.statistics.reads
                if await self._open():
                    await self._lost.wait()
                    self._drop()
                    begun = self._clock.monotonic()
                if self.statistics.reads > reads:  # not before: a device may accept every connection and serve none
                    back_off = _BACK_OFF_FIRST
                pause = back_off * random.uniform(0.5, 1.0)
                soonest = self._clock.monotonic() + 0.5 * _BACK_OFF_FIRST
                await self._clock.sleep_until(max(begun + pause, soonest))
                back_off = min(2 * back_off, _BACK_OFF_MOST)
        finally:
            self._drop()
            if self._closing:
                await asyncio.wait(self._closing, timeout=_CLOSE_LIMIT)

    def ask(self, patience: float) -> "asyncio.Task[None] | None":
        """Start this scan's read unless one is outstanding; returns what to wait for, for `patience` seconds.

        None when there is nothing to wait for: no link, or a device that is off-scan.
        """
        self._told.catch_up()
        self._answered, self._patience = False, patience
        if self._driver is None:
            return None
        if self._read is None or self._read.done():
            self._read = asyncio.create_task(self._do_read(self._driver), name=f"read {self.name}")
        else:
            self._late = True
        return None if self.statistics.off_scan else self._read

    def latch(self, inputs: Image, start: int) -> None:
        """Copy the newest samples to `inputs` from index `start`, with the status that they deserve in this scan."""
        if self._driver is None:
            self.samples.fail(StatusCode.BAD_NO_COMMUNICATION)
        inputs.take_over(self.samples, start)
        if not self._answered:
            if self._driver is not None:
                self._missed += 1
                self.statistics.off_scan = self._missed >= _OFF_SCAN_AFTER
            statuses = inputs.statuses[start : start + len(self.samples)]
            statuses[statuses < np.uint32(StatusCode.BAD)] = StatusCode.UNCERTAIN_LAST_USABLE_VALUE
        self.life.lower(inputs, start, start + len(self.samples), self._answered)

    def put(self, position: int, value: float, until: float = float("inf")) -> None:
        """Have a value written while it is valid, which is `until` this monotonic time; the newest only."""
        self.writing.slots.put(np.array([position]), np.array([value]), until)

    def flush(self) -> None:
        """Start writing what was put, unless a write is under way."""
        self.writing.flush(self._driver, self._turn)

    async def _open(self) -> bool:
        driver = None
        try:
            driver = self._make_driver()
            async with asyncio.timeout(self._connect_timeout):
                await driver.open()
            remarks, problems = driver.remarks, driver.problems
        except (LinkError, TimeoutError) as error:
            self._told.lost(str(error) or f"no connection within {self._connect_timeout:g} s")
        except Exception as error:  # a driver's defect is this link's fault alone
            self._tell_defect("driver failed to open")
            self._told.lost(repr(error))
        else:
            self._lost.clear()
            self._driver = driver
            self.statistics.connected = True
            self._slow_before = self.statistics.slow_path
            self._told.up()
            self._told.words("remark", remarks)
            self._told.words("tag problem", problems)
            return True
        if driver is not None:
            self._close(driver)
        return False

    def _drop(self) -> None:
        """Let the driver go; the samples are Bad from here."""
        if self._driver is None:
            return
        driver, self._driver = self._driver, None
        self.statistics.connected = False
        self.statistics.reconnects += 1
        if self._read is not None and not self._read.done():
            self._read.cancel()
        self._read = None
        self.writing.drop()
        self._answered = self._late = self._slow = self.statistics.off_scan = False
        self._missed = 0
        self.life.pause()
        self._turn = asyncio.Lock()
        self.samples.fail(StatusCode.BAD_NO_COMMUNICATION)
        self._close(driver)

    def _close(self, driver: Driver) -> None:
        """Close in the background: a dead connection may take its time, and nobody waits for it."""

        async def close() -> None:
            with contextlib.suppress(Exception):
                async with asyncio.timeout(_CLOSE_LIMIT):
                    await driver.close()

        task = asyncio.create_task(close(), name=f"close {self.name}")
        self._closing.add(task)
        task.add_done_callback(self._closing.discard)

    def _fail(self, driver: Driver, reason: str) -> None:
        if driver is self._driver and not self._lost.is_set():
            self._told.lost(reason)
            self._lost.set()

    async def _do_read(self, driver: Driver) -> None:
        try:
            begun = await self._read_once(driver)
            if self._late and not self._slow:  # who knows when the device took these values
                begun = await self._read_once(driver)
            if driver is self._driver:
                self._take(driver, begun)
        except (LinkError, TimeoutError) as error:
            self.statistics.read_errors += 1
            self._fail(driver, str(error) or f"no reply within {self._timeout:g} s")
        except Exception as error:  # a driver's defect is this link's fault alone
            self._tell_defect("driver failed to read")
            self.statistics.read_errors += 1
            self._fail(driver, repr(error))

    def _take(self, driver: Driver, begun: float) -> None:
        """Make what came in the link's samples; `begun` is when it was asked for."""
        if self._told.tags(self._readings, self.samples.statuses, self._incoming.statuses):
            self._told.words("tag problem", driver.problems)
        self.samples, self._incoming = self._incoming, self.samples
        self._incoming.take_over(self.samples)  # a driver may fill in only what is new
        now = self._clock.monotonic()
        self.statistics.reads += 1
        self.statistics.slow_path = self._slow_before + getattr(driver, "slow_path", 0)
        self.statistics.read_time = now - begun
        self.statistics.last_read = now
        self.life.look(self.samples, now, self._clock.utc_ns())
        self._told.life(self.life, self._readings)
        self._answered, self._slow = not self._late, self._late
        if now - begun <= self._patience:
            self._missed, self.statistics.off_scan = 0, False

    def _tell_defect(self, event: str) -> None:
        """One line with the traceback; of a driver that fails in every attempt some a minute."""
        room = self._defects.ask(self._clock.monotonic())
        if room is not None:
            log.exception(event, source=self.name, **room)

    async def _read_once(self, driver: Driver) -> float:
        """Have the driver fill what comes in; the monotonic time at which it was asked."""
        self._late = False
        begun = self._clock.monotonic()
        async with asyncio.timeout(self._timeout), self._turn:
            await driver.read(self._incoming)
        return begun
