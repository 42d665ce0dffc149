"""The scan engine: one cyclic task reads, latches, observes, writes and publishes, on an absolute time grid."""

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import structlog

from softplc.clock import Clock
from softplc.exchange import Writer
from softplc.interfaces import Observer
from softplc.link import Link
from softplc.log_limit import LogLimit
from softplc.sample import StatusCode
from softplc.tags import Block, DataType, Image, Tag
from softplc.timing import Deadlines, Scan, TaskStatistics, next_deadline
from softplc.writeback import WriteBacks

READ_BUDGET = 0.6  # part of the period that a scan waits for replies; later ones serve the next scan
_STATISTICS = (
    ("P50", "median of the last 1024 scans"),
    ("P95", "95th percentile of the last 1024 scans"),
    ("P99", "99th percentile of the last 1024 scans"),
    ("Max", "largest since start"),
)
_TELL = 60.0  # seconds between two log lines about overruns
_REFRESH = 1.0  # seconds between two computations of the percentiles
_SUSPENDED = 0.1  # seconds; a machine does not sleep for less

log = structlog.get_logger(__name__)


def task_tags(name: str) -> tuple[Tag, ...]:
    """The published statistics of one task."""

    def tag(leaf: str, unit: str, description: str, data_type: DataType = DataType.DOUBLE) -> Tag:
        return Tag(f"Tasks.{name}.{leaf}", unit, description, data_type=data_type)

    return (
        tag("Heartbeat", "", "Counts scans, rolls over after 65535", DataType.UINT16),
        tag("ScanNumber", "", "Scans since start", DataType.UINT32),
        tag("Period", "s", "Configured time between scans"),
        tag("Dt", "s", "Measured time between the last two scans, start to start"),
        tag("Jitter", "s", "Measured time between scans minus the period"),
        tag("ExecutionTime", "s", "From the start of the scan to its published image"),
        *(
            tag(f"{kind}{statistic}", "s", f"{text}, {meaning}")
            for kind, text in (("Dt", "Δt"), ("Jitter", "Absolute jitter"), ("Execution", "Execution time"))
            for statistic, meaning in _STATISTICS
        ),
        tag("Overruns", "", "Slots of the time grid that were missed since start", DataType.UINT32),
        tag("Overloaded", "", "Five of the last 100 slots or more were missed", DataType.BOOLEAN),
        tag("Suspended", "s", "Time for which the machine was suspended since start"),
        tag("CommandsRefused", "", "Values from clients that no observer took, since start", DataType.UINT32),
    )


def source_tags(name: str, heartbeat: bool = False, skew: bool = False) -> tuple[Tag, ...]:
    """The published statistics of one source's link; `heartbeat` and `skew` where it has them."""

    def tag(leaf: str, unit: str, description: str, data_type: DataType = DataType.UINT32) -> Tag:
        return Tag(f"Sources.{name}.{leaf}", unit, description, data_type=data_type)

    more: list[Tag] = []
    if heartbeat:
        more.append(tag("Heartbeat", "", "The heartbeat of the source's program moves", DataType.BOOLEAN))
    if skew:
        what = "Source clock minus ours: newest timestamp that moved, against its arrival"
        more.append(tag("Skew", "s", what, DataType.DOUBLE))
    return (
        tag("Connected", "", "The link is up", DataType.BOOLEAN),
        tag("OffScan", "", "The device answers too late; no scan waits for it", DataType.BOOLEAN),
        tag("Reads", "", "Successful reads since start"),
        tag("ReadErrors", "", "Failed reads since start"),
        tag("Reconnects", "", "Times that the link was lost since start"),
        tag("Writes", "", "Values written into the source since start"),
        tag("WriteErrors", "", "Values that could not be written since start"),
        tag("WriteMismatches", "", "Times that another value was read back than written", DataType.UINT16),
        tag("SlowPath", "", "Messages and values that the driver had to decode one by one since start"),
        tag("ReadTime", "s", "Duration of the last successful read", DataType.DOUBLE),
        tag("Age", "s", "Time since the last successful read", DataType.DOUBLE),
        *more,
    )


@dataclass(slots=True)
class LinkPlace:
    """A link of the task: where its samples go in the inputs, and its block of published tags."""

    link: Link
    start: int
    block: Block


@dataclass(slots=True)
class CyclicTask:
    """One task (IEC 61131-3): everything that one scan needs, and `run`, which scans until cancelled."""

    name: str
    period: float
    priority: int
    clock: Clock
    links: Sequence[LinkPlace]
    inputs: Image
    observers: Sequence[Observer]
    write_backs: WriteBacks
    outputs: Image
    block: Block
    section: int
    writer: Writer
    dispatch_commands: Callable[[], None] = lambda: None
    commands_refused: Callable[[], int] = lambda: 0
    on_scan: Callable[[Scan], None] = lambda _: None
    statistics: TaskStatistics = field(default_factory=TaskStatistics)
    _refreshed: float = float("-inf")
    _failed: set[int] = field(default_factory=set)
    _told_overruns: int = 0
    _told_at: float = float("-inf")
    _deadlines: Deadlines = field(default_factory=Deadlines)
    _suspended: float = 0.0
    _defects: dict[str, LogLimit] = field(default_factory=dict)
    _failing: set[str] = field(default_factory=set)

    async def run(self) -> None:
        """Scan on the grid t0 + k·period. A late scan skips to the next slot; missed slots are counted.

        After a sleep of the machine the grid begins anew: its Δt is measured, its slots were not missed.
        """
        t0 = deadline = self.clock.monotonic()
        slot = number = overruns = 0
        previous, slept = t0 - self.period, self.clock.suspended()
        while True:
            await self.clock.sleep_until(deadline, self.priority)
            start = self.clock.monotonic()
            scan = Scan(number, start, self.clock.utc_ns(), start - previous, self.period, overruns)
            if number == 0:
                scan = Scan(0, start, scan.timestamp, self.period, self.period, 0)
            await self._acquire(scan)
            self._execute(scan)
            for place in self.links:
                self._attempt(f"writing into {place.link.name}", place.link.flush)
            previous, number = start, number + 1
            if self.clock.suspended() - slept > _SUSPENDED:
                slept = self._tell_suspended(slept)
                t0, slot = self.clock.monotonic(), 0
            before = slot
            deadline, slot = next_deadline(t0, self.period, self.clock.monotonic())
            overruns += slot - before - 1
            self._deadlines.add(slot - before - 1)
            self._tell_overruns(start, overruns)

    def _tell_suspended(self, before: float) -> float:
        now = self.clock.suspended()
        self._suspended += now - before
        log.warning("the machine was suspended", task=self.name, seconds=round(now - before, 1))
        return now

    def _tell_overruns(self, now: float, overruns: int) -> None:
        """Log that slots were missed, once a minute at the most, with how many since the last line."""
        if overruns > self._told_overruns and now - self._told_at >= _TELL:
            missed, self._told_overruns, self._told_at = overruns - self._told_overruns, overruns, now
            log.warning("scans overran", task=self.name, missed=missed, period_ms=self.period * 1e3)

    async def _acquire(self, scan: Scan) -> None:
        """Ask every source at once and wait for the replies, no longer than the read budget allows."""
        budget = READ_BUDGET * self.period
        asked: list[asyncio.Task[None]] = []
        for place in self.links:
            self._attempt(f"asking {place.link.name}", self._ask, place.link, budget, asked)
        if asked:
            budget += scan.start - self.clock.monotonic()
            await asyncio.wait(asked, timeout=max(budget, 0.0))

    def _ask(self, link: Link, budget: float, asked: "list[asyncio.Task[None]]") -> None:
        task = link.ask(budget)
        if task is not None:
            asked.append(task)

    def _attempt(self, part: str, action: Callable[..., None], *arguments: object) -> bool:
        """Run one part of the scan; False when it raised. A defect ends nothing but its own part, and is told."""
        try:
            action(*arguments)
        except Exception:  # a part's defect must not end the scan
            self._tell_defect(part)
            return False
        if self._failing and part in self._failing:
            self._failing.discard(part)
            log.info("part of the scan works again", task=self.name, part=part)
        return True

    def _tell_defect(self, part: str) -> None:
        if part in self._failing:
            return
        room = self._defects.setdefault(part, LogLimit()).ask(self.clock.monotonic())
        if room is not None:
            self._failing.add(part)
            log.exception("part of the scan failed", task=self.name, part=part, **room)

    def _execute(self, scan: Scan) -> None:
        """From the latch to the published image; synchronous, nobody else runs in between."""
        for place in self.links:
            if not self._attempt(f"latching {place.link.name}", place.link.latch, self.inputs, place.start):
                where = slice(place.start, place.start + len(place.link.samples))
                self.inputs.fail(StatusCode.BAD_INTERNAL_ERROR, where)
        self._attempt("commands", self.dispatch_commands)
        for number, observer in enumerate(self.observers):
            if number in self._failed:
                self._attempt("a parked observer", observer.park, scan, self.outputs)
            else:
                self._step(number, observer, scan)
        self._attempt("writing back", self.write_backs.step, scan, self.inputs, self.outputs)
        for place in self.links:
            if not self._attempt(f"statistics of {place.link.name}", self._publish_link, place, scan):
                self._fail(place.block)
        execution = self.clock.monotonic() - scan.start
        if not self._attempt("statistics of the task", self._publish_task, scan, execution):
            self._fail(self.block)
        self._attempt("publishing", self.writer.publish, self.section, scan, self.outputs)
        self._attempt("the end of the scan", self.on_scan, scan)

    def _fail(self, block: Block) -> None:
        self.outputs.fail(StatusCode.BAD_INTERNAL_ERROR, slice(block.start, block.stop))

    def _step(self, number: int, observer: Observer, scan: Scan) -> None:
        """An observer that raises is parked, its axes Bad; the others run on."""
        try:
            observer.step(scan, self.inputs, self.outputs)
        except Exception:  # an observer's defect must not end the scan
            log.exception("observer parked", task=self.name)
            self._failed.add(number)
            observer.park(scan, self.outputs)

    def _publish_link(self, place: LinkPlace, scan: Scan) -> None:
        counted = place.link.statistics
        self._put(
            place.block,
            scan,
            counted.connected,
            counted.off_scan,
            counted.reads,
            counted.read_errors,
            counted.reconnects,
            place.link.writing.written,
            place.link.writing.errors,
            place.link.writing.mismatches % 65536,
            counted.slow_path,
            counted.read_time,
            0.0 if counted.last_read > scan.start else scan.start - counted.last_read,  # read within this scan
            *place.link.life.tags(counted.connected),
        )
        values = self.outputs.values[place.block.start : place.block.stop]
        missing = place.block.start + np.flatnonzero(np.isnan(values))  # never read, no timestamp yet
        self.outputs.statuses[missing] = StatusCode.BAD_WAITING_FOR_INITIAL_DATA

    def _publish_task(self, scan: Scan, execution: float) -> None:
        self.statistics.add(scan, execution)
        counts = (scan.number % 65536, scan.number, self.period, scan.dt, scan.jitter, execution)
        start = self.block.start
        if scan.start - self._refreshed >= _REFRESH:
            self._refreshed = scan.start
            windows = (self.statistics.dt, self.statistics.jitter, self.statistics.execution)
            summary = [value for window in windows for value in window.percentiles()]
            self.outputs.values[start + len(counts) : start + len(counts) + len(summary)] = summary
        self.outputs.values[start : start + len(counts)] = counts
        last = (scan.overruns, self._deadlines.overloaded, self._suspended, self.commands_refused())
        self.outputs.values[self.block.stop - len(last) : self.block.stop] = last
        self.outputs.statuses[start : self.block.stop] = StatusCode.GOOD
        self.outputs.source_timestamps[start : self.block.stop] = scan.timestamp

    def _put(self, block: Block, scan: Scan, *values: float) -> None:
        self.outputs.values[block.start : block.stop] = values
        self.outputs.statuses[block.start : block.stop] = StatusCode.GOOD
        self.outputs.source_timestamps[block.start : block.stop] = scan.timestamp
