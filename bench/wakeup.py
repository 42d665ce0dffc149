"""How late a sleeper wakes on this machine: the event loop's own timer, SystemClock and cyclictest, alternating.

Usage: python bench/wakeup.py [--seconds 30] [--period-ms 50] [--hog]
Prints lateness percentiles in µs and their ratios. `--hog` keeps one core busy meanwhile. cyclictest is Debian's
rt-tests, a C program, here as SCHED_OTHER; without it (apt install rt-tests) its row is missing.
"""

import argparse
import asyncio
import multiprocessing
import shutil
import subprocess
import time
from collections.abc import Awaitable, Callable

import numpy as np

from softplc.clock import SystemClock
from softplc.timing import next_deadline

_SLICE = 2.0  # seconds that each method runs before the other has its turn
_WORST = 200_000  # µs that cyclictest's histogram reaches to


async def _lateness(sleep_until: Callable[[float], Awaitable[None]], period: float, seconds: float) -> list[float]:
    start = time.monotonic()
    late = []
    while (now := time.monotonic()) < start + seconds:
        deadline, _ = next_deadline(start, period, now)
        await sleep_until(deadline)
        late.append(time.monotonic() - deadline)
    return late


async def _asyncio_sleep(deadline: float) -> None:
    await asyncio.sleep(deadline - time.monotonic())


def _cyclictest(period: float, seconds: float) -> list[float]:
    """Lateness of a C program that sleeps to absolute deadlines in a thread of its own, seconds."""
    microseconds = round(period * 1e6)
    command = ["cyclictest", "-t1", "--policy=other", "--laptop", f"-i{microseconds}", f"-l{round(seconds / period)}"]
    done = subprocess.run([*command, "-q", f"-h{_WORST}"], check=True, capture_output=True, text=True)
    late: list[float] = []
    for line in done.stdout.splitlines():
        if line[:1].isdigit():
            value, count = line.split()
            late += [int(value) / 1e6] * int(count)
    return late


def _measure(period: float, seconds: float) -> dict[str, list[float]]:
    async def asyncio_sleep() -> list[float]:
        return await _lateness(_asyncio_sleep, period, _SLICE)

    async def system_clock() -> list[float]:
        clock = SystemClock()
        late = await _lateness(clock.sleep_until, period, _SLICE)
        clock.close()
        return late

    methods: dict[str, Callable[[], list[float]]] = {
        "asyncio.sleep": lambda: asyncio.run(asyncio_sleep()),
        "SystemClock": lambda: asyncio.run(system_clock()),
    }
    if shutil.which("cyclictest"):
        methods["cyclictest"] = lambda: _cyclictest(period, _SLICE)
    late: dict[str, list[float]] = {name: [] for name in methods}
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        for name, method in methods.items():
            late[name] += method()
    return late


def _hog(seconds: float) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        pass


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--period-ms", type=float, default=50.0)
    parser.add_argument("--hog", action="store_true")
    options = parser.parse_args()
    spawn = multiprocessing.get_context("spawn")
    hog = spawn.Process(target=_hog, args=(options.seconds + 5,)) if options.hog else None
    if hog is not None:
        hog.start()
    late = _measure(options.period_ms / 1e3, options.seconds)
    if hog is not None:
        hog.terminate()
        hog.join()
    print(f"lateness at {options.period_ms:g} ms{', one core hogged' if options.hog else ''}, µs")
    print(f"{'method':<16}{'n':>7}{'p50':>9}{'p95':>9}{'p99':>9}{'max':>9}")
    summary = {}
    for name, values in late.items():
        p50, p95, p99 = np.percentile(values, (50, 95, 99)) * 1e6
        summary[name] = (p50, p95, p99, max(values) * 1e6)
        print(f"{name:<16}{len(values):>7}{p50:>9.0f}{p95:>9.0f}{p99:>9.0f}{max(values) * 1e6:>9.0f}")
    for other in summary.keys() - {"SystemClock"}:
        ratios = [a / b for a, b in zip(summary["SystemClock"], summary[other], strict=True)]
        print(f"{'÷ ' + other:<16}{'':>7}" + "".join(f"{ratio:>9.2f}" for ratio in ratios))


if __name__ == "__main__":
    main()
