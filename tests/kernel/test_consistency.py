"""Statistics of innovations: against sums over a list, tables of χ², and matrices of numpy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from softplc.kernel.batch.consistency import (
    EXPECTED_OUTSIDE,
    ConsistencyState,
    Figures,
    autocorrelation_limit,
    chi_square_mean,
    diagnose,
    nis_band,
    smallest_eigenvalue,
    step,
)
from softplc.kernel.diagnosis import DIAGNOSIS_TEXT, Diagnosis


def feed(state: ConsistencyState, nu: np.ndarray, S: float = 4.0) -> None:
    """Updates of all rows with these normalised innovations [updates, n]."""
    everyone = np.ones(len(state), np.bool_)
    for row in nu:
        step(state, row * np.sqrt(S), np.full(len(state), S), everyone)


@settings(max_examples=30, deadline=None)
@given(
    window=st.sampled_from([50, 100]),
    lags=st.integers(1, 7),
    share=st.floats(0.2, 1.0),
    seed=st.integers(0, 2**32 - 1),
    scans=st.integers(1, 400),
)
def test_a_window_is_the_sums_over_its_updates_whichever_scans_they_came_in(window, lags, share, seed, scans):
    rng = np.random.default_rng(seed)
    n = 4
    state = ConsistencyState(n, window, lags)
    taken: list[list[float]] = [[] for _ in range(n)]
    for _ in range(scans):
        y, S, rows = rng.normal(0.0, 3.0, n), rng.uniform(0.5, 9.0, n), rng.random(n) < share
        S[rng.random(n) < 0.02] = 0.0
        step(state, y, S, rows)
        for axis in np.flatnonzero(rows & (S > 0.0)):
            taken[axis].append(y[axis] / np.sqrt(S[axis]))

    figures = Figures(state)
    for axis in range(n):
        nu = np.array(taken[axis][state.settling :])
        stop = len(nu) // (window // 10) * (window // 10)
        start = max(stop - window, 0)
        if stop == 0:
            assert np.isnan(figures.nis[axis])
            assert np.isnan(figures.rho[:, axis]).all()
            continue
        part = nu[start:stop]
        energy = (part * part).sum()
        # 1e-9: the same numbers, added in another order
        assert figures.nis[axis] == pytest.approx(energy / len(part), rel=1e-9)
        assert figures.outside[axis] == np.mean(np.abs(part) > 2.0)
        earlier = np.concatenate([np.zeros(lags), nu])
        for lag in range(1, lags + 1):
            product = (part * earlier[start + lags - lag : stop + lags - lag]).sum()
            assert figures.rho[lag - 1, axis] == pytest.approx(product / energy, rel=1e-9, abs=1e-9)
        assert state.full[axis] == (stop - start == window)


def test_a_window_forgets_a_large_value_completely():
    state = ConsistencyState(2, 50, 3)
    rng = np.random.default_rng(0)
    feed(state, np.full((30, 2), 1e9))
    feed(state, rng.normal(size=(1000, 2)))
    calm = ConsistencyState(2, 50, 3)
    rng = np.random.default_rng(0)
    feed(calm, np.zeros((30, 2)))
    feed(calm, rng.normal(size=(1000, 2)))
    assert (state.totals == calm.totals).all()


def test_updates_while_the_covariance_settles_do_not_count():
    state = ConsistencyState(1, 100, 1)
    feed(state, np.full((25, 1), 50.0))
    feed(state, np.ones((100, 1)))
    assert Figures(state).nis[0] == 1.0


def test_a_cleared_row_is_as_new_and_the_others_go_on():
    state, other = ConsistencyState(2, 50, 2), ConsistencyState(2, 50, 2)
    nu = np.random.default_rng(3).normal(size=(200, 2))
    feed(state, nu)
    feed(other, nu)
    state.clear(np.array([True, False]))
    assert state.filled.tolist() == [0, 10]
    feed(state, nu)
    feed(other, nu)
    fresh = ConsistencyState(2, 50, 2)
    feed(fresh, nu)
    assert (state.totals[:, 0] == fresh.totals[:, 0]).all()
    assert (state.totals[:, 1] == other.totals[:, 1]).all()


@pytest.mark.parametrize("n", [50, 100, 200, 1000, 10_000])
@pytest.mark.parametrize("p", [0.0005, 0.025, 0.5, 0.975, 0.9995])
def test_quantiles_of_chi_square_are_those_of_the_tables(n: int, p: float):
    assert chi_square_mean(p, n) == pytest.approx(stats.chi2.ppf(p, n) / n, abs=3e-3)


def test_the_band_of_the_default_window_is_as_documented():
    assert nis_band(200) == pytest.approx((0.8136, 1.2053), abs=1e-4)
    assert autocorrelation_limit(200, 5) == pytest.approx(0.1816, abs=1e-4)
    assert pytest.approx(0.0455, abs=1e-4) == EXPECTED_OUTSIDE


def test_independent_innovations_stay_within_the_bands_as_often_as_they_say():
    runs, window, lags = 4000, 200, 5
    state = ConsistencyState(runs, window, lags)
    feed(state, np.random.default_rng(1).normal(size=(window + state.settling, runs)))
    figures = Figures(state)
    low, high = nis_band(window)

    # 4000 runs: 95 % has a standard error of 0.34 %; the lags are not quite independent
    assert np.mean((figures.nis > low) & (figures.nis < high)) == pytest.approx(0.95, abs=0.015)
    largest = np.abs(figures.rho).max(axis=0)
    assert np.mean(largest < autocorrelation_limit(window, lags)) == pytest.approx(0.95, abs=0.015)
    assert figures.outside.mean() == pytest.approx(EXPECTED_OUTSIDE, abs=0.002)
    consistent = diagnose(state, figures, np.full(runs, 0.2)) == Diagnosis.CONSISTENT
    assert consistent.mean() > 0.98


@pytest.mark.parametrize(("window", "lags"), [(50, 3), (200, 2), (200, 5), (1000, 12)])
def test_independent_innovations_are_rarely_called_not_random(window, lags):
    runs = 3000
    state = ConsistencyState(runs, window, lags)
    feed(state, np.random.default_rng(2).normal(size=(window + state.settling, runs)))
    codes = diagnose(state, Figures(state), np.full(runs, 0.2))
    assert np.mean(codes == Diagnosis.NOT_RANDOM) < 0.015
    assert np.mean(codes == Diagnosis.CONSISTENT) > 0.97


@pytest.mark.parametrize("period", [2.5, 4, 6, 9, 14])
def test_innovations_that_swing_are_not_random_though_their_autocorrelation_averages_out(period: float):
    """Half of the variance is white, half a swing whose phase wanders; the mean NIS is as it should be."""
    runs, scans = 300, 260
    rng = np.random.default_rng(3)
    phase = 2 * np.pi * (np.arange(scans)[:, np.newaxis] / period + rng.random(runs))
    phase += np.cumsum(rng.normal(0, 0.1, (scans, runs)), axis=0)
    state = ConsistencyState(runs, 200, 5)
    feed(state, np.sin(phase) + rng.normal(0, np.sqrt(0.5), (scans, runs)))
    figures = Figures(state)
    codes = diagnose(state, figures, np.full(runs, 0.2))
    assert np.abs(figures.rho.mean(axis=0)).mean() < 0.2  # what lags has more
    assert np.mean(codes == Diagnosis.CONSISTENT) == 0.0
    # a fast swing has a negative mean of ρ, which is what a gain that is too high looks like
    assert set(codes) <= {Diagnosis.NOT_RANDOM, Diagnosis.Q_TOO_LARGE, Diagnosis.R_TOO_SMALL, Diagnosis.Q_TOO_SMALL}


def test_one_lag_alone_has_no_shape_and_is_judged_by_its_size():
    state = ConsistencyState(3, 200, 1)
    nu = np.random.default_rng(0).normal(size=(250, 3))
    nu[1:, 1] += nu[:-1, 1]
    nu[1:, 2] -= nu[:-1, 2]
    feed(state, nu / nu.std(axis=0))
    codes = diagnose(state, Figures(state), np.full(3, 0.2))
    assert codes.tolist()[0] == Diagnosis.CONSISTENT
    assert Diagnosis.CONSISTENT not in codes.tolist()[1:]


def test_the_smallest_eigenvalue_is_numpys_whatever_the_entries_scales():
    rng = np.random.default_rng(5)
    a, c = 10.0 ** rng.uniform(-6, 6, (2, 500))
    b = np.sqrt(a * c) * rng.uniform(-1.5, 1.5, 500)  # some are no covariance
    expected = np.linalg.eigvalsh(np.array([[a, b], [b, c]]).transpose(2, 0, 1))
    # numpy's own error is relative to the largest eigenvalue
    assert smallest_eigenvalue(a, b, c) == pytest.approx(expected[:, 0], abs=1e-14 * expected[:, 1].max())
    signs = np.sign(smallest_eigenvalue(a, b, c))
    assert (signs == np.sign(a * c - b * b)).all()


def test_the_smallest_eigenvalue_of_huge_and_of_no_entries_is_a_number():
    huge = np.array([1.7e308, 1e200, 0.0, -1.0])
    found = smallest_eigenvalue(huge, np.zeros(4), huge)
    assert np.isfinite(found).all()
    assert found[2:].tolist() == [0.0, -1.0]


def test_a_window_that_cannot_be_is_refused():
    for window, lags in ((55, 1), (0, 1), (50, 0)):
        with pytest.raises(ValueError, match="multiple of 10"):
            ConsistencyState(1, window, lags)


def test_every_diagnosis_has_its_sentence():
    assert DIAGNOSIS_TEXT.keys() == set(Diagnosis)
