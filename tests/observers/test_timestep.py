"""Time steps: measured, never lost, never negative; from the scan, the samples' stamps, or their arrivals."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from softplc.kernel.reference.aoi import AoiInputs, AoiState, aoi_lreal
from softplc.observers.axes import AxisSpec, DtSource, OnRepeat
from softplc.sample import Reason, StatusCode
from tests.observers.rig import CONFIG, Rig, make_rig

SPEED = 10.0  # u/s, of the ramps here
DT_SOURCES: tuple[DtSource, ...] = ("scan", "source", "arrival")
MODES = list(itertools.product(DT_SOURCES, ("update", "predict")))


def axis(dt_source: DtSource = "scan", on_repeat: OnRepeat = "update", **more: float) -> AxisSpec:
    return AxisSpec("A0", dt_source=dt_source, on_repeat=on_repeat, **more)  # type: ignore[arg-type]


def ramp(rig: Rig, seconds: float) -> None:
    """A new sample in every scan."""
    for _ in range(round(seconds / rig.period)):
        rig.scan(SPEED * rig.next)


def follow(rig: Rig, seconds: float, source_period: float, phase: float = 0.001) -> list[float]:
    """Scans of a source that takes a sample of the ramp every `source_period`; the velocities of the second half.

    The source stamps its samples as it takes them; a subscription brings each as it is taken.
    """
    velocities = []
    scans = round(seconds / rig.period)
    for k in range(scans):
        taken = math.floor((rig.next - phase) / source_period) * source_period + phase
        rig.scan(SPEED * taken, stamp=taken, arrival=taken)
        if k >= scans // 2:
            velocities.append(rig.get("Velocity"))
    return velocities


@pytest.mark.parametrize("dt_source", DT_SOURCES)
def test_every_dt_source_uses_the_measured_interval(dt_source: DtSource):
    rig = make_rig(axis(dt_source))
    rig.scan(0.0)

    steps = []
    for dt in (0.05, 0.061, 0.043, 0.05):
        rig.scan(1.0, dt=dt)
        steps.append(rig.get("Dt"))

    assert steps == pytest.approx([0.05, 0.061, 0.043, 0.05], abs=1e-8)  # stamps are whole ns


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


@pytest.mark.parametrize(("bad_scans", "reason"), [(20, Reason.NONE), (21, Reason.INITIALISING)])
def test_a_gap_longer_than_reinit_after_starts_anew(bad_scans: int, reason: Reason):
    rig = make_rig(axis(reinit_after=1.001))  # 20 scans of 50 ms are 1.0 s
    ramp(rig, 5.0)

    for _ in range(bad_scans):
        rig.fail(StatusCode.BAD_NO_COMMUNICATION)
    rig.scan(SPEED * rig.next)

    assert rig.outcome()[1] == reason
    if reason == Reason.INITIALISING:
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
def test_a_held_value_lets_the_velocity_go_to_zero(dt_source: DtSource, on_repeat: OnRepeat):
    """A subscription brings nothing while the value does not change; the link is alive, the axis stands still."""
    rig = make_rig(axis(dt_source, on_repeat))
    ramp(rig, 10.0)
    stopped_at = rig.get("Raw")

    for _ in range(200):
        rig.again()

    assert rig.outcome() == (StatusCode.GOOD, Reason.NONE)
    assert rig.get("Velocity") == pytest.approx(0.0, abs=1e-3)
    assert rig.get("Position") == pytest.approx(stopped_at, abs=1e-3)


@pytest.mark.parametrize(("dt_source", "on_repeat"), MODES)
def test_motion_after_a_long_standstill_is_followed_at_once(dt_source: DtSource, on_repeat: OnRepeat):
    """What was stepped while the value was held is not stepped a second time with the next stamp."""
    rig = make_rig(axis(dt_source, on_repeat))
    ramp(rig, 10.0)
    for _ in range(1200):  # a minute
        rig.again()
    z = rig.get("Raw")

    steps = []
    for k in range(1, 41):
        rig.scan(z + SPEED * 0.05 * k)
        steps.append(rig.get("Dt"))

    assert max(steps) < 0.11
    assert sum(steps) == pytest.approx(2.0, abs=0.06)  # 40 scans, one may be carried into the next
    assert rig.get("Velocity") == pytest.approx(SPEED, abs=1.0)  # the filter itself needs some 2 s


def test_a_source_clock_that_runs_slow_costs_no_more_than_two_scans_after_a_standstill():
    rig = make_rig(axis("source"))
    ramp(rig, 5.0)
    stamp, z = rig.now, rig.get("Raw")
    for _ in range(12_000):  # ten minutes, in which the source's clock loses half a second
        rig.again()
    stamp += 600.0 - 0.5

    reasons = []
    for k in range(1, 6):
        rig.scan(z + SPEED * 0.05 * k, stamp=stamp + 0.05 * k)
        reasons.append(rig.outcome()[1])

    assert reasons == [Reason.PREDICTED, Reason.PREDICTED, Reason.NONE, Reason.NONE, Reason.NONE]


def test_on_repeat_predict_publishes_the_state_carried_on_to_now():
    rig = make_rig(axis("source", "predict"))
    ramp(rig, 20.0)
    x, v, used = rig.get("Position"), rig.get("Velocity"), rig.stamp()
    frozen = [rig.get(leaf) for leaf in ("Innovation", "S", "K0", "K1", "P00", "P01", "P11", "NIS")]

    for k in (1, 2, 3):
        rig.again()
        assert rig.outcome() == (StatusCode.GOOD, Reason.PREDICTED)
        assert rig.get("Dt") == pytest.approx(0.05 * k)
        assert rig.get("Position") == x + v * rig.get("Dt")
        assert rig.get("Velocity") == v
        assert rig.stamp() == used
    assert [rig.get(leaf) for leaf in ("Innovation", "S", "K0", "K1", "P00", "P01", "P11", "NIS")] == frozen

    rig.scan(SPEED * rig.next)
    assert rig.outcome() == (StatusCode.GOOD, Reason.NONE)
    assert rig.get("Dt") == pytest.approx(0.2)
    assert rig.get("Velocity") == pytest.approx(SPEED, abs=1e-6)


def test_a_repeated_uncertain_sample_keeps_its_own_status_while_predicted():
    rig = make_rig(axis("scan", "predict"))
    ramp(rig, 1.0)
    rig.again(StatusCode.UNCERTAIN_SENSOR_NOT_ACCURATE)
    assert rig.outcome() == (StatusCode.UNCERTAIN_SENSOR_NOT_ACCURATE, Reason.INPUT_UNCERTAIN)
    assert rig.get("Dt") == 0.05


@pytest.mark.parametrize("dt_source", DT_SOURCES)
def test_a_repeated_value_counts_as_held_after_held_after(dt_source: DtSource):
    rig = make_rig(axis(dt_source, "predict", held_after=0.22))
    ramp(rig, 10.0)

    reasons, steps = [], []
    for _ in range(7):
        rig.again()
        reasons.append(rig.outcome()[1])
        steps.append(rig.get("Dt"))

    assert reasons == [Reason.PREDICTED] * 4 + [Reason.NONE] * 3
    assert steps[4:] == pytest.approx([0.25, 0.05, 0.05])  # the first makes up for the predicted scans


def test_predicting_for_longer_than_reinit_after_is_no_gap():
    rig = make_rig(axis("source", "predict", held_after=10.0, reinit_after=1.0))
    ramp(rig, 10.0)
    for _ in range(40):
        rig.again()
        assert rig.outcome()[1] == Reason.PREDICTED

    rig.scan(SPEED * rig.next)

    assert rig.outcome()[1] == Reason.NONE
    assert rig.get("Dt") == pytest.approx(2.05)
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


@pytest.mark.parametrize(("dt_source", "on_repeat"), MODES)
def test_enabling_again_forgets_how_long_the_value_was_held(dt_source: DtSource, on_repeat: OnRepeat):
    rig = make_rig(replace(axis(dt_source, on_repeat), enable_writable=True))
    ramp(rig, 5.0)
    for _ in range(100):
        rig.again()
    for enable in (0.0, 1.0):
        rig.observer.command(rig.table.index("A0.Enable"), enable)
        rig.again()
    assert rig.outcome()[1] == Reason.INITIALISING

    rig.again()
    assert rig.outcome()[1] == (Reason.PREDICTED if on_repeat == "predict" else Reason.NONE)


@pytest.mark.parametrize(("dt_source", "on_repeat"), MODES)
@pytest.mark.parametrize("held", [0.5, 30.0])
def test_time_before_a_start_on_an_old_sample_is_not_stepped_afterwards(
    dt_source: DtSource, on_repeat: OnRepeat, held: float
):
    """The axis stands still and is enabled: the next stamp's difference reaches back to before the start."""
    rig = make_rig(replace(axis(dt_source, on_repeat), enable_writable=True))
    ramp(rig, 5.0)
    rig.observer.command(rig.table.index("A0.Enable"), 0.0)
    for _ in range(round(held / 0.05)):
        rig.again()
    rig.observer.command(rig.table.index("A0.Enable"), 1.0)
    rig.again()
    assert rig.outcome()[1] == Reason.INITIALISING

    rig.scan(rig.get("Raw") + 0.5)

    assert rig.outcome()[1] == Reason.NONE
    assert rig.get("Dt") == pytest.approx(0.05)


def test_a_start_on_a_new_stamp_owes_nothing_to_what_was_held_before():
    rig = make_rig(replace(axis("source"), enable_writable=True))
    ramp(rig, 5.0)
    rig.observer.command(rig.table.index("A0.Enable"), 0.0)
    for _ in range(10):
        rig.again()
    rig.observer.command(rig.table.index("A0.Enable"), 1.0)
    stamp = rig.next - 0.1

    rig.scan(0.0, stamp=stamp)
    rig.scan(0.5, stamp=stamp + 0.05)

    assert rig.outcome()[1] == Reason.NONE
    assert rig.get("Dt") == pytest.approx(0.05)


def test_only_scans_on_a_live_link_count_towards_held_after():
    rig = make_rig(axis("source", "predict", held_after=0.22))
    ramp(rig, 5.0)
    for status in (StatusCode.GOOD, *[StatusCode.UNCERTAIN_LAST_USABLE_VALUE] * 10, StatusCode.GOOD):
        rig.again(status)
    assert rig.outcome()[1] == Reason.PREDICTED


def test_a_rejected_sample_in_between_does_not_make_a_repeated_one_new():
    rig = make_rig(axis("source", "predict"))
    ramp(rig, 5.0)
    z, stamp = rig.get("Raw"), rig.now

    rig.scan(math.nan, stamp=stamp)
    rig.scan(z, stamp=stamp)

    assert rig.outcome()[1] == Reason.PREDICTED


def test_on_repeat_update_takes_a_repeated_sample_as_a_measurement_of_a_held_value():
    rig, polled = make_rig(axis("source", "update")), make_rig(axis("scan", "update"))
    ramp(rig, 1.0)
    ramp(polled, 1.0)

    for _ in range(5):
        rig.again()
        polled.scan(polled.get("Raw"))

    assert rig.get("Velocity") == pytest.approx(polled.get("Velocity"), abs=1e-6)  # stamps are whole ns


def test_time_of_stamps_and_repetitions_adds_up_to_the_time_that_passed():
    """A 12.5 ms source on a 10 ms scan with irregular phase: what repetitions stepped is taken off the next stamp."""
    rig = make_rig(axis("source", "update"), period=0.01)
    rng = np.random.default_rng(2)
    start, total, stamp = 0.0, 0.0, 0.0
    for k in range(2000):
        now = 100.0 + 0.01 * k
        stamp = max(stamp, math.floor(now / 0.0125) * 0.0125 - rng.uniform(0, 0.002) * (k % 7 == 0))
        rig.scan(SPEED * stamp, stamp=stamp, arrival=stamp)
        if k == 0:
            start = stamp
        elif rig.outcome()[1] != Reason.PREDICTED:
            assert rig.get("Dt") > 0.0
            total += rig.get("Dt")

    assert total == pytest.approx(stamp - start, abs=0.0101)  # the last repetition may still be ahead of its stamp
