"""The scan process: links, tasks and observers; it listens on nothing."""

import asyncio
from collections.abc import Callable
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

import structlog

from softplc.app.child import run_child
from softplc.app.dispatch import Commands
from softplc.app.garbage import Slack, freeze_garbage
from softplc.app.layout import Layout, SourceLayout, TaskLayout, WriteBackLayout, build_layout
from softplc.app.logs import configure_logs
from softplc.app.notify import Watchdog, watchdog_interval
from softplc.app.observing import build_observer
from softplc.app.realtime import apply_realtime
from softplc.clock import Clock, SystemClock
from softplc.config.models import Config, KernelChoice
from softplc.config.remarks import remarks
from softplc.errors import ConfigError
from softplc.exchange import Writer
from softplc.link import Link
from softplc.read_back import ReadBack
from softplc.scan import CyclicTask, LinkPlace
from softplc.tags import Image
from softplc.timing import Scan
from softplc.writeback import WriteBack, WriteBacks

_REPLAY_TIMEOUT = 10.0

log = structlog.get_logger(__name__)


def scan_process(config_json: str, buffer: Any, connection: "Connection[Any, Any]") -> None:
    """Entry point of the process: scan until told to stop."""
    config = Config.model_validate_json(config_json)
    configure_logs(config.log, "scan")
    run_child("scan", connection, partial(_scan, config, buffer, connection))


async def _scan(config: Config, buffer: Any, connection: "Connection[Any, Any]", stop: asyncio.Event) -> None:
    for text in remarks(config):
        log.warning("remark", text=text)
    clock = SystemClock()
    layout = build_layout(config)
    tasks = build_tasks(layout, Writer(buffer, layout.table), clock, config.realtime.kernel)
    watchdog = Watchdog(len(tasks), watchdog_interval())
    slack = Slack(clock) if config.realtime.gc_freeze else None
    for number, task in enumerate(tasks):
        task.on_scan = _scanned(watchdog, number, slack)
    apply_realtime(config.realtime)
    connection.send(("ready", {}))
    try:
        async with asyncio.TaskGroup() as group:
            running = start_tasks(group, tasks)
            if slack is not None:
                freeze_garbage()
            await stop.wait()
            for coroutine in running:
                coroutine.cancel()
    finally:
        clock.close()


def start_tasks(group: asyncio.TaskGroup, tasks: list[CyclicTask]) -> list["asyncio.Task[None]"]:
    """Start every link and every task in the group."""
    running = [group.create_task(place.link.run(), name=place.link.name) for task in tasks for place in task.links]
    return running + [group.create_task(task.run(), name=task.name) for task in tasks]


def build_tasks(layout: Layout, writer: Writer, clock: Clock, kernel: KernelChoice = "auto") -> list[CyclicTask]:
    """The cyclic tasks of a layout, ready to run. Imports the libraries of the protocols that are used."""
    image = Image(len(layout.table))
    commands = Commands(layout.table, image, writer, clock)
    tasks = [_build_task(task, image, writer, clock, commands, kernel) for task in layout.tasks]
    commands.tasks = tasks
    return tasks


def _build_task(
    layout: TaskLayout,
    image: Image,
    writer: Writer,
    clock: Clock,
    commands: Commands,
    kernel: KernelChoice,
) -> CyclicTask:
    period = layout.task.period_ms / 1000.0
    links = {source.source.name: _build_link(source, clock, period) for source in layout.sources}
    return CyclicTask(
        name=layout.task.name,
        period=period,
        priority=layout.task.priority,
        clock=clock,
        links=[LinkPlace(links[source.source.name], source.start, source.block) for source in layout.sources],
        inputs=Image(layout.inputs),
        observers=[build_observer(group, kernel, clock) for group in layout.observers],
        write_backs=WriteBacks(
            [build_write_back(each, links[each.source]) for each in layout.write_backs], layout.task.name
        ),
        outputs=image,
        block=layout.block,
        section=layout.section,
        writer=writer,
        dispatch_commands=commands.dispatch,
        commands_refused=lambda: commands.refused,
    )


def build_write_back(layout: WriteBackLayout, link: Link) -> WriteBack:
    """A write-back of the layout, into the link of its source."""
    config = layout.config
    read_back = None
    if layout.read_back is not None:
        read_back = ReadBack(layout.read_back, config.tolerance + config.rounding, config.verify_within_ms / 1000.0)
    return WriteBack(
        layout.index,
        link,
        layout.position,
        config.deadband,
        config.every_scans,
        config.min_interval_ms / 1000.0,
        read_back,
        layout.name,
        layout.state,
        layout.judge,
    )


def _build_link(layout: SourceLayout, clock: Clock, period: float) -> Link:
    source = layout.source
    stamped = {"stamped": frozenset(layout.stale_after)} if layout.tells_time and layout.stale_after else {}
    make = partial(source.build, list(layout.readings), layout.writings, clock, period, **stamped)
    try:
        make()  # imports the protocol's library now rather than on the scan's time
    except ConfigError as error:
        raise ConfigError(f"source {source.name}: {error}") from error
    timeout = getattr(source, "timeout_ms", _REPLAY_TIMEOUT * 1e3) / 1e3
    connect_timeout = getattr(source, "connect_timeout_ms", _REPLAY_TIMEOUT * 1e3) / 1e3
    names = layout.reading_names, layout.writing_names
    return Link(source.name, make, *names, clock, timeout, connect_timeout, layout.life())


def _scanned(watchdog: Watchdog, number: int, slack: Slack | None) -> Callable[[Scan], None]:
    def scanned(scan: Scan) -> None:
        watchdog.beat(number, scan.start)
        if slack is not None:
            slack.after(scan)

    return scanned
