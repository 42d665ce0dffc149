"""Whatever a source writes into its stamps: Δt adds up to the time that passed, is never negative, and is told."""

import asyncio
import math
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta

import pytest

from softplc.sample import Reason, StatusCode
from tests.drivers_opcua.paths import every_path, on
from tests.drivers_opcua.servers import NEVER, AsyncuaPlc
from tests.links.plant import PERIOD, Shown, add, number, plant

HOUR = timedelta(hours=1)
CENTURIES = timedelta(days=80_000)
RATE = 10.0  # units per second
BEGIN = datetime(2024, 5, 17, 8, 30, tzinfo=UTC)
ROUNDS = 40
TURN = ROUNDS // 2
CASES: dict[str, Callable[[datetime, int], datetime | None]] = {
    "Right": lambda now, _: now,
    "Frozen": lambda _, __: BEGIN,
    "Backwards": lambda _, k: BEGIN - timedelta(seconds=k),
    "Ahead": lambda now, _: now + HOUR,
    "Behind": lambda now, _: now - HOUR,
    "JumpsAhead": lambda now, k: now + HOUR if k > TURN else now,
    "JumpsBack": lambda now, k: now - HOUR if k > TURN else now,
    "ToAndFro": lambda now, k: now + (-1) ** k * HOUR,
    "Year9999": lambda _, __: NEVER,
    "Year9999Once": lambda now, k: NEVER if k == TURN else now,
    "None": lambda _, __: None,
    "NoneOnce": lambda now, k: None if k == TURN else now,
    "Year1601": lambda _, __: datetime(1601, 1, 1, tzinfo=UTC),
    "Duplicated": lambda now, k: now - timedelta(milliseconds=k % 2),
    "Centuries": lambda now, _: now + CENTURIES,
}
WATCHED = {"WatchedFrozen": "Frozen", "WatchedRight": "Right"}
SOURCES = ("source", "arrival", "scan")


@pytest.fixture(scope="module")
def plc() -> Iterator[AsyncuaPlc]:
    server = AsyncuaPlc()
    server.run(add(server, [*(f"{name}_{dt}" for name in CASES for dt in SOURCES), *WATCHED]))
    yield server
    server.close()


def write(plc: AsyncuaPlc, k: int, position: float) -> None:
    """One sample of every case, of the same moment."""
    now = datetime.now(UTC)
    for name, stamp in CASES.items():
        for dt in SOURCES:
            plc.write(f"{name}_{dt}", number(position, SourceTimestamp=stamp(now, k)))
    for name, case in WATCHED.items():
        plc.write(name, number(position, SourceTimestamp=CASES[case](now, k)))


@every_path
async def test_steps_add_up_to_the_time_that_passed_whatever_the_stamps_say(plc: AsyncuaPlc, path: str):
    own = {f"{name}_{dt}": {"dt_source": dt} for name in CASES for dt in SOURCES}
    own |= {name: {"stale_after_ms": 400.0} for name in WATCHED}
    write(plc, 0, 0.0)
    with on(path) as mode:
        async with plant(plc, list(own), mode, keep=True, own=own) as axes:
            await axes.until(lambda: all(s.status == 0 for s in axes.shown.values()) and bool(axes.shown), "Good")
            begun = time.monotonic()
            marks = {name: len(seen) for name, seen in axes.history.items()}
            for k in range(1, ROUNDS + 1):
                await asyncio.to_thread(write, plc, k, RATE * (time.monotonic() - begun))
                await axes.scan()
            for name in own:
                judge(name, axes.history[name][marks[name] :], mode)
            for offset in (CENTURIES, HOUR, timedelta()):  # the newest of those that moved
                plc.write("Right_scan", number(offset.total_seconds(), SourceTimestamp=datetime.now(UTC) + offset))
                away = offset.total_seconds()
                await axes.until(lambda away=away: abs(axes.value("Sources.plc.Skew") - away) < 5.0, f"Skew {away}")


def judge(name: str, seen: list[Shown], mode: str) -> None:
    if name in WATCHED:
        reasons = [each.reason for each in seen]
        if WATCHED[name] == "Frozen":
            told = [(StatusCode.UNCERTAIN_LAST_USABLE_VALUE, 1), (StatusCode.BAD_OUT_OF_SERVICE, 0)]
            assert set(told) <= {(each.status, each.quality) for each in seen if each.reason == Reason.STAMP_FROZEN}
            assert seen[-1].status == StatusCode.BAD_OUT_OF_SERVICE
            assert math.isnan(seen[-1].position)
        else:
            assert Reason.STAMP_FROZEN not in reasons
        return
    steps = [each.dt for each in seen[1:] if each.reason != Reason.PREDICTED]
    assert all(math.isfinite(each.dt) and each.dt >= 0.0 for each in seen), name
    assert min(steps, default=0.0) > 0.0, f"{name}: {seen}"
    # the time of the first scan is not counted; at either end a sample may be late by two reports
    late = (4.0 if mode == "subscribe" else 2.0) * max(PERIOD, *steps)
    passed = sum(steps)
    assert passed == pytest.approx(seen[-1].start - seen[0].start, abs=late), name
    # a Δt that was wrong by the hour, or close to zero, would show here
    assert all(abs(each.velocity) < 5.0 * RATE for each in seen), name
