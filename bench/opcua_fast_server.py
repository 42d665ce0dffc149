"""CPU of the OPC-UA server: PYTHONPATH=. python bench/opcua_fast_server.py [read|monitor], about 4 minutes.

softplc's server, asyncua's and node-opcua's (SOFTPLC_PEERS, default tests/peers), each with as many Doubles in a
process of its own, in turns. Read: 1 000 and 5 000 Doubles, 2 000 in one request, by node-opcua's client and by
asyncua's; CPU of the server's process for each read of all, all its threads. Monitor: 2 000 items that all change
every 50 ms, publishing and sampling at 50 ms, by node-opcua's client; the server's CPU for each second and for each
notification that arrived.
"""

import argparse
import asyncio
import gc
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from asyncua import Client, ua

from softplc.clock import SystemClock
from softplc.exchange import Reader, Writer, size
from softplc.publishers.opcua.config import OpcUaPublisher
from softplc.tags import Image, Tag, TagTable
from softplc.timing import Scan
from tests.support.doubles import doubles_server
from tests.support.network import free_port

PEERS = Path(os.environ.get("SOFTPLC_PEERS", Path(__file__).parent.parent / "tests" / "peers"))
KINDS = ("softplc", "asyncua", "node-opcua")
BATCH = 2000
ROUNDS = 7
MONITORED, PERIOD, SECONDS = 2000, 0.05, 8.0


class Running:
    """A server in its own process."""

    def __init__(self, kind: str, process: asyncio.subprocess.Process, url: str) -> None:
        self.kind, self.process, self.url = kind, process, url

    def cpu(self) -> float:
        """Milliseconds of CPU so far, of all its threads that live."""
        tasks = Path(f"/proc/{self.process.pid}/task").iterdir()
        return sum(int((task / "schedstat").read_text().split()[0]) for task in tasks) / 1e6


def name(kind: str, number: int) -> str:
    return f"ns=2;s=A{number // 100}.D{number}" if kind == "softplc" else f"ns=1;s=D{number}"


@asynccontextmanager
async def started(kind: str, count: int, folder: str, changing: int = 0) -> AsyncIterator[Running]:
    port = free_port()
    if kind == "node-opcua":
        own = Path(folder) / str(port)
        own.mkdir()
        script = str(Path(__file__).parent / "opcua_doubles.js")
        command = ["node", script, str(port), str(own), str(count), str(changing)]
    else:
        command = [sys.executable, __file__, f"serve-{kind}", str(port), str(count), str(changing)]
    process = await spawn(command, folder)
    try:
        await said(process, b"ready", kind)
        yield Running(kind, process, f"opc.tcp://127.0.0.1:{port}")
    finally:
        process.kill()
        await process.wait()


async def spawn(command: list[str], folder: str) -> asyncio.subprocess.Process:
    environment = {**os.environ, "NODE_PATH": str(PEERS / "node_modules"), "HOME": folder, "XDG_CONFIG_HOME": folder}
    pipe, null = subprocess.PIPE, subprocess.DEVNULL
    return await asyncio.create_subprocess_exec(
        *command, stdin=pipe, stdout=pipe, stderr=null, env=environment, limit=1 << 24
    )


async def said(process: asyncio.subprocess.Process, begin: bytes, who: str) -> bytes:
    assert process.stdout is not None
    async with asyncio.timeout(120):
        while line := await process.stdout.readline():
            if line.startswith(begin):
                return line[len(begin) :].strip()
    raise SystemExit(f"{who} ended too early")


class NodeClient:
    """bench/opcua_reader.js."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.process = process

    async def ask(self, **request: Any) -> dict[str, Any]:
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(request).encode() + b"\n")
        answer: dict[str, Any] = json.loads(b'{"answer":' + await said(self.process, b'{"answer":', "node-opcua"))
        if "error" in answer or answer.get("bad"):
            raise SystemExit(f"node-opcua's client: {answer}")
        return answer


@asynccontextmanager
async def node_client(folder: str, server: Running, count: int) -> AsyncIterator[NodeClient]:
    own = tempfile.mkdtemp(dir=folder)
    process = await spawn(["node", str(Path(__file__).parent / "opcua_reader.js"), own], own)
    client = NodeClient(process)
    try:
        await client.ask(connect=server.url, nodes=[name(server.kind, n) for n in range(count)], batch=BATCH)
        yield client
        await client.ask(disconnect=True)
    finally:
        process.kill()
        await process.wait()


async def reads(count: int, who: str, folder: str) -> None:
    """Rows of one table."""
    costs: dict[str, list[float]] = {kind: [] for kind in KINDS}
    async with AsyncExitStack() as stack:
        servers, readers = [], []
        for kind in KINDS:
            server = await stack.enter_async_context(started(kind, count, folder))
            servers.append(server)
            if who == "node-opcua":
                node = await stack.enter_async_context(node_client(folder, server, count))
                readers.append(lambda times, node=node: node.ask(read=times))
            else:
                client = await stack.enter_async_context(Client(server.url, timeout=60))
                readers.append(lambda times, client=client, kind=kind: asyncua_read(client, kind, count, times))
        for number in range(ROUNDS + 1):
            for server, read in zip(servers, readers, strict=True):
                times = 20 if server.kind == "softplc" else 3
                before = server.cpu()
                await read(times)
                if number:  # the first round warms up
                    costs[server.kind].append((server.cpu() - before) / times)
    cost = {kind: statistics.median(found) for kind, found in costs.items()}
    ours = cost["softplc"]
    print(
        f"| {who} | {count} | {cost['asyncua']:.1f} | {cost['node-opcua']:.1f} | {ours:.2f} "
        f"| {cost['asyncua'] / ours:.0f} × | {cost['node-opcua'] / ours:.0f} × |",
        flush=True,
    )


async def asyncua_read(client: Client, kind: str, count: int, times: int) -> None:
    ids = [ua.NodeId.from_string(name(kind, number)) for number in range(count)]
    for _ in range(times):
        for first in range(0, count, BATCH):
            found = await client.uaclient.read_attributes(ids[first : first + BATCH], ua.AttributeIds.Value)
            assert all(value.StatusCode.is_good() for value in found)


async def monitor(folder: str) -> None:
    found: dict[str, list[tuple[float, float]]] = {kind: [] for kind in KINDS}
    for _ in range(2):
        for kind in KINDS:
            async with AsyncExitStack() as stack:
                server = await stack.enter_async_context(started(kind, MONITORED, folder, MONITORED))
                client = await stack.enter_async_context(node_client(folder, server, MONITORED))
                await client.ask(monitor=PERIOD * 1000)
                assert server.process.stdin is not None
                server.process.stdin.write(b"go\n")
                await asyncio.sleep(2.0)
                found[kind].append(await listened(server, client))
    ours = min(cpu / heard for cpu, heard in found["softplc"])
    for kind in KINDS:
        cpu, heard = min(found[kind], key=lambda pair: pair[0] / pair[1])
        print(
            f"| {kind} | {heard / SECONDS:.0f} | {cpu / SECONDS / 10:.0f} % | {cpu / heard * 1e3:.1f} "
            f"| {cpu / heard / ours:.0f} × |",
            flush=True,
        )


async def listened(server: Running, client: NodeClient) -> tuple[float, float]:
    """CPU ms and notifications in `SECONDS`."""
    begun, before = (await client.ask(heard=True))["heard"], server.cpu()
    await asyncio.sleep(SECONDS)
    cpu = server.cpu() - before
    return cpu, max((await client.ask(heard=True))["heard"] - begun, 1)


async def serve_softplc(port: int, count: int, changing: int) -> None:
    """softplc's server over an exchange of Doubles A0.D0 … in axes of 100; scans every 50 ms where some change."""
    table = TagTable()
    for first in range(0, count, 100):
        numbers = range(first, min(first + 100, count))
        table.add_block(f"A{first // 100}", "axis", [Tag(f"A{first // 100}.D{number}") for number in numbers])
    table.close_section("main")
    clock, buffer = SystemClock(), bytearray(size(table))
    writer, image = Writer(buffer, table), Image(len(table))
    image.statuses[:] = 0
    image.values[:] = 0.5
    server = OpcUaPublisher(type="opcua", port=port).build(Reader(buffer, table, clock))
    scans = 0

    async def scan() -> None:
        nonlocal scans
        scans += 1
        now = clock.utc_ns()
        image.values[:changing] = scans
        image.source_timestamps[:changing] = now
        writer.publish(0, Scan(scans, clock.monotonic(), now, PERIOD, PERIOD, 0), image)
        await server.publish()

    await server.open()
    await scan()
    gc.collect()
    gc.freeze()  # as the service does after its start
    await changes(scan if changing else None)


async def serve_asyncua(port: int, count: int, changing: int) -> None:
    server = await doubles_server(port, count)
    ids = [ua.NodeId(f"D{number}", 1) for number in range(changing)]
    scans = 0

    async def scan() -> None:
        nonlocal scans
        scans += 1
        now = datetime.now(UTC)
        for node in ids:
            value = ua.DataValue(ua.Variant(float(scans), ua.VariantType.Double), SourceTimestamp=now)
            await server.write_attribute_value(node, value)

    async with server:
        gc.collect()
        gc.freeze()
        await changes(scan if changing else None)


async def changes(scan: Any) -> None:
    """Tell that the server is ready; after a line on stdin scan every 50 ms; end with stdin."""
    print("ready", flush=True)
    line = await asyncio.to_thread(sys.stdin.readline)
    loop = asyncio.get_running_loop()
    ended = loop.run_in_executor(None, sys.stdin.read)
    due = loop.time()
    while line and scan is not None and not ended.done():
        await scan()
        due = max(due + PERIOD, loop.time())
        await asyncio.sleep(due - loop.time())
    await ended


async def run(what: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        if what in ("all", "read"):
            print("| client | Doubles | asyncua ms | node-opcua ms | softplc ms | to asyncua | to node-opcua |")
            print("|---|---|---|---|---|---|---|")
            for who in ("node-opcua", "asyncua"):
                for count in (1000, 5000):
                    await reads(count, who, folder)
        if what in ("all", "monitor"):
            print("| server | notifications/s | CPU | µs each | to softplc |\n|---|---|---|---|---|")
            await monitor(folder)


def main() -> None:
    if sys.argv[1:2] in (["serve-softplc"], ["serve-asyncua"]):  # a process that a benchmark starts
        serve = serve_softplc if sys.argv[1] == "serve-softplc" else serve_asyncua
        asyncio.run(serve(*map(int, sys.argv[2:5])))
        return
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", choices=("all", "read", "monitor"), default="all")
    asyncio.run(run(parser.parse_args().what))


if __name__ == "__main__":
    main()
