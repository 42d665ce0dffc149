"""The chaos suite in its long form: every fault of the table, held against its limits.

Usage: python3 dev.py chaos [--quick] [--outage SECONDS] [--resets N] [--ours] [ROW ...]
Prints the table of docs/reliability.md; exit code 1 when a row does not hold. Takes 10 to 15 minutes; `--quick` does
less of everything and asserts no times; `--outage 600` has outages of ten minutes instead of 1 s and 10 s. The
sources are node-opcua and modbus-serial, which need node and the packages of tests/peers (npm ci); with `--ours` it
is softplc's emulator, for the rows that do not need another server.
"""

import argparse
import asyncio
import dataclasses
import sys
import tempfile
import time
from pathlib import Path

import pytest
import structlog

from tests.chaos.claims import LONG, SHORT, Size
from tests.chaos.rig import our_rig, rig
from tests.chaos.rows import ROWS, Row

THIRD_PARTY = ("another server", "silent neighbour")


async def _run(rows: list[Row], size: Size, folder: Path, ours: bool) -> bool:
    held = True
    async with (our_rig if ours else rig)(folder) as made:
        print("| row | fault | expected | result | figure |\n|---|---|---|---|---|", flush=True)
        for row in rows:
            begun = time.monotonic()
            try:
                await made.all_good()
                result, figure = "holds", await row.run(made, size)
            except AssertionError as error:
                result, figure, held = "**fails**", str(error), False
                for proxy in made.proxies.values():
                    proxy.spoil, proxy.delay = None, 0.0
                    proxy.forget(reset=True)
            print(f"| {row.name} | {row.fault} | {row.expectation} | {result} | {figure} |", flush=True)
            print(f"{row.name}: {time.monotonic() - begun:.0f} s", file=sys.stderr, flush=True)
            made.forget()
    return held


def main() -> int:
    names = {row.name: row for row in ROWS}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--outage", type=float, action="append", default=[])
    parser.add_argument("--resets", type=int)
    parser.add_argument("--ours", action="store_true")
    parser.add_argument("rows", nargs="*", metavar="ROW", help=", ".join(names))
    options = parser.parse_args()
    unknown = [name for name in options.rows if name not in names]
    if unknown:
        parser.error(f"no row {', '.join(unknown)}; rows are {', '.join(names)}")
    size = SHORT if options.quick else LONG
    outages, resets = tuple(options.outage) or size.outages, options.resets or size.resets
    size = dataclasses.replace(size, outages=outages, resets=resets)
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(50))
    all_rows = [row for row in ROWS if not (options.ours and row.name in THIRD_PARTY)]
    chosen = [names[name] for name in options.rows] or all_rows
    with tempfile.TemporaryDirectory() as folder:
        try:
            return 0 if asyncio.run(_run(chosen, size, Path(folder), options.ours)) else 1
        except pytest.skip.Exception as missing:
            print(missing, file=sys.stderr)
            return 2


if __name__ == "__main__":
    sys.exit(main())
