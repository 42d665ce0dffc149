"""Coasting on arrays: the operations of `kernel.reference.coast` in the same order, one row for each axis.

Bit-equal to the reference. `dt` is what a scan of that observer takes: milliseconds for the AOI, seconds for all
others. Only rows that are meant, have started, and have a time above zero are carried on.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from softplc.kernel.batch import adaptive, adaptive_hypotheses, aoi, cv_accel, ducekf, fb_kalman
from softplc.kernel.batch.alpha_beta import AlphaBetaBatchState

Numbers = NDArray[Any]
Flags = NDArray[np.bool_]


@np.errstate(all="ignore")
def aoi_coast(state: aoi.AoiBatchState, tuning: aoi.AoiTuning, dt: Numbers, rows: Flags) -> None:
    """(2) to (12) and S of (17), with the options of process and measurement noise; `state.y` is without offset."""
    new = state._scratch
    new.dt_s[:] = dt
    np.divide(new.dt_s, 1000.0, out=new.dt_s)
    where = rows & state.init & (new.dt_s > 0.0)
    if tuning.options is None:
        aoi._predict(state, new, tuning)
    else:
        aoi._propagate(state, new)
        tuning.options.add_noise(state, new, tuning)
    _take(
        where,
        (state.dt_s, new.dt_s),
        (state.x_pred, new.x_pred),
        *zip((state.P0, state.P1, state.P2, state.P3), new.x_cov, strict=True),
        (state.S, new.S),
        (state.y, new.x_pred),
        (state.y_dot, state.x_dot_pred),
    )
    _nothing(where, state.K0, state.K1, state.y_res)


@np.errstate(all="ignore")
def fb_kalman_coast(
    state: fb_kalman.FbKalmanBatchState, tuning: fb_kalman.FbKalmanTuning, dt: Numbers, rows: Flags
) -> None:
    """The block's prediction step."""
    new = state._scratch
    new.dt[:] = dt
    where = rows & state.init & (new.dt > 0.0)
    fb_kalman._predict(state, new, tuning)
    _take(
        where,
        (state.x_pos, new.x_pos),
        (state.p_11, new.p_11),
        (state.p_12, new.p_12),
        (state.p_22, new.p_22),
        (state.S, new.S),
        (state.y, new.x_pos),
        (state.y_dot, state.x_vel),
    )
    _nothing(where, state.KalmanGain, state.k_vel, state.y_res)


@np.errstate(all="ignore")
def cv_accel_coast(
    state: cv_accel.CvAccelBatchState, tuning: cv_accel.CvAccelTuning, dt: Numbers, rows: Flags
) -> None:
    """(1) to (10) and S of (11)."""
    dt = np.asarray(dt, state.dtype)
    where, h = rows & state.init & (dt > 0.0), 0.5 * dt * dt
    x_pred = state.x_pred + dt * state.x_dot_pred + h * state.x_ddot_pred
    x_dot_pred = state.x_dot_pred + dt * state.x_ddot_pred
    x_cov = cv_accel._predict(state, tuning, dt, h)
    _take(
        where,
        (state.x_pred, x_pred),
        (state.x_dot_pred, x_dot_pred),
        *((getattr(state, name), getattr(x_cov, name)) for name in x_cov._fields),
        (state.S, x_cov.P00 + tuning.r_x),
        (state.y, x_pred),
        (state.y_dot, x_dot_pred),
    )
    _nothing(where, state.K0, state.K1, state.K2, state.y_res)


@np.errstate(all="ignore")
def ducekf_coast(
    state: ducekf.DucekfBatchState,
    tuning: ducekf.DucekfBatchTuning,
    model: ducekf.Model,
    dt: Numbers,
    rows: Flags,
) -> None:
    """(3) and (4), up to the surface."""
    where = rows & state.init & (dt > 0.0)
    x1, x2 = model.f(state.x1, state.x2, dt)
    limit, side = model.surface(x1)
    x1 = np.where(side * (x1 - limit) < 0.0, limit, x1)
    P = ducekf._propagate(model.jacobian(state.x1, state.x2, dt), state)
    P00 = P[0] + tuning.q_x
    _take(
        where,
        (state.x1, x1),
        (state.x2, x2),
        (state.P00, P00),
        (state.P01, P[1]),
        (state.P11, P[3] + tuning.q_x_dot),
        (state.S, P00 + tuning.r_x),
        (state.y, x1),
        (state.y_dot, x2),
    )
    _nothing(where, state.K0, state.K1, state.y_res)


@np.errstate(all="ignore")
def adaptive_coast(
    state: adaptive.AdaptiveBatchState, tuning: adaptive_hypotheses.AdaptiveTuning, dt: Numbers, rows: Flags
) -> None:
    """Births and prediction as in every scan; the weights are what these make them."""
    dt = np.asarray(dt, state.dtype)
    adaptive.carry_on(state, tuning, dt, rows & state.init & (dt > 0.0))


@np.errstate(all="ignore")
def alpha_beta_coast(state: AlphaBetaBatchState, dt: Numbers, rows: Flags) -> None:
    """(1)."""
    dt = np.asarray(dt, state.dtype)
    where = rows & state.init & (dt > 0.0)
    x_pred = state.x_pred + dt * state.x_dot_pred
    _take(where, (state.x_pred, x_pred), (state.y, x_pred), (state.y_dot, state.x_dot_pred))
    _nothing(where, state.y_res, state.K0, state.K1)


def _take(where: Flags, *pairs: tuple[Numbers, Numbers]) -> None:
    for array, new in pairs:
        np.copyto(array, new, where=where)


def _nothing(where: Flags, *arrays: Numbers) -> None:
    for array in arrays:
        np.copyto(array, 0.0, where=where)
