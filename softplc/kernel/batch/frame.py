"""What the simple observers share on arrays: named state rows, and which rows do what in a scan.

The rules are those of every observer: a disabled row passes its measurement through and starts anew with the next
enabled scan; a row whose dt is not above zero passes it through and keeps its state; a row starts on its first
enabled measurement with a valid dt.
"""

from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from softplc.kernel.result import Result

Numbers = NDArray[Any]  # float64[n], or float32[n] where the observer computes in REAL
Flags = NDArray[np.bool_]
Counts = NDArray[np.int64]


class Rows:
    """The variables of n observers as arrays[n], named as in the reference; zero before the first scan.

    `NAMES` are the numbers of a row, `POSITIONS` those of them that are positions. `samples` counts the measurements
    since the row started.
    """

    NAMES: ClassVar[tuple[str, ...]]
    POSITIONS: ClassVar[tuple[str, ...]]
    y: Numbers
    y_dot: Numbers

    def __init__(self, n: int, dtype: DTypeLike = np.float64) -> None:
        self.dtype = np.dtype(dtype)
        self.init: Flags = np.zeros(n, np.bool_)
        self.samples: Counts = np.zeros(n, np.int64)
        self._values: Numbers = np.zeros((len(self.NAMES), n), self.dtype)
        for name, values in zip(self.NAMES, self._values, strict=True):
            setattr(self, name, values)

    def __len__(self) -> int:
        return len(self.init)

    def finite(self) -> Flags:
        """Rows without NaN and infinity in the state."""
        finite: Flags = np.logical_and.reduce(np.isfinite(self._values), axis=0)
        return finite

    def clear(self, rows: Flags) -> None:
        """Forget everything about these rows, as before the first scan."""
        self.init[rows] = False
        self.samples[rows] = 0
        self._values[:, rows] = 0.0

    def shift(self, rows: Flags, by: NDArray[np.float64]) -> None:
        """The origin of these rows moves: every position that they hold grows by `by` [n], u, rounded once."""
        for name in self.POSITIONS:
            add_to(getattr(self, name), rows, by)


class Frame:
    """One scan of n rows, sorted by what is to be done; bool[n] each, `x` and `dt` in the precision of the state.

    `start`: initialise on this measurement; `on`: go on from the state; `go`: either of them.
    `through`: pass the measurement through; `disabled`: because the row is not enabled.
    """

    def __init__(self, state: Rows, EnableIn: Flags, x: NDArray[Any], dt: NDArray[Any], rows: Flags) -> None:
        self.x: Numbers = x.astype(state.dtype, copy=False)
        self.dt: Numbers = dt.astype(state.dtype, copy=False)
        self.rows = rows
        self.disabled: Flags = rows & ~EnableIn
        self.go: Flags = np.greater(self.dt, 0.0) & rows & EnableIn
        self.start: Flags = self.go & ~state.init
        self.on: Flags = self.go & state.init
        self.through: Flags = rows & ~self.go

    def finish(self, state: Rows, *, warm: int | Counts = 1) -> NDArray[np.uint8]:
        """Commit what is common to all; the Result of each row, warming up below `warm` samples since the start."""
        state.init[self.start] = True
        state.init[self.disabled] = False
        state.samples[self.start] = 1
        state.samples[self.on] += 1
        state.samples[self.disabled] = 0
        np.copyto(state.y, self.x, where=self.through)
        np.copyto(state.y_dot, 0.0, where=self.through)

        result = np.full(len(state), Result.SKIPPED, np.uint8)
        result[self.on] = Result.UPDATED
        result[self.on & (state.samples < warm)] = Result.WARMING_UP
        result[self.start] = Result.INITIALISED
        result[self.through] = Result.DT_INVALID
        result[self.disabled] = Result.DISABLED
        return result


def add_to(array: Numbers, rows: Flags, by: NDArray[np.float64]) -> None:
    """array[rows] + by[rows] where it is, in float64 and rounded once to the precision of the array."""
    array[rows] = array[rows] + by[rows]


def numbers(values: ArrayLike, dtype: DTypeLike = np.float64) -> Numbers:
    """A tuning input in the precision of the state; too large for it becomes infinite."""
    with np.errstate(all="ignore"):
        return np.array(values, dtype)
