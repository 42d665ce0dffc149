"""The moving average against numpy's convolution, its lag and its noise, and the batch against the reference."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from softplc.kernel.batch import moving_average as batch
from softplc.kernel.reference.moving_average import MovingAverageInputs, MovingAverageState, moving_average
from softplc.kernel.result import Result
from tests.kernel.side_by_side import Axis, assert_batch_equals_reference, axes_of, run


@settings(max_examples=80, deadline=None)
@given(
    axes=axes_of(lambda: st.builds(MovingAverageInputs, st.just(True), st.just(0.0), st.just(0.0), st.integers(2, 6)))
)
def test_batch_equals_reference(axes: list[Axis]):
    windows = [axis.inputs[0].window for axis in axes]
    state = batch.MovingAverageBatchState(len(axes), longest=max(windows))
    tuning = batch.MovingAverageTuning(window=windows)
    assert_batch_equals_reference(axes, moving_average, MovingAverageState, batch, state, tuning)


@pytest.mark.parametrize("n", [2, 5, 40])
def test_batch_equals_reference_over_long_runs_with_jitter(n: int):
    rng = np.random.default_rng(n)
    axes = [
        Axis(
            [
                MovingAverageInputs(True, x, dt, window)
                for x, dt in zip(np.cumsum(rng.normal(size=300)), rng.uniform(0.01, 0.1, 300), strict=True)
            ],
            (rng.random(300) < 0.9).tolist(),
        )
        for window in (n, 3)
    ]
    state, tuning = batch.MovingAverageBatchState(2, longest=max(n, 3)), batch.MovingAverageTuning(window=[n, 3])
    assert_batch_equals_reference(axes, moving_average, MovingAverageState, batch, state, tuning)


def averaged(x: NDArray[np.float64], dt: NDArray[np.float64], n: int) -> NDArray[np.float64]:
    inputs = [MovingAverageInputs(True, *one, n) for one in zip(x, dt, strict=True)]
    return run(moving_average, MovingAverageState(), inputs, "y", "y_dot")


@pytest.mark.parametrize("n", [2, 3, 10, 64])
def test_it_is_numpys_convolution_and_its_difference_over_the_measured_time(n: int):
    rng = np.random.default_rng(n)
    x, dt = np.cumsum(rng.normal(size=400)), rng.uniform(0.01, 0.1, 400)
    t = np.cumsum(dt)

    y = averaged(x, dt, n)

    means, times = (np.convolve(values, np.full(n, 1 / n), mode="valid") for values in (x, t))
    # values to 40, summed up to 64 times, each addition rounded to 1e-16 of the sum; the difference over 0.001 s
    np.testing.assert_allclose(y[n - 1 :, 0], means, rtol=0, atol=1e-12)
    np.testing.assert_allclose(y[n:, 1], np.diff(means) / np.diff(times), rtol=0, atol=1e-9)


def test_until_the_window_is_full_it_averages_what_is_there_and_says_so():
    state, results = MovingAverageState(), []
    for z in (0.0, 3.0, 6.0, 9.0, 12.0):
        state, result = moving_average(state, MovingAverageInputs(True, z, 0.5, 3))
        results.append((result, state.y, state.y_dot))

    assert results == [
        (Result.INITIALISED, 0.0, 0.0),
        (Result.WARMING_UP, 1.5, 6.0),
        (Result.WARMING_UP, 3.0, 6.0),
        (Result.UPDATED, 6.0, 6.0),
        (Result.UPDATED, 9.0, 6.0),
    ]


@pytest.mark.parametrize("n", [2, 7, 20])
def test_a_ramp_lags_by_half_the_window_less_one_and_its_speed_is_exact_under_jitter(n: int):
    even = averaged(0.5 * np.arange(100), np.full(100, 0.05), n)
    assert 0.5 * 99 - even[-1, 0] == pytest.approx(0.5 * (n - 1) / 2, abs=1e-12)

    dt = np.random.default_rng(1).uniform(0.02, 0.08, 100)
    jittered = averaged(10.0 * np.cumsum(dt), dt, n)
    assert jittered[n:, 1] == pytest.approx(np.full(100 - n, 10.0), abs=1e-11)


def test_noise_falls_with_the_window():
    n, x = 16, np.random.default_rng(2).uniform(-2, 2, 40_000)
    position, velocity = averaged(x, np.full(len(x), 0.05), n)[n:].T
    # consecutive means share all but one sample: 40 000/16 = 2 500 that are independent, thus 1.4 % of deviation
    assert np.std(position) == pytest.approx(np.sqrt(4 / 3 / n), rel=0.05)
    assert np.std(velocity) == pytest.approx(np.sqrt(2 * 4 / 3) / (n * 0.05), rel=0.05)


def test_a_large_number_is_forgotten_with_the_window():
    y = averaged(np.array([1.0] * 5 + [1e17] + [1.0] * 10), np.full(16, 0.05), 4)
    assert y[-1].tolist() == [1.0, 0.0]


def test_disable_forgets_the_window():
    inputs = [MovingAverageInputs(True, z, 0.1, 4) for z in (1.0, 2.0, 3.0, 4.0, 5.0)]
    state, fresh = MovingAverageState(), MovingAverageState()
    for one in (*inputs, dataclasses.replace(inputs[0], EnableIn=False)):
        state, _ = moving_average(state, one)
    for one in inputs:
        state, again = moving_average(state, one)
        fresh, first = moving_average(fresh, one)
        assert (again, state.y, state.y_dot) == (first, fresh.y, fresh.y_dot)


def test_finite_and_clear_reach_the_rings():
    state, tuning = batch.MovingAverageBatchState(2, longest=3), batch.MovingAverageTuning(window=[3, 3])
    every, dt = np.full(2, True), np.full(2, 0.1)
    for x in ([1.0, 1.0], [2.0, np.inf]):
        batch.step(state, tuning, EnableIn=every, x=np.array(x), dt=dt, rows=every)
    assert state.finite().tolist() == [True, False]

    state.clear(np.array([False, True]))
    assert state.finite().all()
    assert state.X[:, 1].tolist() == [0.0] * 3
    assert state.X[:2, 0].tolist() == [1.0, 2.0]
