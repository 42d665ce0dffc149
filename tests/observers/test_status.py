"""The status and reason table, row by row: what the outputs say when they are not plainly Good."""

import math

import numpy as np
import pytest

from softplc.observers.axes import AxisSpec
from softplc.sample import Reason, StatusCode
from tests.observers.rig import ESTIMATES, Rig, make_rig

RAN = 10  # scans on a ramp of 10 u/s before the fault


def running(*axes: AxisSpec) -> Rig:
    rig = make_rig(*axes)
    for k in range(RAN):
        rig.scan(*[0.5 * k] * max(len(axes), 1))
    return rig


def estimates(rig: Rig) -> list[float]:
    return [rig.get(leaf) for leaf in ESTIMATES]


def assert_held(rig: Rig, before: list[float], stamp: float) -> None:
    assert estimates(rig) == before
    assert rig.stamp() == stamp


def test_before_the_first_sample_the_axis_waits():
    rig = make_rig()

    rig.step()

    assert rig.outcome() == (StatusCode.BAD_WAITING_FOR_INITIAL_DATA, Reason.WAITING)
    assert (rig.status("Raw"), rig.get("Age"), rig.get("Enabled")) == (
        StatusCode.BAD_WAITING_FOR_INITIAL_DATA,
        0.0,
        1.0,
    )


def test_the_scan_that_starts_the_observer_is_an_initial_value():
    rig = make_rig()

    rig.scan(3.0)

    assert rig.outcome() == (StatusCode.UNCERTAIN_INITIAL_VALUE, Reason.INITIALISING)
    assert (rig.get("Position"), rig.get("Velocity"), rig.get("Dt")) == (3.0, 0.0, 0.05)


def test_a_good_sample_gives_good_outputs_with_its_own_timestamp():
    rig = running()

    rig.scan(5.0, stamp=rig.now + 0.04)

    assert rig.outcome() == (StatusCode.GOOD, Reason.NONE)
    (stamp,) = {rig.stamp(leaf) for leaf in (*ESTIMATES, "Raw")}
    assert stamp == pytest.approx(rig.now - 0.01, abs=1e-8)  # seconds as floats beside nanoseconds
    assert rig.stamp("Quality") == rig.stamp("Age") == pytest.approx(rig.now, abs=1e-8)


@pytest.mark.parametrize(
    ("status", "reason"),
    [
        (StatusCode.BAD_NO_COMMUNICATION, Reason.NO_COMMUNICATION),
        (StatusCode.BAD_NOT_CONNECTED, Reason.NO_COMMUNICATION),
        (StatusCode.BAD_TIMEOUT, Reason.NO_COMMUNICATION),
        (StatusCode.BAD_WAITING_FOR_INITIAL_DATA, Reason.WAITING),
        (StatusCode.BAD_NODE_ID_UNKNOWN, Reason.CONFIGURATION),
        (StatusCode.BAD_TYPE_MISMATCH, Reason.CONFIGURATION),
        (StatusCode.BAD_NOT_READABLE, Reason.CONFIGURATION),
        (StatusCode.BAD_CONFIGURATION_ERROR, Reason.CONFIGURATION),
    ],
)
def test_without_connection_data_or_tag_the_outputs_are_as_bad_as_the_input(status: StatusCode, reason: Reason):
    rig = running()
    used = rig.stamp()

    rig.fail(status)

    assert rig.outcome() == (status, reason)
    assert rig.status("Raw") == status
    assert rig.stamp() == used


def test_information_bits_of_a_bad_status_are_kept_and_do_not_hide_its_meaning():
    rig = running()

    rig.fail(StatusCode.BAD_TIMEOUT | 0x0480)

    assert rig.get("Reason") == Reason.NO_COMMUNICATION
    assert rig.status() == StatusCode.BAD_TIMEOUT | 0x0480


def test_any_other_bad_input_holds_the_last_outputs():
    rig = running()
    before, used = estimates(rig), rig.stamp()

    rig.fail(StatusCode.BAD_SENSOR_FAILURE)

    assert rig.outcome() == (StatusCode.UNCERTAIN_LAST_USABLE_VALUE, Reason.INPUT_BAD)
    assert_held(rig, before, used)
    assert (rig.status("Raw"), math.isnan(rig.get("Raw"))) == (StatusCode.BAD_SENSOR_FAILURE, True)


def test_outputs_held_after_lost_communication_are_those_from_before_it():
    rig = running()
    before, used = estimates(rig), rig.stamp()

    rig.fail(StatusCode.BAD_NO_COMMUNICATION)
    rig.fail(StatusCode.BAD_DEVICE_FAILURE)

    assert rig.outcome() == (StatusCode.UNCERTAIN_LAST_USABLE_VALUE, Reason.INPUT_BAD)
    assert_held(rig, before, used)


def test_an_axis_that_never_ran_has_nothing_to_hold():
    rig = make_rig(AxisSpec("A0", range=(-100.0, 100.0)))
    rig.fail(StatusCode.BAD_SENSOR_FAILURE)
    assert rig.outcome() == (StatusCode.BAD_SENSOR_FAILURE, Reason.INPUT_BAD)

    rig.scan(math.nan)
    assert rig.outcome() == (StatusCode.BAD_OUT_OF_RANGE, Reason.INPUT_NOT_FINITE)

    rig.scan(101.0)
    assert rig.outcome() == (StatusCode.BAD_OUT_OF_RANGE, Reason.INPUT_OUT_OF_RANGE)
    assert (rig.get("Raw"), rig.status("Raw")) == (101.0, StatusCode.GOOD)

    rig.scan(50.0, status=StatusCode.UNCERTAIN_LAST_USABLE_VALUE, arrival=rig.now)  # as old as the last one
    assert rig.outcome() == (StatusCode.BAD_WAITING_FOR_INITIAL_DATA, Reason.STALE)


@pytest.mark.parametrize("z", [math.inf, -math.inf])
def test_infinity_is_rejected_and_shown_as_read(z: float):
    rig = running()
    before, used = estimates(rig), rig.stamp()

    rig.scan(z)

    assert rig.outcome() == (StatusCode.UNCERTAIN_LAST_USABLE_VALUE, Reason.INPUT_NOT_FINITE)
    assert_held(rig, before, used)
    assert (rig.get("Raw"), rig.status("Raw")) == (z, StatusCode.GOOD)


def test_nan_with_a_good_status_is_rejected_and_its_raw_tag_is_bad():
    rig = running()
    before, used = estimates(rig), rig.stamp()

    rig.scan(math.nan)

    assert rig.outcome() == (StatusCode.UNCERTAIN_LAST_USABLE_VALUE, Reason.INPUT_NOT_FINITE)
    assert_held(rig, before, used)
    assert rig.status("Raw") == StatusCode.BAD_OUT_OF_RANGE


@pytest.mark.parametrize("z", [100.001, -1e9])
def test_a_sample_outside_the_range_is_rejected(z: float):
    rig = running(AxisSpec("A0", range=(-100.0, 100.0)))
    before, used = estimates(rig), rig.stamp()

    rig.scan(z)

    assert rig.outcome() == (StatusCode.UNCERTAIN_ENGINEERING_UNITS_EXCEEDED, Reason.INPUT_OUT_OF_RANGE)
    assert_held(rig, before, used)
    assert (rig.get("Raw"), rig.status("Raw")) == (z, StatusCode.GOOD)


@pytest.mark.parametrize("z", [100.0, -100.0])
def test_the_limits_belong_to_the_range(z: float):
    rig = make_rig(AxisSpec("A0", range=(-100.0, 100.0)))
    rig.scan(z)
    assert rig.get("Position") == z


@pytest.mark.parametrize(
    "status",
    [StatusCode.UNCERTAIN_LAST_USABLE_VALUE, StatusCode.UNCERTAIN_NO_COMMUNICATION_LAST_USABLE_VALUE],
)
def test_a_scan_without_a_reply_from_the_source_is_no_evidence(status: StatusCode):
    rig = running()
    before, used = estimates(rig), rig.stamp()

    rig.again(status)

    assert rig.outcome() == (StatusCode.UNCERTAIN_LAST_USABLE_VALUE, Reason.STALE)
    assert_held(rig, before, used)
    assert (rig.get("Raw"), rig.status("Raw")) == (0.5 * (RAN - 1), status)


@pytest.mark.parametrize(
    "status", [StatusCode.UNCERTAIN, StatusCode.UNCERTAIN_SENSOR_NOT_ACCURATE, StatusCode.UNCERTAIN_LAST_USABLE_VALUE]
)
def test_an_uncertain_sample_that_did_arrive_is_used_and_its_status_passed_on(status: StatusCode):
    rig, good = running(), running()

    rig.scan(5.0, status=status)
    good.scan(5.0)

    assert rig.outcome() == (status, Reason.INPUT_UNCERTAIN)
    assert estimates(rig) == estimates(good)


def test_a_good_status_with_a_subcode_counts_as_good():
    rig = running()
    rig.scan(5.0, status=0x00960000)  # GoodLocalOverride
    assert rig.outcome() == (StatusCode.GOOD, Reason.NONE)
    assert rig.status("Raw") == 0x00960000


def test_a_fault_on_one_axis_leaves_the_others_good():
    rig, alone = running(AxisSpec("A0"), AxisSpec("A1"), AxisSpec("A2")), running()

    rig.scan(5.0, math.nan, 5.0)
    alone.scan(5.0)

    outcomes = [rig.outcome(axis) for axis in range(3)]
    assert outcomes[0] == outcomes[2] == (StatusCode.GOOD, Reason.NONE)
    assert outcomes[1] == (StatusCode.UNCERTAIN_LAST_USABLE_VALUE, Reason.INPUT_NOT_FINITE)
    assert [rig.get(leaf, 2) for leaf in ESTIMATES] == estimates(alone)


def test_an_axis_holds_its_outputs_also_when_another_never_ran():
    rig = make_rig(AxisSpec("A0"), AxisSpec("A1"))
    for k in range(RAN):
        rig.scan(0.5 * k, math.nan)
    before = estimates(rig)

    rig.scan(math.nan, math.nan)

    assert rig.outcome(0) == (StatusCode.UNCERTAIN_LAST_USABLE_VALUE, Reason.INPUT_NOT_FINITE)
    assert rig.outcome(1) == (StatusCode.BAD_OUT_OF_RANGE, Reason.INPUT_NOT_FINITE)
    assert estimates(rig) == before


def test_a_last_usable_value_that_never_arrived_is_no_evidence():
    rig = make_rig()
    rig.scan(5.0, status=StatusCode.UNCERTAIN_LAST_USABLE_VALUE, arrival=math.nan)
    assert rig.outcome() == (StatusCode.BAD_WAITING_FOR_INITIAL_DATA, Reason.STALE)


def test_age_is_the_time_since_the_newest_arrival_and_survives_a_lost_connection():
    rig = make_rig()
    rig.scan(1.0, arrival=99.98)
    assert rig.get("Age") == pytest.approx(0.02, abs=1e-9)

    rig.inputs.arrivals[:] = np.nan  # a new connection has not seen a sample yet
    rig.fail(StatusCode.BAD_NO_COMMUNICATION)
    assert rig.get("Age") == pytest.approx(0.07, abs=1e-9)

    rig.scan(1.0, arrival=rig.now + 0.06)  # read within the scan, after its start
    assert rig.get("Age") == 0.0


def test_age_counts_from_the_first_scan_while_nothing_has_arrived():
    rig = make_rig()
    rig.step()
    rig.fail(StatusCode.BAD_WAITING_FOR_INITIAL_DATA)
    assert rig.get("Age") == pytest.approx(0.05, abs=1e-9)


def test_a_parked_observer_leaves_estimates_bad_and_says_so():
    rig = make_rig()
    rig.scan(1.0)
    rig.park()
    position = rig.outputs.sample(rig.table.index("A0.Position"))
    assert (position.status, position.value != position.value) == (StatusCode.BAD_INTERNAL_ERROR, True)
    assert rig.outputs.values[rig.table.index("A0.Quality")] == 0
    assert rig.outputs.values[rig.table.index("A0.Reason")] == Reason.INTERNAL_ERROR


def test_the_age_of_a_parked_observer_grows_and_what_tells_its_state_is_of_each_scan():
    rig = make_rig()
    rig.scan(1.0)
    for scans in range(1, 4):
        rig.park()
        assert rig.get("Age") == pytest.approx(scans * rig.period, abs=1e-9)  # rounding of the clock
        for leaf in ("Age", "State", "Quality", "Reason", "Enabled"):
            assert rig.stamp(leaf) == pytest.approx(rig.now, abs=1e-6)
    assert rig.stamp("Raw") == pytest.approx(rig.now - 3 * rig.period, abs=1e-6)
