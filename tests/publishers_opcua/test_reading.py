"""What a Read asks for is heeded, of tags and of other nodes, with the fast path and without."""

import math
from typing import Any

import pytest
from asyncua import Client, ua

from softplc.sample import StatusCode
from tests.publishers_opcua.conftest import PASSWORD, Served, refused
from tests.publishers_opcua.messages import PARTS

pytestmark = pytest.mark.asyncio(loop_scope="module")

CODES = ua.StatusCodes
POSITION = ua.NodeId("AxisX.Position", 2)
STATES = ua.NodeId("AxisX.State.EnumStrings", 2)
CLOCK = ua.NodeId(ua.ObjectIds.Server_ServerStatus_CurrentTime)
STATUS = ua.NodeId(ua.ObjectIds.Server_ServerStatus)
NAMESPACES = ua.NodeId(ua.ObjectIds.Server_NamespaceArray)


async def read(
    client: Client, *nodes: ua.NodeId, age: float = 0.0, stamps: Any = ua.TimestampsToReturn.Both, **asked: Any
) -> list[ua.DataValue]:
    asked = {"AttributeId": ua.AttributeIds.Value, **asked}
    wanted = [ua.ReadValueId(node, **asked) for node in nodes]
    return await client.uaclient.read(ua.ReadParameters(age, stamps, wanted))


@pytest.mark.parametrize(
    ("asked", "expected"),
    [*PARTS, ("5:2", CODES.BadIndexRangeInvalid), ("x", CODES.BadIndexRangeInvalid)],
)
async def test_an_index_range_is_the_part_that_is_read(alone: Client, asked: str, expected: Any) -> None:
    (value,) = await read(alone, NAMESPACES, IndexRange=asked)

    assert expected == (value.Value.Value or value.StatusCode.value)


async def test_the_meaning_of_one_state_can_be_read(alone: Client) -> None:
    (whole,) = await read(alone, STATES)
    (part,) = await read(alone, STATES, IndexRange="0:1")

    assert (len(part.Value.Value), whole.Value.Value[:2]) == (2, part.Value.Value)


@pytest.mark.parametrize(
    ("asked", "expected"), [("0", CODES.BadIndexRangeNoData), ("5:2", CODES.BadIndexRangeInvalid)]
)
async def test_a_number_has_no_part(rested: Served, alone: Client, asked: str, expected: int) -> None:
    found = await read(alone, POSITION, CLOCK, IndexRange=asked)

    assert [(None, expected)] * 2 == [(value.Value.Value, value.StatusCode.value) for value in found]


async def test_a_bad_value_stays_bad_whatever_part_is_asked_for(rested: Served, alone: Client) -> None:
    rested.exchange.set("AxisX.Position", math.nan, StatusCode.BAD_NO_COMMUNICATION)
    await rested.scan()

    (value,) = await read(alone, POSITION, IndexRange="0")

    assert value.StatusCode.value == StatusCode.BAD_NO_COMMUNICATION


async def test_who_has_no_node_reads_no_part_of_it(alone: Client) -> None:
    (value,) = await read(alone, ua.NodeId("AxisX.Nothing", 2), IndexRange="0")

    assert value.StatusCode.value == CODES.BadNodeIdUnknown


async def test_an_index_range_counts_for_a_users_own_access_too(rested: Served) -> None:
    async with rested.client("engineer", PASSWORD) as engineer:
        level = ua.AttributeIds.UserAccessLevel
        (whole,) = await read(engineer, ua.NodeId("AxisY.Enable", 2), AttributeId=level)
        (part,) = await read(engineer, ua.NodeId("AxisY.Enable", 2), AttributeId=level, IndexRange="0")

    assert (whole.Value.Value, part.Value.Value) == (3, None)
    assert part.StatusCode.value == CODES.BadIndexRangeNoData


@pytest.mark.parametrize(
    ("node", "encoding", "status"),
    [
        (STATUS, ua.QualifiedName("Default Binary", 0), "Good"),
        (STATUS, ua.QualifiedName("Default XML", 0), "BadDataEncodingUnsupported"),
        (CLOCK, ua.QualifiedName("Default Binary", 0), "BadDataEncodingInvalid"),
        (POSITION, ua.QualifiedName("foo", 0), "BadDataEncodingInvalid"),
    ],
)
async def test_a_data_encoding_is_for_structures_alone(
    rested: Served, alone: Client, node: ua.NodeId, encoding: ua.QualifiedName, status: str
) -> None:
    (value,) = await read(alone, node, DataEncoding=encoding)

    assert value.StatusCode.name == status


@pytest.mark.parametrize("age", [-1.0, -1e-300, math.nan, -math.inf])
@pytest.mark.parametrize("node", [POSITION, CLOCK], ids=["position", "clock"])
async def test_a_negative_max_age_fails_the_service(alone: Client, node: ua.NodeId, age: float) -> None:
    with pytest.raises(ua.UaStatusCodeError) as error:
        await read(alone, node, age=age)

    assert refused(error) == CODES.BadMaxAgeInvalid


@pytest.mark.parametrize("age", [1e9, math.inf])
async def test_a_value_may_be_of_any_age(rested: Served, alone: Client, age: float) -> None:
    (value,) = await read(alone, POSITION, age=age)

    assert value.StatusCode.is_good()


@pytest.mark.parametrize("stamps", [4, 5, -1, 2**31 - 1])
@pytest.mark.parametrize("node", [POSITION, CLOCK], ids=["position", "clock"])
async def test_timestamps_to_return_that_are_none_fail_the_service(
    alone: Client, node: ua.NodeId, stamps: int
) -> None:
    with pytest.raises(ua.UaStatusCodeError) as error:
        await read(alone, node, stamps=Number(stamps))

    assert refused(error) == CODES.BadTimestampsToReturnInvalid


class Number(int):
    """A number that asyncua encodes as one of an enumeration."""

    @property
    def value(self) -> int:
        return self
