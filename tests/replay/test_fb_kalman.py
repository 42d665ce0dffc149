"""The PLC's block, its cure and the AOI on one recording, each an axis of the same task."""

import csv
import io
import json
from pathlib import Path

import numpy as np
import pytest

from softplc.app.replay import replay
from softplc.config.models import Config

OBSERVERS = {
    "Written": {"type": "fb_kalman", "R": 1.0},
    "Written32": {"type": "fb_kalman", "R": 1.0, "precision": "real"},
    "Cured": {"type": "fb_kalman", "R": 1.0, "variant": "corrected"},
    "Aoi": {"type": "aoi", "q_x": 0.0, "q_x_dot": 0.1, "r_x": 1.0},
}


def test_on_a_recording_the_cure_settles_on_the_aoi_and_the_block_as_written_is_six_times_as_noisy(tmp_path: Path):
    z = 3.0 * 0.1 * np.arange(3000) + np.random.default_rng(3).normal(size=3000)
    recording = tmp_path / "r.csv"
    recording.write_text("t,x\n" + "".join(f"{0.1 * k!r},{value!r}\n" for k, value in enumerate(z.tolist())))
    source = {"source": "recording", "column": "x"}
    data = {
        "tasks": [{"period_ms": 100.0}],
        "sources": [{"name": "recording", "type": "replay", "file": str(recording)}],
        "axes": [{"name": name, "input": source, "observer": one} for name, one in OBSERVERS.items()],
    }
    output = io.StringIO()

    replay(Config.model_validate_json(json.dumps(data)), output)

    rows = list(csv.DictReader(io.StringIO(output.getvalue())))[500:]
    velocity = {name: np.array([float(row[f"{name}.Velocity"]) for row in rows]) for name in OBSERVERS}
    # 0.88^500 is 1e-27; the CSV prints nine digits
    assert velocity["Cured"] == pytest.approx(velocity["Aoi"], rel=1e-7, abs=1e-7)
    # 2 500 scans are some 250 independent velocities: 5 % of each standard deviation, and 15 % are three times that
    assert velocity["Written"].std() / velocity["Cured"].std() == pytest.approx(6.34, rel=0.15)
    # single precision of a position near 900 is 6e-5, and the velocity gain of 1.7/s works on it over some scans
    assert velocity["Written32"] == pytest.approx(velocity["Written"], abs=1e-2)
