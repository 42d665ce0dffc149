"""Samples that are faster than the axis can move, and homing."""

import numpy as np
import pytest

from softplc.observers.adaptive import AdaptiveConfig
from softplc.observers.aoi import AoiConfig
from softplc.observers.axes import AxisSpec, ObserverModel
from softplc.observers.cv_accel import CvAccelConfig
from softplc.observers.finite_difference import FiniteDifferenceConfig
from softplc.observers.moving_average import MovingAverageConfig
from softplc.observers.signal_config import SignalSpec
from softplc.sample import Reason, StatusCode
from tests.observers.rig import CONFIG, Rig, make_rig

LIMIT = SignalSpec(max_rate=100.0, max_rate_samples=3)  # 5 mm a scan
REJECTED = (StatusCode.UNCERTAIN_ENGINEERING_UNITS_EXCEEDED, Reason.RATE_EXCEEDED)
GOOD = (StatusCode.GOOD, Reason.NONE)
OBSERVERS: dict[str, ObserverModel] = {
    "aoi": CONFIG,
    "aoi real": AoiConfig(type="aoi", r_x=1.0, precision="real"),
    "cv_accel": CvAccelConfig(type="cv_accel", r_x=1.0),
    "adaptive": AdaptiveConfig(type="adaptive", r_x=0.01, top_speed=100.0, top_acceleration=1000.0),
    "moving_average": MovingAverageConfig(type="moving_average", window=4),
    "finite_difference": FiniteDifferenceConfig(type="finite_difference"),
}


def rig(config: ObserverModel = CONFIG, signal: SignalSpec = LIMIT, **spec: object) -> Rig:
    return make_rig((AxisSpec("A0", signal=signal, **spec), config))  # type: ignore[arg-type]


def settled(own: Rig, z: float = 10.0) -> Rig:
    for _ in range(60):
        own.scan(z)
    return own


def test_one_wild_sample_is_rejected_and_leaves_no_trace():
    own, plain = settled(rig()), settled(make_rig())
    own.scan(1e6)
    assert own.outcome() == REJECTED
    assert own.get("Position") == pytest.approx(10.0)  # the last usable one
    assert (own.get("Raw"), own.status("Raw")) == (1e6, StatusCode.GOOD)
    plain.scan(np.nan)
    for z in (10.0, 10.2, 9.9):
        own.scan(z)
        plain.scan(z)
        assert own.outcome() == GOOD
        assert own.get("Position") == plain.get("Position")
        assert own.get("Velocity") == plain.get("Velocity")


@pytest.mark.parametrize("name", OBSERVERS)
def test_homing_ends_at_the_new_place_without_tail_or_spike(name: str):
    """A step of a million: three samples rejected, then a start at the new place, at rest."""
    own = settled(rig(OBSERVERS[name]))
    seen = []
    for _ in range(30):
        own.scan(1e6)
        seen.append((own.get("Position"), own.get("Velocity")))
        assert own.get("Velocity") == pytest.approx(0.0, abs=1e-9)
    assert [position for position, _ in seen[:3]] == pytest.approx([10.0] * 3)
    assert [position for position, _ in seen[3:]] == pytest.approx([1e6] * 27)
    assert own.outcome() == GOOD


def test_the_statuses_of_homing():
    own = settled(rig())
    outcomes = []
    for _ in range(6):
        own.scan(500.0)
        outcomes.append(own.outcome())
    start = (StatusCode.UNCERTAIN_INITIAL_VALUE, Reason.INITIALISING)
    assert outcomes == [REJECTED, REJECTED, REJECTED, start, GOOD, GOOD]


def test_the_count_is_of_samples_in_a_row():
    own = settled(rig())
    for _ in range(20):
        for z in (500.0, 500.0, 500.0, 10.0):
            own.scan(z)
    assert own.outcome() == GOOD
    assert own.get("Position") == pytest.approx(10.0)


def test_the_limit_is_of_the_measured_time_between_used_samples():
    """Seven mm in 50 ms are too fast, in 100 ms they are not."""
    own = settled(rig())
    own.scan(17.0)
    assert own.outcome() == REJECTED
    own = settled(rig())
    own.scan(17.0, dt=0.1)
    assert own.outcome() == GOOD
    own = settled(rig())
    own.fail(StatusCode.BAD_SENSOR_FAILURE)
    own.scan(17.0)
    assert own.outcome() == GOOD


def test_an_axis_at_its_top_speed_is_let_through():
    own = rig(signal=SignalSpec(max_rate=100.0))
    for k in range(100):
        own.scan(4.99 * k)
        assert own.outcome()[1] is not Reason.RATE_EXCEEDED
    assert own.get("Velocity") == pytest.approx(99.8, abs=0.1)


def test_a_step_of_the_measurement_over_a_tiny_time_is_no_speed():
    """Quantum 0.1 over 0.1 ms is 1000 mm/s by the figures."""
    own = rig(signal=SignalSpec(max_rate=100.0, quantum=0.1))
    for z in (0.0, 0.1, 0.0, 0.1, 0.1):
        own.scan(z, dt=1e-4)
        assert own.outcome()[1] is not Reason.RATE_EXCEEDED


def test_the_limit_is_judged_by_the_samples_own_stamps_where_those_are_the_time():
    """A source that is slower than the scans: 12 mm every 200 ms are 60 mm/s, though in the scan it looks as 240."""
    own = rig(dt_source="source", on_repeat="predict")
    for k in range(60):
        own.scan(12.0 * (k // 4), stamp=100.0 + 0.2 * (k // 4))
        assert own.outcome()[1] is not Reason.RATE_EXCEEDED


def test_a_wild_sample_that_a_slow_source_repeats_counts_once():
    own = settled(rig(dt_source="source"))
    for _ in range(8):
        own.scan(500.0, stamp=103.2)
        assert own.outcome() == REJECTED
    own.scan(10.0)
    assert own.outcome() == GOOD


def test_a_new_place_that_is_repeated_for_long_is_the_place():
    """An OPC-UA source need not stamp a value anew that does not change: no sample in a row would come."""
    own = settled(rig(dt_source="source", reinit_after=0.5))
    for _ in range(14):
        own.scan(500.0, stamp=103.2)
    assert own.get("Position") == pytest.approx(500.0)
    assert own.get("Velocity") == pytest.approx(0.0)


def test_after_a_gap_that_starts_the_observer_anew_everything_is_let_in():
    own = settled(rig(reinit_after=0.5, reinit_samples=1))
    own.scan(5000.0, dt=2.0)
    assert own.outcome() == (StatusCode.UNCERTAIN_INITIAL_VALUE, Reason.INITIALISING)
    for _ in range(2):  # settles, and ramps from where it was
        own.scan(5000.0)
    assert own.outcome() == (StatusCode.GOOD, Reason.NONE)
    assert own.get("Position") == 5000.0


def test_a_counter_that_is_set_anew_while_homing_is_where_it_says():
    """Two turns of the counter on, then the PLC zeroes it."""
    own = rig(FiniteDifferenceConfig(type="finite_difference"), SignalSpec(counter=655.36, max_rate=200.0))
    for k in range(180):
        own.scan((8.0 * k) % 655.36)
    assert own.get("Position") == pytest.approx(1432.0)
    for _ in range(5):
        own.scan(300.0)
        assert abs(own.get("Velocity")) < 161.0
    assert own.get("Position") == pytest.approx(300.0)


def test_a_rotary_axis_is_judged_on_the_circle():
    own = rig(FiniteDifferenceConfig(type="finite_difference"), SignalSpec(modulo=360.0, max_rate=100.0))
    for k in range(300):
        own.scan((4.0 * k) % 360.0)
        assert own.outcome()[1] is not Reason.RATE_EXCEEDED
    own.scan((4.0 * 300 + 170.0) % 360.0)
    assert own.outcome() == REJECTED


def test_a_sample_that_is_bad_and_has_a_value_counts_for_nothing():
    own = settled(rig())
    for _ in range(5):
        own.scan(500.0, status=StatusCode.BAD_SENSOR_FAILURE)
        assert own.outcome()[1] is Reason.INPUT_BAD
    own.scan(10.0)
    assert own.outcome() == GOOD


def test_a_fault_that_is_out_of_range_for_long_does_not_start_the_observer_anew():
    own = settled(rig(range=(0.0, 100.0)))
    for _ in range(10):
        own.scan(5000.0)
        assert own.outcome()[1] is Reason.INPUT_OUT_OF_RANGE
    own.scan(10.0)
    assert own.outcome() == GOOD
