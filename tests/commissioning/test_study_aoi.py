"""The AOI paper's experiment against its golden numbers, and the report against a browser."""

import pytest

from softplc.kernel.steady import steady_gains
from tests.commissioning.studies import (
    Done,
    chromium,
    documented_figures,
    is_self_contained,
    rendered,
    run_study,
    shows_something,
)
from tests.support.program import softplc


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Done:
    return run_study("aoi", tmp_path_factory.mktemp("aoi"))


def test_the_gains_settle_at_the_closed_form(done):
    gains = done.numbers["steady_gains"]
    assert gains["K0"] == pytest.approx(0.1704, abs=5e-5)  # four digits are given
    assert gains["K1"] == pytest.approx(0.2494, abs=5e-5)
    assert (gains["K0"], gains["K1"]) == pytest.approx(steady_gains(0.01, 0.1, 4 / 3, 0.05), rel=1e-12)


def test_a_hold_is_2_9_times_quieter_than_what_was_measured(done):
    assert round(done.numbers["hold_noise_reduction"], 1) == 2.9


def test_the_velocity_on_the_first_ramp_is_right_on_average(done):
    ramp = done.numbers["segments"][0]
    assert ramp["velocity_error_mean"] == pytest.approx(0.007, abs=1e-3)
    assert round(ramp["velocity_error_std"], 2) == 0.54


def test_the_estimate_overshoots_at_the_stop_by_2_44(done):
    assert round(done.numbers["overshoot"][0], 2) == 2.44


def test_bleed_biases_the_velocity_on_a_ramp_and_lessens_the_overshoot(done):
    off, *on = done.numbers["bleed"]
    assert abs(off["velocity_bias"]) < 0.05  # three standard errors
    for row, bias in zip(on, (-2.6, -4.01, -5.13), strict=True):
        assert row["velocity_bias"] == pytest.approx(bias, abs=0.3)  # another stretch of the ramp was averaged there
        assert row["overshoot"] < off["overshoot"]


def test_the_bandwidth_depends_on_the_scan_rate_as_the_closed_form_says(done):
    rows = done.numbers["scan_rate"]
    assert [row["dt"] for row in rows] == [0.002, 0.01, 0.02, 0.05, 0.1]
    assert [float(f"{row['bandwidth']:.2g}") for row in rows] == [21.0, 7.6, 5.1, 3.1, 2.1]
    for row in rows:
        assert (row["K0"], row["K1"]) == pytest.approx(steady_gains(0.001, 0.1, 4 / 3, row["dt"]), rel=1e-9)
        assert row["scaled_time_constant"] == pytest.approx(0.596, rel=0.01)


def test_single_precision_differs_by_a_ten_thousandth(done):
    single = done.numbers["single_precision"]
    assert 1e-6 < single["position"] < 2e-4
    assert 1e-6 < single["velocity"] < 2e-4


def test_the_checklist_of_sane_numbers_holds_in_every_scan(done):
    sanity = done.numbers["sanity"]
    assert sanity["S_min"] > 0.0
    assert sanity["P00_min"] >= 0.0
    assert sanity["P11_min"] >= 0.0
    assert 0.0 <= sanity["K0_min"] <= sanity["K0_max"] <= 1.0


def test_the_kalman_filter_has_the_least_errors_of_the_investigations_four_methods(done):
    methods = {row["method"]: row for row in done.numbers["methods"]}
    kalman = methods["2-state Kalman, the AOI"]
    for name in ("moving average", "numerical differentiation", "α-β, tracking index"):
        assert kalman["rmse_position"] < methods[name]["rmse_position"]
        assert kalman["rmse_velocity"] < methods[name]["rmse_velocity"]


def test_what_the_investigation_says_of_the_simple_methods_is_seen_in_numbers(done):
    methods = {row["method"]: row for row in done.numbers["methods"]}
    average, difference = methods["moving average"], methods["numerical differentiation"]
    assert average["lag"] == pytest.approx((average["setting"]["window"] - 1) / 2 * 0.05, rel=0.02)  # its closed form
    assert difference["noise_velocity"] == pytest.approx((2 * 4 / 3) ** 0.5 / 0.05, rel=0.03)  # √(2R)/Δt
    assert difference["lag"] == pytest.approx(0.0, abs=2e-3)


def test_every_claim_holds(done):
    assert [claim["claim"] for claim in done.document["claims"] if not claim["holds"]] == []


def test_the_pictures_are_pngs_that_show_something(done):
    assert "aoi-figure-2.png" in {path.name for path in done.pictures}
    for path in done.pictures:
        assert shows_something(path), path.name


def test_every_figure_is_explained_in_the_docs(done):
    assert {path.stem for path in done.pictures} == documented_figures("aoi")


def test_the_report_loads_nothing_and_holds_every_picture(done):
    assert is_self_contained(done.html)
    assert done.html.count("data:image/png;base64,") == len(done.pictures)


def test_the_folder_holds_what_was_told_and_nothing_is_left_elsewhere(done):
    assert sorted(map(str, done.folder.iterdir())) == sorted(done.document["files"])
    assert list(done.home.iterdir()) == []


def test_again_without_options_the_folder_is_study_aoi_and_the_bytes_are_the_same(done, tmp_path):
    folder = tmp_path / "study-aoi"
    folder.mkdir()
    (folder / "notes.txt").write_text("mine")
    (folder / "report.html").write_text("of last week")
    again = softplc("study", "aoi", cwd=tmp_path, timeout=110)
    assert again.returncode == 0, again.stderr
    assert "2.44 u" in again.stdout
    assert "study-aoi/report.html" in again.stdout
    assert (folder / "notes.txt").read_text() == "mine"
    for path in done.folder.iterdir():
        assert (folder / path.name).read_bytes() == path.read_bytes(), path.name


@pytest.mark.skipif(chromium() is None, reason="no Chromium here (Debian: apt install chromium)")
def test_chromium_renders_the_report_without_a_complaint(done, tmp_path):
    said, picture = rendered(done.folder / "report.html", tmp_path)
    assert said == ""
    assert shows_something(picture)
