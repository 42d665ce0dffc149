"""What a client asks of a monitored item is heeded, on tags and on other nodes, with the fast path and without."""

from collections.abc import AsyncIterator
from typing import Any

import pytest
import pytest_asyncio
from asyncua import Client, ua

from softplc.sample import StatusCode
from tests.publishers_opcua.conftest import Served, serve
from tests.publishers_opcua.messages import Messages, told

pytestmark = pytest.mark.asyncio(loop_scope="module")

POSITION = ua.NodeId("AxisX.Position", 2)
TUNING = ua.NodeId("AxisY.Enable", 2)
CLOCK = ua.NodeId(ua.ObjectIds.Server_ServerStatus_CurrentTime)
STATUS = ua.NodeId(ua.ObjectIds.Server_ServerStatus)
NAMESPACES = ua.NodeId(ua.ObjectIds.Server_NamespaceArray)
OVERFLOW = 0x480
DISABLED, SAMPLING, REPORTING = ua.MonitoringMode.Disabled, ua.MonitoringMode.Sampling, ua.MonitoringMode.Reporting


@pytest_asyncio.fixture(scope="module", loop_scope="module", params=[True, False], ids=["fast", "ordinary"])
async def either(request: pytest.FixtureRequest) -> AsyncIterator[Served]:
    """A server with the fast path, and one without."""
    async with serve(fast=request.param) as served:
        yield served


@pytest_asyncio.fixture(loop_scope="module")
async def rested(either: Served) -> Served:
    """Every tag Good and 1, published."""
    for tag in either.exchange.table:
        either.exchange.set(tag.name, 1.0)
    await either.scan(1.0)
    return either


@pytest_asyncio.fixture(loop_scope="module")
async def alone(rested: Served) -> AsyncIterator[Client]:
    async with rested.client() as client:
        yield client


def data_change(trigger: str, band: float | None = None, kind: str = "Absolute") -> Any:
    dead_band = ua.DeadbandType.None_ if band is None else getattr(ua.DeadbandType, kind)
    return ua.uaprotocol_auto.DataChangeFilter(getattr(ua.DataChangeTrigger, trigger), dead_band, band or 0.0)


def stamps_of(value: ua.DataValue) -> tuple[bool, bool]:
    return value.SourceTimestamp is not None, value.ServerTimestamp is not None


@pytest.mark.parametrize("stamps", [0, 1, 2, 3])
@pytest.mark.parametrize("node", [CLOCK, STATUS, POSITION, TUNING], ids=["clock", "status", "position", "tuning"])
async def test_timestamps_are_those_that_create_and_modify_ask_for(
    rested: Served, alone: Client, node: ua.NodeId, stamps: int
) -> None:
    messages = await Messages(alone).create()
    (item,) = await messages.monitor(node, stamps=stamps)
    (created,) = (await messages.values()).values()
    modified_to = 3 - stamps

    await messages.modify(item, 7, stamps=modified_to)
    rested.exchange.set("AxisX.Position", 2.0)
    rested.exchange.set("AxisY.Enable", 0.0)
    await rested.scan(1.0)  # the clock shows whole seconds

    assert stamps_of(created) == (stamps in (0, 2), stamps in (1, 2))
    modified = (await messages.values())[7]
    assert stamps_of(modified) == (modified_to in (0, 2), modified_to in (1, 2))


async def test_other_attributes_come_without_the_timestamps_that_nobody_asked_for(alone: Client) -> None:
    messages = await Messages(alone).create()
    await messages.monitor(POSITION, CLOCK, attribute=ua.AttributeIds.DisplayName, stamps=3)

    found = await messages.values()

    assert [(found[handle].Value.Value.Text, *stamps_of(found[handle])) for handle in (0, 1)] == [
        ("Position", False, False),
        ("CurrentTime", False, False),
    ]


async def test_timestamps_to_return_that_are_none_fail_the_service(alone: Client) -> None:
    messages = await Messages(alone).create()
    (item,) = await messages.monitor(CLOCK)

    with pytest.raises(ua.uaerrors.BadTimestampsToReturnInvalid):
        await messages.monitor(POSITION, stamps=4)
    with pytest.raises(ua.uaerrors.BadTimestampsToReturnInvalid):
        await messages.modify(item, 0, stamps=4)


@pytest.mark.parametrize(
    ("trigger", "expected"),
    [
        ("Status", [(1.0, 0), (3.0, StatusCode.UNCERTAIN)]),
        ("StatusValue", [(1.0, 0), (2.0, 0), (3.0, StatusCode.UNCERTAIN)]),
        ("StatusValueTimestamp", [(1.0, 0), (2.0, 0), (2.0, 0), (3.0, StatusCode.UNCERTAIN)]),
    ],
)
async def test_the_trigger_says_which_changes_are_told(
    rested: Served, alone: Client, trigger: str, expected: list[tuple[float, int]]
) -> None:
    messages = await Messages(alone).create()
    await messages.monitor(POSITION, flt=data_change(trigger))
    steps = [(2.0, StatusCode.GOOD), (2.0, StatusCode.GOOD), (3.0, StatusCode.UNCERTAIN)]

    found = told(await messages.publish())
    for value, status in steps:  # the second is a new timestamp alone
        rested.exchange.set("AxisX.Position", value, status)
        await rested.scan()
    found += told(await messages.publish())

    assert [(value, int(status)) for value, status in expected] == [(value, status) for _, value, status in found]


async def test_the_trigger_counts_for_the_server_clock_too(rested: Served, alone: Client) -> None:
    messages = await Messages(alone).create()
    await messages.monitor(CLOCK, flt=data_change("Status"))
    await messages.monitor(CLOCK)
    await messages.publish()

    await rested.scan(1.0)

    assert list(await messages.values()) == [1]


@pytest.mark.parametrize(
    ("node", "attribute", "flt", "status"),
    [
        (POSITION, ua.AttributeIds.Value, data_change("StatusValue", 101.0, "Percent"), "BadDeadbandFilterInvalid"),
        (POSITION, ua.AttributeIds.DisplayName, data_change("StatusValue", 1.0), "BadFilterNotAllowed"),
        (POSITION, ua.AttributeIds.DisplayName, data_change("StatusValue", 1.0, "Percent"), "BadFilterNotAllowed"),
        (TUNING, ua.AttributeIds.Value, data_change("StatusValue", 1.0), "BadFilterNotAllowed"),  # a Boolean
        (CLOCK, ua.AttributeIds.Value, data_change("StatusValue", 1.0), "BadFilterNotAllowed"),
        (ua.NodeId(ua.ObjectIds.Server_ServiceLevel), ua.AttributeIds.Value, data_change("Status", 1.0), "Good"),
    ],
)
async def test_a_dead_band_is_for_numbers_alone(
    alone: Client, node: ua.NodeId, attribute: int, flt: Any, status: str
) -> None:
    messages = await Messages(alone).create()

    (found,) = await messages.create_items(node, attribute=attribute, flt=flt)

    assert found.StatusCode.name == status


@pytest.mark.parametrize(
    ("asked", "expected"),
    [
        ("1", ["urn:softplc:server"]),
        ("1:2", ["urn:softplc:server", "urn:softplc:tags"]),
        ("1:99", ["urn:softplc:server", "urn:softplc:tags"]),
        ("1:2,0:2", ["urn", "urn"]),
        ("9", ua.StatusCodes.BadIndexRangeNoData),
        ("1,2,3", ua.StatusCodes.BadIndexRangeNoData),
    ],
)
async def test_an_index_range_is_the_part_that_is_told(alone: Client, asked: str, expected: Any) -> None:
    messages = await Messages(alone).create()

    await messages.monitor(NAMESPACES, IndexRange=asked)

    (value,) = (await messages.values()).values()
    assert expected == (value.Value.Value or value.StatusCode.value)


@pytest.mark.parametrize("asked", ["2:1", "1:1", "-1", "a", "1:", "1,", "１", " 1"])
async def test_an_index_range_that_is_none_is_refused(alone: Client, asked: str) -> None:
    messages = await Messages(alone).create()

    found = await messages.create_items(NAMESPACES, POSITION, IndexRange=asked)

    assert [result.StatusCode.name for result in found] == ["BadIndexRangeInvalid"] * 2


async def test_a_number_has_no_part(rested: Served, alone: Client) -> None:
    messages = await Messages(alone).create()
    await messages.monitor(POSITION, IndexRange="0")
    assert told(await messages.publish()) == [(0, None, ua.StatusCodes.BadIndexRangeNoData)]

    rested.exchange.set("AxisX.Position", float("nan"), StatusCode.BAD_NO_COMMUNICATION)
    await rested.scan()

    assert told(await messages.publish()) == [(0, None, StatusCode.BAD_NO_COMMUNICATION)]


@pytest.mark.parametrize(
    ("node", "encoding", "status"),
    [
        (STATUS, ua.QualifiedName("Default Binary", 0), "Good"),
        (STATUS, ua.QualifiedName("Default XML", 0), "BadDataEncodingUnsupported"),
        (STATUS, ua.QualifiedName("Default Binary", 2), "BadDataEncodingUnsupported"),
        (CLOCK, ua.QualifiedName("Default Binary", 0), "BadDataEncodingInvalid"),
        (POSITION, ua.QualifiedName("Default Binary", 0), "BadDataEncodingInvalid"),
    ],
)
async def test_a_data_encoding_is_for_structures_alone(
    alone: Client, node: ua.NodeId, encoding: ua.QualifiedName, status: str
) -> None:
    messages = await Messages(alone).create()

    (found,) = await messages.create_items(node, DataEncoding=encoding)

    assert found.StatusCode.name == status


@pytest.mark.parametrize("node", [CLOCK, POSITION], ids=["clock", "position"])
@pytest.mark.parametrize(
    ("size", "oldest", "kept"),
    [
        (0, True, [(3, 0)]),
        (1, True, [(3, 0)]),
        (1, False, [(3, 0)]),
        (2, True, [(2, OVERFLOW), (3, 0)]),
        (2, False, [(1, 0), (3, OVERFLOW)]),
        (3, True, [(1, 0), (2, 0), (3, 0)]),
    ],
)
async def test_a_queue_keeps_what_was_asked_for_and_says_that_some_were_lost(
    rested: Served, alone: Client, node: ua.NodeId, size: int, oldest: bool, kept: list[tuple[int, int]]
) -> None:
    messages = await Messages(alone).create()
    (result,) = await messages.create_items(node, queue=size, oldest=oldest)
    await messages.publish()

    came = await changes(rested, node, 3)

    assert result.RevisedQueueSize == max(size, 1)
    found = [(came.index(value) + 1, status) for _, value, status in told(await messages.publish())]
    assert kept == found


async def changes(served: Served, node: ua.NodeId, count: int) -> list[Any]:
    """The values that the node takes, one after the other."""
    found = []
    for number in range(count):
        served.exchange.set("AxisX.Position", 10.0 + number)
        await served.scan(1.0)
        found.append(served.server._space.read_attribute_value(node, ua.AttributeIds.Value).Value.Value)
    return found


@pytest.mark.parametrize("node", [CLOCK, POSITION], ids=["clock", "position"])
async def test_a_queue_that_is_made_smaller_keeps_the_newest(rested: Served, alone: Client, node: ua.NodeId) -> None:
    messages = await Messages(alone).create()
    (item,) = await messages.monitor(node)
    await messages.publish()
    came = await changes(rested, node, 3)

    await messages.modify(item, 0, queue=2)

    assert told(await messages.publish()) == [(0, came[1], OVERFLOW), (0, came[2], 0)]


@pytest.mark.parametrize("node", [CLOCK, POSITION], ids=["clock", "position"])
async def test_a_deleted_item_has_nothing_more_to_say(rested: Served, alone: Client, node: ua.NodeId) -> None:
    messages = await Messages(alone).create()
    items = await messages.monitor(node, node)
    await messages.publish()
    await changes(rested, node, 1)

    await alone.uaclient.delete_monitored_items(ua.DeleteMonitoredItemsParameters(messages.number, items[:1]))

    assert [handle for handle, _, _ in told(await messages.publish())] == [1]


@pytest.mark.parametrize("node", [CLOCK, POSITION], ids=["clock", "position"])
async def test_an_item_that_is_disabled_forgets_and_reports_anew(
    rested: Served, alone: Client, node: ua.NodeId
) -> None:
    messages = await Messages(alone).create()
    (item,) = await messages.monitor(node)
    await messages.publish()
    (value,) = await changes(rested, node, 1)

    await messages.set_mode(DISABLED, item)
    await messages.set_mode(REPORTING, item)

    assert told(await messages.publish()) == [(0, value, 0)]
    await changes(rested, node, 1)
    await messages.set_mode(DISABLED, item)
    await messages.monitor(TUNING)
    assert [handle for handle, _, _ in told(await messages.publish())] == [1]


@pytest.mark.parametrize("node", [CLOCK, POSITION], ids=["clock", "position"])
async def test_an_item_that_is_only_sampled_reports_when_it_may(
    rested: Served, alone: Client, node: ua.NodeId
) -> None:
    messages = await Messages(alone).create()
    (sampled,) = await messages.monitor(node, mode=SAMPLING, queue=2)
    (other,) = await messages.monitor(node)
    assert [handle for handle, _, _ in told(await messages.publish())] == [1]
    came = await changes(rested, node, 3)
    assert {handle for handle, _, _ in told(await messages.publish())} == {1}

    await messages.set_mode(REPORTING, sampled)
    await messages.set_mode(SAMPLING, other)

    assert told(await messages.publish()) == [(0, came[1], OVERFLOW), (0, came[2], 0)]


async def test_a_client_gets_no_more_in_one_message_than_it_wants_whatever_it_monitors(
    rested: Served, alone: Client
) -> None:
    tags = [ua.NodeId(tag.name, 2) for tag in rested.exchange.table][:13]
    messages = await Messages(alone, most=10).create()
    await messages.monitor(*[CLOCK] * 12, *tags)

    found = [await messages.publish() for _ in range(3)]

    assert [len(told(result)) for result in found] == [10, 10, 5]
    assert [result.MoreNotifications for result in found] == [True, True, False]
    assert list(range(25)) == sorted(handle for result in found for handle, _, _ in told(result))
