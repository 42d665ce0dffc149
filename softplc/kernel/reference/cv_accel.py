"""Three-state Kalman observer: position, velocity and acceleration, in scalar arithmetic like the AOI's.

The acceleration that T. Turner's two-state observer (2026) names as future work, with the guards and the order of
its Structured Text. Equations are numbered here.

| letter | meaning | variable | tag | unit | equation |
|---|---|---|---|---|---|
| z | measured position | x | Raw | u | |
| Δt | measured time step | dt | Dt | s | |
| x̂ | position estimate | x_pred, y | Position | u | (1), (13) |
| v̂ | velocity estimate | x_dot_pred, y_dot | Velocity | u/s | (2), (13) |
| â | acceleration estimate | x_ddot_pred | Acceleration | u/s² | (3), (13) |
| P00 … P22 | covariance of the estimates, six entries | P00 … P22 | P00 … P22 | u² … (u/s²)² | (4) to (9), (14) |
| Q | process noise | q_x, q_x_dot, q_x_ddot; q_jerk | same | u², (u/s)², (u/s²)²; (u/s³)²·s | (10) |
| R | measurement noise variance, per sample | r_x | r_x | u² | (11) |
| y | innovation | y_res | Innovation | u | (11) |
| S | innovation variance | S | S | u² | (11) |
| K0, K1, K2 | gains | K0, K1, K2 | K0, K1, K2 | 1, 1/s, 1/s² | (12) |

With h = Δt²/2, F = [[1, Δt, h], [0, 1, Δt], [0, 0, 1]] and H = [1, 0, 0]:
(1) x̂⁻ = x̂ + Δt·v̂ + h·â, (2) v̂⁻ = v̂ + Δt·â, (3) â⁻ = â; (4) to (9) are the entries of F·P·Fᵀ;
(10) + Q, per scan diag(q_x, q_x_dot, q_x_ddot), or that of a white jerk of density q_jerk,
q·[[Δt⁵/20, Δt⁴/8, Δt³/6], [Δt⁴/8, Δt³/3, Δt²/2], [Δt³/6, Δt²/2, Δt]], which does not depend on the scan rate;
(11) y = z − x̂⁻, S = P00⁻ + R; (12) Ki = P0i⁻/S; (13) state + K·y; (14) Pij = Pij⁻ − Ki·P0j⁻.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from softplc.kernel.reference.frame import Number
from softplc.kernel.result import Result

Covariance = tuple[Number, Number, Number, Number, Number, Number]

P_START: Final = (1.0, 10.0, 100.0)
"""Variance of position, velocity and acceleration on the first scan: the AOI's two, and one more of their kind."""


@dataclass(slots=True)
class CvAccelState:
    """What is kept between scans; all zero before the first enabled scan. `y` and `y_dot` are the outputs."""

    init: bool = False
    x_pred: float = 0.0
    x_dot_pred: float = 0.0
    x_ddot_pred: float = 0.0
    P00: float = 0.0
    P01: float = 0.0
    P02: float = 0.0
    P11: float = 0.0
    P12: float = 0.0
    P22: float = 0.0
    K0: float = 0.0
    K1: float = 0.0
    K2: float = 0.0
    S: float = 0.0
    y_res: float = 0.0
    y: float = 0.0
    y_dot: float = 0.0


@dataclass(frozen=True, slots=True)
class CvAccelInputs:
    """The inputs of one scan: `x` in u, `dt` in seconds; `white_jerk` takes Q from q_jerk, else it is per scan."""

    EnableIn: bool
    x: float
    dt: float
    r_x: float
    q_x: float = 0.0
    q_x_dot: float = 0.0
    q_x_ddot: float = 0.0
    white_jerk: bool = False
    q_jerk: float = 0.0


@np.errstate(all="ignore")
def cv_accel(state: CvAccelState, inputs: CvAccelInputs) -> tuple[CvAccelState, Result]:
    """One scan: the state after it, and what happened."""
    x: Number = np.float64(inputs.x)
    dt: Number = np.float64(inputs.dt)
    init = state.init
    x_pred, x_dot_pred, x_ddot_pred = state.x_pred, state.x_dot_pred, state.x_ddot_pred
    P00, P01, P02, P11, P12, P22 = state.P00, state.P01, state.P02, state.P11, state.P12, state.P22
    K0, K1, K2, S, y_res = state.K0, state.K1, state.K2, state.S, state.y_res

    y, y_dot = x, 0.0
    if not inputs.EnableIn:
        init = False
        result = Result.DISABLED
    else:
        # Once after enable, even when dt is invalid, as the AOI: start at the measurement, at rest.
        result = Result.UPDATED
        if not init:
            x_pred, x_dot_pred, x_ddot_pred = x, 0.0, 0.0
            P00, P11, P22 = P_START
            P01, P02, P12 = 0.0, 0.0, 0.0
            K0, K1, K2 = 0.0, 0.0, 0.0
            init = True
            result = Result.INITIALISED

        if dt > 0.0:
            h = 0.5 * dt * dt
            # Predict, (1) and (2).
            x_pred = x_pred + dt * x_dot_pred + h * x_ddot_pred
            x_dot_pred = x_dot_pred + dt * x_ddot_pred

            # Covariance; P itself stays as it is until the update is complete.
            P = (P00, P01, P02, P11, P12, P22)
            x_cov00, x_cov01, x_cov02, x_cov11, x_cov12, x_cov22 = predicted_covariance(P, inputs, dt, h)

            # Innovation and its variance, (11).
            y_res = x - x_pred
            S = x_cov00 + inputs.r_x

            if S > 0.0:
                # Gains, (12).
                K0 = x_cov00 / S
                K1 = x_cov01 / S
                K2 = x_cov02 / S

                # Correct, (13).
                x_pred = x_pred + K0 * y_res
                x_dot_pred = x_dot_pred + K1 * y_res
                x_ddot_pred = x_ddot_pred + K2 * y_res

                # Covariance, (14).
                P00 = (1.0 - K0) * x_cov00
                P01 = (1.0 - K0) * x_cov01
                P02 = (1.0 - K0) * x_cov02
                P11 = x_cov11 - K1 * x_cov01
                P12 = x_cov12 - K1 * x_cov02
                P22 = x_cov22 - K2 * x_cov02
            else:
                result = Result.S_NOT_POSITIVE

            y, y_dot = x_pred, x_dot_pred
        else:
            result = Result.DT_INVALID

    after = CvAccelState(
        init, x_pred, x_dot_pred, x_ddot_pred, P00, P01, P02, P11, P12, P22, K0, K1, K2, S, y_res, y, y_dot
    )
    return after, result


def predicted_covariance(P: Covariance, inputs: CvAccelInputs, dt: Number, h: Number) -> Covariance:
    """(4) to (10): P00, P01, P02, P11, P12, P22 one step of dt later, h = Δt²/2."""
    P00, P01, P02, P11, P12, P22 = P
    # F·P: its first two rows.
    A00 = P00 + dt * P01 + h * P02
    A01 = P01 + dt * P11 + h * P12
    A02 = P02 + dt * P12 + h * P22
    A11 = P11 + dt * P12
    A12 = P12 + dt * P22

    # Q, (10).
    if inputs.white_jerk:
        q1 = inputs.q_jerk * dt
        q2 = q1 * dt
        q3 = q2 * dt
        q4 = q3 * dt
        q5 = q4 * dt
        Q00, Q01, Q02 = q5 / 20.0, q4 / 8.0, q3 / 6.0
        Q11, Q12, Q22 = q3 / 3.0, q2 / 2.0, q1
    else:
        Q00, Q01, Q02 = inputs.q_x, 0.0, 0.0
        Q11, Q12, Q22 = inputs.q_x_dot, 0.0, inputs.q_x_ddot

    # F·P·Fᵀ + Q, (4) to (9).
    return (
        A00 + dt * A01 + h * A02 + Q00,
        A01 + dt * A02 + Q01,
        A02 + Q02,
        A11 + dt * A12 + Q11,
        A12 + Q12,
        P22 + Q22,
    )
