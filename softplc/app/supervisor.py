"""The supervisor: starts the scan process and the gateway, restarts one that dies, ends both in order."""

import asyncio
from collections.abc import Callable
from typing import Any

import structlog

from softplc import __version__
from softplc.app.gateway import gateway_process
from softplc.app.layout import build_layout
from softplc.app.notify import notify
from softplc.app.process import SPAWN, Child
from softplc.app.scan_process import scan_process
from softplc.clock import SystemClock
from softplc.config.models import Config
from softplc.errors import SoftplcError
from softplc.exchange import size

_RESTARTS = 5  # of one process within the window; one more and the supervisor gives up

log = structlog.get_logger(__name__)


Endpoints = list[tuple[str, str]]


async def supervise(
    config: Config, on_ready: Callable[[Endpoints], None], stop: asyncio.Event, companion: Child | None = None
) -> int:
    """Run softplc until `stop`; returns the exit code. `on_ready` gets the endpoints once all servers listen.

    A process that dies is started anew while the others go on; after more than five deaths of one within a minute
    everything stops with exit code 1. A `companion` (the demo's emulated PLC) is ready
    before the scans start, and watched and ended along.
    Raises SoftplcError when a process cannot start at all.
    """
    scan, *others = children = _children(config) + ([companion] if companion is not None else [])
    clock = SystemClock()
    try:
        for child in others:
            child.start(clock.monotonic())
        if companion is not None:
            await _await_ready([companion], stop)
        scan.start(clock.monotonic())
        endpoints = await _await_ready(children, stop)
        if not stop.is_set():
            on_ready(endpoints)
            log.info(
                "started",
                version=__version__,
                axes=len(config.axes),
                endpoints=[endpoint for _, endpoint in endpoints],
            )
            notify(f"READY=1\nSTATUS=scanning {len(config.axes)} axes")
        return await _watch(children, clock, stop)
    finally:
        log.info("stopping")
        notify("STOPPING=1")
        await scan.stop()  # first the scans, so that the last one is whole and nobody reads a vanishing source
        await asyncio.gather(*(child.stop() for child in others))
        clock.close()


def _children(config: Config) -> list[Child]:
    buffer = SPAWN.RawArray("b", size(build_layout(config).table))
    arguments = (config.as_json(), buffer)
    children = [Child("scan", scan_process, arguments)]
    if config.publishers:
        children.append(Child("gateway", gateway_process, arguments))
    return children


async def _await_ready(children: list[Child], stop: asyncio.Event) -> Endpoints:
    endpoints: Endpoints = []
    stopped = asyncio.create_task(stop.wait())
    try:
        for child in children:
            assert child.ready is not None
            await asyncio.wait([child.ready, stopped], return_when=asyncio.FIRST_COMPLETED)
            if stop.is_set():
                return []
            message = _succeeded(child)
            if child.name == "gateway":
                endpoints += message
    finally:
        stopped.cancel()
    return endpoints


def _succeeded(child: Child) -> Any:
    """What the child said when it was ready. Raises SoftplcError with its exit code when it failed or ended."""
    message = child.ready.result() if child.ready is not None else None
    if message is None:
        raise SoftplcError(f"the {child.name} process ended while it started; its log says why")
    if message[0] == "failed":
        error = SoftplcError(str(message[-1]))
        error.exit_code = message[1] if isinstance(message[1], int) else SoftplcError.exit_code
        raise error
    return message[1]


async def _watch(children: list[Child], clock: SystemClock, stop: asyncio.Event) -> int:
    stopped = asyncio.create_task(stop.wait())
    ended = {asyncio.create_task(child.ended()): child for child in children}
    try:
        while True:
            done, _ = await asyncio.wait([stopped, *ended], return_when=asyncio.FIRST_COMPLETED)
            if stop.is_set():
                return 0
            for task in done - {stopped}:
                child = ended.pop(task)
                code = task.result()
                if len(child.starts) > _RESTARTS:
                    log.error("process dies again and again, giving up", child=child.name, exit_code=code)
                    return 1
                log.error("process died, starting it anew", child=child.name, exit_code=code)
                child.start(clock.monotonic())
                ended[asyncio.create_task(child.ended())] = child
    finally:
        for task in (stopped, *ended):
            task.cancel()
        await asyncio.gather(stopped, *ended, return_exceptions=True)


async def run_alone(child: Child, on_ready: Callable[[Endpoints], None], stop: asyncio.Event) -> int:
    """Run one process until `stop`; its ready message is a mapping of endpoints. Its own end is an error."""
    clock = SystemClock()
    try:
        child.start(clock.monotonic())
        await _await_ready([child], stop)
        if not stop.is_set():
            on_ready(list(_succeeded(child).items()))
        return await _watch([child], clock, stop)
    finally:
        await child.stop()
        clock.close()
