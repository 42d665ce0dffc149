"""A configuration whose sources are all recordings, run on the virtual clock: every scan's tags as CSV rows."""

import asyncio
import csv
from typing import TextIO

from softplc.app.layout import Layout, build_layout
from softplc.app.scan_process import build_tasks, start_tasks
from softplc.clock import VirtualClock
from softplc.config.models import Config
from softplc.drivers.replay import ReplaySource, recording_seconds, rows_seen
from softplc.errors import UsageError
from softplc.exchange import Writer, size
from softplc.scan import CyclicTask
from softplc.timing import Scan


def replay(config: Config, output: TextIO) -> int:
    """Replay to the end of the longest recording as fast as the machine can; returns the number of scans.

    Writes one row for each scan: time in seconds from the start, then value and status of each of the task's axis
    tags. Raises UsageError unless all sources are recordings, LinkError when a recording is not as declared.
    """
    recordings = [source for source in config.sources if isinstance(source, ReplaySource)]
    if len(recordings) != len(config.sources):
        raise UsageError("replay needs a configuration whose sources are all of type replay")
    if len({config.task_of(axis).name for axis in config.axes}) > 1:
        raise UsageError("replay needs a configuration whose axes are all in one task")
    seconds = max(recording_seconds(source) for source in recordings)
    return asyncio.run(_replay(config, seconds, output))


def overlooked(config: Config) -> list[str]:
    """One sentence for each recording whose rows come closer together than the scans. Raises LinkError."""
    sentences = []
    for source in config.sources:
        if isinstance(source, ReplaySource):
            seen, rows = rows_seen(source, config.task_of(config.axes[0]).period_ms / 1000.0)
            if seen < rows:
                sentences.append(
                    f"{source.file}: {rows - seen} of {rows} rows came between two scans and were not seen; "
                    "a shorter period_ms with dt_source: source and on_repeat: predict steps every one"
                )
    return sentences


async def _replay(config: Config, seconds: float, output: TextIO) -> int:
    clock = VirtualClock()
    layout = build_layout(config)
    writer = Writer(bytearray(size(layout.table)), layout.table)
    (task,) = build_tasks(layout, writer, clock, config.realtime.kernel)
    for source in layout.tasks[0].sources:  # a link would try again for ever; here a wrong recording is an error
        await source.source.build(list(source.readings), source.writings, clock, task.period).open()
    rows = _Rows(layout, task, output)
    end = asyncio.Event()

    def on_scan(scan: Scan) -> None:
        if not all(place.link.statistics.connected for place in task.links):
            return
        rows.write(scan)
        if scan.start - rows.start >= seconds - 1e-9:
            end.set()

    task.on_scan = on_scan
    async with asyncio.TaskGroup() as group:
        running = start_tasks(group, [task])
        await end.wait()
        for coroutine in running:
            coroutine.cancel()
    return rows.count


class _Rows:
    """The CSV: a header, then one row for each scan."""

    def __init__(self, layout: Layout, task: CyclicTask, output: TextIO) -> None:
        self.start = 0.0
        self.count = 0
        self._task = task
        blocks = [block for block in layout.table.blocks if block.kind == "axis"]
        self._indices = [index for block in blocks for index in range(block.start, block.stop)]
        self._csv = csv.writer(output, lineterminator="\n")
        names = [layout.table.tags[index].name for index in self._indices]
        self._csv.writerow(["t", "dt", *names, *(f"{block.name}.Status" for block in blocks)])
        self._positions = [block.start for block in blocks]

    def write(self, scan: Scan) -> None:
        if self.count == 0:
            self.start = scan.start
        image = self._task.outputs
        values = [repr(float(image.values[index])) for index in self._indices]
        statuses = [f"0x{int(image.statuses[position]):08X}" for position in self._positions]
        self._csv.writerow([f"{scan.start - self.start:.9f}", f"{scan.dt:.9f}", *values, *statuses])
        self.count += 1
