"""Recordings on the virtual clock, through the whole scan engine."""

import csv
import io
import json

import numpy as np
import pytest

from softplc.app.replay import replay
from softplc.config.models import Config
from softplc.errors import LinkError, UsageError
from softplc.kernel.reference.aoi import AoiInputs, AoiState, aoi_lreal
from tests.support.program import softplc

OBSERVER = {"type": "aoi", "q_x": 0.01, "q_x_dot": 0.1, "r_x": 4 / 3}


def config(path, period_ms=50.0, **axis) -> Config:
    data = {
        "tasks": [{"period_ms": period_ms}],
        "sources": [{"name": "recording", "type": "replay", "file": str(path)}],
        "axes": [{"name": "X", "input": {"source": "recording", "column": "x"}, "observer": OBSERVER, **axis}],
    }
    return Config.model_validate_json(json.dumps(data))


def write(path, rows) -> None:
    path.write_text("# a comment\nt,x\n" + "".join(f"{t!r},{x!r}\n" for t, x in rows))


def replayed(settings: Config) -> dict[str, np.ndarray]:
    output = io.StringIO()
    scans = replay(settings, output)
    rows = list(csv.DictReader(io.StringIO(output.getvalue())))
    assert len(rows) == scans
    return {
        name: np.array([int(row[name], 16) if name.endswith("Status") else float(row[name]) for row in rows])
        for name in rows[0]
    }


def test_a_recording_gives_what_the_reference_gives_scan_by_scan(tmp_path):
    rng = np.random.default_rng(5)
    z = np.concatenate([np.arange(100) * 0.5, np.full(100, 50.0)]) + rng.uniform(-2, 2, 200)
    write(tmp_path / "r.csv", [(k * 0.05, float(value)) for k, value in enumerate(z)])

    out = replayed(config(tmp_path / "r.csv"))

    state = AoiState()
    expected = []
    for value, dt in zip(z, out["dt"], strict=True):
        state, _ = aoi_lreal(state, AoiInputs(True, value, dt * 1000.0, 0.01, 0.1, 4 / 3))
        expected.append((state.y, state.y_dot))
    # the CSV prints dt with nanoseconds, the virtual clock's own dt has more digits
    assert np.column_stack([out["X.Position"], out["X.Velocity"]]) == pytest.approx(np.array(expected), abs=1e-6)


def test_a_source_whose_period_slips_from_10_to_12_5_ms_reads_10_with_measured_dt(tmp_path):
    """The source samples 10 u/s every 10 ms, then every 12.5 ms; a nominal 10 ms would read 12.50."""
    times = np.concatenate([np.arange(0, 2, 0.010), 2 + np.arange(0, 8, 0.0125)])
    write(tmp_path / "slip.csv", [(float(t), float(10 * t)) for t in times])

    out = replayed(config(tmp_path / "slip.csv", 12.5, dt_source="source"))
    assert out["X.Velocity"][-1] == pytest.approx(10.0, abs=0.005)

    nominal = AoiState()
    for t in times:
        nominal, _ = aoi_lreal(nominal, AoiInputs(True, 10 * t, 10.0, 0.01, 0.1, 4 / 3))
    assert nominal.y_dot == pytest.approx(12.5, abs=0.005)


def test_an_empty_cell_is_a_bad_sample_and_the_next_good_one_goes_on(tmp_path):
    rows = [f"{k * 0.05},{k}" for k in range(10)]
    rows[5] = "0.25,"
    (tmp_path / "r.csv").write_text("t,x\n" + "\n".join(rows) + "\n")

    out = replayed(config(tmp_path / "r.csv"))

    assert out["X.Quality"].tolist() == [1] + [2] * 4 + [1] + [2] * 4
    assert np.isfinite(out["X.Position"]).all()


def test_a_missing_column_is_named_with_those_that_are_there(tmp_path):
    (tmp_path / "r.csv").write_text("time,pos\n0,1\n")
    with pytest.raises(LinkError, match="no column 't'; the header has time, pos"):
        replay(config(tmp_path / "r.csv"), io.StringIO())


def test_a_row_that_is_not_numbers_is_named_by_its_line(tmp_path):
    (tmp_path / "r.csv").write_text("t,x\n0,1\n0.05,one\n")
    done = _command(tmp_path)
    assert done.returncode == 69
    assert "line 3" in done.stderr


def test_times_that_go_back_are_refused(tmp_path):
    (tmp_path / "r.csv").write_text("t,x\n0,1\n0.05,2\n0.04,3\n")
    done = _command(tmp_path)
    assert done.returncode == 69
    assert "must ascend" in done.stderr


def test_replay_refuses_sources_that_are_no_recordings(tmp_path):
    settings = json.loads(config(tmp_path / "r.csv").model_dump_json(exclude_none=True))
    settings["sources"].append({"name": "plc", "type": "opcua", "url": "opc.tcp://127.0.0.1:1"})
    with pytest.raises(UsageError, match="all of type replay"):
        replay(Config.model_validate_json(json.dumps(settings)), io.StringIO())


def test_the_command_writes_the_rows_to_stdout(tmp_path):
    write(tmp_path / "r.csv", [(k * 0.05, float(k)) for k in range(21)])
    done = _command(tmp_path)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0].startswith("t,dt,X.Position,X.Velocity")
    assert len(lines) == 22
    assert "21 scans" in done.stderr
    assert "not seen" not in done.stderr


def test_rows_between_two_scans_are_told(tmp_path):
    write(tmp_path / "r.csv", [(k * 0.02, float(k)) for k in range(51)])
    done = _command(tmp_path)
    assert done.returncode == 0
    assert "30 of 51 rows came between two scans" in " ".join(done.stderr.split())


def _command(folder):
    path = folder / "replay.yaml"
    path.write_text(
        f"""sources:
  - {{name: recording, type: replay, file: "{folder / "r.csv"}"}}
axes:
  - name: X
    input: {{source: recording, column: x}}
    observer: {{type: aoi, r_x: 1.0}}
"""
    )
    return softplc("replay", str(path))
