"""The arithmetic of the studies, each against something that is computed otherwise."""

from itertools import count

import numpy as np
import pytest

from softplc.commissioning.study.aoi_runs import noise_left, settling_scan, slowest_time_constant
from softplc.commissioning.study.ducekf_timing import ITERATIONS, Path, dac_words, measure, paper_statistics
from softplc.commissioning.study.waveform import both, ramp_hold
from softplc.kernel.steady import steady_gains


def error_step(K0: float, K1: float, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """e⁺ = Ae − Kv of an observer at constant gains."""
    F, H, K = np.array([[1.0, dt], [0.0, 1.0]]), np.array([[1.0, 0.0]]), np.array([[K0], [K1]])
    return (np.eye(2) - K @ H) @ F, K


@pytest.mark.parametrize("tuning", [(0.01, 0.1, 4 / 3, 0.05), (1e-3, 10.0, 0.5, 0.01), (0.0, 0.2, 2.0, 0.1)])
def test_noise_left_is_what_the_covariance_of_the_error_settles_at(tuning):
    K0, K1 = steady_gains(*tuning)
    A, K = error_step(K0, K1, tuning[3])
    P = np.zeros((2, 2))
    for _ in range(5000):
        P = A @ P @ A.T + K @ K.T
    assert noise_left(K0, K1, tuning[3]) == pytest.approx(np.sqrt(np.diag(P)), rel=1e-9)


def test_the_slowest_time_constant_is_that_of_an_error_left_alone():
    K0, K1 = steady_gains(0.01, 0.1, 4 / 3, 0.002)  # two real poles, far apart
    A, _ = error_step(K0, K1, 0.002)
    e = np.linalg.matrix_power(A, 400) @ np.array([1.0, 0.0])
    later = np.linalg.matrix_power(A, 50) @ e
    assert slowest_time_constant(K0, K1, 0.002) == pytest.approx(-0.1 / np.log(later[0] / e[0]), rel=1e-3)


def test_a_gain_has_settled_after_the_last_scan_outside():
    assert settling_scan(np.array([2.0, 1.0, 1.5, 1.005, 1.0]), 1.0) == 4
    assert settling_scan(np.array([1.0, 1.0]), 1.0) == 1


def test_the_waveform_is_ramp_hold_ramp_hold_with_bounded_noise():
    wave = ramp_hold(0)
    assert wave.position[[0, 299, 599, 899, 1199]] == pytest.approx([0.5, 150.0, 150.0, 300.0, 300.0])
    noise = wave.measured - wave.position
    assert np.abs(noise).max() < 2.0
    assert noise.var() == pytest.approx(4 / 3, rel=0.1)  # 1200 samples: a standard error of 3 %
    assert set(wave.velocity[both(0, 2)]) == {10.0}
    assert set(wave.velocity[both(1, 3)]) == {0.0}


def test_a_dac_word_is_channel_data_padding():
    assert dac_words((-3.0, 3.0, 0.0, 99.0)).hex(" ", 3) == "000000 01fff0 028000 03fff0"


def test_paths_are_timed_by_the_clock_that_is_given():
    ticks = count(0, 1500)
    timing = measure(lambda: next(ticks))
    assert timing.times.shape[1] == ITERATIONS
    assert set(timing.times.ravel()) == {1.5}
    assert [path.here_us for path in timing.paths] == [1.5] * 4
    assert (timing.here.mean, timing.here.variance) == (1.5, 0.0)


def test_the_papers_statistics_weigh_each_path_with_its_iterations():
    paths = [Path(1, 349, (2, 4, 6), 0.0), Path(350, 350, (2, 3), 0.0)]
    paper = paper_statistics(paths)
    assert (round(paper.mean, 3), round(paper.variance, 4), round(paper.deviation, 4)) == (252.972, 0.2736, 0.5231)
