"""The constants of softplc check's prediction, measured here: PYTHONPATH=. python bench/budget.py, about a minute.

Prints the table of softplc/app/costs.py anew: what a scan's parts cost at two sizes, as a line through them, CPU time
of this process; for a device, what the wall clock says beyond it. The device is node-opcua (SOFTPLC_PEERS) or else
asyncua, and softplc's emulated Modbus PLC, each in its own process on this machine. Then what `in_flight` does with a
Modbus device that takes 2 ms for each request, however many it has.
"""

import argparse
import asyncio
import contextlib
import gc
import json
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import numpy as np
from end_to_end import configuration, free_port, scenario, start
from opcua_client import PEERS, started

from softplc.app.layout import build_layout
from softplc.app.observing import build_observer
from softplc.clock import SystemClock
from softplc.config.load import load
from softplc.config.models import Config
from softplc.drivers.modbus.config import ModbusSource, ModbusTag
from softplc.drivers.opcua.config import OpcUaSource, OpcUaTag
from softplc.exchange import Writer, size
from softplc.tags import Image
from softplc.timing import Scan

FEW, MANY = 100, 2000
DEVICE_TAKES = 0.002
SHIPPED = Path(__file__).parent.parent / "config"
Line = tuple[float, float]


def line(few: float, many: float, sizes: Line = (FEW, MANY)) -> Line:
    """Microseconds once, and for each, through two measurements."""
    each = max((many - few) / (sizes[1] - sizes[0]), 0.0)
    return max(few - each * sizes[0], 0.0), each


def scan(number: int) -> Scan:
    return Scan(number, number * 0.05, number * 50_000_000 + 1, 0.05, 0.05, 0)


def median_us(work: Callable[[int], object], rounds: int) -> float:
    costs = []
    for number in range(rounds):
        begin = time.process_time()
        work(number)
        costs.append(time.process_time() - begin)
    return statistics.median(costs[rounds // 4 :]) * 1e6


def observed(shipped: list[Config], axis: Any, count: int) -> tuple[float, float]:
    """One scan of so many axes like this one, and its publishing, µs."""
    axes = [axis.model_copy(update={"name": f"A{number}", "write_back": (), "task": None}) for number in range(count)]
    config = shipped[0].model_copy(update={"axes": tuple(axes), "publishers": ()})
    config = config.model_copy(update={"sources": tuple(source for each in shipped for source in each.sources)})
    layout = build_layout(config)
    (task,) = layout.tasks
    (observer,) = [build_observer(group, "numpy", SystemClock()) for group in task.observers]
    inputs, outputs = Image(task.inputs), Image(len(layout.table))
    chance = np.random.default_rng(1)
    inputs.statuses[:] = 0

    def step(number: int) -> None:
        inputs.values[:] = number * 0.1 + chance.normal(0, 0.1, len(inputs))
        inputs.source_timestamps[:] = inputs.arrivals[:] = number * 0.05
        observer.step(scan(number), inputs, outputs)

    writer = Writer(bytearray(size(layout.table)), layout.table)
    rounds = 100 if count == FEW else 40
    return median_us(step, rounds), median_us(lambda n: writer.publish(0, scan(n), outputs), rounds)


async def read_costs(read: Callable[[], Awaitable[object]], rounds: int = 60) -> Line:
    """CPU and further waiting of one read, µs."""
    costs = []
    gc.freeze()
    for _ in range(rounds):
        cpu, wall = time.process_time(), time.perf_counter()
        await read()
        used = time.process_time() - cpu
        costs.append((used, time.perf_counter() - wall - used))
    gc.unfreeze()
    return statistics.median(cpu for cpu, _ in costs) * 1e6, statistics.median(wait for _, wait in costs) * 1e6


async def opcua(count: int, folder: str) -> Line:
    kind = "node-opcua" if (PEERS / "node_modules").is_dir() else "asyncua"
    async with started(kind, count, folder) as url:
        source = OpcUaSource(type="opcua", name="plc", url=url, timeout_ms=30_000, connect_timeout_ms=60_000)
        tags = [OpcUaTag(source="plc", node=f"ns=1;s=D{number}") for number in range(count)]
        driver, image = source.build(tags, (), SystemClock(), 0.05), Image(count)
        await driver.open()
        found = await read_costs(lambda: driver.read(image))
        await driver.close()
    return found


async def modbus(folder: str) -> tuple[Line, Line]:
    """Of one request, and of 20 (one request for every 5 axes of the emulated PLC)."""
    ports = {name: free_port() for name in ("plc opcua", "plc modbus", "opcua", "modbus")}
    document = scenario(100, ports, 1000.0)
    del document["opcua"]
    process, _ = start("emulate", document, Path(folder))
    results = []
    try:
        for axes in (5, 100):
            config = Config.model_validate_json(json.dumps(configuration(axes, "modbus", ports, 50)))
            source, tags = config.sources[0], [axis.input for axis in config.axes]
            driver, image = source.build(tags, (), SystemClock(), 0.05), Image(axes)  # type: ignore[arg-type]
            await driver.open()
            results.append(await read_costs(lambda driver=driver, image=image: driver.read(image)))  # type: ignore[misc]
            await driver.close()
    finally:
        process.terminate()
        process.wait()
    return results[0], results[1]


async def device() -> None:
    """Says its port; answers each request for registers with zeros, 2 ms later; ends with stdin."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        loop = asyncio.get_running_loop()
        with contextlib.suppress(asyncio.IncompleteReadError, ConnectionError):
            while True:
                head = await reader.readexactly(6)
                pdu = await reader.readexactly(struct.unpack(">H", head[4:])[0])
                data = bytes(2 * struct.unpack(">H", pdu[4:6])[0])
                body = pdu[:2] + bytes([len(data)]) + data
                loop.call_later(DEVICE_TAKES, writer.write, head[:4] + struct.pack(">H", len(body)) + body)
        writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    print(server.sockets[0].getsockname()[1], flush=True)
    await asyncio.to_thread(sys.stdin.read)


async def in_flight(port: int, count: int, many: int) -> Line:
    """One read of so many requests for a float each, so many in flight."""
    transport = {"type": "tcp", "host": "127.0.0.1", "port": port}
    keys = {"type": "modbus", "name": "plc", "in_flight": many, "max_gap": 0, "timeout_ms": 5000}
    source = ModbusSource.model_validate({**keys, "transport": transport})
    tags = [ModbusTag(source="plc", address=f"holding:{100 * number}") for number in range(count)]
    driver, image = source.build(tags, (), SystemClock(), 0.05), Image(count)
    await driver.open()
    found = await read_costs(lambda: driver.read(image), rounds=20)
    await driver.close()
    return found


def measure_in_flight() -> None:
    command = [sys.executable, __file__, "device"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        port = int(process.stdout.readline())
        for count in (100, 20):
            costs = [asyncio.run(in_flight(port, count, many)) for many in (1, 2, 4, 8, 16, 32)]
            told = " | ".join(f"{wait / 1e3:.3g} + {cpu / 1e3:.1f}" for cpu, wait in costs)
            print(f"    # ms with 1, 2, 4, 8, 16, 32 in flight: | {count} requests | {told} |", flush=True)


def shown(name: str, cost: Line) -> None:
    print(f"    {name}=Cost({cost[0]:.3g}, {cost[1]:.3g}),", flush=True)


def main() -> None:
    if sys.argv[1:2] == ["device"]:  # a process that this benchmark starts
        asyncio.run(device())
        return
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--in-flight", action="store_true", help="Modbus with several requests in flight alone")
    if parser.parse_args().in_flight:
        measure_in_flight()
        return
    shipped = [load(SHIPPED / name) for name in ("observers.yaml", "end_stops.yaml")]
    axes = {axis.observer.type: axis for config in shipped for axis in config.axes}
    publish: list[Line] = []
    print("    observers={")
    for kind, axis in sorted(axes.items()):
        (few, copied), (many, copied_many) = (observed(shipped, axis, count) for count in (FEW, MANY))
        once, each = line(few, many)
        publish.append((copied, copied_many))
        print(f'        "{kind}": Cost({once:.3g}, {each:.3g}),', flush=True)
    print("    },")
    tags = 35  # of an axis, about
    few, many = (statistics.median(pair[side] for pair in publish) for side in (0, 1))
    shown("publish", line(few, many, (tags * FEW, tags * MANY)))
    with tempfile.TemporaryDirectory() as folder:
        (cpu, wait), (cpu_many, wait_many) = (asyncio.run(opcua(count, folder)) for count in (FEW, 1000))
        shown("opcua", line(cpu, cpu_many, (FEW, 1000)))
        shown("opcua_device", line(wait, wait_many, (FEW, 1000)))
        (cpu, wait), (cpu_many, wait_many) = asyncio.run(modbus(folder))
        print(f"    # Modbus: 1 request {cpu:.0f} + {wait:.0f} µs, of 100 axes {cpu_many:.0f} + {wait_many:.0f} µs")
    measure_in_flight()


if __name__ == "__main__":
    main()
