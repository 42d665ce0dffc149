"""The supervisor: starts the scan process and the gateway, restarts one that dies or is stuck, ends both in order."""

import asyncio
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import structlog

from softplc import __version__
from softplc.app.gateway import gateway_process
from softplc.app.guard import GATEWAY_LIMIT, SCAN_LIMIT, Guard, Sign, guard
from softplc.app.layout import build_layout
from softplc.app.notify import notify
from softplc.app.process import SPAWN, Child
from softplc.app.scan_process import scan_process
from softplc.clock import SystemClock
from softplc.config.models import Config
from softplc.errors import SoftplcError
from softplc.exchange import Pulse, size

_RESTARTS = 5  # of one process within the window; one more and the supervisor gives up

log = structlog.get_logger(__name__)


Endpoints = list[tuple[str, str]]


async def supervise(
    config: Config, on_ready: Callable[[Endpoints], None], stop: asyncio.Event, companion: Child | None = None
) -> int:
    """Run softplc until `stop`; returns the exit code. `on_ready` gets the endpoints once all servers listen.

    A process that dies is started anew while the others go on, and one that is stuck (guard.py) is killed for it;
    after more than five deaths of one within a minute everything stops with exit code 1. A `companion` (the demo's
    emulated PLC) is ready before the scans start, and watched and ended along.
    Raises SoftplcError when a process cannot start at all.
    """
    guards = _guards(config)
    children = [each.child for each in guards] + ([companion] if companion is not None else [])
    scan, *others = children
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
        return await _watch(children, clock, stop, guards)
    finally:
        log.info("stopping")
        notify("STOPPING=1")
        await scan.stop()  # first the scans, so that the last one is whole and nobody reads a vanishing source
        await asyncio.gather(*(child.stop() for child in others))
        clock.close()


def _guards(config: Config) -> list[Guard]:
    layout = build_layout(config)
    buffer = SPAWN.RawArray("b", size(layout.table))
    pulse, arguments = Pulse(buffer, layout.table), (config.as_json(), buffer)
    scans = [
        Sign(
            f"no scan of task {each.task.name}",
            partial(pulse.scan, each.section),
            max(SCAN_LIMIT, 3.0 * each.task.period_ms / 1000.0),
        )
        for each in layout.tasks
    ]
    guards = [Guard(Child("scan", scan_process, arguments), scans)]
    if config.publishers:
        turns = Sign("its event loop does not turn", pulse.gateway, GATEWAY_LIMIT)
        guards.append(Guard(Child("gateway", gateway_process, arguments), [turns]))
    return guards


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


async def _watch(children: list[Child], clock: SystemClock, stop: asyncio.Event, guards: Sequence[Guard] = ()) -> int:
    stopped = asyncio.create_task(stop.wait())
    guarding = asyncio.create_task(guard(guards, clock))
    ended = {asyncio.create_task(child.ended()): child for child in children}
    try:
        while True:
            await asyncio.wait([stopped, guarding, *ended], return_when=asyncio.FIRST_COMPLETED)
            if stop.is_set():
                return 0
            if guarding.done():
                guarding.result()
            for task in [task for task in ended if task.done()]:
                child = ended.pop(task)
                code = task.result()
                if len(child.starts) > _RESTARTS:
                    log.error("process dies again and again, giving up", child=child.name, exit_code=code)
                    return 1
                log.error("process died, starting it anew", child=child.name, exit_code=code)
                child.start(clock.monotonic())
                ended[asyncio.create_task(child.ended())] = child
    finally:
        waiting: list[asyncio.Task[Any]] = [stopped, guarding, *ended]
        for each in waiting:
            each.cancel()
        await asyncio.gather(*waiting, return_exceptions=True)


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
