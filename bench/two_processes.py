"""Interval between scans while a client reads in a tight loop: server in the scan's process against its own process.

Usage: python bench/two_processes.py [--seconds 6] [--figure docs/img/two-processes.svg]
Both variants run in turns. Prints percentiles and their ratio; draws the figure when asked.
"""

import argparse
import asyncio
import logging
import multiprocessing
from pathlib import Path
from typing import Any

import numpy as np

from softplc.clock import SystemClock, monotonic
from softplc.timing import next_deadline

_PERIOD = 0.01
_TAGS = 2000
_ROUNDS = 3


async def _serve(port: int) -> Any:
    from asyncua import Server

    logging.disable(logging.CRITICAL)
    server = Server()
    await server.init()
    server.set_endpoint(f"opc.tcp://127.0.0.1:{port}")
    index = await server.register_namespace("urn:bench")
    folder = await server.nodes.objects.add_object(index, "bench")
    for k in range(_TAGS):
        await folder.add_variable(f"ns={index};s=T{k}", f"T{k}", float(k))
    await server.start()
    return server


def _server_process(port: int, ready: Any, stop: Any) -> None:
    async def run() -> None:
        server = await _serve(port)
        ready.set()
        while not stop.is_set():
            await asyncio.sleep(0.05)
        await server.stop()

    asyncio.run(run())


def _client_process(port: int, ready: Any, stop: Any) -> None:
    """Reads all tags over and over: a heavy client, as a historian without a subscription is."""

    async def run() -> None:
        from asyncua import Client

        logging.disable(logging.CRITICAL)
        async with Client(f"opc.tcp://127.0.0.1:{port}", timeout=30) as client:
            nodes = [client.get_node(f"ns=2;s=T{k}") for k in range(_TAGS)]
            await client.read_values(nodes)
            ready.set()
            while not stop.is_set():
                await client.read_values(nodes)

    asyncio.run(run())


async def _scan(seconds: float) -> list[float]:
    """Measured intervals of a bare 10 ms task, in seconds."""
    clock = SystemClock()
    start = previous = monotonic()
    intervals = []
    while previous < start + seconds:
        deadline, _ = next_deadline(start, _PERIOD, monotonic())
        await clock.sleep_until(deadline)
        now = monotonic()
        intervals.append(now - previous)
        previous = now
    clock.close()
    return intervals


async def _with_client(spawn: Any, port: int, seconds: float) -> list[float]:
    ready, stop = spawn.Event(), spawn.Event()
    client = spawn.Process(target=_client_process, args=(port, ready, stop))
    client.start()
    while not ready.is_set():
        await asyncio.sleep(0.01)
    intervals = await _scan(seconds)
    stop.set()
    while client.is_alive():
        await asyncio.sleep(0.01)
    client.join()
    return intervals


async def _same_process(spawn: Any, port: int, seconds: float) -> list[float]:
    server = await _serve(port)
    try:
        return await _with_client(spawn, port, seconds)
    finally:
        await server.stop()


async def _own_process(spawn: Any, port: int, seconds: float) -> list[float]:
    ready, stop = spawn.Event(), spawn.Event()
    server = spawn.Process(target=_server_process, args=(port, ready, stop))
    server.start()
    while not ready.is_set():
        await asyncio.sleep(0.01)
    try:
        return await _with_client(spawn, port, seconds)
    finally:
        stop.set()
        server.join(10)


def _free_port() -> int:
    import socket

    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _draw(results: dict[str, list[float]], path: Path) -> None:
    import matplotlib as mpl

    mpl.use("svg")
    from matplotlib import pyplot as plt

    mpl.rcParams["svg.hashsalt"] = "softplc"
    figure, axes = plt.subplots(2, 1, figsize=(9, 4.2), sharex=True, sharey=True, layout="constrained")
    for axis, (name, intervals) in zip(axes, results.items(), strict=True):
        axis.plot(np.array(intervals) * 1e3, color="#d9730d" if "same" in name else "#2b6cb0", linewidth=0.8)
        axis.set_title(f"server in the {name}", fontsize=10, loc="left")
        axis.set_ylabel("interval, ms")
        axis.grid(alpha=0.3)
    axes[-1].set_xlabel("scan (period 10 ms, one client reading 2 000 tags in a tight loop)")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, metadata={"Date": None})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=6.0, help="for each variant")
    parser.add_argument("--figure", type=Path)
    options = parser.parse_args()
    spawn = multiprocessing.get_context("spawn")
    results: dict[str, list[float]] = {"same process": [], "own process": []}
    for _ in range(_ROUNDS):
        for name, variant in (("same process", _same_process), ("own process", _own_process)):
            results[name] += asyncio.run(variant(spawn, _free_port(), options.seconds / _ROUNDS))
    print(f"{'server in the':<16}{'scans':>7}{'p50':>8}{'p99':>8}{'max':>8}   interval at 10 ms, in ms")
    p99 = {}
    for name, intervals in results.items():
        milliseconds = np.array(intervals) * 1e3
        p50, p99[name] = np.percentile(milliseconds, (50, 99))
        print(f"{name:<16}{len(intervals):>7}{p50:>8.2f}{p99[name]:>8.2f}{milliseconds.max():>8.2f}")
    print(f"99th percentile, same / own: {p99['same process'] / p99['own process']:.1f}")
    if options.figure:
        _draw(results, options.figure)


if __name__ == "__main__":
    main()
