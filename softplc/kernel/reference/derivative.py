"""The DERIVATIVE example block of IEC 61131-3: four samples, a nominal cycle; the position passes through.

| letter | meaning | ST variable | tag | unit | equation |
|---|---|---|---|---|---|
| z | measured position | XIN | Raw, Position | u | |
| T | sampling period, as the engineer wrote it | CYCLE (cycle) | Cycle | s | |
| h0, h1, h2 | the last three measured time steps, newest first | dt, h1, h2 | Dt | s | |
| z₁, z₂, z₃ | the three samples before | X1, X2, X3 | | u | |
| v̂ | velocity | XOUT | Velocity | u/s | (1) nominal, (2) measured |

(1) XOUT := (3.0*(XIN − X3) + X1 − X2) / (10.0*CYCLE), the text of the standard (second edition, annex F, examples
of analogue signal processing): the least-squares slope through four equally spaced samples. It believes CYCLE: a
task that runs slower than written reads too fast by the same ratio, and a sample that comes late reads as a jump of
the velocity.
(2) The same numerator over 3·h0 + 4·h1 + 3·h2: a ramp at any steps is read without error, and equal steps give (1).

In the standard RUN = FALSE sets XOUT to 0 and X1, X2, X3 to XIN. That call is made here when the observer starts, as
well as in every disabled scan; without it the block would start from 0 and put out 3·XIN/(10·CYCLE). What the
standard leaves to the platform is TIME_TO_REAL(CYCLE): it gives milliseconds on many, seconds on some, so the
block's output there is u/ms. Here CYCLE is in seconds. On a ramp the first three scans after the start read 0, 0.3
and 0.7 of the slope; the velocity lags by 1.5 scans and has a variance of 0.2·R/T².

LREAL is float64; REAL is strict single precision, each operation rounded.
"""

from dataclasses import dataclass

import numpy as np

from softplc.kernel.reference.frame import LREAL, REAL, Precision
from softplc.kernel.result import Result


@dataclass(slots=True)
class DerivativeState:
    """What is kept between scans; all zero before the first enabled scan. `y` and `y_dot` (XOUT) are the outputs."""

    init: bool = False
    samples: int = 0
    X1: float = 0.0
    X2: float = 0.0
    X3: float = 0.0
    h1: float = 0.0
    h2: float = 0.0
    y: float = 0.0
    y_dot: float = 0.0


@dataclass(frozen=True, slots=True)
class DerivativeInputs:
    """The inputs of one scan: `x` (XIN) in u, `dt` and `cycle` in seconds; `measured` chooses (2)."""

    EnableIn: bool
    x: float
    dt: float
    cycle: float
    measured: bool = False


def derivative_lreal(state: DerivativeState, inputs: DerivativeInputs) -> tuple[DerivativeState, Result]:
    """One scan in double precision: the state after it, and what happened."""
    return _derivative(state, inputs, LREAL)


def derivative_real(state: DerivativeState, inputs: DerivativeInputs) -> tuple[DerivativeState, Result]:
    """One scan in single precision; inputs are rounded first, the state's numbers are float32 afterwards."""
    return _derivative(state, inputs, REAL)


@np.errstate(all="ignore")
def _derivative(
    state: DerivativeState, inputs: DerivativeInputs, number: Precision
) -> tuple[DerivativeState, Result]:
    XIN, dt, CYCLE = number(inputs.x), number(inputs.dt), number(inputs.cycle)
    X1, X2, X3, h1, h2 = state.X1, state.X2, state.X3, state.h1, state.h2

    if not inputs.EnableIn:  # RUN = FALSE
        return DerivativeState(False, 0, XIN, XIN, XIN, h1, h2, XIN, number(0.0)), Result.DISABLED
    if not dt > 0.0:
        return DerivativeState(state.init, state.samples, X1, X2, X3, h1, h2, XIN, number(0.0)), Result.DT_INVALID
    if not state.init:  # RUN = FALSE in the first scan
        return DerivativeState(True, 1, XIN, XIN, XIN, dt, dt, XIN, number(0.0)), Result.INITIALISED

    time = number(10.0) * CYCLE
    if inputs.measured:
        time = number(3.0) * dt + number(4.0) * h1 + number(3.0) * h2  # (2)
    XOUT = (number(3.0) * (XIN - X3) + X1 - X2) / time  # (1)

    samples = state.samples + 1
    after = DerivativeState(True, samples, XIN, X1, X2, dt, h1, XIN, XOUT)
    return after, Result.WARMING_UP if samples < 4 else Result.UPDATED
