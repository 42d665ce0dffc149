"""Moving the origin of an observer's state: the same as measuring from another origin."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softplc.observers.adaptive import AdaptiveConfig
from softplc.observers.alpha_beta import AlphaBetaConfig
from softplc.observers.aoi import AoiConfig
from softplc.observers.axes import AxisSpec, ObserverModel
from softplc.observers.cv_accel import CvAccelConfig
from softplc.observers.derivative import DerivativeConfig
from softplc.observers.ducekf import DucekfConfig, DucekfKernel, EndStops
from softplc.observers.fb_kalman import FbKalmanConfig
from softplc.observers.finite_difference import FiniteDifferenceConfig
from softplc.observers.kernel import Given, Kernel
from softplc.observers.moving_average import MovingAverageConfig
from softplc.observers.one_euro import OneEuroConfig
from tests.observers.rig import make_rig

KALMAN = {"q_x": 0.01, "q_x_dot": 1.0, "r_x": 0.25}
CONFIGS: dict[str, ObserverModel] = {
    "aoi": AoiConfig(type="aoi", **KALMAN),
    "aoi with a gate and a reference": AoiConfig(
        type="aoi", **KALMAN, reference="first_sample", gate={"sigma": 50.0, "most_in_a_row": 3}
    ),
    "aoi with a fixed reference": AoiConfig(type="aoi", **KALMAN, reference=100.0),
    "fb_kalman": FbKalmanConfig(type="fb_kalman", variant="corrected", R=0.25),
    "fb_kalman as written": FbKalmanConfig(type="fb_kalman", R=0.25),
    "cv_accel": CvAccelConfig(type="cv_accel", r_x=0.25),
    "adaptive": AdaptiveConfig(type="adaptive", r_x=0.25, top_speed=100.0, top_acceleration=100.0),
    "alpha_beta": AlphaBetaConfig(type="alpha_beta", alpha=0.5),
    "one_euro": OneEuroConfig(type="one_euro", beta=0.1),
    "one_euro as in the paper": OneEuroConfig(type="one_euro", beta=0.1, difference="filtered"),
    "moving_average": MovingAverageConfig(type="moving_average", window=5),
    "finite_difference": FiniteDifferenceConfig(type="finite_difference"),
    "derivative": DerivativeConfig(type="derivative", dt_mode="measured"),
}
REAL = {
    "aoi": AoiConfig(type="aoi", precision="real", **KALMAN),
    "fb_kalman": FbKalmanConfig(type="fb_kalman", precision="real", variant="corrected", R=0.25),
    "alpha_beta": AlphaBetaConfig(type="alpha_beta", precision="real", alpha=0.5),
    "derivative": DerivativeConfig(type="derivative", precision="real", dt_mode="measured"),
}


def kernel_of(*configs: ObserverModel) -> Kernel:
    """The kernel that an observer of these configurations steps."""
    kernel: Kernel = make_rig(*((AxisSpec(f"A{i}"), one) for i, one in enumerate(configs))).observer._kernel  # type: ignore[attr-defined]
    return kernel


def run(kernel: Kernel, z: Sequence[Any], dt: Sequence[float], enabled: Sequence[Any]) -> None:
    n = len(z[0])
    for position, step, on in zip(z, dt, enabled, strict=True):
        rows = np.ones(n, np.bool_)
        kernel.step(Given(np.array(on), np.array(position), np.full(n, step), rows, np.full(n, np.nan)))


@st.composite
def motions(draw: st.DrawFn) -> tuple[Any, Any, Any, int, Any]:
    """Positions [scan, 3], steps, enables, when to shift, by what; noise as of a sensor, so that nothing is a tie."""
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    scans = draw(st.integers(2, 40))
    z = np.cumsum(random.normal(0.0, 1.0, (scans, 3)), axis=0) + random.uniform(-300.0, 300.0, 3)
    dt = random.uniform(0.01, 0.1, scans)
    enabled = random.random((scans, 3)) < draw(st.sampled_from([1.0, 0.9]))
    return z, dt, enabled, draw(st.integers(1, scans - 1)), random.choice([-720.0, -360.0, 0.0, 360.0, 6.283185], 3)


def assert_shift_commutes(config: ObserverModel, motion: Any, tolerance: float) -> None:
    z, dt, enabled, at, by = motion
    if getattr(config, "variant", "") == "as_written":
        enabled = np.ones_like(enabled)  # it starts at 0, wherever it is measured from
    plain, shifted = kernel_of(*[config] * 3), kernel_of(*[config] * 3)
    run(plain, z, dt, enabled)
    run(shifted, z[:at], dt[:at], enabled[:at])
    shifted.shift(by != 0.0, by)
    run(shifted, z[at:] + by, dt[at:], enabled[at:])
    for leaf, values in plain.estimates.items():
        moved = by if leaf == "Position" else 0.0
        approx = pytest.approx(values + moved, rel=tolerance, abs=tolerance)
        assert np.asarray(shifted.estimates[leaf]) == approx, leaf


@pytest.mark.parametrize("name", CONFIGS)
@given(motions())
@settings(max_examples=25, deadline=None)
def test_a_shifted_state_goes_on_as_if_it_had_been_measured_from_there(name: str, motion: Any):
    """1e-7: a rounding is 2e-16 · 1000 u, over 10 ms 2e-11 u/s; some hundreds of them, and their squares in S."""
    assert_shift_commutes(CONFIGS[name], motion, 1e-7)


@pytest.mark.parametrize("name", REAL)
@given(motions())
@settings(max_examples=15, deadline=None)
def test_so_does_one_in_single_precision(name: str, motion: Any):
    """A REAL has 6e-8 · 1000 u = 6e-5 u; over 10 ms that is 6e-3 u/s for each rounding, up to 40 of them in a row."""
    assert_shift_commutes(REAL[name], motion, 0.25)


@given(motions())
@settings(max_examples=25, deadline=None)
def test_a_filter_with_stops_goes_on_alike_when_its_stops_move_along(motion: Any):
    z, dt, enabled, at, by = motion
    stops = {"type": "end_stops", "lower": -250.0, "upper": 250.0, "restitution": 0.5}
    config = DucekfConfig(type="ducekf", r_x=0.25, contact_from="position", model=EndStops.model_validate(stops))
    plain, shifted = DucekfKernel([config] * 3), DucekfKernel([config] * 3)
    run(plain, z, dt, enabled)
    run(shifted, z[:at], dt[:at], enabled[:at])
    shifted.shift(by != 0.0, by)
    for leaf in ("lower", "upper"):
        getattr(shifted._model, leaf)[:] += by
    run(shifted, z[at:] + by, dt[at:], enabled[at:])
    for leaf, values in plain.estimates.items():
        moved = by if leaf == "Position" else 0.0
        assert np.asarray(shifted.estimates[leaf]) == pytest.approx(values + moved, rel=1e-7, abs=1e-7), leaf


def test_rows_that_are_not_shifted_keep_every_bit():
    for config in (*CONFIGS.values(), *REAL.values()):
        kernel, other = kernel_of(config, config), kernel_of(config, config)
        z = np.random.default_rng(1).normal(0.0, 1.0, (12, 2))
        for one in (kernel, other):
            run(one, z, [0.05] * 12, [[True, True]] * 12)
        kernel.shift(np.array([True, False]), np.array([360.0, 360.0]))
        for leaf, values in other.estimates.items():
            assert kernel.estimates[leaf][1] == values[1], (config.type, leaf)
