"""The AOI's arithmetic as numba compiles it: over many rows in one scan, and over many scans of recordings.

What is written here is a subset of Python that numba translates; mypy and coverage do not see it run. Names and
order of the operations are those of `kernel.reference.aoi`. One block of memory holds the state, float[13, n], in
the order of `AoiBatchState.numbers`, another the tuning, float[5, n], as `AoiTuning.numbers`.

Nothing is reordered or fused: no fast-math, no fused multiply-add. A loop that shall become vector instructions has
no branches, loads before it selects, and touches few enough arrays for LLVM to check that they do not overlap
(128 pairs with one that is written): `_steady`, with 12 written and 5 more read, has 126.
"""

# mypy: disable-error-code="no-untyped-def"
from typing import Any

import numpy as np
from numba import types

from softplc.kernel.compiled.jit import inlined
from softplc.kernel.result import Result

X_PRED, Y_RES, S, X_DOT_PRED, P0, P1, P2, P3, K0, K1, DT_S, Y, Y_DOT = range(13)
Q_X, Q_X_DOT, R_X, BLEED_THRESH, BLEED_FACTOR = range(5)
_UPDATED, _INITIALISED, _DISABLED = int(Result.UPDATED), int(Result.INITIALISED), int(Result.DISABLED)
_DT_INVALID, _S_NOT_POSITIVE = int(Result.DT_INVALID), int(Result.S_NOT_POSITIVE)
_SKIPPED = int(Result.SKIPPED)


@inlined
def _update(x, d, q_x, q_x_dot, r_x, one, zero, x_pred, x_dot_pred, P0, P1, P2, P3, K0, K1):  # pragma: no cover
    """Equations (2) to (21): predict, then correct where S > 0. Everything that a scan with a valid dt changes."""
    x_pred = x_pred + d * x_dot_pred
    dP3 = d * P3
    x_cov1 = P1 + dP3
    x_cov2 = P2 + dP3
    x_cov0 = (P0 + d * P2) + d * x_cov1
    x_cov0 = x_cov0 + q_x
    x_cov3 = P3 + q_x_dot
    y_res = x - x_pred
    S = x_cov0 + r_x

    ok = S > zero
    gain0 = x_cov0 / S
    gain1 = x_cov2 / S
    rest = one - gain0
    symmetric = rest * x_cov1
    corrected = x_pred + gain0 * y_res
    velocity = x_dot_pred + gain1 * y_res
    variance = x_cov3 - gain1 * x_cov1
    first = rest * x_cov0
    return (
        corrected if ok else x_pred,
        y_res,
        S,
        velocity if ok else x_dot_pred,
        first if ok else P0,
        symmetric if ok else P1,
        symmetric if ok else P2,
        variance if ok else P3,
        gain0 if ok else K0,
        gain1 if ok else K1,
    )


@inlined
def _ready(numbers, init, EnableIn, dt, rows):  # pragma: no cover
    """Whether every row is in the normal course of things; if so dt_s of all rows has been written."""
    n = len(init)
    real = numbers.dtype.type
    zero, thousand = real(0.0), real(1000.0)
    dt_s = numbers[DT_S]
    ready = True
    for i in range(n):
        ready &= (init[i] != 0) & EnableIn[i] & rows[i]
    if not ready or n == 0:
        return False
    first = real(dt[0])
    same = True
    for i in range(n):
        same &= real(dt[i]) == first
    if same:  # one division instead of n
        d = zero if first <= zero else first / thousand
        for i in range(n):
            dt_s[i] = d
        return d > zero
    positive = True
    for i in range(n):
        ms = real(dt[i])
        d = zero if ms <= zero else ms / thousand
        dt_s[i] = d
        positive &= d > zero
    return positive


@inlined
def _steady(numbers, tuning, x):  # pragma: no cover
    """All rows at once; whether S was positive in all of them."""
    real = numbers.dtype.type
    one, zero = real(1.0), real(0.0)
    x_pred, y_res, S_, x_dot_pred = numbers[X_PRED], numbers[Y_RES], numbers[S], numbers[X_DOT_PRED]
    P0_, P1_, P2_, P3_ = numbers[P0], numbers[P1], numbers[P2], numbers[P3]
    K0_, K1_, dt_s, y, y_dot = numbers[K0], numbers[K1], numbers[DT_S], numbers[Y], numbers[Y_DOT]
    q_x, q_x_dot, r_x = tuning[Q_X], tuning[Q_X_DOT], tuning[R_X]
    positive = True
    for i in range(numbers.shape[1]):
        position, e, s, velocity, p0, p1, p2, p3, k0, k1 = _update(
            real(x[i]), dt_s[i], q_x[i], q_x_dot[i], r_x[i], one, zero, x_pred[i], x_dot_pred[i],
            P0_[i], P1_[i], P2_[i], P3_[i], K0_[i], K1_[i],
        )  # fmt: skip
        x_pred[i] = position
        y[i] = position
        y_res[i] = e
        S_[i] = s
        x_dot_pred[i] = velocity
        y_dot[i] = velocity
        P0_[i] = p0
        P1_[i] = p1
        P2_[i] = p2
        P3_[i] = p3
        K0_[i] = k0
        K1_[i] = k1
        positive &= s > zero
    return positive


@inlined
def _bleed(numbers, tuning, BleedEnable, x):  # pragma: no cover
    """Equation (22) for all rows."""
    real = numbers.dtype.type
    zero = real(0.0)
    S_, x_pred, x_dot_pred, y_dot = numbers[S], numbers[X_PRED], numbers[X_DOT_PRED], numbers[Y_DOT]
    threshold, factor = tuning[BLEED_THRESH], tuning[BLEED_FACTOR]
    for i in range(numbers.shape[1]):
        velocity = x_dot_pred[i]
        bled = velocity * factor[i]
        near = abs(real(x[i]) - x_pred[i]) < threshold[i]
        velocity = bled if BleedEnable[i] & near & (S_[i] > zero) else velocity
        x_dot_pred[i] = velocity
        y_dot[i] = velocity


@inlined
def _row(numbers, init, tuning, BleedEnable, i, EnableIn, x, dt):  # pragma: no cover
    """One row by itself, whatever it is given; its result."""
    real = numbers.dtype.type
    zero, one = real(0.0), real(1.0)
    if not EnableIn:
        init[i] = 0
        numbers[Y, i] = x
        numbers[Y_DOT, i] = zero
        return _DISABLED
    d = zero if dt <= zero else dt / real(1000.0)
    numbers[DT_S, i] = d
    result = _UPDATED
    if init[i] == 0:
        numbers[X_PRED, i] = x
        numbers[X_DOT_PRED, i] = zero
        numbers[P0, i] = one
        numbers[P1, i] = zero
        numbers[P2, i] = zero
        numbers[P3, i] = real(10.0)
        numbers[K0, i] = zero
        numbers[K1, i] = zero
        init[i] = 1
        result = _INITIALISED
    if not d > zero:
        numbers[Y, i] = x
        numbers[Y_DOT, i] = zero
        return _DT_INVALID
    position, e, s, velocity, p0, p1, p2, p3, k0, k1 = _update(
        x, d, tuning[Q_X, i], tuning[Q_X_DOT, i], tuning[R_X, i], one, zero, numbers[X_PRED, i],
        numbers[X_DOT_PRED, i], numbers[P0, i], numbers[P1, i], numbers[P2, i], numbers[P3, i], numbers[K0, i],
        numbers[K1, i],
    )  # fmt: skip
    if s > zero:
        if BleedEnable[i] and abs(x - position) < tuning[BLEED_THRESH, i]:
            velocity = velocity * tuning[BLEED_FACTOR, i]
    else:
        result = _S_NOT_POSITIVE
    numbers[X_PRED, i] = position
    numbers[Y_RES, i] = e
    numbers[S, i] = s
    numbers[X_DOT_PRED, i] = velocity
    numbers[P0, i] = p0
    numbers[P1, i] = p1
    numbers[P2, i] = p2
    numbers[P3, i] = p3
    numbers[K0, i] = k0
    numbers[K1, i] = k1
    numbers[Y, i] = position
    numbers[Y_DOT, i] = velocity
    return result


@inlined
def _scan(numbers, flags, tuning, BleedEnable, EnableIn, x, dt, rows):  # pragma: no cover
    """One scan of n rows: x and dt (ms) float64[n], EnableIn, rows bool[n], flags as `AoiBatchState.bytes`."""
    init, result = flags[0], flags[1]
    n = len(init)
    real = numbers.dtype.type
    if not _ready(numbers, init, EnableIn, dt, rows):
        for i in range(n):
            if rows[i]:
                result[i] = _row(numbers, init, tuning, BleedEnable, i, EnableIn[i], real(x[i]), real(dt[i]))
            else:
                result[i] = _SKIPPED
        return
    positive = _steady(numbers, tuning, x)
    bleeding = False
    for i in range(n):
        bleeding |= BleedEnable[i]
    if bleeding:
        _bleed(numbers, tuning, BleedEnable, x)
    for i in range(n):
        result[i] = _UPDATED
    if not positive:
        for i in range(n):
            if not numbers[S, i] > real(0.0):
                result[i] = _S_NOT_POSITIVE


def scan(numbers, flags, tuning, BleedEnable, EnableIn, x, dt, rows):  # pragma: no cover
    """`_scan` for `compile_now`."""
    _scan(numbers, flags, tuning, BleedEnable, EnableIn, x, dt, rows)


def scan_signature(dtype: np.dtype[Any]) -> tuple[Any, ...]:
    """The numba types of `scan`'s arguments for a state of this precision."""
    block, flags, numbers = _real(dtype)[:, ::1], types.boolean[::1], types.float64[::1]
    return block, types.uint8[:, ::1], block, flags, flags, numbers, numbers, flags


def _real(dtype: np.dtype[Any]) -> Any:
    return types.float32 if dtype == np.float32 else types.float64
