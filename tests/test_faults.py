"""A defect in one part of the scan, of any part: the scan goes on, the part is told and shows it."""

import numpy as np
import pytest
import structlog

from softplc.clock import VirtualClock
from softplc.sample import StatusCode, WriteState
from softplc.writeback import WriteBack
from tests.support.tasks import Rig


class DefectError(Exception):
    """Something that nobody thought of."""


def breaking(thing, name, scans):
    """Let a method raise in these scans of the rig; all other calls go through."""
    sound = getattr(thing, name)
    state = {"number": -1}

    def broken(*arguments):
        if state["number"] in scans:
            raise DefectError(name)
        return sound(*arguments)

    setattr(thing, name, broken)
    return lambda scan: state.update(number=scan.number + 1)


def events(lines, event):
    return [line for line in lines if line["event"] == event]


async def test_a_latch_that_raises_makes_its_own_inputs_bad_and_works_again():
    rig = Rig()
    count = breaking(rig.link, "latch", {3, 4})
    seen = {}
    with structlog.testing.capture_logs() as lines:
        await rig.run(8, lambda scan: (count(scan), seen.update({scan.number: rig.status("Echo.0")})))
    assert [seen[number] for number in (2, 3, 4, 5)] == [0, *2 * [StatusCode.BAD_INTERNAL_ERROR], 0]
    assert len(events(lines, "part of the scan failed")) == 1
    assert len(events(lines, "part of the scan works again")) == 1


async def test_an_ask_or_a_flush_that_raises_ends_nothing():
    for name in ("ask", "flush"):
        rig = Rig()
        count = breaking(rig.link, name, {3})
        with structlog.testing.capture_logs() as lines:
            await rig.run(8, count)
        assert rig.status("Echo.0") == StatusCode.GOOD
        assert [line["part"] for line in events(lines, "part of the scan failed")] == [
            {"ask": "asking plc", "flush": "writing into plc"}[name]
        ]


async def test_dispatching_commands_that_raises_ends_nothing():
    rig = Rig()

    def dispatch():
        raise DefectError

    rig.task.dispatch_commands = dispatch
    with structlog.testing.capture_logs() as lines:
        await rig.run(20)
    assert rig.status("Echo.0") == StatusCode.GOOD
    assert len(events(lines, "part of the scan failed")) == 1


async def test_a_write_back_that_raises_is_parked_with_what_it_had_put_and_its_neighbour_goes_on():
    rig = Rig(readings=2, writings=("w", "v"))
    rig.device.values = [1.0, 0.0]
    bad = WriteBack(rig.echo.start, rig.link, 0, name="Echo.0", state=rig.echo.start + 1, every_scans=1)
    good = WriteBack(rig.echo.start, rig.link, 1, every_scans=1)
    rig.write_backs(bad, good)
    write_backs = rig.task.write_backs
    step = write_backs._step_rows

    def broken(rows, scan, inputs, outputs):
        step(rows, scan, inputs, outputs)
        if 0 in rows and scan.number >= 3:
            raise DefectError

    write_backs._step_rows = broken
    with structlog.testing.capture_logs() as lines:
        await rig.run(10)
    assert [line["write_back"] for line in events(lines, "write-back parked")] == ["Echo.0"]
    assert rig.value("Echo.1") == WriteState.PARKED
    assert sum(0 in written for written in rig.device.written) <= 3
    assert sum(1 in written for written in rig.device.written) >= 8


async def test_statistics_that_raise_make_their_own_tags_bad():
    rig = Rig()
    count = breaking(rig.task.statistics, "add", {3})
    seen = {}
    await rig.run(6, lambda scan: (count(scan), seen.update({scan.number: rig.status("Tasks.main.Heartbeat")})))
    assert [seen[number] for number in (2, 3, 4)] == [0, StatusCode.BAD_INTERNAL_ERROR, 0]
    assert rig.status("Echo.0") == StatusCode.GOOD


async def test_statistics_of_a_link_that_raise_make_their_own_tags_bad():
    rig = Rig()
    rig.link.statistics.reads = "a defect"
    rig.link._take = lambda driver, begun: None
    await rig.run(4)
    assert rig.status("Sources.plc.Connected") == StatusCode.BAD_INTERNAL_ERROR
    assert rig.status("Tasks.main.Heartbeat") == StatusCode.GOOD


async def test_a_scan_that_cannot_be_published_is_followed_by_one_that_can():
    rig = Rig()
    count = breaking(rig.task.writer, "publish", {3})
    await rig.run(6, count)
    assert rig.value("Tasks.main.ScanNumber") == 5


@pytest.mark.parametrize("name", ["problems", "remarks"])
async def test_a_driver_that_cannot_even_say_what_is_wrong_is_that_links_fault_alone(name):
    rig = Rig(period=0.1)
    make = rig.device.driver

    class Broken(type(make())):
        pass

    def raises(self):
        raise DefectError

    setattr(Broken, name, property(raises))
    rig.link._make_driver = lambda: Broken(rig.device)
    with structlog.testing.capture_logs() as lines:
        await rig.run(1200)  # two minutes of attempts
    assert rig.status("Echo.0") == StatusCode.BAD_NO_COMMUNICATION
    assert 1 <= len(events(lines, "driver failed to open")) <= 18


async def test_a_driver_that_raises_while_a_bad_tag_is_told_is_read_again():
    rig = Rig(period=0.1)
    make = rig.device.driver
    failing = [True]

    class Broken(type(make())):
        @property
        def problems(self):
            if failing[0] and rig.scans:
                raise DefectError
            return ()

    rig.link._make_driver = lambda: Broken(rig.device)

    def spoil(scan):
        rig.device.statuses = [StatusCode.BAD_SENSOR_FAILURE if scan.number % 2 else 0]
        rig.device.values = [np.nan if scan.number % 2 else 1.0]
        failing[0] = scan.number < 20

    await rig.run(60, spoil)
    assert rig.value("Sources.plc.Connected") == 1
    assert rig.value("Sources.plc.ReadErrors") >= 1


async def test_the_machine_that_slept_shows_in_dt_and_in_a_tag_and_misses_no_slot():
    clock = VirtualClock()
    rig = Rig(clock, period=0.1)
    with structlog.testing.capture_logs() as lines:
        scans = await rig.run(30, lambda scan: clock.suspend(3600.0) if scan.number == 9 else None)
    assert scans[10].dt == pytest.approx(3600.1, abs=0.1)  # within the period in which it fell asleep
    assert scans[11].dt == pytest.approx(0.1)
    assert scans[-1].overruns == 0
    assert rig.value("Tasks.main.Suspended") == 3600.0
    assert rig.value("Tasks.main.Overloaded") == 0
    told = events(lines, "the machine was suspended")
    assert [line["seconds"] for line in told] == [3600.0]


async def test_five_of_a_hundred_slots_missed_are_an_alarm_until_one_is_left():
    rig = Rig(period=0.1)
    shown = []

    def work():
        late = 0 <= len(rig.scans) - 20 < 5
        rig.clock.advance(0.15 if late else 0.0)

    rig.echo.work = work
    await rig.run(200, lambda scan: shown.append(rig.value("Tasks.main.Overloaded")))
    assert shown[23] == 0.0
    assert shown[26] == 1.0
    assert shown[-1] == 0.0
    assert 80 < sum(shown) < 100
