"""Cost of the AOI for each axis and scan: softplc's kernels, the limit that C has on this machine, and other filters.

    python bench/kernel.py [--quick]

C is bench/kernel.c, compiled here with `cc -O3 -march=native -ffp-contract=off`: the same recursion on the same
arrays, without any of the AOI's guards, its loop over the scans inside. "per call" is the same, called once for each
scan through ctypes; "fused" has contraction allowed, and other bits than the PLC. Times are CPU times, candidates
alternate and the best turn of each counts, so that a busy machine disturbs little. What would take too long is left
out: "-". Of a recording, numpy and all below it take the first samples only.
"""

import argparse
import ctypes
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from softplc.kernel.batch import aoi as batch
from softplc.kernel.compiled import available
from softplc.kernel.offline import run_aoi
from softplc.kernel.reference.aoi import AoiInputs, AoiState, aoi_lreal
from softplc.observers.aoi import AoiConfig
from softplc.observers.axes import AxisPlace, AxisSpec, axis_tags
from softplc.sample import StatusCode
from softplc.tags import Image, TagTable
from softplc.timing import Scan

Q_X, Q_X_DOT, R_X, DT = 0.01, 0.1, 4 / 3, 0.05
F, H = np.array([[1.0, DT], [0.0, 1.0]]), np.array([[1.0, 0.0]])
Runs = Callable[[int], Any]  # runs that many scans, or samples


def compiled_c(folder: Path, *options: str) -> ctypes.CDLL:
    library = folder / f"kernel{len(list(folder.iterdir()))}.so"
    source = Path(__file__).with_suffix(".c")
    command = ["cc", "-O3", "-march=native", *options, "-shared", "-fPIC", "-o", str(library), str(source)]
    subprocess.run(command, check=True)
    loaded = ctypes.CDLL(str(library))
    size, pointer, number = ctypes.c_ssize_t, ctypes.c_void_p, ctypes.c_double
    loaded.live.argtypes = [size] * 2 + [pointer] * 4
    loaded.replay_many.argtypes = [size] * 2 + [pointer] * 6
    loaded.replay_one.argtypes = [size] + [number] * 3 + [pointer] * 4
    return loaded


def tuning_of(n: int) -> batch.AoiTuning:
    one = np.ones(n)
    noise: dict[str, Any] = {"q_x": Q_X * one, "q_x_dot": Q_X_DOT * one, "r_x": R_X * one}
    return batch.AoiTuning(np.float64, **noise, BleedEnable=one < 0, BleedThresh=one, BleedFactor=one)


def in_c(n: int, library: ctypes.CDLL, x: Any, per_call: bool = False) -> Runs:
    state, tuning, dt = batch.AoiBatchState(n), tuning_of(n).numbers.copy(), np.full(n, 1000 * DT)
    state.numbers[[4, 7]] = [[1.0], [10.0]]
    state.x_pred[:] = x[0]
    pointers = (state.numbers.ctypes.data, tuning.ctypes.data, x.ctypes.data, dt.ctypes.data)

    def run(scans: int) -> Any:
        if per_call:
            for _ in range(scans):
                library.live(1, n, *pointers)
        else:
            library.live(scans, n, *pointers)
        return state.y, tuning, dt

    return run


def stepped(step: Any, n: int, x: Any) -> Runs:
    state, tuning, every, dt = batch.AoiBatchState(n), tuning_of(n), np.full(n, True), np.full(n, 1000 * DT)
    rows = list(x)

    def run(scans: int) -> Any:
        for k in range(scans):
            step(state, tuning, EnableIn=every, x=rows[k & 3], dt=dt, rows=every)
        return state.y

    return run


def plain_numpy(n: int, x: Any) -> Runs:
    """The recursion as one would write it down, without buffers."""
    y, v, P00, P01, P11 = x[0].copy(), np.zeros(n), np.ones(n), np.zeros(n), np.full(n, 10.0)

    def run(scans: int) -> Any:
        nonlocal y, v, P00, P01, P11
        for k in range(scans):
            y = y + DT * v
            P00, P01, P11 = P00 + 2 * DT * P01 + DT**2 * P11 + Q_X, P01 + DT * P11, P11 + Q_X_DOT
            e, S = x[k & 3] - y, P00 + R_X
            K0, K1 = P00 / S, P01 / S
            y, v = y + K0 * e, v + K1 * e
            P00, P01, P11 = (1 - K0) * P00, (1 - K0) * P01, P11 - K1 * P01

    return run


def reference(n: int, x: Any) -> Runs:
    states, columns = [AoiState() for _ in range(n)], x.tolist()

    def run(scans: int) -> None:
        for k in range(scans):
            for i, z in enumerate(columns[k & 3]):
                states[i], _ = aoi_lreal(states[i], AoiInputs(True, z, 1000 * DT, Q_X, Q_X_DOT, R_X))

    return run


def filterpy_each(n: int, x: Any) -> Runs:
    from filterpy.kalman import KalmanFilter

    filters = [KalmanFilter(dim_x=2, dim_z=1) for _ in range(n)]
    for one in filters:
        one.F, one.H, one.Q, one.R, one.P = F, H, np.diag([Q_X, Q_X_DOT]), np.array([[R_X]]), np.diag([1.0, 10.0])

    def run(scans: int) -> None:
        for k in range(scans):
            for one, z in zip(filters, x[k & 3], strict=True):
                one.predict()
                one.update(z)

    return run


def simdkalman_all(n: int, x: Any) -> Runs:
    import simdkalman

    kalman = simdkalman.KalmanFilter(F, np.diag([Q_X, Q_X_DOT]), H, R_X)
    m, P = np.zeros((n, 2, 1)), np.repeat(np.diag([1.0, 10.0])[np.newaxis], n, axis=0)

    def run(scans: int) -> None:
        nonlocal m, P
        for k in range(scans):
            m, P = kalman.predict_next(m, P)
            m, P, _ = kalman.update(m, P, x[k & 3].reshape(n, 1, 1))

    return run


def whole_observer(n: int, x: Any) -> Runs:
    """The batch with all around it: judging samples, time steps, enable, status, writing every tag of each axis."""
    config, table = AoiConfig(type="aoi", q_x=Q_X, q_x_dot=Q_X_DOT, r_x=R_X), TagTable()
    specs = [AxisSpec(f"A{i}") for i in range(n)]
    places = [
        AxisPlace(spec, i, None, table.add_block(spec.name, "axis", axis_tags(spec, config)))
        for i, spec in enumerate(specs)
    ]
    built, inputs, outputs = AoiConfig.build(places, [config] * n), Image(n), Image(len(table))
    inputs.statuses[:] = StatusCode.GOOD
    count = 0

    def run(scans: int) -> None:
        nonlocal count
        for _ in range(scans):
            inputs.values[:] = x[count & 3]
            inputs.arrivals.fill(DT * count)
            built.step(Scan(count, DT * count, 0, DT, DT, 0), inputs, outputs)
            count += 1

    return run


def compiled_step() -> Any:
    from softplc.kernel.compiled import aoi

    aoi.prepare(np.float64)
    return aoi.step


def live_candidates(n: int, c: ctypes.CDLL, fused: ctypes.CDLL) -> dict[str, Runs]:
    """By name; the slow ones only where a scan of theirs takes less than some 0.1 s."""
    x = np.random.default_rng(1).normal(size=(4, n))
    candidates = {"C": in_c(n, c, x), "C fused": in_c(n, fused, x), "C per call": in_c(n, c, x, per_call=True)}
    if available():
        candidates["compiled"] = stepped(compiled_step(), n, x)
    candidates["numpy"] = stepped(batch.step, n, x)
    candidates["plain numpy"] = plain_numpy(n, x)
    if n <= 10_000:
        candidates["reference"] = reference(n, x)
        candidates["observer"] = whole_observer(n, x)
    if n <= 1000:
        candidates["filterpy"] = filterpy_each(n, x)
    candidates["simdkalman"] = simdkalman_all(n, x)
    return candidates


def same_bits(n: int, c: ctypes.CDLL) -> bool:
    """Whether C, the batch and the compiled kernel give the same numbers after some scans."""
    x = np.random.default_rng(2).normal(size=(4, n))
    steps = [batch.step, compiled_step()] if available() else [batch.step]
    in_each = [in_c(n, c, x)(400)[0], *(stepped(step, n, x)(400) for step in steps)]
    return all((y == in_each[0]).all() for y in in_each)


def measure(candidates: dict[str, Runs], seconds: float, at_most: dict[str, int] | None = None) -> dict[str, float]:
    """CPU seconds for each run of each candidate, in the best of its turns, taken alternately for this long in all.

    A turn is what takes some 5 ms; or with `at_most`, that many runs.
    """
    turns = dict(at_most or {})
    for name, run in candidates.items():
        if name not in turns:
            run(1)
            start = time.thread_time()
            run(1)
            turns[name] = max(1, round(0.005 / (time.thread_time() - start)))
    best, rounds, end = dict.fromkeys(candidates, np.inf), 0, time.perf_counter() + seconds
    while rounds < 2 or time.perf_counter() < end:
        for name, run in candidates.items():
            start = time.thread_time()
            run(turns[name])
            best[name] = min(best[name], (time.thread_time() - start) / turns[name])
        rounds += 1
    return best


def one_axis(c: ctypes.CDLL, samples: int, seconds: float) -> dict[str, float]:
    """Seconds for each sample of one recorded axis; slow candidates take the first of them."""
    rng = np.random.default_rng(3)
    x, same = np.cumsum(rng.normal(size=samples)), np.full(samples, 1000 * DT)
    jittered = same + rng.normal(size=samples)

    def c_run(dt: Any) -> Runs:
        def run(count: int) -> Any:
            tracks = np.empty((2, count))
            pointers = [one.ctypes.data for one in (x, dt, tracks[0], tracks[1])]
            c.replay_one(count, Q_X, Q_X_DOT, R_X, *pointers)
            return tracks

        return run

    def ours(backend: Any, dt: Any) -> Runs:
        return lambda count: run_aoi(tuning_of(1), x[:count], dt[:count], backend=backend)

    candidates, at_most = {"C": c_run(same), "C, dt varies": c_run(jittered)}, {}
    if available():
        candidates |= {"compiled": ours("compiled", same), "compiled, dt varies": ours("compiled", jittered)}
        assert (ours("compiled", jittered)(1000)["y"] == candidates["C, dt varies"](1000)[0]).all()
    slow = {
        "reference": reference(1, x[:4].reshape(4, 1)),
        "numpy": ours("numpy", same),
        "simdkalman": simdkalman_all(1, x[:4].reshape(4, 1)),
        "filterpy": filterpy_each(1, x[:4].reshape(4, 1)),
    }
    at_most = dict.fromkeys(candidates, samples) | {name: min(samples, 2000) for name in slow}
    return measure(candidates | slow, seconds, at_most)


def many_axes(c: ctypes.CDLL, n: int, scans: int, seconds: float) -> dict[str, float]:
    """Seconds for each scan of n recorded axes with a dt that varies; slow candidates take the first of them."""
    rng = np.random.default_rng(4)
    x, dt = rng.normal(size=(scans, n)), 1000 * DT + rng.normal(size=scans)

    def c_run(count: int) -> Any:
        state, tuning, row, tracks = (
            batch.AoiBatchState(n),
            tuning_of(n).numbers.copy(),
            np.empty(n),
            np.empty(2 * count * n),
        )
        state.numbers[[4, 7]] = [[1.0], [10.0]]
        state.x_pred[:] = x[0]
        pointers = [one.ctypes.data for one in (state.numbers, tuning, x, dt, row, tracks)]
        c.replay_many(count, n, *pointers)
        return tracks.reshape(2, count, n)

    def ours(backend: Any) -> Runs:
        return lambda count: run_aoi(tuning_of(n), x[:count], dt[:count], backend=backend)

    candidates: dict[str, Runs] = {"C": c_run}
    if available():
        candidates["compiled"] = ours("compiled")
        assert (ours("compiled")(100)["y"] == c_run(100)[0]).all()
    candidates["numpy"] = ours("numpy")
    slow = {
        "reference": reference(n, x[:4]),
        "simdkalman": simdkalman_all(n, x[:4]),
        "filterpy": filterpy_each(n, x[:4]),
    }
    at_most = dict.fromkeys(candidates, scans) | dict.fromkeys(slow, 5) | {"filterpy": 1}
    return measure(candidates | slow, seconds, at_most)


def table(title: str, columns: list[str], rows: dict[str, list[float | None]]) -> None:
    """ns, and how many times C's; `rows` begins with C."""
    print(f"\n{title}")
    print(
        " " * 20 + "".join(column.rjust(11) for column in columns) + "   × C" + "".join(c.rjust(9) for c in columns)
    )
    limit = rows["C"]
    for name, row in rows.items():
        cells = "".join("-".rjust(11) if cell is None else f"{cell * 1e9:11.4g}" for cell in row)
        times = ("-" if a is None or b is None else f"{a / b:.3g}" for a, b in zip(row, limit, strict=True))
        print(f"{name:20}{cells}      {''.join(each.rjust(9) for each in times)}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description="Cost of one scan of the AOI for each axis")
    parser.add_argument("--quick", action="store_true", help="less of everything, in less than 20 s")
    quick = parser.parse_args().quick
    warnings.simplefilter("ignore")
    if shutil.which("cc") is None:
        sys.exit("bench/kernel.py compares with C and finds no compiler called cc; try: sudo apt install gcc")
    numbers = (1, 100, 1000) if quick else (1, 100, 1000, 10_000, 100_000)
    with tempfile.TemporaryDirectory() as folder:
        c, fused = compiled_c(Path(folder), "-ffp-contract=off"), compiled_c(Path(folder), "-ffp-contract=fast")
        print(f"C, numpy{' and compiled' * available()} give the same bits: {'yes' if same_bits(1000, c) else 'NO'}")
        if not available():
            print("numba is not installed, so nothing compiled is measured: pip install 'softplc[compiled]'")
        each = [measure(live_candidates(n, c, fused), 1.5 if quick else 12.0) for n in numbers]
        rows = {
            name: [None if name not in times else times[name] / n for times, n in zip(each, numbers, strict=True)]
            for name in each[0]
        }
        table("Live: ns for each axis of a scan, by the number of axes", [f"{n:,}" for n in numbers], rows)
        samples, scans = (100_000, 500) if quick else (1_000_000, 10_000)
        one = one_axis(c, samples, 2.0 if quick else 20.0)
        table(f"Replay of 1 axis × {samples:,}: ns for each sample", ["1"], {k: [v] for k, v in one.items()})
        many = many_axes(c, 1000, scans, 2.0 if quick else 20.0)
        table(f"Replay of 1,000 axes × {scans:,}", ["1,000"], {k: [v / 1000] for k, v in many.items()})


if __name__ == "__main__":
    main()
