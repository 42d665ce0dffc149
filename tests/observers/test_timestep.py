"""Time steps: measured, never lost, never negative; from the scan, the samples' stamps, or their arrivals."""

import math

import numpy as np
import pytest

from softplc.kernel.reference.aoi import AoiInputs, AoiState, aoi_lreal
from softplc.observers.axes import DtSource, OnRepeat
from softplc.sample import Reason, StatusCode
from tests.observers.motion import DT_SOURCES, MODES, SPEED, axis, follow, ramp
from tests.observers.rig import CONFIG, make_rig


@pytest.mark.parametrize("dt_source", DT_SOURCES)
def test_every_dt_source_uses_the_measured_interval(dt_source: DtSource):
    rig = make_rig(axis(dt_source))
    rig.scan(0.0)

    steps = []
    for dt in (0.05, 0.061, 0.043, 0.05):
        rig.scan(1.0, dt=dt)
        steps.append(rig.get("Dt"))

    assert steps == pytest.approx([0.05, 0.061, 0.043, 0.05], abs=1e-8)  # stamps are whole ns


def test_a_nominal_step_is_the_period_whatever_time_went_by():
    rig = make_rig(axis("nominal"))
    rig.scan(0.0)

    steps = []
    for z, dt in ((1.0, 0.061), (math.nan, 0.05), (1.0, 0.05), (1.0, 0.0)):
        rig.scan(z, dt=dt)
        steps.append(rig.get("Dt"))

    assert steps[0] == steps[2] == 0.05
    assert steps[3] == 0.0  # no time went by


@pytest.mark.parametrize(("dt_source", "on_repeat"), MODES)
def test_time_without_a_usable_sample_is_not_lost(dt_source: DtSource, on_repeat: OnRepeat):
    rig = make_rig(axis(dt_source, on_repeat))
    ramp(rig, 20.0)

    for _ in range(10):
        rig.scan(math.nan)
    rig.scan(SPEED * rig.next)

    assert rig.get("Dt") == pytest.approx(0.55)
    # a converged ramp is carried on exactly; the AOI as written would be off by the 5 u that were travelled
    assert rig.get("Position") == pytest.approx(SPEED * rig.now, abs=1e-6)
    assert rig.get("Velocity") == pytest.approx(SPEED, abs=1e-6)


@pytest.mark.parametrize(("bad_scans", "reason"), [(20, Reason.SETTLING), (21, Reason.INITIALISING)])
def test_a_gap_longer_than_reinit_after_starts_anew(bad_scans: int, reason: Reason):
    rig = make_rig(axis(reinit_after=1.001))  # 20 scans of 50 ms are 1.0 s
    ramp(rig, 5.0)

    for _ in range(bad_scans):
        rig.fail(StatusCode.BAD_NO_COMMUNICATION)
    rig.scan(SPEED * rig.next)

    assert rig.outcome()[1] == reason
    if reason == Reason.SETTLING:
        assert rig.get("Dt") == pytest.approx(1.05)
    else:
        assert (rig.get("Position"), rig.get("Velocity"), rig.get("Dt")) == (SPEED * rig.now, 0.0, 0.05)


def test_a_scan_that_came_far_too_late_starts_anew():
    rig = make_rig(axis())
    ramp(rig, 5.0)
    rig.scan(7.0, dt=10.0)
    assert rig.outcome()[1] == Reason.INITIALISING


def test_a_period_longer_than_reinit_after_is_no_gap_but_a_missed_scan_is():
    rig = make_rig(axis(reinit_after=1.0), period=2.0)
    ramp(rig, 40.0)
    assert rig.outcome()[1] == Reason.NONE

    rig.fail(StatusCode.BAD_DEVICE_FAILURE)
    rig.scan(SPEED * rig.next)
    assert rig.outcome()[1] == Reason.INITIALISING


@pytest.mark.parametrize("on_repeat", ["update", "predict"])
def test_a_source_that_slips_from_10_to_12_5_ms_reads_its_true_velocity(on_repeat: OnRepeat):
    rig = make_rig(axis("source", on_repeat), period=0.01)
    follow(rig, 10.0, source_period=0.01)

    velocities = follow(rig, 20.0, source_period=0.0125)

    if on_repeat == "predict":  # one step for each sample with its own interval: exact but for rounding
        assert velocities == pytest.approx([SPEED] * len(velocities), abs=1e-4)
    else:  # every fifth scan finds the value held: a ripple about the true velocity, and no bias
        assert np.mean(velocities) == pytest.approx(SPEED, abs=0.01)


def test_with_the_nominal_period_that_source_would_read_12_50():
    """The same samples into the AOI with its preset of 10 ms: why Δt is measured."""
    state = AoiState()
    for k in range(3000):
        z = SPEED * 0.0125 * k
        state, _ = aoi_lreal(state, AoiInputs(True, z, 10.0, CONFIG.q_x, CONFIG.q_x_dot, CONFIG.r_x))
    assert state.y_dot == pytest.approx(12.50, abs=1e-4)


def test_samples_that_arrive_in_bunches_read_their_true_velocity_by_their_stamps():
    """A publishing interval of 50 ms on a 10 ms source: five samples at once, of which the scan sees the newest."""
    rig = make_rig(axis("source", "predict"), period=0.01)
    for k in range(1500):
        arrived = math.floor(k / 5) * 0.05 + 100.0
        jitter = 0.004 * math.sin(k // 5)  # the bunch's newest sample is more or less old
        rig.scan(SPEED * (arrived - jitter), stamp=arrived - jitter, arrival=arrived)
    assert rig.get("Velocity") == pytest.approx(SPEED, abs=1e-3)


def test_stamps_in_bunches_neither_divide_by_zero_nor_spike():
    """Arrivals 6 µs apart, then 50 ms of silence: the velocity stays near the ramp's."""
    rig = make_rig(axis("arrival"), period=0.01)
    ramp(rig, 10.0)

    start, velocities = rig.now, []
    for k in range(500):
        bunch, place = divmod(k, 5)
        rig.scan(SPEED * (start + 0.01 * k), arrival=start + 0.05 * (bunch + 1) + 6e-6 * place)
        velocities.append(rig.get("Velocity"))

    assert min(velocities) > 0.5 * SPEED
    assert max(velocities) < 1.5 * SPEED


@pytest.mark.parametrize("dt_source", ["source", "arrival"])
def test_a_stamp_that_went_backwards_steps_by_measured_time(dt_source: DtSource):
    rig = make_rig(axis(dt_source))
    ramp(rig, 10.0)

    back = rig.now - 3600.0
    for k in range(1, 40):
        rig.scan(SPEED * rig.next, stamp=back + 0.05 * k, arrival=back + 0.05 * k)
        assert rig.get("Dt") == pytest.approx(0.05, abs=1e-6)
        assert rig.outcome() == (StatusCode.GOOD, Reason.NONE)
    assert rig.get("Velocity") == pytest.approx(SPEED, abs=1e-4)


def test_a_source_whose_clock_is_set_forward_steps_by_measured_time():
    rig = make_rig(axis("source"))
    ramp(rig, 10.0)

    for _ in range(40):
        rig.scan(SPEED * rig.next, stamp=rig.next + 3600.0)
        assert rig.get("Dt") == pytest.approx(0.05, abs=1e-6)
    assert rig.get("Velocity") == pytest.approx(SPEED, abs=1e-4)


def test_a_frozen_stamp_under_new_values_steps_by_measured_time():
    rig = make_rig(axis("source", "predict"))
    for _ in range(400):
        rig.scan(SPEED * rig.next, stamp=50.0)
        assert rig.outcome()[1] in (Reason.INITIALISING, Reason.NONE)
    assert rig.get("Dt") == pytest.approx(0.05)
    assert rig.get("Velocity") == pytest.approx(SPEED, abs=1e-4)


def test_stamps_in_whole_seconds_add_up_to_the_time_that_passed():
    rig = make_rig(axis("source", "predict"))
    steps = []
    for _ in range(400):
        rig.scan(SPEED * rig.next, stamp=math.floor(rig.next))
        if rig.outcome()[1] != Reason.PREDICTED:  # once a second nothing is left of the stamps' difference
            steps.append(rig.get("Dt"))
    assert sum(steps) == pytest.approx(20.0, abs=0.11)  # the first scan's 0.05, and what the last stamp leaves open
    assert max(steps) < 0.11
    assert rig.get("Velocity") == pytest.approx(SPEED, abs=0.1)


@pytest.mark.parametrize("dt_source", DT_SOURCES)
def test_a_stamp_that_is_missing_steps_by_measured_time(dt_source: DtSource):
    rig = make_rig(axis(dt_source))
    for _ in range(400):
        rig.now += 0.05
        rig.inputs.values[0] = SPEED * rig.now
        rig.inputs.statuses[0] = StatusCode.GOOD
        rig.step()
    assert rig.get("Velocity") == pytest.approx(SPEED, abs=1e-4)


@pytest.mark.parametrize(("dt_source", "on_repeat"), MODES)
def test_scans_without_a_reply_are_made_up_for_by_the_next_sample(dt_source: DtSource, on_repeat: OnRepeat):
    rig = make_rig(axis(dt_source, on_repeat))
    ramp(rig, 10.0)
    for _ in range(5):
        rig.again(StatusCode.UNCERTAIN_LAST_USABLE_VALUE)

    rig.scan(SPEED * rig.next)

    assert rig.outcome()[1] == Reason.NONE
    assert rig.get("Dt") == pytest.approx(0.3)
    assert rig.get("Velocity") == pytest.approx(SPEED, abs=1e-4)
