import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from softplc.emulator.motion import Constant, Motion, RampHold, Sine, Trapezoid

MOTIONS = [
    (RampHold(type="ramp_hold"), 10.0),
    (RampHold(type="ramp_hold", slope=-3.0, segment_s=0.7, start=5.0), 3.0),
    (Sine(type="sine", amplitude=40.0, period_s=7.0, offset=-5.0), 40.0 * 2 * math.pi / 7.0),
    (Constant(type="constant", value=12.5), 0.0),
    (Trapezoid(type="trapezoid", distance=100.0, velocity=20.0, acceleration=50.0), 20.0),
    (Trapezoid(type="trapezoid", distance=-1.0, velocity=20.0, acceleration=50.0, dwell_s=0.0), 20.0),
]


@pytest.mark.parametrize(
    ("t", "position", "velocity"),
    [
        (0.0, 0.0, 10.0),
        (7.5, 75.0, 10.0),
        (15.0, 150.0, 0.0),
        (29.95, 150.0, 0.0),
        (30.0, 150.0, 10.0),
        (37.5, 225.0, 10.0),
        (45.0, 300.0, 0.0),
        (59.95, 300.0, 0.0),
        (60.0, 300.0, -10.0),
        (75.0, 150.0, 0.0),
        (90.0, 150.0, -10.0),
        (105.0, 0.0, 0.0),
        (120.0, 0.0, 10.0),
        (135.0, 150.0, 0.0),
    ],
)
def test_ramp_hold_is_the_papers_experiment_and_then_comes_down_again(t: float, position: float, velocity: float):
    assert RampHold(type="ramp_hold").at(t) == (position, velocity)


@pytest.mark.parametrize(
    ("t", "position", "velocity"),
    [
        (0.0, 0.0, 0.0),
        (0.2, 1.0, 10.0),  # a·t²/2, a·t
        (0.4, 4.0, 20.0),
        (2.9, 54.0, 20.0),
        (5.0, 96.0, 20.0),
        (5.2, 99.0, 10.0),
        (5.4, 100.0, 0.0),
        (6.0, 100.0, 0.0),  # dwells 1 s
        (6.8, 96.0, -20.0),
        (11.8, 0.0, 0.0),
        (12.8 + 0.2, 1.0, 10.0),
    ],
)
def test_trapezoid_accelerates_cruises_decelerates_dwells_and_comes_back(t: float, position: float, velocity: float):
    motion = Trapezoid(type="trapezoid", distance=100.0, velocity=20.0, acceleration=50.0)

    # 1e-9: the corners are not exact in binary
    assert motion.at(t) == (pytest.approx(position, abs=1e-9), pytest.approx(velocity, abs=1e-9))


def test_a_short_trapezoid_never_reaches_its_velocity():
    motion = Trapezoid(type="trapezoid", distance=1.0, velocity=20.0, acceleration=4.0)

    assert motion.at(0.5) == (pytest.approx(0.5), pytest.approx(2.0))  # the peak: √(a·d) half way
    assert motion.at(1.0) == (pytest.approx(1.0), pytest.approx(0.0, abs=1e-9))


@pytest.mark.parametrize(("motion", "fastest"), MOTIONS)
@given(t=st.floats(0.0, 1e5), dt=st.floats(0.0, 2.0))
def test_no_motion_jumps_or_exceeds_its_velocity(motion: Motion, fastest: float, t: float, dt: float):
    (before, _), (after, velocity) = motion.at(t), motion.at(t + dt)

    assert abs(velocity) <= fastest * (1 + 1e-12)
    assert abs(after - before) <= fastest * dt + 1e-6  # 1e-6: time itself is rounded at 1e5 s, times the velocity


@pytest.mark.parametrize(("motion", "fastest"), MOTIONS)
@given(t=st.floats(0.0, 200.0))
def test_velocity_is_the_derivative_of_position_where_there_is_one(motion: Motion, fastest: float, t: float):
    h = 1e-4
    left, right = motion.at(t)[1], motion.at(t + h)[1]
    slope = (motion.at(t + h)[0] - motion.at(t)[0]) / h

    # the slope lies between the velocities around it; at a corner within h of here anything up to the fastest is in
    low, high = min(left, right), max(left, right)
    if high - low < 0.02 * fastest:
        assert low - 1e-2 <= slope <= high + 1e-2
