"""Each option of the AOI: what it cures, with the number it cures it from, and what it costs."""

import numpy as np
import pytest
from numpy.typing import NDArray

from softplc.kernel.batch import aoi as batch
from softplc.kernel.batch.aoi_options import AoiBatchOptions
from softplc.kernel.reference.aoi import AoiInputs
from softplc.kernel.reference.aoi_options import (
    AoiOptions,
    AoiOptionsState,
    aoi_options_lreal,
    aoi_options_real,
)
from softplc.kernel.result import Result

R = 4 / 3
UNLIMITED = (-np.inf, np.inf)


def run(
    xs: object, options: AoiOptions, precision: str = "lreal", **tuning: object
) -> tuple[list[AoiOptionsState], list[Result]]:
    """States and results after each measurement, at dt = 50 ms and the usual tuning unless told otherwise."""
    step = aoi_options_real if precision == "real" else aoi_options_lreal
    given = {"dt": 50.0, "q_x": 0.01, "q_x_dot": 0.1, "r_x": R, **tuning}
    state, states, results = AoiOptionsState(), [], []
    for x in xs:  # type: ignore[attr-defined]
        state, result = step(state, AoiInputs(True, float(x), **given), options)  # type: ignore[arg-type]
        states.append(state)
        results.append(result)
    return states, results


def velocities(states: list[AoiOptionsState]) -> NDArray[np.float64]:
    return np.array([float(state.aoi.y_dot) for state in states])


def canonical_ramp() -> NDArray[np.float64]:
    """The first segment of the ramp–hold experiment: 10 u/s, U(-2, 2), seed 0."""
    return 0.5 * np.arange(1, 301) + np.random.default_rng(0).uniform(-2, 2, 1200)[:300]


# --- Joseph form

DOUBTFUL = np.logspace(-6.5, -5.5, 200)  # r_x so small beside P that a REAL can hardly hold 1 - K0


def covariance_after(
    options: AoiOptions, r_x: NDArray[np.float64], dt: float
) -> tuple[NDArray[np.bool_], batch.AoiBatchState]:
    """Which rows had, in REAL, a covariance that is none in any of 200 scans, and the last state."""
    n = len(r_x)
    tuning = batch.AoiTuning(
        np.float32,
        q_x=np.zeros(n),
        q_x_dot=np.zeros(n),
        r_x=r_x,
        BleedEnable=np.zeros(n, bool),
        BleedThresh=np.zeros(n),
        BleedFactor=np.ones(n),
        options=AoiBatchOptions(np.float32, [options] * n),
    )
    state, every, lost = batch.AoiBatchState(n, np.float32), np.full(n, True), np.full(n, False)
    for _ in range(200):
        batch.step(state, tuning, EnableIn=every, x=np.zeros(n), dt=np.full(n, dt), rows=every)
        P0, P1, P3 = (P.astype(np.float64) for P in (state.P0, state.P1, state.P3))  # their products are exact
        lost |= (P0 < 0) | (P3 < 0) | (P0 * P3 < P1 * P1)
    return lost, state


def test_joseph_form_keeps_a_covariance_in_real_that_the_plain_form_loses_until_s_is_not_positive():
    plain, after_plain = covariance_after(AoiOptions(), DOUBTFUL, 1000.0)
    joseph, after_joseph = covariance_after(AoiOptions(joseph=True), DOUBTFUL, 1000.0)

    assert plain.sum() > 20
    assert (after_plain.S <= 0).sum() > 20  # and there it stays
    assert not joseph.any()
    assert (after_joseph.S > 0).all()


def test_joseph_form_keeps_variances_positive_even_where_r_x_is_below_the_resolution_of_a_real():
    _, state = covariance_after(AoiOptions(joseph=True), 1e-4 * DOUBTFUL, 1000.0)

    assert (state.P0 >= 0).all()
    assert (state.P3 >= 0).all()


def test_joseph_form_is_the_same_filter():
    xs = canonical_ramp()

    plain, joseph = velocities(run(xs, AoiOptions())[0]), velocities(run(xs, AoiOptions(joseph=True))[0])

    assert np.abs(plain - joseph).max() < 1e-12  # last places of numbers up to 10, remembered for 20 scans
    assert (plain != joseph).any()


# --- min_r and gain limits


def test_min_r_is_the_measurement_noise_where_r_x_is_smaller_and_nothing_where_it_is_larger():
    xs = canonical_ramp()
    floored = run(xs, AoiOptions(min_r=0.5), r_x=0.0)[0]

    assert floored == run(xs, AoiOptions(), r_x=0.5)[0]
    assert run(xs, AoiOptions(min_r=0.5), r_x=0.6)[0] == run(xs, AoiOptions(), r_x=0.6)[0]


def test_without_measurement_noise_the_output_is_the_noisy_input_and_min_r_prevents_it():
    xs = canonical_ramp()
    truth = 0.5 * np.arange(1, 301)

    def noise(options: AoiOptions) -> float:
        return float(np.std([s.aoi.y for s in run(xs, options, r_x=0.0)[0]][150:] - truth[150:]))

    assert noise(AoiOptions()) == pytest.approx(np.std((xs - truth)[150:]), rel=1e-9)
    assert noise(AoiOptions(min_r=R)) < 0.5 * noise(AoiOptions())


def test_gains_stay_within_their_limits():
    states, _ = run(canonical_ramp(), AoiOptions(joseph=True, K0_limits=(0.2, 0.3), K1_limits=(0.1, 0.2)))

    assert {state.aoi.K0 for state in states} >= {0.2}
    assert all(0.2 <= state.aoi.K0 <= 0.3 and 0.1 <= state.aoi.K1 <= 0.2 for state in states)


def test_a_gain_limit_makes_the_plain_covariance_wrong_and_joseph_keeps_it():
    """Raised above its optimum, K1 takes more off P11 than there is; the Joseph form holds for any gain."""
    raised = (1.0, np.inf)

    plain, _ = run(np.zeros(100), AoiOptions(K1_limits=raised))
    joseph, _ = run(np.zeros(100), AoiOptions(K1_limits=raised, joseph=True))

    assert min(state.aoi.P[3] for state in plain) < 0
    for state in joseph:
        P0, P1, _, P3 = state.aoi.P
        assert P0 > 0
        assert P0 * P3 > P1 * P1


# --- bleed


@pytest.mark.parametrize(("threshold", "velocity"), [(0.5, 7.40), (1.0, 5.99), (2.0, 4.87)])
def test_bleed_biases_a_ramp_of_10_u_per_s_and_the_velocity_gate_frees_it(threshold: float, velocity: float):
    bleed = {"BleedEnable": True, "BleedThresh": threshold, "BleedFactor": 0.9}

    def mean(options: AoiOptions) -> float:
        return float(velocities(run(canonical_ramp(), options, **bleed)[0])[150:].mean())

    assert mean(AoiOptions()) == pytest.approx(
        velocity, abs=0.005
    )  # given with two decimals; the seed fixes the noise
    unbiased = velocities(run(canonical_ramp(), AoiOptions())[0])[150:].mean()
    assert mean(AoiOptions(bleed_velocity=2.0)) == pytest.approx(unbiased, abs=0.01)


def test_bleed_with_the_velocity_gate_quietens_the_velocity_of_a_hold_as_without_it():
    xs = np.concatenate([canonical_ramp(), 150 + np.random.default_rng(1).uniform(-2, 2, 600)])
    bleed = {"BleedEnable": True, "BleedThresh": 1.0, "BleedFactor": 0.5}

    still = np.std(velocities(run(xs, AoiOptions())[0])[450:])
    bled, gated = (
        np.std(velocities(run(xs, AoiOptions(bleed_velocity=limit), **bleed)[0])[450:]) for limit in (None, 2.0)
    )

    assert bled < 0.7 * still
    assert gated == pytest.approx(bled, rel=0.01)


def test_the_velocity_gate_costs_what_bleed_takes_off_the_overshoot_at_a_stop_from_a_higher_speed():
    xs = np.concatenate([0.5 * np.arange(300), np.full(300, 149.5)])

    def overshoot(options: AoiOptions, **bleed: object) -> float:
        return max(float(state.aoi.y) for state in run(xs, options, **bleed)[0]) - 149.5

    bleed = {"BleedEnable": True, "BleedThresh": 1.0, "BleedFactor": 0.9}
    assert overshoot(AoiOptions()) == pytest.approx(1.65, abs=0.005)
    assert overshoot(AoiOptions(), **bleed) == pytest.approx(0.53, abs=0.005)
    assert overshoot(AoiOptions(bleed_velocity=2.0), **bleed) == pytest.approx(1.65, abs=0.005)


def test_bleed_by_the_innovation_acts_less_often_than_by_the_deviation_after_the_correction():
    """The latter is 1 - K0 times the former, 0.83 here once the gains have settled."""
    bleed = {"BleedEnable": True, "BleedThresh": 1.0, "BleedFactor": 0.9}

    def mean(options: AoiOptions) -> float:
        return float(velocities(run(canonical_ramp(), options, **bleed)[0])[150:].mean())

    assert mean(AoiOptions()) + 0.3 < mean(AoiOptions(bleed_on_innovation=True)) < 10


@pytest.mark.parametrize(("x", "bleeds_posterior", "bleeds_innovation"), [(1.1, True, False), (0.9, True, True)])
def test_bleed_tests_the_deviation_it_is_told_to(x: float, bleeds_posterior: bool, bleeds_innovation: bool):
    bleed = {"BleedEnable": True, "BleedThresh": 1.0, "BleedFactor": 0.5}
    still = [0.0] * 300
    without = run([*still, x], AoiOptions())[0][-1].aoi.y_dot

    for options, bleeds in (
        (AoiOptions(), bleeds_posterior),
        (AoiOptions(bleed_on_innovation=True), bleeds_innovation),
    ):
        assert run([*still, x], options, **bleed)[0][-1].aoi.y_dot == (0.5 if bleeds else 1.0) * without


# --- innovation gate


def test_the_gate_rejects_an_outlier_and_the_next_sample_is_taken_as_if_there_had_been_a_gap():
    xs = [*(0.5 * np.arange(200)), 400.0, 100.5, 101.0]
    gate = AoiOptions(gate=5.0, gate_most=3)

    states, results = run(xs, gate)
    spoiled, _ = run(xs, AoiOptions())

    before, at, after = states[199:202]
    assert results[199:] == [Result.UPDATED, Result.REJECTED, Result.UPDATED, Result.UPDATED]
    assert at.aoi.y == pytest.approx(100.0, abs=1e-6)
    assert at.aoi.y_dot == before.aoi.y_dot
    assert (at.aoi.K0, at.aoi.K1) == (0.0, 0.0)
    assert at.aoi.P[0] > before.aoi.P[0]
    assert at.aoi.P[3] == before.aoi.P[3] + 0.1
    assert [s.rejected for s in states[199:]] == [0, 1, 1, 1]
    assert after.aoi.y == pytest.approx(100.5, abs=1e-6)
    assert abs(spoiled[200].aoi.y - 100.0) > 50


def test_after_so_many_rejections_in_a_row_the_next_one_starts_anew_on_its_sample():
    xs = [*np.zeros(100), *np.full(50, 100.0)]

    states, results = run(xs, AoiOptions(gate=5.0, gate_most=4))

    assert results[100:106] == [Result.REJECTED] * 4 + [Result.INITIALISED, Result.UPDATED]
    assert (states[103].aoi.y, states[104].aoi.y, states[104].aoi.y_dot) == (0.0, 100.0, 0.0)
    assert (states[103].in_a_row, states[104].in_a_row, states[-1].rejected) == (4, 0, 4)
    fresh, _ = run([100.0], AoiOptions())
    assert states[104].aoi == fresh[0].aoi


def test_a_gate_that_allows_none_in_a_row_starts_anew_at_once():
    _, results = run([*np.zeros(100), 100.0], AoiOptions(gate=5.0, gate_most=0))

    assert results[-1] == Result.INITIALISED


def test_a_sample_on_the_gate_is_taken_and_one_beyond_it_is_not():
    S = run(np.zeros(201), AoiOptions())[0][-1].aoi.S  # of the last scan, whatever its sample

    assert run([*np.zeros(200), 3.0 * np.sqrt(S)], AoiOptions(gate=3.0, gate_most=9))[1][-1] == Result.UPDATED
    beyond = np.nextafter(3.0 * np.sqrt(S), np.inf)
    assert run([*np.zeros(200), beyond], AoiOptions(gate=3.0, gate_most=9))[1][-1] == Result.REJECTED


@pytest.mark.parametrize("x", [np.nan, np.inf, -np.inf])
def test_with_the_gate_what_is_no_number_does_not_enter_even_the_kernel_itself(x: float):
    states, results = run([*(0.5 * np.arange(100)), x, 50.5, 51.0], AoiOptions(gate=5.0, gate_most=3))

    assert results[100:] == [Result.REJECTED, Result.UPDATED, Result.UPDATED]
    assert states[-1].aoi.y == pytest.approx(51.0, abs=1e-3)  # 100 scans after the start


def test_outliers_cost_the_gated_observer_nothing_to_speak_of():
    rng = np.random.default_rng(3)
    truth = 0.5 * np.arange(1200)
    clean = truth + rng.normal(0, np.sqrt(R), 1200)
    spoiled = np.where(rng.random(1200) < 0.05, clean + rng.choice([-60, 60], 1200), clean)

    def rmse(xs: NDArray[np.float64], options: AoiOptions) -> float:
        y = np.array([s.aoi.y for s in run(xs, options)[0]])
        return float(np.sqrt(np.mean((y - truth)[100:] ** 2)))

    gate = AoiOptions(gate=5.0, gate_most=5)
    assert rmse(spoiled, AoiOptions()) > 5 * rmse(clean, AoiOptions())
    assert rmse(spoiled, gate) < 1.1 * rmse(clean, AoiOptions())


# --- S not positive


def stepwise(r_x: list[float], options: AoiOptions) -> tuple[list[AoiOptionsState], list[Result]]:
    """A ramp of 10 u/s with this r_x in each scan."""
    state, states, results = AoiOptionsState(), [], []
    for k, r in enumerate(r_x):
        state, result = aoi_options_lreal(state, AoiInputs(True, 0.5 * k, 50.0, 0.01, 0.1, r), options)
        states.append(state)
        results.append(result)
    return states, results


def test_an_innovation_variance_that_is_not_positive_latches_and_reinitialise_ends_it():
    r_x = [R] * 100 + [-5.0] * 40

    kept, kept_results = stepwise(r_x, AoiOptions())
    anew, anew_results = stepwise(r_x, AoiOptions(reinitialise=True))

    assert kept_results[100:] == [Result.S_NOT_POSITIVE] * 40
    assert {s.aoi.y_dot for s in kept[100:]} == {kept[99].aoi.y_dot}  # runs on at that speed whatever is measured
    # a start that gives no positive S either is flagged as such, and follows the measurement meanwhile
    assert anew_results[100:] == [Result.S_NOT_POSITIVE] * 40
    assert [s.aoi.y for s in anew[100:]] == [0.5 * k for k in range(100, 140)]


def test_reinitialise_recovers_where_the_covariance_itself_has_gone_negative():
    """As the plain form may leave it in REAL: P00 below -r_x, so that S stays where it is for good."""
    state = AoiOptionsState()
    for k in range(100):
        state, _ = aoi_options_lreal(state, AoiInputs(True, 0.5 * k, 50.0, 0.01, 0.1, R), AoiOptions())
    state.aoi.P = (-2.0, 0.0, 0.0, 0.0)
    scan = AoiInputs(True, 50.0, 50.0, 0.01, 0.1, R)

    kept, result = aoi_options_lreal(state, scan, AoiOptions())
    assert result == Result.S_NOT_POSITIVE
    assert kept.aoi.P == (-2.0, 0.0, 0.0, 0.0)

    anew, result = aoi_options_lreal(state, scan, AoiOptions(reinitialise=True))
    assert result == Result.INITIALISED
    assert (anew.aoi.y, anew.aoi.S > 0) == (50.0, True)


# --- reference


def test_above_two_to_the_24_a_real_loses_the_counts_and_a_reference_brings_them_back():
    xs = 2.0**25 + 0.5 * np.arange(600)

    def worst(options: AoiOptions) -> float:
        return float(np.abs(velocities(run(xs, options, "real")[0])[100:] / 10.0 - 1.0).max())

    assert worst(AoiOptions()) > 0.5  # seen 0.52
    for reference in ("first_sample", 2.0**25):
        assert worst(AoiOptions(reference=reference)) < 1e-4  # type: ignore[arg-type]  # REAL at 300 u


@pytest.mark.parametrize("reference", ["first_sample", 2.0**25, -7.25])
def test_the_position_is_absolute_again_and_in_double_precision(reference: object):
    xs = 2.0**25 + 0.5 * np.arange(600)

    referenced, _ = run(xs, AoiOptions(reference=reference), "real")  # type: ignore[arg-type]

    lasting = referenced[-1].position - xs[-1]
    assert abs(lasting) < (
        8.0 if reference == -7.25 else 1e-3
    )  # -7.25 takes nothing off 2^25, REAL counts by 4 there
    assert referenced[-1].position == referenced[-1].offset + float(referenced[-1].aoi.y)


def test_in_lreal_a_reference_of_a_round_number_changes_no_bit_of_the_velocity():
    xs = np.round(canonical_ramp() * 256) / 256  # so that taking off the reference is exact

    plain, referenced = run(xs, AoiOptions())[0], run(xs - 0.0, AoiOptions(reference=0.0))[0]

    assert [s.aoi for s in plain] == [s.aoi for s in referenced]


def test_a_start_anew_takes_a_new_reference():
    xs = [*np.full(50, 1000.0), *np.full(10, 2.0**25 + 1)]

    states, results = run(xs, AoiOptions(gate=5.0, gate_most=2, reference="first_sample"), "real")

    assert [s.offset for s in states[49:53]] == [1000.0, 1000.0, 1000.0, 2.0**25 + 1]
    assert results[52] == Result.INITIALISED
    assert states[-1].position == 2.0**25 + 1
