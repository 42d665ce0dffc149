"""The three-state observer on arrays: the operations of `kernel.reference.cv_accel`, one row for each axis.

Bit-equal to the reference: the same operations in the same order, no matrix product, no fused multiply-add.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from softplc.kernel.batch.frame import Flags, Frame, Numbers, Rows, numbers
from softplc.kernel.reference.cv_accel import P_START
from softplc.kernel.result import Result


class CvAccelBatchState(Rows):
    """The state of n observers; the y and y_dot of a row are also its outputs."""

    NAMES = (
        *("y", "y_dot", "x_pred", "x_dot_pred", "x_ddot_pred"),
        *("P00", "P01", "P02", "P11", "P12", "P22", "K0", "K1", "K2", "S", "y_res"),
    )
    POSITIONS = ("y", "x_pred")
    x_pred: Numbers
    x_dot_pred: Numbers
    x_ddot_pred: Numbers
    P00: Numbers
    P01: Numbers
    P02: Numbers
    P11: Numbers
    P12: Numbers
    P22: Numbers
    K0: Numbers
    K1: Numbers
    K2: Numbers
    S: Numbers
    y_res: Numbers


class CvAccelTuning:
    """Variances per update r_x, q_x, q_x_dot, q_x_ddot; where `white_jerk` the density `q_jerk`; arrays[n]."""

    def __init__(
        self,
        dtype: DTypeLike = np.float64,
        *,
        r_x: ArrayLike,
        q_x: ArrayLike,
        q_x_dot: ArrayLike,
        q_x_ddot: ArrayLike,
        white_jerk: ArrayLike,
        q_jerk: ArrayLike,
    ) -> None:
        self.r_x: Numbers = numbers(r_x, dtype)
        self.q_x: Numbers = numbers(q_x, dtype)
        self.q_x_dot: Numbers = numbers(q_x_dot, dtype)
        self.q_x_ddot: Numbers = numbers(q_x_ddot, dtype)
        self.white_jerk: Flags = np.array(white_jerk, np.bool_)
        self.q_jerk: Numbers = numbers(q_jerk, dtype)


class _Covariance(NamedTuple):
    """The predicted covariance; arrays[n]."""

    P00: Numbers
    P01: Numbers
    P02: Numbers
    P11: Numbers
    P12: Numbers
    P22: Numbers


@np.errstate(all="ignore")
def step(
    state: CvAccelBatchState,
    tuning: CvAccelTuning,
    *,
    EnableIn: Flags,
    x: NDArray[Any],
    dt: NDArray[Any],
    rows: Flags,
) -> NDArray[np.uint8]:
    """One scan of the rows where `rows` is true; the others are untouched. `x` in u, `dt` in s, all arrays[n].

    Returns the Result of each row.
    """
    scan = Frame(state, EnableIn, x, dt, rows)
    starting = rows & EnableIn & ~state.init  # also while dt is invalid
    if starting.any():
        _initialise(state, starting, scan.x)

    dt, h = scan.dt, 0.5 * scan.dt * scan.dt
    x_pred = state.x_pred + dt * state.x_dot_pred + h * state.x_ddot_pred  # (1)
    x_dot_pred = state.x_dot_pred + dt * state.x_ddot_pred  # (2)
    x_ddot_pred = state.x_ddot_pred
    x_cov = _predict(state, tuning, dt, h)

    y_res = scan.x - x_pred  # (11)
    S = x_cov.P00 + tuning.r_x
    ok = S > 0.0
    K0, K1, K2 = x_cov.P00 / S, x_cov.P01 / S, x_cov.P02 / S  # (12)
    x_pred = np.where(ok, x_pred + K0 * y_res, x_pred)  # (13)
    x_dot_pred = np.where(ok, x_dot_pred + K1 * y_res, x_dot_pred)
    x_ddot_pred = np.where(ok, x_ddot_pred + K2 * y_res, x_ddot_pred)
    for array, new in (
        (state.x_pred, x_pred),
        (state.x_dot_pred, x_dot_pred),
        (state.x_ddot_pred, x_ddot_pred),
        (state.y_res, y_res),
        (state.S, S),
        (state.y, x_pred),
        (state.y_dot, x_dot_pred),
    ):
        np.copyto(array, new, where=scan.go)

    left = 1.0 - K0
    for array, new in (
        (state.K0, K0),
        (state.K1, K1),
        (state.K2, K2),
        (state.P00, left * x_cov.P00),  # (14)
        (state.P01, left * x_cov.P01),
        (state.P02, left * x_cov.P02),
        (state.P11, x_cov.P11 - K1 * x_cov.P01),
        (state.P12, x_cov.P12 - K1 * x_cov.P02),
        (state.P22, x_cov.P22 - K2 * x_cov.P02),
    ):
        np.copyto(array, new, where=scan.go & ok)

    result = scan.finish(state)
    result[scan.go & starting] = Result.INITIALISED
    result[scan.go & ~ok] = Result.S_NOT_POSITIVE
    return result


def _initialise(state: CvAccelBatchState, rows: Flags, x: Numbers) -> None:
    """Start at the measurement, at rest."""
    np.copyto(state.x_pred, x, where=rows)
    for name in ("x_dot_pred", "x_ddot_pred", "P01", "P02", "P12", "K0", "K1", "K2"):
        getattr(state, name)[rows] = 0.0
    state.P00[rows], state.P11[rows], state.P22[rows] = P_START
    state.init[rows] = True


def _predict(state: CvAccelBatchState, tuning: CvAccelTuning, dt: Numbers, h: Numbers) -> _Covariance:
    """F·P·Fᵀ + Q, (4) to (10)."""
    A00 = state.P00 + dt * state.P01 + h * state.P02
    A01 = state.P01 + dt * state.P11 + h * state.P12
    A02 = state.P02 + dt * state.P12 + h * state.P22
    A11 = state.P11 + dt * state.P12
    A12 = state.P12 + dt * state.P22
    Q = _Covariance(tuning.q_x, *(np.zeros_like(dt),) * 2, tuning.q_x_dot, np.zeros_like(dt), tuning.q_x_ddot)
    if tuning.white_jerk.any():
        q1 = tuning.q_jerk * dt
        q2 = q1 * dt
        q3 = q2 * dt
        q4 = q3 * dt
        q5 = q4 * dt
        white = (q5 / 20.0, q4 / 8.0, q3 / 6.0, q3 / 3.0, q2 / 2.0, q1)
        Q = _Covariance(*(np.where(tuning.white_jerk, new, old) for new, old in zip(white, Q, strict=True)))
    return _Covariance(
        A00 + dt * A01 + h * A02 + Q.P00,
        A01 + dt * A02 + Q.P01,
        A02 + Q.P02,
        A11 + dt * A12 + Q.P11,
        A12 + Q.P12,
        state.P22 + Q.P22,
    )
