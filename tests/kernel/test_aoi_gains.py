"""Where the AOI's gains settle, what they do in time, and what its investigation says of them."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from softplc.kernel.reference.aoi import AoiInputs, AoiState, aoi_lreal
from softplc.kernel.reference.aoi_options import AoiOptions
from softplc.kernel.result import Result
from softplc.kernel.steady import steady_gains
from tests.kernel.settled import riccati, settled, slowest_time_constant

R, T = 4 / 3, 0.05  # the tuning of the rows below, q_x 0.01 and q_x_dot 0.1, is meant for 50 ms
PERIODS = np.array([0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5])
GRID = [
    (q_x, q_x_dot, r_x, dt)
    for q_x in (0.0, 0.001, 0.1, 1.0)
    for q_x_dot in (0.01, 0.1, 10.0)
    for r_x in (0.01, 4 / 3, 100.0)
    for dt in (0.02, 0.05, 0.5)
]
WHITE = AoiOptions(white_accel=True, r_density=True)


def time_constants(q_x: object, q_x_dot: object, r_x: object, options: AoiOptions | None) -> NDArray[np.float64]:
    """Of the settled observer at each of PERIODS, seconds."""
    state = settled(q_x, q_x_dot, r_x, PERIODS, options)  # type: ignore[arg-type]
    return np.array([slowest_time_constant(*one) for one in zip(state.K0, state.K1, PERIODS, strict=True)])


def model(dt: float) -> NDArray[np.float64]:
    return np.array([[1.0, dt], [0.0, 1.0]])


def white_noise(q_x: float, q: float, dt: float) -> NDArray[np.float64]:
    """Covariance of a velocity driven by white noise of density q, and of a position by q_x, after dt."""
    return q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]) + np.diag([q_x * dt, 0.0])


def test_noise_per_scan_makes_another_observer_of_every_period():
    tau = dict(zip(PERIODS, time_constants(0.01, 0.1, R, None), strict=True))

    given_with_two_decimals = {0.002: 0.32, 0.05: 0.54, 0.5: 1.88}
    for period, expected in given_with_two_decimals.items():
        assert tau[period] == pytest.approx(expected, abs=0.005)


def test_process_noise_by_the_period_alone_is_not_invariant_either():
    tau = time_constants(0.01 / T, 0.1 / T, R, AoiOptions(q_exponents=(1, 1)))

    assert tau[[0, 4, 7]] == pytest.approx([0.29, 0.54, 1.02], abs=0.005)  # given with two decimals


def test_process_noise_by_the_period_and_measurement_noise_as_density_keep_the_time_constant_to_100_ms():
    tau = time_constants(0.01 / T, 0.1 / T, R * T, AoiOptions(q_exponents=(1, 1), r_density=True))

    assert tau[:6] == pytest.approx([0.535] * 6, rel=0.01)
    assert tau[7] == pytest.approx(0.527, rel=0.01)


@pytest.mark.parametrize(
    ("exponents", "expected"),
    [
        ((2, 1), [0.60, 0.59, 0.54, 0.49, 0.99]),
        ((1, 2), [1.45, 0.71, 0.54, 0.46, 0.31]),
        ((2, 2), [1.32, 0.85, 0.54, 0.43, 0.28]),
    ],
)
def test_no_reading_of_dt_and_dt_squared_keeps_the_time_constant(exponents: tuple[int, int], expected: list[float]):
    a, b = exponents
    tau = time_constants(0.01 / T**a, 0.1 / T**b, R * T, AoiOptions(q_exponents=exponents, r_density=True))

    assert tau[[0, 2, 4, 5, 7]] == pytest.approx(expected, abs=0.006)  # of the page of options, with two decimals


def test_white_acceleration_and_measurement_noise_as_density_keep_the_time_constant_at_every_period():
    tau = time_constants(0.0, 0.1 / T, R * T, WHITE)

    assert tau == pytest.approx([0.604] * len(PERIODS), rel=0.01)


@pytest.mark.parametrize("dt", [0.002, 0.05, 0.5])
def test_with_white_acceleration_two_half_steps_are_one_whole_step(dt: float):
    """Nothing is corrected at this r_x, so P is the prediction alone."""
    whole = settled(0.3, 2.0, 1e200, dt, AoiOptions(white_accel=True), scans=1)
    halves = settled(0.3, 2.0, 1e200, dt / 2, AoiOptions(white_accel=True), scans=2)

    for name in ("P0", "P1", "P2", "P3"):
        assert getattr(halves, name) == pytest.approx(getattr(whole, name), rel=1e-14)  # a few roundings


@pytest.mark.parametrize(
    ("options", "q_factor", "r_factor"),
    [(AoiOptions(q_exponents=(1, 1)), 1 / T, 1.0), (AoiOptions(q_exponents=(1, 1), r_density=True), 1 / T, T)],
)
def test_at_its_own_period_a_tuning_divided_by_it_is_the_same_observer(
    options: AoiOptions, q_factor: float, r_factor: float
):
    as_written = settled(0.01, 0.1, R, T, scans=400)
    scaled = settled(0.01 * q_factor, 0.1 * q_factor, R * r_factor, T, options, scans=400)

    np.testing.assert_allclose([scaled.K0, scaled.K1], [as_written.K0, as_written.K1], rtol=1e-12)


def test_exponents_of_each_entry_scale_that_entry_alone():
    state = settled(0.3, 0.7, 1e200, 0.5, AoiOptions(q_exponents=(2, 3)), scans=1)

    assert float(state.P0[0]) == pytest.approx(1 + 0.5**2 * 10 + 0.3 * 0.5**2, rel=1e-14)
    assert float(state.P3[0]) == pytest.approx(10 + 0.7 * 0.5**3, rel=1e-14)


def test_doubling_solves_the_riccati_equation_as_scipy_does():
    linalg = pytest.importorskip("scipy.linalg")
    for q_x, q_x_dot, r_x, dt in GRID:
        F, Q = model(dt), np.diag([q_x, q_x_dot])
        expected = linalg.solve_discrete_are(F.T, np.array([[1.0], [0.0]]), Q, np.array([[r_x]]))
        # both lose what the equation's condition costs; seen 2e-11 of scipy against the closed form
        np.testing.assert_allclose(riccati(F, Q, r_x), expected, rtol=1e-9)


def test_gains_of_108_tunings_settle_where_riccati_and_closed_form_say():
    q_x, q_x_dot, r_x, dt = np.array(GRID).T
    state = settled(q_x, q_x_dot, r_x, dt)

    for row, (a, b, r, step) in enumerate(GRID):
        P = riccati(model(step), np.diag([a, b]), r)
        by_riccati = P[:, 0] / (P[0, 0] + r)
        got = [state.K0[row], state.K1[row]]
        # 0.996^8000 of the start is 1e-14 for the slowest; rounding over the 500 scans it remembers 5e-14
        assert got == pytest.approx(steady_gains(a, b, r, step), rel=1e-12)
        assert got == pytest.approx(by_riccati, rel=1e-9)


def test_gains_of_108_tunings_with_white_acceleration_and_density_settle_where_riccati_says():
    q_x, q_x_dot, r_x, dt = np.array(GRID).T
    state = settled(q_x, q_x_dot, r_x, dt, WHITE)

    for row, (a, b, r, step) in enumerate(GRID):
        P = riccati(model(step), white_noise(a, b, step), r / step)
        assert [state.K0[row], state.K1[row]] == pytest.approx(P[:, 0] / (P[0, 0] + r / step), rel=1e-9)


@pytest.mark.parametrize("options", [None, WHITE, AoiOptions(joseph=True)])
def test_filterpy_leaves_the_settled_covariance_of_108_tunings_where_it_is(options: AoiOptions | None):
    q_x, q_x_dot, r_x, dt = np.array(GRID).T
    state = settled(q_x, q_x_dot, r_x, dt, options)

    for row, (a, b, r, step) in enumerate(GRID):
        kf = KalmanFilter(dim_x=2, dim_z=1)
        P = np.array([[state.P0[row], state.P1[row]], [state.P2[row], state.P3[row]]])
        kf.P, kf.H, kf.F = P.copy(), np.array([[1.0, 0.0]]), model(step)
        white = options is WHITE
        kf.Q, kf.R = (white_noise(a, b, step), r / step) if white else (np.diag([a, b]), r)
        kf.predict()
        kf.update(0.0)
        np.testing.assert_allclose(kf.K.ravel(), [state.K0[row], state.K1[row]], rtol=1e-11)
        np.testing.assert_allclose(kf.P, P, rtol=1e-9)  # P11 is a difference of numbers a hundred times larger


_variances = st.floats(1e-3, 1e3)
_periods = st.floats(1e-3, 1.0)


@settings(max_examples=300, deadline=None)
@given(q_x=st.one_of(st.just(0.0), _variances), q_x_dot=_variances, r_x=_variances, dt=_periods)
def test_settled_gains_fall_with_r_x_and_the_velocity_gain_rises_with_q_x_dot(
    q_x: float, q_x_dot: float, r_x: float, dt: float
):
    K0, K1 = steady_gains(q_x, q_x_dot, r_x, dt)
    noisier, quicker = steady_gains(q_x, q_x_dot, 1.1 * r_x, dt), steady_gains(q_x, 1.1 * q_x_dot, r_x, dt)

    assert noisier[0] < K0
    assert noisier[1] < K1
    assert quicker[1] > K1


_dts = st.lists(st.floats(1.0, 1000.0), min_size=1, max_size=30)


def runs(dts: list[float], q_x: float, q_x_dot: float, r_x: float) -> list[AoiState]:
    state, states = AoiState(), []
    for k, dt in enumerate(dts):
        state, result = aoi_lreal(state, AoiInputs(True, (-1.0) ** k, dt, q_x, q_x_dot, r_x))
        assert result != Result.S_NOT_POSITIVE
        states.append(state)
    return states


@settings(max_examples=100, deadline=None)
@given(dts=_dts, q_x=_variances, q_x_dot=_variances, r_x=_variances)
def test_from_the_same_covariance_a_larger_r_x_gives_smaller_gains(
    dts: list[float], q_x: float, q_x_dot: float, r_x: float
):
    state = runs(dts, q_x, q_x_dot, r_x)[-1]

    one, _ = aoi_lreal(state, AoiInputs(True, 0.0, 50.0, q_x, q_x_dot, r_x))
    other, _ = aoi_lreal(state, AoiInputs(True, 0.0, 50.0, q_x, q_x_dot, 1.1 * r_x))

    assert other.K0 < one.K0
    assert other.K1 < one.K1


@settings(max_examples=100, deadline=None)
@given(dts=_dts, q_x=_variances, q_x_dot=_variances, r_x=_variances)
def test_innovation_variance_is_positive_variances_are_not_negative_and_the_position_gain_is_a_fraction(
    dts: list[float], q_x: float, q_x_dot: float, r_x: float
):
    for state in runs(dts, q_x, q_x_dot, r_x):
        assert state.S > 0
        assert state.P[0] >= 0
        assert state.P[3] >= 0
        assert 0 <= state.K0 <= 1


@settings(max_examples=100, deadline=None)
@given(dt=st.floats(1e-3, 1e6), q_x=_variances, q_x_dot=_variances, r_x=_variances)
def test_one_prediction_couples_the_velocity_to_the_position(dt: float, q_x: float, q_x_dot: float, r_x: float):
    assert runs([dt], q_x, q_x_dot, r_x)[0].K1 > 0
