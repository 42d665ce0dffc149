"""Write-backs: the newest Good value or none, read back where asked, and what the axis shows of it."""

import asyncio
import sys

import numpy as np
import structlog

from softplc.clock import SystemClock, VirtualClock
from softplc.link import Link
from softplc.read_back import ReadBack
from softplc.sample import StatusCode, WriteState
from softplc.writeback import WriteBack
from tests.support.drivers import Device
from tests.support.network import eventually
from tests.support.tasks import Rig

PERIOD = 0.1


def rig_with(clock=None, **settings) -> Rig:
    """Reading 0 is the input, which the observer echoes; reading 1 the tag that it is written to, shown as state."""
    rig = Rig(clock, period=PERIOD, readings=2, timeout=settings.pop("timeout", 0.2))
    read_back = ReadBack(1, tolerance=0.01, within=0.5) if settings.pop("verify", False) else None
    rig.write_backs(
        WriteBack(
            rig.echo.start, rig.link, 0, read_back=read_back, name="Echo.0", state=rig.echo.start + 1, **settings
        )
    )
    return rig


def obey(rig, clamp=float("inf")):
    """The device holds what was written, or as much of it as it takes."""
    if rig.device.written:
        rig.device.values[1] = min(rig.device.written[-1][0], clamp)


async def test_a_slow_writer_gets_the_newest_value_each_time_and_publishing_goes_on():
    rig = rig_with(SystemClock(), timeout=30.0)
    newest, stamps, states, released = [], [], set(), asyncio.Event()

    async def slow(positions, values):
        newest.append((float(values[0]), rig.device.values[0]))
        await released.wait()
        return np.zeros(len(positions), np.uint32)

    driver = rig.device.driver

    def slow_driver():
        made = driver()
        made.write = slow
        return made

    rig.link._make_driver = slow_driver

    def scan(scan):
        rig.device.values[0] = float(scan.number)
        stamps.append(rig.value("Tasks.main.ScanNumber"))
        states.add(int(rig.value("Echo.1")))
        if scan.number % 7 == 6:  # each write takes seven scans
            released.set()
            released.clear()

    await rig.run(40, scan)

    assert stamps == [float(number) for number in range(40)]
    assert 3 <= len(newest) <= 8
    # what is written is of the newest scan, which read what the device had then; the next one changes it at once
    assert all(held - written <= 1.0 for written, held in newest)
    # one request at a time: while the device takes its time to write, it is not read, and nothing is Good
    assert {WriteState.WRITTEN, WriteState.WITHHELD} <= states


async def test_a_value_that_a_stopped_process_held_is_not_written_when_it_goes_on():
    rig = rig_with()

    def stop_between_the_scan_and_its_write(scan):
        rig.device.values[0] = float(scan.number)  # which the next scan reads, and writes
        if scan.number == 5:
            rig.clock.advance(10.0)

    scans = await rig.run(10, stop_between_the_scan_and_its_write)

    assert scans[6].dt > 10.0
    written = [write[0] for write in rig.device.written]
    assert 4.0 not in written  # what scan 5 had read ten seconds ago
    assert {3.0, 5.0} <= set(written)


async def test_a_value_that_waited_for_its_turn_while_the_machine_slept_is_not_written():
    clock = VirtualClock()
    rig = rig_with(clock)
    async with asyncio.TaskGroup() as group:
        running = group.create_task(rig.link.run())
        await eventually(lambda: rig.link.statistics.connected)
        rig.link.put(0, 1.0, until=clock.monotonic() + 0.3)
        async with rig.link._turn:  # a read is under way
            rig.link.flush()
            await asyncio.sleep(0)
            clock.suspend(3600.0)
        for _ in range(10):
            await asyncio.sleep(0)
        assert rig.device.written == []
        assert rig.link.writing.slots.pending[0]  # until a newer one comes, or it is withdrawn
        rig.link.put(0, 2.0, until=clock.monotonic() + 0.3)
        rig.link.flush()
        await eventually(lambda: rig.device.written == [{0: 2.0}])
        running.cancel()


async def test_a_device_that_takes_one_value_at_a_time_is_read_between_two_of_them():
    rig = Rig(SystemClock(), period=PERIOD, writings="abcdef")
    order = []
    driver = rig.device.driver

    def make():
        made = driver()
        made.writes_at_once = 1
        read, write = made.read, made.write

        async def noted_read(into):
            order.append("read")
            await read(into)

        async def noted_write(positions, values):
            order.append("write")
            assert len(positions) == 1
            await asyncio.sleep(0.03)
            return await write(positions, values)

        made.read, made.write = noted_read, noted_write
        return made

    rig.link._make_driver = make

    def put(scan):
        if scan.number == 1:
            for position in range(6):
                rig.link.put(position, float(position))

    await rig.run(8, put)
    first, last = order.index("write"), len(order) - 1 - order[::-1].index("write")
    assert order.count("write") == 6
    assert "read" in order[first:last]


async def test_what_is_read_back_as_written_is_written():
    rig = rig_with(verify=True)
    states = []

    def scan(scan):
        rig.device.values[0] = 0.5 * scan.number
        obey(rig)
        states.append(int(rig.value("Echo.1")))

    await rig.run(40, scan)
    assert set(states[10:]) == {WriteState.WRITTEN}
    assert rig.value("Sources.plc.WriteMismatches") == 0


async def test_a_plc_that_clamps_is_a_mismatch_told_once_and_counted_until_it_takes_the_value_again():
    rig = rig_with(verify=True)
    states = []

    def scan(scan):
        rig.device.values[0] = 5.0 if scan.number < 20 or scan.number >= 60 else 50.0
        obey(rig, clamp=10.0)
        states.append(int(rig.value("Echo.1")))

    with structlog.testing.capture_logs() as lines:
        await rig.run(90, scan)

    assert states[19] == WriteState.WRITTEN
    assert set(states[30:60]) == {WriteState.MISMATCH}
    assert states[-1] == WriteState.WRITTEN
    assert rig.value("Sources.plc.WriteMismatches") == 1
    told = [line for line in lines if line["event"].startswith("written value")]
    assert [line["event"] for line in told] == [
        "written value reads back different",
        "written value reads back as written again",
    ]
    assert (told[0]["wrote"], told[0]["found"], told[0]["tag"]) == (50.0, 10.0, "w")


async def test_a_tag_that_lags_by_less_than_the_limit_is_no_mismatch():
    rig = rig_with(verify=True)
    states = []

    def scan(scan):
        rig.device.values[0] = float(scan.number)
        if len(rig.device.written) > 3:
            rig.device.values[1] = rig.device.written[-4][0]  # a slow cycle of the PLC; the limit is five periods
        states.append(int(rig.value("Echo.1")))

    await rig.run(40, scan)
    assert WriteState.MISMATCH not in states
    assert states[-1] == WriteState.WRITTEN


async def test_a_written_tag_that_cannot_be_read_is_unverified():
    rig = rig_with(verify=True)
    rig.device.statuses[1] = StatusCode.BAD_NOT_READABLE
    await rig.run(10)
    assert rig.value("Echo.1") == WriteState.UNVERIFIED


async def test_an_output_that_is_not_good_is_withheld_and_what_a_source_refuses_is_refused():
    rig = rig_with(every_scans=1)
    rig.device.write_status = StatusCode.BAD_NOT_WRITABLE
    await rig.run(5)
    assert rig.value("Echo.1") == WriteState.REFUSED
    rig.device.statuses[0] = StatusCode.UNCERTAIN_LAST_USABLE_VALUE
    await rig.run(3)
    assert rig.value("Echo.1") == WriteState.WITHHELD


async def test_a_device_that_refuses_every_other_write_fills_no_log():
    rig = rig_with(every_scans=1)

    def flicker(scan):
        rig.device.write_status = StatusCode.BAD_NOT_WRITABLE if scan.number % 2 else 0

    with structlog.testing.capture_logs() as lines:
        await rig.run(900, flicker)  # 90 s
    told = [line for line in lines if line["event"].startswith("write ")]
    assert 6 <= len(told) <= 12
    assert sum(line.get("suppressed", 0) for line in told) > 300


async def test_a_tag_that_is_good_in_every_state_is_written_only_while_the_position_is():
    rig = rig_with()
    rig.write_backs(WriteBack(rig.echo.start, rig.link, 0, name="Echo.0", judge=rig.echo.start + 1))

    def scan(scan):
        rig.device.values[0] = float(scan.number)
        rig.device.statuses[1] = StatusCode.BAD_SENSOR_FAILURE if 5 <= scan.number < 10 else StatusCode.GOOD

    await rig.run(15, scan)
    written = {values[0] for values in rig.device.written}
    assert {2.0, 12.0} <= written
    assert not written & {6.0, 7.0, 8.0}


async def test_after_a_spell_that_was_not_good_the_value_is_written_though_it_did_not_move():
    rig = rig_with()
    rig.device.values[0] = 5.0

    def scan(scan):
        bad = 10 <= scan.number < 20
        rig.device.statuses[0] = StatusCode.UNCERTAIN_LAST_USABLE_VALUE if bad else StatusCode.GOOD

    await rig.run(40, scan)
    assert [values[0] for values in rig.device.written] == [5.0, 5.0]


async def test_what_a_busy_device_refused_is_written_once_it_takes_it_though_it_did_not_move():
    rig = rig_with()
    rig.device.values[0] = 5.0

    def scan(scan):
        rig.device.write_status = StatusCode.BAD_RESOURCE_UNAVAILABLE if scan.number < 25 else 0

    await rig.run(60, scan)  # 6 s
    assert rig.value("Echo.1") == WriteState.WRITTEN
    assert rig.value("Sources.plc.Writes") == 1
    assert 2 <= rig.value("Sources.plc.WriteErrors") <= 4  # at first, and once a second for 2.5 s


SETTINGS = (
    {},
    {"deadband": 2.5},
    {"every_scans": 3},
    {"every_scans": 2, "min_interval": 0.35},
    {"verify": True},
    {"verify": True, "deadband": 4.0},
)


async def states_and_writes(settings) -> tuple[list[list[float]], list[dict[int, float]]]:
    """What 60 scans show and write, with spells that are not Good, refused or clamped."""
    n = len(settings)
    rig = Rig(period=PERIOD, readings=3 * n, writings=[f"w{k}" for k in range(n)])
    write_backs = []
    for k, each in enumerate(settings):
        options = {name: value for name, value in each.items() if name != "verify"}
        read_back = ReadBack(n + k, tolerance=0.01, within=0.3) if "verify" in each else None
        state = rig.echo.start + 2 * n + k
        write_backs.append(WriteBack(rig.echo.start + k, rig.link, k, read_back=read_back, state=state, **options))
    rig.write_backs(*write_backs)
    states = []

    def scan(scan):
        device = rig.device
        device.values[:n] = [0.5 * scan.number] * n
        device.statuses[:n] = [StatusCode.UNCERTAIN if scan.number % 17 in (3, 4) else 0] * n
        device.write_status = StatusCode.BAD_NOT_WRITABLE if scan.number % 23 in (7, 8, 9) else 0
        for values in device.written[-1:]:
            for position, value in values.items():
                device.values[n + position] = min(value, 20.0)
        states.append([rig.value(f"Echo.{2 * n + k}") for k in range(n)])

    await rig.run(60, scan)
    return states, rig.device.written


async def test_every_write_back_of_many_does_what_it_does_alone():
    together, written = await states_and_writes(SETTINGS)
    assert len({state for states in together for state in states}) >= 5
    for k, each in enumerate(SETTINGS):
        alone, written_alone = await states_and_writes([each])
        assert [states[k] for states in together] == [states[0] for states in alone]
        assert [values[k] for values in written if k in values] == [values[0] for values in written_alone]


async def test_a_lost_link_withholds_what_goes_into_it_and_no_more():
    rig = Rig(period=PERIOD, readings=3, writings="ab")
    device = Device(rig.clock)
    other = Link("other", device.driver, [], ["c", "d"], rig.clock, 0.2, 1.0)
    start, states = rig.echo.start, []
    rig.write_backs(
        WriteBack(start, rig.link, 1, state=start + 1),
        WriteBack(start, other, 1, state=start + 2),
    )

    def scan(scan):
        rig.device.values = [float(scan.number), 0.0, 0.0]
        device.reachable = scan.number >= 20
        other.flush()
        states.append((rig.value("Echo.1"), rig.value("Echo.2")))

    async with asyncio.TaskGroup() as group:
        running = group.create_task(other.run())
        await rig.run(50, scan)
        running.cancel()
    assert set(states[5:20]) == {(WriteState.WRITTEN, WriteState.WITHHELD)}
    assert states[-1] == (WriteState.WRITTEN, WriteState.WRITTEN)
    assert {1} == {position for values in rig.device.written + device.written for position in values}
    assert device.written[-1][1] == 48.0  # of the newest scan


async def test_where_a_device_takes_few_values_at_a_time_each_gets_its_turn():
    rig = Rig(period=PERIOD, readings=7, writings="abcdefg")
    rig.write_backs(*(WriteBack(rig.echo.start + k, rig.link, k) for k in range(7)))
    driver = rig.device.driver

    def make():
        made = driver()
        made.writes_at_once = 3
        write = made.write

        async def rare(positions, values):
            answers = await write(positions, values)
            while len(rig.device.written) > len(rig.scans) // 2:  # one request in two scans
                await asyncio.sleep(0)
            return answers

        made.write = rare
        return made

    rig.link._make_driver = make

    def move(scan):
        rig.device.values = [scan.number + 0.1 * k for k in range(7)]

    await rig.run(60, move)
    counts = [sum(k in values for values in rig.device.written) for k in range(7)]
    assert min(counts) >= 5
    assert max(counts) - min(counts) <= 1


async def test_a_scan_runs_no_python_for_each_write_back():
    async def calls(n: int) -> int:
        rig = Rig(period=PERIOD, readings=n, writings=[f"w{k}" for k in range(n)])
        rig.write_backs(*(WriteBack(rig.echo.start + k, rig.link, k) for k in range(n)))
        count = 0

        def called(frame, event, argument):
            nonlocal count
            count += event in ("call", "c_call")

        def move(scan):
            sys.setprofile(None)
            rig.device.values = [scan.number + 0.1 * k for k in range(n)]  # each is due in every scan
            if scan.number > 5:
                sys.setprofile(called)

        try:
            await rig.run(20, move)
        finally:
            sys.setprofile(None)
        assert len(rig.device.written) > 15
        assert all(len(values) == n for values in rig.device.written[5:])
        return count

    few, many = await calls(5), await calls(100)
    assert many < few + 14 * 10  # in 14 scans; ninety-five more of them are not even ten calls each
