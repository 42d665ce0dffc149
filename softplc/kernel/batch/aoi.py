"""The Logix AOI on arrays: the operations of `kernel.reference.aoi` in the same order, one row for each axis.

Names, equations and units are those of the reference. The arithmetic runs over all rows in buffers that are made
once, and is then committed to the rows that it is meant for; where every row is in the normal course of things
`aoi_steady` does it for less. Bit-equal to the reference in both precisions: no x ** 2, no matrix product, no fused
multiply-add.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from softplc.kernel.batch.aoi_steady import Steady, tuning_parts
from softplc.kernel.batch.frame import add_to
from softplc.kernel.batch.memory import aligned
from softplc.kernel.result import Result

if TYPE_CHECKING:
    from softplc.kernel.batch.aoi_options import AoiBatchOptions

Numbers = NDArray[Any]  # float64[n] (LREAL) or float32[n] (REAL)
Flags = NDArray[np.bool_]
Step = Callable[..., NDArray[np.uint8]]  # step, or what does the same faster

_PREDICTED = slice(0, 3)  # x_pred, y_res, S: written by every scan with a valid dt
_CORRECTED = slice(3, 10)  # x_dot_pred, P0..P3, K0, K1: written only when S > 0


class AoiBatchState:
    """The persistent variables of n function blocks as arrays[n], named as in the Structured Text; zero at first.

    The y and y_dot of a row are also its outputs. The last three are of the options and stay zero without them:
    positions are relative to `offset` (float64), `in_a_row` and `rejected` count rejected samples. The rows of
    `numbers` are the same memory: x_pred, y_res, S, x_dot_pred, P0 to P3, K0, K1, dt_s, y, y_dot. Those of `bytes`
    are init and the results of the last step.
    """

    def __init__(self, n: int, dtype: DTypeLike = np.float64) -> None:
        self.dtype = np.dtype(dtype)
        self.bytes: NDArray[np.uint8] = np.zeros((2, n), np.uint8)
        self.init: Flags = self.bytes[0].view(np.bool_)
        self.numbers: Numbers = aligned((13, n), self.dtype)
        self.dt_s, self.y, self.y_dot = self.numbers[10:]
        self._rows: Numbers = self.numbers[:10]
        self.x_pred, self.y_res, self.S = self._rows[_PREDICTED]
        self.x_dot_pred, self.P0, self.P1, self.P2, self.P3, self.K0, self.K1 = self._rows[_CORRECTED]
        self.offset: NDArray[np.float64] = np.zeros(n)
        self.in_a_row: NDArray[np.int64] = np.zeros(n, np.int64)
        self.rejected: NDArray[np.int64] = np.zeros(n, np.int64)
        self._scratch = _Scratch(n, self.dtype, self.bytes[1])
        self._steady = Steady(self.numbers)

    def __len__(self) -> int:
        return len(self.init)

    def finite(self) -> Flags:
        """Rows without NaN and infinity in the state; valid until the next call."""
        scratch = self._scratch
        np.isfinite(self._rows, out=scratch.finite)
        return np.logical_and.reduce(scratch.finite, axis=0, out=scratch.all_finite)

    def clear(self, rows: Flags) -> None:
        """Forget everything about these rows, as before the first scan, but the count of rejected samples."""
        for array in (self.init, self.dt_s, self.y, self.y_dot, self.offset, self.in_a_row):
            array[rows] = 0
        self._rows[:, rows] = 0

    def shift(self, rows: Flags, by: NDArray[np.float64]) -> None:
        """The origin of these rows moves: their positions grow by `by` [n], u, rounded once. `offset` stays."""
        for array in (self.x_pred, self.y):
            add_to(array, rows, by)


class AoiTuning:
    """The tuning inputs of n function blocks as arrays[n] in the precision of the state; `options`: those in use.

    To change the tuning, write into an array: putting another in its place raises AttributeError, since others hold
    the same memory. It is that of the rows of `numbers`: q_x, q_x_dot, r_x, BleedThresh, BleedFactor. Raises
    ValueError unless each is one number for each axis. Units: q_x u² and q_x_dot (u/s)² per scan, r_x u² per sample.
    """

    def __init__(
        self,
        dtype: DTypeLike,
        *,
        q_x: ArrayLike,
        q_x_dot: ArrayLike,
        r_x: ArrayLike,
        BleedEnable: ArrayLike,
        BleedThresh: ArrayLike,
        BleedFactor: ArrayLike,
        options: "AoiBatchOptions | None" = None,
    ) -> None:
        self.options = options
        given = {"q_x": q_x, "q_x_dot": q_x_dot, "r_x": r_x, "BleedThresh": BleedThresh, "BleedFactor": BleedFactor}
        with np.errstate(all="ignore"):
            arrays = {name: np.array(one, dtype) for name, one in given.items()}
        arrays["BleedEnable"] = np.array(BleedEnable, np.bool_)
        for name, array in arrays.items():
            if array.shape != arrays["q_x"].shape or array.ndim != 1:
                raise ValueError(f"expected one {name} for each axis as q_x has them, found {list(array.shape)}")
        rows = np.stack([arrays[name] for name in given])
        self.numbers: Numbers = aligned(rows.shape, dtype)
        self.numbers[:] = rows
        self.q_x, self.q_x_dot, self.r_x, self.BleedThresh, self.BleedFactor = self.numbers
        self.BleedEnable: Flags = arrays["BleedEnable"]
        self._parts = tuning_parts(self.numbers, self.BleedEnable)

    def __setattr__(self, name: str, value: object) -> None:
        if hasattr(vars(self).get(name), "dtype"):
            raise AttributeError(f"{name} is one array for good: write into it")
        super().__setattr__(name, value)


class _Scratch:
    """Buffers of one step: what the next state would be, and what is needed on the way."""

    def __init__(self, n: int, dtype: np.dtype[Any], result: NDArray[np.uint8]) -> None:
        self.x: Numbers = np.zeros(n, dtype)
        self.dt_s: Numbers = np.zeros(n, dtype)
        self.rows: Numbers = np.zeros((10, n), dtype)
        self.x_pred, self.y_res, self.S = self.rows[_PREDICTED]
        self.x_dot_pred, self.P0, self.P1, self.P2, self.P3, self.K0, self.K1 = self.rows[_CORRECTED]
        self.x_cov: tuple[Numbers, ...] = tuple(np.zeros((4, n), dtype))
        self.a: Numbers = np.zeros(n, dtype)
        self.b: Numbers = np.zeros(n, dtype)
        self.run: Flags = np.zeros(n, np.bool_)
        self.go: Flags = np.zeros(n, np.bool_)
        self.ok: Flags = np.zeros(n, np.bool_)
        self.flag: Flags = np.zeros(n, np.bool_)
        self.finite: Flags = np.zeros((10, n), np.bool_)
        self.all_finite: Flags = np.zeros(n, np.bool_)
        self.result = result


@np.errstate(all="ignore")
def step(
    state: AoiBatchState,
    tuning: AoiTuning,
    *,
    EnableIn: Flags,
    x: NDArray[Any],
    dt: NDArray[Any],
    rows: Flags,
) -> NDArray[np.uint8]:
    """One scan of the rows where `rows` is true; the others are untouched. `x` in u, `dt` in ms, all arrays[n].

    Returns the Result of each row, valid until the next step. `x` and `dt` are no memory of the state's.
    """
    if tuning.options is not None:
        return tuning.options.step(state, tuning, EnableIn=EnableIn, x=x, dt=dt, rows=rows)
    if not _all_usual(state, EnableIn, rows):
        return _step(state, tuning, EnableIn, x, dt, rows)
    result = state._scratch.result
    left = state._steady.step(tuning._parts, bool(np.count_nonzero(tuning.BleedEnable)), x, dt)
    if not left:
        result.fill(Result.UPDATED)
        return result
    others = np.ones(len(state), np.bool_)
    for these in left:
        others[these] = False
    _step(state, tuning, EnableIn, x, dt, ~others)
    result[others] = Result.UPDATED
    return result


def _all_usual(state: AoiBatchState, EnableIn: Flags, rows: Flags) -> bool:
    """Whether every row is to be stepped, enabled and initialised."""
    n, count = len(state), np.count_nonzero
    return n > 0 and count(rows) == n and count(EnableIn) == n and count(state.init) == n


def _step(
    state: AoiBatchState, tuning: AoiTuning, EnableIn: Flags, x: NDArray[Any], dt: NDArray[Any], rows: Flags
) -> NDArray[np.uint8]:
    """`step` whatever is given."""
    new = state._scratch
    new.x[:] = x
    new.dt_s[:] = dt
    np.less_equal(new.dt_s, 0.0, out=new.flag)
    np.divide(new.dt_s, 1000.0, out=new.dt_s)
    np.copyto(new.dt_s, 0.0, where=new.flag)

    np.logical_and(rows, EnableIn, out=new.run)
    np.greater(new.dt_s, 0.0, out=new.go)
    np.logical_and(new.go, new.run, out=new.go)
    np.greater(new.run, state.init, out=new.flag)  # to run, not initialised
    starting = np.flatnonzero(new.flag) if new.flag.any() else None
    if starting is not None:
        _initialise(state, starting, new.x)

    _predict(state, new, tuning)
    np.greater(new.S, 0.0, out=new.ok)
    _correct(state, new, tuning)
    new.result.fill(Result.UPDATED)
    _commit(state, new, rows)
    if starting is not None:
        started = new.result[starting]
        new.result[starting] = np.where(started == Result.UPDATED, np.uint8(Result.INITIALISED), started)
    return new.result


def _initialise(state: AoiBatchState, rows: NDArray[np.intp], x: Numbers) -> None:
    """Start at the measurement, at rest."""
    state.x_pred[rows] = x[rows]
    state.x_dot_pred[rows] = 0.0
    state.P0[rows] = 1.0
    state.P1[rows] = 0.0
    state.P2[rows] = 0.0
    state.P3[rows] = 10.0
    state.K0[rows] = 0.0
    state.K1[rows] = 0.0
    state.init[rows] = True


def _predict(state: AoiBatchState, new: _Scratch, tuning: AoiTuning) -> None:
    """Equations (2) to (12) and (17), into the scratch buffers."""
    _propagate(state, new)
    x_cov0, _, _, x_cov3 = new.x_cov
    np.add(x_cov0, tuning.q_x, out=x_cov0)
    np.add(state.P3, tuning.q_x_dot, out=x_cov3)
    np.subtract(new.x, new.x_pred, out=new.y_res)
    np.add(x_cov0, tuning.r_x, out=new.S)


def _propagate(state: AoiBatchState, new: _Scratch) -> None:
    """Equations (2) to (9); (10) leaves P11 as it is."""
    dt_s, a, b = new.dt_s, new.a, new.b
    x_cov0, x_cov1, x_cov2, _ = new.x_cov

    np.multiply(dt_s, state.x_dot_pred, out=a)
    np.add(state.x_pred, a, out=new.x_pred)

    np.multiply(dt_s, state.P3, out=a)
    np.add(state.P1, a, out=x_cov1)  # also the inner bracket of x_cov[0]
    np.add(state.P2, a, out=x_cov2)
    np.multiply(dt_s, state.P2, out=a)
    np.add(state.P0, a, out=a)
    np.multiply(dt_s, x_cov1, out=b)
    np.add(a, b, out=x_cov0)


def _correct(state: AoiBatchState, new: _Scratch, tuning: AoiTuning) -> None:
    """Equations (16) to (22), into the scratch buffers; where S is not positive the position stays predicted."""
    a, b = new.a, new.b
    x_cov0, x_cov1, x_cov2, x_cov3 = new.x_cov

    np.divide(x_cov0, new.S, out=new.K0)
    np.divide(x_cov2, new.S, out=new.K1)

    np.multiply(new.K0, new.y_res, out=a)
    np.add(new.x_pred, a, out=new.x_pred, where=new.ok)
    np.multiply(new.K1, new.y_res, out=a)
    np.add(state.x_dot_pred, a, out=new.x_dot_pred)

    if tuning.BleedEnable.any():
        np.subtract(new.x, new.x_pred, out=a)
        np.abs(a, out=a)
        np.less(a, tuning.BleedThresh, out=new.flag)
        np.logical_and(new.flag, tuning.BleedEnable, out=new.flag)
        np.multiply(new.x_dot_pred, tuning.BleedFactor, out=new.x_dot_pred, where=new.flag)

    np.subtract(1.0, new.K0, out=a)
    np.multiply(a, x_cov0, out=new.P0)
    np.multiply(a, x_cov1, out=new.P1)
    new.P2[:] = new.P1
    np.multiply(new.K1, x_cov1, out=b)
    np.subtract(x_cov3, b, out=new.P3)


def _commit(state: AoiBatchState, new: _Scratch, rows: Flags) -> None:
    """Some rows are disabled, have an invalid dt or S, or are not to be stepped at all."""
    go, run = new.go, new.run
    np.copyto(state.dt_s, new.dt_s, where=run)
    np.copyto(state._rows[_PREDICTED], new.rows[_PREDICTED], where=go)
    np.copyto(state._rows[_CORRECTED], new.rows[_CORRECTED], where=go & new.ok)
    np.copyto(state.y, state.x_pred, where=go)
    np.copyto(state.y_dot, state.x_dot_pred, where=go)

    through = rows & ~go  # pass through
    np.copyto(state.y, new.x, where=through)
    np.copyto(state.y_dot, 0.0, where=through)
    disabled = rows & ~run
    state.init[disabled] = False

    new.result[go & ~new.ok] = Result.S_NOT_POSITIVE
    new.result[through] = Result.DT_INVALID
    new.result[disabled] = Result.DISABLED
    new.result[~rows] = Result.SKIPPED
