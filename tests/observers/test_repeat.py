"""Repeated samples: a held value is evidence, a sample not yet come is not, and no time is stepped twice."""

import math
from dataclasses import replace

import numpy as np
import pytest

from softplc.observers.axes import AxisSpec, DtSource, OnRepeat
from softplc.sample import AxisState, Reason, StatusCode
from tests.observers.motion import DT_SOURCES, MODES, SPEED, axis, ramp
from tests.observers.rig import make_rig


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
    assert rig.outcome()[1] == (Reason.INITIALISING if on_repeat == "predict" else Reason.NONE)


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


@pytest.mark.parametrize("dead_time", [None, 0.0])
def test_repetitions_of_the_sample_that_it_started_on_are_no_better_than_that(dead_time: float | None):
    """A source of 200 ms in a task of 50 ms: until its second sample the velocity is an assumption."""
    rig = make_rig(AxisSpec("A0", dt_source="source", on_repeat="predict", dead_time=dead_time))
    for k in range(8):
        if k % 4:
            rig.again()
        else:
            rig.scan(100.0 * rig.next)
        if k < 4:
            assert rig.outcome() == (StatusCode.UNCERTAIN_INITIAL_VALUE, Reason.INITIALISING)
            assert rig.get("State") == AxisState.INIT
        else:
            assert rig.outcome() == (StatusCode.GOOD, Reason.PREDICTED if k % 4 else Reason.NONE)
            assert rig.get("State") == AxisState.RUN


def test_a_value_that_is_held_from_the_start_on_is_good_when_it_counts_as_a_measurement():
    rig = make_rig(AxisSpec("A0", on_repeat="predict", dt_source="source", held_after=0.3))
    rig.scan(7.0)
    for _ in range(8):
        rig.again()
    assert rig.outcome() == (StatusCode.GOOD, Reason.NONE)
