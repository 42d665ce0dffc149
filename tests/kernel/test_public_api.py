"""The kernel as a library: importable without a server, and the script that teaches it says what the page says."""

import doctest
import subprocess
import sys
from pathlib import Path

import pytest

import softplc.kernel

ROOT = Path(__file__).parents[2]


def test_the_example_of_the_package_is_true():
    assert doctest.testmod(softplc.kernel) == doctest.TestResults(failed=0, attempted=8)


def test_every_public_name_has_a_docstring():
    assert [name for name in softplc.kernel.__all__ if not getattr(softplc.kernel, name).__doc__] == []


def test_the_kernel_imports_numpy_and_nothing_heavier():
    code = (
        "import sys, softplc.kernel\n"
        "heavy = {'asyncio', 'asyncua', 'pymodbus', 'pydantic', 'structlog', 'numba', 'scipy', 'softplc.config'}\n"
        "print(sorted(heavy & set(sys.modules)))"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert shown.stdout.strip() == "[]"


def test_the_script_by_hand_and_the_kernel_agree_and_show_the_paper_s_experiment():
    script = subprocess.run(
        [sys.executable, "docs/kalman_by_hand.py"], capture_output=True, text=True, check=True, cwd=ROOT, env=_env()
    )
    lines = script.stdout.splitlines()
    assert lines[1] == lines[2] != ""  # the scan by hand and by the kernel
    for figure in ("K0 = 0.4370161858", "K0 = 0.170412, K1 = 0.249438", "10.01 ± 0.54 u/s", "2.44 u"):
        assert figure in script.stdout


def _env() -> dict[str, str]:
    return {"PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "utf-8"}


def test_what_does_not_fit_is_told_in_words():
    bleed = {"BleedEnable": [False], "BleedThresh": [0.0], "BleedFactor": [1.0]}
    with pytest.raises(ValueError, match="expected one q_x for each axis"):
        softplc.kernel.AoiTuning("f8", q_x=0.01, q_x_dot=0.1, r_x=1.0, **bleed)
    with pytest.raises(ValueError, match=r"expected one r_x for each axis as q_x has them, found \[2\]"):
        softplc.kernel.AoiTuning("f8", q_x=[0.01], q_x_dot=[0.1], r_x=[1.0, 2.0], **bleed)
    tuning = softplc.kernel.AoiTuning("f8", q_x=[0.01], q_x_dot=[0.1], r_x=[1.0], **bleed)
    with pytest.raises(ValueError, match="unknown backend 'gpu'"):
        softplc.kernel.run_aoi(tuning, x=[0.0], dt=50.0, backend="gpu")
    with pytest.raises(ValueError, match="r_x and dt_s above 0"):
        softplc.kernel.steady_gains(0.01, 0.1, 0.0, 0.05)
