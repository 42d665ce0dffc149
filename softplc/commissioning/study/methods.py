"""The investigation's methods on one interface: a kernel steps many settings and realisations in one call."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from softplc.commissioning.study.waveform import DT, Numbers, R
from softplc.kernel.batch import alpha_beta, aoi, cv_accel, derivative, finite_difference, moving_average, one_euro

Setting = tuple[float, ...]
Make = Callable[[Numbers], tuple[Any, Any]]

_SIGMA_V = R**0.5


@dataclass(frozen=True, slots=True)
class Method:
    """A way to position and velocity: `settings` are those that were weighed, `names` say what their numbers are.

    `make` gives state and tuning for a table with one row for each row of the batch; `dt` is in the kernel's unit.
    """

    name: str
    verdict: str  # of the investigation
    names: tuple[str, ...]
    settings: Sequence[Setting]
    make: Make
    step: Callable[..., Any]
    dt: float = DT

    def label(self, setting: Setting) -> str:
        """The setting in words."""
        return ", ".join(f"{name} {value:.3g}" for name, value in zip(self.names, setting, strict=True)) or "–"


def run_method(method: Method, settings: Sequence[Setting], measured: Numbers) -> tuple[Numbers, Numbers]:
    """Position and velocity, arrays[settings, realisations, scans]; `measured` is array[realisations, scans] in u."""
    realisations, scans = measured.shape
    n = len(settings) * realisations
    table = np.repeat(np.array(settings, float).reshape(len(settings), -1), realisations, axis=0)
    x = np.tile(measured, (len(settings), 1))
    state, tuning = method.make(table)
    every, dt = np.ones(n, np.bool_), np.full(n, method.dt)
    position, velocity = np.empty((n, scans)), np.empty((n, scans))
    for scan in range(scans):
        method.step(state, tuning, EnableIn=every, x=x[:, scan], dt=dt, rows=every)
        position[:, scan], velocity[:, scan] = state.y, state.y_dot
    shape = (len(settings), realisations, scans)
    return position.reshape(shape), velocity.reshape(shape)


def _moving_average(table: Numbers) -> tuple[Any, Any]:
    window = table[:, 0].astype(int)
    return moving_average.MovingAverageBatchState(len(table), longest=int(window.max())), (
        moving_average.MovingAverageTuning(window=window)
    )


def _difference(table: Numbers) -> tuple[Any, Any]:
    return finite_difference.FiniteDifferenceBatchState(len(table)), finite_difference.FiniteDifferenceTuning()


def _derivative(table: Numbers) -> tuple[Any, Any]:
    n = len(table)
    return derivative.DerivativeBatchState(n), derivative.DerivativeTuning(cycle=[DT] * n, measured=[True] * n)


def _alpha_beta(table: Numbers) -> tuple[Any, Any]:
    zero = np.zeros(len(table))
    tuning = alpha_beta.AlphaBetaTuning(
        indexed=np.ones(len(table), np.bool_), alpha=zero, beta=zero, sigma_w=table[:, 0], sigma_v=zero + _SIGMA_V
    )
    return alpha_beta.AlphaBetaBatchState(len(table)), tuning


def _one_euro(table: Numbers) -> tuple[Any, Any]:
    tuning = one_euro.OneEuroTuning(
        min_cutoff=table[:, 0], beta=table[:, 1], d_cutoff=table[:, 2], filtered=np.zeros(len(table), np.bool_)
    )
    return one_euro.OneEuroBatchState(len(table)), tuning


def _aoi(table: Numbers) -> tuple[Any, Any]:
    n = len(table)
    tuning = aoi.AoiTuning(
        np.float64,
        q_x=table[:, 0],
        q_x_dot=table[:, 1],
        r_x=np.full(n, R),
        BleedEnable=np.zeros(n, np.bool_),
        BleedThresh=np.zeros(n),
        BleedFactor=np.ones(n),
    )
    return aoi.AoiBatchState(n), tuning


def _cv_accel(table: Numbers) -> tuple[Any, Any]:
    zero = np.zeros(len(table))
    tuning = cv_accel.CvAccelTuning(
        r_x=zero + R, q_x=zero, q_x_dot=zero, q_x_ddot=table[:, 0], white_jerk=zero > 0.0, q_jerk=zero
    )
    return cv_accel.CvAccelBatchState(len(table)), tuning


def _line(start: float, stop: float, count: int) -> list[Setting]:
    return [(float(value),) for value in np.geomspace(start, stop, count)]


METHODS: tuple[Method, ...] = (
    Method(
        "moving average",
        "rejected: lag",
        ("window",),
        [(float(n),) for n in (2, 3, 4, 5, 6, 8, 10, 12, 15, 20, 25, 30, 40)],
        _moving_average,
        moving_average.step,
    ),
    Method("numerical differentiation", "rejected: noise", (), [()], _difference, finite_difference.step),
    Method("IEC 61131-3 DERIVATIVE", "", (), [()], _derivative, derivative.step),
    Method("α-β, tracking index", "considered", ("σw",), _line(0.5, 200.0, 25), _alpha_beta, alpha_beta.step),
    Method(
        "1€ filter",
        "",
        ("min_cutoff", "beta", "d_cutoff"),
        list(product((0.02, 0.05, 0.1, 0.2, 0.4, 0.8), (0.0, 0.05, 0.1, 0.2, 0.4, 0.8), (0.1, 0.2, 0.4, 0.8))),
        _one_euro,
        one_euro.step,
    ),
    Method(
        "2-state Kalman, the AOI",
        "selected",
        ("q_x", "q_x_dot"),
        [(0.001, q) for (q,) in _line(0.01, 30.0, 25)],
        _aoi,
        aoi.step,
        DT * 1000.0,
    ),
    Method("3-state Kalman, cv_accel", "", ("q_x_ddot",), _line(0.01, 300.0, 25), _cv_accel, cv_accel.step),
)
