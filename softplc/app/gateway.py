"""The gateway process: everything that listens, served from the exchange's newest snapshot."""

import asyncio
from contextlib import AsyncExitStack
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

import structlog

from softplc.app.child import run_child
from softplc.app.garbage import freeze_garbage
from softplc.app.layout import build_layout
from softplc.app.logs import configure_logs
from softplc.clock import SystemClock
from softplc.config.models import Config
from softplc.exchange import Reader
from softplc.feed import Feed
from softplc.interfaces import Publisher

_BEAT = 0.5  # seconds between two signs of life for the supervisor
_FASTEST = 0.02  # seconds; nobody looks more often, and a feed costs CPU

log = structlog.get_logger(__name__)


def gateway_process(config_json: str, buffer: Any, connection: "Connection[Any, Any]") -> None:
    """Entry point of the process: serve until told to stop. Sends ("ready", {type: endpoint}) when all listen."""
    config = Config.model_validate_json(config_json)
    configure_logs(config.log, "gateway")
    run_child("gateway", connection, partial(_serve, config, buffer, connection))


async def _serve(config: Config, buffer: Any, connection: "Connection[Any, Any]", stop: asyncio.Event) -> None:
    clock = SystemClock()
    reader = Reader(buffer, build_layout(config).table, clock)
    endpoints = []
    publishers: list[tuple[Any, Publisher]] = []
    async with AsyncExitStack() as stack:
        stack.callback(clock.close)
        for settings in config.publishers:
            publisher = settings.build(reader)
            endpoints.append((settings.type, await publisher.open()))
            stack.push_async_callback(publisher.close)
            publishers.append((settings, publisher))
        freeze_garbage()
        start = clock.monotonic()
        feeds = [
            Feed(settings.type, publisher, clock, _interval(config, settings), start)
            for settings, publisher in publishers
        ]
        connection.send(("ready", endpoints))
        async with asyncio.TaskGroup() as group:
            running = [group.create_task(feed.run(), name=feed.name) for feed in feeds]
            running.append(group.create_task(_beat(reader, clock), name="beat"))
            await stop.wait()
            for task in running:
                task.cancel()


async def _beat(reader: Reader, clock: SystemClock) -> None:
    while True:
        reader.beat()
        await clock.sleep_until(clock.monotonic() + _BEAT)


def _interval(config: Config, settings: Any) -> float:
    configured = getattr(settings, "interval_ms", None)
    if configured is not None:
        return float(configured) / 1000.0
    return max(min(task.period_ms for task in config.tasks) / 1000.0, _FASTEST)
