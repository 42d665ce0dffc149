"""The method tables of docs/observers: what the pages print is what the kernels give."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.timeout(600)  # some 5 s of arithmetic, on however busy a machine
def test_the_tables_of_the_pages_are_those_that_the_script_makes():
    made = subprocess.run(
        [sys.executable, "docs/scripts/baselines.py", "--check"],
        capture_output=True,
        text=True,
        encoding="utf-8",
        cwd=ROOT,
        env={"PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "utf-8"},
        check=False,
    )
    assert made.returncode == 0, made.stdout + made.stderr
