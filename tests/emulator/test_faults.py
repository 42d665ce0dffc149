import math
from typing import Any

import pytest

from softplc.emulator.plant import AxisState, Plant
from softplc.sample import StatusCode
from tests.emulator.scenarios import scenario


def states(steps: int, *faults: dict[str, Any]) -> tuple[list[AxisState], list[AxisState]]:
    """The axis with faults and the same axis without, at 50 ms a step."""
    spoilt = Plant(scenario({"name": "AxisX", "faults": faults}))
    healthy = Plant(scenario({"name": "AxisX"}))
    return [spoilt.at(k).axes[0] for k in range(steps)], [healthy.at(k).axes[0] for k in range(steps)]


def differing(found: list[AxisState], healthy: list[AxisState]) -> list[int]:
    return [k for k, (one, other) in enumerate(zip(found, healthy, strict=True)) if one != other]


def test_a_fault_lasts_from_its_time_for_its_duration_and_no_longer():
    found, healthy = states(60, {"type": "jump", "at_s": 1.0, "for_s": 0.25, "offset": 7.0})

    assert differing(found, healthy) == [20, 21, 22, 23, 24]
    assert [found[k].position - healthy[k].position for k in range(20, 25)] == pytest.approx([7.0] * 5, abs=1e-12)


def test_a_fault_without_a_duration_hits_one_step_and_repeats_if_told():
    found, healthy = states(60, {"type": "jump", "at_s": 0.5, "every_s": 1.0, "offset": 7.0})

    assert differing(found, healthy) == [10, 30, 50]


def test_nan_spoils_position_and_neither_count_nor_status():
    found, healthy = states(12, {"type": "nan", "at_s": 0.5})

    assert [math.isnan(state.position) for state in found] == [False] * 10 + [True, False]
    assert found[10].count == healthy[10].count
    assert found[10].status == StatusCode.GOOD


def test_a_jump_moves_count_as_well():
    found, healthy = states(12, {"type": "jump", "at_s": 0.5, "offset": 7.0})

    assert found[10].count - healthy[10].count == 7000


def test_freeze_repeats_the_first_measurement_and_the_timestamp_goes_on():
    found, healthy = states(40, {"type": "freeze", "at_s": 0.5, "for_s": 1.0})

    assert [state.position for state in found[10:30]] == [healthy[10].position] * 20
    assert [state.measured_in for state in found] == list(range(40))
    assert [state.true_position for state in found] == [state.true_position for state in healthy]
    assert found[30:] == healthy[30:]


def test_freeze_can_stop_the_timestamp_as_well():
    found, _ = states(40, {"type": "freeze", "at_s": 0.5, "for_s": 1.0, "timestamp": "frozen"})

    assert [state.measured_in for state in found[9:31]] == [9] + [10] * 20 + [30]


def test_status_marks_the_measurement():
    found, _ = states(12, {"type": "status", "at_s": 0.5, "status": "BadOutOfService"})

    assert [state.status for state in found[9:12]] == [StatusCode.GOOD, 0x808D0000, StatusCode.GOOD]


def test_probability_hits_that_share_of_the_steps_and_the_seed_says_which():
    fault = {"type": "nan", "at_s": 0, "for_s": 1000, "probability": 0.2}
    first = [math.isnan(state.position) for state in states(10_000, fault)[0]]

    assert [math.isnan(state.position) for state in states(10_000, fault)[0]] == first
    assert abs(sum(first) / 10_000 - 0.2) < 4 * 0.004  # four standard errors, √(0.2 · 0.8 / n)


def test_faults_add_up_in_their_order():
    found, healthy = states(
        12,
        {"type": "jump", "at_s": 0.5, "offset": 7.0},
        {"type": "status", "at_s": 0.5, "status": "BadSensorFailure"},
    )

    assert found[10].position == healthy[10].position + 7.0
    assert found[10].status == StatusCode.BAD_SENSOR_FAILURE
