"""FB_KalmanFilter on arrays: the operations of `kernel.reference.fb_kalman` in the same order, a row for each axis.

Names, equations and units are those of the reference. Bit-equal to it in both variants and both precisions: no
x ** 2, no matrix product, no fused multiply-add. The whole state is computed beside the old one, in buffers that are
made once, and then committed to the rows that it is meant for.
"""

from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from softplc.kernel.batch.frame import add_to
from softplc.kernel.result import Result

Numbers = NDArray[Any]  # float64[n] (LREAL) or float32[n] (REAL)
Flags = NDArray[np.bool_]
Variant = Literal["as_written", "corrected"]
Start = Literal["zero", "measurement"]

_PREDICTED = slice(0, 3)  # x_pos, y_res, S: written by every scan that predicts
_CORRECTED = slice(3, 9)  # x_vel, p_11, p_12, p_22, KalmanGain, k_vel: corrected writes them only when S > 0


class FbKalmanBatchState:
    """The variables of n function blocks as arrays[n], named as in the Structured Text, with its initial values.

    `y` and `y_dot` are the outputs EstimatedPosition and EstimatedVelocity. Where `init` is false the next scan is
    called with Reset TRUE, which is also how to reset a row.
    """

    def __init__(self, n: int, dtype: DTypeLike = np.float64) -> None:
        self.dtype = np.dtype(dtype)
        self.init: Flags = np.zeros(n, np.bool_)
        self.y: Numbers = np.zeros(n, self.dtype)
        self.y_dot: Numbers = np.zeros(n, self.dtype)
        self._rows: Numbers = np.zeros((9, n), self.dtype)
        self.x_pos, self.y_res, self.S = self._rows[_PREDICTED]
        self.x_vel, self.p_11, self.p_12, self.p_22, self.KalmanGain, self.k_vel = self._rows[_CORRECTED]
        self._scratch = _Scratch(n, self.dtype)
        self.clear(np.ones(n, np.bool_))

    def __len__(self) -> int:
        return len(self.init)

    def finite(self) -> Flags:
        """Rows without NaN and infinity in the state; valid until the next call."""
        scratch = self._scratch
        np.isfinite(self._rows, out=scratch.finite)
        return np.logical_and.reduce(scratch.finite, axis=0, out=scratch.all_finite)

    def clear(self, rows: Flags) -> None:
        """Forget everything about these rows, as before the first call."""
        for array in (self.init, self.y, self.y_dot):
            array[rows] = 0
        self._rows[:, rows] = 0
        self.p_11[rows] = 1.0
        self.p_22[rows] = 1.0

    def shift(self, rows: Flags, by: NDArray[np.float64]) -> None:
        """The origin of these rows moves: their positions grow by `by` [n], u, rounded once."""
        for array in (self.x_pos, self.y):
            add_to(array, rows, by)


class FbKalmanTuning:
    """Q and R of n function blocks as arrays[n] in the precision of the state; variant and start of them all.

    `Q`: process noise of the velocity per scan, (u/s)². `R`: measurement noise variance per sample, u².
    """

    def __init__(
        self,
        dtype: DTypeLike,
        *,
        Q: ArrayLike,
        R: ArrayLike,
        variant: Variant = "as_written",
        start: Start = "zero",
    ) -> None:
        with np.errstate(all="ignore"):
            self.Q: Numbers = np.array(Q, dtype)
            self.R: Numbers = np.array(R, dtype)
        self.variant = variant
        self.start = start


class _Scratch:
    """Buffers of one step: what the next state would be, and what is needed on the way."""

    def __init__(self, n: int, dtype: np.dtype[Any]) -> None:
        self.z: Numbers = np.zeros(n, dtype)
        self.dt: Numbers = np.zeros(n, dtype)
        self.rows: Numbers = np.zeros((9, n), dtype)
        self.x_pos, self.y_res, self.S = self.rows[_PREDICTED]
        self.x_vel, self.p_11, self.p_12, self.p_22, self.KalmanGain, self.k_vel = self.rows[_CORRECTED]
        self.a: Numbers = np.zeros(n, dtype)
        self.b: Numbers = np.zeros(n, dtype)
        self.run: Flags = np.zeros(n, np.bool_)
        self.go: Flags = np.zeros(n, np.bool_)
        self.ok: Flags = np.zeros(n, np.bool_)
        self.finite: Flags = np.zeros((9, n), np.bool_)
        self.all_finite: Flags = np.zeros(n, np.bool_)
        self.result: NDArray[np.uint8] = np.zeros(n, np.uint8)


@np.errstate(all="ignore")
def step(
    state: FbKalmanBatchState,
    tuning: FbKalmanTuning,
    *,
    EnableIn: Flags,
    x: NDArray[Any],
    dt: NDArray[Any],
    rows: Flags,
) -> NDArray[np.uint8]:
    """One scan of the rows where `rows` is true; the others are untouched. `x` in u, `dt` in s, all arrays[n].

    As written takes every dt as the block does: 0 divides by zero. Corrected passes through where dt is not above
    zero (DT_INVALID) and puts out the prediction where S is not (S_NOT_POSITIVE). Returns the Result of each row,
    valid until the next step.
    """
    new, corrected = state._scratch, tuning.variant == "corrected"
    new.z[:] = x
    new.dt[:] = dt
    np.logical_and(rows, EnableIn, out=new.run)
    if corrected:
        np.greater(new.dt, 0.0, out=new.go)
        np.logical_and(new.go, new.run, out=new.go)
    else:
        np.copyto(new.go, new.run)
    np.greater(new.go, state.init, out=new.ok)  # to run, not initialised
    starting = np.flatnonzero(new.ok) if new.ok.any() else None
    if starting is not None:
        _reset(state, starting, new.z if tuning.start == "measurement" else None)

    _predict(state, new, tuning)
    if corrected:
        np.greater(new.S, 0.0, out=new.ok)
        _update_corrected(state, new)
    else:
        new.ok.fill(True)
        _update_as_written(state, new, tuning)

    new.result.fill(Result.UPDATED)
    if starting is not None:
        new.result[starting] = Result.INITIALISED
    _commit(state, new, rows)
    return new.result


def _reset(state: FbKalmanBatchState, rows: NDArray[np.intp], z: Numbers | None) -> None:
    """What Reset sets: at rest at 0, or at the measurement when it is given."""
    state.x_pos[rows] = 0.0 if z is None else z[rows]
    state.x_vel[rows] = 0.0
    state.p_11[rows] = 1.0
    state.p_12[rows] = 0.0
    state.p_22[rows] = 1.0
    state.init[rows] = True


def _predict(state: FbKalmanBatchState, new: _Scratch, tuning: FbKalmanTuning) -> None:
    """Predicted state and covariance, innovation and its variance, into the scratch buffers."""
    dt, a, b = new.dt, new.a, new.b
    np.multiply(dt, state.x_vel, out=a)
    np.add(state.x_pos, a, out=new.x_pos)

    np.multiply(dt, state.p_22, out=a)
    np.add(state.p_12, a, out=new.p_12)
    np.multiply(2.0, state.p_12, out=b)
    np.add(a, b, out=a)
    np.multiply(dt, a, out=a)
    np.add(state.p_11, a, out=new.p_11)
    np.add(state.p_22, tuning.Q, out=new.p_22)

    np.subtract(new.z, new.x_pos, out=new.y_res)
    np.add(new.p_11, tuning.R, out=new.S)
    np.divide(new.p_11, new.S, out=new.KalmanGain)


def _update_as_written(state: FbKalmanBatchState, new: _Scratch, tuning: FbKalmanTuning) -> None:
    """The velocity takes what the position has left over; Q is added a second time."""
    a, b, K = new.a, new.b, new.KalmanGain
    np.multiply(K, new.y_res, out=a)
    np.add(new.x_pos, a, out=new.x_pos)
    np.divide(K, new.dt, out=a)
    np.subtract(new.z, new.x_pos, out=b)
    np.multiply(a, b, out=a)
    np.add(state.x_vel, a, out=new.x_vel)

    np.subtract(1.0, K, out=a)
    np.multiply(a, new.p_11, out=new.p_11)
    np.multiply(a, new.p_12, out=new.p_12)
    np.multiply(a, new.p_22, out=new.p_22)
    np.add(new.p_22, tuning.Q, out=new.p_22)

    np.multiply(K, a, out=b)
    np.divide(b, new.dt, out=new.k_vel)


def _update_corrected(state: FbKalmanBatchState, new: _Scratch) -> None:
    """Both gains before p changes, both on the innovation; where S is not positive the position stays predicted."""
    a, K = new.a, new.KalmanGain
    np.divide(new.p_12, new.S, out=new.k_vel)
    np.multiply(K, new.y_res, out=a)
    np.add(new.x_pos, a, out=new.x_pos, where=new.ok)
    np.multiply(new.k_vel, new.y_res, out=a)
    np.add(state.x_vel, a, out=new.x_vel)

    np.multiply(new.k_vel, new.p_12, out=a)
    np.subtract(new.p_22, a, out=new.p_22)
    np.subtract(1.0, K, out=a)
    np.multiply(a, new.p_11, out=new.p_11)
    np.multiply(a, new.p_12, out=new.p_12)


def _commit(state: FbKalmanBatchState, new: _Scratch, rows: Flags) -> None:
    """The new state to the rows that ran; the others pass through or stay as they are."""
    go, ok = new.go, new.ok
    if go.all() and ok.all():
        np.copyto(state._rows, new.rows)
        np.copyto(state.y, state.x_pos)
        np.copyto(state.y_dot, state.x_vel)
        return
    updated = go & ok
    np.copyto(state._rows[_PREDICTED], new.rows[_PREDICTED], where=go)
    np.copyto(state._rows[_CORRECTED], new.rows[_CORRECTED], where=updated)
    np.copyto(state.y, state.x_pos, where=go)
    np.copyto(state.y_dot, state.x_vel, where=go)

    through = rows & ~go  # disabled, or dt not above zero
    np.copyto(state.y, new.z, where=through)
    np.copyto(state.y_dot, 0.0, where=through)
    disabled = rows & ~new.run
    state.init[disabled] = False

    new.result[go & ~ok] = Result.S_NOT_POSITIVE
    new.result[through] = Result.DT_INVALID
    new.result[disabled] = Result.DISABLED
    new.result[~rows] = Result.SKIPPED
