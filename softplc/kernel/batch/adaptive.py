"""The adaptive observer on arrays: the operations of `kernel.reference.adaptive` in the same order, a row per axis.

Names, equations and units are those of the reference. Arrays of hypotheses are [what, hypothesis, axis]. Bit-equal
to the reference: sums go over the hypotheses in a fixed order, and there is no exponential.
"""

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from softplc.kernel.batch.adaptive_hypotheses import (
    AT_P00,
    AT_P11,
    AT_P22,
    AT_W,
    AT_WEIGHT,
    AT_X,
    OUTPUTS,
    AdaptiveTuning,
    Flags,
    Numbers,
    Scratch,
    give_birth,
    noise,
    predict,
    rates,
    sum12,
    weigh,
)
from softplc.kernel.batch.frame import add_to
from softplc.kernel.reference.adaptive_hypothesis import (
    CRUISE,
    HOLD,
    HYPOTHESES,
    KEPT,
    MANOEUVRE,
    REJECTIONS,
    SWING,
    SWINGS,
)
from softplc.kernel.result import Result

__all__ = ["AdaptiveBatchState", "AdaptiveTuning", "step"]


class AdaptiveBatchState:
    """What n axes keep between scans: outputs and variances as arrays[n], named as in the reference; zero at first.

    `modes` int8[12, n] and `hypotheses` float64[10, 12, n] (w, x, v, a, P00 … P22): the four swings, then the others
    in order of probability.
    """

    def __init__(self, n: int, dtype: DTypeLike = np.float64) -> None:
        self.dtype = np.dtype(dtype)
        self.init: Flags = np.zeros(n, np.bool_)
        self.rejections: NDArray[np.int8] = np.zeros(n, np.int8)
        self.modes: NDArray[np.int8] = np.zeros((KEPT, n), np.int8)
        self.hypotheses: Numbers = np.zeros((10, KEPT, n), self.dtype)
        self._outputs: Numbers = np.zeros((len(OUTPUTS), n), self.dtype)
        self.y, self.y_dot, self.y_ddot, self.y_res, self.S, self.K0, self.K1 = self._outputs[:7]
        self.P00, self.P01, self.P11, self.hold, self.cruise, self.manoeuvre = self._outputs[7:]
        self._scratch = Scratch(n, self.dtype)

    def __len__(self) -> int:
        return len(self.init)

    def finite(self) -> Flags:
        """Rows without NaN and infinity in the state."""
        hypotheses = np.logical_and.reduce(np.isfinite(self.hypotheses), axis=(0, 1))
        finite: Flags = hypotheses & np.logical_and.reduce(np.isfinite(self._outputs), axis=0)
        return finite

    def clear(self, rows: Flags) -> None:
        """Forget everything about these rows, as before the first scan."""
        self.init[rows] = False
        self.rejections[rows] = 0
        self.modes[:, rows] = 0
        self.hypotheses[:, :, rows] = 0.0
        self._outputs[:, rows] = 0.0

    def shift(self, rows: Flags, by: NDArray[np.float64]) -> None:
        """The origin of these rows moves: the positions of all their hypotheses grow by `by` [n], u."""
        self.hypotheses[AT_X][:, rows] += by[rows]
        add_to(self.y, rows, by)


@np.errstate(all="ignore")
def step(
    state: AdaptiveBatchState,
    tuning: AdaptiveTuning,
    *,
    EnableIn: Flags,
    x: NDArray[Any],
    dt: NDArray[Any],
    rows: Flags,
) -> NDArray[np.uint8]:
    """One scan of the rows where `rows` is true; the others are untouched. `x` in u, `dt` in s, all arrays[n].

    Returns the Result of each row, valid until the next step.
    """
    scratch = state._scratch
    z, dt = np.asarray(x, state.dtype), np.asarray(dt, state.dtype)
    run = rows & EnableIn
    timed = run & (dt > 0.0)
    starting = timed & ~state.init
    going = timed & state.init

    result = scratch.result
    result.fill(Result.UPDATED)
    if going.any():
        rates(scratch, tuning, dt)
        noise(scratch, tuning, dt)
        give_birth(state.hypotheses, state.modes, scratch, tuning)
        predict(scratch, dt)
        accepted = weigh(scratch, tuning, z)
        rejected = going & ~accepted
        updated = going & accepted
        _update(state, scratch, updated)
        if rejected.any():
            again = rejected & (state.rejections >= REJECTIONS) & np.isfinite(z)
            starting |= again
            rejected &= ~again
            _carry_on(state, scratch, rejected)
            result[rejected] = Result.REJECTED
    if starting.any():
        _start(state, tuning, z, starting)
        result[starting] = Result.INITIALISED
    if not timed.all():
        through = rows & ~timed  # pass through
        state.y[through] = z[through]
        state.y_dot[through] = 0.0
        state.y_ddot[through] = 0.0
        result[through] = Result.DT_INVALID
        disabled = rows & ~EnableIn
        state.init[disabled] = False
        result[disabled] = Result.DISABLED
        result[~rows] = Result.SKIPPED
    return result


def _update(state: AdaptiveBatchState, scratch: Scratch, rows: Flags) -> None:
    """Keep the swings and the eight most probable others, update them with the sample, and commit these rows."""
    kept, modes = _most_probable(scratch)
    _, x, v, a, P00, P01, P02, P11, P12, P22, nu, S, weight = kept
    np.divide(weight, sum12(weight), out=kept[AT_W])
    K0, K1, K2 = P00 / S, P01 / S, P02 / S
    rest = 1.0 - K0
    x += K0 * nu
    v += K1 * nu
    a += K2 * nu
    P11 -= K1 * P01
    np.copyto(P11, 0.0, where=P11 < 0.0)  # by rounding
    P12 -= K1 * P02
    P22 -= K2 * P02
    np.copyto(P22, 0.0, where=P22 < 0.0)
    P00 *= rest
    P01 *= rest
    P02 *= rest
    _commit(state, scratch, kept[:10], modes, (K0, K1), rows)


def _most_probable(scratch: Scratch) -> tuple[Numbers, NDArray[np.int8]]:
    """The swings and the eight others that weigh most, with their modes."""
    ranked = np.argsort(-scratch.every[AT_WEIGHT, SWINGS:], axis=0, kind="stable")[:HYPOTHESES]
    scratch.order[SWINGS:] = SWINGS + ranked
    index = scratch.order * len(scratch.axes) + scratch.axes
    return scratch.every.reshape(13, -1)[:, index], scratch.modes.ravel()[index]


def carry_on(state: AdaptiveBatchState, tuning: AdaptiveTuning, dt: Numbers, rows: Flags) -> None:
    """Δt later without a measurement, in these rows: the most probable of the sixteen, as they are predicted."""
    scratch, rejections = state._scratch, state.rejections.copy()
    rates(scratch, tuning, dt)
    noise(scratch, tuning, dt)
    give_birth(state.hypotheses, state.modes, scratch, tuning)
    predict(scratch, dt)
    weigh(scratch, tuning, state.y)  # for S
    scratch.outputs[OUTPUTS.index("y_res")] = 0.0
    scratch.every[AT_WEIGHT] = scratch.every[AT_W]
    kept, modes = _most_probable(scratch)
    weight = kept[AT_WEIGHT]
    np.divide(weight, sum12(weight), out=kept[AT_W])
    nothing = np.zeros_like(kept[AT_W])
    _commit(state, scratch, kept[:10], modes, (nothing, nothing), rows)
    state.rejections[:] = rejections


def _carry_on(state: AdaptiveBatchState, scratch: Scratch, rows: Flags) -> None:
    """The sample did not enter: the prediction of the twelve, their probabilities as they were."""
    kept = scratch.every[:10, :KEPT].copy()
    kept[AT_W] = state.hypotheses[AT_W]
    nothing = np.zeros_like(kept[AT_W])
    count = np.minimum(state.rejections + 1, REJECTIONS)
    _commit(state, scratch, kept, scratch.modes[:KEPT], (nothing, nothing), rows)
    state.rejections[rows] = count[rows]


def _start(state: AdaptiveBatchState, tuning: AdaptiveTuning, z: Numbers, rows: Flags) -> None:
    """At the measurement, at rest or not: four modes, none preferred."""
    R, speed, acceleration = tuning.r_x[rows], tuning.top_speed[rows], tuning.top_acceleration[rows]
    hold, cruise, manoeuvre = range(SWINGS, SWINGS + 3)
    moving = (*range(SWINGS), manoeuvre)
    first = np.zeros((10, KEPT, len(R)), state.dtype)
    first[AT_W, :SWINGS] = 0.25 * 0.25
    first[AT_W, hold : manoeuvre + 1] = 0.25
    first[AT_X] = z[rows]
    first[AT_P00] = R
    first[AT_P11, (*moving, cruise)] = speed * speed
    first[AT_P22, moving] = acceleration * acceleration
    modes = np.zeros((KEPT, len(R)), np.int8)
    modes[:SWINGS], modes[cruise], modes[manoeuvre] = SWING, CRUISE, MANOEUVRE
    outputs = np.zeros((len(OUTPUTS), len(R)), state.dtype)
    _estimate(outputs, first, modes, None)
    outputs[OUTPUTS.index("S")] = R
    state.hypotheses[:, :, rows] = first
    state.modes[:, rows] = modes
    state._outputs[:, rows] = outputs
    state.rejections[rows] = 0
    state.init[rows] = True


def _commit(
    state: AdaptiveBatchState,
    scratch: Scratch,
    kept: Numbers,
    modes: NDArray[np.int8],
    gains: tuple[Numbers, Numbers],
    rows: Flags,
) -> None:
    """Estimates of the kept hypotheses, and all of it to these rows."""
    _estimate(scratch.outputs, kept, modes, gains)
    if rows.all():
        np.copyto(state.hypotheses, kept)
        np.copyto(state.modes, modes)
        np.copyto(state._outputs, scratch.outputs)
        state.rejections.fill(0)
        return
    np.copyto(state.hypotheses, kept, where=rows)
    np.copyto(state.modes, modes, where=rows)
    np.copyto(state._outputs, scratch.outputs, where=rows)
    state.rejections[rows] = 0


def _estimate(
    outputs: Numbers, kept: Numbers, modes: NDArray[np.int8], gains: tuple[Numbers, Numbers] | None
) -> None:
    """Means over the twelve, into the rows of `outputs`; y_res and S stay as they are."""
    w, x, v, a, P00, P01, _, P11, _, _ = kept
    y, y_dot, y_ddot, _, _, K0, K1, out_P00, out_P01, out_P11, hold, cruise, manoeuvre = outputs
    y[:] = sum12(w * x)
    y_dot[:] = sum12(w * v)
    y_ddot[:] = sum12(w * a)
    dx, dv = x - y, v - y_dot
    out_P00[:] = sum12(w * (P00 + dx * dx))
    out_P01[:] = sum12(w * (P01 + dx * dv))
    out_P11[:] = sum12(w * (P11 + dv * dv))
    K0[:] = sum12(w * gains[0]) if gains else 0.0
    K1[:] = sum12(w * gains[1]) if gains else 0.0
    for mode, out in ((modes == HOLD, hold), (modes == CRUISE, cruise), (modes >= MANOEUVRE, manoeuvre)):
        out[:] = sum12(np.where(mode, w, 0.0))
