"""The 1€ filter on arrays: the operations of `kernel.reference.one_euro`, one row for each axis."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from softplc.kernel.batch.frame import Flags, Frame, Numbers, Rows, numbers
from softplc.kernel.reference.one_euro import TURN


class OneEuroBatchState(Rows):
    """The state of n filters; the y and y_dot of a row are also its outputs."""

    NAMES = ("y", "y_dot", "x_prev", "x_hat", "dx_hat", "cutoff")
    POSITIONS = ("y", "x_prev", "x_hat")
    x_prev: Numbers
    x_hat: Numbers
    dx_hat: Numbers
    cutoff: Numbers


class OneEuroTuning:
    """`min_cutoff` and `d_cutoff` in Hz, `beta` in 1/u, `filtered` bool[n] as in the paper; arrays[n]."""

    def __init__(
        self,
        dtype: DTypeLike = np.float64,
        *,
        min_cutoff: ArrayLike,
        beta: ArrayLike,
        d_cutoff: ArrayLike,
        filtered: ArrayLike,
    ) -> None:
        self.min_cutoff: Numbers = numbers(min_cutoff, dtype)
        self.beta: Numbers = numbers(beta, dtype)
        self.d_cutoff: Numbers = numbers(d_cutoff, dtype)
        self.filtered: Flags = np.array(filtered, np.bool_)


@np.errstate(all="ignore")
def step(
    state: OneEuroBatchState,
    tuning: OneEuroTuning,
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
    before = np.where(tuning.filtered, state.x_hat, state.x_prev)
    dx = (scan.x - before) / scan.dt  # (2)
    a = 1.0 / (1.0 + 1.0 / (TURN * tuning.d_cutoff * scan.dt))  # (1)
    dx_hat = a * dx + (1.0 - a) * state.dx_hat  # (3)
    cutoff = tuning.min_cutoff + tuning.beta * np.abs(dx_hat)  # (4)
    a = 1.0 / (1.0 + 1.0 / (TURN * cutoff * scan.dt))  # (1)
    x_hat = a * scan.x + (1.0 - a) * state.x_hat  # (5)
    for array, new in (
        (state.x_prev, scan.x),
        (state.x_hat, x_hat),
        (state.dx_hat, dx_hat),
        (state.cutoff, cutoff),
        (state.y, x_hat),
        (state.y_dot, dx_hat),
    ):
        np.copyto(array, new, where=scan.on)

    if scan.start.any():
        for array, first in (
            (state.x_prev, scan.x),
            (state.x_hat, scan.x),
            (state.dx_hat, 0.0),
            (state.cutoff, tuning.min_cutoff),
            (state.y, scan.x),
            (state.y_dot, 0.0),
        ):
            np.copyto(array, first, where=scan.start)
    return scan.finish(state)
