"""Moving average: the mean of the last n samples; the velocity is the difference of two consecutive means.

| letter | meaning | variable | tag | unit | equation |
|---|---|---|---|---|---|
| z | measured position | x | Raw | u | |
| Δt | time since the last sample | dt | Dt | s | |
| n | samples in the window | window | Window | 1 | |
| m | mean of the window | y | Position | u | (1) m_k = (z_k + … + z_{k−n+1})/n |
| v̂ | velocity | y_dot | Velocity | u/s | (2) v̂_k = (z_k − z_{k−n})/(t_k − t_{k−n}) |

(2) is the difference of two consecutive means over the difference of the two windows' mean times: in both, all but
the newest and the dropped sample cancel. So the time steps are the measured ones, and a ramp is read without error
at any jitter. White noise of variance R leaves R/n on the position and 2R/(nΔt)² on the velocity. On a ramp of
speed v the position lags by (n − 1)/2 scans, thus by v·Δt·(n − 1)/2; the velocity by n/2 scans.

Until n + 1 samples are there, the mean is that of the samples so far, and the velocity goes back to the first one.
The window is summed anew in every scan: a running sum would keep what a large number has rounded away for ever.
"""

from dataclasses import dataclass

import numpy as np

from softplc.kernel.result import Result


@dataclass(slots=True)
class MovingAverageState:
    """What is kept between scans; all zero before the first enabled scan. `y` and `y_dot` are the outputs.

    `X` and `DT` are rings of the last n samples, and of the time before each of them (0 before the first one);
    `head` is the slot of the oldest, which the next sample takes, and `samples` counts since the start.
    """

    init: bool = False
    samples: int = 0
    head: int = 0
    X: tuple[float, ...] = ()
    DT: tuple[float, ...] = ()
    y: float = 0.0
    y_dot: float = 0.0


@dataclass(frozen=True, slots=True)
class MovingAverageInputs:
    """The inputs of one scan: `x` in u, `dt` in seconds, `window` in samples, constant between initialisations."""

    EnableIn: bool
    x: float
    dt: float
    window: int


@np.errstate(all="ignore")
def moving_average(state: MovingAverageState, inputs: MovingAverageInputs) -> tuple[MovingAverageState, Result]:
    """One scan: the state after it, and what happened."""
    n, x, dt = inputs.window, np.float64(inputs.x), np.float64(inputs.dt)
    samples, head = state.samples, state.head
    X, DT = list(state.X), list(state.DT)

    if not inputs.EnableIn:
        return MovingAverageState(False, 0, head, state.X, state.DT, x, 0.0), Result.DISABLED
    if not dt > 0.0:
        return MovingAverageState(state.init, samples, head, state.X, state.DT, x, 0.0), Result.DT_INVALID
    if not state.init:
        X, DT = [x] + [0.0] * (n - 1), [0.0] * n
        return MovingAverageState(True, 1, 1 % n, tuple(X), tuple(DT), x, 0.0), Result.INITIALISED

    oldest = X[head] if samples >= n else X[0]
    X[head], DT[head] = x, dt
    head = (head + 1) % n
    samples = samples + 1

    # Slot by slot, whatever the head: the order in which the batch adds, too.
    total, time = X[0], DT[0]
    for i in range(1, n):
        total = total + X[i]
        time = time + DT[i]
    y = total / min(samples, n)  # (1)
    y_dot = (x - oldest) / time  # (2)

    after = MovingAverageState(True, samples, head, tuple(X), tuple(DT), y, y_dot)
    return after, Result.WARMING_UP if samples <= n else Result.UPDATED
