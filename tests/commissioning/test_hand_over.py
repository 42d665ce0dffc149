"""What becomes of a finished study."""

import json
import math
from pathlib import Path

import pytest

from softplc.cli.studying import hand_over
from softplc.commissioning.report import Claim, Report
from softplc.commissioning.study.study import Study, save
from softplc.errors import SoftplcError


def study(*, holds: bool) -> Study:
    claims = [Claim("water is wet", "wet", "dry", holds), Claim("fire is hot", "hot", "hot", holds=True)]
    return Study("x", Report("X", "", [("1 u", "what")], claims, [], ""), {"value": math.nan})


@pytest.mark.parametrize("as_json", [False, True])
def test_a_claim_that_fails_makes_the_command_fail_and_is_named(as_json: bool, tmp_path: Path, capsys):
    assert hand_over(study(holds=False), tmp_path, as_json=as_json) == 1
    said = capsys.readouterr()
    assert "not reproduced: water is wet" in said.err
    assert "fire" not in said.err
    assert (tmp_path / "report.html").exists()  # it says which


def test_where_all_hold_the_command_succeeds_and_says_what_it_wrote(tmp_path: Path, capsys):
    assert hand_over(study(holds=True), tmp_path, as_json=False) == 0
    said = capsys.readouterr()
    assert str(tmp_path / "report.html") in said.out
    assert "holds  water is wet: dry (expected wet)" in said.out
    assert said.err == ""


def test_json_is_json_whatever_the_numbers(tmp_path: Path, capsys):
    hand_over(study(holds=True), tmp_path, as_json=True)
    document = json.loads(capsys.readouterr().out)
    assert document["numbers"] == {"value": None}
    assert document["files"] == [str(tmp_path / "report.html")]


def test_a_folder_below_a_file_is_an_error_that_names_it(tmp_path: Path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(SoftplcError, match="file/below: cannot write"):
        save(study(holds=True), tmp_path / "file" / "below")
