"""DUCEKF: the extended Kalman filter of two states with a unilateral constraint, one scan at a time.

Equation numbers are those of L. Herrera, R. Méndez-Ramírez, "Discrete Unilateral Constrained Extended Kalman Filter
in an Embedded System", Sensors 25(15), 4636 (2025); steps and routes are those of its Appendix A. u is the unit of
the position.

| letter | meaning | variable | tag | unit | equation |
|---|---|---|---|---|---|
| y | measured position | x | Raw | u | (2), (14) |
| ΔT | time step | dt | Dt | s | (13) |
| x̂(1) | position estimate | x1, y | Position | u | (3), (6), (17) |
| x̂(2) | velocity estimate | x2, y_dot | Velocity | u/s | (3), (6), (17) |
| P | covariance, row-major P00, P01, P10, P11 | P | P00, P01, P11 | u², u²/s, (u/s)² | (4), (7), (18) |
| A | Jacobian of f | model.jacobian | | 1, s, 1/s, 1 | (8), (27) |
| Q | process noise per scan, diagonal | q_x, q_x_dot | q_x, q_x_dot | u², (u/s)² | (4) |
| R | measurement noise variance | r_x | r_x | u² | (5) |
| y − Cx̂ | innovation | y_res | Innovation | u | (6) |
| CPC + R | innovation variance | S | S | u² | (5) |
| K | gain | K0, K1 | K0, K1 | 1, 1/s | (5) |
| F | distance to the constraint surface | gap | | u | (10), (16) |
| ε0 | width of the activation set | band | Band | u | (10) |
| κ | restitution | model.kappa | Restitution | 1 | (15) |
| Ã | Jacobian of the transition μ, diagonal | m0, m1 | | 1 | (23), (30) |
| Ω | covariance gain, taken elementwise | d0, d1: Ω = ddᵀ | | 1 | (18), (28) |

The model gives f, A, and the surface; the output is the position, C = [1 0]. Arithmetic is double precision.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal, Protocol

from softplc.kernel.reference.covariance import ImpactCovariance, Matrix, impact_covariance, propagate
from softplc.kernel.result import Result

Vector = tuple[float, float]

ContactFrom = Literal["tag", "position", "either"]
Band = Literal["above", "below"]
ImpactScan = Literal["replace", "within"]


class Model(Protocol):
    """x⁺ = f(x, Δt) of position and velocity with a unilateral constraint on the position."""

    @property
    def kappa(self) -> float:
        """Restitution: an impact turns the velocity v into −κv, (15)."""
        ...

    def f(self, x1: float, x2: float, dt: float) -> Vector:
        """The smooth branch, one step of `dt` seconds, (1)."""
        ...

    def jacobian(self, x1: float, x2: float, dt: float) -> Matrix:
        """∂f/∂x at (x1, x2), row-major, (8)."""
        ...

    def surface(self, x1: float) -> tuple[float, float]:
        """Position of the surface that is nearest to `x1`, and its side: the gap F(x) is side·(x − limit)."""
        ...


@dataclass(frozen=True, slots=True)
class DucekfTuning:
    """Noise, constraint and initial variances. Lengths in u, times in seconds.

    `covariance`: what an impact does to P: Ω∘P of the paper, ÃPÃᵀ (saltation), or nothing (the paper's EKF).
    `contact_from`: the system's contact is a tag, is judged from its measured position, or either.
    `impact_scan`: the transition takes the place of predict and update (the paper), or lies within the prediction.
    `edge`: the activation set, (0, ε0] above the surface or [−ε0, 0) below it.
    `hysteresis`: beyond ε0 + hysteresis the position may report the next contact. `threshold`: a contact tag above it
    touches. `hold_limit`: the longest wait for the system's contact, after which the filter starts anew.
    """

    q_x: float
    q_x_dot: float
    r_x: float
    band: float
    covariance: ImpactCovariance = "omega"
    contact_from: ContactFrom = "tag"
    impact_scan: ImpactScan = "replace"
    edge: Band = "above"
    hysteresis: float = 0.0
    threshold: float = 0.5
    hold_limit: float = math.inf
    p_x: float = 1.0
    p_x_dot: float = 10.0


@dataclass(frozen=True, slots=True)
class DucekfInputs:
    """Inputs of one scan: `x` the measured position in u, `dt` in seconds, `contact` a tag's value or NaN."""

    EnableIn: bool
    x: float
    dt: float
    contact: float = math.nan


@dataclass(frozen=True, slots=True)
class DucekfState:
    """What the filter keeps between scans; zero before the first, positions not yet known are NaN.

    `s1`, `s0`: the system's measured position of the last scan and of the one before. `armed`: the position may
    report a contact. `touching`: the contact is closed. `wait`: seconds that a hold may still last, NaN while there
    is none. `routes`: the routes of Appendix A that the last scan took.
    """

    init: bool = False
    x1: float = 0.0
    x2: float = 0.0
    P: Matrix = (0.0, 0.0, 0.0, 0.0)
    K0: float = 0.0
    K1: float = 0.0
    S: float = 0.0
    y_res: float = 0.0
    s0: float = math.nan
    s1: float = math.nan
    armed: bool = False
    touching: bool = False
    wait: float = math.nan
    impacts: int = 0
    routes: tuple[int, ...] = ()
    y: float = 0.0
    y_dot: float = 0.0


def ducekf_start(x1: float, x2: float, P: Matrix, position: float = math.nan) -> DucekfState:
    """The state that starts at a given estimate, as Table 1 does; `position` is the system's, if it is known."""
    return DucekfState(init=True, x1=x1, x2=x2, P=P, s1=position, y=x1, y_dot=x2)


def in_band(gap: float, band: float, edge: Band) -> bool:
    """Whether a gap lies in the activation set ε of (10): (0, ε0], or [−ε0, 0)."""
    if edge == "above":
        return 0.0 < gap <= band
    return -band <= gap < 0.0


def ducekf(  # noqa: PLR0911  # one for each outcome
    model: Model, tuning: DucekfTuning, state: DucekfState, inputs: DucekfInputs
) -> tuple[DucekfState, Result]:
    """One scan: the state after it, and what happened. The model's parameters are finite numbers."""
    x, dt = inputs.x, inputs.dt
    if not inputs.EnableIn:
        return replace(state, init=False, y=x, y_dot=0.0, routes=()), Result.DISABLED
    if not dt > 0.0:
        return replace(state, y=x, y_dot=0.0, routes=()), Result.DT_INVALID
    if not state.init:
        return _initialise(model, tuning, state, inputs), Result.INITIALISED

    x1, x2 = model.f(state.x1, state.x2, dt)  # (3)
    judged = _judge(model, tuning, state, inputs, x1, x2)
    after = replace(state, s0=state.s1, s1=x, armed=judged.armed, touching=judged.touching, wait=math.nan)
    first = 1 if math.isnan(state.s0) else 2  # step 10: whether there is a position before the carried one

    if judged.contact and tuning.impact_scan == "replace":
        # (17) and (18): constant position, reversed velocity; predict and update do not take place.
        P = impact_covariance(state.P, tuning.covariance, 1.0, -model.kappa)
        x2 = -model.kappa * state.x2
        after = replace(after, impacts=state.impacts + 1, routes=(first, 3))
        return _without_update(after, tuning, state.x1, x2, P), Result.IMPACT

    if judged.hold:
        # The estimate stays where it is, and P with it, until the system's contact, or until that is overdue.
        wait = (judged.longest if math.isnan(state.wait) else state.wait) - dt
        if wait < 0.0:
            return _initialise(model, tuning, state, inputs), Result.INITIALISED
        after = replace(after, wait=wait, routes=(first, 4, 5))
        return _without_update(after, tuning, state.x1, state.x2, state.P), Result.HELD

    P = propagate(model.jacobian(state.x1, state.x2, dt), state.P)  # (4) without Q
    if judged.contact:
        # Within the prediction: what lies beyond the surface is folded back by κ.
        m0, m1 = 1.0, -model.kappa
        if judged.gap <= 0.0:
            m0 = -model.kappa
            x1 = judged.limit + m0 * (x1 - judged.limit)
        x2 = m1 * x2
        P = impact_covariance(P, tuning.covariance, m0, m1)
        after = replace(after, impacts=state.impacts + 1)
    P = (P[0] + tuning.q_x, P[1], P[2], P[3] + tuning.q_x_dot)
    after = replace(after, routes=(first, 3 if judged.contact else 4, 6))
    return _update(after, tuning, x1, x2, P, Result.IMPACT if judged.contact else Result.UPDATED)


@dataclass(frozen=True, slots=True)
class _Judged:
    """What a scan is: the surface, the estimate's gap to it, and whether this is an impact or a hold."""

    limit: float
    gap: float
    contact: bool
    hold: bool
    longest: float
    armed: bool
    touching: bool


def _judge(
    model: Model, tuning: DucekfTuning, state: DucekfState, inputs: DucekfInputs, x1: float, x2: float
) -> _Judged:
    """Steps 13 and 17: has the system touched the surface, and has the estimate been there first?"""
    replaces = tuning.impact_scan == "replace"
    x = inputs.x
    if replaces:  # the state that is carried into this scan
        x1, x2 = state.x1, state.x2
    limit, side = model.surface(x1)
    gap, gap_z = side * (x1 - limit), side * (x - limit)
    approaching = side * x2 < 0.0

    use_tag, use_position = tuning.contact_from != "position", tuning.contact_from != "tag"

    # By the tag: its rising edge. NaN says nothing.
    known = use_tag and not math.isnan(inputs.contact)
    closed = known and inputs.contact > tuning.threshold
    by_tag = closed and not state.touching
    touching = closed if known else (gap_z <= tuning.band if use_position else state.touching)

    # By the position.
    longest = tuning.hold_limit
    if replaces:
        # The position carried into this scan is in the activation set, and it came nearer (not, while the one before
        # is not known).
        closing = side * (state.s1 - state.s0) < 0.0
        by_position = in_band(side * (state.s1 - limit), tuning.band, tuning.edge) and closing
        at_surface = gap <= tuning.band if tuning.edge == "above" else gap < 0.0
    else:
        # The prediction crosses the surface, and the sample is as near as the way of one scan allows: the band is
        # widened by |v|Δt, so that no impact is lost between two samples.
        travel = -(side * x2) * inputs.dt
        widened = tuning.band + travel * max(1.0, model.kappa)
        by_position = gap <= 0.0 and gap_z <= widened
        waiting = not math.isnan(state.wait)
        at_surface = gap <= 0.0 and (gap_z > tuning.band or waiting)
        if at_surface and approaching:  # twice the time that the system needs at this speed
            longest = min(longest, 2.0 * gap_z / abs(x2))
    by_position = use_position and by_position and state.armed

    contact = by_tag or by_position
    if not replaces:
        contact = contact and approaching  # an estimate that already leaves the surface has had its transition
    awaited = (known and not closed) or (use_position and state.armed)
    hold = at_surface and approaching and awaited and not contact
    armed = (state.armed or gap_z > tuning.band + tuning.hysteresis) and not contact
    return _Judged(limit, gap, contact, hold, longest, armed, touching)


def _initialise(model: Model, tuning: DucekfTuning, state: DucekfState, inputs: DucekfInputs) -> DucekfState:
    """Start at the measurement, at rest."""
    limit, side = model.surface(inputs.x)
    return DucekfState(
        init=True,
        x1=inputs.x,
        P=(tuning.p_x, 0.0, 0.0, tuning.p_x_dot),
        S=tuning.p_x + tuning.r_x,
        s1=inputs.x,
        armed=side * (inputs.x - limit) > tuning.band + tuning.hysteresis,
        touching=inputs.contact > tuning.threshold,
        impacts=state.impacts,
        y=inputs.x,
    )


def _update(
    state: DucekfState, tuning: DucekfTuning, x1: float, x2: float, P: Matrix, result: Result
) -> tuple[DucekfState, Result]:
    """Correct a prediction by the measurement, (5) to (7); P10 stays a copy of P01."""
    P00, P01, P10, P11 = P
    y_res = state.s1 - x1
    S = P00 + tuning.r_x
    if not S > 0.0:
        return replace(state, x1=x1, x2=x2, S=S, y_res=y_res, y=x1, y_dot=x2), Result.S_NOT_POSITIVE
    K0 = P00 / S
    K1 = P10 / S
    x1 = x1 + K0 * y_res
    x2 = x2 + K1 * y_res
    c01 = (1.0 - K0) * P01
    P = ((1.0 - K0) * P00, c01, c01, P11 - K1 * P01)
    return replace(state, x1=x1, x2=x2, P=P, K0=K0, K1=K1, S=S, y_res=y_res, y=x1, y_dot=x2), result


def _without_update(state: DucekfState, tuning: DucekfTuning, x1: float, x2: float, P: Matrix) -> DucekfState:
    """The sample did not enter: gains are zero, the innovation is what it deviates by."""
    y_res, S = state.s1 - x1, P[0] + tuning.r_x
    return replace(state, x1=x1, x2=x2, P=P, K0=0.0, K1=0.0, S=S, y_res=y_res, y=x1, y_dot=x2)
