"""One process of softplc's as the supervisor holds it: spawned, heard, waited for, ended."""

import asyncio
import multiprocessing
import signal
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from typing import Any, Final

import structlog

SPAWN: Final = multiprocessing.get_context("spawn")  # never fork: threads and event loops do not survive it
RESTART_WINDOW: Final = 60.0  # seconds over which starts are counted
_STOP_LIMIT = 0.9  # seconds for the scan process, and then for the others, to end by themselves

log = structlog.get_logger(__name__)


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
        self.starts = [*(start for start in self.starts if now - start < RESTART_WINDOW), now]
        self.connection, theirs = SPAWN.Pipe(duplex=False)
        self.ready = asyncio.get_running_loop().create_future()
        self.process = SPAWN.Process(target=self.target, args=(*self.arguments, theirs), name=f"softplc-{self.name}")
        resource_tracker.ensure_running()  # its own start unblocks SIGINT
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

    @property
    def alive(self) -> bool:
        """The process runs, or is stopped."""
        return self.process is not None and bool(self.process.is_alive())

    def kill(self) -> None:
        """SIGKILL, which ends a stopped process as well."""
        self.process.kill()

    async def stop(self) -> None:
        """SIGTERM, and SIGKILL for one that does not end within the limit."""
        if not self.alive:
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
