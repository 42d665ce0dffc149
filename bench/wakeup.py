"""How late a sleeper wakes on this machine: the event loop's own timer against SystemClock, alternating.

Usage: python bench/wakeup.py [--seconds 10] [--period-ms 50] [--hog]
Prints lateness percentiles in µs and their ratios. `--hog` keeps one core busy meanwhile.
"""

import argparse
import asyncio
import multiprocessing
from collections.abc import Awaitable, Callable

import numpy as np

from softplc.clock import SystemClock, monotonic
from softplc.timing import next_deadline

_SLICE = 1.0  # seconds that each method runs before the other has its turn


async def _lateness(sleep_until: Callable[[float], Awaitable[None]], period: float, seconds: float) -> list[float]:
    start = monotonic()
    late = []
    while (now := monotonic()) < start + seconds:
        deadline, _ = next_deadline(start, period, now)
        await sleep_until(deadline)
        late.append(monotonic() - deadline)
    return late


async def _asyncio_sleep(deadline: float) -> None:
    await asyncio.sleep(deadline - monotonic())


async def _measure(period: float, seconds: float) -> dict[str, list[float]]:
    clock = SystemClock()
    methods: dict[str, Callable[[float], Awaitable[None]]] = {
        "asyncio.sleep": _asyncio_sleep,
        "SystemClock": clock.sleep_until,
    }
    late: dict[str, list[float]] = {name: [] for name in methods}
    end = monotonic() + seconds
    while monotonic() < end:
        for name, method in methods.items():
            late[name] += await _lateness(method, period, _SLICE)
    clock.close()
    return late


def _hog(seconds: float) -> None:
    end = monotonic() + seconds
    while monotonic() < end:
        pass


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--period-ms", type=float, default=50.0)
    parser.add_argument("--hog", action="store_true")
    options = parser.parse_args()
    spawn = multiprocessing.get_context("spawn")
    hog = spawn.Process(target=_hog, args=(options.seconds + 5,)) if options.hog else None
    if hog is not None:
        hog.start()
    late = asyncio.run(_measure(options.period_ms / 1e3, options.seconds))
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
    ratios = [a / b for a, b in zip(summary["asyncio.sleep"], summary["SystemClock"], strict=True)]
    print(f"{'ratio':<16}{'':>7}" + "".join(f"{ratio:>9.1f}" for ratio in ratios))


if __name__ == "__main__":
    main()
