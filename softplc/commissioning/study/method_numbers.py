"""The investigation's method table in numbers: each method set on one realisation of the noise, scored on others."""

from dataclasses import dataclass

import numpy as np

from softplc.commissioning.study.methods import METHODS, Method, Setting, run_method
from softplc.commissioning.study.waveform import DT, SCANS, SLOPE, Numbers, Waveform, both, ramp_hold

SCORED = 20  # realisations


@dataclass(frozen=True, slots=True)
class Score:
    """Means over the scored realisations. `lag` is how late the position is on a ramp, in s.

    `stop` is how long the velocity takes to fall below a tenth after a stop, in s, without noise. Noise is the
    standard deviation in the settled holds, `overshoot` how far the position goes beyond where the axis stopped.
    """

    rmse_position: float
    rmse_velocity: float
    lag: float
    stop: float
    noise_position: float
    noise_velocity: float
    overshoot: float


@dataclass(frozen=True, slots=True)
class MethodNumbers:
    """One method: `swept` has RMSE of position and velocity for every setting weighed, on the realisation shown."""

    method: Method
    setting: Setting
    score: Score
    swept: Numbers
    position: Numbers
    velocity: Numbers


def compare(seed: int) -> list[MethodNumbers]:
    """All methods; the realisation with this seed sets them, the `SCORED` next ones score them."""
    shown = ramp_hold(seed)
    others = np.array([ramp_hold(seed + 1 + index).measured for index in range(SCORED)])
    return [_one(method, shown, others) for method in METHODS]


def _one(method: Method, shown: Waveform, others: Numbers) -> MethodNumbers:
    position, velocity = run_method(method, method.settings, shown.measured[None, :])
    swept = np.array([_rms(position[:, 0] - shown.position), _rms(velocity[:, 0] - shown.velocity)])
    best = int(np.argmin(np.log(swept).sum(axis=0)))
    setting = method.settings[best]
    scored = run_method(method, [setting], others)
    quiet = run_method(method, [setting], shown.position[None, :])[1][0, 0]
    score = _score(shown, scored[0][0], scored[1][0], _stop(quiet))
    return MethodNumbers(method, setting, score, swept, position[best, 0], velocity[best, 0])


def _rms(error: Numbers) -> Numbers:
    """Over the last axis, the scans."""
    return np.asarray(np.sqrt(np.mean(error * error, axis=-1)))


def _stop(velocity: Numbers) -> float:
    """Seconds from the first stop until the velocity is below a tenth of what it was."""
    late = np.flatnonzero(velocity[SCANS : 2 * SCANS] >= 0.1 * SLOPE)
    return float(late[-1] + 1) * DT if len(late) else 0.0


def _score(truth: Waveform, position: Numbers, velocity: Numbers, stop: float) -> Score:
    """Position and velocity are arrays[realisations, scans]; the truth is the same for all."""
    error = position - truth.position
    ramps, holds = both(0, 2), both(1, 3)
    return Score(
        rmse_position=float(_rms(error).mean()),
        rmse_velocity=float(_rms(velocity - truth.velocity).mean()),
        lag=float(-error[:, ramps].mean() / SLOPE),
        stop=stop,
        noise_position=float(error[:, holds].std()),
        noise_velocity=float(velocity[:, holds].std()),
        overshoot=float(np.mean([error[:, start : start + SCANS].max(axis=1) for start in (SCANS, 3 * SCANS)])),
    )
