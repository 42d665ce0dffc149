"""The paper's case study, reproduced: the numbers that its authors give or that follow from Table 1."""

from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest

from softplc.kernel.reference.covariance import ImpactCovariance
from softplc.kernel.reference.dhvpo import TABLE_1, Dhvpo, PlantRule, PlantState, Scan, plant_step, run
from softplc.kernel.result import Result

DIGITS = 5e-9  # numbers below are printed with nine significant digits


def impacts(scans: list[Scan]) -> list[int]:
    return [scan.k for scan in scans if scan.impact]


def paths(scans: list[Scan]) -> list[tuple[tuple[int, ...], int]]:
    """Runs of equal routes, as Table A2 lists them."""
    return [(routes, len(list(group))) for routes, group in groupby(scan.routes for scan in scans)]


@pytest.fixture(scope="module")
def table_1() -> list[Scan]:
    return run(1400)


def test_the_350_iterations_take_the_paths_of_table_a2(table_1: list[Scan]):
    assert paths(table_1[:350]) == [((1, 4, 6), 1), ((2, 4, 6), 313), ((2, 3), 1), ((2, 4, 6), 35)]


def test_the_only_impact_of_the_350_iterations_is_at_k_315(table_1: list[Scan]):
    assert impacts(table_1[:350]) == [315]


def test_later_impacts_come_every_331_iterations(table_1: list[Scan]):
    assert impacts(table_1) == [315, 646, 977, 1308]


def test_with_kappa_above_one_they_come_every_307(table_1: list[Scan]):
    assert impacts(run(1400, Dhvpo(kappa=1.5))) == [315, 622, 929, 1236]


def test_the_oscillator_falls_through_the_band_to_the_state_that_the_transition_takes():
    state, model, free = PlantState(0.0, 1.5), Dhvpo(), PlantRule(band=0.0)  # no band: never a transition
    positions = {}
    for k in range(1, 316):
        state, _ = plant_step(model, free, state, 0.01)
        positions[k] = state.x1
        if k == 314:
            assert state.x2 == pytest.approx(-1.50203, abs=5e-6)
    assert [positions[k] for k in (313, 314, 315)] == pytest.approx([0.02620649, 0.01118782, -0.00383252], abs=DIGITS)


def test_state_and_covariance_at_the_first_impact(table_1: list[Scan]):
    before, impact = table_1[313], table_1[314]
    assert impact.x == pytest.approx((0.01118782, 0.75101714), abs=DIGITS)
    assert pytest.approx((9.16176026e-5, 9.9989831e-6, 9.9989831e-6, 1.15433729e-2), rel=1e-8) == before.P
    assert pytest.approx((9.16176026e-5, -1.99979662e-5, -1.99979662e-5, 4.61734914e-2), rel=1e-8) == impact.P
    assert impact.result == Result.IMPACT


def test_the_estimate_converges_from_its_wrong_velocity(table_1: list[Scan]):
    errors = [scan.x[1] - scan.x_hat[1] for scan in table_1]
    assert table_1[0].x_hat == pytest.approx((0.0150014916, 1.7821822), abs=5e-8)
    assert max(map(abs, errors[63:])) < 0.015 <= abs(errors[62])  # k = 64
    assert abs(errors[99]) == pytest.approx(6.3e-3, rel=0.01)
    assert abs(errors[313]) == pytest.approx(5.7e-5, rel=0.01)


def test_without_a_direction_test_the_start_would_be_an_impact():
    """x1 = 0.015 at k = 1 lies in the band, on its way up."""
    assert impacts(run(350, rule=PlantRule(direction="none")))[0] == 2
    assert impacts(run(350, rule=PlantRule(direction="velocity"))) == [315]


@pytest.mark.parametrize(
    ("step", "edge", "carried", "same"),
    [
        ("euler", "above", 315, 314),
        ("euler", "below", 316, 315),
        ("semi_implicit", "above", 314, 313),
        ("semi_implicit", "below", 315, 314),
        ("rk4", "above", 314, 313),
        ("rk4", "below", 316, 315),
    ],
)
def test_first_impact_under_other_readings_of_step_rule_and_band(step: str, edge: str, carried: int, same: int):
    """`carried`: the transition is the iteration; `same`: the sample of this iteration is in the band and flips."""
    rule = PlantRule(step=step, edge=edge)  # type: ignore[arg-type]
    assert impacts(run(350, rule=rule)) == [carried]
    assert impacts(run(350, rule=replace(rule, judged="same"))) == [same]


@pytest.mark.parametrize(("kappa", "expected"), [(0.5, [315, 648, 981]), (1.5, [315, 623, 931])])
def test_the_other_reading_that_gives_315_parts_from_ours_only_later(kappa: float, expected: list[int]):
    """The paper's 350 iterations cannot tell [−ε0, 0) in the same iteration from (0, ε0] carried."""
    assert impacts(run(1000, Dhvpo(kappa=kappa), rule=PlantRule(edge="below", judged="same"))) == expected


def test_an_estimate_that_is_early_waits_for_the_oscillator():
    """Route 5, which Table 1 never takes: x̂0 = (0.3, 1.5) and a filter that hardly listens."""
    scans = run(350, tuning=replace(TABLE_1, r_x=1e3), x0_hat=(0.3, 1.5))

    assert [scan.k for scan in scans if scan.held] == list(range(296, 315))
    assert {scan.routes for scan in scans[295:314]} == {(2, 4, 5)}
    assert len({(scan.x_hat, scan.P) for scan in scans[294:314]}) == 1  # x̂ and P frozen
    assert impacts(scans) == [315]
    assert scans[314].x_hat[1] == -0.5 * scans[313].x_hat[1]


def delta_v(kappa: float, covariance: ImpactCovariance) -> list[float]:
    scans = run(1000, Dhvpo(kappa=kappa), replace(TABLE_1, covariance=covariance))
    return [scan.delta_v for scan in scans if scan.impact]


def test_figure_3_the_lyapunov_difference_is_zero_with_omega_and_positive_without():
    unchanged, omega = delta_v(1.5, "none"), delta_v(1.5, "omega")
    assert all(dv > 0.0 for dv in unchanged)
    assert unchanged == pytest.approx([4.68e-11, 1.05e-18, 2.3e-26], rel=0.02)  # printed with two or three digits
    # (29): V is a sum of products with a relative rounding error of 2e-16 each, and most of V cancels in δV
    assert all(abs(zero) < 1e-3 * positive for zero, positive in zip(omega, unchanged, strict=True))


def test_at_kappa_below_one_the_unchanged_covariance_also_lessens_v():
    """So Figure 3 needs κ = 1.5."""
    assert all(dv < 0.0 for dv in delta_v(0.5, "none"))
    assert delta_v(0.5, "omega") == pytest.approx([0.0] * 3, abs=1e-21)


def test_as_a_matrix_product_omega_gives_a_singular_asymmetric_covariance_that_fails_29(table_1: list[Scan]):
    P = np.array(table_1[313].P).reshape(2, 2)
    kappa = 0.5
    omega = np.array([[1.0, -1 / kappa], [-1 / kappa, 1 / kappa**2]])
    A = np.diag([1.0, -kappa])

    product = omega @ P
    assert abs(np.linalg.det(product)) < 1e-18  # det Ω = 0
    assert (product[0, 1], product[1, 0]) == pytest.approx((-2.31e-2, -1.43e-4), rel=0.03)
    assert np.abs(A.T @ product @ A - P).max() == pytest.approx(1.15e-2, rel=0.01)

    elementwise = omega * P
    assert np.abs(A.T @ elementwise @ A - P).max() < 1e-17
    assert elementwise.ravel() == pytest.approx(table_1[314].P, rel=1e-12)


def test_the_jacobian_is_the_derivative_of_f():
    model, h = Dhvpo(alpha=0.7, mu=1.3, rho=1.1), 1e-6
    for x in ((0.3, -1.2), (1.7, 0.4), (-0.2, 2.0)):
        columns = [
            np.subtract(
                model.f(x[0] + h * (i == 0), x[1] + h * (i == 1), 0.01),
                model.f(x[0] - h * (i == 0), x[1] - h * (i == 1), 0.01),
            )
            / (2 * h)
            for i in (0, 1)
        ]
        # central differences of a cubic: an error of h² and rounding of 1e-16/h
        assert np.array(model.jacobian(*x, 0.01)).reshape(2, 2) == pytest.approx(np.column_stack(columns), abs=1e-9)


def post_impact_nees(kappa: float, covariance: ImpactCovariance, runs: int = 60) -> float:
    """Mean eᵀP⁻¹e over the 20 scans from the first impact, with Q = 1e-5·I and R = 1e-4 true of the plant."""
    tuning = replace(TABLE_1, q_x=1e-5, q_x_dot=1e-5, r_x=1e-4, covariance=covariance)
    values = []
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        deviations = np.sqrt([1e-5, 1e-5, 1e-4])
        scans = run(
            400, Dhvpo(kappa=kappa), tuning, noise=lambda rng=rng, d=deviations: tuple(rng.normal(size=3) * d)
        )
        hits = impacts(scans)
        if not hits:
            continue  # noise carried it over the band
        for scan in scans[hits[0] - 1 : hits[0] + 19]:
            e = np.subtract(scan.x, scan.x_hat)
            values.append(float(e @ np.linalg.solve(np.array(scan.P).reshape(2, 2), e)))
    return float(np.mean(values))


def test_saltation_keeps_the_filter_consistent_through_an_impact_and_omega_does_not():
    """Ideal is 2. Ω is too cautious below κ = 1 and too confident above; P unchanged lies between."""
    soft = {covariance: post_impact_nees(0.5, covariance) for covariance in ("omega", "none", "saltation")}
    assert soft["omega"] < soft["none"] < soft["saltation"]
    # 60 runs of 20 correlated scans: a standard error of about 0.2
    assert soft == pytest.approx({"omega": 1.25, "none": 1.54, "saltation": 1.95}, abs=0.4)

    hard = {covariance: post_impact_nees(1.5, covariance) for covariance in ("omega", "none", "saltation")}
    assert hard["omega"] > hard["none"] > hard["saltation"]
    assert hard == pytest.approx({"omega": 2.97, "none": 2.44, "saltation": 2.02}, abs=0.4)


def test_the_direction_is_unknown_in_the_first_iteration_only(table_1: list[Scan]):
    assert [scan.k for scan in table_1 if 1 in scan.routes] == [1]
