"""The AOI's behaviour as its documents state it, on the reference; the batch is held equal elsewhere."""

import math

import numpy as np
import pytest

from softplc.kernel.reference.aoi import AoiInputs, AoiState, aoi_lreal
from softplc.kernel.result import Result

R = 4 / 3


def run(xs: object, state: AoiState | None = None, **tuning: float) -> list[AoiState]:
    """States after each measurement, at dt = 50 ms unless told otherwise."""
    settings = {"dt": 50.0, "q_x": 0.01, "q_x_dot": 0.1, "r_x": R, **tuning}
    state, states = state or AoiState(), []
    for x in xs:  # type: ignore[attr-defined]
        state, _ = aoi_lreal(state, AoiInputs(True, float(x), **settings))  # type: ignore[arg-type]
        states.append(state)
    return states


def test_golden_scans():
    states = run([0, 1, 2, 3, 4])

    def close(values: list[float]) -> object:
        return pytest.approx(values, rel=0, abs=6e-11)  # they are printed with ten decimals

    K0 = [0.4370161858, 0.3263124558, 0.2814199548, 0.2653261514, 0.2619631637]
    K1 = [0.2111189303, 0.3947205724, 0.5473413764, 0.6591669316, 0.7256588025]
    assert [s.K0 for s in states] == close(K0)
    assert [s.K1 for s in states] == close(K1)
    assert [s.y for s in states] == close([0, 0.3263124558, 0.8115034452, 1.4399224914, 2.2101937067])
    assert [s.y_dot for s in states] == close([0, 0.3947205724, 1.2999966714, 2.6997354893, 4.4595239275])
    assert list(states[-1].P) == close([0.3492842182, 0.9675450700, 0.9675450700, 7.7903222300])


def test_disabled_passes_through_and_touches_nothing_but_init():
    before = run([0, 1, 2])[-1]

    after, result = aoi_lreal(before, AoiInputs(False, 7.0, 50.0, 0.01, 0.1, R))

    assert result == Result.DISABLED
    assert (after.y, after.y_dot, after.init) == (7.0, 0.0, False)
    kept = ("dt_s", "x_pred", "x_dot_pred", "P", "K0", "K1", "S", "y_res")
    assert [getattr(after, name) for name in kept] == [getattr(before, name) for name in kept]


def test_enable_initialises_once_and_lets_no_old_value_through():
    disabled, _ = aoi_lreal(run(np.arange(100.0))[-1], AoiInputs(False, 7.0, 50.0, 0.01, 0.1, R))

    again = run([7.0, 7.5, 8.0], disabled)
    fresh = run([7.0, 7.5, 8.0])

    assert again == fresh


def test_first_enabled_scan_initialises_predicts_and_updates():
    state, result = aoi_lreal(AoiState(), AoiInputs(True, 3.0, 50.0, 0.01, 0.1, R))

    assert result == Result.INITIALISED
    assert (state.y, state.y_dot, state.y_res) == (3.0, 0.0, 0.0)
    assert state.K0 > 0
    assert state.K1 > 0
    assert state.P != (1.0, 0.0, 0.0, 10.0)


@pytest.mark.parametrize("dt", [0.0, -0.0, -1.0, -math.inf, math.nan, 5e-324])
def test_invalid_dt_passes_through_without_dividing_and_freezes_the_state(dt: float):
    before = run([0, 1, 2])[-1]

    after, result = aoi_lreal(before, AoiInputs(True, 9.0, dt, 0.01, 0.1, R))

    assert result == Result.DT_INVALID
    assert (after.y, after.y_dot, after.init) == (9.0, 0.0, True)
    assert (after.x_pred, after.x_dot_pred, after.P) == (before.x_pred, before.x_dot_pred, before.P)


def test_initialises_also_while_dt_is_invalid_and_starts_from_that_old_position():
    first, result = aoi_lreal(AoiState(), AoiInputs(True, 3.0, 0.0, 0.01, 0.1, R))
    second = run([4.0], first)[0]

    assert result == Result.DT_INVALID
    assert (first.init, first.x_pred, first.P, first.K0) == (True, 3.0, (1.0, 0.0, 0.0, 10.0), 0.0)
    assert second.y_res == 1.0


def test_innovation_variance_not_positive_puts_out_the_prediction_and_keeps_gains_and_covariance():
    before = run([0, 1, 2, 3])[-1]

    after, result = aoi_lreal(before, AoiInputs(True, 9.0, 50.0, 0.01, 0.1, -5.0))

    assert result == Result.S_NOT_POSITIVE
    assert after.S < 0
    assert after.y == before.x_pred + 0.05 * before.x_dot_pred
    assert (after.y_dot, after.K0, after.K1, after.P) == (before.y_dot, before.K0, before.K1, before.P)


def test_time_is_lost_while_dt_is_invalid():
    """After 20 such scans on a ramp of 10 u/s the block jumps back to 101.7: why the service accumulates time."""
    ramp = 0.5 * np.arange(221)  # 10 u/s at 50 ms
    state = run(ramp[:201])[-1]
    for x in ramp[201:220]:
        state, _ = aoi_lreal(state, AoiInputs(True, x, 0.0, 0.01, 0.1, R))
        assert state.y == x
    lost = run([ramp[220]], state)[0]
    kept, _ = aoi_lreal(run(ramp[:201])[-1], AoiInputs(True, ramp[220], 1000.0, 0.01, 0.1, R))

    assert (lost.y, lost.y_dot) == (pytest.approx(102, abs=0.5), pytest.approx(12.4, abs=0.2))
    assert (kept.y, kept.y_dot) == (pytest.approx(110, abs=1e-3), pytest.approx(10, abs=1e-3))


def test_velocity_converges_to_the_slope_of_a_ramp():
    assert run(0.5 * np.arange(600))[-1].y_dot == pytest.approx(10.0, abs=1e-6)  # transient 0.83^n is long over


def test_position_smooths_a_step_and_velocity_spikes_then_settles():
    states = run([0.0] * 200 + [10.0] * 600)
    step = states[200:]

    assert 0 < step[0].y < 3
    assert max(s.y_dot for s in step) > 5
    assert (step[-1].y, step[-1].y_dot) == (pytest.approx(10, abs=1e-6), pytest.approx(0, abs=1e-6))


def overshoot(**bleed: float) -> float:
    """How far the estimate runs past a stop from 10 u/s."""
    return max(s.y for s in run(np.concatenate([0.5 * np.arange(300), np.full(300, 149.5)]), **bleed)) - 149.5


def test_bleed_lessens_the_overshoot_at_a_stop():
    without = overshoot()
    with_bleed = overshoot(BleedEnable=True, BleedThresh=1.0, BleedFactor=0.9)

    assert without > 1.5
    assert with_bleed < 0.5 * without


@pytest.mark.parametrize(("threshold", "velocity"), [(0.5, 7.1), (1.0, 5.9), (2.0, 4.8)])
def test_bleed_makes_a_well_tracked_ramp_of_10_u_per_s_read_low(threshold: float, velocity: float):
    xs = 0.5 * np.arange(4000) + np.random.default_rng(0).uniform(-2, 2, 4000)

    states = run(xs, BleedEnable=True, BleedThresh=threshold, BleedFactor=0.9)

    mean = float(np.mean([s.y_dot for s in states[400:]]))
    assert mean == pytest.approx(velocity, abs=0.1)  # printed with one decimal; the seed fixes the noise


def test_larger_r_x_lowers_both_gains_and_larger_q_x_dot_raises_K1():
    def gains(**tuning: float) -> tuple[float, float]:
        state = run(np.zeros(400), **tuning)[-1]
        return state.K0, state.K1

    by_r = [gains(r_x=r) for r in (0.1, 0.5, 1.0, 2.0, 10.0)]
    by_q = [gains(q_x_dot=q) for q in (0.001, 0.01, 0.1, 1.0, 10.0)]

    assert by_r == sorted(by_r, reverse=True)
    assert [K1 for _, K1 in by_r] == sorted((K1 for _, K1 in by_r), reverse=True)
    assert [K1 for _, K1 in by_q] == sorted(K1 for _, K1 in by_q)


def test_velocity_gain_is_there_after_one_prediction():
    assert run([0.0])[0].K1 != 0.0


def test_canonical_ramp_hold_ramp_hold():
    """Slope 10 u/s, 15 s each, U(-2, 2) noise, seed 0: the paper's experiment with what it leaves open filled in."""
    step, still = np.full(300, 0.5), np.zeros(300)
    truth = np.cumsum(np.concatenate([step, still, step, still]))
    noise = np.random.default_rng(0).uniform(-2, 2, 1200)

    states = run(truth + noise)

    y, v = np.array([s.y for s in states]), np.array([s.y_dot for s in states])
    ramp, hold = slice(150, 300), slice(450, 600)  # the settled second halves of the first two segments
    gains = [states[-1].K0, states[-1].K1]
    assert gains == pytest.approx([0.1704, 0.2494], abs=5e-5)
    assert np.std(noise[hold]) / np.std((y - truth)[hold]) == pytest.approx(2.9, abs=0.05)
    assert np.mean(v[ramp]) - 10 == pytest.approx(0.007, abs=0.0005)
    assert np.std(v[ramp]) == pytest.approx(0.54, abs=0.005)
    assert max((y - truth)[300:]) == pytest.approx(2.44, abs=0.005)
    assert all(s.S > 0 and s.P[0] >= 0 and s.P[3] >= 0 and 0 <= s.K0 <= 1 for s in states)
