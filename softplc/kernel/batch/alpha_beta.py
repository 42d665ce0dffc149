"""The α-β filter on arrays: the operations of `kernel.reference.alpha_beta`, one row for each axis."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from softplc.kernel.batch.frame import Flags, Frame, Numbers, Rows, numbers


class AlphaBetaBatchState(Rows):
    """The state of n filters; the y and y_dot of a row are also its outputs."""

    NAMES = ("y", "y_dot", "x_pred", "x_dot_pred", "y_res", "S", "K0", "K1")
    POSITIONS = ("y", "x_pred")
    x_pred: Numbers
    x_dot_pred: Numbers
    y_res: Numbers
    S: Numbers
    K0: Numbers
    K1: Numbers


class AlphaBetaTuning:
    """Gains `alpha`, `beta`, or where `indexed` deviations `sigma_w` in u/s² and `sigma_v` in u; arrays[n]."""

    def __init__(
        self,
        dtype: DTypeLike = np.float64,
        *,
        indexed: ArrayLike,
        alpha: ArrayLike,
        beta: ArrayLike,
        sigma_w: ArrayLike,
        sigma_v: ArrayLike,
    ) -> None:
        self.indexed: Flags = np.array(indexed, np.bool_)
        self.alpha: Numbers = numbers(alpha, dtype)
        self.beta: Numbers = numbers(beta, dtype)
        self.sigma_w: Numbers = numbers(sigma_w, dtype)
        self.sigma_v: Numbers = numbers(sigma_v, dtype)


@np.errstate(all="ignore")
def step(
    state: AlphaBetaBatchState,
    tuning: AlphaBetaTuning,
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
    go = scan.go
    np.copyto(state.x_pred, scan.x, where=scan.start)
    np.copyto(state.x_dot_pred, 0.0, where=scan.start)

    alpha, beta, S = tuning.alpha, tuning.beta, np.zeros_like(state.S)
    if tuning.indexed.any():
        alpha, beta, S = (
            np.where(tuning.indexed, from_index, fixed)
            for from_index, fixed in zip(_gains(tuning, scan.dt), (alpha, beta, S), strict=True)
        )

    K1 = beta / scan.dt
    x_pred = state.x_pred + scan.dt * state.x_dot_pred  # (1)
    y_res = scan.x - x_pred  # (2)
    x_pred = x_pred + alpha * y_res  # (3)
    x_dot_pred = state.x_dot_pred + K1 * y_res  # (4)
    for array, new in (
        (state.x_pred, x_pred),
        (state.x_dot_pred, x_dot_pred),
        (state.y_res, y_res),
        (state.S, S),
        (state.K0, alpha),
        (state.K1, K1),
        (state.y, x_pred),
        (state.y_dot, x_dot_pred),
    ):
        np.copyto(array, new, where=go)
    return scan.finish(state)


def _gains(tuning: AlphaBetaTuning, dt: Numbers) -> tuple[Numbers, Numbers, Numbers]:
    """α, β and S from the tracking index, (5) to (9)."""
    index = tuning.sigma_w * dt * dt / tuning.sigma_v
    s = np.sqrt(index * (8.0 + index))
    d = 4.0 + index + s
    rho = 4.0 / d
    e = (index + s) / d
    return e * (1.0 + rho), 2.0 * e * e, tuning.sigma_v * tuning.sigma_v / (rho * rho)
