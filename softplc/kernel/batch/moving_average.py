"""The moving average on arrays: the operations of `kernel.reference.moving_average`, one row for each axis."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from softplc.kernel.batch.frame import Counts, Flags, Frame, Numbers, Rows


class MovingAverageBatchState(Rows):
    """The state of n moving averages; the y and y_dot of a row are also its outputs.

    `X` and `DT` are the rings, arrays[longest window, n]; slots beyond a row's own window stay 0. `used` are those
    that hold a sample.
    """

    NAMES = ("y", "y_dot")
    POSITIONS = ("y",)

    def __init__(self, n: int, dtype: DTypeLike = np.float64, *, longest: int) -> None:
        super().__init__(n, dtype)
        self.head: Counts = np.zeros(n, np.int64)
        self.used: Counts = np.zeros(n, np.int64)
        self.X: Numbers = np.zeros((longest, n), self.dtype)
        self.DT: Numbers = np.zeros((longest, n), self.dtype)
        self._sums: Numbers = np.zeros((longest, n), self.dtype)

    def reserve(self, longest: int) -> None:
        """Room for windows of this length; what the rings hold stays. For rows that start anew with a longer one."""
        missing = longest - len(self.X)
        if missing > 0:
            more = np.zeros((missing, len(self)), self.dtype)
            self.X, self.DT, self._sums = (np.concatenate((ring, more)) for ring in (self.X, self.DT, self._sums))

    def finite(self) -> Flags:
        """Rows without NaN and infinity in the state."""
        finite: Flags = np.logical_and(super().finite(), np.logical_and.reduce(np.isfinite(self.X), axis=0))
        return finite

    def clear(self, rows: Flags) -> None:
        """Forget everything about these rows, as before the first scan."""
        super().clear(rows)
        self.head[rows] = 0
        self.used[rows] = 0
        self.X[:, rows] = 0.0
        self.DT[:, rows] = 0.0

    def shift(self, rows: Flags, by: NDArray[np.float64]) -> None:
        """The origin of these rows moves: the samples in their rings grow by `by` [n], u."""
        super().shift(rows, by)
        held = rows & (np.arange(len(self.X))[:, np.newaxis] < self.used)
        np.add(self.X, by, out=self.X, where=held, casting="same_kind")

    def sum(self, ring: Numbers) -> Numbers:
        """Sum of each row's ring in the order of the slots: `accumulate` adds one after the other by definition."""
        total: Numbers = np.add.accumulate(ring, axis=0, out=self._sums)[-1]
        return total


class MovingAverageTuning:
    """`window` int64[n]: the samples to average, at least 2 and at most the state's longest."""

    def __init__(self, dtype: DTypeLike = np.float64, *, window: ArrayLike) -> None:
        self.window: Counts = np.array(window, np.int64)


@np.errstate(all="ignore")
def step(
    state: MovingAverageBatchState,
    tuning: MovingAverageTuning,
    *,
    EnableIn: Flags,
    x: NDArray[Any],
    dt: NDArray[Any],
    rows: Flags,
) -> NDArray[np.uint8]:
    """One scan of the rows where `rows` is true; the others are untouched. `x` in u, `dt` in s, all arrays[n].

    Returns the Result of each row.
    """
    scan, window = Frame(state, EnableIn, x, dt, rows), tuning.window
    if scan.start.any():
        state.X[:, scan.start] = 0.0
        state.DT[:, scan.start] = 0.0
        state.head[scan.start] = 0

    every = np.arange(len(state))
    oldest = np.where(state.samples >= window, state.X[state.head, every], state.X[0])
    go, head = np.flatnonzero(scan.go), state.head[scan.go]
    state.X[head, go] = scan.x[go]
    state.DT[head, go] = np.where(scan.start[go], 0.0, scan.dt[go])
    state.head[go] = (head + 1) % window[go]

    y = state.sum(state.X) / np.minimum(state.samples + 1, window)
    np.copyto(state.y, y, where=scan.on)
    np.copyto(state.y_dot, (scan.x - oldest) / state.sum(state.DT), where=scan.on)
    np.copyto(state.y, scan.x, where=scan.start)
    np.copyto(state.y_dot, 0.0, where=scan.start)

    result = scan.finish(state, warm=window + 1)
    np.minimum(state.samples, window, out=state.used)
    return result
