"""CPU of the OPC-UA client: PYTHONPATH=. python bench/opcua_client.py, at most a minute.

One read of 1 000 and 5 000 Doubles, from an asyncua server and from node-opcua (SOFTPLC_PEERS, default tests/peers):
the OPC-UA source in mode poll, image included, against asyncua's client with one Read of as many nodes (which gives
DataValues). Both in one process, in turns; each server in its own. Median CPU and wall time for each read.
"""

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
from pathlib import Path

from asyncua import Client, Server, ua

from softplc.clock import SystemClock
from softplc.drivers.opcua.config import OpcUaSource, OpcUaTag
from softplc.drivers.opcua.driver import OpcUaDriver
from softplc.tags import Image
from tests.support.network import free_port

SECONDS = 4.0
"""For each row, of measuring."""
PEERS = Path(os.environ.get("SOFTPLC_PEERS", Path(__file__).parent.parent / "tests" / "peers"))
Read = Callable[[], Awaitable[object]]


async def serve(port: int, count: int) -> None:
    """An asyncua server with so many Doubles ns=1;s=D0 …, until its stdin ends."""
    server = Server()
    await server.init()
    server.set_endpoint(f"opc.tcp://127.0.0.1:{port}")
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    for first in range(0, count, 100):
        axis = await server.nodes.objects.add_object(ua.NodeId(f"A{first}", 1), f"1:A{first}")
        for number in range(first, min(first + 100, count)):
            await axis.add_variable(ua.NodeId(f"D{number}", 1), f"1:D{number}", number + 0.5)
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


async def row(kind: str, count: int, folder: str) -> str:
    nodes = [f"ns=1;s=D{number}" for number in range(count)]
    config = OpcUaSource(type="opcua", name="plc", url="opc.tcp://x:1", timeout_ms=30_000, connect_timeout_ms=60_000)
    async with started(kind, count, folder) as url:
        source = config.model_copy(update={"url": url})
        tags = [OpcUaTag(source="plc", node=node) for node in nodes]
        driver = source.build(tags, (), SystemClock(), 0.05)
        assert isinstance(driver, OpcUaDriver)
        await driver.open()
        async with Client(url, timeout=30) as client:
            ids = [ua.NodeId.from_string(node) for node in nodes]
            image = Image(count)

            def ours() -> Awaitable[object]:
                return driver.read(image)

            def theirs() -> Awaitable[object]:
                return client.uaclient.read_attributes(ids, ua.AttributeIds.Value)

            for read in (ours, theirs, ours):
                await read()
            assert image.values.tolist() == [number + 0.5 for number in range(count)]
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
    return (
        f"| {kind} | {count} | {cpu:.2f} / {wall:.1f} | {our_cpu:.3f} / {our_wall:.2f} | {cpu / our_cpu:.0f} × "
        f"| {slow.messages} + {slow.values} | {len(plain)} |"
    )


def medians(costs: list[tuple[float, float]]) -> tuple[float, float]:
    return statistics.median(cpu for cpu, _ in costs), statistics.median(wall for _, wall in costs)


def main() -> None:
    if sys.argv[1:2] == ["serve"]:
        asyncio.run(serve(int(sys.argv[2]), int(sys.argv[3])))
        return
    print("| server | Doubles | asyncua client CPU / wall ms | softplc CPU / wall ms | CPU ratio | slow | rounds |")
    print("|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for kind in ("asyncua", "node-opcua"):
            for count in (1000, 5000):
                print(asyncio.run(row(kind, count, folder)), flush=True)


if __name__ == "__main__":
    main()
