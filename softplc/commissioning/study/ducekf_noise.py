"""What the covariance after an impact is worth when there is noise: a Monte Carlo run on the oscillator."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from softplc.kernel.reference.covariance import ImpactCovariance
from softplc.kernel.reference.dhvpo import TABLE_1, Dhvpo, PlantRule, PlantState, plant_step
from softplc.kernel.reference.ducekf import DucekfInputs, DucekfState, ducekf, ducekf_start

KAPPAS = (0.5, 1.5)
COVARIANCES: tuple[ImpactCovariance, ...] = ("omega", "none", "saltation")
Q, R = 1e-5, 1e-4  # true of the plant, and told to the filter
SCANS = 20  # after the impact
_RULE, _DT = PlantRule(direction="velocity"), 0.01  # (12): noise would turn the direction of a position
_LATEST = 400


@dataclass(frozen=True, slots=True)
class Consistency:
    """eᵀP⁻¹e averaged over the scans after the first impact, ideally 2, with its standard error; velocity RMSE."""

    kappa: float
    covariance: ImpactCovariance
    nees: float
    nees_error: float
    rmse_velocity: float


def consistency(seed: int, runs: int) -> list[Consistency]:
    """The same noise for each κ and covariance; runs whose noise carries it over the band are left out."""
    tuning = replace(TABLE_1, q_x=Q, q_x_dot=Q, r_x=R)
    found: dict[tuple[float, ImpactCovariance], list[tuple[float, float]]] = {
        (kappa, covariance): [] for kappa in KAPPAS for covariance in COVARIANCES
    }
    for run in range(runs):
        noise = _noise(np.random.default_rng((seed, run)))
        plant, state = PlantState(0.0, 1.5), ducekf_start(0.0, 1.8, (0.2, 0.0, 0.0, 0.2), 0.0)
        for k in range(_LATEST):
            w1, w2, v = noise[k]
            after, contact = plant_step(Dhvpo(), _RULE, plant, _DT, (w1, w2))
            if contact:  # up to here κ and the covariance rule have had no part
                for (kappa, covariance), values in found.items():
                    values.append(_after_impact(kappa, covariance, plant, state, noise[k : k + SCANS]))
                break
            plant = after
            state, _ = ducekf(Dhvpo(), tuning, state, DucekfInputs(True, plant.x1 + v, _DT, 0.0))
    return [_summary(kappa, covariance, values) for (kappa, covariance), values in found.items()]


def _noise(rng: np.random.Generator) -> NDArray[np.float64]:
    """w(1), w(2) and v of every iteration."""
    return rng.normal(size=(_LATEST + SCANS, 3)) * np.sqrt([Q, Q, R])


def _after_impact(
    kappa: float, covariance: ImpactCovariance, plant: PlantState, state: DucekfState, noise: NDArray[np.float64]
) -> tuple[float, float]:
    """Mean eᵀP⁻¹e and mean square of the velocity error, from the impact on."""
    model = Dhvpo(kappa=kappa)
    tuning = replace(TABLE_1, q_x=Q, q_x_dot=Q, r_x=R, covariance=covariance)
    nees = squares = 0.0
    for w1, w2, v in noise.tolist():
        plant, contact = plant_step(model, _RULE, plant, _DT, (w1, w2))
        state, _ = ducekf(model, tuning, state, DucekfInputs(True, plant.x1 + v, _DT, float(contact)))
        e1, e2 = plant.x1 - state.x1, plant.x2 - state.x2
        P00, P01, P10, P11 = state.P
        nees += (P11 * e1 * e1 - (P01 + P10) * e1 * e2 + P00 * e2 * e2) / (P00 * P11 - P01 * P10)
        squares += e2 * e2
    return nees / len(noise), squares / len(noise)


def _summary(kappa: float, covariance: ImpactCovariance, values: list[tuple[float, float]]) -> Consistency:
    nees, squares = np.array(values).T
    error = float(nees.std() / math.sqrt(len(nees)))
    return Consistency(kappa, covariance, float(nees.mean()), error, float(np.sqrt(squares.mean())))
