"""The DERIVATIVE block on arrays: the operations of `kernel.reference.derivative`, one row for each axis."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from softplc.kernel.batch.frame import Flags, Frame, Numbers, Rows, numbers


class DerivativeBatchState(Rows):
    """The state of n blocks; the y and y_dot (XOUT) of a row are also its outputs."""

    NAMES = ("y", "y_dot", "X1", "X2", "X3", "h1", "h2")
    POSITIONS = ("y", "X1", "X2", "X3")
    X1: Numbers
    X2: Numbers
    X3: Numbers
    h1: Numbers
    h2: Numbers


class DerivativeTuning:
    """`cycle` in seconds, the period that the block believes in; `measured` bool[n], where it uses measured steps."""

    def __init__(self, dtype: DTypeLike = np.float64, *, cycle: ArrayLike, measured: ArrayLike) -> None:
        self.cycle: Numbers = numbers(cycle, dtype)
        self.measured: Flags = np.array(measured, np.bool_)


@np.errstate(all="ignore")
def step(
    state: DerivativeBatchState,
    tuning: DerivativeTuning,
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
    measured = 3.0 * scan.dt + 4.0 * state.h1 + 3.0 * state.h2  # (2)
    time = np.where(tuning.measured, measured, 10.0 * tuning.cycle)
    XOUT = (3.0 * (scan.x - state.X3) + state.X1 - state.X2) / time  # (1)
    np.copyto(state.y_dot, XOUT, where=scan.on)
    np.copyto(state.y, scan.x, where=scan.on)
    for newer, older in ((state.X2, state.X3), (state.X1, state.X2), (scan.x, state.X1)):
        np.copyto(older, newer, where=scan.on)
    for newer, older in ((state.h1, state.h2), (scan.dt, state.h1)):
        np.copyto(older, newer, where=scan.on)

    reset = scan.start | scan.disabled  # RUN = FALSE
    if reset.any():
        for array in (state.y, state.X1, state.X2, state.X3):
            np.copyto(array, scan.x, where=reset)
        for array in (state.h1, state.h2):
            np.copyto(array, scan.dt, where=scan.start)
        np.copyto(state.y_dot, 0.0, where=reset)
    return scan.finish(state, warm=4)
