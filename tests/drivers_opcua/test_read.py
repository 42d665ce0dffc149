"""What a scan gets to see of a server's variables, polled and subscribed, from two independent servers."""

import math
import time
from collections.abc import Callable
from functools import partial

import pytest

from softplc.clock import monotonic
from softplc.sample import StatusCode
from softplc.tags import Image
from tests.drivers_opcua.opened import opened, read, read_until
from tests.drivers_opcua.servers import NUMBERS, STAMP_NS, AsyncuaPlc, NodePlc

HOUR_NS = 3_600_000_000_000
AXIS = "ns=2;s=PLC.Axis"
both_modes = pytest.mark.parametrize("mode", ["poll", "subscribe"])


@both_modes
async def test_every_number_type_arrives_with_status_timestamp_and_arrival(plc: NodePlc, mode: str):
    before = monotonic()
    async with opened(plc.url, [f"{AXIS}.{name}" for name in NUMBERS], mode=mode) as driver:
        image = await read(driver, len(NUMBERS))

    assert dict(zip(NUMBERS, image.values.tolist(), strict=True)) == NUMBERS
    assert set(image.statuses.tolist()) == {StatusCode.GOOD}
    assert set(image.source_timestamps.tolist()) == {STAMP_NS}
    assert all(before < arrival < monotonic() for arrival in image.arrivals)


@both_modes
async def test_status_of_the_server_decides_what_a_value_is_worth(plc: NodePlc, mode: str):
    async with opened(
        plc.url, [f"{AXIS}.Bad", f"{AXIS}.Uncertain", f"{AXIS}.NaN", f"{AXIS}.Inf"], mode=mode
    ) as driver:
        image = await read(driver, 4)

    assert math.isnan(image.values[0])
    assert image.statuses[0] == StatusCode.BAD_SENSOR_FAILURE
    assert (image.values[1], image.statuses[1]) == (14.0, StatusCode.UNCERTAIN_SENSOR_NOT_ACCURATE)
    assert image.source_timestamps[1] == STAMP_NS
    assert math.isnan(image.values[2])
    assert math.isinf(image.values[3])
    assert image.statuses[2:].tolist() == [StatusCode.GOOD] * 2  # passed on as it is; the observer rejects it


@both_modes
async def test_array_elements_are_read_by_index(plc: NodePlc, mode: str):
    tags = [(f"{AXIS}.Doubles", 0), (f"{AXIS}.Doubles", 2), (f"{AXIS}.Words", 1), (f"{AXIS}.Matrix", 4)]
    async with opened(plc.url, [*tags, (f"{AXIS}.Words", 3)], mode=mode) as driver:
        image = await read(driver, 5)

        assert image.values[:4].tolist() == [10.5, 12.5, 8.0, 5.0]
        assert image.statuses.tolist() == [0, 0, 0, 0, StatusCode.BAD_OUT_OF_RANGE]
        assert math.isnan(image.values[4])
        assert driver.problems == ("ns=2;s=PLC.Axis.Words: index 3 is outside 0 … 2",)


@both_modes
async def test_all_forms_of_address_lead_to_the_same_variable(plc: NodePlc, mode: str):
    addresses = [
        "ns=2;s=PLC.Axis.Float",
        "nsu=urn:softplc:test:plc;s=PLC.Axis.Float",
        "/Objects/2:PLC/2:Axis/2:Float",
        "Objects/2:PLC/2:Axis/2:Float",
        "/Objects/nsu=urn:softplc:test:plc;PLC/2:Axis/nsu=urn:softplc:test:plc;Float",
    ]
    async with opened(plc.url, addresses, mode=mode) as driver:
        image = await read(driver, len(addresses))

        assert image.values.tolist() == [0.5] * len(addresses)
        assert driver.problems == ()


@both_modes
async def test_a_tag_that_is_missing_or_no_number_is_bad_and_the_others_live(plc: NodePlc, mode: str):
    wrong = {
        "ns=2;s=PLC.Axis.Nope": (StatusCode.BAD_NODE_ID_UNKNOWN, "no such node"),
        "ns=9;s=PLC.Axis.Float": (
            StatusCode.BAD_NODE_ID_UNKNOWN,
            "no namespace 9; it has 0 http://opcfoundation.org/UA/",
        ),
        "nsu=urn:other;s=PLC.Axis.Float": (StatusCode.BAD_NODE_ID_UNKNOWN, "no namespace urn:other"),
        "/Objects/2:PLC/2:Axis/2:Flaot": (StatusCode.BAD_NODE_ID_UNKNOWN, "there is 2:Float"),
        "/Objects/2:PCL/2:Axis/2:Float": (
            StatusCode.BAD_NODE_ID_UNKNOWN,
            "under /Objects there is no 2:PCL; there is",
        ),
        "ns=2;s=PLC.Axis.Text": (StatusCode.BAD_TYPE_MISMATCH, "is String; expected a number or Boolean"),
        "ns=2;s=PLC.Axis.Doubles": (StatusCode.BAD_TYPE_MISMATCH, "array of 3 Double; expected `index:`"),
        "ns=2;s=PLC.Axis.Secret": (StatusCode.BAD_NOT_READABLE, "may not be read"),
        "ns=2;s=PLC.Axis": (0x80350000, "is not a variable"),
    }
    async with opened(plc.url, [*wrong, f"{AXIS}.Float", (f"{AXIS}.Int16", 0)], mode=mode) as driver:
        image = await read(driver, len(wrong) + 2)
        problems = {problem.split(": ", 1)[0]: problem for problem in driver.problems}

    for position, (address, (status, text)) in enumerate(wrong.items()):
        assert image.statuses[position] == status, address
        assert math.isnan(image.values[position])
        assert text in problems[address]
    assert (image.values[-2], image.statuses[-2]) == (0.5, StatusCode.GOOD)
    assert image.statuses[-1] == StatusCode.BAD_TYPE_MISMATCH
    assert "is a single Int16; expected no `index:`" in problems[f"{AXIS}.Int16"]


@both_modes
async def test_a_value_without_usable_timestamp_gets_the_time_of_its_arrival(asyncua_plc: AsyncuaPlc, mode: str):
    names = ["Plain", "NoStamp", "Year9999"]
    before = time.time_ns()
    async with opened(asyncua_plc.url, [f"ns={asyncua_plc.index};s={name}" for name in names], mode=mode) as driver:
        image = await read(driver, len(names))

    assert image.values.tolist() == [1.5, 2.5, 3.5]
    assert image.source_timestamps[0] == STAMP_NS
    assert all(before <= stamp <= time.time_ns() for stamp in image.source_timestamps[1:])


async def test_an_old_timestamp_is_told_as_it_is(plc: NodePlc):
    async with opened(plc.url, [f"{AXIS}.Late"]) as driver:
        image = await read(driver, 1)

    assert time.time_ns() - image.source_timestamps[0] >= HOUR_NS


@both_modes
async def test_a_variable_without_value_waits_for_it(asyncua_plc: AsyncuaPlc, mode: str):
    async with opened(asyncua_plc.url, [f"ns={asyncua_plc.index};s=Empty"], mode=mode) as driver:
        image = await read(driver, 1)

        assert image.statuses[0] == StatusCode.BAD_WAITING_FOR_INITIAL_DATA
        assert driver.problems == ()  # its declared type is a number


async def test_a_browse_path_that_leads_to_two_nodes_is_refused(asyncua_plc: AsyncuaPlc):
    index = asyncua_plc.index
    async with opened(asyncua_plc.url, [f"/Objects/{index}:PLC/{index}:Twice/{index}:Same"]) as driver:
        image = await read(driver, 1)

        assert image.statuses[0] == StatusCode.BAD_CONFIGURATION_ERROR
        assert "several nodes" in driver.problems[0]


async def test_polling_sees_every_change_in_the_next_read(plc: NodePlc):
    async with opened(plc.url, [f"{AXIS}.Held", f"{AXIS}.Ramp"]) as driver:
        image = Image(2)
        ramp = -1.0
        for number in range(10):
            plc.do(f"set Held {number}")
            await driver.read(image)
            assert image.values[0] == number
            assert image.values[1] >= ramp  # the server's clock may stand still for a while on a busy machine
            ramp = float(image.values[1])


async def test_a_subscription_brings_changes_of_value_and_status_without_being_asked(plc: NodePlc):
    async with opened(plc.url, [f"{AXIS}.Held"], mode="subscribe") as driver:
        image = Image(1)
        first = (await read(driver, 1)).arrivals[0]

        def now(value: float, status: int) -> bool:
            return bool(image.statuses[0] == status and (image.values[0] == value or math.isnan(value)))

        for command, value, status in (
            ("set Held 41", 41.0, 0),
            ("bad Held", math.nan, StatusCode.BAD_SENSOR_FAILURE),
            ("set Held 42", 42.0, 0),
        ):
            plc.do(command)
            await read_until(driver, image, partial(now, value, status))
        assert image.arrivals[0] > first


async def test_the_servers_limits_are_kept_and_what_exceeds_them_is_bad(start_plc: Callable[..., NodePlc]):
    plc = start_plc(maxRead=2, maxItems=4)
    tags = [f"{AXIS}.{name}" for name in NUMBERS]
    async with opened(plc.url, tags, [f"{AXIS}.Target"]) as driver:
        assert (await read(driver, len(tags))).values.tolist() == list(NUMBERS.values())
        (remark,) = driver.remarks
        assert "at most 2 nodes (MaxNodesPerRead)" in remark
        assert "expected mode: subscribe" in remark

    async with opened(plc.url, tags, mode="subscribe") as driver:
        image = await read(driver, len(tags))
        assert image.values[:4].tolist() == list(NUMBERS.values())[:4]
        assert image.statuses[4:].tolist() == [0x80DB0000] * (len(tags) - 4)  # BadTooManyMonitoredItems
        assert "cannot be monitored: BadTooManyMonitoredItems" in driver.problems[0]


@both_modes
async def test_an_enumeration_is_a_number(plc: NodePlc, mode: str):
    async with opened(plc.url, [f"{AXIS}.Mode"], mode=mode) as driver:
        assert (await read(driver, 1)).values[0] == 2.0


@both_modes
async def test_without_any_tag_the_server_still_has_to_answer(plc: NodePlc, mode: str):
    async with opened(plc.url, [], [f"{AXIS}.Target"], mode=mode) as driver:
        await read(driver, 0)
