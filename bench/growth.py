"""How a scan and the memory grow with the axes: PYTHONPATH=. python bench/growth.py [--write-back] [--axes 10 100 …].

Each number of axes has two fresh processes. The scan process' own code scans one source that answers at once with
a new value for each axis: latch, AOI with its consistency tags, statistics, publishing. The gateway's own code takes
each of these scans over, with 1 000 monitored items. CPU of one scan and of one publish, median, wire and peers left
out; resident memory when all of it runs; seconds until it is built. Prints a + b·N through the measurements.
`--profile N` says where the scans of N axes spend their time.
"""

import argparse
import asyncio
import cProfile
import json
import pstats
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from tests.support.network import free_port

PERIOD = 0.05
MONITORED = 1000


class Instant:
    """A source whose every sample is new and Good, without a wire."""

    problems = remarks = ()
    writes_at_once = 5000

    def __init__(self, clock: Any, n: int) -> None:
        self._clock = clock
        self._noise = np.random.default_rng(1).normal(0.0, 0.1, (16, n))
        self._reads = 0

    async def open(self) -> None: ...

    async def close(self) -> None: ...

    async def read(self, into: Any) -> None:
        self._reads += 1
        np.add(self._noise[self._reads % len(self._noise)], 0.1 * self._reads, out=into.values)
        into.statuses[:] = 0
        into.source_timestamps[:] = self._clock.utc_ns()
        into.arrivals[:] = self._clock.monotonic()

    async def write(self, positions: Any, values: Any) -> Any:
        return np.zeros(len(positions), np.uint32)


class Steps:
    """A clock on which the next slot is due at once: what goes by between two slots is the scan's work."""

    def __init__(self) -> None:
        self.now, self.began = 100.0, None
        self.costs: list[float] = []
        self.enough = asyncio.Event()
        self.wanted = 0

    def monotonic(self) -> float:
        return self.now

    def suspended(self) -> float:
        return 0.0

    def utc_ns(self) -> int:
        return int(self.now * 1e9)

    async def sleep_until(self, deadline: float, priority: int = 0) -> None:
        if self.began is not None:
            self.costs.append(time.process_time() - self.began)
        if len(self.costs) >= self.wanted:
            self.enough.set()
            await asyncio.Event().wait()
        await asyncio.sleep(0)  # the write that the scan began
        self.now = max(deadline, self.now)
        self.began = time.process_time()

    def close(self) -> None: ...


def configuration(n: int, write_back: bool) -> Any:
    from softplc.config.models import Config

    axes = []
    for number in range(n):
        axis = {"name": f"A{number}", "unit": "mm", "input": {"source": "plc", "node": f"ns=2;s=P{number}"}}
        axis["observer"] = {"type": "aoi", "q_x": 0.01, "q_x_dot": 0.1, "r_x": 0.01}
        if write_back:
            tag = {"source": "plc", "node": f"ns=2;s=V{number}"}
            axis["write_back"] = [{"output": "Velocity", "tag": tag}]
        axes.append(axis)
    source = {"type": "opcua", "name": "plc", "url": "opc.tcp://127.0.0.1:4840", "mode": "poll"}
    publisher = {"type": "opcua", "port": free_port()}
    document = {"tasks": [{"name": "main", "period_ms": PERIOD * 1e3}], "sources": [source], "axes": axes}
    return Config.model_validate_json(json.dumps({**document, "publishers": [publisher]}))


def memory(key: str = "VmRSS") -> float:
    """MiB of this process."""
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(key))
    return int(line.split()[1]) / 1024


async def scan(n: int, write_back: bool, scans: int, profile: bool) -> None:
    from softplc.app.garbage import freeze_garbage
    from softplc.app.layout import build_layout
    from softplc.app.scan_process import build_tasks, build_write_back
    from softplc.exchange import Writer, size
    from softplc.link import Link
    from softplc.scan import LinkPlace
    from softplc.writeback import WriteBacks

    clock, begun = Steps(), time.process_time()
    layout = build_layout(configuration(n, write_back))
    (task,) = build_tasks(layout, Writer(bytearray(size(layout.table)), layout.table), clock, "numpy")
    built = time.process_time() - begun
    (place,) = task.links
    names = [f"V{number}" for number in range(n)]
    link = Link("plc", lambda: Instant(clock, n), place.link._readings, names, clock, 10.0, 10.0, place.link.life)
    task.links = [LinkPlace(link, place.start, place.block)]
    task.write_backs = WriteBacks([build_write_back(each, link) for each in layout.tasks[0].write_backs])
    freeze_garbage()
    clock.wanted = scans
    profiler = cProfile.Profile()
    running = [asyncio.create_task(link.run())]
    while not link.statistics.connected:
        await asyncio.sleep(0)
    if profile:
        profiler.enable()
    running.append(asyncio.create_task(task.run()))
    await clock.enough.wait()
    profiler.disable()
    for each in running:
        each.cancel()
    assert link.statistics.reads >= scans, "the source was not read"
    assert task.outputs.statuses[layout.table.index("A0.Position")] == 0, "the axes are not Good"
    cost = statistics.median(clock.costs[scans // 4 :])
    if profile:
        pstats.Stats(profiler).sort_stats("tottime").print_stats(25)
    print(json.dumps({"cost": cost, "built": built, "memory": memory(), "peak": memory("VmHWM")}))


async def gateway(n: int, scans: int, profile: bool) -> None:
    from softplc.app.garbage import freeze_garbage
    from softplc.app.layout import build_layout
    from softplc.clock import SystemClock
    from softplc.exchange import Reader, Writer, size
    from softplc.publishers.opcua.fast.sweep import NO_BAND, Terms
    from softplc.tags import Image
    from softplc.timing import Scan

    clock, begun = SystemClock(), time.process_time()
    config = configuration(n, write_back=False)
    table = build_layout(config).table
    buffer = bytearray(size(table))
    writer, image = Writer(buffer, table), Image(len(table))
    image.statuses[:] = image.values[:] = 0
    server = config.publishers[0].build(Reader(buffer, table, clock))
    await server.open()
    freeze_garbage()
    built = time.process_time() - begun

    class Count:
        def put(self, *_: object) -> None: ...

    sweep = server._sweep
    queue = sweep.open(Count())
    for number in range(min(n, MONITORED)):
        sweep.add(
            table.index(f"A{number}.Position"),
            queue,
            Terms(number, 3, True, False, NO_BAND, 0.0, 1, True),
            active=True,
        )
    costs, profiler = [], cProfile.Profile()
    for number in range(scans):
        image.values[:] = number % 2
        image.source_timestamps[:] = clock.utc_ns()
        writer.publish(0, Scan(number, clock.monotonic(), clock.utc_ns(), PERIOD, PERIOD, 0), image)
        if profile:
            profiler.enable()
        before = time.process_time()
        await server.publish()
        costs.append(time.process_time() - before)
        profiler.disable()
        await asyncio.sleep(0)
    if profile:
        pstats.Stats(profiler).sort_stats("tottime").print_stats(15)
    cost = statistics.median(costs[scans // 4 :])
    print(json.dumps({"cost": cost, "built": built, "memory": memory(), "peak": memory("VmHWM")}))
    await server.close()
    clock.close()


def measured(part: str, n: int, options: argparse.Namespace) -> dict[str, float]:
    command = [sys.executable, __file__, "--part", part, "--axes", str(n), "--scans", str(options.scans)]
    command += ["--write-back"] * options.write_back
    answer = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
    found: dict[str, float] = json.loads(answer.splitlines()[-1])
    return found


def line(axes: list[int], found: list[float]) -> tuple[float, float]:
    """a + b·N with the least relative errors."""
    b, a = np.polyfit(axes, found, 1, w=1.0 / np.array(found))
    return float(a), float(b)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--axes", type=int, nargs="*", default=[10, 100, 1000, 10_000])
    parser.add_argument("--scans", type=int, default=100)
    parser.add_argument("--write-back", action="store_true", help="each axis writes its velocity back")
    parser.add_argument("--profile", type=int, metavar="N")
    parser.add_argument("--part", choices=("scan", "gateway"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.part or options.profile:
        n = options.profile or options.axes[0]
        if options.part != "gateway":
            asyncio.run(scan(n, options.write_back, options.scans, bool(options.profile)))
        if options.part != "scan":
            asyncio.run(gateway(n, options.scans, bool(options.profile)))
        return
    table: dict[str, list[float]] = {}
    print(
        f"{'axes':>6} |{'scan ms':>9}{'built s':>9}{'MiB':>7}{'peak':>7} |"
        f"{'publish ms':>11}{'built s':>9}{'MiB':>7}{'peak':>7}"
    )
    for n in options.axes:
        ours, theirs = measured("scan", n, options), measured("gateway", n, options)
        for part, found in (("scan", ours), ("gateway", theirs)):
            for key in ("cost", "memory"):
                table.setdefault(f"{part} {key}", []).append(found[key])
        print(
            f"{n:>6} |{ours['cost'] * 1e3:>9.2f}{ours['built']:>9.2f}{ours['memory']:>7.0f}{ours['peak']:>7.0f} |"
            f"{theirs['cost'] * 1e3:>11.2f}{theirs['built']:>9.2f}{theirs['memory']:>7.0f}{theirs['peak']:>7.0f}",
            flush=True,
        )
    if len(options.axes) > 1:
        for what, found in table.items():
            a, b = line(options.axes, found)
            scale, unit = (1e6, "µs") if what.endswith("cost") else (1024, "KiB")
            print(f"{what}: {a * scale:.0f} {unit} + {b * scale:.2f} {unit} for each axis")


if __name__ == "__main__":
    main()
