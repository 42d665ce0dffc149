"""The second half of the status table: what the outputs say of what the observer did with a usable sample."""

import pytest

from softplc.observers.aoi import AoiConfig
from softplc.observers.axes import AxisSpec, DtSource
from softplc.sample import Reason, StatusCode
from tests.observers.rig import ESTIMATES, Rig, make_rig


def estimates(rig: Rig) -> list[float]:
    return [rig.get(leaf) for leaf in ESTIMATES]


def test_a_disabled_axis_passes_the_position_through():
    rig = make_rig(AxisSpec("A0", enable=False))

    rig.scan(3.0)

    assert rig.outcome() == (StatusCode.UNCERTAIN_SUB_NORMAL, Reason.DISABLED)
    assert [rig.get(leaf) for leaf in ("Position", "Velocity", "Dt", "NIS")] == [3.0, 0.0, 0.0, 0.0]
    assert (rig.get("Enabled"), rig.get("Enable")) == (0.0, 0.0)


def test_what_the_observer_did_goes_before_an_uncertain_input():
    rig = make_rig(AxisSpec("A0", enable=False), AxisSpec("A1"))

    rig.scan(3.0, 4.0, status=StatusCode.UNCERTAIN_SENSOR_NOT_ACCURATE)

    assert rig.outcome(0) == (StatusCode.UNCERTAIN_SUB_NORMAL, Reason.DISABLED)
    assert rig.outcome(1) == (StatusCode.UNCERTAIN_INITIAL_VALUE, Reason.INITIALISING)


def test_a_bad_input_goes_before_disabled():
    rig = make_rig(AxisSpec("A0", enable=False))
    rig.scan(3.0)

    rig.fail(StatusCode.BAD_SENSOR_FAILURE)
    assert rig.outcome() == (StatusCode.UNCERTAIN_LAST_USABLE_VALUE, Reason.INPUT_BAD)
    assert rig.get("Position") == 3.0

    rig.fail(StatusCode.BAD_NO_COMMUNICATION)
    assert rig.outcome() == (StatusCode.BAD_NO_COMMUNICATION, Reason.NO_COMMUNICATION)


def test_a_non_positive_innovation_variance_is_flagged_and_stays_so():
    config = AoiConfig.model_construct(type="aoi", precision="lreal", q_x=0.0, q_x_dot=0.0, r_x=-2.0, bleed=None)
    rig = make_rig((AxisSpec("A0"), config))

    for k in range(3):  # a negative r_x does not pass the configuration; S = P00 + r_x is negative from the start
        rig.scan(0.5 * k)
        assert rig.outcome() == (StatusCode.UNCERTAIN_SUB_NORMAL, Reason.INNOVATION_VARIANCE)
        assert (rig.get("S") < 0, rig.get("NIS"), rig.get("Position")) == (True, 0.0, 0.0)


def test_a_state_that_is_no_number_is_never_shown_and_the_next_sample_starts_anew():
    rig = make_rig()
    rig.scan(1.7e308)
    before, used = estimates(rig), rig.stamp()

    rig.scan(-1.7e308)  # the innovation overflows
    assert rig.outcome() == (StatusCode.UNCERTAIN_LAST_USABLE_VALUE, Reason.NOT_FINITE)
    assert estimates(rig) == before
    assert used < rig.now

    rig.scan(5.0)
    assert rig.outcome() == (StatusCode.UNCERTAIN_INITIAL_VALUE, Reason.INITIALISING)
    assert (rig.get("Position"), rig.get("Velocity")) == (5.0, 0.0)


def test_a_state_that_was_no_number_is_not_shown_by_a_disabled_axis_either():
    rig = make_rig(AxisSpec("A0", enable_writable=True))
    rig.scan(1.7e308)
    rig.scan(-1.7e308)
    rig.observer.command(rig.table.index("A0.Enable"), 0.0)

    rig.scan(5.0)

    assert rig.outcome() == (StatusCode.UNCERTAIN_SUB_NORMAL, Reason.DISABLED)
    assert [rig.get(leaf) for leaf in ("Position", "Velocity", "P00", "K0")] == [5.0, 0.0, 0.0, 0.0]


def test_a_state_from_a_skipped_update_is_not_good_while_it_is_carried_on():
    config = AoiConfig.model_construct(type="aoi", precision="lreal", q_x=0.0, q_x_dot=0.0, r_x=-2.0, bleed=None)
    rig = make_rig((AxisSpec("A0", on_repeat="predict"), config))
    rig.scan(1.0)
    rig.again()
    assert rig.outcome() == (StatusCode.UNCERTAIN_SUB_NORMAL, Reason.INNOVATION_VARIANCE)


def test_an_axis_whose_first_scan_already_overflows_has_nothing_to_show():
    config = AoiConfig(type="aoi", q_x=1.5e308, r_x=1.5e308)  # S is infinite
    rig = make_rig((AxisSpec("A0"), config))
    rig.scan(1.0)
    assert rig.outcome() == (StatusCode.BAD_OUT_OF_RANGE, Reason.NOT_FINITE)


@pytest.mark.parametrize("dt_source", ["scan", "source", "arrival"])
def test_no_usable_time_step_at_the_start_passes_the_position_through(dt_source: DtSource):
    rig = make_rig(AxisSpec("A0", dt_source=dt_source))
    rig.scan(3.0, dt=0.0)
    assert rig.outcome() == (StatusCode.UNCERTAIN_SUB_NORMAL, Reason.DT_INVALID)
    assert (rig.get("Position"), rig.get("Velocity")) == (3.0, 0.0)
