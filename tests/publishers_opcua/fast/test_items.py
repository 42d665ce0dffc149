"""Monitored items over the wire: what the sweep serves, what it leaves to asyncua, and what a client takes."""

from collections.abc import AsyncIterator

import pytest
import pytest_asyncio
from asyncua import Client, ua

from softplc.sample import StatusCode
from tests.publishers_opcua.conftest import Notifications, Served
from tests.publishers_opcua.messages import Messages, told
from tests.support.network import eventually

pytestmark = pytest.mark.asyncio(loop_scope="module")
POSITION = ua.NodeId("AxisX.Position", 2)


@pytest_asyncio.fixture(loop_scope="module")
async def alone(calm: Served) -> AsyncIterator[Client]:
    """A client of its own."""
    async with calm.client() as client:
        yield client


async def test_a_message_is_repeated_until_it_is_acknowledged(calm: Served, alone: Client) -> None:
    messages = await Messages(alone).create()
    await messages.monitor(POSITION)
    first = await messages.publish()
    calm.exchange.set("AxisX.Position", 2.0)
    await calm.scan()
    second = await messages.publish()

    assert told(first) == [(0, 1.0, 0)]
    assert told(second) == [(0, 2.0, 0)]
    assert second.AvailableSequenceNumbers == [1, 2]
    for message in (first, second, first):
        number = message.NotificationMessage.SequenceNumber
        assert await messages.republish(number) == message.NotificationMessage
    calm.exchange.set("AxisX.Position", 3.0)
    await calm.scan()
    third = await messages.publish(1)
    assert third.AvailableSequenceNumbers == [2, 3]
    assert [code.value for code in third.Results] == [0]
    with pytest.raises(ua.UaStatusCodeError):
        await messages.republish(1)


async def test_a_queue_that_ran_over_says_so(calm: Served, alone: Client) -> None:
    messages = await Messages(alone, interval=200.0).create()
    await messages.monitor(POSITION, POSITION, queue=1)
    await messages.monitor(POSITION, queue=2)
    await messages.publish()

    for number in (2.0, 3.0, 4.0):
        calm.exchange.set("AxisX.Position", number)
        await calm.scan()

    assert sorted(told(await messages.publish())) == [(0, 4.0, 0), (1, 4.0, 0), (2, 3.0, 0x480), (2, 4.0, 0)]


@pytest.mark.parametrize("stamps", [0, 1, 2, 3])
async def test_timestamps_are_those_asked_for(calm: Served, alone: Client, stamps: int) -> None:
    messages = await Messages(alone).create()
    await messages.monitor(POSITION, ua.NodeId("AxisX.Enabled", 2), stamps=stamps)

    (data,) = (await messages.publish()).NotificationMessage.NotificationData

    assert [
        (item.Value.SourceTimestamp is not None, item.Value.ServerTimestamp is not None)
        for item in data.MonitoredItems
    ] == [(stamps in (0, 2), stamps in (1, 2))] * 2


async def test_a_client_gets_no_more_in_one_message_than_it_wants(calm: Served, alone: Client) -> None:
    nodes = [ua.NodeId(tag.name, 2) for tag in calm.exchange.table][:25]
    messages = await Messages(alone, most=10).create()
    await messages.monitor(*nodes)

    found = [await messages.publish() for _ in range(3)]

    assert [len(told(result)) for result in found] == [10, 10, 5]
    assert [result.MoreNotifications for result in found] == [True, True, False]
    assert list(range(25)) == sorted(handle for result in found for handle, _, _ in told(result))


async def test_a_client_gets_no_larger_message_than_it_takes(calm: Served) -> None:
    client = calm.client()
    client.max_messagesize = 8192
    async with client:
        messages = await Messages(client).create()
        for _ in range(3):
            await messages.monitor(*[POSITION] * 100)
        found = []
        while sum(map(len, found)) < 300:
            found.append(told(await messages.publish()))

        assert sorted(handle for some in found for handle, _, _ in some) == list(range(300))
        assert len(found) > 2
        position, clock = (ua.ReadValueId(node, ua.AttributeIds.Value) for node in (POSITION, ua.NodeId(2258)))
        for other in (position, clock):  # on either way
            with pytest.raises(ua.uaerrors.BadResponseTooLarge):
                await client.uaclient.read(
                    ua.ReadParameters(0.0, ua.TimestampsToReturn.Both, [other, *[position] * 300])
                )
        assert len(await client.uaclient.read(ua.ReadParameters(NodesToRead=[position] * 200))) == 200


async def test_deleted_items_have_nothing_more_to_say(calm: Served, alone: Client) -> None:
    messages = await Messages(alone, interval=100.0).create()
    items = await messages.monitor(POSITION, POSITION)
    await messages.publish()
    calm.exchange.set("AxisX.Position", 5.0)
    await calm.scan()

    await alone.uaclient.delete_monitored_items(ua.DeleteMonitoredItemsParameters(messages.number, items[:1]))

    assert told(await messages.publish()) == [(1, 5.0, 0)]


async def test_items_of_other_nodes_are_told_beside_swept_ones_and_counted(calm: Served, alone: Client) -> None:
    before = calm.server.slow
    messages = await Messages(alone).create()
    await messages.monitor(POSITION, ua.NodeId(ua.ObjectIds.Server_ServiceLevel))
    await messages.monitor(POSITION, IndexRange="0:1")

    found = []
    while len(found) < 3:
        found += told(await messages.publish())

    assert sorted(found) == [(0, 1.0, 0), (1, 255, 0), (2, None, ua.StatusCodes.BadIndexRangeNoData)]
    assert calm.server.slow[1] > before[1]


async def test_nothing_of_a_subscription_stays_when_it_is_deleted(calm: Served, client: Client) -> None:
    sweep = calm.server._sweep
    assert sweep is not None
    heard = Notifications()
    before = len(sweep), len(sweep._queues)
    subscription = await client.create_subscription(10, heard)
    await subscription.subscribe_data_change([client.get_node(POSITION)] * 3)
    await eventually(lambda: len(heard.values) == 3)
    assert (before[0] + 3, before[1] + 2) == (len(sweep), len(sweep._queues))

    await subscription.delete()

    assert before == (len(sweep), len(sweep._queues))
    calm.exchange.set("AxisX.Position", 9.0, StatusCode.UNCERTAIN)
    await calm.scan()
