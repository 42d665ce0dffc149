"""What the scan process and the gateway share: signals, the life line to the supervisor, the exit code."""

import asyncio
import contextlib
import multiprocessing
import signal
import sys
from collections.abc import Awaitable, Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import structlog

from softplc.clock import monotonic
from softplc.errors import SoftplcError
from softplc.log_limit import LogLimit

Body = Callable[[asyncio.Event], Awaitable[None]]

log = structlog.get_logger(__name__)


def run_child(
    name: str, connection: "Connection[Any, Any]", body: Callable[[asyncio.Event], Awaitable[None]]
) -> None:
    """Run `body(stop)` in an event loop; `stop` is set by SIGTERM or when the supervisor is gone.

    A SoftplcError is told to the supervisor as ("failed", exit code, text) and becomes this process' exit code.
    SIGINT is left to the supervisor: a terminal sends it to everyone.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(OSError):  # what ps and top show; only Linux has it
        Path("/proc/self/comm").write_text(f"softplc-{name}", encoding="ascii")
    try:
        asyncio.run(_run(body))
    except* SoftplcError as group:
        error = _first(group)
        connection.send(("failed", error.exit_code, str(error)))
        sys.exit(error.exit_code)


async def _run(body: Body) -> None:
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    loop.add_signal_handler(signal.SIGTERM, stop.set)
    loop.set_exception_handler(_Unhandled().tell)
    parent = multiprocessing.parent_process()
    if parent is not None:
        loop.add_reader(parent.sentinel, stop.set)
    try:
        await body(stop)
    finally:
        if parent is not None:
            loop.remove_reader(parent.sentinel)


class _Unhandled:
    """What callbacks and tasks of the libraries raised and nobody took: told, some a minute, and nothing more."""

    def __init__(self) -> None:
        self._limit = LogLimit()

    def tell(self, _loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """The event loop's exception handler."""
        room = self._limit.ask(monotonic())
        if room is not None:
            error = context.get("exception")
            log.error("unhandled in the event loop", text=context.get("message"), exc_info=error, **room)


def _first(group: "BaseExceptionGroup[SoftplcError]") -> SoftplcError:
    error = group.exceptions[0]
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    return error
