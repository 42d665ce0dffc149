"""One hypothesis of the adaptive observer: its constants, how it is mixed, predicted and updated.

Letters, units and sources as in `kernel.reference.adaptive`.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

HOLD, CRUISE, MANOEUVRE, SWING = 0, 1, 2, 3
SWINGS: Final = 4  # filters that follow a motion without rest; always kept, and first in every list
HYPOTHESES: Final = 8
KEPT: Final = SWINGS + HYPOTHESES
BIRTHS: Final = 4

# What all machines have in common, in units of V, A and τ = V/A: found by search on simulated tracks.
CHANGE: Final = 13.5  # mean time between changes of motion, τ
JUMP: Final = 1.9  # how often a speed changes at once, against how often an acceleration begins
DWELL: Final = 2.0  # mean duration of a manoeuvre, τ
TO_REST, TO_OTHER, TO_CRUISE = 0.18, 0.22, 0.6  # what follows a manoeuvre: rest, another, constant speed
JERK: Final = 0.026  # drift of the acceleration in a manoeuvre, A²/τ
SWAY: Final = 1.3e-4  # drift of the speed in a cruise, A²·τ
CREEP: Final = 0.003  # drift of the position in a hold, R/τ
SWING_JERK: Final = (
    0.8,
    0.032,
    0.00128,
    5.12e-5,
)  # drift of the acceleration in a swing, A²/τ: 25 times gentler each
SWING_BEGINS: Final = 0.002  # how often anything else becomes a swing, 1/τ
SWING_ENDS: Final = 0.02  # how often a swing ends, each birth as often, 1/τ
REJECTIONS: Final = 3  # in a row; the next sample beyond the gate starts the observer anew


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """One guess how the axis moves: mode, probability, state and covariance."""

    mode: int = HOLD
    w: float = 0.0
    x: float = 0.0
    v: float = 0.0
    a: float = 0.0
    P00: float = 0.0
    P01: float = 0.0
    P02: float = 0.0
    P11: float = 0.0
    P12: float = 0.0
    P22: float = 0.0


def mixed(old: tuple[Hypothesis, ...], rates: tuple[Any, Any, Any, Any]) -> Hypothesis:
    """Mean and covariance of position and speed over all that may change this way, without acceleration [BB]."""
    sources = [one.w * rates[one.mode] for one in old]
    w = sum12(sources)
    shares = [s / w if w > 0.0 else 0.0 * s for s in sources]
    x = sum12([s * one.x for s, one in zip(shares, old, strict=True)])
    v = sum12([s * one.v for s, one in zip(shares, old, strict=True)])
    from_mean = [(s, one, one.x - x, one.v - v) for s, one in zip(shares, old, strict=True)]
    P00 = sum12([s * (one.P00 + dx * dx) for s, one, dx, _ in from_mean])
    P01 = sum12([s * (one.P01 + dx * dv) for s, one, dx, dv in from_mean])
    P11 = sum12([s * (one.P11 + dv * dv) for s, one, _, dv in from_mean])
    none = np.float64(0.0)
    return Hypothesis(CRUISE, w, x, v, none, P00, P01, none, P11, none, none)


def noise(dt: Any, tau: Any, R: Any, A: Any) -> tuple[tuple[Any, ...], ...]:
    """Q of hold, cruise, manoeuvre and each swing: white noise through 0, 1, 2 and 2 integrators.

    As (Q00, Q01, Q02, Q11, Q12, Q22).
    """
    none, half = np.float64(0.0), 0.5 * dt
    creep = (CREEP * R / tau) * dt
    sway = (((SWAY * A) * A) * tau) * dt
    square = dt * dt
    swings = [_jerk(drift, dt, tau, A) for drift in SWING_JERK]
    return (
        (creep, none, none, none, none, none),
        (sway * (square / 3.0), sway * half, none, sway, none, none),
        _jerk(JERK, dt, tau, A),
        *swings,
    )


def _jerk(drift: float, dt: Any, tau: Any, A: Any) -> tuple[Any, ...]:
    """Q of an acceleration that drifts."""
    jerk = (((drift * A) * A) / tau) * dt
    square = dt * dt
    return (
        jerk * (square * square / 20.0),
        jerk * (square * dt / 8.0),
        jerk * (square / 6.0),
        jerk * (square / 3.0),
        jerk * (0.5 * dt),
        jerk,
    )


def predicted(one: Hypothesis, dt: Any, Q: tuple[Any, ...]) -> Hypothesis:
    """State and covariance Δt later."""
    h = (0.5 * dt) * dt
    a0 = (one.P00 + dt * one.P01) + h * one.P02  # F·P, first row
    a1 = (one.P01 + dt * one.P11) + h * one.P12
    a2 = (one.P02 + dt * one.P12) + h * one.P22
    b1 = one.P11 + dt * one.P12  # second row
    b2 = one.P12 + dt * one.P22
    P00 = ((a0 + dt * a1) + h * a2) + Q[0]
    return Hypothesis(
        one.mode,
        one.w,
        (one.x + dt * one.v) + h * one.a,
        one.v + dt * one.a,
        one.a,
        np.float64(0.0) if P00 < 0.0 else P00,  # by rounding
        (a1 + dt * a2) + Q[1],
        a2 + Q[2],
        (b1 + dt * b2) + Q[3],
        b2 + Q[4],
        one.P22 + Q[5],
    )


def updated(one: Hypothesis, nu: Any, S: Any) -> tuple[Hypothesis, Any, Any]:
    """The hypothesis after its measurement, and its gains for position and speed."""
    K0, K1, K2 = one.P00 / S, one.P01 / S, one.P02 / S
    P11 = one.P11 - K1 * one.P01
    P22 = one.P22 - K2 * one.P02
    after = Hypothesis(
        one.mode,
        one.w,
        one.x + K0 * nu,
        one.v + K1 * nu,
        one.a + K2 * nu,
        (1.0 - K0) * one.P00,
        (1.0 - K0) * one.P01,
        (1.0 - K0) * one.P02,
        np.float64(0.0) if P11 < 0.0 else P11,  # by rounding
        one.P12 - K1 * one.P02,
        np.float64(0.0) if P22 < 0.0 else P22,
    )
    return after, K0, K1


def sum12(v: list[Any]) -> Any:
    """In the order in which the batch adds twelve rows."""
    six = [v[i] + v[i + 6] for i in range(6)]
    return ((six[0] + six[3]) + (six[1] + six[4])) + (six[2] + six[5])


def sum16(v: list[Any]) -> Any:
    """In the order in which the batch adds sixteen rows."""
    eight = [v[i] + v[i + 8] for i in range(8)]
    four = [eight[i] + eight[i + 4] for i in range(4)]
    return (four[0] + four[2]) + (four[1] + four[3])
