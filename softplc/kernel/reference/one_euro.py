"""The 1€ filter: a low pass whose cutoff rises with the speed; the velocity is its own low-passed derivative.

G. Casiez, N. Roussel, D. Vogel, "1€ Filter: a simple speed-based low-pass filter for noisy input in interactive
systems", CHI 2012, with the time step measured in every scan.

| letter | meaning | variable | tag | unit | equation |
|---|---|---|---|---|---|
| z | measured position | x | Raw | u | |
| Δt | measured time step | dt | Dt | s | |
| f_c,min | cutoff at rest | min_cutoff | min_cutoff | Hz | (4) |
| β | slope of the cutoff | beta | beta | 1/u | (4) |
| f_d | cutoff of the derivative | d_cutoff | d_cutoff | Hz | (3) |
| d | derivative | | | u/s | (2) |
| v̂ | filtered derivative | dx_hat, y_dot | Velocity | u/s | (3) |
| f_c | cutoff | cutoff | Cutoff | Hz | (4) |
| x̂ | filtered position | x_hat, y | Position | u | (5) |

(1) a(f) = 1/(1 + 1/(2πf·Δt)), (2) d = (z − z₋)/Δt, (3) v̂ = a(f_d)·d + (1 − a(f_d))·v̂, (4) f_c = f_c,min + β·|v̂|,
(5) x̂ = a(f_c)·z + (1 − a(f_c))·x̂.

In (2) z₋ is the last measurement. The paper's algorithm 1 takes the last *filtered* position there (`filtered`),
which is fine for steering the cutoff, but not as a velocity: on a ramp it reads v/a(f_c), several times too much.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from softplc.kernel.result import Result

TURN: Final = 2.0 * math.pi


@dataclass(slots=True)
class OneEuroState:
    """What is kept between scans; all zero before the first enabled scan. `y` and `y_dot` are the outputs."""

    init: bool = False
    x_prev: float = 0.0
    x_hat: float = 0.0
    dx_hat: float = 0.0
    cutoff: float = 0.0
    y: float = 0.0
    y_dot: float = 0.0


@dataclass(frozen=True, slots=True)
class OneEuroInputs:
    """The inputs of one scan: `x` in u, `dt` in seconds, cutoffs in Hz, `beta` in 1/u; `filtered` as in the paper."""

    EnableIn: bool
    x: float
    dt: float
    min_cutoff: float
    beta: float
    d_cutoff: float
    filtered: bool = False


@np.errstate(all="ignore")
def one_euro(state: OneEuroState, inputs: OneEuroInputs) -> tuple[OneEuroState, Result]:
    """One scan: the state after it, and what happened."""
    x, dt = np.float64(inputs.x), np.float64(inputs.dt)
    x_prev, x_hat, dx_hat, cutoff = state.x_prev, state.x_hat, state.dx_hat, state.cutoff

    if not inputs.EnableIn:
        return OneEuroState(False, x_prev, x_hat, dx_hat, cutoff, x, 0.0), Result.DISABLED
    if not dt > 0.0:
        return OneEuroState(state.init, x_prev, x_hat, dx_hat, cutoff, x, 0.0), Result.DT_INVALID
    if not state.init:
        return OneEuroState(True, x, x, 0.0, inputs.min_cutoff, x, 0.0), Result.INITIALISED

    before = x_hat if inputs.filtered else x_prev
    dx = (x - before) / dt  # (2)
    a = 1.0 / (1.0 + 1.0 / (TURN * inputs.d_cutoff * dt))  # (1)
    dx_hat = a * dx + (1.0 - a) * dx_hat  # (3)
    cutoff = inputs.min_cutoff + inputs.beta * np.abs(dx_hat)  # (4)
    a = 1.0 / (1.0 + 1.0 / (TURN * cutoff * dt))  # (1)
    x_hat = a * x + (1.0 - a) * x_hat  # (5)
    return OneEuroState(True, x, x_hat, dx_hat, cutoff, x_hat, dx_hat), Result.UPDATED
