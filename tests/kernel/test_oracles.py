"""The AOI against the same filter written otherwise: matrices, filterpy, and the closed form of the steady gains."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray

from softplc.kernel.batch import aoi as batch
from softplc.kernel.reference.aoi import AoiInputs
from softplc.kernel.steady import steady_gains
from tests.kernel.sequences import OUTPUTS, run_reference

_GRID = [
    (q_x, q_x_dot, r_x, dt)
    for q_x in (0.0, 0.001, 0.1, 1.0)
    for q_x_dot in (0.01, 0.1, 10.0)
    for r_x in (0.01, 4 / 3, 100.0)
    for dt in (0.02, 0.05, 0.5)
]


def noisy_ramp(scans: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Measurements, and time steps in seconds that jitter."""
    rng = np.random.default_rng(11)
    dt = rng.uniform(0.02, 0.08, scans)
    return 10.0 * np.cumsum(dt) + rng.uniform(-2, 2, scans), dt


def matrix_form(
    x: NDArray[np.float64], dt: NDArray[np.float64], Q: NDArray[np.float64], R: float
) -> NDArray[np.float64]:
    """Textbook predict and correct with matrices, equations (4), (6), (14) to (16); float64[scans, 6]."""
    H, identity = np.array([[1.0, 0.0]]), np.eye(2)
    state, P = np.array([[x[0]], [0.0]]), np.diag([1.0, 10.0])
    rows = []
    for z, step in zip(x, dt, strict=True):
        F = np.array([[1.0, step], [0.0, 1.0]])
        state, P = F @ state, F @ P @ F.T + Q
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        state, P = state + K @ (z - H @ state), (identity - K @ H) @ P
        rows.append([*state.ravel(), *K.ravel(), P[0, 0], P[1, 1]])
    return np.array(rows)


def filterpy_form(
    x: NDArray[np.float64], dt: NDArray[np.float64], Q: NDArray[np.float64], R: float
) -> NDArray[np.float64]:
    """filterpy's KalmanFilter, which corrects the covariance in Joseph form."""
    kf = KalmanFilter(dim_x=2, dim_z=1)
    kf.x, kf.P, kf.H, kf.R, kf.Q = np.array([[x[0]], [0.0]]), np.diag([1.0, 10.0]), np.array([[1.0, 0.0]]), R, Q
    rows = []
    for z, step in zip(x, dt, strict=True):
        kf.predict(F=np.array([[1.0, step], [0.0, 1.0]]))
        kf.update(z)
        rows.append([*kf.x.ravel(), *kf.K.ravel(), kf.P[0, 0], kf.P[1, 1]])
    return np.array(rows)


@pytest.mark.parametrize("form", [matrix_form, filterpy_form])
def test_another_form_of_the_filter_gives_the_same_numbers(form: object):
    x, dt = noisy_ramp(1000)

    outputs, _ = run_reference(
        [AoiInputs(True, z, 1000 * step, 0.01, 0.1, 4 / 3) for z, step in zip(x, dt, strict=True)], "lreal"
    )
    expected = form(x, dt, np.diag([0.01, 0.1]), 4 / 3)  # type: ignore[operator]

    # |x| reaches 500, whose last place is 6e-14; the filter remembers some 20 scans of such rounding
    columns = [OUTPUTS.index(name) for name in ("y", "y_dot", "K0", "K1", "P0", "P3")]
    np.testing.assert_allclose(outputs[:, columns], expected, rtol=0, atol=2e-12)


def test_gains_settle_at_the_closed_form():
    n = len(_GRID)
    q_x, q_x_dot, r_x, dt = np.array(_GRID).T
    state = batch.AoiBatchState(n)
    no_bleed = {"BleedEnable": np.zeros(n, bool), "BleedThresh": np.zeros(n), "BleedFactor": np.ones(n)}
    tuning = batch.AoiTuning(np.float64, q_x=q_x, q_x_dot=q_x_dot, r_x=r_x, **no_bleed)
    every = np.full(n, True)
    for _ in range(8_000):  # the slowest, q_x 1, q_x_dot 0.01 at 20 ms, has a pole at 0.998: P forgets with 0.996
        batch.step(state, tuning, EnableIn=every, x=np.zeros(n), dt=1000 * dt, rows=every)

    expected = np.array([steady_gains(*one) for one in _GRID])

    # what is left of the start is 0.996^8000 = 1e-14; rounding of 1e-16 a scan over the 500 remembered ones 5e-14
    np.testing.assert_allclose(np.array([state.K0, state.K1]).T, expected, rtol=1e-12)


@pytest.mark.parametrize(("dt", "bandwidth"), [(0.002, 21.0), (0.01, 7.6), (0.02, 5.1), (0.05, 3.1), (0.1, 2.1)])
def test_noise_per_scan_makes_the_bandwidth_depend_on_the_period(dt: float, bandwidth: float):
    assert steady_gains(0.001, 0.1, 4 / 3, dt)[0] / dt == pytest.approx(bandwidth, rel=0.03)  # given with two digits


def slowest_time_constant(q_x: float, q_x_dot: float, r_x: float, dt: float) -> float:
    """Of the α-β filter with the settled gains: its slowest pole, in seconds."""
    K0, K1 = steady_gains(q_x, q_x_dot, r_x, dt)
    return float(-dt / np.log(np.abs(np.roots([1, -(2 - K0 - dt * K1), 1 - K0])).max()))


@pytest.mark.parametrize(("dt", "unscaled"), [(0.002, 0.09), (0.01, 0.25), (0.05, 0.60), (0.1, 0.85)])
def test_noise_scaled_with_the_period_keeps_the_time_constant(dt: float, unscaled: float):
    factor = dt / 0.05

    assert slowest_time_constant(0.001, 0.1, 4 / 3, dt) == pytest.approx(unscaled, abs=0.005)  # two decimals
    scaled = slowest_time_constant(0.001 * factor, 0.1 * factor, 4 / 3 / factor, dt)
    assert scaled == pytest.approx(0.5955, abs=0.001)  # exact but for terms of (K0)²


def test_real_stays_within_single_precision_of_lreal_over_the_canonical_run():
    truth = np.cumsum(np.repeat([0.5, 0.0, 0.5, 0.0], 300))
    x = truth + np.random.default_rng(0).uniform(-2, 2, 1200)
    inputs = [AoiInputs(True, z, 50.0, 0.01, 0.1, 4 / 3) for z in x]

    double, _ = run_reference(inputs, "lreal")
    single, _ = run_reference(inputs, "real")

    # x reaches 300, whose last place in single precision is 3e-5; K1/(1 - 0.83) of it ends up in the velocity,
    # seen 1e-4: a slip of one literal into double precision, or of a product into a fused one, stays below that too,
    # so this guards the size alone; the bits are guarded by the vectors
    assert np.abs(double[:, 1] - single[:, 1]).max() < 2e-4


def test_real_loses_the_counts_above_two_to_the_24():
    """Each count is 1, the numbers next to 2^25 are 4 apart: why such an axis belongs in LREAL."""
    x = 2.0**25 + 0.5 * np.arange(400)
    inputs = [AoiInputs(True, z, 50.0, 0.01, 0.1, 4 / 3) for z in x]

    assert run_reference(inputs, "lreal")[0][-1, 1] == pytest.approx(10.0, abs=1e-6)
    errors = np.abs(run_reference(inputs, "real")[0][100:, 1] - 10.0)
    assert errors.max() > 0.5
