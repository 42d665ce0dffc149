"""The three-state observer against matrices, filterpy and the iterated Riccati equation; the batch against it."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from softplc.kernel.batch import cv_accel as batch
from softplc.kernel.reference.aoi import AoiInputs, AoiState, aoi_lreal
from softplc.kernel.reference.cv_accel import P_START, CvAccelInputs, CvAccelState, cv_accel
from softplc.kernel.result import Result
from tests.kernel.side_by_side import SPECIAL, Axis, assert_batch_equals_reference, axes_of, run

NAMES = ("r_x", "q_x", "q_x_dot", "q_x_ddot", "white_jerk", "q_jerk")
TUNINGS: list[dict[str, Any]] = [
    {"r_x": 4 / 3, "q_x": 0.001, "q_x_dot": 0.01, "q_x_ddot": 0.1},
    {"r_x": 0.01, "q_x": 0.0, "q_x_dot": 0.0, "q_x_ddot": 10.0},
    {"r_x": 4 / 3, "white_jerk": True, "q_jerk": 50.0},
    {"r_x": 0.1, "white_jerk": True, "q_jerk": 1e4},
]
_variances = st.one_of(st.floats(0.0, 100.0), st.sampled_from([*SPECIAL, -0.5]))


def tuning_of(inputs: list[CvAccelInputs]) -> batch.CvAccelTuning:
    return batch.CvAccelTuning(**{name: [getattr(one, name) for one in inputs] for name in NAMES})


@settings(max_examples=100, deadline=None)
@given(
    axes=axes_of(
        lambda: st.builds(
            CvAccelInputs,
            st.just(True),
            st.just(0.0),
            st.just(0.0),
            r_x=_variances,
            q_x=_variances,
            q_x_dot=_variances,
            q_x_ddot=_variances,
            white_jerk=st.booleans(),
            q_jerk=_variances,
        )
    )
)
def test_batch_equals_reference(axes: list[Axis]):
    tuning = tuning_of([axis.inputs[0] for axis in axes])
    assert_batch_equals_reference(axes, cv_accel, CvAccelState, batch, batch.CvAccelBatchState(len(axes)), tuning)


def test_batch_equals_reference_over_a_long_run_of_many_tunings():
    rng = np.random.default_rng(1)
    axes = []
    for k in range(12):
        r, *q = 10.0 ** rng.uniform(-4, 2, 5)
        one = CvAccelInputs(True, 0.0, 0.0, r, *q[:3], white_jerk=bool(k % 2), q_jerk=q[3])
        x, dt = np.cumsum(rng.normal(size=300)), rng.uniform(0.005, 0.1, 300)
        scans = [dataclasses.replace(one, x=z, dt=h) for z, h in zip(x, dt, strict=True)]
        axes.append(Axis(scans, [True] * 300))
    tuning = tuning_of([axis.inputs[0] for axis in axes])
    assert_batch_equals_reference(axes, cv_accel, CvAccelState, batch, batch.CvAccelBatchState(12), tuning)


def noisy_parabola(scans: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Measurements, and time steps in seconds that jitter."""
    rng = np.random.default_rng(11)
    dt = rng.uniform(0.02, 0.08, scans)
    t = np.cumsum(dt)
    return 0.5 * t * t + 10.0 * t + rng.uniform(-2, 2, scans), dt


def model(dt: float, tuning: dict[str, Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """F and Q; the white jerk's by numerical integration of its definition, exact for polynomials of this degree."""
    F = np.array([[1.0, dt, dt * dt / 2], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])
    if not tuning.get("white_jerk"):
        return F, np.diag([tuning["q_x"], tuning["q_x_dot"], tuning["q_x_ddot"]])
    nodes, weights = np.polynomial.legendre.leggauss(4)
    Q = np.zeros((3, 3))
    for node, weight in zip(nodes, weights, strict=True):
        s = (node + 1) * dt / 2
        g = np.array([[s * s / 2], [s], [1.0]])
        Q += weight * dt / 2 * tuning["q_jerk"] * g @ g.T
    return F, Q


def matrix_form(x: NDArray[np.float64], dt: NDArray[np.float64], tuning: dict[str, Any]) -> NDArray[np.float64]:
    H, state, P = np.array([[1.0, 0.0, 0.0]]), np.array([[x[0]], [0.0], [0.0]]), np.diag(P_START)
    rows = []
    for z, h in zip(x, dt, strict=True):
        F, Q = model(h, tuning)
        state, P = F @ state, F @ P @ F.T + Q
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + tuning["r_x"])
        state, P = state + K @ (z - H @ state), (np.eye(3) - K @ H) @ P
        rows.append([*state.ravel(), *K.ravel(), *P[np.triu_indices(3)]])
    return np.array(rows)


def filterpy_form(x: NDArray[np.float64], dt: NDArray[np.float64], tuning: dict[str, Any]) -> NDArray[np.float64]:
    """filterpy's KalmanFilter, which corrects the covariance in Joseph form."""
    kf = KalmanFilter(dim_x=3, dim_z=1)
    kf.x, kf.P, kf.H = np.array([[x[0]], [0.0], [0.0]]), np.diag(P_START), np.array([[1.0, 0.0, 0.0]])
    kf.R = tuning["r_x"]
    rows = []
    for z, h in zip(x, dt, strict=True):
        F, Q = model(h, tuning)
        kf.predict(F=F, Q=Q)
        kf.update(z)
        rows.append([*kf.x.ravel(), *kf.K.ravel(), *kf.P[np.triu_indices(3)]])
    return np.array(rows)


COLUMNS = ("y", "y_dot", "x_ddot_pred", "K0", "K1", "K2", "P00", "P01", "P02", "P11", "P12", "P22")


@pytest.mark.parametrize("form", [matrix_form, filterpy_form])
@pytest.mark.parametrize("tuning", TUNINGS)
def test_another_form_of_the_filter_gives_the_same_numbers(form: Any, tuning: dict[str, Any]):
    x, dt = noisy_parabola(1000)

    got = run(cv_accel, CvAccelState(), scans_of(x, dt, tuning), *COLUMNS)

    # positions to 2e3, last place 2e-13, times gains of 1e2 into the acceleration, over the scans it remembers
    np.testing.assert_allclose(got, form(x, dt, tuning), rtol=1e-9, atol=1e-9)


def iterated_riccati(dt: float, tuning: dict[str, Any]) -> NDArray[np.float64]:
    """The settled gains, by the matrix recursion from another start."""
    (F, Q), P, H = model(dt, tuning), np.eye(3), np.array([[1.0, 0.0, 0.0]])
    K = np.zeros((3, 1))
    for _ in range(20_000):
        P = F @ P @ F.T + Q
        S = H @ P @ H.T + tuning["r_x"]
        before, K = K, P @ H.T / S
        P = P - K @ S @ K.T
        P = (P + P.T) / 2  # or rounding's antisymmetric part would grow without bound
        if np.abs(K - before).max() < 1e-15:
            break
    return K.ravel()


@pytest.mark.parametrize("dt", [0.01, 0.05, 0.2])
@pytest.mark.parametrize("tuning", TUNINGS)
def test_gains_settle_at_those_of_the_iterated_riccati_equation(tuning: dict[str, Any], dt: float):
    inputs = [CvAccelInputs(True, 0.0, dt, **tuning)]
    state, rows = batch.CvAccelBatchState(1), np.full(1, True)
    for _ in range(5000):
        batch.step(state, tuning_of(inputs), EnableIn=rows, x=np.zeros(1), dt=np.full(1, dt), rows=rows)

    got = [float(values[0]) for values in (state.K0, state.K1, state.K2)]
    assert got == pytest.approx(iterated_riccati(dt, tuning).tolist(), rel=1e-9)


def test_white_jerk_keeps_its_bandwidth_where_noise_per_scan_does_not():
    """With r as a density too, the gains per second do not depend on the scan rate; per scan they do."""

    def slowest(dt: float, tuning: dict[str, Any]) -> float:
        F, _ = model(dt, tuning)
        poles = np.linalg.eigvals(F - iterated_riccati(dt, tuning)[:, np.newaxis] @ F[:1])
        return float(-dt / np.log(np.abs(poles).max()))

    white = [slowest(dt, {"r_x": 4 / 3 * 0.05 / dt, "white_jerk": True, "q_jerk": 50.0}) for dt in (0.002, 0.5)]
    per_scan = [slowest(dt, TUNINGS[0]) for dt in (0.002, 0.5)]

    assert white == pytest.approx([0.6635, 0.6635], rel=0.001)  # exact but for terms of (Δt/T)²
    assert per_scan[1] > 6 * per_scan[0]


def scans_of(x: NDArray[np.float64], dt: NDArray[np.float64], tuning: dict[str, Any]) -> list[CvAccelInputs]:
    return [CvAccelInputs(True, z, h, **tuning) for z, h in zip(x, dt, strict=True)]


def test_a_parabola_is_followed_without_error_at_any_steps():
    rng = np.random.default_rng(4)
    dt = rng.uniform(0.02, 0.08, 1500)
    t = np.cumsum(dt)
    x = 2.0 * t * t - 7.0 * t
    got = run(
        cv_accel,
        CvAccelState(),
        scans_of(x, dt, TUNINGS[1]),
        *COLUMNS[:3],
    )
    # positions to 1e4 with a last place of 2e-12, through gains of 7 and 40
    assert got[-1] == pytest.approx([x[-1], 4.0 * t[-1] - 7.0, 4.0], abs=1e-8)


def test_without_noise_on_the_acceleration_and_none_to_start_with_it_would_be_the_two_state_observer():
    """K2 = 0 when P22 = 0: shown on the arithmetic, from a state as the AOI's first scan leaves it."""
    aoi, _ = aoi_lreal(AoiState(), AoiInputs(True, 1.0, 50.0, 0.01, 0.1, 4 / 3))
    state = CvAccelState(True, aoi.x_pred, 0.0, 0.0, aoi.P[0], aoi.P[1], 0.0, aoi.P[3])
    for z in np.random.default_rng(5).normal(size=50):
        aoi, _ = aoi_lreal(aoi, AoiInputs(True, z, 50.0, 0.01, 0.1, 4 / 3))
        state, _ = cv_accel(state, CvAccelInputs(True, z, 0.05, 4 / 3, 0.01, 0.1, 0.0))
        assert (state.y, state.y_dot, state.x_ddot_pred) == pytest.approx((aoi.y, aoi.y_dot, 0.0), abs=1e-13)


def test_covariance_stays_positive_over_20_000_scans_of_any_length():
    n = len(TUNINGS)
    state = batch.CvAccelBatchState(n)
    tuning = tuning_of([CvAccelInputs(True, 0.0, 0.05, **one) for one in TUNINGS])
    every, rng = np.full(n, True), np.random.default_rng(6)
    for k in range(20_000):
        step = rng.choice([0.001, 0.05, 0.05, 0.05, 1.0])
        batch.step(state, tuning, EnableIn=every, x=np.full(n, 0.1 * k), dt=np.full(n, step), rows=every)
        if k % 100 == 0:
            names = (("P00", "P01", "P02"), ("P01", "P11", "P12"), ("P02", "P12", "P22"))
            P = np.array([[getattr(state, name) for name in row] for row in names])
            assert (np.linalg.eigvalsh(np.moveaxis(P, 2, 0)) > 0).all()


def first(**more: Any) -> tuple[CvAccelState, Result]:
    return cv_accel(CvAccelState(), CvAccelInputs(**{"EnableIn": True, "x": 3.0, "dt": 0.05, **TUNINGS[0], **more}))


def test_first_scan_initialises_predicts_and_updates():
    state, result = first()
    assert (result, state.y, state.y_dot, state.x_ddot_pred, state.y_res) == (Result.INITIALISED, 3.0, 0.0, 0.0, 0.0)
    assert min(state.K0, state.K1, state.K2) > 0


@pytest.mark.parametrize("dt", [0.0, -0.0, -1.0, -np.inf, np.nan])
def test_invalid_dt_passes_through_and_freezes_the_state_but_initialises_as_the_AOI_does(dt: float):
    state, result = first(dt=dt)
    assert (result, state.init, state.y, state.y_dot) == (Result.DT_INVALID, True, 3.0, 0.0)
    assert (*P_START, 0.0) == (state.P00, state.P11, state.P22, state.K0)

    going, _ = cv_accel(first()[0], CvAccelInputs(True, 4.0, 0.05, **TUNINGS[0]))
    frozen, result = cv_accel(going, CvAccelInputs(True, 9.0, dt, **TUNINGS[0]))
    assert (result, frozen.y, frozen.y_dot) == (Result.DT_INVALID, 9.0, 0.0)
    assert dataclasses.replace(frozen, y=going.y, y_dot=going.y_dot) == going


def test_innovation_variance_not_positive_puts_out_the_prediction_and_keeps_gains_and_covariance():
    going, _ = cv_accel(first()[0], CvAccelInputs(True, 4.0, 0.05, **TUNINGS[0]))
    after, result = cv_accel(going, CvAccelInputs(True, 9.0, 0.05, **{**TUNINGS[0], "r_x": -50.0}))

    assert (result, after.S < 0) == (Result.S_NOT_POSITIVE, True)
    h = 0.5 * 0.05 * 0.05
    assert after.y == going.x_pred + 0.05 * going.x_dot_pred + h * going.x_ddot_pred
    kept = ("P00", "P01", "P02", "P11", "P12", "P22", "K0", "K1", "K2", "x_ddot_pred")
    assert [getattr(after, name) for name in kept] == [getattr(going, name) for name in kept]


def test_enable_initialises_and_lets_no_old_value_through():
    state, fresh = first()[0], CvAccelState()
    for z in (4.0, 6.0, 9.0):
        state, _ = cv_accel(state, CvAccelInputs(True, z, 0.05, **TUNINGS[0]))
    state, result = cv_accel(state, CvAccelInputs(False, 8.0, 0.05, **TUNINGS[0]))
    assert (result, state.y, state.y_dot, state.init) == (Result.DISABLED, 8.0, 0.0, False)
    for z in (1.0, 2.0, 4.0):
        state, _ = cv_accel(state, CvAccelInputs(True, z, 0.05, **TUNINGS[0]))
        fresh, _ = cv_accel(fresh, CvAccelInputs(True, z, 0.05, **TUNINGS[0]))
    assert state == fresh
