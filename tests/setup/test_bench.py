"""Every benchmark says what it measures before it measures."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.program import ROOT, environment

BENCHES = sorted((ROOT / "bench").glob("*.py"))


@pytest.mark.parametrize("bench", BENCHES, ids=lambda bench: bench.stem)
def test_help_of_a_benchmark_is_its_usage_and_measures_nothing(bench: Path) -> None:
    command = [sys.executable, str(bench), "--help"]
    done = subprocess.run(
        command, cwd=ROOT, env=environment(), capture_output=True, text=True, timeout=60, check=False
    )

    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"usage: {bench.name} [-h]")
