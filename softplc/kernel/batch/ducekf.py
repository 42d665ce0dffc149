"""DUCEKF on arrays: the operations of `kernel.reference.ducekf` in the same order, one row for each axis.

Names, equations and units are those of the reference, dt is in seconds. Bit-equal to it: no x ** 2, no matrix
product, no fused multiply-add. Everything is worked out for every row and then committed to the rows that it is
meant for.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softplc.kernel.batch.ducekf_state import DucekfBatchState, DucekfBatchTuning, Flags, Model, Numbers
from softplc.kernel.reference.covariance import ImpactCovariance
from softplc.kernel.result import Result

__all__ = ["DucekfBatchState", "DucekfBatchTuning", "Model", "step"]

Covariance = tuple[Numbers, Numbers, Numbers, Numbers]


@np.errstate(all="ignore")
def step(
    state: DucekfBatchState,
    tuning: DucekfBatchTuning,
    model: Model,
    *,
    EnableIn: Flags,
    x: Numbers,
    dt: Numbers,
    rows: Flags,
    contact: Numbers,
) -> NDArray[np.uint8]:
    """One scan of the rows where `rows` is true; the others are untouched. `x` in u, `dt` in s, all arrays[n].

    Returns the Result of each row.
    """
    result = np.full(len(state), Result.SKIPPED, np.uint8)
    run = rows & EnableIn
    valid = run & (dt > 0.0)
    start = valid & ~state.init
    go = valid & state.init

    x1, x2 = model.f(state.x1, state.x2, dt)  # (3)
    judged = _judge(model, tuning, state, x, dt, contact, x1, x2)
    impact, hold = go & judged.contact, go & judged.hold
    wait = np.where(np.isnan(state.wait), judged.longest, state.wait) - dt
    overdue = hold & (wait < 0.0)
    hold = hold & ~overdue
    start = start | overdue
    go = go & ~overdue

    stay = (impact | hold) if tuning.impact_scan == "replace" else hold  # the sample does not enter
    m0 = np.ones_like(x1)
    update = go & ~stay
    P = _propagate(model.jacobian(state.x1, state.x2, dt), state)  # (4) without Q
    if tuning.impact_scan == "within":
        beyond = impact & (judged.gap <= 0.0)
        m0[beyond] = -model.kappa[beyond]
        x1 = np.where(beyond, judged.limit + m0 * (x1 - judged.limit), x1)
        x2 = np.where(impact, -model.kappa * x2, x2)
        if impact.any():
            P = _impact_covariance(P, tuning.covariance, m0, -model.kappa, impact)
    P = (P[0] + tuning.q_x, P[1], P[2], P[3] + tuning.q_x_dot)
    ok = _update(state, tuning, x1, x2, P, x, update)

    if stay.any():
        _stay(state, tuning, model, x, impact, stay)

    # What both kinds leave behind, and the starts.
    np.copyto(state.s0, state.s1, where=go)
    np.copyto(state.s1, x, where=go)
    np.copyto(state.armed, judged.armed, where=go)
    np.copyto(state.touching, judged.touching, where=go)
    np.copyto(state.wait, np.where(hold, wait, np.nan), where=go)
    state.impacts[impact] += 1
    if start.any():
        _initialise(model, tuning, state, x, contact, start)
    np.copyto(state.y, state.x1, where=valid)
    np.copyto(state.y_dot, state.x2, where=valid)

    through = rows & ~valid
    np.copyto(state.y, x, where=through)
    np.copyto(state.y_dot, 0.0, where=through)
    state.init[rows & ~EnableIn] = False

    for code, where in (
        (Result.UPDATED, go),
        (Result.IMPACT, impact),
        (Result.S_NOT_POSITIVE, update & ~ok),
        (Result.HELD, hold),
        (Result.INITIALISED, start),
        (Result.DT_INVALID, through),
        (Result.DISABLED, rows & ~EnableIn),
    ):
        result[where] = code
    return result


@dataclass(frozen=True, slots=True)
class _Judged:
    """What a scan is, in each row: the surface, the estimate's gap to it, and whether it is an impact or a hold."""

    limit: Any
    gap: Numbers
    contact: Flags
    hold: Flags
    longest: Numbers
    armed: Flags
    touching: Flags


def _judge(
    model: Model,
    tuning: DucekfBatchTuning,
    state: DucekfBatchState,
    x: Numbers,
    dt: Numbers,
    contact: Numbers,
    x1: Numbers,
    x2: Numbers,
) -> _Judged:
    """Steps 13 and 17."""
    replaces = tuning.impact_scan == "replace"
    if replaces:
        x1, x2 = state.x1, state.x2
    limit, side = model.surface(x1)
    gap, gap_z = side * (x1 - limit), side * (x - limit)
    approaching = side * x2 < 0.0

    use_tag, use_position = tuning.contact_from != "position", tuning.contact_from != "tag"
    known = ~np.isnan(contact) if use_tag else np.zeros(len(x), np.bool_)
    closed = known & (contact > tuning.threshold)
    by_tag = closed & ~state.touching
    touching = np.where(known, closed, gap_z <= tuning.band if use_position else state.touching)

    longest = tuning.hold_limit
    if replaces:
        carried = side * (state.s1 - limit)
        above = tuning.edge == "above"
        band = (carried > 0.0) & (carried <= tuning.band) if above else (carried >= -tuning.band) & (carried < 0.0)
        by_position = band & (side * (state.s1 - state.s0) < 0.0)
        at_surface = gap <= tuning.band if above else gap < 0.0
    else:
        travel = -(side * x2) * dt
        widened = tuning.band + travel * np.where(model.kappa > 1.0, model.kappa, 1.0)
        by_position = (gap <= 0.0) & (gap_z <= widened)
        at_surface = (gap <= 0.0) & ((gap_z > tuning.band) | ~np.isnan(state.wait))
        needed = 2.0 * gap_z / abs(x2)
        longest = np.where(needed < longest, needed, longest)
    by_position = (by_position & state.armed) if use_position else np.zeros(len(x), np.bool_)

    touched = by_tag | by_position
    if not replaces:
        touched = touched & approaching
    awaited = known & ~closed
    if use_position:
        awaited = awaited | state.armed
    hold = at_surface & approaching & awaited & ~touched
    armed = (state.armed | (gap_z > tuning.band + tuning.hysteresis)) & ~touched
    return _Judged(limit, gap, touched, hold, longest, armed, touching)


def _initialise(
    model: Model, tuning: DucekfBatchTuning, state: DucekfBatchState, x: Numbers, contact: Numbers, rows: Flags
) -> None:
    """Start at the measurement, at rest."""
    limit, side = model.surface(x)
    state.init[rows] = True
    state._numbers[:, rows] = 0.0
    for array, values in (
        (state.x1, x),
        (state.P00, tuning.p_x),
        (state.P11, tuning.p_x_dot),
        (state.S, tuning.p_x + tuning.r_x),
        (state.s0, np.nan),
        (state.s1, x),
        (state.armed, side * (x - limit) > tuning.band + tuning.hysteresis),
        (state.touching, contact > tuning.threshold),
        (state.wait, np.nan),
    ):
        np.copyto(array, values, where=rows)


def _propagate(A: tuple[Any, Any, Any, Any], state: DucekfBatchState) -> Covariance:
    """APAᵀ, (4)."""
    a00, a01, a10, a11 = A
    P00, P01, P10, P11 = state.P00, state.P01, state.P01, state.P11
    b00 = a00 * P00 + a01 * P10
    b01 = a00 * P01 + a01 * P11
    b10 = a10 * P00 + a11 * P10
    b11 = a10 * P01 + a11 * P11
    return (b00 * a00 + b01 * a01, b00 * a10 + b01 * a11, b10 * a00 + b11 * a01, b10 * a10 + b11 * a11)


def _impact_covariance(
    P: Covariance, covariance: ImpactCovariance, m0: Numbers, m1: Numbers, rows: Flags
) -> Covariance:
    """P after a transition with the Jacobian diag(m0, m1) in these rows, (18), (28)."""
    if covariance == "none":
        return P
    if covariance == "omega":
        defined = m1 != 0.0
        m0, m1 = np.where(defined, 1.0 / m0, m0), np.where(defined, 1.0 / m1, m1)
    P00, P01, P10, P11 = P
    return (
        np.where(rows, (m0 * m0) * P00, P00),
        np.where(rows, (m0 * m1) * P01, P01),
        np.where(rows, (m0 * m1) * P10, P10),
        np.where(rows, (m1 * m1) * P11, P11),
    )


def _update(
    state: DucekfBatchState,
    tuning: DucekfBatchTuning,
    x1: Numbers,
    x2: Numbers,
    P: Covariance,
    x: Numbers,
    rows: Flags,
) -> Flags:
    """Correct a prediction by the measurement, (5) to (7), in these rows; returns where S is above zero."""
    P00, P01, P10, P11 = P
    y_res = x - x1
    S = P00 + tuning.r_x
    ok: Flags = S > 0.0
    K0 = P00 / S
    K1 = P10 / S
    np.copyto(state.y_res, y_res, where=rows)
    np.copyto(state.S, S, where=rows)
    np.copyto(state.x1, np.where(ok, x1 + K0 * y_res, x1), where=rows)
    np.copyto(state.x2, np.where(ok, x2 + K1 * y_res, x2), where=rows)
    rows = rows & ok
    np.copyto(state.K0, K0, where=rows)
    np.copyto(state.K1, K1, where=rows)
    np.copyto(state.P00, (1.0 - K0) * P00, where=rows)
    np.copyto(state.P01, (1.0 - K0) * P01, where=rows)
    np.copyto(state.P11, P11 - K1 * P01, where=rows)
    return ok


def _stay(
    state: DucekfBatchState, tuning: DucekfBatchTuning, model: Model, x: Numbers, impact: Flags, stay: Flags
) -> None:
    """(17) and (18) where a transition takes the place of the step, nothing where a hold does."""
    flip = impact & stay
    if flip.any():
        P = (state.P00, state.P01, state.P01, state.P11)
        P00, P01, _, P11 = _impact_covariance(P, tuning.covariance, np.ones_like(x), -model.kappa, flip)
        for array, values in (
            (state.P00, P00),
            (state.P01, P01),
            (state.P11, P11),
            (state.x2, -model.kappa * state.x2),
        ):
            np.copyto(array, values, where=flip)
    for array, values in (
        (state.K0, 0.0),
        (state.K1, 0.0),
        (state.S, state.P00 + tuning.r_x),
        (state.y_res, x - state.x1),
    ):
        np.copyto(array, values, where=stay)
