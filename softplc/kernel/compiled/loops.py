"""The AOI's arithmetic as numba compiles it: over many rows in one scan, and over many scans of recordings.

What is written here is a subset of Python that numba translates; mypy and coverage do not see it run. It is one
file, whatever its length, as numba tells by its date and size whether what was kept of it is still right. Names
and order of the operations are those of `kernel.reference.aoi`. One block of memory holds the state, float[13, n], in
the order of `AoiBatchState.numbers`, another the tuning, float[5, n], as `AoiTuning.numbers`.

Nothing is reordered or fused: no fast-math, no fused multiply-add. A loop that shall become vector instructions has
no branches, loads before it selects, and touches few enough arrays for LLVM to check that they do not overlap
(128 pairs with one that is written): `_steady`, with 12 written and 5 more read, has 126.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: SIM300  # zero is a variable here

import numpy as np

from softplc.kernel.compiled.jit import inlined
from softplc.kernel.result import Result

X_PRED, Y_RES, S, X_DOT_PRED, P0, P1, P2, P3, K0, K1, DT_S, Y, Y_DOT = range(13)
Q_X, Q_X_DOT, R_X, BLEED_THRESH, BLEED_FACTOR = range(5)
_UPDATED, _INITIALISED, _DISABLED = int(Result.UPDATED), int(Result.INITIALISED), int(Result.DISABLED)
_DT_INVALID, _S_NOT_POSITIVE = int(Result.DT_INVALID), int(Result.S_NOT_POSITIVE)
_SKIPPED = int(Result.SKIPPED)
FEW = 24  # axes below which a recording is replayed axis by axis


@inlined
def _update(x, d, q_x, q_x_dot, r_x, one, x_pred, x_dot_pred, P0, P1, P2, P3):  # pragma: no cover
    """Equations (2) to (21) of a scan with a valid dt: what is predicted, and what it is corrected to if S > 0."""
    x_pred = x_pred + d * x_dot_pred
    dP3 = d * P3
    x_cov1 = P1 + dP3
    x_cov2 = P2 + dP3
    x_cov0 = (P0 + d * P2) + d * x_cov1
    x_cov0 = x_cov0 + q_x
    x_cov3 = P3 + q_x_dot
    y_res = x - x_pred
    S = x_cov0 + r_x

    K1 = x_cov2 / S  # before K0, since more hangs on it: from here to the next S is the longer way
    K0 = x_cov0 / S
    rest = one - K0
    corrected = x_pred + K0 * y_res
    x_dot_pred = x_dot_pred + K1 * y_res
    return x_pred, y_res, S, corrected, x_dot_pred, rest * x_cov0, rest * x_cov1, x_cov3 - K1 * x_cov1, K0, K1


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
        v, p0, p1, p2, p3, k0, k1 = x_dot_pred[i], P0_[i], P1_[i], P2_[i], P3_[i], K0_[i], K1_[i]
        predicted, e, s, corrected, velocity, first, second, third, gain0, gain1 = _update(
            real(x[i]), dt_s[i], q_x[i], q_x_dot[i], r_x[i], one, x_pred[i], v, p0, p1, p2, p3
        )
        ok = s > zero
        position = corrected if ok else predicted
        velocity = velocity if ok else v
        x_pred[i] = position
        y[i] = position
        y_res[i] = e
        S_[i] = s
        x_dot_pred[i] = velocity
        y_dot[i] = velocity
        P0_[i] = first if ok else p0
        P1_[i] = second if ok else p1
        P2_[i] = second if ok else p2
        P3_[i] = third if ok else p3
        K0_[i] = gain0 if ok else k0
        K1_[i] = gain1 if ok else k1
        positive &= ok
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
def _block(
    real, EnableIn, x, dt, q_x, q_x_dot, r_x, BleedEnable, BleedThresh, BleedFactor,
    init, x_pred, y_res, S, x_dot_pred, P0, P1, P2, P3, K0, K1, dt_s, y, y_dot,
):  # fmt: skip  # pragma: no cover
    """One scan of one axis whatever it is given, as `reference.aoi`: its result, then its state in this order."""
    zero, one = real(0.0), real(1.0)
    result = _UPDATED
    if not EnableIn:
        init, y, y_dot, result = False, x, zero, _DISABLED
    else:
        dt_s = zero if dt <= zero else dt / real(1000.0)
        if not init:
            x_pred, x_dot_pred = x, zero
            P0, P1, P2, P3 = one, zero, zero, real(10.0)
            K0, K1 = zero, zero
            init, result = True, _INITIALISED
        if dt_s > zero:
            x_pred, y_res, S, corrected, velocity, first, second, third, gain0, gain1 = _update(
                x, dt_s, q_x, q_x_dot, r_x, one, x_pred, x_dot_pred, P0, P1, P2, P3
            )
            if S > zero:
                x_pred, x_dot_pred, P0, P1, P2, P3 = corrected, velocity, first, second, second, third
                K0, K1 = gain0, gain1
                if BleedEnable and abs(x - x_pred) < BleedThresh:
                    x_dot_pred = x_dot_pred * BleedFactor
            else:
                result = _S_NOT_POSITIVE
            y, y_dot = x_pred, x_dot_pred
        else:
            y, y_dot, result = x, zero, _DT_INVALID
    return result, init, x_pred, y_res, S, x_dot_pred, P0, P1, P2, P3, K0, K1, dt_s, y, y_dot


@inlined
def _load(numbers, init, i):  # pragma: no cover
    """The state of one row."""
    return (
        init[i] != 0, numbers[X_PRED, i], numbers[Y_RES, i], numbers[S, i], numbers[X_DOT_PRED, i],
        numbers[P0, i], numbers[P1, i], numbers[P2, i], numbers[P3, i], numbers[K0, i], numbers[K1, i],
        numbers[DT_S, i], numbers[Y, i], numbers[Y_DOT, i],
    )  # fmt: skip


@inlined
def _store(numbers, init, i, state):  # pragma: no cover
    """Put the state of one row back."""
    (
        init[i], numbers[X_PRED, i], numbers[Y_RES, i], numbers[S, i], numbers[X_DOT_PRED, i],
        numbers[P0, i], numbers[P1, i], numbers[P2, i], numbers[P3, i], numbers[K0, i], numbers[K1, i],
        numbers[DT_S, i], numbers[Y, i], numbers[Y_DOT, i],
    ) = state  # fmt: skip


@inlined
def _row(numbers, init, tuning, BleedEnable, i, EnableIn, x, dt):  # pragma: no cover
    """One scan of one row by itself; its result."""
    after = _block(
        numbers.dtype.type, EnableIn, x, dt, tuning[Q_X, i], tuning[Q_X_DOT, i], tuning[R_X, i], BleedEnable[i],
        tuning[BLEED_THRESH, i], tuning[BLEED_FACTOR, i], *_load(numbers, init, i),
    )  # fmt: skip
    _store(numbers, init, i, after[1:])
    return after[0]


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


def replay(numbers, flags, tuning, BleedEnable, EnableIn, x, dt, out, results):  # pragma: no cover
    """A recording of n axes, x float64[t, n], through `_scan`, or axis by axis where there are few.

    EnableIn bool[t, m] and dt float64[t, m], ms, with m = n or 1 for all axes. `out` is float[13, t, n] for all
    rows of `numbers`, or float[2, t, n] for the last two, y and y_dot. results: uint8[t, n].
    """
    scans, n = x.shape
    if n < FEW:
        for j in range(n):
            _axis(numbers, flags[0], tuning, BleedEnable, j, EnableIn, x, dt, out, results)
        return
    rows = np.ones(n, np.bool_)
    enable, steps = np.empty(n, np.bool_), np.empty(n, np.float64)
    tracks = out.shape[0]
    for t in range(scans):
        _spread(EnableIn[t], enable)
        _spread(dt[t], steps)
        _scan(numbers, flags, tuning, BleedEnable, enable, x[t], steps, rows)
        for row in range(tracks):
            _spread(numbers[13 - tracks + row], out[row, t])
        _spread(flags[1], results[t])


@inlined
def _spread(values, into):  # pragma: no cover
    """Copy n numbers, or one to all n."""
    if len(values) == len(into):
        for j in range(len(into)):
            into[j] = values[j]
    else:
        for j in range(len(into)):
            into[j] = values[0]


@inlined
def _axis(numbers, init, tuning, BleedEnable, j, EnableIn, x, dt, out, results):  # pragma: no cover
    """One axis through all its scans, with its state in registers.

    The inner loops are the normal course and leave it by a jump, so that nothing waits for a choice to be made.
    P, K and S depend on dt alone. Where a scan has left P as it was, bit by bit, the next one with the same dt would
    leave it again: from there on position and velocity are all that is left to compute.
    """
    real = numbers.dtype.type
    zero, one, thousand = real(0.0), real(1.0), real(1000.0)
    q_x, q_x_dot, r_x = tuning[Q_X, j], tuning[Q_X_DOT, j], tuning[R_X, j]
    bleeding, threshold, factor = BleedEnable[j], tuning[BLEED_THRESH, j], tuning[BLEED_FACTOR, j]
    enables, steps = EnableIn[:, j % EnableIn.shape[1]], dt[:, j % dt.shape[1]]
    init_, x_pred, y_res, s, velocity, p0, p1, p2, p3, k0, k1, dt_s, y, y_dot = _load(numbers, init, j)
    t, scans = 0, x.shape[0]
    while t < scans:
        settled = False
        while init_ and not settled and t < scans and enables[t]:
            z, ms = real(x[t, j]), real(steps[t])
            d = ms / thousand
            if not d > zero:
                break
            _, e, variance, corrected, corrected_velocity, first, second, third, gain0, gain1 = _update(
                z, d, q_x, q_x_dot, r_x, one, x_pred, velocity, p0, p1, p2, p3
            )
            if not variance > zero:
                break
            settled = p0 == first and p1 == second and p2 == second and p3 == third
            x_pred, y_res, s, velocity, dt_s = corrected, e, variance, corrected_velocity, d
            p0, p1, p2, p3, k0, k1 = first, second, second, third, gain0, gain1
            if bleeding and abs(z - x_pred) < threshold:
                velocity = velocity * factor
            y, y_dot = x_pred, velocity
            _keep(out, t, j, (x_pred, y_res, s, velocity, p0, p1, p2, p3, k0, k1, dt_s, y, y_dot))
            results[t, j] = _UPDATED
            t += 1
        if settled:
            while t < scans and enables[t] and real(steps[t]) == ms:
                z = real(x[t, j])
                x_pred = x_pred + dt_s * velocity
                y_res = z - x_pred
                x_pred = x_pred + k0 * y_res
                velocity = velocity + k1 * y_res
                if bleeding and abs(z - x_pred) < threshold:
                    velocity = velocity * factor
                y, y_dot = x_pred, velocity
                _keep(out, t, j, (x_pred, y_res, s, velocity, p0, p1, p2, p3, k0, k1, dt_s, y, y_dot))
                results[t, j] = _UPDATED
                t += 1
        elif t < scans:
            results[t, j], init_, x_pred, y_res, s, velocity, p0, p1, p2, p3, k0, k1, dt_s, y, y_dot = _block(
                real, enables[t], real(x[t, j]), real(steps[t]), q_x, q_x_dot, r_x, bleeding, threshold, factor,
                init_, x_pred, y_res, s, velocity, p0, p1, p2, p3, k0, k1, dt_s, y, y_dot,
            )  # fmt: skip
            _keep(out, t, j, (x_pred, y_res, s, velocity, p0, p1, p2, p3, k0, k1, dt_s, y, y_dot))
            t += 1
    _store(
        numbers, init, j,
        (init_, x_pred, y_res, s, velocity, p0, p1, p2, p3, k0, k1, dt_s, y, y_dot),
    )  # fmt: skip


@inlined
def _keep(out, t, j, state):  # pragma: no cover
    """The state after a scan into `out`: all of it, or y and y_dot."""
    if out.shape[0] == 13:
        (
            out[X_PRED, t, j], out[Y_RES, t, j], out[S, t, j], out[X_DOT_PRED, t, j], out[P0, t, j],
            out[P1, t, j], out[P2, t, j], out[P3, t, j], out[K0, t, j], out[K1, t, j], out[DT_S, t, j],
        ) = state[:11]  # fmt: skip
    out[-2, t, j], out[-1, t, j] = state[11], state[12]
