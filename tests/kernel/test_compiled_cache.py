"""What was compiled is kept for the next process; where nothing can be written, each compiles for itself."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("numba", reason="numba is not installed: pip install 'softplc[compiled]'")

ROOT = Path(__file__).parents[2]
PREPARE = """
import numpy as np
from softplc.kernel.batch.aoi import AoiBatchState, AoiTuning
from softplc.kernel.compiled import aoi
print(aoi.prepare(np.float64))
one = np.ones(1)
tuning = AoiTuning("f8", q_x=one, q_x_dot=one, r_x=one, BleedEnable=[False], BleedThresh=one, BleedFactor=one)
every = np.array([True])
aoi.step(AoiBatchState(1), tuning, EnableIn=every, x=one, dt=one, rows=every)
"""


def prepare(folder: Path, **environment: str) -> str:
    """Make the compiled kernel of the package in this folder ready in a process of its own; what `prepare` said."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("NUMBA", "COV"))}
    done = subprocess.run(
        [sys.executable, "-c", PREPARE],
        cwd=folder,
        env=kept | {"PYTHONPATH": str(folder)} | environment,
        capture_output=True,
        text=True,
        timeout=110,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_second_process_loads_what_the_first_compiled_into_the_given_folder(tmp_path: Path):
    assert [prepare(ROOT, NUMBA_CACHE_DIR=str(tmp_path)) for _ in range(2)] == ["False", "True"]


def test_installation_where_nothing_can_be_written_compiles_in_memory(tmp_path: Path):
    shutil.copytree(ROOT / "softplc", tmp_path / "softplc", ignore=shutil.ignore_patterns("__pycache__"))
    nowhere = tmp_path / "softplc" / "kernel" / "compiled" / "__pycache__"
    nowhere.write_text("a file where a folder would be: not even root writes there")
    environment = {"HOME": str(nowhere), "XDG_CACHE_HOME": str(nowhere), "PYTHONDONTWRITEBYTECODE": "1"}

    assert [prepare(tmp_path, **environment), nowhere.is_file()] == ["False", True]
