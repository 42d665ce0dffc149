"""What waits to be told: queues, modes and messages, on tags and on other nodes, with the fast path and without."""

from typing import Any

import pytest
from asyncua import Client, ua

from tests.publishers_opcua.conftest import Served
from tests.publishers_opcua.messages import Messages, told

pytestmark = pytest.mark.asyncio(loop_scope="module")

POSITION = ua.NodeId("AxisX.Position", 2)
TUNING = ua.NodeId("AxisY.Enable", 2)
CLOCK = ua.NodeId(ua.ObjectIds.Server_ServerStatus_CurrentTime)
OVERFLOW = 0x480
DISABLED, SAMPLING, REPORTING = ua.MonitoringMode.Disabled, ua.MonitoringMode.Sampling, ua.MonitoringMode.Reporting


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
