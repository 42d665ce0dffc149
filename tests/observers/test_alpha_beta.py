"""The α-β filter as a user sees it: gains that follow the measured steps, and tunings that are refused."""

import pytest
from pydantic import ValidationError

from softplc.observers.alpha_beta import AlphaBetaConfig
from softplc.observers.axes import AxisSpec
from tests.observers.rig import make_rig


def test_gains_of_the_tracking_index_follow_the_measured_step_and_fixed_ones_do_not():
    indexed = make_rig((AxisSpec("A0"), AlphaBetaConfig(type="alpha_beta", sigma_w=20.0, sigma_v=1.0)))
    fixed = make_rig((AxisSpec("A0"), AlphaBetaConfig(type="alpha_beta", alpha=0.3)))
    gains = []
    for dt in (0.05, 0.05, 0.2):
        for rig in (indexed, fixed):
            rig.scan(1.0, dt=dt)
        gains.append((indexed.get("K0"), fixed.get("K0")))

    assert gains[1][0] < gains[2][0]
    assert [gain for _, gain in gains] == [0.3] * 3


def test_beta_left_out_is_that_of_an_optimal_filter_with_this_alpha():
    rig = make_rig((AxisSpec("A0"), AlphaBetaConfig(type="alpha_beta", alpha=0.3)))
    rig.scan(1.0)
    assert rig.get("beta") == pytest.approx(0.3 * 0.3 / 1.7)
    assert rig.get("K1") == pytest.approx(0.3 * 0.3 / 1.7 / 0.05)


def test_only_gains_of_the_tracking_index_say_how_large_an_innovation_may_be():
    assert "NIS" in AlphaBetaConfig(type="alpha_beta", sigma_w=1.0, sigma_v=1.0).estimates
    assert not {"S", "NIS"} & set(AlphaBetaConfig(type="alpha_beta", alpha=0.3).estimates)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({}, "no gains, expected alpha, or alpha and beta, or sigma_w and sigma_v"),
        ({"beta": 0.1}, "beta, expected"),
        ({"alpha": 0.3, "sigma_w": 1.0, "sigma_v": 1.0}, "alpha and sigma_w and sigma_v, expected"),
        ({"sigma_w": 1.0}, "sigma_w, expected"),
        ({"alpha": 0.5, "beta": 3.0}, "beta 3 is unstable with alpha 0.5, expected less than 4 − 2·alpha, 3"),
        ({"alpha": 1.5}, "less than or equal to 1"),
        ({"alpha": float("nan")}, "alpha"),
        ({"sigma_w": -1.0, "sigma_v": 1.0}, "sigma_w"),
    ],
)
def test_gains_that_are_missing_mixed_or_unstable_are_refused(settings: dict[str, float], message: str):
    with pytest.raises(ValidationError, match=message):
        AlphaBetaConfig(type="alpha_beta", **settings)  # type: ignore[arg-type]
