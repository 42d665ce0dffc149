"""Cost of one scan of the AOI for each axis: the reference in a loop, the batch, and the whole observer.

    python bench/kernel.py [--seconds 0.5]

The three alternate and the best turn of each counts, so that a busy machine disturbs little. The observer is
the batch with everything around it: judging samples, time steps, enable, status, writing 23 tags for each axis.
"""

import argparse
import time
from collections.abc import Callable

import numpy as np

from softplc.kernel.batch import aoi as batch
from softplc.kernel.reference.aoi import AoiInputs, AoiState, aoi_lreal
from softplc.observers.aoi import AoiConfig
from softplc.observers.axes import AxisPlace, AxisSpec, axis_tags
from softplc.sample import StatusCode
from softplc.tags import Image, TagTable
from softplc.timing import Scan

AXES = (1, 10, 100, 1000, 10_000)
PERIOD = 0.05


def reference(n: int) -> Callable[[int], None]:
    states = [AoiState()] * n

    def scan(k: int) -> None:
        inputs = AoiInputs(True, 0.5 * k, 50.0, 0.01, 0.1, 4 / 3)
        for i in range(n):
            states[i], _ = aoi_lreal(states[i], inputs)

    return scan


def batched(n: int) -> Callable[[int], None]:
    state = batch.AoiBatchState(n)
    tuning = batch.AoiTuning(
        np.float64,
        q_x=np.full(n, 0.01),
        q_x_dot=np.full(n, 0.1),
        r_x=np.full(n, 4 / 3),
        BleedEnable=np.full(n, False),
        BleedThresh=np.zeros(n),
        BleedFactor=np.ones(n),
    )
    every, x, dt = np.full(n, True), np.zeros(n), np.full(n, 50.0)

    def scan(k: int) -> None:
        x.fill(0.5 * k)
        batch.step(state, tuning, EnableIn=every, x=x, dt=dt, rows=every)

    return scan


def observer(n: int) -> Callable[[int], None]:
    config, table = AoiConfig(type="aoi", q_x=0.01, q_x_dot=0.1, r_x=4 / 3), TagTable()
    specs = [AxisSpec(f"A{i}") for i in range(n)]
    places = [
        AxisPlace(spec, i, None, table.add_block(spec.name, "axis", axis_tags(spec, config)))
        for i, spec in enumerate(specs)
    ]
    built, inputs, outputs = AoiConfig.build(places, [config] * n), Image(n), Image(len(table))
    inputs.statuses[:] = StatusCode.GOOD

    def scan(k: int) -> None:
        inputs.values.fill(0.5 * k)
        inputs.arrivals.fill(PERIOD * k)
        built.step(Scan(k, PERIOD * k, 0, PERIOD, PERIOD, 0), inputs, outputs)

    return scan


def measure(scans: list[Callable[[int], None]], seconds: float) -> list[float]:
    """Seconds per scan of each in its best of several turns of some 3 ms, taken alternately for this long in all."""
    turns = []
    for scan in scans:
        scan(0)
        start = time.perf_counter()
        scan(1)
        turns.append(max(1, round(0.003 / (time.perf_counter() - start))))
    times: list[list[float]] = [[] for _ in scans]
    end, k = time.perf_counter() + seconds, 2
    while len(times[0]) < 3 or time.perf_counter() < end:
        for scan, turn, taken in zip(scans, turns, times, strict=True):
            start = time.perf_counter()
            for i in range(turn):
                scan(k + i)
            taken.append((time.perf_counter() - start) / turn)
        k += max(turns)
    return [min(taken) for taken in times]


def main() -> None:
    parser = argparse.ArgumentParser(description="Cost of one scan of the AOI for each axis")
    parser.add_argument("--seconds", type=float, default=0.5, help="time for each number of axes")
    seconds = parser.parse_args().seconds
    titles = ("reference", "batch", "observer", "ref/batch", "obs/batch")
    print("ns per axis".rjust(39))
    print("  axes" + "".join(title.rjust(11) for title in titles))
    for n in AXES:
        ref, bat, obs = measure([reference(n), batched(n), observer(n)], seconds)
        each = "".join(f"{1e9 * t / n:>11.0f}" for t in (ref, bat, obs))
        print(f"{n:>6}{each}{ref / bat:>11.2f}{obs / bat:>11.1f}")


if __name__ == "__main__":
    main()
