"""Coasting: the state of each Kalman filter and of the α-β filter carried on over time that had no measurement.

It is the prediction of the observer's own scan, committed: x̂ = x̂⁻, P = P⁻ with the process noise of one scan, so
that P grows and is the right prior of the next measurement. Nothing is corrected: innovation and gains are 0, S is
the variance that an innovation would have, no velocity bleeds, no gate counts. Letters, units and equation numbers
are those of each observer's own module. A state that has not started, and a time that is not above zero, stay.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from softplc.kernel.reference import cv_accel
from softplc.kernel.reference.adaptive import AdaptiveInputs, AdaptiveState, carried_on
from softplc.kernel.reference.alpha_beta import AlphaBetaInputs, AlphaBetaState
from softplc.kernel.reference.aoi import AoiInputs, AoiState
from softplc.kernel.reference.aoi_options import (
    AoiOptions,
    AoiOptionsState,
    measurement_noise,
    predicted_covariance,
)
from softplc.kernel.reference.covariance import propagate
from softplc.kernel.reference.cv_accel import CvAccelInputs, CvAccelState
from softplc.kernel.reference.ducekf import DucekfInputs, DucekfState, DucekfTuning, Model
from softplc.kernel.reference.fb_kalman import FbKalmanInputs, FbKalmanState

_OFF = AoiOptions()


@np.errstate(all="ignore")
def aoi_coast(state: AoiState, inputs: AoiInputs, real: Any = np.float64, options: AoiOptions = _OFF) -> AoiState:
    """(2) to (12) and S of (17); `real` is the precision, np.float64 or np.float32."""
    dt, q_x, q_x_dot, r_x = real(inputs.dt), real(inputs.q_x), real(inputs.q_x_dot), real(inputs.r_x)
    dt_s = dt / 1000.0
    if not state.init or not dt_s > 0.0:
        return state
    x_pred = state.x_pred + dt_s * state.x_dot_pred
    P = predicted_covariance(state.P, q_x, q_x_dot, dt_s, options)
    R = measurement_noise(r_x, dt_s, options, real)
    return replace(
        state,
        dt_s=dt_s,
        x_pred=x_pred,
        P=P,
        K0=0.0,
        K1=0.0,
        S=P[0] + R,
        y_res=0.0,
        y=x_pred,
        y_dot=state.x_dot_pred,
    )


def aoi_options_coast(
    state: AoiOptionsState, inputs: AoiInputs, options: AoiOptions, real: Any = np.float64
) -> AoiOptionsState:
    """The same with the options of process and measurement noise; the rejected samples stay counted."""
    after = aoi_coast(state.aoi, inputs, real, options)
    return state if after is state.aoi else replace(state, aoi=after, position=state.offset + float(after.y))


@np.errstate(all="ignore")
def fb_kalman_coast(state: FbKalmanState, inputs: FbKalmanInputs, number: Any = np.float64) -> FbKalmanState:
    """The block's prediction step, the same in both variants; Q once, for there is no update to add it again."""
    Q, R, DeltaT = number(inputs.Q), number(inputs.R), number(inputs.DeltaT)
    if not state.init or not DeltaT > 0.0:
        return state
    x_pos, x_vel = number(state.x_pos), number(state.x_vel)
    p_11, p_12, p_22 = number(state.p_11), number(state.p_12), number(state.p_22)

    x_pos = x_pos + DeltaT * x_vel
    p_11 = p_11 + DeltaT * (DeltaT * p_22 + 2 * p_12)
    p_12 = p_12 + DeltaT * p_22
    p_22 = p_22 + Q

    nothing = number(0.0)
    return FbKalmanState(True, x_pos, x_vel, p_11, p_12, p_22, nothing, nothing, nothing, p_11 + R, x_pos, x_vel)


@np.errstate(all="ignore")
def cv_accel_coast(state: CvAccelState, inputs: CvAccelInputs) -> CvAccelState:
    """(1) to (10) and S of (11): the acceleration stays, the velocity goes on with it."""
    dt = np.float64(inputs.dt)
    if not state.init or not dt > 0.0:
        return state
    h = 0.5 * dt * dt
    x_pred = state.x_pred + dt * state.x_dot_pred + h * state.x_ddot_pred
    x_dot_pred = state.x_dot_pred + dt * state.x_ddot_pred
    P = (state.P00, state.P01, state.P02, state.P11, state.P12, state.P22)
    P00, P01, P02, P11, P12, P22 = cv_accel.predicted_covariance(P, inputs, dt, h)
    return replace(
        state,
        x_pred=x_pred,
        x_dot_pred=x_dot_pred,
        P00=P00,
        P01=P01,
        P02=P02,
        P11=P11,
        P12=P12,
        P22=P22,
        K0=0.0,
        K1=0.0,
        K2=0.0,
        S=P00 + inputs.r_x,
        y_res=0.0,
        y=x_pred,
        y_dot=x_dot_pred,
    )


@np.errstate(all="ignore")
def ducekf_coast(model: Model, tuning: DucekfTuning, state: DucekfState, inputs: DucekfInputs) -> DucekfState:
    """(3) and (4), up to the surface: what happens there is for the next sample to say."""
    dt = np.float64(inputs.dt)
    if not state.init or not dt > 0.0:
        return state
    x1, x2 = model.f(state.x1, state.x2, dt)
    limit, side = model.surface(x1)
    if side * (x1 - limit) < 0.0:
        x1 = limit
    P = propagate(model.jacobian(state.x1, state.x2, dt), state.P)
    P00, P11 = P[0] + tuning.q_x, P[3] + tuning.q_x_dot
    return replace(
        state,
        x1=x1,
        x2=x2,
        P=(P00, P[1], P[1], P11),
        K0=0.0,
        K1=0.0,
        S=P00 + tuning.r_x,
        y_res=0.0,
        y=x1,
        y_dot=x2,
    )


@np.errstate(all="ignore")
def adaptive_coast(state: AdaptiveState, inputs: AdaptiveInputs) -> AdaptiveState:
    """The hypotheses change mode, are born and predicted as in every scan, and keep the weights that this gives."""
    dt = np.float64(inputs.dt)
    return carried_on(state, inputs) if state.init and dt > 0.0 else state


@np.errstate(all="ignore")
def alpha_beta_coast(state: AlphaBetaState, inputs: AlphaBetaInputs, number: Any = np.float64) -> AlphaBetaState:
    """(1); there is no P, and S stays what the tracking index last made it."""
    dt, nothing = number(inputs.dt), number(0.0)
    if not state.init or not dt > 0.0:
        return state
    x_pred = state.x_pred + dt * state.x_dot_pred
    return replace(state, x_pred=x_pred, y_res=nothing, K0=nothing, K1=nothing, y=x_pred, y_dot=state.x_dot_pred)
