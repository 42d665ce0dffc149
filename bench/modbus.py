"""Modbus TCP reads of 125 registers: softplc, pymodbus and libmodbus, each client against its own server, in turns.

    python bench/modbus.py [--rounds 7] [--seconds 0.5]

Client and server are a process each; CPU is that of both, user and system. One turn of softplc is reads of a whole
driver, 16 requests of 62 floats and a word each, decoded into the process image; pymodbus and libmodbus give lists of
words. softplc's server takes over a new scan every 50 ms meanwhile, the others' registers never change. libmodbus is
called through ctypes, its server by two calls for each request.
"""

import argparse
import asyncio
import ctypes
import multiprocessing
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from statistics import median
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent))

REGISTERS, REQUESTS = 125, 16
PERIOD = 0.05


async def _softplc(ready: "Connection[Any, Any]") -> None:
    from softplc.clock import SystemClock
    from tests.publishers_modbus.support import full_exchange, serving

    clock = SystemClock()
    exchange = full_exchange(clock)
    async with serving(exchange) as served:
        ready.send(served.port)
        deadline = clock.monotonic()
        while True:
            exchange.publish(PERIOD)
            await served.server.publish()
            deadline += PERIOD
            await clock.sleep_until(deadline)


async def _pymodbus(ready: "Connection[Any, Any]") -> None:
    from pymodbus.server import ModbusTcpServer
    from pymodbus.simulator import DataType, SimData, SimDevice

    data = [SimData(0, count=REGISTERS * REQUESTS, values=7, datatype=DataType.REGISTERS)]
    server = ModbusTcpServer(SimDevice(1, simdata=data), address=("127.0.0.1", 0))
    await server.serve_forever(background=True)
    ready.send(server.transport.sockets[0].getsockname()[1])
    await asyncio.Event().wait()


def _libmodbus(ready: "Connection[Any, Any]") -> None:
    import socket

    from tests.support.libmodbus import library

    modbus = library()
    assert modbus is not None
    with socket.socket() as probe:  # libmodbus does not tell which port it got
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    context = modbus.modbus_new_tcp(b"127.0.0.1", port)
    mapping = modbus.modbus_mapping_new(0, 0, REGISTERS * REQUESTS, 0)
    listener = ctypes.c_int(modbus.modbus_tcp_listen(context, 1))
    ready.send(port)
    modbus.modbus_tcp_accept(context, ctypes.byref(listener))
    query = (ctypes.c_uint8 * 260)()
    while (size := modbus.modbus_receive(context, query)) >= 0:
        modbus.modbus_reply(context, query, size, mapping)


def _serve(name: str, ready: "Connection[Any, Any]") -> None:
    if name == "libmodbus":
        _libmodbus(ready)
    else:
        asyncio.run({"softplc": _softplc, "pymodbus": _pymodbus}[name](ready))


@contextmanager
def serving(name: str) -> Iterator[tuple[int, int]]:
    """A server in its own process: its pid and its port."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(name, theirs), daemon=True)
    process.start()
    try:
        if not ours.poll(60):
            raise TimeoutError(f"{name} did not start within 60 s")
        yield process.pid or 0, ours.recv()
    finally:
        process.kill()
        process.join(10)


def cpu_seconds(pid: int) -> float:
    """CPU that a process of one thread used since it started, exact to what the scheduler knows."""
    return int(Path(f"/proc/{pid}/schedstat").read_text().split()[0]) / 1e9


class Softplc:
    """A driver that reads everything again and again."""

    def __init__(self, port: int, in_flight: int) -> None:
        from softplc.clock import SystemClock
        from softplc.drivers.modbus.config import ModbusSource, ModbusTag, TcpTransport
        from softplc.drivers.modbus.driver import ModbusDriver
        from softplc.tags import Image

        fields = {"transport": TcpTransport(host="127.0.0.1", port=port), "timeout_ms": 20_000.0}
        source = ModbusSource(type="modbus", name="plc", in_flight=in_flight, **fields)
        tags = []
        for start in range(0, REGISTERS * REQUESTS, REGISTERS):
            tags += [ModbusTag(source="plc", address=f"holding:{start + 2 * n}") for n in range(REGISTERS // 2)]
            tags.append(ModbusTag(source="plc", address=f"holding:{start + REGISTERS - 1}", data_type="uint16"))
        self.runner = asyncio.Runner()
        self._driver = ModbusDriver(source, tags, (), SystemClock())
        self._image = Image(len(tags))
        self.runner.run(self._driver.open())

    def reads(self, until: float) -> int:
        async def read() -> int:
            requests = 0
            while time.perf_counter() < until:
                await self._driver.read(self._image)
                requests += REQUESTS
            return requests

        return self.runner.run(read())


class Pymodbus:
    """pymodbus' own asyncio client."""

    def __init__(self, port: int) -> None:
        from pymodbus.client import AsyncModbusTcpClient

        self.runner = asyncio.Runner()

        async def connect() -> Any:
            client = AsyncModbusTcpClient("127.0.0.1", port=port, timeout=20)
            assert await client.connect()
            return client

        self._client = self.runner.run(connect())

    def reads(self, until: float) -> int:
        async def read() -> int:
            requests = 0
            while time.perf_counter() < until:
                for number in range(REQUESTS):
                    reply = await self._client.read_holding_registers(number * REGISTERS, count=REGISTERS)
                    assert len(reply.registers) == REGISTERS
                requests += REQUESTS
            return requests

        return self.runner.run(read())


class Libmodbus:
    """libmodbus' client."""

    def __init__(self, port: int) -> None:
        from tests.support.libmodbus import library

        modbus = library()
        assert modbus is not None
        self._modbus, self._context = modbus, modbus.modbus_new_tcp(b"127.0.0.1", port)
        modbus.modbus_set_slave(self._context, 1)
        if modbus.modbus_connect(self._context) != 0:
            raise ConnectionError("libmodbus cannot connect")
        self._words = (ctypes.c_uint16 * REGISTERS)()

    def reads(self, until: float) -> int:
        requests = 0
        while time.perf_counter() < until:
            for number in range(REQUESTS):
                read = self._modbus.modbus_read_registers
                assert read(self._context, number * REGISTERS, REGISTERS, self._words) == REGISTERS
            requests += REQUESTS
        return requests


def measure(client: Any, pid: int, seconds: float) -> tuple[float, float, float, float]:
    """Requests per CPU second of both; µs of wall, of the client's CPU and of the server's for each request."""
    wall, server, own = time.perf_counter(), cpu_seconds(pid), time.process_time()
    requests = client.reads(wall + seconds)
    own, server = time.process_time() - own, cpu_seconds(pid) - server
    wall = time.perf_counter() - wall
    return requests / (own + server), wall / requests * 1e6, own / requests * 1e6, server / requests * 1e6


def main() -> None:
    from tests.support.libmodbus import library

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--seconds", type=float, default=0.5)
    options = parser.parse_args()
    cases: list[tuple[str, int]] = [("softplc", 1), ("softplc", 8), ("pymodbus", 1)]
    if library() is None:
        print("libmodbus is not installed (Debian: libmodbus5); its rows are left out", file=sys.stderr)
    else:
        cases.append(("libmodbus", 1))
    with ExitStack() as stack:
        pairs: dict[tuple[str, int], tuple[Any, int]] = {}
        for name, in_flight in cases:
            pid, port = stack.enter_context(serving(name))
            made = {"softplc": lambda p=port, n=in_flight: Softplc(p, n), "pymodbus": lambda p=port: Pymodbus(p)}
            pairs[name, in_flight] = made.get(name, lambda p=port: Libmodbus(p))(), pid
        results: dict[tuple[str, int], list[tuple[float, ...]]] = {case: [] for case in cases}
        for _ in range(options.rounds):
            for case, (client, pid) in pairs.items():
                results[case].append(measure(client, pid, options.seconds))
    print_table(results)


def print_table(results: dict[tuple[str, int], list[tuple[float, ...]]]) -> None:
    """Medians, and the ratios of each round's rates: median, lowest and highest."""
    others = [case for case in (("pymodbus", 1), ("libmodbus", 1)) if case in results]
    titles = ["client ↔ server", "in flight", "wall µs", "client µs", "server µs", "requests/CPU s"]
    print(f"| {' | '.join([*titles, *(f'× {name}' for name, _ in others)])} |")
    print(f"|{'---|' * (len(titles) + len(others))}")
    for (name, in_flight), rounds in results.items():
        rate, wall, own, server = (median(column) for column in zip(*rounds, strict=True))
        cells = [name, str(in_flight), f"{wall:.0f}", f"{own:.0f}", f"{server:.0f}", f"{rate:,.0f}"]
        for other in others:
            ratios = [mine[0] / theirs[0] for mine, theirs in zip(rounds, results[other], strict=True)]
            cells.append(f"{median(ratios):.2f} ({min(ratios):.2f}…{max(ratios):.2f})")
        print(f"| {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
