"""The paper's case study: the discrete hybrid Van der Pol oscillator, as a model, as a plant, and beside its filter.

Equation numbers as in `kernel.reference.ducekf`.

| letter | meaning | variable | equation |
|---|---|---|---|
| x(1), x(2) | position, velocity | x1, x2 | (13) |
| α, μ, ρ | damping, frequency, radius of the oscillator | alpha, mu, rho | (13) |
| κ | restitution | kappa | (15) |
| A | Jacobian of f | jacobian | (27) |
| V | eᵀPe, the Lyapunov function | | (21) |
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal

from softplc.kernel.reference.covariance import Matrix
from softplc.kernel.reference.ducekf import (
    Band,
    DucekfInputs,
    DucekfState,
    DucekfTuning,
    Vector,
    ducekf,
    ducekf_start,
    in_band,
)
from softplc.kernel.result import Result

StepRule = Literal["euler", "semi_implicit", "rk4"]
Judged = Literal["carried", "same"]


@dataclass(frozen=True, slots=True)
class Dhvpo:
    """The oscillator of (12) with its constraint x(1) ≥ 0. All parameters above zero."""

    alpha: float = 1.0
    mu: float = 1.0
    rho: float = 1.5
    kappa: float = 0.5

    def f(self, x1: float, x2: float, dt: float) -> Vector:
        """Explicit Euler, (13)."""
        return (x1 + x2 * dt, x2 + self.acceleration(x1, x2) * dt)

    def acceleration(self, x1: float, x2: float) -> float:
        """−α(x1² + x2²/μ² − ρ²)x2 − μ²x1, (13)."""
        mu2 = self.mu * self.mu
        return -self.alpha * ((x1 * x1 + x2 * x2 / mu2) - self.rho * self.rho) * x2 - mu2 * x1

    def jacobian(self, x1: float, x2: float, dt: float) -> Matrix:
        """(27)."""
        mu2 = self.mu * self.mu
        a10 = (-2.0 * self.alpha * x1 * x2 - mu2) * dt
        a11 = (
            1.0
            + (-self.alpha * (x1 * x1) - 3.0 * self.alpha * (x2 * x2) / mu2 + self.alpha * (self.rho * self.rho)) * dt
        )
        return (1.0, dt, a10, a11)

    def surface(self, x1: float) -> tuple[float, float]:
        """The surface is at 0, the oscillator above it."""
        return 0.0, 1.0

    def advance(self, x1: float, x2: float, dt: float, rule: StepRule) -> Vector:
        """The smooth branch under another step rule than the paper's: where its impacts would fall instead."""
        if rule == "euler":
            return self.f(x1, x2, dt)
        if rule == "semi_implicit":
            x2 = x2 + self.acceleration(x1, x2) * dt
            return x1 + x2 * dt, x2
        half = dt / 2.0
        p1, v1 = x2, self.acceleration(x1, x2)
        p2, v2 = x2 + half * v1, self.acceleration(x1 + half * p1, x2 + half * v1)
        p3, v3 = x2 + half * v2, self.acceleration(x1 + half * p2, x2 + half * v2)
        p4, v4 = x2 + dt * v3, self.acceleration(x1 + dt * p3, x2 + dt * v3)
        sixth = dt / 6.0
        return x1 + sixth * (p1 + 2.0 * p2 + 2.0 * p3 + p4), x2 + sixth * (v1 + 2.0 * v2 + 2.0 * v3 + v4)


@dataclass(frozen=True, slots=True)
class PlantState:
    """The oscillator between scans; `before` is the position before `x1`, NaN at the start."""

    x1: float
    x2: float
    before: float = math.nan


@dataclass(frozen=True, slots=True)
class PlantRule:
    """How the plant steps and recognises its impact. The defaults are the reading that gives the paper's k = 315.

    `edge`: the activation set (0, ε0] or [−ε0, 0). `judged`: the state carried into the iteration, whose step the
    transition then replaces; or the new sample, to which it is applied in the same iteration. `direction`: the
    position must have come nearer (unknown in the first iteration), the velocity must, or neither is asked.
    """

    band: float = 0.02
    edge: Band = "above"
    step: StepRule = "euler"
    judged: Judged = "carried"
    direction: Literal["position", "velocity", "none"] = "position"


def plant_step(
    model: Dhvpo, rule: PlantRule, state: PlantState, dt: float, noise: Vector = (0.0, 0.0)
) -> tuple[PlantState, bool]:
    """One iteration of (12): the state after it, and whether it was the transition (15)."""
    if rule.judged == "carried":
        if _touches(rule, state):
            return PlantState(state.x1, -model.kappa * state.x2, state.x1), True
        x1, x2 = model.advance(state.x1, state.x2, dt, rule.step)
        return PlantState(x1 + noise[0], x2 + noise[1], state.x1), False
    x1, x2 = model.advance(state.x1, state.x2, dt, rule.step)
    after = PlantState(x1 + noise[0], x2 + noise[1], state.x1)
    if _touches(rule, after):
        return PlantState(after.x1, -model.kappa * after.x2, after.x1), True
    return after, False


def _touches(rule: PlantRule, state: PlantState) -> bool:
    """Steps 10 and 13: in the activation set, and coming nearer."""
    falling = {"position": state.x1 < state.before, "velocity": state.x2 < 0.0, "none": True}[rule.direction]
    return in_band(state.x1, rule.band, rule.edge) and falling


TABLE_1: Final = DucekfTuning(q_x=0.001, q_x_dot=0.001, r_x=0.0001, band=0.02)
"""Q, R and ε0 of Table 1."""


@dataclass(frozen=True, slots=True)
class Scan:
    """Iteration k of oscillator and filter: x, x̂, P after it, the routes taken, and V before and after an impact."""

    k: int
    x: Vector
    x_hat: Vector
    P: Matrix
    routes: tuple[int, ...]
    result: Result
    delta_v: float

    @property
    def impact(self) -> bool:
        """The transition took place."""
        return self.result == Result.IMPACT

    @property
    def held(self) -> bool:
        """The estimate waited at the surface."""
        return self.result == Result.HELD


def run(
    iterations: int,
    model: Dhvpo = Dhvpo(),
    tuning: DucekfTuning = TABLE_1,
    rule: PlantRule = PlantRule(),
    *,
    dt: float = 0.01,
    x0: Vector = (0.0, 1.5),
    x0_hat: Vector = (0.0, 1.8),
    P0: Matrix = (0.2, 0.0, 0.0, 0.2),
    noise: Callable[[], tuple[float, float, float]] = lambda: (0.0, 0.0, 0.0),
) -> list[Scan]:
    """The main algorithm, steps 9 to 19, for k = 1 … iterations; the defaults are Table 1.

    The plant's contact triggers both transitions. `noise` is drawn once in each iteration: w(1), w(2), v.
    `delta_v` is V(e_i) − V(e_{i−1}) of (21) with the true error at an impact, otherwise 0.
    """
    plant = PlantState(*x0)
    state = ducekf_start(*x0_hat, P0, x0[0])
    scans = []
    for k in range(1, iterations + 1):
        w1, w2, v = noise()
        plant_before, before = plant, state
        plant, contact = plant_step(model, rule, plant, dt, (w1, w2))
        state, result = ducekf(model, tuning, state, DucekfInputs(True, plant.x1 + v, dt, float(contact)))
        delta_v = 0.0
        if result == Result.IMPACT:
            delta_v = _lyapunov(plant, state) - _lyapunov(plant_before, before)
        scans.append(Scan(k, (plant.x1, plant.x2), (state.x1, state.x2), state.P, state.routes, result, delta_v))
    return scans


def _lyapunov(plant: PlantState, state: DucekfState) -> float:
    """V = eᵀPe, (21)."""
    e1, e2 = plant.x1 - state.x1, plant.x2 - state.x2
    P00, P01, P10, P11 = state.P
    return e1 * (P00 * e1 + P01 * e2) + e2 * (P10 * e1 + P11 * e2)
