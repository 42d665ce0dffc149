"""Scans without end on hand-made time: one sample in a hundred is no measurement, and every output is checked."""

import gc
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from softplc.observers.adaptive import AdaptiveConfig
from softplc.observers.alpha_beta import AlphaBetaConfig
from softplc.observers.aoi import AoiConfig
from softplc.observers.axes import AxisSpec
from softplc.observers.cv_accel import CvAccelConfig
from softplc.observers.derivative import DerivativeConfig
from softplc.observers.ducekf import DucekfConfig, EndStops
from softplc.observers.fb_kalman import FbKalmanConfig
from softplc.observers.finite_difference import FiniteDifferenceConfig
from softplc.observers.moving_average import MovingAverageConfig
from softplc.observers.one_euro import OneEuroConfig
from softplc.sample import StatusCode
from tests.observers.rig import UTC, make_rig
from tests.soak.oracle import BAD, GOOD, INFINITE, INPUT_STATUS, LOST, NAN, OUTSIDE, UNCERTAIN, Oracle

PERIOD: Final = 0.05
SHARE: Final = 0.01  # of the samples
_CHUNK: Final = 5000  # scans that are drawn at once
_STOPS: Final = EndStops(type="end_stops", lower=-1e6, upper=1e6)

OBSERVERS: Final[dict[str, tuple[Any, int]]] = {
    "aoi": (AoiConfig(type="aoi", q_x=0.01, q_x_dot=0.1, r_x=4 / 3), 1),
    "aoi in REAL": (AoiConfig(type="aoi", precision="real", q_x=0.01, q_x_dot=0.1, r_x=4 / 3), 1),
    "aoi with options": (AoiConfig(type="aoi", q_mode="white_accel", joseph=True, r_mode="density", r_x=0.1), 1),
    "fb_kalman as written": (FbKalmanConfig(type="fb_kalman", R=4 / 3), 1),
    "fb_kalman corrected": (FbKalmanConfig(type="fb_kalman", variant="corrected", R=4 / 3), 1),
    "ducekf": (DucekfConfig(type="ducekf", r_x=4 / 3, contact_from="position", model=_STOPS), 1),
    "cv_accel": (CvAccelConfig(type="cv_accel", r_x=4 / 3), 1),
    "adaptive": (AdaptiveConfig(type="adaptive", r_x=4 / 3, top_speed=50, top_acceleration=100, gate=1e6), 1),
    "alpha_beta": (AlphaBetaConfig(type="alpha_beta", alpha=0.4), 1),
    "moving_average": (MovingAverageConfig(type="moving_average", window=8), 8),
    "derivative": (DerivativeConfig(type="derivative", dt_mode="measured"), 3),
    "one_euro": (OneEuroConfig(type="one_euro", beta=0.1), 1),
    "finite_difference": (FiniteDifferenceConfig(type="finite_difference"), 1),
}
"""Each with the samples from its start that are not Good yet."""

_BASE: Final = AxisSpec("A0", range=(-1000.0, 1000.0))
POLICIES: Final = (
    _BASE,
    replace(_BASE, on_bad="coast", on_lost="coast", coast_max=0.4),
    replace(_BASE, on_bad="coast", on_lost="hold", coast_max=2.0, after_coast="hold", reinit_samples=5),
    replace(_BASE, on_bad="passthrough", on_lost="passthrough", dt_source="source"),
    replace(_BASE, on_bad="fail", on_lost="fail", reinit_samples=1, dt_source="arrival"),
    replace(_BASE, on_bad="hold", on_lost="hold", reinit_after=0.3),
)
"""One axis each."""


@dataclass(frozen=True, slots=True)
class Report:
    """What came of one observer: figures, and what was wrong with the first scans that were."""

    observer: str
    scans: int
    faulty: float  # share of the samples
    states: NDArray[np.int64]  # how often each AxisState
    growth: float  # MiB per million scans, resident
    seconds: float
    wrong: tuple[str, ...]


def soak(name: str, scans: int, seed: int = 0) -> Report:
    """Run one observer with an axis of every policy for so many scans; stops at the tenth thing that is wrong."""
    config, warm = OBSERVERS[name]
    n = len(POLICIES)
    specs = [replace(spec, name=f"A{axis}") for axis, spec in enumerate(POLICIES)]
    rig = make_rig(*[(spec, config) for spec in specs], period=PERIOD)
    oracles = [Oracle(spec, PERIOD, warm) for spec in specs]
    index = np.array(
        [[rig.table.index(f"A{axis}.{leaf}") for leaf in ("Position", "Reason", "State")] for axis in range(n)]
    )
    where_nis = [rig.table.index(f"A{axis}.NIS") for axis in range(n)] if "A0.NIS" in rig.table else []
    first = int(rig.table.blocks[1].start)
    kernel = rig.observer._kernel  # type: ignore[attr-defined]
    outputs, states = rig.outputs, np.zeros(9, np.int64)
    wrong: list[str] = []
    warm_up, faulty, before, began = min(scans // 5, 50_000), 0, 0.0, time.monotonic()

    for number, (kinds, z, dt) in enumerate(_samples(n, scans, np.random.default_rng(seed))):
        if number == warm_up:
            before = _resident()
        rig.now += dt
        rig.inputs.values[:] = z
        rig.inputs.statuses[:] = [INPUT_STATUS[kind] for kind in kinds]
        rig.inputs.source_timestamps[:] = UTC + round(rig.now * 1e9)
        rig.inputs.arrivals[:] = rig.now
        rig.step(dt)

        nis = outputs.values[where_nis] if where_nis else [np.nan] * n
        expected = [oracle.scan(kind, dt, its) for oracle, kind, its in zip(oracles, kinds, nis, strict=True)]
        got = [
            (int(status), int(reason), int(state))
            for status, reason, state in zip(
                outputs.statuses[index[:, 0]],
                outputs.values[index[:, 1]],
                outputs.values[index[:, 2]],
                strict=True,
            )
        ]
        if got != expected:
            wrong += [
                f"scan {number}, {specs[axis]}: {one} where {other} was to be"
                for axis, (one, other) in enumerate(zip(got, expected, strict=True))
                if one != other
            ]
        values, statuses = outputs.values[first:], outputs.statuses[first:]
        if not np.array_equal(np.isnan(values), statuses >= StatusCode.BAD):
            wrong.append(f"scan {number}: a number that is Bad, or a NaN that is not")
        if not kernel.finite().all():
            wrong.append(f"scan {number}: the state is not finite")
        states += np.bincount(outputs.values[index[:, 2]].astype(np.intp), minlength=9)
        faulty += sum(kind > UNCERTAIN for kind in kinds)
        if len(wrong) >= 10:
            break
    growth = (_resident() - before) / max(scans - warm_up, 1) * 1e6
    return Report(
        name, number + 1, faulty / ((number + 1) * n), states, growth, time.monotonic() - began, tuple(wrong)
    )


def _samples(n: int, scans: int, rng: np.random.Generator) -> Iterator[tuple[list[int], list[float], float]]:
    """Kind and value of each axis' sample, and the time step; faults come alone or in bursts, seldom long ones."""
    left, kind_now = np.zeros(n, np.int64), np.zeros(n, np.int64)
    t = 0.0
    for start in range(0, scans, _CHUNK):
        size = min(_CHUNK, scans - start)
        begins = rng.random((size, n)) < SHARE / 2.7
        lengths = np.where(
            rng.random((size, n)) < 0.97, rng.integers(1, 4, (size, n)), rng.integers(4, 80, (size, n))
        )
        drawn = rng.choice([NAN, INFINITE, OUTSIDE, BAD, LOST, UNCERTAIN], (size, n))
        flickers = rng.random((size, n)) < 0.15  # a good sample amid the others
        noise = rng.uniform(-2.0, 2.0, (size, n))
        huge = np.copysign(10.0 ** rng.uniform(4.0, 38.0, (size, n)), rng.normal(size=(size, n)))
        late = np.where(rng.random(size) < 1e-4, rng.uniform(0.1, 3.0, size), PERIOD)
        for k in range(size):
            t += late[k]
            fresh = begins[k] & (left == 0)
            left[fresh], kind_now[fresh] = lengths[k][fresh], drawn[k][fresh]
            kinds = np.where((left > 0) & ~flickers[k], kind_now, GOOD)
            left -= left > 0
            z = 100.0 * np.sin(0.5 * t + np.arange(n)) + noise[k]
            z = np.where(kinds == OUTSIDE, huge[k], z)
            z = np.where(kinds == INFINITE, np.copysign(np.inf, noise[k]), z)
            z = np.where((kinds == NAN) | (kinds == BAD) | (kinds == LOST), np.nan, z)
            yield kinds.tolist(), z.tolist(), float(late[k])


def _resident() -> float:
    """MiB of this process in memory."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * 4096 / 2**20
