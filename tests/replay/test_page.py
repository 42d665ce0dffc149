"""docs/replay.md and the shipped recording: what the page shows is what happens."""

import csv
import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from softplc.drivers.replay import read_columns
from tests.support.program import ROOT, softplc

TEXT = (ROOT / "docs" / "replay.md").read_text(encoding="utf-8")
RECORDING = ROOT / "config" / "recording.csv"


def part(kind: str, name: str) -> str:
    """The block of the page under this mark."""
    found = re.search(rf"<!-- {kind}: {re.escape(name)} -->\n```\w*\n(.*?)```", TEXT, re.S)
    assert found is not None, name
    return found[1]


def run(code: str, folder: Path) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def replayed() -> str:
    done = softplc("replay", "config/replay.yaml")
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_shipped_recording_is_the_papers_experiment_and_made_by_its_script():
    spec = importlib.util.spec_from_file_location("recording", ROOT / "docs" / "scripts" / "recording.py")
    assert spec is not None and spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    assert RECORDING.read_text(encoding="utf-8") == script.recording(), "run docs/scripts/recording.py"
    assert RECORDING.stat().st_size <= 30_000

    t, position, truth = read_columns(RECORDING, ["t", "position", "truth"]).T
    assert t == pytest.approx(np.arange(1200) * 0.05)
    assert truth[::300] == pytest.approx([0.0, 150.0, 150.0, 300.0])
    noise = position - truth
    assert np.abs(noise).max() <= 2.0 + 5e-4  # as it is rounded
    assert noise.var() == pytest.approx(4 / 3, rel=0.1)  # of 1200 uniform values: σ is 2.6 %


def test_the_shipped_example_runs_and_the_comparison_prints_what_the_page_shows(replayed: str, tmp_path: Path):
    (tmp_path / "out.csv").write_text(replayed, encoding="utf-8")
    assert len(replayed.splitlines()) == 1201

    assert run(part("run", "compare"), tmp_path) == part("prints", "compare")


def test_what_replay_writes_is_a_recording_again(replayed: str, tmp_path: Path):
    (tmp_path / "out.csv").write_text(replayed, encoding="utf-8")
    again = read_columns(tmp_path / "out.csv", ["t", "Aoi.Raw"])
    assert again == pytest.approx(read_columns(RECORDING, ["t", "position"]))


def test_a_historians_export_becomes_a_recording(tmp_path: Path):
    (tmp_path / "export.csv").write_text(part("file", "export.csv"), encoding="utf-8-sig")
    run(part("run", "convert"), tmp_path)
    table = read_columns(tmp_path / "recording.csv", ["t", "position"])
    assert table == pytest.approx(np.array([[0, 1.893], [0.05, 2.006], [0.1, np.nan]]), nan_ok=True)


def test_a_recording_that_a_spreadsheet_saved_with_a_byte_order_mark_is_read(tmp_path: Path):
    (tmp_path / "r.csv").write_text("t,x\n0,1\n", encoding="utf-8-sig")
    assert read_columns(tmp_path / "r.csv", ["t", "x"]).tolist() == [[0.0, 1.0]]


def test_its_links_lead_somewhere():
    for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", TEXT):
        assert (ROOT / "docs" / target).exists(), target


def test_the_example_of_a_recording_has_the_first_rows_of_the_shipped_one():
    shown = re.search(r"```\n(t,position,truth\n.*?)```", TEXT, re.S)
    assert shown is not None
    with RECORDING.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert [line.split(",") for line in shown[1].splitlines()[:3]] == rows[:3]
