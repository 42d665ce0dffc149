"""The study commands: experiments of the papers, as a report in a folder."""

import sys
import time
from pathlib import Path

from softplc.cli.output import messages, print_json
from softplc.commissioning.study.study import Study, expect_folder, save
from softplc.errors import SoftplcError


def aoi(folder: Path, seed: int, *, as_json: bool) -> int:
    """Write the AOI study; see `softplc study aoi --help`."""
    from softplc.commissioning.study.aoi import study  # noqa: PLC0415

    expect_folder(folder)
    return hand_over(study(seed), folder, as_json=as_json)


def ducekf(folder: Path, seed: int, *, as_json: bool) -> int:
    """Write the DUCEKF study; see `softplc study ducekf --help`."""
    from softplc.commissioning.study.ducekf import study  # noqa: PLC0415

    expect_folder(folder)
    return hand_over(study(time.perf_counter_ns, seed), folder, as_json=as_json)


def hand_over(study: Study, folder: Path, *, as_json: bool) -> int:
    """Write a finished study and tell of it; returns the exit code, which is 0 only when every claim holds."""
    files = save(study, folder)
    if as_json:
        claims = [
            {"claim": claim.text, "expected": claim.expected, "found": claim.found, "holds": claim.holds}
            for claim in study.report.claims
        ]
        print_json(
            {"study": study.name, "files": [str(path) for path in files], "claims": claims, "numbers": study.numbers}
        )
    else:
        lines = [study.report.title]
        lines += [f"  {value:<18} {what}" for value, what in study.report.headline]
        lines += [
            f"  {'holds' if claim.holds else 'FAILS':<6} {claim.text}: {claim.found} (expected {claim.expected})"
            for claim in study.report.claims
        ]
        lines += [str(path) for path in files]
        sys.stdout.write("\n".join(lines) + "\n")
    if not study.reproduced():
        failed = [claim.text for claim in study.report.claims if not claim.holds]
        messages.print(f"not reproduced: {'; '.join(failed)}", style="red", markup=False)
        return SoftplcError.exit_code
    return 0
