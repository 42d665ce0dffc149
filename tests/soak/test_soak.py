"""The short form of the soak: every observer, every policy, some thousand scans, every status right."""

import numpy as np
import pytest

from softplc.sample import AxisState
from tests.soak.run import OBSERVERS, soak


@pytest.mark.parametrize("name", OBSERVERS)
def test_whatever_the_samples_are_every_status_is_right_and_the_state_is_finite(name: str):
    report = soak(name, 1500, seed=7)
    assert report.wrong == ()


def test_the_soak_sees_every_state_that_an_axis_without_a_defect_may_have():
    report = soak("aoi", 4000, seed=3)
    met = {AxisState(state) for state in np.flatnonzero(report.states)}
    assert met == set(AxisState) - {AxisState.DISABLED, AxisState.PARKED}
