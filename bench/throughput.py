"""How many axes fit into 50 ms from end to end: softplc against a plain asyncua program of the same work.

Usage: python bench/throughput.py [--axes 100 1000 5000] [--plain 10 35 100] [--batched 100 400] [--seconds 10]

The same work for each: a source with N Doubles over OPC-UA is read, observed by the AOI and served over OPC-UA with
its tags, and an independent client (node-opcua, npm) monitors up to 1 000 of them. Source, program and client share
this machine. The source is softplc's own server over a hand-made image, because no other peer answers 5 000 Doubles
in a fraction of 50 ms. A row holds when the 99th percentile of the scan's execution time is below half the period and
no slot was missed.

plain: one await for each tag and each output, as most people begin. batched: one read and one write request a scan.
"""

import argparse
import asyncio
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from softplc.clock import SystemClock
from softplc.timing import next_deadline

PERIOD = 0.05
MONITORED = 1000
ROOT = Path(__file__).parent
OUTPUTS = ("Position", "Velocity", "Raw", "Innovation", "S", "K0", "K1", "P00", "P01", "P11", "NIS", "Dt")


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


async def source(port: int, n: int) -> None:
    """Serves ns=2;s=P0.Position … until its standard input ends; every value and stamp changes every 50 ms."""
    from softplc.exchange import Reader, Writer, size
    from softplc.feed import Feed
    from softplc.publishers.opcua.config import OpcUaPublisher
    from softplc.tags import Image, Tag, TagTable
    from softplc.timing import Scan

    table = TagTable()
    for k in range(n):
        table.add_block(f"P{k}", "axis", [Tag(f"P{k}.Position", "mm")])
    table.close_section("main")
    buffer, clock = bytearray(size(table)), SystemClock()
    writer, image = Writer(buffer, table), Image(n)
    image.statuses[:] = 0
    reader = Reader(buffer, table, clock)
    server = OpcUaPublisher(type="opcua", port=port).build(reader)
    random = np.random.default_rng(1)

    async def plant() -> None:
        start = deadline = clock.monotonic()
        number = 0
        while True:
            await clock.sleep_until(deadline)
            now, number = clock.monotonic(), number + 1
            image.values[:] = 10.0 * (now - start) + random.uniform(-2.0, 2.0, n)
            image.source_timestamps[:] = clock.utc_ns()
            writer.publish(0, Scan(number, now, clock.utc_ns(), PERIOD, PERIOD, 0), image)
            deadline, _ = next_deadline(start, PERIOD, clock.monotonic())

    running = [asyncio.create_task(plant())]
    await server.open()
    running.append(asyncio.create_task(Feed("opcua", server, clock, PERIOD, clock.monotonic()).run()))
    print("ready", flush=True)
    await asyncio.to_thread(sys.stdin.read)
    for task in running:
        task.cancel()
    await server.close()


async def plain(url: str, port: int, n: int, batched: bool, seconds: float) -> None:
    """The program that one writes with asyncua alone; prints its scans' execution times as JSON in the end."""
    from asyncua import Client, Server, ua

    from softplc.kernel.reference.aoi import AoiInputs, AoiState, aoi_lreal

    server = Server()
    await server.init()
    server.set_endpoint(f"opc.tcp://127.0.0.1:{port}")
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    namespace = await server.register_namespace("urn:plain")
    outputs = []
    for k in range(n):
        axis = await server.nodes.objects.add_object(ua.NodeId(f"A{k}", namespace), f"A{k}")
        outputs.append([await axis.add_variable(ua.NodeId(f"A{k}.{leaf}", namespace), leaf, 0.0) for leaf in OUTPUTS])
    states = [AoiState() for _ in range(n)]
    times: list[float] = []
    missed = 0
    clock = SystemClock()
    async with server, Client(url) as client:
        nodes = [client.get_node(f"ns=2;s=P{k}.Position") for k in range(n)]
        print("ready", flush=True)
        await asyncio.to_thread(sys.stdin.readline)  # the client is there
        start = deadline = clock.monotonic()
        slot = 0
        while clock.monotonic() < start + seconds:
            await clock.sleep_until(deadline)
            begun = clock.monotonic()
            values = await client.read_values(nodes) if batched else [await node.read_value() for node in nodes]
            writes = []
            for k, value in enumerate(values):
                inputs = AoiInputs(EnableIn=True, x=value, dt=50.0, q_x=0.01, q_x_dot=0.1, r_x=4 / 3)
                states[k], _ = aoi_lreal(states[k], inputs)
                state = states[k]
                results = (state.y, state.y_dot, value, state.y_res, state.S, state.K0, state.K1, *state.P[:2])
                results += (state.P[3], state.y_res**2 / state.S if state.S else 0.0, 0.05)
                for node, result in zip(outputs[k], results, strict=True):
                    if batched:
                        writes.append((node.nodeid, result))
                    else:
                        await node.write_value(float(result))
            for nodeid, result in writes:
                await server.write_attribute_value(nodeid, ua.DataValue(ua.Variant(result, ua.VariantType.Double)))
            times.append(clock.monotonic() - begun)
            before = slot
            deadline, slot = next_deadline(start, PERIOD, clock.monotonic())
            missed += slot - before - 1
    print(json.dumps({"times": times, "missed": missed}), flush=True)


@contextmanager
def running(*command: str, env: dict[str, str] | None = None) -> "Iterator[subprocess.Popen[str]]":
    """A process that says "ready" and ends when its standard input does."""
    pipe = subprocess.PIPE
    process = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env={**os.environ, **(env or {})})
    assert process.stdout is not None and process.stdin is not None
    try:
        if "ready\n" not in process.stdout:  # reads up to it
            raise SystemExit(f"{command[1]} did not start")
        yield process
    finally:
        process.stdin.close()
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def this(*arguments: Any, script: str = Path(__file__).name) -> list[str]:
    return [sys.executable, str(ROOT / script), *map(str, arguments)]


def ask(process: "subprocess.Popen[str]") -> str:
    assert process.stdout is not None and process.stdin is not None
    process.stdin.write("\n")
    process.stdin.flush()
    return next(line for line in process.stdout if line.startswith("{") or line.strip().isdigit())


def monitor(url: str, n: int, folder: str, pattern: str = "ns=2;s=AK.Position") -> Any:
    peers = os.environ.get("SOFTPLC_PEERS", str(ROOT.parent / "tests" / "peers"))
    arguments = [url, folder, str(min(n, MONITORED)), pattern, str(PERIOD * 1e3)]
    return running("node", str(ROOT / "opcua_monitor.js"), *arguments, env={"NODE_PATH": f"{peers}/node_modules"})


def cpu_seconds(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def row(what: str, n: int, p50: float, p99: float, missed: float, scans: int, heard: float, cpu: str) -> bool:
    holds = p99 < 0.5 * PERIOD and not missed
    verdict = "holds" if holds else "in time" if not missed else "no"
    asked = min(n, MONITORED) / PERIOD
    print(
        f"{what:<10}{n:>6}{p50 * 1e3:>9.1f}{p99 * 1e3:>9.1f}{scans:>7}{missed:>8.0f}{100 * heard / asked:>10.0f} %"
        f"  {verdict:<8} {cpu}",
        flush=True,
    )
    return holds


def measure_plain(n: int, batched: bool, seconds: float) -> bool:
    port, own = free_port(), free_port()
    with tempfile.TemporaryDirectory() as folder, running(*this("--source", port, n)):
        url = f"opc.tcp://127.0.0.1:{port}"
        options = ["--program", url, own, n, "batched" if batched else "plain", seconds]
        with running(*this(*options)) as program, monitor(f"opc.tcp://127.0.0.1:{own}", n, folder) as client:
            before = int(ask(client))
            begun = time.monotonic()
            result = json.loads(ask(program))
            heard = (int(ask(client)) - before) / (time.monotonic() - begun)
    p50, p99 = np.percentile(result["times"], (50, 99))
    return row("batched" if batched else "plain", n, p50, p99, result["missed"], len(result["times"]), heard, "")


def measure_softplc(n: int, seconds: float) -> bool:
    port, own = free_port(), free_port()
    observer = {"type": "aoi", "q_x": 0.01, "q_x_dot": 0.1, "r_x": 1.3333}
    axis = {
        "for": f"0..{n - 1}",
        "name": "A{i}",
        "unit": "mm",
        "input": {"source": "plc", "node": "ns=2;s=P{i}.Position"},
        "observer": observer,
        "consistency": False,
    }
    document = {
        "tasks": [{"name": "main", "period_ms": PERIOD * 1e3}],
        "sources": [{"type": "opcua", "name": "plc", "url": f"opc.tcp://127.0.0.1:{port}", "mode": "poll"}],
        "axes": [axis],
        "publishers": [{"type": "opcua", "port": own}],
        "log": {"level": "error"},
    }
    with tempfile.TemporaryDirectory() as folder, running(*this("--source", port, n)) as plc:
        path = Path(folder) / "throughput.json"
        path.write_text(json.dumps(document))
        begun = time.monotonic()
        command = [sys.executable, "-m", "softplc", "run", str(path), "--json"]
        daemon = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=sys.stderr, text=True)
        try:
            assert daemon.stdout is not None
            for line in daemon.stdout:
                if line == "}\n":
                    break
            else:
                raise SystemExit("softplc did not start")
            ready = time.monotonic() - begun
            url = f"opc.tcp://127.0.0.1:{own}"
            with monitor(url, n, folder) as client:
                time.sleep(5.0)
                pids = {"source": plc.pid, "client": client.pid}
                for child in Path(f"/proc/{daemon.pid}/task/{daemon.pid}/children").read_text().split():
                    name = Path(f"/proc/{child}/comm").read_text().strip()
                    pids[name.removeprefix("softplc-")] = int(child)
                cpu = {name: cpu_seconds(pid) for name, pid in pids.items()}
                before, begun = int(ask(client)), time.monotonic()
                times, missed = asyncio.run(watched(url, seconds))
                heard = (int(ask(client)) - before) / (time.monotonic() - begun)
                used = {
                    name: (cpu_seconds(pid) - cpu[name]) / (time.monotonic() - begun) for name, pid in pids.items()
                }
        finally:
            daemon.terminate()
            daemon.wait(10)
    told = ", ".join(f"{name} {100 * share:.0f} %" for name, share in used.items() if share > 0.005)
    p50, p99 = np.percentile(times, (50, 99))
    return row("softplc", n, p50, p99, missed, len(times), heard, f"CPU {told}; up {ready:.1f} s")


async def watched(url: str, seconds: float) -> tuple[list[float], float]:
    """The execution times that softplc tells of its scans for so long, and the slots that were missed meanwhile."""
    from asyncua import Client

    class Times:
        def __init__(self) -> None:
            self.heard: list[float] = []

        def datachange_notification(self, _node: Any, value: float, _data: Any) -> None:
            self.heard.append(value)

    async with Client(url, timeout=20) as client:
        overruns, times = client.get_node("ns=2;s=Tasks.main.Overruns"), Times()
        before = await overruns.read_value()
        subscription = await client.create_subscription(500, times)
        await subscription.subscribe_data_change(
            client.get_node("ns=2;s=Tasks.main.ExecutionTime"), queuesize=100, sampling_interval=0
        )
        await asyncio.sleep(seconds)
        return times.heard[1:], float(await overruns.read_value() - before)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--axes", type=int, nargs="*", default=[100, 1000, 2000, 5000])
    parser.add_argument("--plain", type=int, nargs="*", default=[10, 20, 35, 50])
    parser.add_argument("--batched", type=int, nargs="*", default=[50, 100, 200, 400])
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--source", nargs=2, type=int, help=argparse.SUPPRESS)
    parser.add_argument("--program", nargs=5, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.source:
        asyncio.run(source(*options.source))
        return
    if options.program:
        url, port, n, kind, seconds = options.program
        asyncio.run(plain(url, int(port), int(n), kind == "batched", float(seconds)))
        return
    print(f"period {PERIOD * 1e3:g} ms, {os.cpu_count()} CPUs for source, program and client, times in ms")
    print(f"{'program':<10}{'axes':>6}{'exec p50':>9}{'exec p99':>9}{'scans':>7}{'missed':>8}{'delivered':>12}")
    most = {
        "plain": [n for n in options.plain if measure_plain(n, False, options.seconds)],
        "batched": [n for n in options.batched if measure_plain(n, True, options.seconds)],
        "softplc": [n for n in options.axes if measure_softplc(n, options.seconds)],
    }
    ours = max(most["softplc"], default=0)
    for other in ("plain", "batched"):
        if most[other]:
            print(f"softplc holds {ours} axes, {ours / max(most[other]):.0f} times as many as {other}")


if __name__ == "__main__":
    main()
