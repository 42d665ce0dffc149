"""Running in the foreground: until a signal or a time limit; alone, with an emulated PLC, or the emulator alone."""

import asyncio
import signal
from collections.abc import Callable
from typing import Any

from softplc.app.supervisor import Child, Endpoints, check_ports, supervise
from softplc.config.models import Config
from softplc.errors import SoftplcError

OnReady = Callable[[Endpoints], None]


def run_daemon(config: Config, seconds: float | None, on_ready: OnReady) -> int:
    """Run the configuration until SIGINT, SIGTERM or `seconds` after it was ready; returns the exit code."""
    check_ports(config)
    return asyncio.run(_until_stopped(lambda stop: _supervised(config, seconds, on_ready, stop)))


def run_with_emulator(config: Config, scenario: Any, seconds: float | None, on_ready: OnReady) -> int:
    """Run the configuration and the emulated PLC that it reads, each in its own processes."""

    async def body(stop: asyncio.Event) -> int:
        emulator = _emulator(scenario)
        emulator.start(asyncio.get_running_loop().time())
        watch = asyncio.create_task(_fail_with(emulator, stop))
        try:
            code = await _supervised(config, seconds, on_ready, stop)
        finally:
            watch.cancel()
            await emulator.stop()
        if watch.done() and not watch.cancelled():
            watch.result()
        return code

    check_ports(config)
    return asyncio.run(_until_stopped(body))


def run_emulator_alone(scenario: Any, seconds: float | None, on_ready: OnReady) -> int:
    """Run the emulated PLC until SIGINT, SIGTERM or `seconds` after it was ready."""

    async def body(stop: asyncio.Event) -> int:
        emulator = _emulator(scenario)
        emulator.start(asyncio.get_running_loop().time())
        watch = asyncio.create_task(_fail_with(emulator, stop))
        assert emulator.ready is not None
        try:
            message = await emulator.ready
            if message is not None and message[0] == "ready":
                on_ready(list(message[1].items()))
                _stop_after(seconds, stop)
                await stop.wait()
        finally:
            if not watch.done():
                watch.cancel()
            await emulator.stop()
        if watch.done() and not watch.cancelled():
            watch.result()
        return 0

    return asyncio.run(_until_stopped(body))


def _emulator(scenario: Any) -> Child:
    from softplc.emulator.run import run_emulator  # noqa: PLC0415  only where an emulator runs

    return Child("emulator", run_emulator, (scenario,))


async def _fail_with(emulator: Child, stop: asyncio.Event) -> None:
    """Wait for the emulator's end, which nobody asked for: stop, and raise what it said."""
    code = await emulator.ended()
    stop.set()
    message = emulator.ready.result() if emulator.ready is not None else None
    if message is not None and message[0] == "failed":
        raise SoftplcError(str(message[-1]))
    raise SoftplcError(f"the emulated PLC ended by itself with exit code {code}; its log says why")


async def _supervised(config: Config, seconds: float | None, on_ready: OnReady, stop: asyncio.Event) -> int:
    def ready(endpoints: Endpoints) -> None:
        _stop_after(seconds, stop)
        on_ready(endpoints)

    return await supervise(config, ready, stop)


def _stop_after(seconds: float | None, stop: asyncio.Event) -> None:
    if seconds is not None:
        asyncio.get_running_loop().call_later(seconds, stop.set)


async def _until_stopped(body: Callable[[asyncio.Event], Any]) -> int:
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop.set)
    return int(await body(stop))
