"""The DUCEKF paper's case study against its golden numbers, and the report against a browser."""

import re

import pytest

from tests.commissioning.studies import (
    Done,
    chromium,
    documented_figures,
    is_self_contained,
    rendered,
    run_study,
    shows_something,
)

DIGITS = 5e-9  # numbers below are printed with nine significant digits


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Done:
    return run_study("ducekf", tmp_path_factory.mktemp("ducekf"))


def test_the_paths_are_those_of_table_a2(done):
    paths = [(path["first"], path["last"], path["routes"], path["quantity"]) for path in done.numbers["paths"]]
    assert paths == [
        (1, 1, [1, 4, 6], 1),
        (2, 314, [2, 4, 6], 313),
        (315, 315, [2, 3], 1),
        (316, 350, [2, 4, 6], 35),
    ]


def test_the_impacts_are_at_315_and_every_331_or_307_iterations_after(done):
    assert done.numbers["impacts"] == {"kappa_0.5": [315, 646, 977, 1308], "kappa_1.5": [315, 622, 929, 1236]}


def test_state_and_covariance_at_the_first_impact(done):
    impact = done.numbers["first_impact"]
    assert impact["x"] == pytest.approx([0.01118782, 0.75101714], abs=DIGITS)
    before, after = (9.16176026e-5, 9.9989831e-6, 1.15433729e-2), (9.16176026e-5, -1.99979662e-5, 4.61734914e-2)
    for name, golden in (("P_before", before), ("P_after", after)):
        P00, P01, P10, P11 = impact[name]
        assert pytest.approx(golden, rel=1e-8) == (P00, P01, P11)
        assert P10 == P01


def test_the_estimate_converges_from_another_velocity(done):
    convergence = done.numbers["convergence"]
    assert convergence["x_hat_1"] == pytest.approx([0.0150014916, 1.7821822], abs=5e-8)
    assert convergence["velocity_error_below_0.015_from"] == 64
    assert abs(convergence["velocity_error_100"]) == pytest.approx(6.3e-3, rel=0.01)
    assert abs(convergence["velocity_error_314"]) == pytest.approx(5.7e-5, rel=0.01)


def test_figure_3_v_does_not_change_with_omega_and_grows_without(done):
    impacts = done.numbers["lyapunov"]["kappa_1.5"]
    assert [one["k"] for one in impacts] == [315, 622, 929]
    for one, golden in zip(impacts, (4.68e-11, 1.05e-18, 2.3e-26), strict=True):
        assert one["ekf"] > 0.0
        assert one["ekf"] == pytest.approx(golden, rel=0.02)  # printed with two or three digits
        assert one["ekf"] / one["ekf_before"] == pytest.approx(1.5 * 1.5 - 1.0, rel=0.01)  # V lies in e(2) alone
        assert abs(one["ducekf"]) < 1e-3 * one["ekf"]  # the last bits of an error that has converged


def test_at_kappa_0_5_v_falls_without_omega_too(done):
    soft = done.numbers["lyapunov"]["kappa_0.5"]
    assert soft[0]["ekf"] == pytest.approx(-2.8e-11, rel=0.01)
    assert all(one["ekf"] < 0.0 for one in soft)


def test_omega_is_entry_by_entry_and_not_a_matrix_product(done):
    omega = done.numbers["omega"]
    assert omega["elementwise_29"] < 1e-16
    assert omega["product_29"] == pytest.approx(1.15e-2, rel=0.01)
    assert (omega["product_P01"], omega["product_P10"]) == pytest.approx((-2.31e-2, -1.43e-4), rel=0.01)


def test_an_estimate_that_is_early_is_held_for_19_scans(done):
    assert done.numbers["hold"] == {"first": 296, "last": 314, "scans": 19, "impacts": [315]}


def test_other_readings_of_the_paper_meet_at_315_and_part_at_the_second_impact(done):
    found = {
        (one["step"], one["edge"], one["judged"]): one["impacts"]
        for one in done.numbers["readings"]
        if one["impacts"][0] == 315
    }
    assert found == {
        ("euler", "above", "carried"): [315, 646, 977],
        ("euler", "below", "same"): [315, 648, 981],
        ("semi_implicit", "below", "carried"): [315, 647, 979],
        ("rk4", "below", "same"): [315, 647, 979],
    }


def test_saltation_is_consistent_when_there_is_noise_and_omega_is_not(done):
    nees = {(one["kappa"], one["covariance"]): one["nees"] for one in done.numbers["consistency"]}
    golden = {
        (0.5, "omega"): 1.25,
        (0.5, "none"): 1.54,
        (0.5, "saltation"): 1.95,
        (1.5, "omega"): 2.97,
        (1.5, "none"): 2.44,
        (1.5, "saltation"): 2.02,
    }
    assert nees == pytest.approx(golden, abs=0.4)  # two standard errors of 120 runs of 20 correlated scans, at most


def test_the_papers_own_statistics_are_recomputed(done):
    paper = done.numbers["paper_statistics"]
    assert [round(paper[name], 4) for name in ("mean", "variance", "deviation")] == [252.972, 0.2736, 0.5231]


def test_every_time_is_measured_here(done):
    timing = done.numbers["timing"]
    assert len(timing["paths_us"]) == 4
    assert all(time > 0.0 for time in timing["paths_us"])
    assert all(timing["processes_us"][name] > 0.0 for name in ("main_algorithm", "picture", "output"))
    assert timing["statistics"]["variance"] == pytest.approx(timing["statistics"]["deviation"] ** 2)


def test_every_claim_holds(done):
    assert [claim["claim"] for claim in done.document["claims"] if not claim["holds"]] == []


def test_the_figures_of_the_paper_are_pngs_that_show_something(done):
    names = {path.name for path in done.pictures}
    assert {f"ducekf-figure-{number}.png" for number in (1, 2, 3, 7)} <= names
    for path in done.pictures:
        assert shows_something(path), path.name


def test_every_figure_is_explained_in_the_docs(done):
    assert {path.stem for path in done.pictures} == documented_figures("ducekf")


def test_the_report_loads_nothing_and_holds_every_picture(done):
    assert is_self_contained(done.html)
    assert done.html.count("data:image/png;base64,") == len(done.pictures)


def test_the_folder_holds_what_was_told_and_nothing_is_left_elsewhere(done):
    assert sorted(map(str, done.folder.iterdir())) == sorted(done.document["files"])
    assert list(done.home.iterdir()) == []


def test_the_report_quotes_the_papers_times_beside_the_measured_ones(done):
    text = re.sub(r"<[^>]+>", " ", re.sub(r"data:image/png;base64,[^\"]*", "", done.html))
    for printed in ("252.972", "0.2736", "0.5231", "67\u202f932", "253.0", "243.2", "95.496", "95.492"):
        assert printed in text


@pytest.mark.skipif(chromium() is None, reason="no Chromium here (Debian: apt install chromium)")
def test_chromium_renders_the_report_without_a_complaint(done, tmp_path):
    said, picture = rendered(done.folder / "report.html", tmp_path)
    assert said == ""
    assert shows_something(picture)
