"""Cost of the OPC-UA server: PYTHONPATH=. python bench/opcua_server.py [start|publish|browse].

Start: seconds and resident memory for 2, 100, 500 and 1 000 axes, each in a fresh process. Publish: CPU for each call
with 50 and 500 changed tags, without a client, and with one that monitors all of the changed ones (its own process).
"""

import argparse
import asyncio
import contextlib
import resource
import statistics
import subprocess
import sys
import time

from asyncua import Client, ua

from softplc.clock import SystemClock
from softplc.exchange import Reader, Writer, size
from softplc.observers.aoi import AoiConfig
from softplc.observers.axes import AxisSpec, axis_tags
from softplc.publishers.opcua.config import OpcUaPublisher
from softplc.tags import Image, TagTable
from softplc.timing import Scan
from tests.support.network import free_port

OBSERVER = AoiConfig(type="aoi", r_x=1.0)


def make_table(axes: int) -> TagTable:
    table = TagTable()
    for number in range(axes):
        spec = AxisSpec(f"Axis{number:03d}", unit="mm")
        table.add_block(spec.name, "axis", axis_tags(spec, OBSERVER))
    table.close_section("main")
    return table


class Plant:
    """An exchange whose every tag is Good, and the server that publishes it."""

    def __init__(self, axes: int) -> None:
        self.clock = SystemClock()
        self.table = make_table(axes)
        buffer = bytearray(size(self.table))
        self.writer, self.image = Writer(buffer, self.table), Image(len(self.table))
        self.image.statuses[:] = 0
        self.image.values[:] = 0.0
        self.scans = 0
        self.port = free_port()
        self.server = OpcUaPublisher(type="opcua", port=self.port).build(Reader(buffer, self.table, self.clock))

    def scan(self, changed: int) -> None:
        self.scans += 1
        now = self.clock.utc_ns()
        self.image.values[:changed] = self.scans % 2
        self.image.source_timestamps[:changed] = now
        scan = Scan(self.scans, self.clock.monotonic(), now, 0.05, 0.05, 0)
        self.writer.publish(0, scan, self.image)


async def start(axes: int) -> None:
    begun, cpu = time.perf_counter(), time.process_time()
    plant = Plant(axes)
    imported = time.process_time() - cpu
    await plant.server.open()
    opened = time.process_time() - cpu - imported
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{axes:4d} axes, {len(plant.table):6d} tags: CPU import {imported:.2f} s, open {opened:.2f} s, ", end="")
    print(f"wall {time.perf_counter() - begun:.2f} s, {memory:.0f} MiB")
    await plant.server.close()


async def publish() -> None:
    plant = Plant(100)
    await plant.server.open()
    for changed in (50, 500):
        await measure(plant, changed, "no client")
        arguments = [sys.executable, __file__, "client", str(plant.port), str(changed)]
        pipe = asyncio.subprocess.PIPE
        client = await asyncio.create_subprocess_exec(*arguments, stdin=pipe, stdout=pipe)
        assert client.stdout is not None
        await client.stdout.readline()
        await measure(plant, changed, f"{changed} monitored")
        await client.communicate(b"")  # end of its input: it says goodbye
    await plant.server.close()


async def measure(plant: Plant, changed: int, what: str, scans: int = 100) -> None:
    costs, begun, cpu = [], time.perf_counter(), time.process_time()
    for number in range(scans):
        plant.scan(changed)
        before = time.process_time()
        await plant.server.publish()
        costs.append(time.process_time() - before)
        await asyncio.sleep(max(begun + (number + 1) * 0.05 - time.perf_counter(), 0))
    whole = (time.process_time() - cpu) / scans
    print(f"{changed:4d} of {len(plant.table)} tags changed, {what:13s}: CPU of publish() ", end="")
    print(f"{statistics.median(costs) * 1e3:.3f} ms, of the whole process {whole * 1e3:.3f} ms for each")


async def client(port: int, count: int) -> None:
    class Handler:
        def datachange_notification(self, *_: object) -> None:
            pass

    names = [tag.name for tag in make_table(100)][:count]
    async with Client(f"opc.tcp://127.0.0.1:{port}") as opcua:
        subscription = await opcua.create_subscription(50, Handler())
        for first in range(0, count, 100):
            await subscription.subscribe_data_change(
                [opcua.get_node(f"ns=2;s={name}") for name in names[first : first + 100]]
            )
        print("ready", flush=True)
        await asyncio.to_thread(sys.stdin.read)


async def browse() -> None:
    plant = Plant(500)
    await plant.server.open()
    async with Client(f"opc.tcp://127.0.0.1:{plant.port}", timeout=60) as opcua:
        for name in ("/softplc/Axes", "Axis000"):
            before = time.process_time()
            children = await opcua.get_node(ua.NodeId(name, 2)).get_children()
            cost = (time.process_time() - before) * 1e3
            print(f"browse {name}: {len(children)} children, {cost:.1f} ms CPU, both ends")
    await plant.server.close()


def main() -> None:
    if sys.argv[1:2] == ["client"]:  # a process that a benchmark starts
        with contextlib.suppress(KeyboardInterrupt):
            asyncio.run(client(int(sys.argv[2]), int(sys.argv[3])))
        return
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", choices=("all", "start", "publish", "browse"), default="all")
    parser.add_argument("axes", nargs="?", type=int, help="start: of so many axes alone, in this process")
    options = parser.parse_args()
    if options.axes is not None:
        if options.what != "start":
            parser.error("a number of axes goes with start alone")
        asyncio.run(start(options.axes))
        return
    if options.what in ("all", "start"):
        for axes in (2, 100, 500, 1000):
            subprocess.run([sys.executable, __file__, "start", str(axes)], check=True)
    if options.what in ("all", "publish"):
        asyncio.run(publish())
    if options.what in ("all", "browse"):
        asyncio.run(browse())


if __name__ == "__main__":
    main()
