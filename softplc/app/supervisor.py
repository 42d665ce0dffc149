"""The supervisor: starts the scan process and the gateway, restarts one that dies, ends both in order."""

import asyncio
import multiprocessing
import signal
import socket
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import Any

import structlog

from softplc.app.gateway import gateway_process
from softplc.app.layout import build_layout
from softplc.app.notify import notify
from softplc.app.scan_process import scan_process
from softplc.clock import SystemClock
from softplc.config.models import Config
from softplc.errors import SoftplcError
from softplc.exchange import size

_RESTARTS = 5  # of one process within the window; one more and the supervisor gives up
_WINDOW = 60.0
_STOP_LIMIT = 0.9  # seconds for the scan process, and then for the others, to end by themselves

log = structlog.get_logger(__name__)
_spawn = multiprocessing.get_context("spawn")


@dataclass(slots=True)
class Child:
    """One process of softplc's: what it runs, and its life."""

    name: str
    target: Callable[..., None]
    arguments: tuple[Any, ...]
    process: Any = None
    connection: "Connection[Any, Any] | None" = None
    ready: "asyncio.Future[Any] | None" = None
    starts: list[float] = field(default_factory=list)

    def start(self, now: float) -> None:
        """Spawn the process. It is born with SIGINT blocked: Ctrl-C on the terminal is the supervisor's to handle."""
        self.starts = [*(start for start in self.starts if now - start < _WINDOW), now]
        self.connection, theirs = _spawn.Pipe(duplex=False)
        self.ready = asyncio.get_running_loop().create_future()
        self.process = _spawn.Process(target=self.target, args=(*self.arguments, theirs), name=f"softplc-{self.name}")
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            self.process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()
        asyncio.get_running_loop().add_reader(self.connection.fileno(), self._on_message)

    async def ended(self) -> int:
        """Wait until the process is gone; returns its exit code."""
        loop = asyncio.get_running_loop()
        gone = asyncio.Event()
        sentinel = self.process.sentinel
        loop.add_reader(sentinel, gone.set)
        try:
            await gone.wait()
        finally:
            loop.remove_reader(sentinel)
        self._on_message()
        self._hang_up()
        self.process.join()
        return int(self.process.exitcode)

    async def stop(self) -> None:
        """SIGTERM, and SIGKILL for one that does not end within the limit."""
        if self.process is None or not self.process.is_alive():
            return
        self.process.terminate()
        try:
            async with asyncio.timeout(_STOP_LIMIT):
                await self.ended()
        except TimeoutError:
            log.warning("process did not end by itself, killed", child=self.name)
            self.process.kill()
            await self.ended()

    def _on_message(self) -> None:
        try:
            while self.connection is not None and self.connection.poll():
                message = self.connection.recv()
                if self.ready is not None and not self.ready.done():
                    self.ready.set_result(message)
        except (EOFError, OSError):
            self._hang_up()

    def _hang_up(self) -> None:
        if self.connection is not None:
            asyncio.get_running_loop().remove_reader(self.connection.fileno())
            self.connection.close()
            self.connection = None
        if self.ready is not None and not self.ready.done():
            self.ready.set_result(None)


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
            notify(f"READY=1\nSTATUS=scanning {len(config.axes)} axes")
        return await _watch(children, clock, stop)
    finally:
        notify("STOPPING=1")
        await scan.stop()  # first the scans, so that the last one is whole and nobody reads a vanishing source
        await asyncio.gather(*(child.stop() for child in others))
        clock.close()


def _children(config: Config) -> list[Child]:
    buffer = _spawn.RawArray("b", size(build_layout(config).table))
    arguments = (config.model_dump_json(), buffer)
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


def check_ports(config: Config) -> None:
    """Fail before anything starts when a port that is to be listened on is taken. Raises SoftplcError."""
    for publisher in config.publishers:
        if not port_is_free(publisher.host, publisher.port):
            raise SoftplcError(
                f"{publisher.host}:{publisher.port} for the {publisher.type} server is in use; "
                f"end what listens there or choose another port"
            )


def port_is_free(host: str, port: int) -> bool:
    """True when nobody listens on the port now."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError:
            return False
    return True
