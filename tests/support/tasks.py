"""A cyclic task over fake devices and plain memory, on a virtual clock."""

import asyncio
from collections.abc import Callable, Sequence

from softplc.clock import Clock, VirtualClock
from softplc.exchange import Reader, Writer, size
from softplc.interfaces import Observer
from softplc.life import Life
from softplc.link import Link
from softplc.scan import CyclicTask, LinkPlace, source_tags, task_tags
from softplc.tags import Image, Tag, TagTable
from softplc.timing import Scan
from softplc.writeback import WriteBack, WriteBacks
from tests.support.drivers import Device


class Echo:
    """An observer that copies its inputs to tags `Echo.0`, `Echo.1`, … as they are latched."""

    def __init__(self, start: int, work: Callable[[], None] = lambda: None) -> None:
        self.start = start
        self.work = work
        self.commands: list[tuple[int, float]] = []

    def step(self, scan: Scan, inputs: Image, outputs: Image) -> None:
        self.work()
        stop = self.start + len(inputs)
        outputs.values[self.start : stop] = inputs.values
        outputs.statuses[self.start : stop] = inputs.statuses
        outputs.source_timestamps[self.start : stop] = inputs.source_timestamps

    def command(self, index: int, value: float) -> bool:
        self.commands.append((index, value))
        return True

    def park(self, scan: Scan, outputs: Image) -> None:
        outputs.fail(0x80020000, slice(self.start, self.start + 1))


class Rig:
    """One task with one device; `scans` records every finished scan."""

    def __init__(
        self,
        clock: Clock | None = None,
        period: float = 0.1,
        readings: int = 1,
        timeout: float = 0.2,
        life: Life | None = None,
        writings: Sequence[str] = ("w",),
    ) -> None:
        self.clock = clock or VirtualClock()
        self.device = Device(self.clock, readings)
        self.scans: list[Scan] = []
        table = self.table = TagTable()
        block = table.add_block("main", "task", task_tags("main"))
        beat, skew = life is not None and life.heartbeat is not None, life is not None and life.stamps is not None
        source = table.add_block("plc", "source", source_tags("plc", beat, skew))
        echo = table.add_block("Echo", "axis", [Tag(f"Echo.{k}") for k in range(readings)])
        table.close_section("main")
        buffer = bytearray(size(table))
        self.reader = Reader(buffer, table, self.clock)
        self.link = Link(
            "plc", self.device.driver, [f"r{k}" for k in range(readings)], writings, self.clock, timeout, 1.0, life
        )
        self.echo = Echo(echo.start)
        self.task = CyclicTask(
            name="main",
            period=period,
            priority=16,
            clock=self.clock,
            links=[LinkPlace(self.link, 0, source)],
            inputs=Image(readings),
            observers=[self.echo],
            write_backs=WriteBacks([]),
            outputs=Image(len(table)),
            block=block,
            section=0,
            writer=Writer(buffer, table),
        )
        self.task.on_scan = self.scans.append

    def value(self, name: str) -> float:
        return float(self.reader.snapshot().values[self.table.index(name)])

    def status(self, name: str) -> int:
        return int(self.reader.snapshot().statuses[self.table.index(name)])

    def observers(self, *observers: Observer) -> None:
        self.task.observers = observers

    def write_backs(self, *write_backs: WriteBack) -> None:
        self.task.write_backs = WriteBacks(write_backs)

    async def run(self, scans: int, each: Callable[[Scan], None] = lambda _: None) -> Sequence[Scan]:
        """Scan so many times; `each` is called after every scan."""
        wanted = len(self.scans) + scans
        enough = asyncio.Event()

        def on_scan(scan: Scan) -> None:
            self.scans.append(scan)
            each(scan)
            if len(self.scans) >= wanted:
                enough.set()

        self.task.on_scan = on_scan
        async with asyncio.TaskGroup() as group:
            running = [group.create_task(self.link.run()), group.create_task(self.task.run())]
            await enough.wait()
            for task in running:
                task.cancel()
        return self.scans[-scans:]
