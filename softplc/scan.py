"""The scan engine: one cyclic task reads, latches, observes, writes and publishes, on an absolute time grid."""

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import structlog

from softplc.clock import Clock
from softplc.exchange import Writer
from softplc.interfaces import Observer
from softplc.link import Link
from softplc.sample import StatusCode
from softplc.tags import Block, DataType, Image, Tag
from softplc.timing import Scan, TaskStatistics, next_deadline
from softplc.writeback import WriteBack

READ_BUDGET = 0.6  # part of the period that a scan waits for replies; later ones serve the next scan
_STATISTICS = (
    ("P50", "median of the last 1024 scans"),
    ("P95", "95th percentile of the last 1024 scans"),
    ("P99", "99th percentile of the last 1024 scans"),
    ("Max", "largest since start"),
)
_TELL = 60.0  # seconds between two log lines about overruns
_REFRESH = 1.0  # seconds between two computations of the percentiles

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
    )


def source_tags(name: str) -> tuple[Tag, ...]:
    """The published statistics of one source's link."""

    def tag(leaf: str, unit: str, description: str, data_type: DataType = DataType.UINT32) -> Tag:
        return Tag(f"Sources.{name}.{leaf}", unit, description, data_type=data_type)

    return (
        tag("Connected", "", "The link is up", DataType.BOOLEAN),
        tag("OffScan", "", "The device answers too late; no scan waits for it", DataType.BOOLEAN),
        tag("Reads", "", "Successful reads since start"),
        tag("ReadErrors", "", "Failed reads since start"),
        tag("Reconnects", "", "Times that the link was lost since start"),
        tag("Writes", "", "Values written into the source since start"),
        tag("WriteErrors", "", "Values that could not be written since start"),
        tag("SlowPath", "", "Messages and values that the driver had to decode one by one since start"),
        tag("ReadTime", "s", "Duration of the last successful read", DataType.DOUBLE),
        tag("Age", "s", "Time since the last successful read", DataType.DOUBLE),
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
    write_backs: Sequence[WriteBack]
    outputs: Image
    block: Block
    section: int
    writer: Writer
    dispatch_commands: Callable[[], None] = lambda: None
    on_scan: Callable[[Scan], None] = lambda _: None
    statistics: TaskStatistics = field(default_factory=TaskStatistics)
    _refreshed: float = float("-inf")
    _failed: set[int] = field(default_factory=set)
    _told_overruns: int = 0
    _told_at: float = float("-inf")

    async def run(self) -> None:
        """Scan on the grid t0 + k·period. A late scan skips to the next slot; missed slots are counted."""
        t0 = deadline = self.clock.monotonic()
        slot = number = overruns = 0
        previous = t0 - self.period
        while True:
            await self.clock.sleep_until(deadline, self.priority)
            start = self.clock.monotonic()
            scan = Scan(number, start, self.clock.utc_ns(), start - previous, self.period, overruns)
            if number == 0:
                scan = Scan(0, start, scan.timestamp, self.period, self.period, 0)
            await self._acquire(scan)
            self._execute(scan)
            for place in self.links:
                place.link.flush()
            previous, number, before = start, number + 1, slot
            deadline, slot = next_deadline(t0, self.period, self.clock.monotonic())
            overruns += slot - before - 1
            self._tell_overruns(start, overruns)

    def _tell_overruns(self, now: float, overruns: int) -> None:
        """Log that slots were missed, once a minute at the most, with how many since the last line."""
        if overruns > self._told_overruns and now - self._told_at >= _TELL:
            missed, self._told_overruns, self._told_at = overruns - self._told_overruns, overruns, now
            log.warning("scans overran", task=self.name, missed=missed, period_ms=self.period * 1e3)

    async def _acquire(self, scan: Scan) -> None:
        """Ask every source at once and wait for the replies, no longer than the read budget allows."""
        budget = READ_BUDGET * self.period
        asked = [task for place in self.links if (task := place.link.ask(budget)) is not None]
        if asked:
            budget += scan.start - self.clock.monotonic()
            await asyncio.wait(asked, timeout=max(budget, 0.0))

    def _execute(self, scan: Scan) -> None:
        """From the latch to the published image; synchronous, nobody else runs in between."""
        for place in self.links:
            place.link.latch(self.inputs, place.start)
        self.dispatch_commands()
        for number, observer in enumerate(self.observers):
            if number not in self._failed:
                self._step(number, observer, scan)
        for write_back in self.write_backs:
            write_back.step(scan, self.outputs)
        self._publish_links(scan)
        execution = self.clock.monotonic() - scan.start
        self.statistics.add(scan, execution)
        self._publish_task(scan, execution)
        self.writer.publish(self.section, scan, self.outputs)
        self.on_scan(scan)

    def _step(self, number: int, observer: Observer, scan: Scan) -> None:
        """An observer that raises is parked, its axes Bad; the others run on."""
        try:
            observer.step(scan, self.inputs, self.outputs)
        except Exception:  # an observer's defect must not end the scan
            log.exception("observer parked", task=self.name)
            self._failed.add(number)
            observer.park(self.outputs)

    def _publish_links(self, scan: Scan) -> None:
        for place in self.links:
            counted = place.link.statistics
            self._put(
                place.block,
                scan,
                counted.connected,
                counted.off_scan,
                counted.reads,
                counted.read_errors,
                counted.reconnects,
                counted.writes,
                counted.write_errors,
                counted.slow_path,
                counted.read_time,
                0.0 if counted.last_read > scan.start else scan.start - counted.last_read,  # read within this scan
            )
            if counted.last_read != counted.last_read:  # NaN: never read
                self.outputs.statuses[place.block.stop - 1] = StatusCode.BAD_WAITING_FOR_INITIAL_DATA

    def _publish_task(self, scan: Scan, execution: float) -> None:
        counts = (scan.number % 65536, scan.number, self.period, scan.dt, scan.jitter, execution)
        start = self.block.start
        if scan.start - self._refreshed >= _REFRESH:
            self._refreshed = scan.start
            windows = (self.statistics.dt, self.statistics.jitter, self.statistics.execution)
            summary = [value for window in windows for value in window.percentiles()]
            self.outputs.values[start + len(counts) : start + len(counts) + len(summary)] = summary
        self.outputs.values[start : start + len(counts)] = counts
        self.outputs.values[self.block.stop - 1] = scan.overruns
        self.outputs.statuses[start : self.block.stop] = StatusCode.GOOD
        self.outputs.source_timestamps[start : self.block.stop] = scan.timestamp

    def _put(self, block: Block, scan: Scan, *values: float) -> None:
        self.outputs.values[block.start : block.stop] = values
        self.outputs.statuses[block.start : block.stop] = StatusCode.GOOD
        self.outputs.source_timestamps[block.start : block.stop] = scan.timestamp
