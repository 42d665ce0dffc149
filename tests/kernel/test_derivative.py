"""The DERIVATIVE block against the standard's text and a least-squares line, with its weakness and the cure."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softplc.kernel.batch import derivative as batch
from softplc.kernel.reference.derivative import DerivativeInputs, DerivativeState, derivative_lreal, derivative_real
from softplc.kernel.result import Result
from tests.kernel.side_by_side import Axis, assert_batch_equals_reference, axes_of, run

T = 0.05
PRECISIONS: list[tuple[Callable[..., Any], Any]] = [(derivative_lreal, np.float64), (derivative_real, np.float32)]


@pytest.mark.parametrize(("reference", "dtype"), PRECISIONS)
@settings(max_examples=60, deadline=None)
@given(
    axes=axes_of(
        lambda: st.builds(
            DerivativeInputs, st.just(True), st.just(0.0), st.just(0.0), st.floats(1e-3, 1.0), st.booleans()
        )
    )
)
def test_batch_equals_reference(reference: Callable[..., Any], dtype: Any, axes: list[Axis]):
    first = [axis.inputs[0] for axis in axes]
    state = batch.DerivativeBatchState(len(axes), dtype)
    tuning = batch.DerivativeTuning(
        dtype, cycle=[one.cycle for one in first], measured=[one.measured for one in first]
    )
    assert_batch_equals_reference(axes, reference, DerivativeState, batch, state, tuning)


class Block:
    """FUNCTION_BLOCK DERIVATIVE as the standard prints it, with CYCLE in seconds; all variables 0 at power-up."""

    def __init__(self) -> None:
        self.XOUT = self.X1 = self.X2 = self.X3 = 0.0

    def __call__(self, RUN: bool, XIN: float, CYCLE: float) -> float:
        if RUN:
            self.XOUT = (3.0 * (XIN - self.X3) + self.X1 - self.X2) / (10.0 * CYCLE)
            self.X3 = self.X2
            self.X2 = self.X1
            self.X1 = XIN
        else:
            self.XOUT, self.X1, self.X2, self.X3 = 0.0, XIN, XIN, XIN
        return self.XOUT


def velocities(x: Any, dt: Any, *, measured: bool = False) -> Any:
    given = [DerivativeInputs(True, z, step, T, measured) for z, step in zip(x, dt, strict=True)]
    return run(derivative_lreal, DerivativeState(), given, "y_dot")[:, 0]


def test_it_is_the_block_of_the_standard_with_RUN_false_in_disabled_scans_and_in_the_first():
    rng = np.random.default_rng(6)
    block, state, running = Block(), DerivativeState(), False
    for z in np.cumsum(rng.normal(size=400)):
        enable = bool(rng.random() < 0.9)
        expected = block(enable and running, z, T)
        running = enable

        state, _ = derivative_lreal(state, DerivativeInputs(enable, z, rng.uniform(0.01, 0.1), T))

        assert (state.y, state.y_dot) == (z, expected)


def test_a_block_that_was_never_called_with_RUN_false_starts_with_a_spike_from_zero():
    assert Block()(True, 100.0, T) == pytest.approx(600.0)
    assert velocities([100.0], [T]).tolist() == [0.0]


def test_it_is_the_slope_of_the_least_squares_line_through_four_samples():
    x = np.cumsum(np.random.default_rng(7).normal(size=60))
    slopes = [np.polyfit(T * np.arange(4), x[k - 3 : k + 1], 1)[0] for k in range(3, 60)]
    # polyfit solves a 4 × 2 system, condition below 100, on values to 10
    np.testing.assert_allclose(velocities(x, np.full(60, T))[3:], slopes, rtol=0, atol=1e-11)


@pytest.mark.parametrize("measured", [False, True])
def test_a_ramp_reads_0_3_and_0_7_of_its_slope_until_four_samples_are_there(measured: bool):
    state, seen = DerivativeState(), []
    for k in range(5):
        state, result = derivative_lreal(state, DerivativeInputs(True, 0.5 * k, T, T, measured))
        seen.append((result, round(state.y_dot, 12)))

    assert seen == [
        (Result.INITIALISED, 0.0),
        (Result.WARMING_UP, 3.0),
        (Result.WARMING_UP, 7.0),
        (Result.UPDATED, 10.0),
        (Result.UPDATED, 10.0),
    ]


@pytest.mark.parametrize("real_period", [0.04, 0.0625, 0.1])
def test_with_a_nominal_cycle_the_speed_is_wrong_by_the_ratio_of_the_periods(real_period: float):
    x = 10.0 * real_period * np.arange(20)
    dt = np.full(20, real_period)
    assert velocities(x, dt)[-1] == pytest.approx(10.0 * real_period / T)
    assert velocities(x, dt, measured=True)[-1] == pytest.approx(10.0)


def test_measured_steps_read_a_ramp_exactly_under_jitter_where_the_nominal_cycle_does_not():
    dt = np.random.default_rng(8).uniform(0.02, 0.08, 500)
    x = 10.0 * np.cumsum(dt)
    assert velocities(x, dt, measured=True)[3:] == pytest.approx(np.full(497, 10.0), abs=1e-9)
    assert np.std(velocities(x, dt)[3:]) > 1.5


def test_one_late_sample_makes_the_nominal_block_jump():
    dt = np.where(np.arange(40) == 20, 5 * T, T)
    x = 10.0 * np.cumsum(dt)
    assert max(velocities(x, dt)) == pytest.approx(26.0)  # 10 + 0.4·40: the late step weighs 4/10 at its widest
    assert velocities(x, dt, measured=True)[3:] == pytest.approx(np.full(37, 10.0))


def test_noise_comes_out_times_the_square_root_of_a_fifth_over_the_cycle():
    x = np.random.default_rng(9).uniform(-2, 2, 20_000)
    assert np.std(velocities(x, np.full(len(x), T))[3:]) == pytest.approx(np.sqrt(0.2 * 4 / 3) / T, rel=0.02)


def test_real_rounds_every_operation():
    state = DerivativeState()
    for z in (0.1, 0.3, 0.7):
        state, _ = derivative_real(state, DerivativeInputs(True, z, T, T))
    f = np.float32
    expected = (f(3) * (f(0.7) - f(0.1)) + f(0.3) - f(0.1)) / (f(10) * f(T))
    assert (type(state.y_dot), state.y_dot) == (np.float32, expected)
