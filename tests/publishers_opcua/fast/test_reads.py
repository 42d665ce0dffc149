"""Reads over the wire: those of tags alone are served from the arrays, and nobody can tell."""

from collections.abc import Iterator
from typing import Any

import pytest
from asyncua import Client, ua

from softplc import asyncua_version
from softplc.publishers.opcua.fast.reads import Reads
from softplc.publishers.opcua.fast.seam import proven
from softplc.sample import StatusCode
from tests.publishers_opcua.conftest import LIMITS, Served, refused

pytestmark = pytest.mark.asyncio(loop_scope="module")
VALUE = ua.AttributeIds.Value


def reads(served: Served) -> Reads:
    found = served.server._server.iserver.reads
    assert isinstance(found, Reads)
    return found


@pytest.fixture
def ordinary(served: Served) -> Iterator[Any]:
    """Switches the fast path off; it is on again after the test."""
    inner = served.server._server.iserver
    before = inner.reads

    def switch() -> None:
        inner.reads = None

    yield switch
    inner.reads = before


async def read(client: Client, nodes: list[ua.ReadValueId], stamps: int = 2) -> list[ua.DataValue]:
    return await client.uaclient.read(ua.ReadParameters(0.0, ua.TimestampsToReturn(stamps), nodes))


@pytest.mark.parametrize("stamps", [0, 1, 2, 3])
async def test_both_ways_answer_the_same(served: Served, client: Client, ordinary: Any, stamps: int) -> None:
    table = served.exchange.table
    for index, tag in enumerate(table):
        served.exchange.set(
            tag.name, index, [0, StatusCode.UNCERTAIN, StatusCode.BAD_TIMEOUT][index % 3], index * 1_000
        )
    await served.scan()
    nodes = [ua.ReadValueId(ua.NodeId(tag.name, 2), VALUE) for tag in table] * 2
    before = reads(served).served

    fast = await read(client, nodes, stamps)
    again = await read(client, nodes, stamps)
    assert reads(served).served == before + 2
    ordinary()
    plain = await read(client, nodes, stamps)

    assert fast == again == plain
    assert {(v.SourceTimestamp is not None, v.ServerTimestamp is not None) for v in fast} == {
        (stamps in (0, 2), stamps in (1, 2))
    }


async def test_a_read_of_other_things_takes_the_ordinary_way_and_is_counted(calm: Served, client: Client) -> None:
    position, unknown, clock = ua.NodeId("AxisX.Position", 2), ua.NodeId("AxisX.Nothing", 2), ua.NodeId(2258)
    before = reads(calm).served, reads(calm).slow

    found = await read(
        client,
        [
            ua.ReadValueId(position, VALUE),
            ua.ReadValueId(unknown, VALUE),
            ua.ReadValueId(clock, VALUE),
            ua.ReadValueId(position, ua.AttributeIds.DisplayName),
        ],
        3,
    )

    assert [value.StatusCode.value for value in found] == [0, ua.StatusCodes.BadNodeIdUnknown, 0, 0]
    assert {(value.SourceTimestamp, value.ServerTimestamp) for value in found} == {(None, None)}
    assert found[3].Value.Value.Text == "Position"
    assert before == (reads(calm).served, reads(calm).slow - 1)


async def test_registered_nodes_read_as_they_are(calm: Served, client: Client) -> None:
    nodes = await client.register_nodes([client.get_node("ns=2;s=AxisX.Position")])
    before = reads(calm).served

    assert await nodes[0].read_value() is not None
    assert reads(calm).served == before + 1


async def test_limits_hold_on_both_ways(quiet: Served) -> None:
    async with quiet.client() as client:
        node = ua.ReadValueId(ua.NodeId("AxisX.Position", 2), VALUE)
        assert len(await read(client, [node] * LIMITS.operations)) == LIMITS.operations
        assert reads(quiet).served
        for count, expected in (
            (LIMITS.operations + 1, ua.StatusCodes.BadTooManyOperations),
            (0, ua.StatusCodes.BadNothingToDo),
        ):
            with pytest.raises(ua.UaStatusCodeError) as error:
                await read(client, [node] * count)
            assert expected == refused(error)


async def test_another_sessions_token_is_refused(quiet: Served) -> None:
    async with quiet.client() as client, quiet.client() as other:
        protocol = client.uaclient.protocol
        own, protocol.authentication_token = (
            protocol.authentication_token,
            other.uaclient.protocol.authentication_token,
        )
        with pytest.raises(ua.UaStatusCodeError) as error:
            await read(client, [ua.ReadValueId(ua.NodeId("AxisX.Position", 2), VALUE)])
        protocol.authentication_token = own

        assert refused(error) == ua.StatusCodes.BadSessionIdInvalid


async def test_a_session_that_only_reads_stays_alive(quiet: Served) -> None:
    async with quiet.client() as client:
        (session,) = quiet.server._server.iserver._external_sessions.values()
        session._last_activity -= 10.0
        before = session._last_activity

        await read(client, [ua.ReadValueId(ua.NodeId("AxisX.Position", 2), VALUE)])

        assert session._last_activity > before
        assert session.processor.session_last_activity == session._last_activity


async def test_an_asyncua_that_was_not_proven_is_not_used() -> None:
    assert proven()
    assert not asyncua_version.proven("test", "2.1.0.post1")
    assert all(asyncua_version.proven("test", version) for version in asyncua_version.PROVEN)
