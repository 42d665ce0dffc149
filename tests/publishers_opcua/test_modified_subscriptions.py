"""ModifySubscription is heeded, with the fast path and without."""

import asyncio
import math
from typing import Any

import pytest
from asyncua import Client, ua

from softplc.publishers.opcua.hardened.limits import Limits
from tests.publishers_opcua.conftest import Served, refused
from tests.publishers_opcua.messages import Messages, told
from tests.support.network import eventually

pytestmark = pytest.mark.asyncio(loop_scope="module")

POSITION = ua.NodeId("AxisX.Position", 2)
CLOCK = ua.NodeId(ua.ObjectIds.Server_ServerStatus_CurrentTime)
HOUR = 3_600_000.0


def subscription(served: Served, messages: Messages) -> Any:
    return served.server._server.iserver.subscription_service.subscriptions.get(messages.number)


def values(revised: Any) -> tuple[float, int, int]:
    return revised.RevisedPublishingInterval, revised.RevisedLifetimeCount, revised.RevisedMaxKeepAliveCount


async def test_the_values_that_were_asked_for_are_told_and_done(rested: Served, alone: Client) -> None:
    messages = await Messages(alone, interval=50.0).create()

    revised = await messages.modify_subscription(500.0, 60, 20, 3)

    assert values(revised) == (500.0, 60, 20) == values(subscription(rested, messages).data)


@pytest.mark.parametrize(
    "asked",
    [(0.0, 0, 0), (-5.0, 1, 1), (math.nan, 3, 5_000), (math.inf, 2**32 - 1, 2**32 - 1), (1e-300, 0, 2**32 - 1)],
)
async def test_limits_are_those_of_a_new_subscription(rested: Served, alone: Client, asked: Any) -> None:
    interval, lifetime, keep_alive = asked
    parameters = ua.CreateSubscriptionParameters(interval, lifetime, keep_alive, 0, True, 0)
    created = await alone.uaclient.create_subscription(parameters, lambda _: None)
    messages = await Messages(alone).create()

    modified = await messages.modify_subscription(interval, lifetime, keep_alive)

    assert values(created) == values(modified)
    assert Limits().min_publishing_ms <= modified.RevisedPublishingInterval <= Limits().max_publishing_ms
    assert modified.RevisedLifetimeCount >= 3 * modified.RevisedMaxKeepAliveCount


@pytest.mark.parametrize("node", [POSITION, CLOCK], ids=["position", "clock"])
async def test_a_subscription_made_faster_publishes_at_once(rested: Served, alone: Client, node: ua.NodeId) -> None:
    messages = await Messages(alone, interval=HOUR).create()
    assert not told(await messages.publish())  # the first message of every subscription
    await messages.monitor(node)
    heard = asyncio.create_task(messages.publish())

    await messages.modify_subscription(10.0)

    async with asyncio.timeout(20):
        assert len(told(await heard)) == 1


async def test_a_subscription_made_slower_publishes_no_more_than_that(rested: Served, alone: Client) -> None:
    slowed, steady = await Messages(alone).create(), await Messages(alone).create()
    for messages in (slowed, steady):
        await messages.monitor(POSITION)
    for _ in range(2):
        await steady.publish()

    await slowed.modify_subscription(HOUR)
    published = []
    for number in range(20):
        rested.exchange.set("AxisX.Position", float(number))
        await rested.scan()
        published.append((await steady.publish()).SubscriptionId)

    assert published.count(slowed.number) <= 1  # the publish that was on its way
    assert steady.number in published


@pytest.mark.parametrize("most", [1, 3])
async def test_a_message_has_as_many_notifications_as_were_asked_for_last(
    rested: Served, alone: Client, most: int
) -> None:
    messages = await Messages(alone).create()
    await messages.monitor(POSITION, queue=10)
    await messages.monitor(CLOCK, queue=10)
    assert len(told(await messages.publish())) == 2

    await messages.modify_subscription(most=most)
    for number in range(2, 6):
        rested.exchange.set("AxisX.Position", float(number))
        await rested.scan(1.0)

    counts = []
    while sum(counts) < 8:
        counts.append(len(told(await messages.publish())))
    assert max(counts) == most


async def test_a_shorter_keep_alive_is_kept(alone: Client) -> None:
    messages = await Messages(alone).create()
    await messages.publish()
    heard = asyncio.create_task(messages.publish())

    await messages.modify_subscription(keep_alive=2)

    async with asyncio.timeout(20):
        assert not told(await heard)


async def test_a_shorter_lifetime_ends_a_subscription_that_nobody_asks(rested: Served, alone: Client) -> None:
    messages = await Messages(alone).create()
    await messages.monitor(POSITION)

    await messages.modify_subscription(lifetime=3, keep_alive=1)

    await eventually(lambda: subscription(rested, messages) is None)


async def test_a_subscription_that_is_modified_lives_on(rested: Served, alone: Client) -> None:
    messages = await Messages(alone).create()
    found = subscription(rested, messages)
    await eventually(lambda: found._publish_cycles_count > 5)

    await messages.modify_subscription(interval=HOUR)

    assert found._publish_cycles_count <= 1


async def test_a_subscription_that_is_not_there_cannot_be_modified(alone: Client) -> None:
    messages = Messages(alone)

    with pytest.raises(ua.UaStatusCodeError) as error:
        await messages.modify_subscription()

    assert refused(error) == ua.StatusCodes.BadSubscriptionIdInvalid
