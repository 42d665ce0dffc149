"""The Logix AOI: two-state constant-velocity Kalman observer, in the Structured Text's order and names.

The equation numbers are those of T. Turner, "Discrete-Time Implementation of a Two-State Kalman Observer in a
Scan-Based Real-Time Control Environment" (2026). Units: u is the unit of the axis.

| letter | meaning | ST variable | tag | unit | equation |
|---|---|---|---|---|---|
| z | measured position | x | Raw | u | (5) |
| Δt | time step | dt (ms), dt_s (s) | Dt | ms, s | (2) |
| x̂ | position estimate | x_pred, y | Position | u | (2), (19) |
| v̂ | velocity estimate | x_dot_pred, y_dot | Velocity | u/s | (3), (20) |
| P00 | variance of x̂ | P[0], x_cov[0] | P00 | u² | (7), (11), (16) |
| P01 | covariance of x̂ and v̂ | P[1], x_cov[1] | P01 | u²/s | (8), (16) |
| P10 | the same, kept equal to P01 | P[2], x_cov[2] | | u²/s | (9), (21) |
| P11 | variance of v̂ | P[3], x_cov[3] | P11 | (u/s)² | (10), (12), (16) |
| Q00 | process noise of the position, per scan | q_x | q_x | u² | (11) |
| Q11 | process noise of the velocity, per scan | q_x_dot | q_x_dot | (u/s)² | (12) |
| R | measurement noise variance, per sample | r_x | r_x | u² | (5), (17) |
| y | innovation | y_res | Innovation | u | (17) |
| S | innovation variance | S | S | u² | (17) |
| K0, K1 | gains | K0, K1 | K0, K1 | 1, 1/s | (18) |
| α | velocity damping | BleedFactor | BleedFactor | 1 | (22) |

LREAL is Python's float. REAL is strict single precision: numpy's float32 rounds every operation, and a literal
beside a float32 is a float32.
"""

from dataclasses import dataclass

import numpy as np

from softplc.kernel.result import Result


@dataclass(slots=True)
class AoiState:
    """What the function block keeps between scans; all zero before the first enabled scan.

    `P` and `x_cov` are row-major, as P[0..3] in the Structured Text. `y` and `y_dot` are its outputs.
    """

    init: bool = False
    dt_s: float = 0.0
    x_pred: float = 0.0
    x_dot_pred: float = 0.0
    P: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    K0: float = 0.0
    K1: float = 0.0
    S: float = 0.0
    y_res: float = 0.0
    y: float = 0.0
    y_dot: float = 0.0


@dataclass(frozen=True, slots=True)
class AoiInputs:
    """The function block's inputs in one scan: `x` in u, `dt` in milliseconds, variances per update."""

    EnableIn: bool
    x: float
    dt: float
    q_x: float
    q_x_dot: float
    r_x: float
    BleedEnable: bool = False
    BleedThresh: float = 0.0
    BleedFactor: float = 1.0


def aoi_lreal(state: AoiState, inputs: AoiInputs) -> tuple[AoiState, Result]:
    """One scan in double precision: the state after it, and what happened."""
    return _aoi(state, inputs)


def aoi_real(state: AoiState, inputs: AoiInputs) -> tuple[AoiState, Result]:
    """One scan in single precision; inputs are rounded first, the state's numbers are float32 afterwards."""
    real = np.float32
    with np.errstate(all="ignore"):
        rounded = AoiInputs(
            inputs.EnableIn,
            real(inputs.x),  # type: ignore[arg-type]  # a float32 computes as a float does, with its own rounding
            real(inputs.dt),  # type: ignore[arg-type]
            real(inputs.q_x),  # type: ignore[arg-type]
            real(inputs.q_x_dot),  # type: ignore[arg-type]
            real(inputs.r_x),  # type: ignore[arg-type]
            inputs.BleedEnable,
            real(inputs.BleedThresh),  # type: ignore[arg-type]
            real(inputs.BleedFactor),  # type: ignore[arg-type]
        )
        return _aoi(state, rounded)


def _aoi(state: AoiState, inputs: AoiInputs) -> tuple[AoiState, Result]:  # noqa: PLR0915  # it is one block of text
    x, dt = inputs.x, inputs.dt
    init, dt_s = state.init, state.dt_s
    x_pred, x_dot_pred = state.x_pred, state.x_dot_pred
    P0, P1, P2, P3 = state.P
    K0, K1, S, y_res = state.K0, state.K1, state.S, state.y_res

    if not inputs.EnableIn:
        # Disable: pass through and re-arm init; nothing else is touched.
        init = False
        y = x
        y_dot = 0.0
        result = Result.DISABLED
    else:
        # ms to s; NaN is not <= 0 and stays NaN, which is not > 0 either.
        if dt <= 0.0:  # noqa: SIM108  # as the text has it
            dt_s = 0.0
        else:
            dt_s = dt / 1000.0

        # Once after enable, even when dt is invalid: start at the measurement, at rest.
        result = Result.UPDATED
        if not init:
            x_pred = x
            x_dot_pred = 0.0
            P0, P1, P2, P3 = 1.0, 0.0, 0.0, 10.0
            K0 = 0.0
            K1 = 0.0
            init = True
            result = Result.INITIALISED

        if dt_s > 0.0:
            # Predict state, (2) and (3).
            x_pred = x_pred + dt_s * x_dot_pred

            # Predict covariance, (7) to (10): P[0..3] stay as they are until the update is complete.
            x_cov0 = (P0 + dt_s * P2) + dt_s * (P1 + dt_s * P3)
            x_cov1 = P1 + dt_s * P3
            x_cov2 = P2 + dt_s * P3
            x_cov3 = P3

            # Process noise per scan, (11) and (12).
            x_cov0 = x_cov0 + inputs.q_x
            x_cov3 = x_cov3 + inputs.q_x_dot

            # Innovation and its variance, (17).
            y_res = x - x_pred
            S = x_cov0 + inputs.r_x

            if S > 0.0:
                # Gains, (18): K1 lives on P10, which the prediction makes non-zero.
                K0 = x_cov0 / S
                K1 = x_cov2 / S

                # Correct state, (19) and (20).
                x_pred = x_pred + K0 * y_res
                x_dot_pred = x_dot_pred + K1 * y_res

                # Bleed, (22): the code tests the deviation after the correction, not the innovation.
                if inputs.BleedEnable and abs(x - x_pred) < inputs.BleedThresh:
                    x_dot_pred = x_dot_pred * inputs.BleedFactor

                # Covariance update, (16).
                P0 = (1.0 - K0) * x_cov0
                P1 = (1.0 - K0) * x_cov1
                P2 = x_cov2 - K1 * x_cov0
                P3 = x_cov3 - K1 * x_cov1

                # Symmetry: a copy, not a mean.
                P2 = P1
            else:
                result = Result.S_NOT_POSITIVE

            y = x_pred
            y_dot = x_dot_pred
        else:
            # dt invalid: pass through.
            y = x
            y_dot = 0.0
            result = Result.DT_INVALID

    after = AoiState(init, dt_s, x_pred, x_dot_pred, (P0, P1, P2, P3), K0, K1, S, y_res, y, y_dot)
    return after, result
