"""Enable edges, from wherever they come."""

import math

import pytest

from softplc.observers.axes import AxisSpec
from softplc.sample import Reason, Sample, StatusCode
from tests.observers.rig import ESTIMATES, Rig, make_rig

WRITABLE = AxisSpec("A0", enable_writable=True)


def enable_index(rig: Rig, axis: int = 0) -> int:
    return rig.table.index(f"A{axis}.Enable")


def test_a_written_enable_takes_effect_with_the_next_scan():
    rig = make_rig(WRITABLE)
    rig.scan(1.0)

    assert rig.observer.command(enable_index(rig), 0.0)
    assert rig.get("Enabled") == 1.0
    rig.scan(2.0)

    assert (rig.get("Enabled"), rig.get("Enable")) == (0.0, 0.0)
    assert rig.outcome() == (StatusCode.UNCERTAIN_SUB_NORMAL, Reason.DISABLED)
    assert (rig.get("Position"), rig.get("Velocity")) == (2.0, 0.0)


def test_commands_for_other_tags_are_refused():
    rig = make_rig(WRITABLE, AxisSpec("A1"))

    assert not rig.observer.command(enable_index(rig, axis=1), 0.0)
    assert not rig.observer.command(rig.table.index("A0.q_x"), 1.0)
    assert not rig.observer.command(enable_index(rig), math.nan)
    assert rig.observer.command(enable_index(rig), 1.0)


def test_enabling_again_starts_once_from_the_measurement_and_no_old_value_leaks():
    rig, fresh = make_rig(WRITABLE), make_rig(WRITABLE)
    for k in range(40):
        rig.scan(0.5 * k)
    rig.observer.command(enable_index(rig), 0.0)
    rig.scan(70.0)
    rig.observer.command(enable_index(rig), 1.0)

    outcomes = []
    for z in (80.0, 80.3, 80.9):
        rig.scan(z)
        fresh.scan(z)
        outcomes.append(rig.outcome()[1])
        assert [rig.get(leaf) for leaf in ESTIMATES] == [fresh.get(leaf) for leaf in ESTIMATES]
    assert outcomes == [Reason.INITIALISING, Reason.NONE, Reason.NONE]


def test_a_disable_that_falls_on_a_bad_sample_still_starts_anew_afterwards():
    rig = make_rig(WRITABLE)
    rig.scan(1.0)
    rig.observer.command(enable_index(rig), 0.0)
    rig.fail(StatusCode.BAD_SENSOR_FAILURE)
    rig.observer.command(enable_index(rig), 1.0)

    rig.scan(9.0)

    assert rig.outcome()[1] == Reason.INITIALISING
    assert rig.get("Position") == 9.0


def test_the_enable_tag_is_stamped_with_the_scan_that_changed_it():
    rig = make_rig(WRITABLE)
    rig.scan(1.0)
    first = rig.stamp("Enable")
    rig.scan(1.0)
    assert rig.stamp("Enable") == rig.stamp("q_x") == first

    rig.observer.command(enable_index(rig), 0.0)
    rig.scan(1.0)
    assert rig.stamp("Enable") == pytest.approx(rig.now, abs=1e-9)
    assert rig.stamp("q_x") == first


def test_an_enable_tag_of_a_source_is_followed_and_a_bad_one_keeps_the_last_state():
    rig = make_rig(AxisSpec("A0"), AxisSpec("A1"), enable_tag=True)

    def enabled_after(value: float, status: int = StatusCode.GOOD) -> tuple[float, float]:
        rig.inputs.put(2, Sample(value, status, None))
        rig.scan(1.0, 2.0)
        return rig.get("Enabled", 0), rig.get("Enabled", 1)

    assert enabled_after(0.0) == (0, 0)
    assert enabled_after(1.0) == (1, 1)
    assert enabled_after(math.nan, StatusCode.BAD_NO_COMMUNICATION) == (1, 1)
    assert enabled_after(-2.5) == (1, 1)
    assert enabled_after(0.0, StatusCode.UNCERTAIN) == (0, 0)
    assert enabled_after(math.nan) == (0, 0)


def test_until_the_enable_tag_is_known_the_configured_state_holds():
    rig = make_rig(AxisSpec("A0", enable=False), enable_tag=True)
    rig.scan(1.0)
    assert rig.get("Enabled") == 0.0
