"""The three-state observer as a user sees it: acceleration, prediction with it, and a guard that does not latch."""

import pytest
from pydantic import ValidationError

from softplc.observers.axes import AxisSpec
from softplc.observers.cv_accel import CvAccelConfig
from softplc.sample import Reason, StatusCode
from tests.observers.motion import axis
from tests.observers.rig import Rig, make_rig

CONFIG = CvAccelConfig(type="cv_accel", q_x=0.0, q_x_dot=0.0, q_x_ddot=10.0, r_x=0.1)


def parabola(rig: Rig, seconds: float) -> None:
    """2 u/s² from rest."""
    for _ in range(round(seconds / rig.period)):
        rig.scan((rig.next - 100.0) ** 2)


def test_a_constant_acceleration_is_read_and_followed_without_error():
    rig = make_rig((AxisSpec("A0"), CONFIG))
    parabola(rig, 20.0)
    t = rig.now - 100.0
    shown = [rig.get(leaf) for leaf in ("Position", "Velocity", "Acceleration")]
    assert shown == pytest.approx([t * t, 2 * t, 2.0], abs=1e-8)


def test_scans_without_a_new_sample_are_predicted_with_the_acceleration():
    rig = make_rig((axis("source", "predict", held_after=5.0), CONFIG))
    parabola(rig, 20.0)
    for _ in range(10):
        rig.again()
        assert rig.outcome() == (StatusCode.GOOD, Reason.PREDICTED)
    t = rig.now - 100.0
    assert (rig.get("Position"), rig.get("Velocity")) == pytest.approx((t * t, 2 * t), abs=1e-4)  # stamps: whole ns


def test_a_non_positive_innovation_variance_is_flagged_and_the_next_sample_starts_anew():
    broken = CvAccelConfig.model_construct(
        type="cv_accel", q_mode="per_scan", q_x=0.0, q_x_dot=0.0, q_x_ddot=0.0, q_jerk=None, r_x=-2.0
    )
    rig = make_rig((AxisSpec("A0"), broken))
    for k in range(4):  # a negative r_x does not pass the configuration; S = P00 + r_x is negative at each start
        rig.scan(0.5 * k)
        assert rig.outcome() == (StatusCode.UNCERTAIN_SUB_NORMAL, Reason.INNOVATION_VARIANCE)
        assert (rig.get("Position"), rig.get("Velocity")) == (0.5 * k, 0.0)  # it does not run away


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"r_x": 0.0}, "greater than 0"),
        ({"r_x": 1.0, "q_x_ddot": -1.0}, "q_x_ddot"),
        ({"r_x": 1.0, "q_jerk": 1.0}, "q_jerk with q_mode per_scan"),
        ({"r_x": 1.0, "q_mode": "white_jerk"}, "white_jerk without q_jerk"),
        ({"r_x": 1.0, "q_mode": "white_jerk", "q_jerk": 1.0, "q_x": 0.1}, "q_x with q_mode white_jerk"),
    ],
)
def test_noise_that_is_missing_or_of_another_mode_is_refused(settings: dict[str, object], message: str):
    with pytest.raises(ValidationError, match=message):
        CvAccelConfig(type="cv_accel", **settings)  # type: ignore[arg-type]
