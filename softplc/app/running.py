"""Running in the foreground: until a signal or a time limit; alone, with an emulated PLC, or the emulator alone."""

import asyncio
import signal
from collections.abc import Awaitable, Callable
from typing import Any

from softplc.app.ports import check_ports
from softplc.app.process import Child
from softplc.app.supervisor import Endpoints, run_alone, supervise
from softplc.config.models import Config

OnReady = Callable[[Endpoints], None]


def run_daemon(config: Config, seconds: float | None, on_ready: OnReady) -> int:
    """Run the configuration until SIGINT, SIGTERM or `seconds` after it was ready; returns the exit code."""
    check_ports(config)
    return _run(seconds, on_ready, lambda ready, stop: supervise(config, ready, stop))


def run_with_emulator(config: Config, scenario: Any, seconds: float | None, on_ready: OnReady) -> int:
    """Run the configuration and the emulated PLC that it reads, each in its own processes."""
    check_ports(config)
    return _run(seconds, on_ready, lambda ready, stop: supervise(config, ready, stop, _emulator(scenario)))


def run_emulator_alone(scenario: Any, seconds: float | None, on_ready: OnReady) -> int:
    """Run the emulated PLC until SIGINT, SIGTERM or `seconds` after it was ready."""
    return _run(seconds, on_ready, lambda ready, stop: run_alone(_emulator(scenario), ready, stop))


def _emulator(scenario: Any) -> Child:
    from softplc.emulator.run import run_emulator  # noqa: PLC0415  only where an emulator runs

    return Child("emulator", run_emulator, (scenario,))


def _run(seconds: float | None, on_ready: OnReady, body: Callable[[OnReady, asyncio.Event], Awaitable[int]]) -> int:
    async def until_stopped() -> int:
        stop = asyncio.Event()
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, _stop_once, stop)

        def ready(endpoints: Endpoints) -> None:
            if seconds is not None:
                loop.call_later(seconds, stop.set)
            on_ready(endpoints)

        return await body(ready, stop)

    return asyncio.run(until_stopped())


def _stop_once(stop: asyncio.Event) -> None:
    """The first signal stops everything in order; further ones, as of an impatient Ctrl-C, change nothing."""
    stop.set()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().remove_signal_handler(number)
        signal.signal(number, signal.SIG_IGN)
