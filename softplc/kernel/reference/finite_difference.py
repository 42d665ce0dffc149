"""Finite difference: the position is the measurement, the velocity its backward difference over the measured time.

| letter | meaning | variable | tag | unit | equation |
|---|---|---|---|---|---|
| z | measured position | x | Raw, Position | u | |
| Δt | time since the last sample | dt | Dt | s | |
| z₋ | the sample before | x_prev | | u | |
| v̂ | velocity | y_dot | Velocity | u/s | v̂ = (z − z₋)/Δt |

Noise of variance R on each sample gives a velocity of variance 2R/Δt²; the velocity lags by half a scan.
"""

from dataclasses import dataclass

import numpy as np

from softplc.kernel.result import Result


@dataclass(slots=True)
class FiniteDifferenceState:
    """What is kept between scans; all zero before the first enabled scan. `y` and `y_dot` are the outputs."""

    init: bool = False
    x_prev: float = 0.0
    y: float = 0.0
    y_dot: float = 0.0


@dataclass(frozen=True, slots=True)
class FiniteDifferenceInputs:
    """The inputs of one scan: `x` in u, `dt` in seconds."""

    EnableIn: bool
    x: float
    dt: float


@np.errstate(all="ignore")
def finite_difference(
    state: FiniteDifferenceState, inputs: FiniteDifferenceInputs
) -> tuple[FiniteDifferenceState, Result]:
    """One scan: the state after it, and what happened."""
    x, dt = np.float64(inputs.x), np.float64(inputs.dt)
    if not inputs.EnableIn:
        return FiniteDifferenceState(False, state.x_prev, x, 0.0), Result.DISABLED
    if not dt > 0.0:
        return FiniteDifferenceState(state.init, state.x_prev, x, 0.0), Result.DT_INVALID
    if not state.init:
        return FiniteDifferenceState(True, x, x, 0.0), Result.INITIALISED
    return FiniteDifferenceState(True, x, x, (x - state.x_prev) / dt), Result.UPDATED
