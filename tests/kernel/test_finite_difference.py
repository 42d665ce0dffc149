"""The finite difference: exact on a ramp at any steps, as noisy as the text says, nothing left of the past."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softplc.kernel.batch import finite_difference as batch
from softplc.kernel.reference.finite_difference import (
    FiniteDifferenceInputs,
    FiniteDifferenceState,
    finite_difference,
)
from softplc.kernel.result import Result
from tests.kernel.side_by_side import Axis, assert_batch_equals_reference, axes_of, run


@settings(max_examples=60, deadline=None)
@given(axes=axes_of(lambda: st.just(FiniteDifferenceInputs(True, 0.0, 0.0))))
def test_batch_equals_reference(axes: list[Axis]):
    state, tuning = batch.FiniteDifferenceBatchState(len(axes)), batch.FiniteDifferenceTuning()
    assert_batch_equals_reference(axes, finite_difference, FiniteDifferenceState, batch, state, tuning)


def test_it_is_numpys_difference():
    rng = np.random.default_rng(3)
    x, dt = rng.normal(size=200), rng.uniform(0.01, 0.1, 200)

    y = run(
        finite_difference,
        FiniteDifferenceState(),
        [FiniteDifferenceInputs(True, *one) for one in zip(x, dt, strict=True)],
        "y",
        "y_dot",
    )

    assert (y[:, 0] == x).all()
    assert (y[1:, 1] == np.diff(x) / dt[1:]).all()
    assert y[0, 1] == 0.0


def test_noise_comes_out_times_the_square_root_of_two_over_the_step():
    x = np.random.default_rng(4).uniform(-2, 2, 20_000)
    velocities = run(
        finite_difference, FiniteDifferenceState(), [FiniteDifferenceInputs(True, z, 0.05) for z in x], "y_dot"
    )
    # the variance of U(-2, 2) is 4/3; 20 000 samples know a standard deviation to 0.5 %
    assert np.std(velocities) == pytest.approx(np.sqrt(2 * 4 / 3) / 0.05, rel=0.02)


@pytest.mark.parametrize("dt", [0.0, -0.0, -1.0, np.nan, -np.inf])
def test_an_invalid_step_passes_through_and_the_next_one_reaches_over_it(dt: float):
    state, _ = finite_difference(FiniteDifferenceState(), FiniteDifferenceInputs(True, 1.0, 0.05))
    invalid, result = finite_difference(state, FiniteDifferenceInputs(True, 7.0, dt))
    after, _ = finite_difference(invalid, FiniteDifferenceInputs(True, 2.0, 0.5))

    assert (result, invalid.y, invalid.y_dot) == (Result.DT_INVALID, 7.0, 0.0)
    assert after.y_dot == 2.0


def test_the_first_scan_after_disable_is_at_rest():
    state, _ = finite_difference(FiniteDifferenceState(), FiniteDifferenceInputs(True, 1.0, 0.05))
    state, result = finite_difference(state, FiniteDifferenceInputs(False, 50.0, 0.05))
    assert (result, state.y, state.y_dot) == (Result.DISABLED, 50.0, 0.0)
    state, result = finite_difference(state, FiniteDifferenceInputs(True, 99.0, 0.05))
    assert (result, state.y, state.y_dot) == (Result.INITIALISED, 99.0, 0.0)
