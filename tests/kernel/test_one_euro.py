"""The 1€ filter against the paper's algorithm written with its own classes, and the batch against the reference."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from softplc.kernel.batch import one_euro as batch
from softplc.kernel.reference.one_euro import OneEuroInputs, OneEuroState, one_euro
from softplc.kernel.result import Result
from tests.kernel.side_by_side import Axis, assert_batch_equals_reference, axes_of, run


@settings(max_examples=80, deadline=None)
@given(
    axes=axes_of(
        lambda: st.builds(
            OneEuroInputs,
            st.just(True),
            st.just(0.0),
            st.just(0.0),
            st.floats(1e-3, 100.0),
            st.floats(0.0, 10.0),
            st.floats(1e-3, 100.0),
            st.booleans(),
        )
    )
)
def test_batch_equals_reference(axes: list[Axis]):
    first = [axis.inputs[0] for axis in axes]
    names = ("min_cutoff", "beta", "d_cutoff", "filtered")
    tuning = batch.OneEuroTuning(**{name: [getattr(one, name) for one in first] for name in names})
    assert_batch_equals_reference(axes, one_euro, OneEuroState, batch, batch.OneEuroBatchState(len(axes)), tuning)


class LowPass:
    """Exponential smoothing, algorithm 2 of the paper."""

    def __init__(self) -> None:
        self.last: float | None = None

    def filter(self, value: float, alpha: float) -> float:
        self.last = value if self.last is None else alpha * value + (1.0 - alpha) * self.last
        return self.last


def alpha(rate: float, cutoff: float) -> float:
    """Algorithm 3."""
    tau = 1.0 / (2 * math.pi * cutoff)
    return 1.0 / (1.0 + tau * rate)


def algorithm_1(
    x: NDArray[np.float64], dt: NDArray[np.float64], min_cutoff: float, beta: float, d_cutoff: float
) -> NDArray[np.float64]:
    """The paper's filter and its smoothed derivative: it differences against the last filtered value."""
    xfilt, dxfilt, rows = LowPass(), LowPass(), []
    for z, step in zip(x, dt, strict=True):
        rate = 1.0 / step
        dx = 0.0 if xfilt.last is None else (z - xfilt.last) * rate
        edx = dxfilt.filter(dx, alpha(rate, d_cutoff))
        cutoff = min_cutoff + beta * abs(edx)
        rows.append([xfilt.filter(z, alpha(rate, cutoff)), edx])
    return np.array(rows)


def filtered(x: object, dt: object, filtered: bool = False, **tuning: float) -> NDArray[np.float64]:
    cutoffs = {"min_cutoff": 1.0, "beta": 0.1, "d_cutoff": 1.0, **tuning}
    given = [OneEuroInputs(True, z, h, filtered=filtered, **cutoffs) for z, h in zip(x, dt, strict=True)]  # type: ignore[call-overload]
    return run(one_euro, OneEuroState(), given, "y", "y_dot")


@pytest.mark.parametrize(
    "tuning", [{}, {"beta": 0.0}, {"min_cutoff": 0.1, "beta": 2.0, "d_cutoff": 5.0}, {"min_cutoff": 10.0}]
)
def test_it_is_the_algorithm_of_the_paper(tuning: dict[str, float]):
    rng = np.random.default_rng(1)
    x, dt = np.cumsum(rng.normal(size=500)), rng.uniform(0.01, 0.1, 500)
    expected = algorithm_1(x, dt, **{"min_cutoff": 1.0, "beta": 0.1, "d_cutoff": 1.0, **tuning})
    # some ten operations a scan on numbers to 1e3, of which the slowest filter remembers a hundred
    np.testing.assert_allclose(filtered(x, dt, filtered=True, **tuning), expected, rtol=0, atol=1e-10)


def test_published_example_by_hand():
    """1 Hz cutoffs, β = 0.5, 100 ms: 0 then 1. a(1 Hz) = 0.2π/(1 + 0.2π), v̂ = a·10, f = 1 + 0.5·v̂."""
    y = filtered([0.0, 1.0], [0.1, 0.1], beta=0.5)
    a = 0.2 * math.pi / (1 + 0.2 * math.pi)
    w = 0.2 * math.pi * (1 + 0.5 * 10 * a)
    assert y[1] == pytest.approx([w / (1 + w), 10 * a], rel=1e-14)


def test_the_velocity_of_a_ramp_is_exact_where_that_of_the_paper_is_several_times_too_high():
    x, dt = 0.5 * np.arange(2000), np.full(2000, 0.05)
    # with β = 0 the cutoff is 1 Hz: a = 0.1π/(1 + 0.1π) = 0.239
    assert filtered(x, dt, beta=0.0)[-1, 1] == pytest.approx(10.0, abs=1e-9)
    assert filtered(x, dt, filtered=True, beta=0.0)[-1, 1] == pytest.approx(10.0 / 0.239, rel=1e-3)


def test_without_slope_it_is_a_first_order_low_pass():
    """A step response of 1 − (1 − a)^k."""
    x = np.array([0.0] + [1.0] * 50)
    y = filtered(x, np.full(51, 0.05), beta=0.0)
    a = 1 / (1 + 1 / (2 * math.pi * 0.05))
    assert y[:, 0] == pytest.approx(1 - (1 - a) ** np.arange(51), abs=1e-14)


def test_slope_lessens_the_lag_of_motion_and_leaves_rest_alone():
    ramp, dt = 0.5 * np.arange(1000), np.full(1000, 0.05)
    lag = [float((ramp - filtered(ramp, dt, beta=beta)[:, 0])[-1]) for beta in (0.0, 0.1, 1.0)]
    assert lag == sorted(lag, reverse=True)
    assert lag[2] < 0.2 * lag[0]
    still = np.full(1000, 3.0)
    assert np.abs(filtered(still, dt, beta=1.0) - [3.0, 0.0]).max() < 1e-14  # a + (1 - a) is not quite 1


def test_first_scan_disable_and_invalid_steps():
    first, result = one_euro(OneEuroState(), OneEuroInputs(True, 5.0, 0.05, 1.0, 0.1, 1.0))
    assert (result, first.y, first.y_dot, first.cutoff) == (Result.INITIALISED, 5.0, 0.0, 1.0)
    frozen, result = one_euro(first, OneEuroInputs(True, 9.0, -1.0, 1.0, 0.1, 1.0))
    assert (result, frozen.y, frozen.y_dot, frozen.x_hat) == (Result.DT_INVALID, 9.0, 0.0, 5.0)
    off, result = one_euro(frozen, OneEuroInputs(False, 9.0, 0.05, 1.0, 0.1, 1.0))
    assert (result, off.init) == (Result.DISABLED, False)


@pytest.mark.parametrize("cutoff", [0.2, 1.0, 5.0])
def test_noise_at_rest_is_that_of_the_closed_form(cutoff: float):
    """The table of docs/observers/baselines.md: sums over the impulse response, at a cutoff that does not move."""
    impulse = np.concatenate([[0.0, 1.0], np.zeros(2000)])
    y, y_dot = filtered(impulse, np.full(2002, 0.05), min_cutoff=cutoff, beta=0.0, d_cutoff=cutoff).T
    a = 1 / (1 + 1 / (2 * math.pi * cutoff * 0.05))
    assert np.sum(y * y) == pytest.approx(a / (2 - a))
    assert np.sum(y_dot * y_dot) == pytest.approx(2 * a * a / (2 - a) / 0.05**2)
