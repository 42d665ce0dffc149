"""The state carried on to now: by the sample's age and the dead time."""

import math

import numpy as np
import pytest

from softplc.observers.adaptive import AdaptiveConfig
from softplc.observers.axes import AxisSpec, ObserverModel
from softplc.observers.cv_accel import CvAccelConfig
from softplc.observers.ducekf import DucekfConfig, EndStops
from softplc.observers.finite_difference import FiniteDifferenceConfig
from softplc.observers.signal_config import SignalSpec
from softplc.sample import Reason, StatusCode
from tests.observers.rig import CONFIG, Rig, make_rig

DIFFERENCE = FiniteDifferenceConfig(type="finite_difference")
STOPS = EndStops(type="end_stops", lower=0.0, upper=100.0, restitution=0.5)


def rig(config: ObserverModel = DIFFERENCE, dead_time: float = 0.02, **spec: object) -> Rig:
    return make_rig((AxisSpec("A0", dead_time=dead_time, **spec), config))  # type: ignore[arg-type]


def now(own: Rig) -> tuple[float, float, float]:
    return own.get("PositionNow"), own.get("VelocityNow"), own.get("Horizon")


def test_without_a_dead_time_there_are_no_such_tags():
    assert "A0.PositionNow" not in make_rig().table
    assert "A0.PositionNow" in rig(dead_time=0.0).table


def test_a_ramp_is_where_it_is_now_and_not_where_it_was_measured():
    """Samples arrive 12 ms before the scan and were 20 ms old then."""
    own = rig(CONFIG)
    for k in range(400):
        own.scan(100.0 * (0.05 * k - 0.032), arrival=own.next - 0.012)
    assert now(own) == pytest.approx((100.0 * 0.05 * 399, 100.0, 0.032), abs=1e-3)  # the AOI settles on a ramp
    assert own.get("Position") == pytest.approx(100.0 * (0.05 * 399 - 0.032), abs=1e-3)
    assert own.outcome() == (StatusCode.GOOD, Reason.NONE)  # these tags carry the status of the others


def test_a_reply_that_came_within_the_scan_has_no_age():
    own = rig()
    for k in range(5):
        own.scan(2.0 * k, arrival=own.next + 0.01)
    assert now(own)[2] == pytest.approx(0.02)


def test_the_samples_own_stamp_tells_its_age_where_it_is_the_time_and_can_be_true():
    own = rig(dt_source="source")
    for k in range(10):
        own.scan(5.0 * k, stamp=own.next - 0.04, arrival=own.next - 0.01)
    assert now(own) == pytest.approx((5.0 * 9 + 100.0 * 0.06, 100.0, 0.06), abs=1e-6)  # stamps are in ns, Δt too
    for shift in (3600.0, -3600.0):  # a clock that is an hour wrong says nothing of the age
        own = rig(dt_source="source")
        for k in range(10):
            own.scan(5.0 * k, stamp=own.next + shift, arrival=own.next - 0.01)
        assert now(own)[2] == pytest.approx(0.03)


def test_the_scan_is_the_clock_for_an_axis_that_goes_by_scans():
    own = rig(dt_source="scan")
    for k in range(10):
        own.scan(5.0 * k, stamp=own.next - 0.04, arrival=own.next - 0.01)
    assert now(own)[2] == pytest.approx(0.03)


def test_what_is_predicted_is_carried_on_from_its_own_step():
    """Every fourth scan brings a sample; between them the source repeats it, freshly asked for."""
    own = rig(on_repeat="predict")
    for k in range(40):
        sample = k // 4
        own.scan(20.0 * sample, stamp=100.0 + 0.2 * sample)
        if k > 8:
            assert now(own) == pytest.approx((5.0 * k + 2.0, 100.0, 0.05 * (k % 4) + 0.02))


def test_an_observer_with_acceleration_uses_it():
    for config in (
        CvAccelConfig(type="cv_accel", r_x=0.01),
        AdaptiveConfig(type="adaptive", r_x=1e-4, top_speed=1000.0, top_acceleration=100.0),
    ):
        own = rig(config, dead_time=0.5)
        for k in range(200):
            own.scan(0.5 * 40.0 * (0.05 * k) ** 2)
        t = 0.05 * 199
        # Within 2 % of what half a second adds, which is 200 u of speed and 5 u of acceleration.
        assert now(own)[0] == pytest.approx(20.0 * (t + 0.5) ** 2, abs=1.0)
        assert now(own)[1] == pytest.approx(40.0 * (t + 0.5), abs=4.0)


def test_an_observer_with_stops_stays_within_them():
    own = rig(DucekfConfig(type="ducekf", model=STOPS, r_x=0.01, contact_from="position"), dead_time=1.0)
    for k in range(20):
        own.scan(50.0 + 2.0 * k)
    assert own.get("Position") == pytest.approx(88.0, abs=0.1)
    assert now(own)[0] == 100.0


def test_what_is_held_is_held_and_what_is_bad_is_bad():
    own = rig()
    for k in range(10):
        own.scan(5.0 * k)
    before = now(own)
    own.scan(math.nan)
    assert now(own) == before
    assert own.outcome() == (StatusCode.UNCERTAIN_LAST_USABLE_VALUE, Reason.INPUT_NOT_FINITE)
    own.fail(StatusCode.BAD_NO_COMMUNICATION)
    assert all(np.isnan(now(own)))
    assert own.status("PositionNow") == own.status("Horizon") == StatusCode.BAD_NO_COMMUNICATION


def test_a_disabled_axis_is_where_it_is_read():
    own = rig(CvAccelConfig(type="cv_accel", r_x=0.01), enable=False)
    for k in range(10):
        own.scan(5.0 * k)
        assert now(own)[:2] == (5.0 * k, 0.0)


def test_a_rotary_axis_is_within_its_turn_now_too():
    own = rig(signal=SignalSpec(modulo=360.0), dead_time=0.1)
    for k in range(200):
        own.scan((17.0 * k) % 360.0)
        assert 0.0 <= now(own)[0] < 360.0
        if k:
            assert abs(math.remainder(now(own)[0] - 17.0 * (k + 2), 360.0)) < 1e-6
