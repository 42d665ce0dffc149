"""FB_KalmanFilter: position and velocity with one scalar gain, as its Structured Text has it; and its cure.

`fb_kalman_lreal` and `fb_kalman_real` are the function block as written, bug for bug. `fb_kalman_corrected_*` is the
block with the arithmetic put right: the textbook Kalman filter of the same model in every scan. u is the unit of the
axis; ⁻ marks what was predicted.

| letter | meaning | ST variable | tag | unit | equation |
|---|---|---|---|---|---|
| z | measured position | MeasuredPosition | Raw | u | z = x + noise |
| Δt | time step | DeltaT | Dt | s | |
| x̂ | position estimate | x_pos, EstimatedPosition | Position | u | x̂⁻ = x̂ + Δt·v̂ |
| v̂ | velocity estimate | x_vel, EstimatedVelocity | Velocity | u/s | v̂⁻ = v̂ |
| P00 | variance of x̂ | p_11 | P00 | u² | P00⁻ = P00 + Δt(Δt·P11 + 2·P01) |
| P01 | covariance of x̂ and v̂ | p_12 | P01 | u²/s | P01⁻ = P01 + Δt·P11 |
| P11 | variance of v̂ | p_22 | P11 | (u/s)² | P11⁻ = P11 + Q |
| Q | process noise of the velocity, per scan | Q | Q | (u/s)² | |
| R | measurement noise variance, per sample | R | R | u² | |
| y | innovation | (none) | Innovation | u | y = z − x̂⁻ |
| S | innovation variance | (none) | S | u² | S = P00⁻ + R |
| K0 | gain for the position | KalmanGain | K0 | 1 | K0 = P00⁻/S |
| K1 | gain for the velocity | k_vel | K1 | 1/s | corrected P01⁻/S; as written K0(1 − K0)/Δt |

What is wrong as written: the velocity is corrected with K0/Δt times the deviation that is left after the position
was corrected, so its gain on the innovation is K0(1 − K0)/Δt and not P01⁻/S; P11 does not lose K1·P01⁻; Q is added a
second time after the update; the start is 0 and not the measurement; Reset does not return, so held TRUE it puts out
the same jump in each scan; DeltaT = 0 divides by zero. k_pos and k_vel are declared and never used.

LREAL is float64, REAL strict single precision. Divisions by zero give infinity or NaN, as they do in compiled
Structured Text.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from softplc.kernel.result import Result


@dataclass(slots=True)
class FbKalmanState:
    """What the function block keeps between calls, with the initial values that it declares.

    `init`: it was called since it was last disabled. `y_res`, `S` and `k_vel` (the gain that the velocity gets on
    the innovation) are no variables of the block as written: they are what the tags show, beside its arithmetic.
    """

    init: bool = False
    x_pos: float = 0.0
    x_vel: float = 0.0
    p_11: float = 1.0
    p_12: float = 0.0
    p_22: float = 1.0
    KalmanGain: float = 0.0
    k_vel: float = 0.0
    y_res: float = 0.0
    S: float = 0.0
    EstimatedPosition: float = 0.0
    EstimatedVelocity: float = 0.0


@dataclass(frozen=True, slots=True)
class FbKalmanInputs:
    """The function block's inputs in one call: position in u, `DeltaT` in seconds; variances per scan and sample.

    The last two are not the block's. `EnableIn` false: the block is not called, the position passes through, and the
    next call has Reset TRUE. `start_at_measurement`: Reset sets x_pos to the measurement and not to 0.
    """

    MeasuredPosition: float
    Q: float
    R: float
    DeltaT: float
    Reset: bool = False
    EnableIn: bool = True
    start_at_measurement: bool = False


def fb_kalman_lreal(state: FbKalmanState, inputs: FbKalmanInputs) -> tuple[FbKalmanState, Result]:
    """One call as written in double precision: the state after it, and what happened."""
    return _as_written(state, inputs, np.float64)


def fb_kalman_real(state: FbKalmanState, inputs: FbKalmanInputs) -> tuple[FbKalmanState, Result]:
    """One call as written in single precision; inputs are rounded first, every operation is rounded to float32."""
    return _as_written(state, inputs, np.float32)


def fb_kalman_corrected_lreal(state: FbKalmanState, inputs: FbKalmanInputs) -> tuple[FbKalmanState, Result]:
    """One call of the corrected block in double precision: the state after it, and what happened."""
    return _corrected(state, inputs, np.float64)


def fb_kalman_corrected_real(state: FbKalmanState, inputs: FbKalmanInputs) -> tuple[FbKalmanState, Result]:
    """One call of the corrected block in single precision, every operation rounded to float32."""
    return _corrected(state, inputs, np.float32)


@np.errstate(all="ignore")
def _as_written(state: FbKalmanState, inputs: FbKalmanInputs, number: Any) -> tuple[FbKalmanState, Result]:
    MeasuredPosition, Q, R = number(inputs.MeasuredPosition), number(inputs.Q), number(inputs.R)
    DeltaT = number(inputs.DeltaT)
    if not inputs.EnableIn:
        return _passed_through(state, MeasuredPosition, init=False), Result.DISABLED

    x_pos, x_vel, p_11, p_12, p_22, result = _reset(state, inputs, number)

    # Prediction step.
    x_pos = x_pos + DeltaT * x_vel
    p_11 = p_11 + DeltaT * (DeltaT * p_22 + 2 * p_12)
    p_12 = p_12 + DeltaT * p_22
    p_22 = p_22 + Q

    y_res = MeasuredPosition - x_pos
    S = p_11 + R

    # Update step: the velocity takes what the position has left over, and p_12 has no part in it.
    KalmanGain = p_11 / (p_11 + R)
    x_pos = x_pos + KalmanGain * (MeasuredPosition - x_pos)
    x_vel = x_vel + KalmanGain / DeltaT * (MeasuredPosition - x_pos)

    # Update error covariance: Q a second time.
    p_11 = (1 - KalmanGain) * p_11
    p_12 = (1 - KalmanGain) * p_12
    p_22 = (1 - KalmanGain) * p_22 + Q

    k_vel = KalmanGain * (1 - KalmanGain) / DeltaT
    return FbKalmanState(True, x_pos, x_vel, p_11, p_12, p_22, KalmanGain, k_vel, y_res, S, x_pos, x_vel), result


@np.errstate(all="ignore")
def _corrected(state: FbKalmanState, inputs: FbKalmanInputs, number: Any) -> tuple[FbKalmanState, Result]:
    MeasuredPosition, Q, R = number(inputs.MeasuredPosition), number(inputs.Q), number(inputs.R)
    DeltaT = number(inputs.DeltaT)
    if not inputs.EnableIn:
        return _passed_through(state, MeasuredPosition, init=False), Result.DISABLED
    if not DeltaT > 0.0:
        init = state.init and not inputs.Reset  # a Reset is not lost, the next scan with a valid dt has it
        return _passed_through(state, MeasuredPosition, init=init), Result.DT_INVALID

    x_pos, x_vel, p_11, p_12, p_22, result = _reset(state, inputs, number)

    # Prediction step, as written.
    x_pos = x_pos + DeltaT * x_vel
    p_11_pred = p_11 + DeltaT * (DeltaT * p_22 + 2 * p_12)
    p_12_pred = p_12 + DeltaT * p_22
    p_22_pred = p_22 + Q

    y_res = MeasuredPosition - x_pos
    S = p_11_pred + R
    if not S > 0.0:
        # The prediction is put out, gains and covariance stay.
        after = replace(state, init=True, x_pos=x_pos, x_vel=x_vel, p_11=p_11, p_12=p_12, p_22=p_22)
        return replace(after, y_res=y_res, S=S, EstimatedPosition=x_pos, EstimatedVelocity=x_vel), (
            Result.S_NOT_POSITIVE
        )

    # Update step: both gains before p changes, both on the stored innovation.
    KalmanGain = p_11_pred / S
    k_vel = p_12_pred / S
    x_pos = x_pos + KalmanGain * y_res
    x_vel = x_vel + k_vel * y_res

    # Update error covariance: Q once, in the prediction.
    p_22 = p_22_pred - k_vel * p_12_pred
    p_11 = (1 - KalmanGain) * p_11_pred
    p_12 = (1 - KalmanGain) * p_12_pred

    return FbKalmanState(True, x_pos, x_vel, p_11, p_12, p_22, KalmanGain, k_vel, y_res, S, x_pos, x_vel), result


def _passed_through(state: FbKalmanState, position: float, *, init: bool) -> FbKalmanState:
    return replace(state, init=init, EstimatedPosition=position, EstimatedVelocity=type(position)(0.0))


def _reset(state: FbKalmanState, inputs: FbKalmanInputs, number: Any) -> tuple[Any, Any, Any, Any, Any, Result]:
    """The state that the block goes on from: its own, or what Reset sets."""
    if inputs.Reset or not state.init:
        start = inputs.MeasuredPosition if inputs.start_at_measurement else 0.0
        return number(start), number(0.0), number(1.0), number(0.0), number(1.0), Result.INITIALISED
    own = (state.x_pos, state.x_vel, state.p_11, state.p_12, state.p_22)
    return *(number(one) for one in own), Result.UPDATED
