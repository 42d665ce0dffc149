"""The Logix AOI with its options, as scalars; with every option off it is `kernel.reference.aoi`, number for number.

Letters, variables and equation numbers are those of `kernel.reference.aoi`. u is the unit of the axis.

| option | equation it changes | off |
|---|---|---|
| joseph | P = (I − KH)P⁻(I − KH)ᵀ + K·R·Kᵀ in place of (16) | False |
| min_r | R = max(R, min_r) before (17) | −∞ |
| K0_limits, K1_limits | K = min(max(K, low), high) after (18) | −∞ to ∞ |
| q_exponents (a, b) | Q00 = q_x·Δt^a, Q11 = q_x_dot·Δt^b in place of (11), (12); Δt in s | (0, 0) |
| white_accel | Q = q_x_dot·[[Δt³/3, Δt²/2], [Δt²/2, Δt]], and q_x·Δt on Q00 | False |
| r_density | R = r_x/Δt before (17) | False |
| bleed_on_innovation | (22) tests \\|y\\| in place of \\|z − x̂\\| | False |
| bleed_velocity | (22) acts only where \\|v̂\\| < bleed_velocity | None |
| gate, gate_most | \\|y\\| > gate·√S only predicts; after gate_most in a row the next one starts anew | None |
| reinitialise | S ≤ 0 starts anew on this sample | False |
| reference | z − reference in float64 before it is rounded, reference + y in float64 as the position | None |

White acceleration is the constant-velocity model driven by white noise of spectral density q_x_dot, sampled exactly:
Y. Bar-Shalom, X. R. Li, T. Kirubarajan, "Estimation with Applications to Tracking and Navigation" (2001), 6.2.2.
The Joseph form: R. Bucy, P. Joseph, "Filtering for Stochastic Processes with Applications to Guidance" (1968).
"""

import math
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from softplc.kernel.reference.aoi import AoiInputs, AoiState
from softplc.kernel.result import Result

_UNLIMITED = (-math.inf, math.inf)


@dataclass(frozen=True, slots=True)
class AoiOptions:
    """Which options are on; a new one has none. `min_r` in u², gains in 1 and 1/s, `bleed_velocity` in u/s.

    `q_exponents` are whole numbers from 0 to 3; `gate` in standard deviations of the innovation. `white_accel` goes
    before `q_exponents`. `reference` is a position in u, or the sample on which the observer starts.
    """

    joseph: bool = False
    min_r: float = -math.inf
    K0_limits: tuple[float, float] = _UNLIMITED
    K1_limits: tuple[float, float] = _UNLIMITED
    q_exponents: tuple[int, int] = (0, 0)
    white_accel: bool = False
    r_density: bool = False
    bleed_on_innovation: bool = False
    bleed_velocity: float | None = None
    gate: float | None = None
    gate_most: int = 0
    reinitialise: bool = False
    reference: float | Literal["first_sample"] | None = None


@dataclass(slots=True)
class AoiOptionsState:
    """The AOI's own state, its positions relative to `offset`, and what the options keep between scans.

    `position` is the absolute position in float64 whatever the precision; `in_a_row` counts the rejected samples
    since the last one that was taken, `rejected` all of them.
    """

    aoi: AoiState = field(default_factory=AoiState)
    offset: float = 0.0
    position: float = 0.0
    in_a_row: int = 0
    rejected: int = 0


def aoi_options_lreal(
    state: AoiOptionsState, inputs: AoiInputs, options: AoiOptions
) -> tuple[AoiOptionsState, Result]:
    """One scan in double precision: the state after it, and what happened."""
    with np.errstate(all="ignore"):
        return _scan(state, inputs, options, np.float64)


def aoi_options_real(
    state: AoiOptionsState, inputs: AoiInputs, options: AoiOptions
) -> tuple[AoiOptionsState, Result]:
    """One scan in single precision: every number is rounded on its way in, the measurement after its reference."""
    with np.errstate(all="ignore"):
        return _scan(state, inputs, options, np.float32)


def _scan(
    state: AoiOptionsState, inputs: AoiInputs, options: AoiOptions, real: Any
) -> tuple[AoiOptionsState, Result]:
    offset = _offset(state, inputs, options)
    x = real(float(inputs.x) - offset)
    rejections = _Rejections(state.in_a_row, state.rejected)
    after, result = _aoi(state.aoi, x, inputs, options, real, rejections)
    if result is None:  # start anew on this sample, once
        fresh = replace(state, aoi=replace(state.aoi, init=False))
        return _scan(fresh, inputs, options, real)
    position = offset + float(after.y)
    return AoiOptionsState(after, offset, position, rejections.in_a_row, rejections.total), result


def _offset(state: AoiOptionsState, inputs: AoiInputs, options: AoiOptions) -> float:
    """What positions are relative to in this scan."""
    if options.reference is None:
        return 0.0
    if options.reference == "first_sample":
        return float(inputs.x) if inputs.EnableIn and not state.aoi.init else state.offset
    return float(options.reference)


@dataclass(slots=True)
class _Rejections:
    in_a_row: int
    total: int


def _aoi(  # noqa: PLR0912, PLR0915  # it is one block of text
    state: AoiState, x: Any, inputs: AoiInputs, options: AoiOptions, real: Any, rejections: _Rejections
) -> tuple[AoiState, Result | None]:
    """The AOI's own text with the options in their places; no Result: to be started anew on this sample."""
    dt, q_x, q_x_dot, r_x = real(inputs.dt), real(inputs.q_x), real(inputs.q_x_dot), real(inputs.r_x)
    init, dt_s = state.init, state.dt_s
    x_pred, x_dot_pred = state.x_pred, state.x_dot_pred
    P0, P1, P2, P3 = state.P
    K0, K1, S, y_res = state.K0, state.K1, state.S, state.y_res

    if not inputs.EnableIn:
        init = False
        y = x
        y_dot = 0.0
        result = Result.DISABLED
    else:
        dt_s = 0.0 if dt <= 0.0 else dt / 1000.0

        started = not init
        result = Result.UPDATED
        if started:
            x_pred = x
            x_dot_pred = 0.0
            P0, P1, P2, P3 = 1.0, 0.0, 0.0, 10.0
            K0 = 0.0
            K1 = 0.0
            init = True
            rejections.in_a_row = 0
            result = Result.INITIALISED

        if dt_s > 0.0:
            x_pred = x_pred + dt_s * x_dot_pred

            x_cov0, x_cov1, x_cov2, x_cov3 = predicted_covariance((P0, P1, P2, P3), q_x, q_x_dot, dt_s, options)
            R = measurement_noise(r_x, dt_s, options, real)

            y_res = x - x_pred
            S = x_cov0 + R

            if S > 0.0:
                # Innovation gate; what is not a number does not pass it.
                if options.gate is not None and not abs(y_res) <= real(options.gate) * np.sqrt(S):
                    if rejections.in_a_row >= options.gate_most and not started:
                        return state, None
                    rejections.in_a_row += 1
                    rejections.total += 1
                    K0 = 0.0
                    K1 = 0.0
                    P0, P1, P2, P3 = x_cov0, x_cov1, x_cov2, x_cov3
                    result = Result.REJECTED
                else:
                    rejections.in_a_row = 0
                    K0 = _limited(x_cov0 / S, options.K0_limits, real)
                    K1 = _limited(x_cov2 / S, options.K1_limits, real)

                    x_pred = x_pred + K0 * y_res
                    x_dot_pred = x_dot_pred + K1 * y_res

                    # Bleed: which deviation is small, and whether the velocity must be, too.
                    deviation = y_res if options.bleed_on_innovation else x - x_pred
                    slow = options.bleed_velocity is None or abs(x_dot_pred) < real(options.bleed_velocity)
                    if inputs.BleedEnable and abs(deviation) < real(inputs.BleedThresh) and slow:
                        x_dot_pred = x_dot_pred * real(inputs.BleedFactor)

                    if options.joseph:
                        rest0 = (1.0 - K0) * x_cov0
                        rest1 = x_cov1 - K1 * x_cov0
                        P0 = (1.0 - K0) * rest0 + K0 * (K0 * R)
                        P1 = (1.0 - K0) * rest1 + K0 * (K1 * R)
                        P3 = ((x_cov3 - K1 * x_cov1) - K1 * rest1) + K1 * (K1 * R)
                    else:
                        P0 = (1.0 - K0) * x_cov0
                        P1 = (1.0 - K0) * x_cov1
                        P3 = x_cov3 - K1 * x_cov1
                    P2 = P1
            elif options.reinitialise and not started:
                return state, None
            else:
                result = Result.S_NOT_POSITIVE

            y = x_pred
            y_dot = x_dot_pred
        else:
            y = x
            y_dot = 0.0
            result = Result.DT_INVALID

    after = AoiState(init, dt_s, x_pred, x_dot_pred, (P0, P1, P2, P3), K0, K1, S, y_res, y, y_dot)
    return after, result


def predicted_covariance(
    P: tuple[Any, Any, Any, Any], q_x: Any, q_x_dot: Any, dt_s: Any, options: AoiOptions
) -> tuple[Any, Any, Any, Any]:
    """(7) to (12): P⁻, with process noise per scan, by powers of the time step, or of white acceleration."""
    P0, P1, P2, P3 = P
    x_cov0 = (P0 + dt_s * P2) + dt_s * (P1 + dt_s * P3)
    x_cov1 = P1 + dt_s * P3
    x_cov2 = P2 + dt_s * P3
    if options.white_accel:
        once = q_x_dot * dt_s
        twice = once * dt_s
        return x_cov0 + (q_x * dt_s + (twice * dt_s) / 3.0), x_cov1 + twice / 2.0, x_cov2 + twice / 2.0, P3 + once
    noise0 = q_x * _power(dt_s, options.q_exponents[0])
    return x_cov0 + noise0, x_cov1, x_cov2, P3 + q_x_dot * _power(dt_s, options.q_exponents[1])


def measurement_noise(r_x: Any, dt_s: Any, options: AoiOptions, real: Any) -> Any:
    """R, per sample or by density, never below its floor."""
    return max(r_x / dt_s if options.r_density else r_x, real(options.min_r))


def _power(dt_s: Any, exponent: int) -> Any:
    """Δt^exponent as products, which round the same everywhere; exactly 1 for exponent 0, whatever Δt is."""
    if exponent == 0:
        return 1.0
    power = dt_s
    for _ in range(exponent - 1):
        power = power * dt_s
    return power


def _limited(K: Any, limits: tuple[float, float], real: Any) -> Any:
    """K within its limits; NaN stays NaN."""
    low, high = limits
    return min(max(K, real(low)), real(high))
