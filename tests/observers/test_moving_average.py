"""The moving average as a user sees it: its lag, its warm-up, and a window that is changed while it runs."""

import numpy as np
import pytest
from pydantic import ValidationError

from softplc.observers.axes import AxisSpec
from softplc.observers.kernel import Given
from softplc.observers.moving_average import MovingAverageConfig, MovingAverageKernel
from softplc.sample import Reason
from tests.observers.motion import SPEED, axis, ramp
from tests.observers.rig import make_rig


@pytest.mark.parametrize("window", [2, 5, 20])
def test_the_position_lags_by_half_the_window_less_one_and_the_velocity_is_exact(window: int):
    rig = make_rig((axis(), MovingAverageConfig(type="moving_average", window=window)))
    ramp(rig, 5.0)
    assert SPEED * rig.now - rig.get("Position") == pytest.approx(SPEED * 0.05 * (window - 1) / 2, abs=1e-9)
    assert rig.get("Velocity") == pytest.approx(SPEED, abs=1e-9)


def test_it_is_good_once_it_has_one_sample_more_than_its_window():
    rig = make_rig((AxisSpec("A0"), MovingAverageConfig(type="moving_average", window=4)))
    reasons = []
    for k in range(6):
        rig.scan(float(k))
        reasons.append(rig.outcome()[1])
    assert reasons == [Reason.INITIALISING] * 4 + [Reason.NONE] * 2


@pytest.mark.parametrize("windows", [(5, 9), (9, 5), (3, 1000), (9, 0)])
def test_an_axis_whose_window_is_changed_starts_anew_and_its_neighbour_does_not(windows: tuple[int, int]):
    kernel = MovingAverageKernel([windows[0], windows[0]])
    given = Given(np.full(2, True), np.zeros(2), np.full(2, 0.05), np.full(2, True), np.full(2, np.nan))
    for k in range(20):
        given.z[:] = 0.5 * k
        kernel.step(given)
    neighbour = [float(kernel.estimates[leaf][1]) for leaf in ("Position", "Velocity")]

    kernel.tuning["window"][0] = windows[1]
    given.z[:] = 100.0, 9.5 + 0.5
    kernel.step(given)

    assert [float(kernel.estimates[leaf][0]) for leaf in ("Position", "Velocity")] == [100.0, 0.0]
    assert [float(kernel.estimates[leaf][1]) for leaf in ("Position", "Velocity")] == pytest.approx(
        [neighbour[0] + 0.5, neighbour[1]]
    )
    for z in (101.0, 102.0):
        given.z[0] = z
        kernel.step(given)
    assert kernel.estimates["Position"][0] == (101.5 if windows[1] == 0 else 101.0)  # at least 2 are averaged


@pytest.mark.parametrize("window", [1, 0, -3, 1001, 2.5])
def test_a_window_that_is_none_is_refused(window: float):
    with pytest.raises(ValidationError):
        MovingAverageConfig(type="moving_average", window=window)  # type: ignore[arg-type]
