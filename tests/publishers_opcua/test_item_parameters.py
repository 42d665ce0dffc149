"""What a client asks of a monitored item is heeded, on tags and on other nodes, with the fast path and without."""

from typing import Any

import pytest
from asyncua import Client, ua

from softplc.sample import StatusCode
from tests.publishers_opcua.conftest import Served
from tests.publishers_opcua.messages import PARTS, Messages, told

pytestmark = pytest.mark.asyncio(loop_scope="module")

POSITION = ua.NodeId("AxisX.Position", 2)
TUNING = ua.NodeId("AxisY.Enable", 2)
CLOCK = ua.NodeId(ua.ObjectIds.Server_ServerStatus_CurrentTime)
STATUS = ua.NodeId(ua.ObjectIds.Server_ServerStatus)
NAMESPACES = ua.NodeId(ua.ObjectIds.Server_NamespaceArray)


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


@pytest.mark.parametrize(("asked", "expected"), PARTS)
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
