"""How an axis comes back after an outage, a suspended process, a jump, a disable: docs/bad-inputs.md, second half."""

import math
from dataclasses import replace

import pytest

from softplc.observers.aoi import AoiConfig
from softplc.observers.aoi_options import Gate
from softplc.sample import AxisState, Reason
from tests.observers.rig import CONFIG, make_rig
from tests.observers.test_modes import SPEC, SPEED, S, ramp, running, state


@pytest.mark.parametrize("n", [1, 2, 3, 8])
def test_after_an_outage_position_ramps_to_the_estimate_and_is_good_at_the_nth_sample(n: int):
    spec = replace(SPEC, reinit_samples=n)
    rig, fresh = running(spec), make_rig((spec, CONFIG))
    held = rig.get("Position")
    for _ in range(30):
        rig.fail(S.BAD_SENSOR_FAILURE)
    for k in range(1, n + 1):
        ramp(rig)
        fresh.scan(SPEED * (rig.now - 100.0))
        estimate = fresh.get("Position")
        if k < n or n == 1:
            assert rig.outcome()[0] == S.UNCERTAIN_INITIAL_VALUE
            assert rig.get("Reason") == (Reason.INITIALISING if k == 1 else Reason.SETTLING)
            assert state(rig) == AxisState.REINIT
        if k < n:
            assert rig.get("Position") == held * (1.0 - k / n) + estimate * (k / n)
        else:
            assert rig.get("Position") == estimate
        assert rig.get("Velocity") == fresh.get("Velocity")
    if n == 1:  # a start is never Good on its first sample
        ramp(rig)
    assert rig.outcome() == (S.GOOD, Reason.NONE)
    assert state(rig) == AxisState.RUN


def test_after_fail_there_is_nothing_to_ramp_from():
    rig = running()
    for _ in range(30):
        rig.fail(S.BAD_NO_COMMUNICATION)
    rig.scan(77.0)
    assert rig.get("Position") == 77.0
    assert (rig.outcome(), state(rig)) == ((S.UNCERTAIN_INITIAL_VALUE, Reason.INITIALISING), AxisState.REINIT)


def test_a_lost_link_is_settled_on_even_when_it_was_short_and_the_filter_goes_on():
    rig, other = running(), running()
    for _ in range(4):
        rig.fail(S.BAD_NO_COMMUNICATION)
        other.fail(S.BAD_SENSOR_FAILURE)
    for k in range(3):
        ramp(rig)
        ramp(other)
        assert rig.get("Dt") == other.get("Dt") == pytest.approx(0.25 if k == 0 else 0.05)
        assert rig.get("Position") == other.get("Position")
        assert other.outcome() == (S.GOOD, Reason.NONE)  # a short hole on a live link is one long step
        assert rig.outcome() == ((S.GOOD, Reason.NONE) if k == 2 else (S.UNCERTAIN_INITIAL_VALUE, Reason.SETTLING))


def test_a_bad_sample_while_settling_starts_the_count_anew():
    rig = running()
    for _ in range(30):
        rig.fail(S.BAD_SENSOR_FAILURE)
    ramp(rig, 2)
    shown = rig.get("Position")
    rig.scan(math.nan)
    assert (state(rig), rig.get("Position")) == (AxisState.HOLD, shown)
    for expected in (AxisState.REINIT, AxisState.REINIT, AxisState.RUN):
        ramp(rig)
        assert state(rig) == expected
        if expected == AxisState.REINIT:
            assert rig.outcome()[0] == S.UNCERTAIN_INITIAL_VALUE


def test_only_fresh_samples_count():
    rig = running()
    rig.fail(S.BAD_NO_COMMUNICATION)
    arrival = rig.now + 0.05
    rig.scan(20.0, stamp=arrival, arrival=arrival)
    assert state(rig) == AxisState.REINIT
    rig.scan(20.0, stamp=arrival, arrival=arrival)
    assert state(rig) == AxisState.REINIT  # the same one
    ramp(rig)
    assert state(rig) == AxisState.REINIT
    ramp(rig)
    assert state(rig) == AxisState.RUN


def test_a_value_that_stands_still_on_a_live_link_settles_as_well():
    """A source that sends on change sends one sample after an outage, and no more."""
    rig = running()
    rig.fail(S.BAD_NO_COMMUNICATION)
    rig.scan(20.0)
    scans = 1
    while state(rig) != AxisState.RUN:
        rig.again()
        scans += 1
    assert scans * rig.period == pytest.approx(0.25, abs=0.051)  # two more, 0.1 s each


def test_an_uncertain_sample_while_settling_keeps_its_own_status():
    rig = running()
    rig.fail(S.BAD_NO_COMMUNICATION)
    rig.scan(30.0, status=S.UNCERTAIN_SENSOR_NOT_ACCURATE)
    assert rig.outcome() == (S.UNCERTAIN_SENSOR_NOT_ACCURATE, Reason.INPUT_UNCERTAIN)
    assert state(rig) == AxisState.REINIT


def test_a_process_that_was_suspended_settles_and_is_not_good_on_the_first_sample():
    rig = running()
    rig.scan(500.0, dt=10.0)
    assert (rig.outcome(), state(rig)) == ((S.UNCERTAIN_INITIAL_VALUE, Reason.INITIALISING), AxisState.REINIT)
    rig.scan(500.5)
    assert (rig.outcome(), state(rig)) == ((S.UNCERTAIN_INITIAL_VALUE, Reason.SETTLING), AxisState.REINIT)
    rig.scan(501.0)
    assert (rig.outcome(), state(rig)) == ((S.GOOD, Reason.NONE), AxisState.RUN)


def test_a_jump_is_kept_out_by_the_gate_and_then_starts_the_observer_anew_without_a_tail():
    config = AoiConfig(type="aoi", r_x=4 / 3, gate=Gate(sigma=5.0, most_in_a_row=3))
    rig = running(replace(SPEC, range=None), config)
    for _ in range(3):
        ramp(rig, offset=1e6)
        assert rig.outcome() == (S.UNCERTAIN_SUB_NORMAL, Reason.INNOVATION_GATE)
    ramp(rig, offset=1e6)
    assert (rig.outcome()[1], state(rig)) == (Reason.INITIALISING, AxisState.REINIT)
    ramp(rig, offset=1e6)
    assert (rig.outcome(), state(rig)) == ((S.GOOD, Reason.NONE), AxisState.RUN)
    assert rig.get("Position") == pytest.approx(1e6 + SPEED * (rig.now - 100.0), abs=2.0)


def test_a_disabled_axis_says_so_whatever_its_input_is_and_starts_as_new():
    rig = running(replace(SPEC, enable_writable=True, on_bad="coast", after_coast="hold"))
    rig.observer.command(rig.table.index("A0.Enable"), 0.0)
    ramp(rig)
    assert (rig.outcome(), state(rig)) == ((S.UNCERTAIN_SUB_NORMAL, Reason.DISABLED), AxisState.DISABLED)
    rig.scan(math.nan)
    assert state(rig) == AxisState.DISABLED
    rig.observer.command(rig.table.index("A0.Enable"), 1.0)
    ramp(rig)
    assert (rig.outcome()[1], state(rig)) == (Reason.INITIALISING, AxisState.INIT)
    ramp(rig)
    assert (rig.outcome()[0], state(rig)) == (S.GOOD, AxisState.RUN)


def test_a_parked_axis_says_so():
    rig = running()
    rig.park()
    assert state(rig) == AxisState.PARKED
