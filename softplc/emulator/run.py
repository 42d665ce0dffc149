"""Runs an emulated PLC: the plant on an absolute time grid, its servers, and a process of its own for them."""

import asyncio
import gc
import logging
import math
import multiprocessing
import os
import signal
import socket
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Protocol

from softplc.clock import Clock, SystemClock
from softplc.emulator.aoi import AoiPrograms
from softplc.emulator.memory import MemoryState
from softplc.emulator.plant import Plant, PlantStep
from softplc.emulator.scenario import Scenario
from softplc.errors import SoftplcError
from softplc.timing import next_deadline

Endpoints = dict[str, str]
"""Protocol to address: `opcua` to `opc.tcp://127.0.0.1:4841`, `modbus` to `tcp://127.0.0.1:5021`."""

_CLOSE_WITHIN = 1.0  # seconds that a server has to drop its clients
_CLOCK_SET = 500_000_000  # ns by which the wall clock must differ before it counts as set


class _Server(Protocol):
    async def prepare(self) -> None: ...
    async def publish(self, step: PlantStep, timestamp: int) -> None: ...
    async def listen(self, port: int) -> str: ...
    async def close(self) -> None: ...


async def serve(scenario: Scenario, ready: Callable[[Endpoints], None]) -> None:
    """Run the emulated PLC until cancelled; `ready` is called once all servers listen.

    Step k is served at start + k·period with that instant as its source timestamp. A step that comes too late
    is skipped, as time goes on for the plant. Raises SoftplcError when a server cannot listen.
    """
    clock = SystemClock()
    memory = MemoryState(len(scenario.axes))
    ports = {name: claim(name, host, port) for name, host, port in _listeners(scenario)}
    servers: dict[str, _Server] = {}
    try:
        servers = _build(scenario, memory, clock)
        for server in servers.values():
            await server.prepare()
        run = _Run(scenario, list(servers.values()), memory, clock)
        await run.publish(0)
        endpoints: Endpoints = {}
        for name, server in servers.items():
            port = ports[name].getsockname()[1]
            ports[name].close()
            endpoints[name] = await server.listen(port)
        ready(endpoints)
        await run.forever()
    finally:
        for held in ports.values():
            held.close()
        await asyncio.gather(*(_close(server) for server in servers.values()))
        clock.close()


def _listeners(scenario: Scenario) -> list[tuple[str, str, int]]:
    named = (("opcua", scenario.opcua), ("modbus", scenario.modbus))
    return [(name, endpoint.host, endpoint.port) for name, endpoint in named if endpoint is not None]


def claim(name: str, host: str, port: int) -> socket.socket:
    """A socket that holds a port, or any free one for 0, until its server is built: what is wrong shows at once.

    Raises SoftplcError that names the port.
    """
    held: socket.socket | None = None
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        held = socket.socket(family, socket.SOCK_STREAM)
        held.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        held.bind((host, port))
    except OSError as error:
        if held is not None:
            held.close()
        raise SoftplcError(
            f"{name}: cannot listen on {host}:{port}: {error.strerror}; choose another port"
        ) from error
    return held


def _build(scenario: Scenario, memory: MemoryState, clock: Clock) -> dict[str, _Server]:
    servers: dict[str, _Server] = {}
    if scenario.opcua is not None:
        from softplc.emulator.opcua_server import OpcUaServer  # noqa: PLC0415  asyncua takes seconds to import

        servers["opcua"] = OpcUaServer(scenario.opcua, scenario, memory, clock)
    if scenario.modbus is not None:
        from softplc.emulator.modbus_server import ModbusServer  # noqa: PLC0415  only where it is served

        servers["modbus"] = ModbusServer(scenario.modbus, scenario, memory)
    return servers


async def _close(server: _Server) -> None:
    with suppress(TimeoutError):
        async with asyncio.timeout(_CLOSE_WITHIN):
            await server.close()


class _Run:
    """The plant on its grid."""

    def __init__(self, scenario: Scenario, servers: list[_Server], memory: MemoryState, clock: Clock) -> None:
        self._plant = Plant(scenario)
        self._programs = AoiPrograms(scenario, memory)
        self._period = scenario.period
        self._period_ns = round(scenario.period_ms * 1e6)
        self._servers = servers
        self._clock = clock
        self._start = clock.monotonic()
        self._epoch = self._measured_epoch()

    async def forever(self) -> None:
        """Publish each step when it is due."""
        while True:
            deadline, number = next_deadline(self._start, self._period, self._clock.monotonic())
            await self._clock.sleep_until(deadline)
            due = math.floor((self._clock.monotonic() - self._start) / self._period)
            await self.publish(max(number, due))

    async def publish(self, number: int) -> None:
        """Publish one step to all servers."""
        self._epoch = followed(self._epoch, self._measured_epoch())
        step = self._programs.run(self._plant.at(number))
        for server in self._servers:
            await server.publish(step, self._epoch + number * self._period_ns)

    def _measured_epoch(self) -> int:
        """Wall time of step 0, ns UTC in whole µs, by what both clocks show now."""
        epoch = self._clock.utc_ns() - round((self._clock.monotonic() - self._start) * 1e9)
        return epoch // 1000 * 1000


def followed(epoch: int, measured: int) -> int:
    """The epoch that timestamps go on with: the same one, unless somebody has set the wall clock. All ns."""
    return measured if abs(measured - epoch) > _CLOCK_SET else epoch


def run_emulator(scenario: Scenario, connection: Connection) -> None:
    """Run an emulated PLC as the target of a process; it sends ("ready", endpoints) or ("failed", text).

    SIGTERM ends it with exit code 0, and so does the end of its parent process. SIGINT is left to the parent.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: os._exit(0))  # until ready there is nothing to close
    for library in ("asyncua", "pymodbus"):  # they log what clients do wrong, with tracebacks
        logging.getLogger(library).setLevel(logging.CRITICAL)
    try:
        asyncio.run(_until_told(scenario, connection))
    except SoftplcError as error:
        _tell(connection, ("failed", str(error)))
        raise SystemExit(error.exit_code) from None


async def _until_told(scenario: Scenario, connection: Connection) -> None:
    loop = asyncio.get_running_loop()

    def ready(endpoints: Endpoints) -> None:
        gc.collect()  # a collection over asyncua's address space takes 100 ms and more: not while steps are due
        gc.freeze()
        loop.add_signal_handler(signal.SIGTERM, task.cancel)
        _tell(connection, ("ready", endpoints))

    task = asyncio.create_task(serve(scenario, ready))
    parent = multiprocessing.parent_process()
    if parent is not None:
        loop.add_reader(parent.sentinel, task.cancel)
    with suppress(asyncio.CancelledError):
        await task


def _tell(connection: Connection, message: tuple[str, Endpoints | str]) -> None:
    with suppress(OSError):  # a parent that is gone needs no answer
        connection.send(message)
