"""Every baseline and cv_accel on one recording beside the AOI, each an axis of the same task."""

import csv
import io
import json
from pathlib import Path

import numpy as np
import pytest

from softplc.app.replay import replay
from softplc.config.models import Config

R = 4 / 3
OBSERVERS = {
    "Difference": {"type": "finite_difference"},
    "Block": {"type": "derivative", "cycle_ms": 50.0},
    "Measured": {"type": "derivative", "dt_mode": "measured", "precision": "real"},
    "Short": {"type": "moving_average", "window": 3},
    "Long": {"type": "moving_average", "window": 30},
    "Fixed": {"type": "alpha_beta", "alpha": 0.22, "beta": 0.0237},
    "Indexed": {"type": "alpha_beta", "sigma_w": 13.6, "sigma_v": R**0.5},
    "Euro": {"type": "one_euro", "min_cutoff": 0.178, "beta": 0.316, "d_cutoff": 0.147},
    "Aoi": {"type": "aoi", "q_x": 0.01, "q_x_dot": 0.316, "r_x": R},
    "Accelerated": {"type": "cv_accel", "q_mode": "white_jerk", "q_jerk": 17.8, "r_x": R},
}


def test_all_observers_replay_one_recording_in_the_order_of_the_method_table(tmp_path: Path):
    velocity = np.repeat([10.0, 0.0, 10.0, 0.0], 300)
    truth = np.cumsum(0.05 * velocity)
    z = truth + np.random.default_rng(1).uniform(-2, 2, 1200)
    recording = tmp_path / "r.csv"
    recording.write_text("t,x\n" + "".join(f"{0.05 * k!r},{value!r}\n" for k, value in enumerate(z.tolist())))
    source = {"source": "recording", "column": "x"}
    data = {
        "tasks": [{"period_ms": 50.0}],
        "sources": [{"name": "recording", "type": "replay", "file": str(recording)}],
        "axes": [{"name": name, "input": source, "observer": one} for name, one in OBSERVERS.items()],
    }
    output = io.StringIO()

    replay(Config.model_validate_json(json.dumps(data)), output)

    rows = list(csv.DictReader(io.StringIO(output.getvalue())))
    assert len(rows) == 1200

    def errors(name: str) -> tuple[float, float]:
        shown = np.array([[float(row[f"{name}.{leaf}"]) for leaf in ("Position", "Velocity")] for row in rows])
        return tuple(np.sqrt(np.mean((shown - np.stack([truth, velocity], axis=1)) ** 2, axis=0)).tolist())

    found = {name: errors(name) for name in OBSERVERS}
    # docs/observers/baselines.md, over twenty realisations; a single one has the corners to 10 %
    expected = {
        "Difference": (1.15, 32.78),
        "Block": (1.15, 10.26),
        "Measured": (1.15, 10.26),
        "Short": (0.75, 10.86),
        "Long": (5.04, 2.24),
        "Fixed": (0.52, 1.67),
        "Indexed": (0.52, 1.68),
        "Euro": (0.67, 2.17),
        "Aoi": (0.51, 1.64),
        "Accelerated": (0.56, 1.98),
    }
    for name, pair in expected.items():
        assert found[name] == pytest.approx(pair, rel=0.1), name
    assert float(rows[-1]["Accelerated.Acceleration"]) == pytest.approx(0.0, abs=5.0)
