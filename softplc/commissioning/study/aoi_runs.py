"""The AOI over a recorded waveform: every variable of every scan, and what is read from them."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from softplc.commissioning.study.waveform import DT, Numbers, R
from softplc.kernel.reference.aoi import AoiInputs, AoiState, aoi_lreal
from softplc.kernel.result import Result

Block = Callable[[AoiState, AoiInputs], tuple[AoiState, Result]]

TUNING = AoiInputs(EnableIn=True, x=0.0, dt=DT * 1000.0, q_x=0.01, q_x_dot=0.1, r_x=R)


@dataclass(frozen=True, slots=True)
class Trace:
    """One entry for each scan: what the function block put out, and its visible variables."""

    position: Numbers
    velocity: Numbers
    K0: Numbers
    K1: Numbers
    S: Numbers
    P00: Numbers
    P11: Numbers
    innovation: Numbers


def run(measured: Numbers, tuning: AoiInputs = TUNING, block: Block = aoi_lreal) -> Trace:
    """Step the AOI through all samples, enabled from the first; `tuning` gives everything but the sample."""
    state = AoiState()
    rows = np.empty((8, len(measured)))
    for scan, x in enumerate(measured.tolist()):
        state, _ = block(state, replace(tuning, x=x))
        P00, _, _, P11 = state.P
        rows[:, scan] = (state.y, state.y_dot, state.K0, state.K1, state.S, P00, P11, state.y_res)
    return Trace(*rows)


def settling_scan(gains: Numbers, goal: float, within: float = 0.01) -> int:
    """From which scan on the gain stays within this fraction of where it settles; scans count from 1."""
    outside = np.flatnonzero(np.abs(gains - goal) > within * abs(goal))
    return int(outside[-1]) + 2 if len(outside) else 1


def slowest_time_constant(K0: float, K1: float, dt: float) -> float:
    """Time constant of the slower pole in s, once the gains are K0 and K1 (1/s) and Δt is `dt` (s).

    The error then follows e⁺ = (I − KH)Fe with F = [[1, Δt], [0, 1]], H = [1, 0].
    """
    poles = np.linalg.eigvals(np.array([[1.0 - K0, dt * (1.0 - K0)], [-K1, 1.0 - dt * K1]]))
    return float(-dt / np.log(np.abs(poles).max()))


def noise_left(K0: float, K1: float, dt: float) -> tuple[float, float]:
    """Standard deviations of position and velocity (1/s) for white noise of standard deviation 1, at settled gains.

    The observer is then an α-β filter with α = K0, β = K1·Δt; with d = α(4 − 2α − β) the variances are
    (2α² + β(2 − 3α))/d and 2β²/(d·Δt²).
    """
    alpha, beta = K0, K1 * dt
    d = alpha * (4.0 - 2.0 * alpha - beta)
    return math.sqrt((2.0 * alpha * alpha + beta * (2.0 - 3.0 * alpha)) / d), math.sqrt(2.0 * beta * beta / d) / dt
