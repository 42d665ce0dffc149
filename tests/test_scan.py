import asyncio
import itertools

import pytest
import structlog

from softplc.clock import VirtualClock
from softplc.sample import StatusCode
from softplc.writeback import WriteBack
from tests.support.tasks import Echo, Rig


async def test_late_scan_stays_on_the_grid_and_counts_overruns():
    rig = Rig(period=0.1)
    work = iter([0.03, 0.25, 0.03, 0.0])
    rig.echo.work = lambda: rig.clock.advance(next(work))

    scans = await rig.run(3)

    assert [scan.start for scan in scans] == pytest.approx([0.0, 0.1, 0.4])
    assert [scan.overruns for scan in scans] == [0, 0, 2]


async def test_overrun_slots_are_skipped_never_fired_back_to_back():
    rig = Rig(period=0.01)
    rig.echo.work = lambda: rig.clock.advance(0.1 if len(rig.scans) == 5 else 0.0)

    scans = await rig.run(20)

    gaps = [b.start - a.start for a, b in itertools.pairwise(scans)]
    assert min(gaps) >= 0.01 - 1e-9
    assert scans[-1].overruns == 10


async def test_dt_is_measured_start_to_start_and_the_period_in_the_first_scan():
    rig = Rig(period=0.1)
    rig.echo.work = lambda: rig.clock.advance(0.15)

    scans = await rig.run(3)

    assert [scan.dt for scan in scans] == pytest.approx([0.1, 0.2, 0.2])


async def test_a_thousand_scans_do_not_drift_from_the_grid():
    rig = Rig(period=0.01)
    rig.echo.work = lambda: rig.clock.advance(0.004)

    scans = await rig.run(1000)

    assert scans[-1].start == pytest.approx(9.99, abs=1e-9)
    assert scans[-1].overruns == 0


async def test_a_step_of_the_wall_clock_leaves_dt_alone():
    rig = Rig(period=0.1)
    scans = await rig.run(4, lambda scan: rig.clock.step_utc(3600 if scan.number == 1 else 0))
    assert [scan.dt for scan in scans] == pytest.approx([0.1] * 4)
    assert scans[2].timestamp - scans[1].timestamp == pytest.approx(3600.1e9, abs=1e3)


async def test_samples_reach_the_published_image_with_status_and_timestamp():
    rig = Rig(readings=2)
    rig.device.values, rig.device.statuses = [1.5, 2.5], [0, StatusCode.UNCERTAIN_SENSOR_NOT_ACCURATE]

    await rig.run(2)

    assert (rig.value("Echo.0"), rig.status("Echo.0")) == (1.5, StatusCode.GOOD)
    assert (rig.value("Echo.1"), rig.status("Echo.1")) == (2.5, StatusCode.UNCERTAIN_SENSOR_NOT_ACCURATE)


async def test_statistics_are_tags():
    rig = Rig(period=0.1)
    rig.echo.work = lambda: rig.clock.advance(0.25 if len(rig.scans) == 1 else 0.03)

    await rig.run(30)

    assert rig.value("Tasks.main.Heartbeat") == 29
    assert rig.value("Tasks.main.ScanNumber") == 29
    assert rig.value("Tasks.main.Period") == 0.1
    assert rig.value("Tasks.main.Overruns") == 2
    assert rig.value("Tasks.main.Dt") == pytest.approx(0.1)
    assert rig.value("Tasks.main.ExecutionTime") == pytest.approx(0.03)
    assert rig.value("Tasks.main.DtP50") == pytest.approx(0.1)
    assert rig.value("Tasks.main.DtMax") == pytest.approx(0.3)
    assert rig.value("Tasks.main.JitterMax") == pytest.approx(0.2)
    assert rig.value("Tasks.main.ExecutionMax") == pytest.approx(0.25)
    assert rig.value("Sources.plc.Connected") == 1
    assert rig.value("Sources.plc.Reads") == 30


async def test_an_observer_that_raises_is_parked_and_the_others_run_on():
    rig = Rig()

    def fail():
        raise ZeroDivisionError

    broken = Echo(rig.echo.start, fail)
    calls = []
    rig.observers(broken, Echo(rig.table.index("Sources.plc.Age"), lambda: calls.append(1)))

    await rig.run(5)

    assert rig.status("Echo.0") == StatusCode.BAD_INTERNAL_ERROR
    assert len(calls) == 5


async def test_of_two_tasks_due_together_the_higher_priority_scans_first():
    clock = VirtualClock()
    order = []
    low, high = Rig(clock, period=0.1), Rig(clock, period=0.1)
    low.task.priority, high.task.priority = 20, 1
    low.task.on_scan = lambda _: order.append("low")
    high.task.on_scan = lambda _: order.append("high")
    running = [asyncio.create_task(rig.task.run()) for rig in (low, high)]
    while len(order) < 8:
        await asyncio.sleep(0)
    for task in running:
        task.cancel()
    assert order[:8] == ["high", "low"] * 4


async def test_a_slow_task_does_not_slow_a_fast_one():
    clock = VirtualClock()
    fast, slow = Rig(clock, period=0.01), Rig(clock, period=0.5)
    running = [asyncio.create_task(rig.task.run()) for rig in (fast, slow)]
    while len(slow.scans) < 3:
        await asyncio.sleep(0)
    for task in running:
        task.cancel()
    assert len(fast.scans) >= 100
    assert fast.scans[-1].overruns == 0


async def test_write_back_on_change_writes_changes_beyond_the_deadband_only():
    rig = Rig()
    rig.write_backs(WriteBack(rig.echo.start, rig.link, 0, deadband=0.5))
    values = iter([1.0, 1.2, 1.6, 1.7, 2.2, 2.2])
    rig.device.values = [next(values)]

    def advance(_):
        rig.device.values = [next(values, 2.2)]

    await rig.run(8, advance)

    assert [write[0] for write in rig.device.written] == [1.0, 1.6, 2.2]


async def test_write_back_every_n_scans_and_not_more_often_than_the_minimum_interval():
    rig = Rig(period=0.1)
    rig.write_backs(WriteBack(rig.echo.start, rig.link, 0, every_scans=2, min_interval=0.35))
    await rig.run(20)
    # due in scans 0, 2, 4, …; after a write the next due scan at least 0.35 s later is 4 scans on
    assert len(rig.device.written) == 5


async def test_only_good_values_are_written_back():
    rig = Rig()
    rig.device.statuses = [StatusCode.UNCERTAIN_LAST_USABLE_VALUE]
    rig.write_backs(WriteBack(rig.echo.start, rig.link, 0, every_scans=1))
    await rig.run(5)
    assert rig.device.written == []


async def test_a_value_that_waits_to_be_written_is_withdrawn_when_its_output_is_not_good_any_more():
    rig = Rig(period=0.1)
    rig.device.values = [1.0]
    rig.write_backs(WriteBack(rig.echo.start, rig.link, 0))

    def write_fails_then_the_value_changes_then_turns_bad(scan):
        rig.device.deaf_to_writes = scan.number < 3  # costs the connection; writing pauses for a second
        good = scan.number < 8 or scan.number >= 40
        rig.device.statuses = [StatusCode.GOOD if good else StatusCode.BAD_SENSOR_FAILURE]
        rig.device.values = [float(scan.number)] if good else [float("nan")]

    await rig.run(39, write_fails_then_the_value_changes_then_turns_bad)
    assert rig.value("Sources.plc.Connected") == 1
    assert rig.device.written == []  # what was Good three seconds ago is not written now

    await rig.run(5, lambda scan: (setattr(rig.device, "statuses", [0]), setattr(rig.device, "values", [77.0])))
    assert [write[0] for write in rig.device.written] == [77.0]


async def test_refused_writes_are_counted_and_visible():
    rig = Rig()
    rig.device.write_status = StatusCode.BAD_NOT_WRITABLE
    rig.write_backs(WriteBack(rig.echo.start, rig.link, 0, every_scans=1))
    await rig.run(6)
    assert rig.value("Sources.plc.WriteErrors") >= 4
    assert rig.value("Sources.plc.Writes") == 0


async def test_commands_reach_the_observer_before_it_steps():
    rig = Rig()
    rig.task.dispatch_commands = lambda: [rig.echo.command(*command) for command in rig.task.writer.commands()]
    rig.reader.command(rig.echo.start, 42.0)
    await rig.run(1)
    assert rig.echo.commands == [(rig.echo.start, 42.0)]


async def test_overruns_are_logged_once_a_minute_with_their_number():
    rig = Rig(period=0.1)
    rig.echo.work = lambda: rig.clock.advance(0.15)
    with structlog.testing.capture_logs() as lines:
        await rig.run(700)  # 140 s, every other slot missed
    told = [line["missed"] for line in lines if line["event"] == "scans overran"]
    assert told == [1, 300, 300]
