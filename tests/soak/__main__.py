"""python3 dev.py soak [--scans N] [--quick] [OBSERVER …]: a million scans of every observer with faulty samples."""

import argparse
import sys

from softplc.sample import AxisState
from tests.soak.run import OBSERVERS, soak

MOST = 1.0
"""MiB per million scans that memory may grow by."""


def main() -> int:
    """Print a row for each observer; 1 when something was wrong."""
    parser = argparse.ArgumentParser(prog="dev.py soak", description=__doc__)
    parser.add_argument("observers", nargs="*", metavar="OBSERVER", help=f"any of: {', '.join(OBSERVERS)}")
    parser.add_argument("--scans", type=int, default=1_000_000)
    parser.add_argument("--quick", action="store_true", help="20 000 scans each")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    unknown = [name for name in given.observers if name not in OBSERVERS]
    if unknown:
        parser.error(f"no observer {', '.join(unknown)}")
    scans = 20_000 if given.quick else given.scans
    short = scans < 200_000  # what the allocator keeps would be counted many times over

    print("| observer | scans | faulty samples | not RUN | statuses wrong | memory per 10⁶ scans | scan and check |")
    print("|---|---|---|---|---|---|---|", flush=True)
    failed = False
    for name in given.observers or OBSERVERS:
        report = soak(name, scans, given.seed)
        away = 1.0 - report.states[AxisState.RUN] / report.states.sum()
        print(
            f"| {name} | {report.scans:,} | {report.faulty:.2%} | {away:.2%} | {len(report.wrong)} "
            f"| {'' if short else f'{report.growth:+.2f} MiB'} | {report.seconds / report.scans * 1e6:.0f} µs |",
            flush=True,
        )
        print(*report.wrong, sep="\n", end="\n" if report.wrong else "", file=sys.stderr)
        failed |= bool(report.wrong) or (report.growth > MOST and not short)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
