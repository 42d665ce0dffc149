"""The finite difference on arrays: the operations of `kernel.reference.finite_difference`, one row for each axis."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from softplc.kernel.batch.frame import Flags, Frame, Numbers, Rows


class FiniteDifferenceBatchState(Rows):
    """The state of n finite differences; the y and y_dot of a row are also its outputs."""

    NAMES = ("y", "y_dot", "x_prev")
    POSITIONS = ("y", "x_prev")
    x_prev: Numbers


class FiniteDifferenceTuning:
    """A finite difference has nothing to tune."""


@np.errstate(all="ignore")
def step(
    state: FiniteDifferenceBatchState,
    tuning: FiniteDifferenceTuning,  # every kernel is called alike
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
    np.copyto(state.y_dot, (scan.x - state.x_prev) / scan.dt, where=scan.on)
    np.copyto(state.y_dot, 0.0, where=scan.start)
    np.copyto(state.x_prev, scan.x, where=scan.go)
    np.copyto(state.y, scan.x, where=scan.go)
    return scan.finish(state)
