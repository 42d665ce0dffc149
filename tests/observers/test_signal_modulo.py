"""Rotary axes: Position within a turn, a velocity that knows no wrap, and no precision lost with turns."""

import math

import numpy as np
import pytest

from softplc.observers.adaptive import AdaptiveConfig
from softplc.observers.alpha_beta import AlphaBetaConfig
from softplc.observers.aoi import AoiConfig
from softplc.observers.axes import AxisSpec, ObserverModel
from softplc.observers.cv_accel import CvAccelConfig
from softplc.observers.derivative import DerivativeConfig
from softplc.observers.fb_kalman import FbKalmanConfig
from softplc.observers.finite_difference import FiniteDifferenceConfig
from softplc.observers.moving_average import MovingAverageConfig
from softplc.observers.one_euro import OneEuroConfig
from softplc.observers.signal_config import SignalSpec
from softplc.sample import Reason
from tests.observers.rig import ESTIMATES, Rig, make_rig

FULL = SignalSpec(modulo=360.0)
DIFFERENCE = FiniteDifferenceConfig(type="finite_difference")
OBSERVERS: dict[str, ObserverModel] = {
    "aoi": AoiConfig(type="aoi", r_x=0.01),
    "aoi real": AoiConfig(type="aoi", r_x=0.01, precision="real"),
    "fb_kalman": FbKalmanConfig(type="fb_kalman", variant="corrected", R=0.01),
    "cv_accel": CvAccelConfig(type="cv_accel", r_x=0.01),
    "adaptive": AdaptiveConfig(type="adaptive", r_x=0.01, top_speed=1000.0, top_acceleration=1000.0),
    "alpha_beta": AlphaBetaConfig(type="alpha_beta", alpha=0.5),
    "one_euro": OneEuroConfig(type="one_euro", beta=0.1),
    "moving_average": MovingAverageConfig(type="moving_average", window=7),
    "finite_difference": DIFFERENCE,
    "derivative": DerivativeConfig(type="derivative", dt_mode="measured"),
}


def rig(config: ObserverModel = DIFFERENCE, signal: SignalSpec = FULL, **spec: object) -> Rig:
    return make_rig((AxisSpec("A0", signal=signal, **spec), config))  # type: ignore[arg-type]


def off(a: float, b: float, turn: float = 360.0) -> float:
    """How far two positions are apart on the circle."""
    return abs(math.remainder(a - b, turn))


@pytest.mark.parametrize("speed", [-3300.0, -900.0, 900.0])
@pytest.mark.parametrize("name", OBSERVERS)
def test_a_turning_axis_is_the_same_as_one_that_goes_straight_on(name: str, speed: float):
    """45° a scan, and 165° backwards; beside it the same observer, which gets the unwrapped positions."""
    own, plain = rig(OBSERVERS[name]), make_rig((AxisSpec("A0"), OBSERVERS[name]))
    noise = np.random.default_rng(1).normal(0.0, 0.05, 120)
    # Rounding of positions of 20 000°: 1e-11 in double; 2e-3 in REAL, of an innovation of 0.3 with an S of 0.02.
    tolerance = 0.1 if name.endswith("real") else 1e-6
    for k in range(120):
        position = 10.0 + 0.05 * k * speed + float(noise[k])
        own.scan(position % 360.0)
        plain.scan(position)
        assert 0.0 <= own.get("Position") < 360.0
        assert off(own.get("Position"), plain.get("Position")) < tolerance
        for leaf in {"Velocity", *(set(ESTIMATES) & set(OBSERVERS[name].estimates))}:
            assert own.get(leaf) == pytest.approx(plain.get(leaf), rel=tolerance, abs=tolerance), leaf
        assert own.outcome() == plain.outcome()


@pytest.mark.parametrize("turn", [360.0, 2.0 * math.pi, 1.0, 4096.0])
def test_degrees_radians_turns_and_counts_alike(turn: float):
    own = rig(signal=SignalSpec(modulo=turn))
    for k in range(100):
        own.scan((0.13 * k * turn) % turn)
        assert own.get("Position") == pytest.approx((0.13 * k * turn) % turn, abs=1e-9 * turn)
        assert 0.0 <= own.get("Position") < turn
        if k:
            assert own.get("Velocity") == pytest.approx(0.13 * turn / 0.05)


def test_a_source_that_counts_from_minus_half_a_turn_gives_the_same_positions():
    own = rig()
    for k in range(60):
        own.scan(math.remainder(13.0 * k, 360.0))
        assert own.get("Raw") == math.remainder(13.0 * k, 360.0)
        assert own.get("Position") == pytest.approx((13.0 * k) % 360.0)


@pytest.mark.parametrize("position", [0.0, 360.0, -0.0, -1e-17, 359.99999999999994, -360.0, 720.0])
def test_the_edge_of_a_turn_is_zero(position: float):
    own = rig()
    for _ in range(3):
        own.scan(position)
        assert 0.0 <= own.get("Position") < 360.0
        assert off(own.get("Position"), position) < 1e-12
        assert own.get("Velocity") == pytest.approx(0.0, abs=1e-9)


def test_turns_cost_no_precision():
    """1000 turns: what goes straight on is at 375 000 by then, and its velocity is noisier by as many roundings."""
    own = rig(AoiConfig(type="aoi", r_x=0.01))
    errors = []
    for k in range(2500):
        own.scan((150.0 * k) % 360.0)
        errors.append(abs(own.get("Velocity") - 3000.0))
    # Rounding of numbers below 720, 6e-14, times gains of a few 1/s; straight on it would be 1e-10 and more.
    assert max(errors[-500:]) < 1e-11


def test_a_counter_that_rolls_over_in_the_middle_of_a_turn():
    """A 16-bit encoder of 1000 counts a turn: 65.536 turns a rollover, which is no whole number."""
    own = rig(signal=SignalSpec(counter=65536 * 0.36, modulo=360.0))
    for k in range(2000):
        counts = -37 * k % 65536  # 13.3° a scan, backwards
        own.scan(counts * 0.36)
        assert off(own.get("Position"), -37 * k * 0.36) < 1e-6
        assert 0.0 <= own.get("Position") < 360.0
        if k:
            assert own.get("Velocity") == pytest.approx(-37 * 0.36 / 0.05, abs=1e-6)


def test_the_range_is_that_of_what_was_read():
    own = rig(range=(0.0, 360.0))
    for k in range(60):
        own.scan((13.0 * k) % 360.0)
        assert own.outcome()[1] in (Reason.NONE, Reason.INITIALISING)
    own.scan(361.0)
    assert own.outcome()[1] is Reason.INPUT_OUT_OF_RANGE


def test_held_positions_and_predicted_ones_are_within_the_turn_too():
    own = rig(dt_source="source", on_repeat="predict")
    seen = []
    for k in range(100):
        sample = k // 4
        own.scan((40.0 * sample) % 360.0, stamp=100.0 + 0.2 * sample)
        seen.append(own.get("Position"))
        if k > 8:
            assert off(own.get("Position"), 10.0 * k) < 1e-6
            assert own.outcome()[1] is (Reason.PREDICTED if k % 4 else Reason.NONE)
            assert own.get("Velocity") == pytest.approx(200.0)
    assert 0.0 <= min(seen) <= max(seen) < 360.0


def test_the_difference_to_the_plc_is_taken_on_the_circle():
    spec = AxisSpec("A0", signal=FULL, shadow=("position", "velocity"))
    own = make_rig((spec, DIFFERENCE), shadow_tags=True, shadow_dt=False)
    for k in range(80):
        position = 30.0 * k
        own.scan(position % 360.0, math.remainder(position, 360.0) - 0.25, 600.0)
        if k:
            assert own.get("PositionDelta") == pytest.approx(0.25)
            assert own.get("PositionDeltaMax") == pytest.approx(0.25)


def test_consistency_sees_no_wrap():
    noise = np.random.default_rng(3).normal(0.0, 0.5, 600)
    config = AoiConfig(type="aoi", q_x=1e-4, q_x_dot=1e-3, r_x=0.25)
    rigs = rig(config, consistency=(200, 5)), make_rig((AxisSpec("A0", consistency=(200, 5)), config))
    for k in range(600):
        for own, turn in zip(rigs, (360.0, math.inf), strict=True):
            own.scan(math.fmod(20.0 * k + float(noise[k]) + 360.0, turn))
    own, plain = rigs
    for leaf in ("NISMean", "Autocorrelation", "Outside", "Consistency"):
        assert own.get(leaf) == pytest.approx(plain.get(leaf), abs=1e-6)


def test_a_disabled_axis_passes_through_within_the_turn():
    own = rig(enable=False)
    for k in range(30):
        own.scan(40.0 * k - 400.0)
        assert own.get("Position") == pytest.approx((40.0 * k - 400.0) % 360.0)
        assert own.outcome()[1] is Reason.DISABLED
