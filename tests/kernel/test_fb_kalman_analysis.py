"""What FB_KalmanFilter is and what it costs: the analysis of docs/observers/fb_kalman.md, number by number."""

import re
from pathlib import Path

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

from softplc.kernel.reference.fb_kalman import FbKalmanInputs
from softplc.kernel.steady import steady_gains
from tests.kernel.fb_kalman_sequences import EVERYTHING, run_batch, run_reference, states

DT, R = 0.1, 1.0
_GRID = [
    (Q, r, dt) for Q in (1e-4, 1e-3, 0.01, 0.1, 1.0) for r in (0.01, 1.0, 4 / 3, 100.0) for dt in (0.02, 0.1, 0.5)
]


PAGE = Path(__file__).parents[2] / "docs" / "observers" / "fb_kalman.md"


def column(name: str) -> int:
    return EVERYTHING.index(name)


def filterpy_form(scans: list[FbKalmanInputs]) -> NDArray[np.float64]:
    """filterpy's KalmanFilter with Q = diag(0, Q), from 0 at rest with P = I; float64[scans, 7]."""
    kf = KalmanFilter(dim_x=2, dim_z=1)
    kf.x, kf.P, kf.H = np.zeros((2, 1)), np.eye(2), np.array([[1.0, 0.0]])
    rows = []
    for scan in scans:
        kf.predict(F=np.array([[1.0, scan.DeltaT], [0.0, 1.0]]), Q=np.diag([0.0, scan.Q]))
        kf.update(scan.MeasuredPosition, R=scan.R)
        rows.append([*kf.x.ravel(), *kf.K.ravel(), kf.P[0, 0], kf.P[0, 1], kf.P[1, 1]])
    return np.array(rows)


def test_corrected_is_the_kalman_filter_from_the_first_scan_on_for_any_time_steps_and_tuning():
    rng = np.random.default_rng(11)
    dt = rng.uniform(0.02, 0.2, 1000)
    z = 3.0 * np.cumsum(dt) + rng.normal(size=1000)
    tuning = np.repeat([0.1, 0.01], 500), np.repeat([1.0, 2.0], 500)
    scans = [FbKalmanInputs(*one) for one in zip(z, *tuning, dt, strict=True)]

    outputs, _ = run_reference(scans, "lreal", "corrected")

    columns = [column(name) for name in ("x_pos", "x_vel", "KalmanGain", "k_vel", "p_11", "p_12", "p_22")]
    # |x| reaches 330, whose last place is 6e-14; the filter remembers some 30 scans of such rounding
    np.testing.assert_allclose(outputs[:, columns], filterpy_form(scans), rtol=0, atol=2e-12)


def test_the_cure_printed_on_the_page_is_the_corrected_kernel_in_every_bit_of_a_real():
    """The Structured Text of the page, run line by line: each is one assignment, which Python reads as it stands."""
    found = re.search(r"```pascal\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert found is not None
    cure = found.group(1).replace(":=", "=").replace("//", "#")
    predict = """
x_pos = x_pos + DeltaT * x_vel
p_11 = p_11 + DeltaT * (DeltaT * p_22 + 2 * p_12)
p_12 = p_12 + DeltaT * p_22
p_22 = p_22 + Q
"""
    real = np.float32
    block = {"x_pos": real(0), "x_vel": real(0), "p_11": real(1), "p_12": real(0), "p_22": real(1)}
    z, dt = np.cumsum(np.random.default_rng(4).normal(size=500)), np.random.default_rng(5).uniform(0.01, 0.3, 500)

    outputs, _ = run_reference(
        [FbKalmanInputs(a, 0.1, 1.0, b) for a, b in zip(z, dt, strict=True)], "real", "corrected"
    )

    for k in range(500):
        block.update(MeasuredPosition=real(z[k]), Q=real(0.1), R=real(1.0), DeltaT=real(dt[k]))
        exec(predict + cure, {}, block)
        for name in ("x_pos", "x_vel", "KalmanGain", "p_11", "p_12", "p_22", "k_vel"):
            assert outputs[k, column(name)] == block[name], (k, name)


def test_covariance_and_position_gain_of_both_settle_where_the_kalman_filter_does():
    """As written, p_22 = (2 − K)Q/K after the update: two errors that cancel once the gains have settled."""
    settled = {}
    for variant in ("as_written", "corrected"):
        outputs, _ = run_batch([[FbKalmanInputs(0.0, *one)] * 3000 for one in _GRID], "lreal", variant)  # type: ignore[arg-type]
        settled[variant] = np.array([sequence[-1] for sequence in outputs])

    for row, (Q, r, dt) in enumerate(_GRID):
        F, H = np.array([[1.0, dt], [0.0, 1.0]]), np.array([[1.0, 0.0]])
        ahead = solve_discrete_are(F.T, H.T, np.diag([0.0, Q]), np.array([[r]]))
        K = ahead @ H.T / (ahead[0, 0] + r)
        P = (np.eye(2) - K @ H) @ ahead
        for variant in settled:
            # scipy's solver is good for 1e-8 where the poles are near 1; 3 000 scans leave less of the start
            got = settled[variant][row]
            assert got[column("KalmanGain")] == pytest.approx(K[0, 0], rel=1e-7)
            assert got[[column(p) for p in ("p_11", "p_12", "p_22")]] == pytest.approx(
                P[[0, 0, 1], [0, 1, 1]], rel=1e-7
            )
        K0, K1 = steady_gains(0.0, Q, r, dt)
        assert settled["corrected"][row][column("k_vel")] == pytest.approx(K1, rel=1e-7)
        assert dt * K1 == pytest.approx(K0 * K0 / (2 - K0), rel=1e-9)  # β = α²/(2 − α)


def gains(Q: float, variant: str) -> tuple[float, float]:
    """Settled α and β of the block: its own gains on the innovation, the second times Δt."""
    last = states([FbKalmanInputs(0.0, Q, R, DT)] * 4000, variant)[-1]
    return float(last.KalmanGain), DT * float(last.k_vel)


def test_gain_of_the_example_settles_at_this_number():
    alpha, beta = gains(0.1, "as_written")

    assert alpha == pytest.approx(0.22261290769865, abs=1e-14)  # given with 14 digits
    assert beta == pytest.approx(alpha * (1 - alpha), rel=1e-14)
    assert gains(0.1, "corrected")[0] == pytest.approx(alpha, rel=1e-13)


def test_velocity_moves_by_k_times_one_minus_k_over_dt_times_the_innovation():
    rng = np.random.default_rng(2)
    outputs, _ = run_reference([FbKalmanInputs(z, 0.1, 1.0, 0.1) for z in rng.normal(size=200)], "lreal")

    moved = np.diff(outputs[:, column("x_vel")])
    K, y = outputs[1:, column("KalmanGain")], outputs[1:, column("y_res")]

    # a difference of velocities around 10, whose last place is 2e-15
    np.testing.assert_allclose(moved, K * (1 - K) / 0.1 * y, rtol=0, atol=2e-13)
    np.testing.assert_allclose(moved, outputs[1:, column("k_vel")] * y, rtol=0, atol=2e-13)


def poles(alpha: float, beta: float) -> NDArray[np.complex128]:
    return np.roots([1.0, -(2.0 - alpha - beta), 1.0 - alpha])


def damping(alpha: float, beta: float) -> float:
    """ζ of the slower pole, mapped to continuous time."""
    s = np.log(poles(alpha, beta).astype(complex))
    return float((-s.real / np.abs(s)).min())


def test_poles_and_damping_of_the_example():
    alpha, beta = gains(0.1, "as_written")

    assert poles(alpha, beta)[0] == pytest.approx(0.802 + 0.366j, abs=1e-3)
    assert damping(alpha, beta) == pytest.approx(0.28, abs=5e-3)


@pytest.mark.parametrize(("K", "zeta"), [(0.05, 0.116), (0.1, 0.17), (0.2, 0.26), (0.5, 0.58)])
def test_damping_is_about_half_the_root_of_the_gain(K: float, zeta: float):
    assert damping(K, K * (1 - K)) == pytest.approx(zeta, abs=5e-3)  # given with two decimals
    assert damping(K, K * (1 - K)) / (np.sqrt(K) / 2) == pytest.approx(1 + 0.75 * K, abs=1.2 * K * K)  # the next term


def test_poles_are_real_only_above_a_gain_of_0_7044():
    """(2 − α − β)² = 4(1 − α) with β = α(1 − α), so K³ − 4K² + 8K − 4 = 0."""
    (limit,) = [root.real for root in np.roots([1, -4, 8, -4]) if abs(root.imag) < 1e-12]

    assert limit == pytest.approx(0.7044, abs=1e-4)
    assert np.abs(poles(limit - 1e-3, (limit - 1e-3) * (1 - limit + 1e-3)).imag).max() > 0
    assert np.abs(poles(limit + 1e-3, (limit + 1e-3) * (1 - limit - 1e-3)).imag).max() == 0


def test_stable_for_every_gain_between_0_and_1():
    for K in np.linspace(0.001, 0.999, 500):
        beta = K * (1 - K)
        assert np.abs(poles(K, beta)).max() < 1
        assert 4 - 2 * K - beta == pytest.approx(4 - 3 * K + K * K)
        assert (beta > K * K / (2 - K)) == (2 - np.sqrt(2) > K)  # too large below α = 2 − √2 = 0.586, too small above


_EFFECT = [  # Q, then damping and overshoot as written and corrected, with the digits of the page
    (0.1, (0.28, 0.41), (0.71, 0.18)),
    (0.01, (0.20, 0.53), (0.71, 0.19)),
    (0.001, (0.15, 0.64), (0.71, 0.20)),
    (0.0001, (0.11, 0.71), (0.71, 0.20)),
]


@pytest.mark.parametrize(("Q", "written", "corrected"), _EFFECT)
def test_damping_and_overshoot_of_a_step(Q: float, written: tuple[float, float], corrected: tuple[float, float]):
    scans = [FbKalmanInputs(0.0, Q, R, DT)] * 2000 + [FbKalmanInputs(1.0, Q, R, DT)] * 400
    for variant, expected in (("as_written", written), ("corrected", corrected)):
        overshoot = max(state.x_pos for state in states(scans, variant)) - 1

        assert (damping(*gains(Q, variant)), overshoot) == pytest.approx(expected, abs=5e-3)


@pytest.mark.parametrize("variant", ["as_written", "corrected"])
def test_a_ramp_leaves_no_error_once_settled(variant: str):
    outputs, _ = run_reference([FbKalmanInputs(0.3 * k, 0.1, R, DT) for k in range(400)], "lreal", variant)

    assert outputs[-1, :2] == pytest.approx([0.3 * 399, 3.0], rel=1e-12)  # poles of 0.88: 0.88^400 is 1e-22


def velocity_noise(alpha: float, beta: float) -> float:
    """Standard deviation of Δt·v̂ for white noise of 1 on the measurement: √(2β²/(α(4 − 2α − β)))."""
    return float(np.sqrt(2 * beta * beta / (alpha * (4 - 2 * alpha - beta))))


@pytest.mark.parametrize(("Q", "ratio"), [(0.1, 6.34), (0.01, 12.47), (1e-3, 23.4), (1e-4, 43.0)])
def test_velocity_is_that_much_noisier_than_optimal(Q: float, ratio: float):
    assert velocity_noise(*gains(Q, "as_written")) / velocity_noise(*gains(Q, "corrected")) == pytest.approx(
        ratio, rel=2e-3
    )


def test_the_formula_of_the_velocity_noise_is_what_a_long_run_gives():
    z = np.random.default_rng(1).normal(size=40_000)
    for variant in ("as_written", "corrected"):
        outputs, _ = run_reference([FbKalmanInputs(one, 0.1, R, DT) for one in z], "lreal", variant)

        expected = velocity_noise(*gains(0.1, variant)) / DT
        # 40 000 scans are some 4 000 independent velocities: 1 % of the standard deviation, three times that
        assert outputs[200:, 1].std() == pytest.approx(expected, rel=0.03)
