"""The α-β filter: Kalata's gains against the Riccati equation and the settled Kalman filter, and the batch."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_are

from softplc.kernel.batch import alpha_beta as batch
from softplc.kernel.reference.alpha_beta import AlphaBetaInputs, AlphaBetaState, alpha_beta_lreal, alpha_beta_real
from softplc.kernel.reference.aoi import AoiInputs, AoiState, aoi_lreal
from softplc.kernel.result import Result
from softplc.kernel.steady import steady_gains
from tests.kernel.side_by_side import Axis, assert_batch_equals_reference, axes_of, run

PRECISIONS: list[tuple[Callable[..., Any], Any]] = [(alpha_beta_lreal, np.float64), (alpha_beta_real, np.float32)]
GRID = [(w, v, dt) for w in (0.01, 1.0, 30.0, 1000.0) for v in (0.01, 1.0, 20.0) for dt in (0.002, 0.05, 0.5)]


@pytest.mark.parametrize(("reference", "dtype"), PRECISIONS)
@settings(max_examples=60, deadline=None)
@given(
    axes=axes_of(
        lambda: st.builds(
            AlphaBetaInputs,
            st.just(True),
            st.just(0.0),
            st.just(0.0),
            st.booleans(),
            alpha=st.floats(0.0, 1.0),
            beta=st.floats(0.0, 4.0),
            sigma_w=st.floats(1e-3, 1e3),
            sigma_v=st.floats(1e-3, 1e3),
        )
    )
)
def test_batch_equals_reference(reference: Callable[..., Any], dtype: Any, axes: list[Axis]):
    first = [axis.inputs[0] for axis in axes]
    names = ("indexed", "alpha", "beta", "sigma_w", "sigma_v")
    tuning = batch.AlphaBetaTuning(dtype, **{name: [getattr(one, name) for one in first] for name in names})
    state = batch.AlphaBetaBatchState(len(axes), dtype)
    assert_batch_equals_reference(axes, reference, AlphaBetaState, batch, state, tuning)


def gains(sigma_w: float, sigma_v: float, dt: float) -> tuple[float, float, float]:
    """α, β and S that the filter uses for these."""
    state, _ = alpha_beta_lreal(
        AlphaBetaState(), AlphaBetaInputs(True, 0.0, dt, True, sigma_w=sigma_w, sigma_v=sigma_v)
    )
    return state.K0, state.K1 * dt, state.S


def model(sigma_w: float, dt: float) -> tuple[Any, Any]:
    """F and Q of an acceleration that is constant within each step."""
    g = np.array([[dt * dt / 2], [dt]])
    return np.array([[1.0, dt], [0.0, 1.0]]), sigma_w * sigma_w * g @ g.T


@pytest.mark.parametrize(("sigma_w", "sigma_v", "dt"), GRID)
def test_gains_from_the_tracking_index_are_those_of_the_riccati_equation(sigma_w: float, sigma_v: float, dt: float):
    F, Q = model(sigma_w, dt)
    H = np.array([[1.0, 0.0]])
    R = sigma_v * sigma_v
    # scaled to Δt = 1 and σv = 1, where the solver is well conditioned
    D = np.diag([1.0, dt]) / sigma_v
    P = solve_discrete_are((D @ F @ np.linalg.inv(D)).T, H.T, D @ Q @ D.T, np.eye(1))

    alpha, beta, S = gains(sigma_w, sigma_v, dt)

    expected = P[:, 0] / (P[0, 0] + 1.0)
    # with Λ = 1e-9 the solver itself has lost half the digits of gains as small as 1e-4
    assert (alpha, beta) == pytest.approx(tuple(expected), rel=1e-6, abs=1e-9)
    assert pytest.approx((P[0, 0] + 1.0) * R, rel=1e-7) == S


@pytest.mark.parametrize(("sigma_w", "sigma_v", "dt"), GRID)
def test_gains_satisfy_kalatas_relations(sigma_w: float, sigma_v: float, dt: float):
    index = sigma_w * dt * dt / sigma_v
    alpha, beta, S = gains(sigma_w, sigma_v, dt)
    assert beta * beta * S / (sigma_v * sigma_v) == pytest.approx(index * index, rel=1e-12)  # 1 - α is σv²/S
    # the right side cancels down to β for a small index: 1e-16 over the smallest β, some 1e-9, times its size
    assert beta == pytest.approx(2 * (2 - alpha) - 4 * np.sqrt(1 - alpha), rel=1e-9, abs=1e-15)
    assert 0 < alpha <= 1
    assert 0 < beta < 4 - 2 * alpha


def test_it_is_the_settled_kalman_filter_to_1e_9():
    dt, sigma_w, sigma_v = 0.05, 20.0, np.sqrt(4 / 3)
    rng = np.random.default_rng(2)
    z = 0.5 * np.arange(1000) + rng.uniform(-2, 2, 1000)
    F, Q = model(sigma_w, dt)
    kf = KalmanFilter(dim_x=2, dim_z=1)
    kf.x, kf.H, kf.F, kf.Q, kf.R = np.array([[z[0]], [0.0]]), np.array([[1.0, 0.0]]), F, Q, sigma_v**2
    expected = []
    for one in z:
        kf.predict()
        kf.update(one)
        expected.append([kf.x[0, 0], kf.x[1, 0], kf.S[0, 0]])

    given = [AlphaBetaInputs(True, one, dt, True, sigma_w=sigma_w, sigma_v=sigma_v) for one in z]
    got = run(alpha_beta_lreal, AlphaBetaState(), given, "y", "y_dot", "S")

    # the transients of both are gone after 500 scans: the poles are at 0.7
    np.testing.assert_allclose(got[500:], np.array(expected)[500:], rtol=0, atol=1e-9)


def test_with_the_settled_gains_of_the_AOI_it_is_the_AOI():
    q_x, q_x_dot, r_x, dt = 0.01, 0.1, 4 / 3, 0.05
    K0, K1 = steady_gains(q_x, q_x_dot, r_x, dt)
    z = 0.5 * np.arange(1000) + np.random.default_rng(3).uniform(-2, 2, 1000)

    aoi = run(aoi_lreal, AoiState(), [AoiInputs(True, one, 50.0, q_x, q_x_dot, r_x) for one in z], "y", "y_dot")
    fixed = [AlphaBetaInputs(True, one, dt, alpha=K0, beta=K1 * dt) for one in z]
    got = run(alpha_beta_lreal, AlphaBetaState(), fixed, "y", "y_dot")

    # numbers to 500, remembered for 20 scans; the AOI's transient is 0.91^500
    np.testing.assert_allclose(got[500:], aoi[500:], rtol=0, atol=1e-9)


def test_a_ramp_is_followed_without_error_at_any_steps():
    dt = np.random.default_rng(4).uniform(0.02, 0.08, 2000)
    x = 10.0 * np.cumsum(dt)
    for extra in ({"alpha": 0.3, "beta": 0.05}, {"indexed": True, "sigma_w": 30.0, "sigma_v": 1.0}):
        given = [AlphaBetaInputs(True, z, h, **extra) for z, h in zip(x, dt, strict=True)]  # type: ignore[arg-type]
        y = run(alpha_beta_lreal, AlphaBetaState(), given, "y", "y_dot")
        assert y[-1] == pytest.approx([x[-1], 10.0], abs=1e-9)


def test_first_scan_starts_at_the_measurement_at_rest():
    state, result = alpha_beta_lreal(AlphaBetaState(), AlphaBetaInputs(True, 5.0, 0.05, alpha=0.5, beta=0.2))
    assert (result, state.y, state.y_dot, state.y_res, state.S) == (Result.INITIALISED, 5.0, 0.0, 0.0, 0.0)


def test_disable_and_invalid_steps_touch_no_state():
    state, _ = alpha_beta_lreal(AlphaBetaState(), AlphaBetaInputs(True, 5.0, 0.05, alpha=0.5, beta=0.2))
    state, _ = alpha_beta_lreal(state, AlphaBetaInputs(True, 6.0, 0.05, alpha=0.5, beta=0.2))
    for enable, dt, expected in (
        (True, 0.0, Result.DT_INVALID),
        (True, np.nan, Result.DT_INVALID),
        (False, 0.05, Result.DISABLED),
    ):
        after, result = alpha_beta_lreal(state, AlphaBetaInputs(enable, 9.0, dt, alpha=0.5, beta=0.2))
        assert (result, after.y, after.y_dot, after.init) == (expected, 9.0, 0.0, enable)
        assert (after.x_pred, after.x_dot_pred) == (state.x_pred, state.x_dot_pred)


def test_innovations_are_as_large_as_S_says():
    """On its own model: an acceleration N(0, σw²) new in every step, measured with N(0, σv²)."""
    dt, sigma_w, sigma_v = 0.05, 20.0, 1.0
    rng = np.random.default_rng(5)
    F, _ = model(sigma_w, dt)
    state, z = np.zeros(2), []
    for w in rng.normal(0, sigma_w, 20_000):
        state = F @ state + np.array([dt * dt / 2, dt]) * w
        z.append(state[0] + rng.normal(0, sigma_v))
    given = [AlphaBetaInputs(True, one, dt, True, sigma_w=sigma_w, sigma_v=sigma_v) for one in z]
    y_res, S = run(alpha_beta_lreal, AlphaBetaState(), given, "y_res", "S")[100:].T
    assert np.mean(y_res * y_res / S) == pytest.approx(1.0, abs=0.05)  # five times √(2/20 000)


@pytest.mark.parametrize(("alpha", "beta"), [(0.1, 0.005), (0.3, 0.05), (0.5, 0.5), (0.9, 0.8)])
def test_noise_and_lag_are_those_of_the_closed_form(alpha: float, beta: float):
    """The table of docs/observers/baselines.md: sums over the impulse response, and a constant acceleration."""
    dt = 0.05
    impulse = np.concatenate([[0.0, 1.0], np.zeros(4000)])  # the first scan initialises
    given = [AlphaBetaInputs(True, z, dt, alpha=alpha, beta=beta) for z in impulse]
    y, y_dot = run(alpha_beta_lreal, AlphaBetaState(), given, "y", "y_dot").T
    D = alpha * (4 - 2 * alpha - beta)
    assert np.sum(y * y) == pytest.approx((2 * alpha * alpha + beta * (2 - 3 * alpha)) / D)
    assert np.sum(y_dot * y_dot) == pytest.approx(2 * beta * beta / D / (dt * dt))

    t = dt * np.arange(4000)
    given = [AlphaBetaInputs(True, z, dt, alpha=alpha, beta=beta) for z in 1.5 * t * t]  # 3 u/s²
    y, y_dot = run(alpha_beta_lreal, AlphaBetaState(), given, "y", "y_dot")[-1]
    # positions to 6e4 with a last place of 7e-12, velocities through β/Δt
    assert 1.5 * t[-1] ** 2 - y == pytest.approx(3 * dt * dt * (1 - alpha) / beta, abs=1e-8)
    assert 3 * t[-1] - y_dot == pytest.approx(3 * dt * (alpha / beta - 0.5), abs=1e-8)
