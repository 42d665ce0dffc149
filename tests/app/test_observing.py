"""The kernel that the service takes, and what it says when that cannot be."""

import io
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import structlog

from softplc.app.replay import replay
from softplc.config.models import Config
from softplc.kernel.compiled import available

ROOT = Path(__file__).parents[2]
needs_numba = pytest.mark.skipif(not available(), reason="numba is not installed: pip install 'softplc[compiled]'")


def settings(folder: Path, kernel: str) -> Config:
    recording = folder / "r.csv"
    if not recording.exists():
        x = np.cumsum(np.random.default_rng(5).normal(size=(60, 2)), axis=0)
        recording.write_text(
            "t,a,b\n" + "".join(f"{k * 0.05!r},{a!r},{b!r}\n" for k, (a, b) in enumerate(x.tolist()))
        )
    observers = [{"type": "aoi", "r_x": 1.0}, {"type": "aoi", "r_x": 2.0, "bleed": {"threshold": 1.0, "factor": 0.5}}]
    data = {
        "sources": [{"name": "recording", "type": "replay", "file": str(recording)}],
        "axes": [
            {"name": f"Axis{i}", "input": {"source": "recording", "column": "ab"[i]}, "observer": observers[i]}
            for i in (0, 1)
        ],
        "realtime": {"kernel": kernel},
    }
    return Config.model_validate_json(json.dumps(data))


@needs_numba
def test_compiled_kernel_gives_the_same_scans_to_the_last_digit_and_says_how_long_it_took_to_get_ready(
    tmp_path: Path,
):
    outputs = {kernel: io.StringIO() for kernel in ("numpy", "compiled")}
    with structlog.testing.capture_logs() as lines:
        for kernel, output in outputs.items():
            replay(settings(tmp_path, kernel), output)

    assert outputs["compiled"].getvalue() == outputs["numpy"].getvalue()
    (line,) = [line for line in lines if line["event"] == "compiled kernel ready"]
    assert line["axes"] == 2
    assert line["compiled"] in {"now", "by an earlier start"}


def test_auto_imports_no_numba_for_a_few_axes(tmp_path: Path):
    code = f"""
import io, sys
from pathlib import Path
from softplc.app.replay import replay
from tests.app.test_observing import settings
replay(settings(Path({str(tmp_path)!r}), "auto"), io.StringIO())
print("numba" in sys.modules)
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=100, check=True
    )
    assert done.stdout.endswith("False\n")


def test_compiled_without_numba_is_a_configuration_error_with_its_place_and_the_command_that_helps(tmp_path: Path):
    file = tmp_path / "plant.yaml"
    file.write_text((ROOT / "config" / "minimal.yaml").read_text() + "realtime: { kernel: compiled }\n")
    code = 'import sys; sys.modules["numba"] = None; from softplc.cli import main; sys.exit(main())'

    done = subprocess.run(
        [sys.executable, "-c", code, "check", str(file)],
        cwd=ROOT,
        env=os.environ | {"NO_COLOR": "1"},
        capture_output=True,
        text=True,
        timeout=100,
        check=False,
    )

    assert done.returncode == 78
    assert "realtime.kernel: compiled needs numba, which is not installed here" in done.stdout + done.stderr
    assert "pip install 'softplc[compiled]'" in done.stdout + done.stderr


@needs_numba
def test_where_memory_may_not_be_made_executable_compiled_is_a_configuration_error(tmp_path: Path):
    code = f"""
import ctypes, io, sys
from pathlib import Path
from softplc.app.replay import replay
from softplc.errors import ConfigError
from tests.app.test_observing import settings
if ctypes.CDLL(None).prctl(65, 1, 0, 0, 0):  # PR_SET_MDWE, as systemd's MemoryDenyWriteExecute
    sys.exit("no MDWE")
try:
    replay(settings(Path({str(tmp_path)!r}), "compiled"), io.StringIO())
except ConfigError as error:
    print(error)
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=100, check=False
    )
    if "no MDWE" in done.stderr:
        pytest.skip("this kernel is older than Linux 6.3")
    assert "realtime.kernel: compiled needs numba, which does not load" in done.stdout
    assert "MemoryDenyWriteExecute" in done.stdout
