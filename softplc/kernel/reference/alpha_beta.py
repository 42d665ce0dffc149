"""The α-β filter: constant gains, or gains from the tracking index of the measured time step.

| letter | meaning | variable | tag | unit | equation |
|---|---|---|---|---|---|
| z | measured position | x | Raw | u | |
| Δt | measured time step | dt | Dt | s | |
| x̂ | position estimate | x_pred, y | Position | u | (1), (3) |
| v̂ | velocity estimate | x_dot_pred, y_dot | Velocity | u/s | (4) |
| y | innovation | y_res | Innovation | u | (2) |
| α, β | gains | alpha, beta | K0 = α, K1 = β/Δt | 1, 1 | (5) to (8) |
| σw | standard deviation of the acceleration | sigma_w | sigma_w | u/s² | (5) |
| σv | standard deviation of the measurement | sigma_v | sigma_v | u | (5) |
| Λ | tracking index | | | 1 | (5) |
| S | innovation variance | S | S | u² | (9) |

(1) x̂⁻ = x̂ + Δt·v̂, (2) y = z − x̂⁻, (3) x̂ = x̂⁻ + α·y, (4) v̂ = v̂ + (β/Δt)·y.

From the tracking index (P. R. Kalata, "The tracking index: a generalized parameter for α-β and α-β-γ target
trackers", IEEE Trans. Aerospace and Electronic Systems 20, 1984):
(5) Λ = σw·Δt²/σv, (6) ρ = (4 + Λ − √(8Λ + Λ²))/4, (7) α = 1 − ρ², (8) β = 2(2 − α) − 4√(1 − α).
Written so that nothing cancels: with s = √(Λ(8 + Λ)) and d = 4 + Λ + s, ρ = 4/d and 1 − ρ = (Λ + s)/d, hence
α = (1 − ρ)(1 + ρ) and β = 2(1 − ρ)². These are the settled gains of the Kalman filter whose acceleration is
constant within a step and new in each, Q = σw²·[[Δt⁴/4, Δt³/2], [Δt³/2, Δt²]], R = σv². From its α = P00⁻/S
follows (9) S = σv²/ρ²; with fixed gains nothing says how large an innovation may be, and S is 0.

LREAL is float64; REAL is strict single precision, each operation rounded.
"""

from dataclasses import dataclass

import numpy as np

from softplc.kernel.reference.frame import LREAL, REAL, Precision
from softplc.kernel.result import Result


@dataclass(slots=True)
class AlphaBetaState:
    """What is kept between scans; all zero before the first enabled scan. `y` and `y_dot` are the outputs."""

    init: bool = False
    x_pred: float = 0.0
    x_dot_pred: float = 0.0
    y_res: float = 0.0
    S: float = 0.0
    K0: float = 0.0
    K1: float = 0.0
    y: float = 0.0
    y_dot: float = 0.0


@dataclass(frozen=True, slots=True)
class AlphaBetaInputs:
    """The inputs of one scan: `x` in u, `dt` in seconds; `indexed` takes the gains from sigma_w and sigma_v."""

    EnableIn: bool
    x: float
    dt: float
    indexed: bool = False
    alpha: float = 0.0
    beta: float = 0.0
    sigma_w: float = 0.0
    sigma_v: float = 0.0


def alpha_beta_lreal(state: AlphaBetaState, inputs: AlphaBetaInputs) -> tuple[AlphaBetaState, Result]:
    """One scan in double precision: the state after it, and what happened."""
    return _alpha_beta(state, inputs, LREAL)


def alpha_beta_real(state: AlphaBetaState, inputs: AlphaBetaInputs) -> tuple[AlphaBetaState, Result]:
    """One scan in single precision; inputs are rounded first, the state's numbers are float32 afterwards."""
    return _alpha_beta(state, inputs, REAL)


@np.errstate(all="ignore")
def _alpha_beta(state: AlphaBetaState, inputs: AlphaBetaInputs, number: Precision) -> tuple[AlphaBetaState, Result]:
    x, dt, nought = number(inputs.x), number(inputs.dt), number(0.0)
    init, x_pred, x_dot_pred = state.init, state.x_pred, state.x_dot_pred
    y_res, S, K0, K1 = state.y_res, state.S, state.K0, state.K1

    if not inputs.EnableIn:
        return AlphaBetaState(False, x_pred, x_dot_pred, y_res, S, K0, K1, x, nought), Result.DISABLED
    if not dt > 0.0:
        return AlphaBetaState(init, x_pred, x_dot_pred, y_res, S, K0, K1, x, nought), Result.DT_INVALID

    result = Result.UPDATED
    if not init:
        x_pred, x_dot_pred = x, nought
        result = Result.INITIALISED

    if inputs.indexed:
        sigma_w, sigma_v = number(inputs.sigma_w), number(inputs.sigma_v)
        index = sigma_w * dt * dt / sigma_v  # (5)
        s = np.sqrt(index * (number(8.0) + index))
        d = number(4.0) + index + s
        rho = number(4.0) / d  # (6)
        e = (index + s) / d
        alpha = e * (number(1.0) + rho)  # (7)
        beta = number(2.0) * e * e  # (8)
        S = sigma_v * sigma_v / (rho * rho)  # (9)
    else:
        alpha, beta, S = number(inputs.alpha), number(inputs.beta), nought

    K0, K1 = alpha, beta / dt
    x_pred = x_pred + dt * x_dot_pred  # (1)
    y_res = x - x_pred  # (2)
    x_pred = x_pred + K0 * y_res  # (3)
    x_dot_pred = x_dot_pred + K1 * y_res  # (4)
    return AlphaBetaState(True, x_pred, x_dot_pred, y_res, S, K0, K1, x_pred, x_dot_pred), result
