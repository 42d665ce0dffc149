"""The wall between scan and gateway: intervals between scans while the gateway idles, is attacked, stopped, killed.

Usage: PYTHONPATH=. python bench/wall.py [--seconds 18] [--period-ms 20] [--rounds 3] [--quick]
The real scan process and gateway with an emulated Modbus PLC; all conditions in turns, and beside the scans, in a
process of its own at the same period, a bare timer that does nothing. |Δt − period| in ms; the longest stall is the
largest Δt − period. `--quick` takes half a minute.
"""

import argparse
import asyncio
import contextlib
import json
import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from softplc.clock import monotonic
from tests.support.attacks import SOCKETS, flood, malform
from tests.support.network import free_port

SPAWN = multiprocessing.get_context("spawn")
_ROOM = 200_000  # starts of scans that are kept


def scan_process(config_json: str, buffer: Any, record: Any, stop: Any) -> None:
    """softplc's scans as its own process runs them, and where they start."""
    from softplc.app.garbage import freeze_garbage
    from softplc.app.layout import build_layout
    from softplc.app.logs import configure_logs
    from softplc.app.scan_process import build_tasks, start_tasks
    from softplc.clock import SystemClock
    from softplc.config.models import Config
    from softplc.exchange import Writer

    async def run() -> None:
        clock = SystemClock()
        config = Config.model_validate_json(config_json)
        configure_logs(config.log, "scan")
        layout = build_layout(config)
        (task,) = build_tasks(layout, Writer(buffer, layout.table), clock)
        task.on_scan = lambda scan: _note(record, scan.start)
        async with asyncio.TaskGroup() as group:
            running = start_tasks(group, [task])
            freeze_garbage()
            while not stop.is_set():
                await asyncio.sleep(0.1)
            for each in running:
                each.cancel()

    asyncio.run(run())


def bare_process(period: float, record: Any, stop: Any) -> None:
    """The same grid and clock, and nothing to do."""
    from softplc.clock import SystemClock
    from softplc.timing import next_deadline

    async def run() -> None:
        clock = SystemClock()
        start = monotonic()
        while not stop.is_set():
            deadline, _ = next_deadline(start, period, monotonic())
            await clock.sleep_until(deadline)
            _note(record, monotonic())

    asyncio.run(run())


def _note(record: Any, start: float) -> None:
    count = int(record[0]) + 1
    record[count % (_ROOM - 1) + 1] = start
    record[0] = count


class Plant:
    """Emulated PLC, scan process, gateway and bare timer, each a process."""

    def __init__(self, period: float) -> None:
        from softplc.app.layout import build_layout
        from softplc.config.models import Config
        from softplc.emulator.scenario import Scenario
        from softplc.exchange import size

        plc, self.ports = free_port(), (free_port(), free_port())
        axes = [{"name": f"A{number}", "unit": "mm"} for number in range(10)]
        scenario = {"period_ms": period * 1e3, "axes": axes, "modbus": {"port": plc}}
        inputs = [{"source": "plc", "address": f"holding:{100 + 20 * number}"} for number in range(10)]
        observer = {"type": "aoi", "r_x": 1.0}
        document = {
            "tasks": [{"name": "main", "period_ms": period * 1e3}],
            "sources": [{"type": "modbus", "name": "plc", "transport": {"host": "127.0.0.1", "port": plc}}],
            "axes": [{"name": f"A{n}", "input": tag, "observer": observer} for n, tag in enumerate(inputs)],
            "publishers": [{"type": "opcua", "port": self.ports[0]}, {"type": "modbus", "port": self.ports[1]}],
            "log": {"level": "error"},
        }
        self.config_json = json.dumps(document)
        config = Config.model_validate_json(self.config_json)
        self.buffer = SPAWN.RawArray("b", size(build_layout(config).table))
        self.stop = SPAWN.Event()
        self.records = {name: SPAWN.RawArray("d", _ROOM) for name in ("scan", "bare timer")}
        self.processes: list[Any] = []
        self._emulator(Scenario.model_validate_json(json.dumps(scenario)))
        scan = (self.config_json, self.buffer, self.records["scan"], self.stop)
        for target, arguments in (
            (scan_process, scan),
            (bare_process, (period, self.records["bare timer"], self.stop)),
        ):
            self.processes.append(SPAWN.Process(target=target, args=arguments, daemon=True))
            self.processes[-1].start()
        self.gateway: Any = None
        self.start_gateway()
        while min(int(record[0]) for record in self.records.values()) < 10:
            time.sleep(0.05)

    def _emulator(self, scenario: Any) -> None:
        from softplc.emulator.run import run_emulator

        ours, theirs = SPAWN.Pipe(duplex=False)
        self.processes.append(SPAWN.Process(target=run_emulator, args=(scenario, theirs), daemon=True))
        self.processes[-1].start()
        ours.recv()

    def start_gateway(self) -> None:
        from softplc.app.gateway import gateway_process

        ours, theirs = SPAWN.Pipe(duplex=False)
        self.gateway = SPAWN.Process(
            target=gateway_process, args=(self.config_json, self.buffer, theirs), daemon=True
        )
        self.gateway.start()
        ours.recv()

    def close(self) -> None:
        self.stop.set()
        for process in (*self.processes, self.gateway):
            process.kill()
            process.join()

    def intervals(self, name: str, since: float) -> Any:
        """Δt of what started after `since`, seconds."""
        record = np.frombuffer(self.records[name])
        count = int(record[0])
        starts = np.sort(record[1:][: min(count, _ROOM - 1)])
        return np.diff(starts[starts >= since])


@contextlib.contextmanager
def attacking(target: Callable[..., None], plant: Plant) -> Iterator[None]:
    stop = SPAWN.Event()
    process = SPAWN.Process(target=target, args=(plant.ports, stop), daemon=True)
    process.start()
    time.sleep(1.0)  # its own start is not the attack
    try:
        yield
    finally:
        stop.set()
        process.join(2)
        process.kill()
        process.join()


@contextlib.contextmanager
def stopped(plant: Plant) -> Iterator[None]:
    os.kill(plant.gateway.pid, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(plant.gateway.pid, signal.SIGCONT)


@contextlib.contextmanager
def killed(plant: Plant) -> Iterator[None]:
    """Killed at the start, and started anew at once as the supervisor does: its start is part of it."""
    plant.gateway.kill()
    plant.gateway.join()
    plant.start_gateway()
    yield


CONDITIONS: dict[str, Callable[[Plant], Any]] = {
    "idle": lambda _: contextlib.nullcontext(),
    f"flooded, {SOCKETS} sockets": lambda plant: attacking(flood, plant),
    "malformed frames": lambda plant: attacking(malform, plant),
    "SIGSTOPped": stopped,
    "killed, restarted": killed,
}


def measure(plant: Plant, seconds: float, rounds: int) -> dict[tuple[str, str], list[float]]:
    found: dict[tuple[str, str], list[float]] = {}
    for _ in range(rounds):
        for condition, make in CONDITIONS.items():
            with contextlib.ExitStack() as stack:
                since = monotonic()
                stack.enter_context(make(plant))
                if condition != "killed, restarted":
                    since = monotonic()
                time.sleep(max(since + seconds / rounds - monotonic(), 0.5))
                for name in plant.records:
                    found.setdefault((condition, name), []).extend(plant.intervals(name, since))
    return found


def report(found: dict[tuple[str, str], list[float]], period: float) -> None:
    print("| gateway | measured | intervals | p50 | p99 | p99.9 | longest stall | over the bare timer's |")
    print("|---|---|---|---|---|---|---|---|")
    for condition in CONDITIONS:
        bare = (max(found[condition, "bare timer"]) - period) * 1e3
        for name in ("scan", "bare timer"):
            late = np.array(found[condition, name]) - period
            p50, p99, p999 = np.percentile(np.abs(late), (50, 99, 99.9)) * 1e3
            stall = late.max() * 1e3
            over = f"{stall - bare:+.1f}" if name == "scan" else ""
            print(
                f"| {condition} | {name} | {len(late)} | {p50:.2f} | {p99:.2f} | {p999:.2f} | {stall:.1f} | {over} |"
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=18.0, help="for each condition")
    parser.add_argument("--period-ms", type=float, default=20.0)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--quick", action="store_true")
    options = parser.parse_args()
    seconds, rounds = (3.0, 1) if options.quick else (options.seconds, options.rounds)
    before = os.getloadavg()[0]
    plant = Plant(options.period_ms / 1e3)
    try:
        found = measure(plant, seconds, rounds)
    finally:
        plant.close()
    report(found, options.period_ms / 1e3)
    print(f"\nperiod {options.period_ms:g} ms; load average {before:.1f} before, {os.getloadavg()[0]:.1f} after")


if __name__ == "__main__":
    main()
