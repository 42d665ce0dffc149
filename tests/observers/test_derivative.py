"""The DERIVATIVE block as a user sees it: what its nominal cycle does to the velocity, and what it is asked for."""

import pytest
from pydantic import ValidationError

from softplc.observers.axes import AxisSpec
from softplc.observers.derivative import DerivativeConfig
from softplc.sample import Reason, StatusCode
from tests.observers.motion import SPEED, ramp
from tests.observers.rig import make_rig

NOMINAL = DerivativeConfig(type="derivative", cycle_ms=50.0)
MEASURED = DerivativeConfig(type="derivative", dt_mode="measured")


@pytest.mark.parametrize("period", [0.05, 0.0625, 0.1])
def test_a_task_slower_than_the_cycle_reads_too_fast_by_the_same_ratio(period: float):
    nominal, measured = (make_rig((AxisSpec("A0"), config), period=period) for config in (NOMINAL, MEASURED))
    for rig in (nominal, measured):
        ramp(rig, 5.0)
    assert nominal.get("Velocity") == pytest.approx(SPEED * period / 0.05)
    assert measured.get("Velocity") == pytest.approx(SPEED)


def test_a_sample_that_comes_late_is_a_jump_of_the_nominal_velocity():
    nominal, measured = (make_rig((AxisSpec("A0"), config)) for config in (NOMINAL, MEASURED))
    for rig in (nominal, measured):
        ramp(rig, 1.0)
        rig.fail(StatusCode.BAD_SENSOR_FAILURE)
        rig.fail(StatusCode.BAD_SENSOR_FAILURE)
        rig.scan(SPEED * rig.next)
    assert nominal.get("Velocity") == pytest.approx(16.0)  # 0.1 of (3·5 + 1) times 10
    assert measured.get("Velocity") == pytest.approx(SPEED)


def test_the_position_passes_through_and_four_samples_make_it_good():
    rig = make_rig((AxisSpec("A0"), NOMINAL))
    seen = []
    for k in range(5):
        rig.scan(0.5 * k)
        seen.append((rig.outcome()[1], round(rig.get("Velocity"), 9), rig.get("Position")))
    assert seen == [
        (Reason.INITIALISING, 0.0, 0.0),
        (Reason.INITIALISING, 3.0, 0.5),
        (Reason.INITIALISING, 7.0, 1.0),
        (Reason.NONE, 10.0, 1.5),
        (Reason.NONE, 10.0, 2.0),
    ]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({}, "dt_mode nominal without cycle_ms"),
        ({"dt_mode": "measured", "cycle_ms": 50.0}, "cycle_ms with dt_mode measured"),
        ({"cycle_ms": 0.0}, "greater than 0"),
        ({"cycle_ms": float("nan")}, "cycle_ms"),
    ],
)
def test_a_cycle_that_is_missing_or_of_no_use_is_refused(settings: dict[str, object], message: str):
    with pytest.raises(ValidationError, match=message):
        DerivativeConfig(type="derivative", **settings)  # type: ignore[arg-type]
