"""Held, stopped, frozen, lost: what proof of life a source gives beyond its connection, on a virtual clock."""

import itertools
import math
from collections.abc import Callable, Iterable, Iterator

import numpy as np
import pytest
import structlog
from hypothesis import given
from hypothesis import strategies as st

from softplc.life import AHEAD, Heartbeat, Life, Stamps
from softplc.sample import Reason, StatusCode
from softplc.tags import Image
from softplc.timing import Scan
from tests.support.tasks import Rig

PERIOD = 0.1
UTC = 1_700_000_000_000_000_000
HOUR = 3_600_000_000_000


def counting(*values: float) -> Iterator[float]:
    return itertools.cycle(values)


ROLLING = {
    "Boolean": counting(0.0, 1.0),
    "Byte that rolls over": (float(k % 256) for k in itertools.count(250)),
    "Int16 that rolls over": (float((k + 32768) % 65536 - 32768) for k in itertools.count(32760)),
    "UInt16 by 1000": (float(1000 * k % 65536) for k in itertools.count()),
    "UInt32 that rolls over": (float(k % 2**32) for k in itertools.count(2**32 - 9)),
    "Int64 of nanoseconds": (float(UTC + 50_000_000 * k) for k in itertools.count()),
    "Float": counting(0.5, math.inf, -0.5),
    "Double that counts down": (-0.001 * k for k in itertools.count()),
}


@pytest.mark.parametrize("kind", ROLLING)
def test_a_heartbeat_of_any_type_that_moves_is_alive_also_where_it_rolls_over(kind: str):
    beat = Heartbeat(0, timeout=0.3)
    for k, value in zip(range(100), ROLLING[kind], strict=False):
        beat.look(value, 0, k * 0.1)
        assert not beat.stopped


@pytest.mark.parametrize(("value", "status"), [(7.0, 0), (math.nan, 0), (math.nan, 0x808B0000), (7.0, 0x40900000)])
def test_a_heartbeat_that_stands_still_is_stopped_after_its_timeout_and_lost_after_three(value: float, status: int):
    beat = Heartbeat(0, timeout=1.0)
    beat.look(1.0, 0, 0.0)
    beat.look(7.0, 0, 0.125)
    seen = []
    for k in range(1, 40):
        beat.look(value, status, 0.125 + 0.125 * k)
        seen.append((beat.stopped, beat.lost))
    assert [[each[n] for each in seen].index(True) + 1 for n in range(2)] == [8, 24]


def test_outages_and_long_pauses_do_not_count_and_hide_no_stopped_program():
    beat = Heartbeat(0, timeout=1.0)
    beat.look(1.0, 0, 0.0)
    beat.look(1.0, 0, 600.0)  # the process was stopped, or the link
    assert not beat.stopped
    for k in range(9):  # a link that is lost every 0.9 s
        beat.pause()
        beat.look(1.0, 0, 700.0 + 10 * k)
        beat.look(1.0, 0, 700.1 + 10 * k)
    assert beat.stopped


@given(st.lists(st.tuples(st.floats(allow_nan=True), st.floats(0.0, 10.0), st.booleans()), max_size=60))
def test_it_is_stopped_exactly_when_nothing_changed_for_the_timeout(looks: list[tuple[float, float, bool]]):
    beat, now, still, last, paused = Heartbeat(0, timeout=2.0), 0.0, 0.0, math.nan, True
    for value, pause, bad in looks:
        now += pause
        if not paused:
            still += min(pause, 1.0)
        paused = False
        beat.look(math.nan if bad else value, 0x80000000 if bad else 0, now)
        if not bad and not math.isnan(value) and value != last:
            still = still if math.isnan(last) else 0.0
            last = value
        assert abs(still - 2.0) < 1e-6 or beat.stopped == (still >= 2.0)
        assert beat.stopped or not beat.lost


class Plant:
    """A rig whose second reading is the heartbeat; records what the first one shows."""

    def __init__(self, life: Life) -> None:
        self.rig = Rig(period=PERIOD, readings=2, life=life)
        self.beats = 0.0
        self.seen: list[tuple[int, int]] = []

    async def run(self, scans: int, each: Callable[[int], None]) -> None:
        def after(scan: Scan) -> None:
            self.seen.append((self.rig.status("Echo.0"), int(self.rig.task.inputs.causes[0])))
            each(scan.number)

        await self.rig.run(scans, after)


async def test_a_program_that_stops_makes_every_sample_of_its_source_uncertain_then_bad_until_it_runs():
    plant = Plant(Life(Heartbeat(1, timeout=0.5)))
    rig = plant.rig

    def beat(number: int) -> None:
        if not 10 <= number < 40:
            rig.device.values[1] = number % 2
        if number in (9, 17, 30, 45):
            shown.append(rig.value("Sources.plc.Heartbeat"))

    shown: list[float] = []
    with structlog.testing.capture_logs() as log:
        await plant.run(50, beat)

    good, doubtful, lost = (0, 0), (StatusCode.UNCERTAIN_LAST_USABLE_VALUE, 23), (StatusCode.BAD_OUT_OF_SERVICE, 23)
    order = [key for key, _ in itertools.groupby(plant.seen)]
    assert order[-5:] == [good, doubtful, lost, good] or order[-4:] == [good, doubtful, lost, good]
    # last change in scan 10; limit 5 scans, 15 scans; rounding of 0.1 k may cost one
    assert plant.seen.index(doubtful) in (15, 16)
    assert plant.seen.index(lost) in (25, 26)
    assert shown == [1.0, 0.0, 0.0, 1.0]
    events = [line["event"] for line in log if "program" in line["event"]]
    assert events == ["program stopped: its heartbeat stands still", "program runs again"]


async def test_a_bad_sample_and_one_of_its_own_uncertain_status_keep_them_while_the_program_stands_still():
    rig = Rig(period=PERIOD, readings=3, life=Life(Heartbeat(0, timeout=0.5)))
    rig.device.statuses = [0, StatusCode.BAD_SENSOR_FAILURE, StatusCode.UNCERTAIN_SENSOR_NOT_ACCURATE]
    await rig.run(12)
    assert [rig.status(f"Echo.{n}") for n in range(3)] == [
        StatusCode.UNCERTAIN_LAST_USABLE_VALUE,
        StatusCode.BAD_SENSOR_FAILURE,
        StatusCode.UNCERTAIN_SENSOR_NOT_ACCURATE,
    ]
    assert rig.task.inputs.causes.tolist() == [Reason.PROGRAM_STOPPED, 0, Reason.PROGRAM_STOPPED]


async def test_a_stamp_that_stands_still_makes_its_tag_uncertain_then_bad_and_no_other():
    plant = Plant(Life(stamps=Stamps(2, {0: 0.5})))
    rig = plant.rig
    rig.device.stamps = [UTC, UTC]

    def stamp(number: int) -> None:
        assert rig.device.stamps is not None
        if not 10 <= number < 40:
            rig.device.stamps[0] = UTC + number * 1000

    await plant.run(50, stamp)

    doubtful, lost = (StatusCode.UNCERTAIN_LAST_USABLE_VALUE, 22), (StatusCode.BAD_OUT_OF_SERVICE, 22)
    assert plant.seen.index(doubtful) in (15, 16)
    assert plant.seen.index(lost) in (25, 26)
    assert plant.seen[-1] == (StatusCode.GOOD, 0)
    assert rig.status("Echo.1") == StatusCode.GOOD  # its stamp never moved, and nobody asked for that


async def test_an_outage_does_not_count_as_a_frozen_stamp_and_does_not_forget_one():
    rig = Rig(period=PERIOD, readings=1, life=Life(stamps=Stamps(1, {0: 1.0})))
    rig.device.stamps = [UTC]
    await rig.run(6)
    rig.device.reachable = False
    await rig.run(50)
    rig.device.reachable = True
    seen: list[int] = []
    await rig.run(40, lambda _: seen.append(rig.status("Echo.0")))
    order = [status for status, _ in itertools.groupby(seen) if status != StatusCode.BAD_NO_COMMUNICATION]
    assert order == [StatusCode.GOOD, StatusCode.UNCERTAIN_LAST_USABLE_VALUE, StatusCode.BAD_OUT_OF_SERVICE]
    assert seen.count(StatusCode.GOOD) < 8  # 0.6 s were on it before the outage


SKEWS = {"an hour ahead": HOUR, "an hour behind": -HOUR, "together": 0}


@pytest.mark.parametrize("skew", SKEWS)
async def test_skew_is_the_newest_stamp_that_moved_minus_our_time(skew: str):
    rig = Rig(period=PERIOD, readings=3, life=Life(stamps=Stamps(3, {})))
    held = UTC - 100 * HOUR

    def stamp(_: Scan | None) -> None:
        now = rig.clock.utc_ns() + round(PERIOD * 1e9) + SKEWS[skew]  # read in the next scan
        rig.device.stamps = [held, now - 5_000_000, now]

    stamp(None)
    with structlog.testing.capture_logs() as log:
        await rig.run(5, stamp)
    assert rig.value("Sources.plc.Skew") == pytest.approx(SKEWS[skew] / 1e9, abs=1e-6)
    ahead = [line for line in log if line["event"] == "source clock is ahead of ours"]
    assert len(ahead) == (SKEWS[skew] / 1e9 > AHEAD)


async def test_without_any_stamp_the_skew_waits():
    rig = Rig(life=Life(stamps=Stamps(1, {})))
    rig.device.reachable = False
    await rig.run(2)
    assert rig.status("Sources.plc.Skew") == StatusCode.BAD_WAITING_FOR_INITIAL_DATA
    assert math.isnan(rig.value("Sources.plc.Skew"))


async def test_a_stamp_that_goes_back_is_told_once_a_minute_with_its_tag():
    rig = Rig(period=PERIOD, readings=2, life=Life(stamps=Stamps(2, {})))

    def back(scan: Scan) -> None:
        rig.device.stamps = [UTC + scan.number, UTC - scan.number * 1_000_000_000]

    with structlog.testing.capture_logs() as log:
        await rig.run(50, back)
    (line,) = [line for line in log if line["event"] == "source timestamp went back"]
    assert (line["tag"], line["seconds"]) == ("r1", 1.0)


def _stamps(image: Image, values: Iterable[int]) -> Image:
    image.source_timestamps[:] = list(values)
    image.statuses[:] = 0
    image.arrivals[:] = 0.0
    return image


def test_a_bad_sample_moves_no_skew():
    stamps, image = Stamps(2, {}), Image(2)
    stamps.look(_stamps(image, [UTC, UTC]), 0.0, UTC)
    image.source_timestamps[1] = UTC + HOUR
    image.statuses[1] = StatusCode.BAD_SENSOR_FAILURE
    image.values[:] = [1.0, np.nan]
    stamps.look(image, 0.1, UTC)
    assert stamps.skew == 0.0
