"""The 1€ filter as a user sees it: still at rest, quick in motion, and a velocity that can be trusted."""

import numpy as np
import pytest
from pydantic import ValidationError

from softplc.observers.axes import AxisSpec
from softplc.observers.one_euro import OneEuroConfig
from tests.observers.motion import SPEED, axis, ramp
from tests.observers.rig import make_rig


def test_the_cutoff_rises_with_the_speed_and_is_published():
    rig = make_rig((axis(), OneEuroConfig(type="one_euro", min_cutoff=0.5, beta=0.2)))
    rig.scan(1.0)
    assert rig.get("Cutoff") == 0.5
    ramp(rig, 10.0)
    assert rig.get("Cutoff") == pytest.approx(0.5 + 0.2 * SPEED)


def test_the_velocity_as_in_the_paper_is_the_speed_over_the_smoothing_factor():
    paper = make_rig((axis(), OneEuroConfig(type="one_euro", beta=0.0, difference="filtered")))
    ours = make_rig((axis(), OneEuroConfig(type="one_euro", beta=0.0)))
    for rig in (paper, ours):
        ramp(rig, 20.0)
    a = 1 / (1 + 1 / (2 * np.pi * 1.0 * 0.05))
    assert paper.get("Velocity") == pytest.approx(SPEED / a)
    assert ours.get("Velocity") == pytest.approx(SPEED)


def test_a_still_axis_is_smoothed_more_than_a_moving_one_lags():
    rig = make_rig((AxisSpec("A0"), OneEuroConfig(type="one_euro", min_cutoff=0.3, beta=1.0, d_cutoff=0.3)))
    noise = np.random.default_rng(1).uniform(-0.1, 0.1, 400)
    still = []
    for one in noise:
        rig.scan(one)
        still.append(rig.get("Position"))
    assert np.std(still[100:]) < 0.5 * np.std(noise)
    for k in range(100):
        rig.scan(0.5 * k)
    assert 0.5 * 99 - rig.get("Position") < 0.2  # at 0.3 Hz alone it would lag by 5


@pytest.mark.parametrize(
    "settings", [{}, {"beta": -1.0}, {"beta": 0.1, "min_cutoff": 0.0}, {"beta": 0.1, "d_cutoff": -1.0}]
)
def test_cutoffs_that_are_none_are_refused(settings: dict[str, float]):
    with pytest.raises(ValidationError):
        OneEuroConfig(type="one_euro", **settings)  # type: ignore[arg-type]
