"""Rotary axes and the state carried on to now, through coasts, outages and their ends."""

import math

import pytest

from softplc.observers.aoi import AoiConfig
from softplc.observers.axes import AxisSpec
from softplc.observers.signal_config import SignalSpec
from softplc.sample import AxisState, Reason, StatusCode
from tests.observers.rig import Rig, make_rig

AOI = AoiConfig(type="aoi", q_x_dot=1.0, r_x=0.01)
TURN = SignalSpec(modulo=360.0)


def rig(**spec: object) -> Rig:
    return make_rig((AxisSpec("A0", dead_time=0.02, **spec), AOI))  # type: ignore[arg-type]


def off(a: float, b: float) -> float:
    return abs(math.remainder(a - b, 360.0))


def test_a_rotary_axis_coasts_over_turns_and_goes_on_in_the_right_one():
    """A second and a half at 900 deg/s, nearly four turns, longer than reinit_after; back without a start anew."""
    own = rig(signal=TURN, on_bad="coast", coast_max=5.0)
    for k in range(100):
        own.scan((45.0 * k) % 360.0)
    for k in range(100, 130):
        own.scan(math.nan, status=StatusCode.BAD_SENSOR_FAILURE)
        assert own.get("State") == AxisState.COAST
        assert 0.0 <= own.get("Position") < 360.0
        assert off(own.get("Position"), 45.0 * k) < 0.01
        assert own.get("Horizon") == pytest.approx(0.02)  # the state is of now
        assert off(own.get("PositionNow"), 45.0 * k + 18.0) < 0.01
    for k in range(130, 140):
        own.scan((45.0 * k) % 360.0)
        assert own.get("Velocity") == pytest.approx(900.0, abs=0.1)
        assert off(own.get("Position"), 45.0 * k) < 0.01


def test_after_an_outage_a_rotary_axis_settles_the_short_way_round():
    """Held at 350, back at 10: through 0."""
    own = rig(signal=TURN, on_lost="hold")
    for _ in range(40):
        own.scan(350.0)
    for _ in range(40):
        own.fail(StatusCode.BAD_NO_COMMUNICATION)
    assert own.get("Position") == pytest.approx(350.0)
    seen = []
    for _ in range(8):
        own.scan(10.0)
        seen.append(own.get("Position"))
        assert off(own.get("Position"), 0.0) < 10.0 + 1e-6
    assert own.outcome() == (StatusCode.GOOD, Reason.NONE)
    assert seen[-1] == pytest.approx(10.0)
    assert any(position != pytest.approx(10.0) for position in seen)


def test_what_passes_through_is_where_it_is_now():
    own = rig(signal=TURN, on_bad="passthrough", range=(0.0, 360.0))
    for k in range(20):
        own.scan(10.0 * k)
    own.scan(365.0)
    assert own.get("State") == AxisState.PASSTHROUGH
    assert own.get("Position") == own.get("PositionNow") == pytest.approx(5.0)
    assert own.get("VelocityNow") == 0.0
