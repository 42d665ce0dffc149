"""docs/studies.md against what the studies give."""

import pytest

from softplc.commissioning.study.aoi_numbers import experiment
from softplc.commissioning.study.method_numbers import compare
from tests.support.program import ROOT

PAGE = (ROOT / "docs" / "studies.md").read_text(encoding="utf-8")


def row(start: str) -> list[str]:
    """Cells of the table row that starts like this."""
    line = next(line for line in PAGE.splitlines() if line.startswith(f"| {start}"))
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_the_methods_table_is_what_the_study_finds():
    for one in compare(0):
        cells = row(one.method.name)
        position, velocity = float(cells[1]), float(cells[2])
        assert position == pytest.approx(one.score.rmse_position, rel=0.005)
        assert velocity == pytest.approx(one.score.rmse_velocity, rel=0.005)
        assert int(cells[3]) == round(one.score.lag * 1000)


def test_the_aoi_numbers_are_what_the_study_finds():
    numbers = experiment(0)
    assert f"overshoot {numbers.overshoots[0]:.2f} and {numbers.overshoots[1]:.2f} u" in PAGE
    assert f"{numbers.quiet_overshoot:.2f} u without noise" in PAGE
    assert f"a true 10 u/s then reads {numbers.bleed[1].velocity_on_ramp:.1f}" in PAGE
    assert f"from scan {max(numbers.settled_scans)} on" in PAGE
