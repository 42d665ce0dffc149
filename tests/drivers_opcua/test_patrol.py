"""One subscribed variable that falls silent while the others go on reporting: its value is never old and Good."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from datetime import UTC, datetime

import pytest
from asyncua import ua

from softplc.drivers.opcua.driver import OpcUaDriver
from softplc.sample import StatusCode
from softplc.tags import Image
from tests.drivers_opcua.opened import opened, read, read_until
from tests.drivers_opcua.servers import AsyncuaPlc

DOUBLE = ua.VariantType.Double


def now() -> datetime:
    return datetime.now(UTC)


def silently(plc: AsyncuaPlc, name: str, value: ua.DataValue) -> None:
    """Change a variable so that no subscription is told."""

    async def change() -> None:
        node = plc.server.iserver.aspace._nodes[ua.NodeId(name, plc.index)]
        node.attributes[ua.AttributeIds.Value].value = value

    plc.run(change())


@pytest.fixture
def mute(asyncua_plc: AsyncuaPlc) -> Iterator[str]:
    """The name of a variable with the value 1.5, which is there for one test."""
    name, plc = "Mute", asyncua_plc

    async def add() -> ua.NodeId:
        node = await plc.server.nodes.objects.add_variable(
            ua.NodeId(name, plc.index), f"{plc.index}:{name}", 1.5, DOUBLE
        )
        return node.nodeid

    plc.run(add())
    plc.write(name, ua.DataValue(ua.Variant(1.5, DOUBLE), SourceTimestamp=now()))
    yield name
    with contextlib.suppress(ua.UaStatusCodeError):
        plc.run(plc.server.get_node(ua.NodeId(name, plc.index)).delete())


@asynccontextmanager
async def beside_a_busy_one(plc: AsyncuaPlc, name: str, **config: float) -> AsyncIterator[OpcUaDriver]:
    """A driver that is subscribed to this variable and to one that reports all the time."""
    tags = [f"ns={plc.index};s={name}", f"ns={plc.index};s=Moving"]

    async def report() -> None:
        number = 0
        while True:
            number += 1
            value = ua.DataValue(ua.Variant(float(number), DOUBLE), SourceTimestamp=now())
            await asyncio.to_thread(plc.write, "Moving", value)
            await asyncio.sleep(0.02)

    async with opened(plc.url, tags, mode="subscribe", **config) as driver:
        assert (await read(driver, 2)).values[0] == 1.5
        reporting = asyncio.create_task(report())
        try:
            yield driver
        finally:
            reporting.cancel()
            await asyncio.gather(reporting, return_exceptions=True)


@pytest.mark.parametrize("stamped", [True, False])
async def test_a_variable_about_which_the_subscription_fell_silent_is_read_from_then_on(
    asyncua_plc: AsyncuaPlc, mute: str, stamped: bool
):
    async with beside_a_busy_one(asyncua_plc, mute) as driver:
        image, at = Image(2), now() if stamped else None
        silently(asyncua_plc, mute, ua.DataValue(ua.Variant(7.0, DOUBLE), SourceTimestamp=at))
        await read_until(driver, image, lambda: image.values[0] == 7.0)
        for value in (8.0, 9.0):
            silently(asyncua_plc, mute, ua.DataValue(ua.Variant(value, DOUBLE), SourceTimestamp=at and now()))
            await driver.read(image)
            assert image.values[0] == value

        assert image.statuses.tolist() == [0, 0]
        (told,) = driver.problems
        assert f"s={mute}: the subscription fell silent about it; it is read in every scan instead" in told


@pytest.mark.parametrize("stamped", [True, False])
async def test_a_bad_status_that_is_not_reported_is_found(asyncua_plc: AsyncuaPlc, mute: str, stamped: bool):
    bad = ua.StatusCode(ua.UInt32(StatusCode.BAD_SENSOR_FAILURE))
    async with beside_a_busy_one(asyncua_plc, mute) as driver:
        silently(asyncua_plc, mute, ua.DataValue(None, bad, SourceTimestamp=now() if stamped else None))
        image = Image(2)
        await read_until(driver, image, lambda: image.statuses[0] == StatusCode.BAD_SENSOR_FAILURE)

        assert image.statuses[1] == 0


@pytest.mark.parametrize("busy", [True, False])
async def test_a_variable_that_is_gone_is_bad_though_no_report_says_so_and_comes_back(
    asyncua_plc: AsyncuaPlc, mute: str, busy: bool
):
    plc = asyncua_plc
    other = mute if busy else "Plain"
    async with contextlib.AsyncExitStack() as stack:
        if busy:
            driver = await stack.enter_async_context(beside_a_busy_one(plc, other))
        else:
            tags = [f"ns={plc.index};s={mute}", f"ns={plc.index};s=Plain"]
            driver = await stack.enter_async_context(opened(plc.url, tags, mode="subscribe"))
        image = await read(driver, 2)
        plc.run(plc.server.get_node(ua.NodeId(mute, plc.index)).delete())
        await read_until(driver, image, lambda: image.statuses[0] == StatusCode.BAD_NODE_ID_UNKNOWN)
        assert image.statuses[1] == 0
        (told,) = driver.problems
        assert f"s={mute}: the server has no such node" in told

        objects = plc.server.nodes.objects
        plc.run(objects.add_variable(ua.NodeId(mute, plc.index), f"{plc.index}:{mute}", 4.0, DOUBLE))
        await read_until(driver, image, lambda: image.values[0] == 4.0)
        assert driver.problems == ()


async def test_another_type_that_is_not_reported_is_that_variables_trouble_alone(asyncua_plc: AsyncuaPlc, mute: str):
    plc = asyncua_plc
    tags = [f"ns={plc.index};s={mute}", f"ns={plc.index};s=Plain"]
    async with opened(plc.url, tags, mode="subscribe") as driver:
        image = await read(driver, 2)
        whole = ua.DataValue(ua.Variant(1, ua.VariantType.Int32), SourceTimestamp=now())
        silently(plc, mute, whole)
        await read_until(driver, image, lambda: image.statuses[0] == StatusCode.BAD_TYPE_MISMATCH)

        assert image.statuses[1] == 0
        silently(plc, mute, ua.DataValue(ua.Variant(2.5, DOUBLE), SourceTimestamp=now()))
        await read_until(driver, image, lambda: image.values[0] == 2.5)


async def test_variables_that_are_reported_late_are_not_taken_for_silent(asyncua_plc: AsyncuaPlc, mute: str):
    async with beside_a_busy_one(asyncua_plc, mute, publishing_ms=400.0) as driver:
        image = Image(2)
        for value in (2.0, 3.0, 4.0):
            asyncua_plc.write(mute, ua.DataValue(ua.Variant(value, DOUBLE), SourceTimestamp=now()))
            await read_until(driver, image, lambda value=value: image.values[0] == value)  # type: ignore[misc]

        assert driver.problems == ()
