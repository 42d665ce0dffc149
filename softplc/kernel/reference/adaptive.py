"""The adaptive observer: twelve hypotheses of how the axis moves, each a Kalman filter, weighed by the measurements.

An axis holds, cruises, manoeuvres (accelerates for a while), or swings (is always in motion). Four swings, from
lively to gentle, follow the axis all the time; only their probabilities come and go. Of the other modes there are
eight hypotheses. In each scan every hypothesis goes on in its mode; four more are born that say the motion has just
changed; all sixteen predict, and beside the swings the eight that the measurement makes most probable are kept. The
outputs are the mean over the twelve. Equations:
[BB] H. Blom, Y. Bar-Shalom, "The interacting multiple model algorithm for systems with Markovian switching
coefficients", IEEE Trans. Automatic Control 33 (1988), whose mixing makes the births;
[TH] J. Tugnait, A. Haddad, "A detection-estimation scheme for state estimation in switching environments",
Automatica 15 (1979), whose rule it is to keep the most probable sequences;
[BLK] Y. Bar-Shalom, X. Li, T. Kirubarajan, "Estimation with Applications to Tracking and Navigation" (2001).

| letter | meaning | variable | tag | unit | equation |
|---|---|---|---|---|---|
| z | measured position | x | Raw | u | z = x + noise |
| Δt | time step | dt | Dt | s | |
| V | speed at which the machine travels | top_speed | top_speed | u/s | deviation of a speed not known yet |
| A | its acceleration | top_acceleration | top_acceleration | u/s² | likewise |
| R | measurement noise, per sample | r_x | r_x | u² | |
| g | gate | gate | gate | 1 | no sample beyond g·√S of every hypothesis |
| τ | time from rest to speed | tau | | s | V/A |
| x, v, a | state of a hypothesis | x, v, a | | u, u/s, u/s² | x⁻ = x + Δt·v + Δt²/2·a, v⁻ = v + Δt·a |
| P | its covariance | P00 … P22 | | | P⁻ = F·P·Fᵀ + Q(mode) [BLK 6.2.2, 6.3.2] |
| w | its probability | w | | 1 | w ∝ w⁻·Λ [BLK 11.6.6] |
| Λ | likelihood of the measurement | like | | | (1 + u/64)⁻³²/√S, u = ν²/S, for exp(−u/2)/√S |
| ν, S | its innovation and variance | nu, S | | u, u² | ν = z − x⁻, S = P00⁻ + R |
| K | its gains | K0, K1, K2 | | | K = P⁻Hᵀ/S |
| x̂, v̂, â | estimates | y, y_dot, y_ddot | Position, Velocity, Acceleration | u, u/s, u/s² | Σ w·x, … [BLK 11.6.6] |
| P00, P01, P11 | their variances | P00 … | P00, P01, P11 | u², u²/s, (u/s)² | Σ w·(P + (x − x̂)²), … |

The likelihood is Student's, with 63 degrees of freedom: a Gauss curve as far as it matters, its tail a little
heavier, computed with + − × ÷ √ alone, and never 0 for the best hypothesis. The probability to go on for Δt is
1/(1 + rate·Δt), so the rates of change fit every Δt.
"""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from softplc.kernel.reference.adaptive_hypothesis import (
    CHANGE,
    CRUISE,
    DWELL,
    HOLD,
    HYPOTHESES,
    JUMP,
    KEPT,
    MANOEUVRE,
    REJECTIONS,
    SWING,
    SWING_BEGINS,
    SWING_ENDS,
    SWINGS,
    TO_CRUISE,
    TO_OTHER,
    TO_REST,
    Hypothesis,
    mixed,
    noise,
    predicted,
    sum12,
    sum16,
    updated,
)
from softplc.kernel.result import Result


@dataclass(slots=True)
class AdaptiveState:
    """What is kept between scans, all zero before the first; the swings, then the others in order of probability."""

    init: bool = False
    hypotheses: tuple[Hypothesis, ...] = field(default_factory=lambda: (Hypothesis(),) * KEPT)
    rejections: int = 0
    y: float = 0.0
    y_dot: float = 0.0
    y_ddot: float = 0.0
    y_res: float = 0.0
    S: float = 0.0
    K0: float = 0.0
    K1: float = 0.0
    P00: float = 0.0
    P01: float = 0.0
    P11: float = 0.0
    hold: float = 0.0
    cruise: float = 0.0
    manoeuvre: float = 0.0


@dataclass(frozen=True, slots=True)
class AdaptiveInputs:
    """One scan: `x` in u, `dt` in s, `r_x` in u², `top_speed` in u/s, `top_acceleration` in u/s², `gate` in √S."""

    EnableIn: bool
    x: float
    dt: float
    r_x: float
    top_speed: float
    top_acceleration: float
    gate: float = 4.0


def adaptive(state: AdaptiveState, inputs: AdaptiveInputs) -> tuple[AdaptiveState, Result]:
    """One scan in double precision: the state after it, and what happened."""
    with np.errstate(all="ignore"):
        return _adaptive(state, inputs)


def _adaptive(state: AdaptiveState, inputs: AdaptiveInputs) -> tuple[AdaptiveState, Result]:
    real = np.float64  # divides by zero as an array does
    z, dt = real(inputs.x), real(inputs.dt)
    R, V, A, gate = (real(value) for value in (inputs.r_x, inputs.top_speed, inputs.top_acceleration, inputs.gate))

    if not inputs.EnableIn:
        return replace(state, init=False, y=z, y_dot=real(0.0), y_ddot=real(0.0)), Result.DISABLED
    if not dt > 0.0:
        return replace(state, y=z, y_dot=real(0.0), y_ddot=real(0.0)), Result.DT_INVALID
    if not state.init:
        return _start(z, R, V, A), Result.INITIALISED

    old = state.hypotheses
    ahead = _sixteen(old, dt, R, V, A)
    none = real(0.0)
    nu = [z - one.x for one in ahead]
    S = [one.P00 + R for one in ahead]
    never = real(np.inf)  # as far as what has no probability is away
    distance = [n * n / s if one.w > 0.0 else never for one, n, s in zip(ahead, nu, S, strict=True)]
    nearest = np.min(distance)
    ordinary = np.min(distance[SWINGS:])  # a gentle swing may be anywhere

    x16, S16 = _expected(ahead, R)
    expected = {"y_res": z - x16, "S": S16}

    if not ordinary <= gate * gate:
        if state.rejections >= REJECTIONS and np.isfinite(z):
            return _start(z, R, V, A), Result.INITIALISED
        kept = [replace(one, w=before.w) for one, before in zip(ahead, old, strict=False)]
        after = _estimate(kept, [none] * KEPT, [none] * KEPT)
        count = min(state.rejections + 1, REJECTIONS)
        return replace(after, rejections=count, **expected), Result.REJECTED

    # Weigh, keep the swings and the eight most probable of the others [TH], update them.
    best = 1.0 + nearest / 64.0
    weights = []
    for w, d, s in zip([one.w for one in ahead], distance, S, strict=True):
        like = best / (1.0 + d / 64.0)
        for _ in range(5):
            like = like * like  # to the power of 32
        weights.append(w * (like / np.sqrt(s)))
    order = _most_probable(weights)
    total = sum12([weights[i] for i in order])
    kept, K0, K1 = [], [], []
    for i in order:
        one, gain0, gain1 = updated(ahead[i], nu[i], S[i])
        kept.append(replace(one, w=weights[i] / total))
        K0.append(gain0)
        K1.append(gain1)
    return replace(_estimate(kept, K0, K1), **expected), Result.UPDATED


def _sixteen(old: tuple[Hypothesis, ...], dt: Any, R: Any, V: Any, A: Any) -> list[Hypothesis]:
    """The twelve that go on and the four that are born, each predicted Δt ahead."""
    # Rates of change, and the probabilities to go on, by mode.
    tau = V / A
    u = dt / (CHANGE * tau)
    g = dt / (DWELL * tau)
    begin = SWING_BEGINS * dt / tau
    end = SWING_ENDS * dt / tau
    ju = JUMP * u
    on = (
        1.0 / (1.0 + ((ju + u) + begin)),
        1.0 / (1.0 + (((ju + ju) + u) + begin)),
        1.0 / (1.0 + (g + begin)),
        1.0 / (1.0 + end),
    )
    leave = g * on[MANOEUVRE]
    quarter = (0.25 * end) * on[SWING]
    none = np.float64(0.0)
    to_rest = (none, ju * on[CRUISE], TO_REST * leave, quarter)
    to_speed = (ju * on[HOLD], ju * on[CRUISE], none, quarter)
    to_push = (u * on[HOLD], u * on[CRUISE], TO_OTHER * leave, quarter)
    to_cruise = (none, none, TO_CRUISE * leave, quarter)
    to_swing = (begin * on[HOLD], begin * on[CRUISE], begin * on[MANOEUVRE], none)

    # Those that go on, and those that are born of all of them, mixed [BB].
    every = [replace(one, w=one.w * on[one.mode]) for one in old]
    inflow = 0.25 * sum12([one.w * to_swing[one.mode] for one in old])
    every[:SWINGS] = [replace(one, w=one.w + inflow) for one in every[:SWINGS]]
    rest = mixed(old, to_rest)
    every.append(Hypothesis(HOLD, rest.w, rest.x, none, none, rest.P00))
    jump = mixed(old, to_speed)
    every.append(Hypothesis(CRUISE, jump.w, jump.x, none, none, jump.P00, P11=V * V))
    push = mixed(old, to_push)
    every.append(replace(push, mode=MANOEUVRE, P22=A * A))
    every.append(replace(mixed(old, to_cruise), mode=CRUISE))

    # Predict each of the sixteen.
    Q = noise(dt, tau, R, A)
    number = [*range(SWING, SWING + SWINGS), *(one.mode for one in every[SWINGS:])]
    return [predicted(one, dt, Q[q]) for one, q in zip(every, number, strict=True)]


def _expected(ahead: list[Hypothesis], R: Any) -> tuple[Any, Any]:
    """The sample that all sixteen together expect, and its variance."""
    w = [one.w for one in ahead]
    x = sum16([a * one.x for a, one in zip(w, ahead, strict=True)])
    spread = [(one.x - x, one.P00 + R) for one in ahead]
    return x, sum16([a * (s + d * d) for a, (d, s) in zip(w, spread, strict=True)])


def _most_probable(weights: list[Any]) -> list[int]:
    """The swings and the eight others that weigh most [TH]."""
    ranked = np.argsort(-np.array(weights[SWINGS:]), kind="stable")[:HYPOTHESES]
    return [*range(SWINGS), *(SWINGS + int(i) for i in ranked)]


def carried_on(state: AdaptiveState, inputs: AdaptiveInputs) -> AdaptiveState:
    """Δt later without a measurement: the most probable of the sixteen, as they are predicted."""
    real = np.float64
    R, V, A = real(inputs.r_x), real(inputs.top_speed), real(inputs.top_acceleration)
    ahead = _sixteen(state.hypotheses, real(inputs.dt), R, V, A)
    weights = [one.w for one in ahead]
    order = _most_probable(weights)
    total = sum12([weights[i] for i in order])
    kept = [replace(ahead[i], w=weights[i] / total) for i in order]
    nothing = [real(0.0)] * KEPT
    after = _estimate(kept, nothing, nothing)
    return replace(after, rejections=state.rejections, y_res=real(0.0), S=_expected(ahead, R)[1])


def _start(z: Any, R: Any, V: Any, A: Any) -> AdaptiveState:
    """At the measurement, at rest or not: four modes, none preferred."""
    none, quarter = np.float64(0.0), np.float64(0.25)
    swings = (Hypothesis(SWING, 0.25 * quarter, z, none, none, R, P11=V * V, P22=A * A),) * SWINGS
    first = (
        Hypothesis(HOLD, quarter, z, none, none, R),
        Hypothesis(CRUISE, quarter, z, none, none, R, P11=V * V),
        Hypothesis(MANOEUVRE, quarter, z, none, none, R, P11=V * V, P22=A * A),
    )
    spare = (Hypothesis(HOLD, none, z, none, none, R),) * (HYPOTHESES - len(first))
    nothing = [none] * KEPT
    return replace(_estimate([*swings, *first, *spare], nothing, nothing), S=R)


def _estimate(kept: list[Hypothesis], K0: list[Any], K1: list[Any]) -> AdaptiveState:
    """Means over the hypotheses [BLK 11.6.6]."""
    w = [one.w for one in kept]
    x = sum12([one.w * one.x for one in kept])
    v = sum12([one.w * one.v for one in kept])
    from_mean = [(one, one.x - x, one.v - v) for one in kept]
    none = np.float64(0.0)
    return AdaptiveState(
        init=True,
        hypotheses=tuple(kept),
        y=x,
        y_dot=v,
        y_ddot=sum12([one.w * one.a for one in kept]),
        K0=sum12([a * b for a, b in zip(w, K0, strict=True)]),
        K1=sum12([a * b for a, b in zip(w, K1, strict=True)]),
        P00=sum12([one.w * (one.P00 + dx * dx) for one, dx, _ in from_mean]),
        P01=sum12([one.w * (one.P01 + dx * dv) for one, dx, dv in from_mean]),
        P11=sum12([one.w * (one.P11 + dv * dv) for one, _, dv in from_mean]),
        hold=sum12([one.w if one.mode == HOLD else none for one in kept]),
        cruise=sum12([one.w if one.mode == CRUISE else none for one in kept]),
        manoeuvre=sum12([one.w if one.mode >= MANOEUVRE else none for one in kept]),
    )
