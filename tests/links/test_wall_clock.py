"""The wall clock is set by an hour, forth and back, under a running process: only the timestamps follow."""

import asyncio
import json
import os
import random
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from softplc.sample import StatusCode
from tests.drivers_modbus.support import running_peer
from tests.support.proxy import Proxy
from tests.support.tasks import Rig

HOUR = 3600.0
LIBRARIES = sorted(Path("/usr/lib").glob("*/faketime/libfaketime.so.1"))
OBSERVER = {"type": "aoi", "q_x": 0.001, "q_x_dot": 0.5, "r_x": 0.01}
ROOT = Path(__file__).parents[2]


async def test_back_off_and_time_limits_do_not_take_notice_of_the_wall_clock():
    """The same outage with and without steps of the wall clock: the same scans are Good, Bad, and read."""

    async def run(step: float) -> list[tuple[int, float, float]]:
        rig = Rig(period=0.1)
        seen: list[tuple[int, float, float]] = []
        random.seed(7)  # the back-off's jitter

        def each(scan: Any) -> None:
            rig.device.reachable = not 10 <= scan.number < 40
            if scan.number in (5, 15, 38, 45):
                rig.clock.step_utc(step if scan.number in (5, 38) else -step)
            seen.append((rig.status("Echo.0"), rig.value("Sources.plc.Reconnects"), scan.dt))

        await rig.run(80, each)
        return seen

    plain = await run(0.0)
    for step in (HOUR, -HOUR):
        assert await run(step) == plain
    assert {status for status, _, _ in plain} == {StatusCode.GOOD, StatusCode.BAD_NO_COMMUNICATION}


class Stepped:
    """tests/links/stepped.py under libfaketime, which takes the offset of the wall clock from a file."""

    def __init__(self, process: asyncio.subprocess.Process, file: Path) -> None:
        self._process, self._file = process, file
        self.lines: list[dict[str, Any]] = []

    def step(self, seconds: float) -> None:
        """The wall clock is so far from the machine's from here on."""
        self._file.write_text(f"{seconds:+.0f}s\n")

    async def until(self, condition: Callable[[dict[str, Any]], bool], what: str, scans: int = 3) -> None:
        """Read lines until the condition held in so many in a row."""
        assert self._process.stdout is not None
        deadline, held = time.monotonic() + 60.0, 0
        while held < scans:
            assert time.monotonic() < deadline, f"{what}: {self.lines[-1:]}"
            line = await asyncio.wait_for(self._process.stdout.readline(), 60.0)
            assert line, "the process ended"
            self.lines.append(json.loads(line))
            held = held + 1 if condition(self.lines[-1]) else 0


def good(line: dict[str, Any]) -> bool:
    return line["status"] == [0, 0]


def away(line: dict[str, Any]) -> float:
    """Seconds of its wall clock ahead of ours."""
    return line["timestamp"] / 1e9 - time.time()


async def test_a_process_whose_wall_clock_is_set_by_an_hour_measures_the_same_steps(tmp_path: Path):
    if not LIBRARIES:
        pytest.skip("libfaketime is not installed: Debian package faketime")
    file = tmp_path / "offset"
    file.write_text("+0s\n")
    environment = {
        **os.environ,
        "LD_PRELOAD": str(LIBRARIES[0]),
        "FAKETIME_TIMESTAMP_FILE": str(file),
        "FAKETIME_NO_CACHE": "1",
        "FAKETIME_DONT_FAKE_MONOTONIC": "1",
        "PYTHONPATH": str(ROOT),
    }
    async with running_peer() as peer, Proxy(peer.port) as proxy:
        await peer.ask("clock", offset=10)
        source = {"type": "modbus", "transport": {"host": "127.0.0.1", "port": proxy.port}, "timeout_ms": 5000}
        axis = {"observer": OBSERVER, "input": {"source": "plc", "address": "holding:10", "data_type": "float64"}}
        document = {
            "tasks": [{"name": "main", "period_ms": 50.0}],
            "sources": [{**source, "name": "plc"}],
            "axes": [{**axis, "name": "A"}, {**axis, "name": "B", "dt_source": "source"}],
            "publishers": [],
        }
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "tests.links.stepped",
            json.dumps(document),
            stdout=asyncio.subprocess.PIPE,
            env=environment,
            cwd=ROOT,
        )
        try:
            run = Stepped(process, file)
            await run.until(good, "Good")
            marks = []
            for step in (HOUR, 0.0, -HOUR, 0.0):
                marks.append(len(run.lines))
                run.step(step)
                await run.until(lambda line, step=step: abs(away(line) - step) < 60.0, f"timestamps {step:+g} s", 10)
            told = run.lines[marks[0] :]
            shown = {status for line in told for status in line["status"]}  # a busy machine answers late: no more
            assert shown <= {StatusCode.GOOD, StatusCode.UNCERTAIN_LAST_USABLE_VALUE}
            for count in ("reconnects", "read_errors"):
                assert {line[count][0] for line in told} == {told[0][count][0]}
            assert all(
                0.0 < line["dt"] < 30.0 for line in told
            )  # an hour it would be; a busy machine is seconds late
            assert all(0.0 < dt < 30.0 for line in told for dt in line["axis_dt"])
            old = [line for line in told if good(line) and abs(line["stamp"][0] - line["timestamp"]) > 30e9]
            assert len(old) <= 4  # what we stamp follows the clock; a step may fall between scan and reply

            for step in (HOUR, -HOUR):  # connections that are lost while the clock is set come back as ever
                run.step(step)
                proxy.reset()
                await run.until(lambda line: not good(line), "the reset is seen", 1)
                await run.until(lambda line, step=step: good(line) and abs(away(line) - step) < 60.0, "Good again")
        finally:
            process.kill()
            await process.wait()
