"""Requests per CPU second of our Modbus server and of pymodbus' server, in one alternating run.

    python bench/modbus_server.py [--rounds 5] [--seconds 1.0]

One blocking client reads 125 registers at a time over loopback. Our server also takes over a new scan every 50 ms
meanwhile; pymodbus serves registers that never change. CPU is that of the server's process (user and system), read
from /proc. pymodbus is asked with one request in flight only: of several in one segment it answers one.
"""

import argparse
import asyncio
import contextlib
import multiprocessing
import os
import socket
import struct
import sys
import time
from collections.abc import Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from statistics import median
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent))

REGISTERS = 125
FIRST = 3000
PERIOD = 0.05
REPLY = 9 + 2 * REGISTERS
CASES = (("softplc", 1), ("pymodbus", 1), ("softplc", 8))


async def _softplc(ready: "Connection[Any, Any]") -> None:
    from softplc.clock import SystemClock
    from softplc.publishers.modbus.config import ModbusPublisher
    from softplc.publishers.modbus.server import ModbusServer
    from tests.support.exchange import make_exchange

    clock = SystemClock()
    exchange = make_exchange(clock)
    config = ModbusPublisher(type="modbus").model_copy(update={"port": 0})
    server = ModbusServer(config, exchange.reader)
    ready.send(int((await server.open()).rpartition(":")[2]))
    deadline = clock.monotonic()
    while True:
        exchange.set("AxisX.Position", float(exchange.scans))
        exchange.publish(PERIOD)
        await server.publish()
        deadline += PERIOD
        await clock.sleep_until(deadline)


async def _pymodbus(ready: "Connection[Any, Any]") -> None:
    from pymodbus.server import ModbusTcpServer
    from pymodbus.simulator import DataType, SimData, SimDevice

    data = [SimData(0, count=FIRST + 200, values=7, datatype=DataType.REGISTERS)]
    server = ModbusTcpServer(SimDevice(1, simdata=data), address=("127.0.0.1", 0))
    await server.serve_forever(background=True)
    ready.send(server.transport.sockets[0].getsockname()[1])
    await asyncio.Event().wait()


def _serve(name: str, ready: "Connection[Any, Any]") -> None:
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run({"softplc": _softplc, "pymodbus": _pymodbus}[name](ready))


@contextlib.contextmanager
def serving(name: str) -> Iterator[tuple[int, socket.socket]]:
    """A server in its own process: its pid and a connection to it."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(name, theirs), daemon=True)
    process.start()
    try:
        if not ours.poll(60):
            raise TimeoutError(f"{name} did not start within 60 s")
        connection = socket.create_connection(("127.0.0.1", ours.recv()), timeout=20)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        with connection:
            yield process.pid or 0, connection
    finally:
        process.terminate()
        process.join(10)


def cpu_seconds(pid: int) -> float:
    """CPU that a process used since it started."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def run(pid: int, connection: socket.socket, in_flight: int, seconds: float) -> tuple[int, float, float]:
    """Read for so long; requests answered, wall seconds, CPU seconds of the server."""
    burst = b"".join(struct.pack(">HHHBBHH", n, 0, 6, 1, 4, FIRST, REGISTERS) for n in range(in_flight))
    buffer = bytearray(REPLY * in_flight)
    requests, start, cpu = 0, time.perf_counter(), cpu_seconds(pid)
    while time.perf_counter() - start < seconds:
        connection.sendall(burst)
        received = 0
        while received < len(buffer):
            count = connection.recv_into(memoryview(buffer)[received:])
            if not count:
                raise ConnectionError("the server closed the connection")
            received += count
        if buffer[7] != 4:
            raise ValueError(f"not the answer to a read: {bytes(buffer[:9]).hex()}")
        requests += in_flight
    return requests, time.perf_counter() - start, cpu_seconds(pid) - cpu


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=1.0)
    options = parser.parse_args()
    results: dict[tuple[str, int], list[tuple[float, float]]] = {case: [] for case in CASES}
    with serving("softplc") as softplc, serving("pymodbus") as pymodbus:
        servers = {"softplc": softplc, "pymodbus": pymodbus}
        for _ in range(options.rounds):
            for name, in_flight in CASES:
                requests, wall, cpu = run(*servers[name], in_flight, options.seconds)
                results[name, in_flight].append((wall / requests * 1e6, requests / max(cpu, 0.01)))
    base = median(rate for _, rate in results["pymodbus", 1])
    print(
        f"| server ({REGISTERS} registers per request) | in flight | wall µs/request | requests/CPU s | × pymodbus |"
    )
    print("|---|---|---|---|---|")
    for (name, in_flight), rounds in results.items():
        wall, rate = median(wall for wall, _ in rounds), median(rate for _, rate in rounds)
        low, high = min(rate for _, rate in rounds) / base, max(rate for _, rate in rounds) / base
        print(f"| {name} | {in_flight} | {wall:.0f} | {rate:,.0f} | {rate / base:.1f} ({low:.1f}…{high:.1f}) |")


if __name__ == "__main__":
    main()
