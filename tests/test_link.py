import asyncio

import numpy as np
import structlog

from softplc.clock import SystemClock
from softplc.sample import StatusCode
from tests.support.network import eventually
from tests.support.tasks import Rig


async def test_a_source_that_refuses_is_bad_no_communication_and_nothing_raises():
    rig = Rig()
    rig.device.reachable = False
    await rig.run(5)
    assert rig.status("Echo.0") == StatusCode.BAD_NO_COMMUNICATION
    assert np.isnan(rig.value("Echo.0"))
    assert rig.value("Sources.plc.Connected") == 0


async def test_a_source_that_comes_back_is_read_again_with_a_new_driver():
    rig = Rig(period=0.1)
    rig.device.values = [7.0]

    def outage(scan):
        rig.device.reachable = not 10 <= scan.number < 40

    seen = {}
    await rig.run(80, lambda scan: (outage(scan), seen.update({scan.number: rig.status("Echo.0")})))

    assert seen[9] == StatusCode.GOOD
    assert seen[12] == StatusCode.BAD_NO_COMMUNICATION
    assert seen[39] == StatusCode.BAD_NO_COMMUNICATION
    # back at scan 40; the back-off is 1 s at the most, which is 10 scans, and one scan reads
    assert seen[52] == StatusCode.GOOD
    assert rig.device.opened == 2
    assert rig.device.closed >= 1
    assert rig.value("Sources.plc.Reconnects") == 1


async def test_a_silent_source_has_one_request_outstanding_and_old_values_are_never_good():
    rig = Rig(SystemClock(), period=0.02, timeout=30.0)
    rig.device.values = [3.0]
    await rig.run(3)
    rig.device.silent = True
    await rig.run(10)
    assert rig.device.most_outstanding == 1
    assert rig.status("Echo.0") != StatusCode.GOOD


async def test_a_late_reply_leaves_the_earlier_sample_as_last_usable_value():
    rig = Rig(SystemClock(), period=0.05, timeout=30.0)
    rig.device.values = [3.0]
    statuses = []

    def silence_after_three(scan):
        rig.device.silent = scan.number >= 3
        statuses.append((rig.status("Echo.0"), rig.value("Echo.0")))

    await rig.run(8, silence_after_three)

    assert statuses[-1] == (StatusCode.UNCERTAIN_LAST_USABLE_VALUE, 3.0)


async def test_what_a_late_reply_brings_is_never_good():
    rig = Rig(SystemClock(), period=0.02, timeout=30.0)
    rig.device.old_replies = True
    shown = []

    def count_and_fall_silent(scan):
        if rig.status("Echo.0") == StatusCode.GOOD:
            shown.append((scan.number, rig.value("Echo.0")))
        rig.device.values = [scan.number + 1.0]  # what the next scan may show
        if scan.number % 5 == 0:
            rig.device.silent = True
            # some replies come between two scans, some while a scan waits
            pause = 0.02 * (1.0 + scan.number / 100)
            asyncio.get_running_loop().call_later(pause, setattr, rig.device, "silent", False)

    await rig.run(100, count_and_fall_silent)

    assert len(shown) > 20
    assert [number for number, value in shown if value != number] == []


async def test_a_device_that_is_late_every_time_is_read_all_the_same_and_never_good():
    rig = Rig(SystemClock(), period=0.02, timeout=30.0)
    statuses, values = [], set()

    def look(scan):
        statuses.append(rig.status("Echo.0"))
        values.add(rig.value("Echo.0"))
        rig.device.values = [float(scan.number)]

    rig.device.delay = 0.05
    await rig.run(60, look)

    assert len(values) > 5
    assert StatusCode.GOOD not in statuses
    assert rig.device.most_outstanding == 1


async def test_no_scan_waits_for_a_device_that_was_silent_twice_until_it_answers_again():
    rig = Rig(SystemClock(), period=0.1, timeout=30.0)
    rig.device.values = [3.0]
    seen = []

    def look(scan):
        rig.device.silent = 3 <= scan.number < 13
        seen.append((rig.value("Sources.plc.OffScan"), rig.value("Tasks.main.ExecutionTime"), rig.status("Echo.0")))

    await rig.run(20, look)

    silent = seen[4:14]
    assert [off for off, _, _ in silent[2:]] == 8 * [1.0]
    assert all(status == StatusCode.UNCERTAIN_LAST_USABLE_VALUE for _, _, status in silent)
    assert silent[0][1] >= 0.055  # it waited for its budget, 0.6 of the period
    assert min(seconds for _, seconds, _ in silent[2:]) < 0.055
    assert seen[-1][0] == 0.0
    assert seen[-1][2] == StatusCode.GOOD


async def test_a_device_that_accepts_connections_and_serves_none_is_tried_ever_more_rarely():
    rig = Rig(period=0.1)
    rig.device.broken = True
    await rig.run(100)
    # 10 s: pauses of 50, 100, 200, 400 and then 800 ms, each shortened by up to a half
    assert 12 < rig.device.opened < 35


async def test_a_read_beyond_the_timeout_means_that_the_link_is_lost():
    rig = Rig(SystemClock(), period=0.02, timeout=0.05)
    rig.device.silent = True
    statuses = []
    await rig.run(40, lambda _: statuses.append(rig.status("Echo.0")))
    assert StatusCode.BAD_NO_COMMUNICATION in statuses
    assert rig.value("Sources.plc.ReadErrors") >= 1


async def test_a_defect_of_the_driver_is_that_links_fault_alone():
    rig = Rig()
    rig.device.broken = True
    await rig.run(5)
    assert rig.status("Echo.0") == StatusCode.BAD_NO_COMMUNICATION
    assert len(rig.scans) == 5


async def test_a_thousand_losses_leave_no_tasks_behind():
    rig = Rig(period=0.01)
    before = len(asyncio.all_tasks())

    def flap(scan):
        rig.device.reachable = scan.number % 2 == 0

    await rig.run(3000, flap)
    await eventually(lambda: len(asyncio.all_tasks()) <= before)
    assert rig.device.opened > 50
    assert rig.device.closed == rig.device.attempts


async def test_of_values_put_while_a_write_is_under_way_only_the_newest_is_written():
    rig = Rig()
    await rig.run(1)

    async def session():
        rig.device.silent = True
        running = asyncio.create_task(rig.link.run())
        await eventually(lambda: rig.link.statistics.connected)
        for value in (1.0, 2.0, 3.0):
            rig.link.put(0, value)
            rig.link.flush()
            await asyncio.sleep(0)
        for value in (4.0, 5.0):
            rig.link.put(0, value)
            rig.link.flush()
        rig.device.silent = False
        await eventually(lambda: bool(rig.device.written))
        rig.link.flush()
        await eventually(lambda: rig.device.written[-1] == {0: 5.0})
        running.cancel()

    await session()
    assert len(rig.device.written) <= 2


async def test_a_device_that_answers_no_writes_is_written_to_ever_more_rarely_so_that_reading_goes_on():
    rig = Rig(period=0.1)
    rig.device.values, rig.device.deaf_to_writes = [7.0], True
    statuses = []

    def write_in_every_scan(scan):
        rig.link.put(0, float(scan.number))
        statuses.append(rig.status("Echo.0"))

    await rig.run(1200, write_in_every_scan)
    # 120 s: pauses of 1, 2, 4, … 60 s, each after one lost connection, which is back within a second
    assert 5 <= rig.value("Sources.plc.Reconnects") <= 8
    assert statuses.count(StatusCode.GOOD) > 0.9 * len(statuses)

    rig.device.deaf_to_writes = False
    await rig.run(700, lambda scan: rig.link.put(0, 1000.0 + scan.number))
    assert len(rig.device.written) > 50


async def test_a_flapping_link_is_logged_a_few_times_a_minute_with_a_count_of_the_rest():
    rig = Rig(period=0.1)
    with structlog.testing.capture_logs() as lines:
        await rig.run(1300, lambda scan: setattr(rig.device, "reachable", scan.number % 2 == 0))
    assert 6 < len(lines) <= 18  # 130 s: three minutes have begun
    assert sum(line.get("suppressed", 0) for line in lines) > 10


async def test_a_tag_that_is_bad_from_the_start_is_told_with_its_status():
    rig = Rig()
    rig.device.values, rig.device.statuses = [float("nan")], [StatusCode.BAD_CONFIGURATION_ERROR]
    with structlog.testing.capture_logs() as lines:
        await rig.run(5)
    told = [line for line in lines if line["event"] == "tag bad"]
    assert [(line["tag"], line["status"]) for line in told] == [("r0", "BadConfigurationError")]


async def test_a_loss_is_one_line_and_the_return_says_how_long_it_was():
    rig = Rig(period=0.1)
    with structlog.testing.capture_logs() as lines:
        await rig.run(80, lambda scan: setattr(rig.device, "reachable", not 10 <= scan.number < 40))
    told = [line["event"] for line in lines if line["event"] != "link still down"]
    assert told == ["link up", "link down", "link up"]
    assert 2.5 <= lines[-1]["down_seconds"] <= 4.5  # down for 3 s, found within the back-off of 1 s


async def test_after_a_flapping_link_settles_the_log_tells_the_state_that_it_reached():
    rig = Rig(period=0.1)

    def flap_then_stay(scan):
        rig.device.reachable = scan.number > 100 or scan.number % 2 == 0

    with structlog.testing.capture_logs() as lines:
        await rig.run(900, flap_then_stay)
    assert rig.value("Sources.plc.Connected") == 1
    assert lines[-1]["event"] == "link up"
    assert lines[-1]["suppressed"] > 0
