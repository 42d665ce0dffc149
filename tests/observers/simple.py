"""The observers that need no more than a position and its time, each with two or three different tunings."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from softplc.kernel.reference.alpha_beta import AlphaBetaInputs, AlphaBetaState, alpha_beta_lreal, alpha_beta_real
from softplc.kernel.reference.cv_accel import CvAccelInputs, CvAccelState, cv_accel
from softplc.kernel.reference.derivative import DerivativeInputs, DerivativeState, derivative_lreal, derivative_real
from softplc.kernel.reference.finite_difference import (
    FiniteDifferenceInputs,
    FiniteDifferenceState,
    finite_difference,
)
from softplc.kernel.reference.moving_average import MovingAverageInputs, MovingAverageState, moving_average
from softplc.kernel.reference.one_euro import OneEuroInputs, OneEuroState, one_euro
from softplc.observers.alpha_beta import AlphaBetaConfig
from softplc.observers.cv_accel import CvAccelConfig
from softplc.observers.derivative import DerivativeConfig
from softplc.observers.finite_difference import FiniteDifferenceConfig
from softplc.observers.moving_average import MovingAverageConfig
from softplc.observers.one_euro import OneEuroConfig


@dataclass(frozen=True)
class Case:
    """Configurations that one observer steps, the reference they stand for, and how to write its inputs.

    `leaves`: published leaf → variable of the reference's state, beside Position and Velocity.
    `exact`: a ramp's velocity is read without error once settled, whatever the steps.
    """

    name: str
    configs: tuple[Any, ...]
    reference: Callable[[Any, Any], Any]
    state: Callable[[], Any]
    inputs: Callable[[Any, float, float], Any]
    leaves: dict[str, str]
    exact: bool = True


def _moving_average(config: MovingAverageConfig, z: float, dt: float) -> MovingAverageInputs:
    return MovingAverageInputs(True, z, dt, config.window)


def _derivative(config: DerivativeConfig, z: float, dt: float) -> DerivativeInputs:
    return DerivativeInputs(True, z, dt, (config.cycle_ms or 0.0) / 1000.0, config.dt_mode == "measured")


def _fixed(config: AlphaBetaConfig, z: float, dt: float) -> AlphaBetaInputs:
    alpha = config.alpha or 0.0
    return AlphaBetaInputs(True, z, dt, alpha=alpha, beta=config.beta or alpha * alpha / (2.0 - alpha))


def _indexed(config: AlphaBetaConfig, z: float, dt: float) -> AlphaBetaInputs:
    return AlphaBetaInputs(True, z, dt, True, sigma_w=config.sigma_w or 0.0, sigma_v=config.sigma_v or 0.0)


def _one_euro(config: OneEuroConfig, z: float, dt: float) -> OneEuroInputs:
    return OneEuroInputs(
        True, z, dt, config.min_cutoff, config.beta, config.d_cutoff, config.difference == "filtered"
    )


def _cv_accel(config: CvAccelConfig, z: float, dt: float) -> CvAccelInputs:
    white = config.q_mode == "white_jerk"
    return CvAccelInputs(
        True, z, dt, config.r_x, config.q_x, config.q_x_dot, config.q_x_ddot, white, config.q_jerk or 0.0
    )


_GAINS = {"Innovation": "y_res", "K0": "K0", "K1": "K1"}
_COVARIANCES = {leaf: leaf for leaf in ("S", "K2", "P00", "P01", "P02", "P11", "P12", "P22")}
_KALMAN = {"Acceleration": "x_ddot_pred", **_GAINS, **_COVARIANCES}

CASES = (
    Case(
        "finite_difference",
        (FiniteDifferenceConfig(type="finite_difference"),) * 2,
        finite_difference,
        FiniteDifferenceState,
        lambda _, z, dt: FiniteDifferenceInputs(True, z, dt),
        {},
    ),
    Case(
        "moving_average",
        tuple(MovingAverageConfig(type="moving_average", window=n) for n in (8, 2, 11)),
        moving_average,
        MovingAverageState,
        _moving_average,
        {},
    ),
    Case(
        "derivative nominal",
        tuple(DerivativeConfig(type="derivative", cycle_ms=ms) for ms in (50.0, 60.0)),
        derivative_lreal,
        DerivativeState,
        _derivative,
        {},
        exact=False,
    ),
    Case(
        "derivative measured in REAL",
        (DerivativeConfig(type="derivative", dt_mode="measured", precision="real"),) * 2,
        derivative_real,
        DerivativeState,
        _derivative,
        {},
        exact=False,  # single precision
    ),
    Case(
        "derivative measured",
        (DerivativeConfig(type="derivative", dt_mode="measured"),) * 2,
        derivative_lreal,
        DerivativeState,
        _derivative,
        {},
    ),
    Case(
        "alpha_beta fixed",
        (
            AlphaBetaConfig(type="alpha_beta", alpha=0.4),
            AlphaBetaConfig(type="alpha_beta", alpha=0.5, beta=0.3),
        ),
        alpha_beta_lreal,
        AlphaBetaState,
        _fixed,
        _GAINS,
    ),
    Case(
        "alpha_beta indexed",
        tuple(AlphaBetaConfig(type="alpha_beta", sigma_w=w, sigma_v=1.2) for w in (200.0, 60.0)),
        alpha_beta_lreal,
        AlphaBetaState,
        _indexed,
        {**_GAINS, "S": "S"},
    ),
    Case(
        "alpha_beta indexed in REAL",
        tuple(AlphaBetaConfig(type="alpha_beta", precision="real", sigma_w=w, sigma_v=1.2) for w in (200.0, 60.0)),
        alpha_beta_real,
        AlphaBetaState,
        _indexed,
        {**_GAINS, "S": "S"},
        exact=False,  # single precision
    ),
    Case(
        "one_euro",
        (
            OneEuroConfig(type="one_euro", beta=0.1),
            OneEuroConfig(type="one_euro", min_cutoff=2.0, beta=0.5, d_cutoff=3.0),
        ),
        one_euro,
        OneEuroState,
        _one_euro,
        {"Cutoff": "cutoff"},
    ),
    Case(
        "one_euro as in the paper",
        (OneEuroConfig(type="one_euro", beta=0.1, difference="filtered"),) * 2,
        one_euro,
        OneEuroState,
        _one_euro,
        {"Cutoff": "cutoff"},
        exact=False,
    ),
    Case(
        "cv_accel per scan",
        (
            CvAccelConfig(type="cv_accel", q_x_ddot=10.0, r_x=4 / 3),
            CvAccelConfig(type="cv_accel", q_x=0.0, q_x_dot=1.0, q_x_ddot=30.0, r_x=0.3),
        ),
        cv_accel,
        CvAccelState,
        _cv_accel,
        _KALMAN,
    ),
    Case(
        "cv_accel white jerk",
        tuple(CvAccelConfig(type="cv_accel", q_mode="white_jerk", q_jerk=q, r_x=4 / 3) for q in (1e4, 1e5)),
        cv_accel,
        CvAccelState,
        _cv_accel,
        _KALMAN,
    ),
)
NAMES = [case.name for case in CASES]
