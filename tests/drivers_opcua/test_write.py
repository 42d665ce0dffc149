"""Writing back to a server's variables, as their own type or not at all."""

import math

import pytest
from asyncua import ua

from softplc.drivers.opcua.driver import REBIND
from softplc.sample import StatusCode
from tests.drivers_opcua.opened import ForwardClock, opened, read, read_until
from tests.drivers_opcua.servers import AsyncuaPlc, NodePlc
from tests.support.drivers import write_values

AXIS = "ns=2;s=PLC.Axis"


async def test_values_are_written_as_each_variables_own_type_and_read_back(plc: NodePlc):
    targets = [f"{AXIS}.Target", f"{AXIS}.Count", f"{AXIS}.Flag", "/Objects/2:PLC/2:Axis/2:Held"]
    async with opened(plc.url, targets, targets) as driver:
        assert await write_values(driver, {0: 0.25, 1: -7.6, 2: 1.0, 3: 1e200}) == {0: 0, 1: 0, 2: 0, 3: 0}
        image = await read(driver, 4)
        assert image.values.tolist() == [0.25, -8.0, 1.0, 1e200]

        assert await write_values(driver, {2: 0.0}) == {2: 0}
        assert (await read(driver, 4)).values[2] == 0.0


async def test_a_value_that_does_not_fit_is_not_sent_and_the_others_are(plc: NodePlc):
    targets = [f"{AXIS}.Count", f"{AXIS}.Flag", f"{AXIS}.Target"]
    async with opened(plc.url, targets, targets) as driver:
        await write_values(driver, {0: 5.0, 1: 1.0, 2: 0.0})
        statuses = await write_values(driver, {0: 40_000.0, 1: 2.0, 2: 0.5})
        image = await read(driver, 3)

        assert statuses == {0: StatusCode.BAD_OUT_OF_RANGE, 1: StatusCode.BAD_OUT_OF_RANGE, 2: 0}
        assert image.values.tolist() == [5.0, 1.0, 0.5]
        assert await write_values(driver, {2: math.nan}) == {2: StatusCode.BAD_OUT_OF_RANGE}


async def test_one_element_of_an_array_is_written_and_its_neighbours_stay(plc: NodePlc):
    elements = [(f"{AXIS}.Scratch", index) for index in range(3)]
    async with opened(plc.url, elements, elements) as driver:
        assert await write_values(driver, {0: 1.0, 1: 2.0, 2: 3.0}) == {0: 0, 1: 0, 2: 0}
        assert await write_values(driver, {1: 20.0}) == {1: 0}
        assert (await read(driver, 3)).values.tolist() == [1.0, 20.0, 3.0]


async def test_what_cannot_be_written_says_why(plc: NodePlc):
    targets = [f"{AXIS}.ReadOnly", f"{AXIS}.Nope", f"{AXIS}.Text", f"{AXIS}.Target"]
    async with opened(plc.url, [], targets) as driver:
        statuses = await write_values(driver, {0: 1.0, 1: 1.0, 2: 1.0, 3: 1.0})

        assert statuses == {
            0: StatusCode.BAD_NOT_WRITABLE,
            1: StatusCode.BAD_NODE_ID_UNKNOWN,
            2: StatusCode.BAD_TYPE_MISMATCH,
            3: StatusCode.GOOD,
        }
        assert any("Nope" in problem for problem in driver.problems)


async def test_a_variable_without_value_is_written_as_its_declared_type(plc: NodePlc):
    targets = [f"{AXIS}.Span", f"{AXIS}.Label"]  # a Duration, which is a Double, and a LocaleId, which is a String
    async with opened(plc.url, [], targets) as driver:
        assert driver.problems == (f"{AXIS}.Label: is String; expected a number or Boolean",)
        assert await write_values(driver, {0: 1.25, 1: 1.0}) == {0: 0, 1: StatusCode.BAD_TYPE_MISMATCH}


@pytest.mark.parametrize("mode", ["poll", "subscribe"])
async def test_a_write_carries_neither_status_nor_timestamp(asyncua_plc: AsyncuaPlc, mode: str):
    """The server stores what it is sent: a status or source timestamp of ours would show."""
    target = f"ns={asyncua_plc.index};s=Target"
    async with opened(asyncua_plc.url, [target], [target], mode=mode) as driver:
        assert await write_values(driver, {0: 12.5}) == {0: 0}
    stored = asyncua_plc.run(asyncua_plc.server.get_node(ua.NodeId("Target", asyncua_plc.index)).read_data_value())

    assert stored.Value.Value == 12.5
    assert stored.SourceTimestamp is None


async def test_a_variable_whose_type_changed_is_written_as_the_new_type_soon_after(plc: NodePlc):
    clock = ForwardClock()
    async with opened(plc.url, [f"{AXIS}.Float"], [f"{AXIS}.Changing"], clock) as driver:
        plc.do("retype Changing Int16")
        assert await write_values(driver, {0: 3.0}) == {0: StatusCode.BAD_TYPE_MISMATCH}

        clock.ahead += 2 * REBIND
        image = await read(driver, 1)
        await read_until(driver, image, lambda: not driver.problems)
        assert await write_values(driver, {0: 3.0}) == {0: 0}
    async with opened(plc.url, [f"{AXIS}.Changing"]) as driver:
        assert (await read(driver, 1)).values[0] == 3.0


async def test_a_node_that_is_read_under_another_spelling_is_never_written(plc: NodePlc):
    readings = [
        "/Objects/2:PLC/2:Axis/2:Target",
        "nsu=urn:softplc:test:plc;s=PLC.Axis.Count",
        (f"{AXIS}.Scratch", 0),
        f"{AXIS}.Held",
    ]
    scratch = "nsu=urn:softplc:test:plc;s=PLC.Axis.Scratch"
    writings = [f"{AXIS}.Target", f"{AXIS}.Count", (scratch, 0), (scratch, 1), f"{AXIS}.Held"]
    async with opened(plc.url, readings, writings) as driver:
        before = (await read(driver, 4)).values.tolist()
        statuses = await write_values(driver, dict.fromkeys(range(5), 77.0))
        after = (await read(driver, 4)).values.tolist()

        loop = StatusCode.BAD_CONFIGURATION_ERROR
        # the last two are no loops: another element, and the tag's own read-back
        assert statuses == {0: loop, 1: loop, 2: loop, 3: StatusCode.GOOD, 4: StatusCode.GOOD}
        assert after == [*before[:3], 77.0]
        assert sum("closes a loop" in problem for problem in driver.problems) == 3
