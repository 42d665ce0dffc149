"""CPU of the OPC-UA client: PYTHONPATH=. python bench/opcua_client.py, about a minute.

The goals are 15 times less than asyncua's at 1 000 Doubles and 50 times at 5 000. One read of 1 000 and 5 000
Doubles, from an asyncua server and from node-opcua (SOFTPLC_PEERS, default tests/peers): the OPC-UA source in mode
poll, image included, against asyncua's client with one Read of as many nodes (which gives DataValues). Both in one
process, in turns; each server in its own. Median CPU and wall time for each read. Then a write of 1 000 Doubles, and
1 000 reported changes from the bytes of the message into the image, without a server.
"""

import argparse
import asyncio
import gc
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from asyncua import Client, ua
from asyncua.ua.ua_binary import struct_to_binary

from softplc.clock import SystemClock
from softplc.drivers.opcua.binding import group, put
from softplc.drivers.opcua.config import OpcUaSource, OpcUaTag
from softplc.drivers.opcua.driver import OpcUaDriver
from softplc.drivers.opcua.fast.notification import Changes, read_published
from softplc.drivers.opcua.fast.seam import decode_message
from softplc.tags import Image
from tests.support.doubles import doubles_server
from tests.support.network import free_port

SECONDS = 4.0
"""For each row, of measuring."""
WRITTEN = 1000
PEERS = Path(os.environ.get("SOFTPLC_PEERS", Path(__file__).parent.parent / "tests" / "peers"))
NOON = datetime(2024, 1, 1, 12, tzinfo=UTC)
Read = Callable[[], Awaitable[object]]


async def serve(port: int, count: int) -> None:
    """An asyncua server with so many Doubles ns=1;s=D0 …, until its stdin ends."""
    server = await doubles_server(port, count, writable=WRITTEN)
    async with server:
        print("ready", flush=True)
        await asyncio.to_thread(sys.stdin.read)


@asynccontextmanager
async def started(kind: str, count: int, folder: str) -> AsyncIterator[str]:
    port = free_port()
    if kind == "asyncua":
        command = [sys.executable, __file__, "serve", str(port), str(count)]
    else:
        command = ["node", str(Path(__file__).parent / "opcua_doubles.js"), str(port), folder, str(count)]
    environment = {**os.environ, "NODE_PATH": str(PEERS / "node_modules"), "HOME": folder, "XDG_CONFIG_HOME": folder}
    process = await asyncio.create_subprocess_exec(
        *command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=environment
    )
    assert process.stdout is not None
    try:
        while (line := await process.stdout.readline()).strip() != b"ready":
            if not line:
                raise SystemExit(f"the {kind} server ended before it was ready")
        yield f"opc.tcp://127.0.0.1:{port}"
    finally:
        process.kill()
        await process.wait()


async def cost(read: Read) -> tuple[float, float]:
    """CPU and wall ms of one read."""
    cpu, wall = time.process_time(), time.perf_counter()
    await read()
    return (time.process_time() - cpu) * 1e3, (time.perf_counter() - wall) * 1e3


async def row(kind: str, count: int, folder: str, *, written: bool = False) -> str:
    nodes = [f"ns=1;s=D{number}" for number in range(count)]
    config = OpcUaSource(type="opcua", name="plc", url="opc.tcp://x:1", timeout_ms=30_000, connect_timeout_ms=60_000)
    async with started(kind, count, folder) as url:
        source = config.model_copy(update={"url": url})
        tags = [OpcUaTag(source="plc", node=node) for node in nodes]
        driver = source.build(tags, tags[:WRITTEN] if written else (), SystemClock(), 0.05)
        assert isinstance(driver, OpcUaDriver)
        await driver.open()
        async with Client(url, timeout=30) as client:
            ids = [ua.NodeId.from_string(node) for node in nodes]
            image = Image(count)

            def ours() -> Awaitable[object]:
                return driver.write(np.arange(count), numbers) if written else driver.read(image)

            def theirs() -> Awaitable[object]:
                if not written:
                    return client.uaclient.read_attributes(ids, ua.AttributeIds.Value)
                made = [ua.DataValue(ua.Variant(value, ua.VariantType.Double)) for value in values.values()]
                return client.uaclient.write_attributes(ids, made, ua.AttributeIds.Value)

            values = {number: number + 0.5 for number in range(count)}
            numbers = np.arange(count) + 0.5
            for read in (ours, theirs, ours):
                await read()
            if written:
                assert not (await driver.write(np.arange(count), numbers)).any()
            else:
                assert image.values.tolist() == list(values.values())
            fast, plain = [], []
            end = time.monotonic() + SECONDS
            while time.monotonic() < end or len(plain) < 5:
                gc.freeze()  # as the service does after its start; asyncua's client as it comes
                fast += [await cost(ours) for _ in range(3)]
                gc.unfreeze()
                plain.append(await cost(theirs))
        slow = driver.slow
        await driver.close()
    (our_cpu, our_wall), (cpu, wall) = map(medians, (fast, plain))
    what = f"write {count}" if written else f"read {count}"
    return (
        f"| {kind} | {what} | {cpu:.2f} / {wall:.1f} | {our_cpu:.3f} / {our_wall:.2f} | {cpu / our_cpu:.0f} × "
        f"| {slow.messages} + {slow.values} | {len(plain)} |"
    )


def changes(count: int) -> str:
    """So many reported changes: the bytes of a message, with a Good status and a timestamp, into the image."""
    items = [
        ua.MonitoredItemNotification(
            n, ua.DataValue(ua.Variant(n + 0.5, ua.VariantType.Double), SourceTimestamp=NOON)
        )
        for n in range(count)
    ]
    response = ua.PublishResponse()
    response.Parameters.NotificationMessage.NotificationData = [ua.DataChangeNotification(MonitoredItems=items)]
    body, image = struct_to_binary(response), Image(count)
    bindings = group([OpcUaTag(source="plc", node=f"ns=1;s=D{number}") for number in range(count)])
    taker = Changes(bindings, image)

    def ours() -> None:
        message = read_published(body)
        assert message is not None
        taker.take(body, message, 1.0, 1)

    def theirs() -> None:
        (notification,) = decode_message(ua.PublishResponse, body).Parameters.NotificationMessage.NotificationData
        for item in notification.MonitoredItems:
            put(bindings[item.ClientHandle], item.Value, image, 1.0, 1)

    costs: dict[Callable[[], None], list[float]] = {ours: [], theirs: []}
    for _ in range(30):
        for work, found in costs.items():
            start = time.process_time()
            work()
            found.append((time.process_time() - start) * 1e3)
    fast, plain = (statistics.median(found) for found in costs.values())
    return f"| none | {count} changes | {plain:.2f} | {fast:.3f} | {plain / fast:.0f} × | {taker.values} | 30 |"


def medians(costs: list[tuple[float, float]]) -> tuple[float, float]:
    return statistics.median(cpu for cpu, _ in costs), statistics.median(wall for _, wall in costs)


def main() -> None:
    if sys.argv[1:2] == ["serve"]:  # a process that a benchmark starts
        asyncio.run(serve(int(sys.argv[2]), int(sys.argv[3])))
        return
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.parse_args()
    print("| server | work | asyncua client CPU / wall ms | softplc CPU / wall ms | CPU ratio | slow | rounds |")
    print("|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for kind in ("asyncua", "node-opcua"):
            for count in (1000, 5000):
                print(asyncio.run(row(kind, count, folder)), flush=True)
        print(asyncio.run(row("asyncua", WRITTEN, folder, written=True)), flush=True)
    print(changes(1000))


if __name__ == "__main__":
    main()
