"""Publish requests that wait hear why nothing more will come, with the fast path and without."""

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import pytest
import pytest_asyncio
from asyncua import Client, ua
from asyncua.ua.ua_binary import struct_from_binary

from tests.publishers_opcua.conftest import PASSWORD, Served, refused
from tests.publishers_opcua.messages import Messages, told
from tests.support.network import eventually

pytestmark = pytest.mark.asyncio(loop_scope="module")

CODES = ua.StatusCodes
POSITION = ua.NodeId("AxisX.Position", 2)
CLOCK = ua.NodeId(ua.ObjectIds.Server_ServerStatus_CurrentTime)


@pytest_asyncio.fixture(loop_scope="module")
async def engineer(rested: Served) -> AsyncIterator[Client]:
    async with rested.client("engineer", PASSWORD) as client:
        yield client


@pytest_asyncio.fixture(loop_scope="module")
async def successor(rested: Served) -> AsyncIterator[Client]:
    async with rested.client("engineer", PASSWORD) as client:
        yield client


async def subscribed(client: Client) -> Messages:
    """A subscription that has nothing to say any more until something changes."""
    messages = await Messages(client).create()
    await messages.monitor(POSITION, CLOCK)
    assert len(await messages.values()) == 2
    return messages


def waiting(served: Served, client: Client, count: int) -> Any:
    """So many Publish requests of this client's session wait."""
    token = client.uaclient.protocol.authentication_token
    sessions = served.server._server.iserver._external_sessions

    def condition() -> bool:
        return len(sessions[token].processor._publish_requests) == count

    return eventually(condition)


def status_of(result: ua.PublishResult) -> int:
    (change,) = result.NotificationMessage.NotificationData
    assert isinstance(change, ua.StatusChangeNotification)
    return int(change.Status.value)


async def failed(request: Any) -> int:
    async with asyncio.timeout(20):
        with pytest.raises(ua.UaStatusCodeError) as error:
            await request
    return refused(error)


async def transfer(client: Client, number: int) -> ua.TransferResult:
    request = ua.TransferSubscriptionsRequest(Parameters=ua.TransferSubscriptionsParameters([number], False))
    response = await client.uaclient._send_request(request)
    (result,) = struct_from_binary(ua.TransferSubscriptionsResponse, response).Parameters.Results
    return result


async def close_session(client: Client, *, delete: bool) -> None:
    await client.uaclient._send_request(ua.CloseSessionRequest(DeleteSubscriptions=delete))


async def test_a_subscription_that_expired_says_so_once(rested: Served, alone: Client) -> None:
    messages = await subscribed(alone)
    held = rested.server._server.iserver.subscription_service.subscriptions

    await messages.modify_subscription(lifetime=3, keep_alive=1)
    await eventually(lambda: messages.number not in held)

    parting = await messages.publish(1)
    assert (messages.number, CODES.BadTimeout) == (parting.SubscriptionId, status_of(parting))
    assert [CODES.BadSubscriptionIdInvalid] == [status.value for status in parting.Results]
    assert CODES.BadNoSubscription == await failed(messages.publish())


async def test_a_subscription_that_expired_leaves_the_others_alone(rested: Served, alone: Client) -> None:
    expiring, lasting = await subscribed(alone), await Messages(alone).create()
    held = rested.server._server.iserver.subscription_service.subscriptions
    await expiring.modify_subscription(lifetime=3, keep_alive=1)
    await eventually(lambda: expiring.number not in held)

    first, second = await lasting.publish(), await lasting.publish()

    assert (expiring.number, CODES.BadTimeout) == (first.SubscriptionId, status_of(first))
    assert second.SubscriptionId == lasting.number


async def test_a_publish_in_time_keeps_a_subscription(rested: Served, alone: Client) -> None:
    messages = await subscribed(alone)
    await messages.modify_subscription(lifetime=3, keep_alive=1)

    found = [await messages.publish() for _ in range(20)]

    assert all(not result.NotificationMessage.NotificationData for result in found)


async def test_the_session_that_had_a_subscription_hears_that_it_was_transferred(
    rested: Served, engineer: Client, successor: Client
) -> None:
    messages = await subscribed(engineer)
    first, second = (asyncio.create_task(messages.publish()) for _ in range(2))
    await waiting(rested, engineer, 2)

    result = await transfer(successor, messages.number)
    rested.exchange.set("AxisX.Position", 2.0)
    await rested.scan()

    assert result.StatusCode.is_good()
    parting = await first
    assert (messages.number, CODES.GoodSubscriptionTransferred) == (parting.SubscriptionId, status_of(parting))
    assert CODES.BadNoSubscription == await failed(second)
    messages.use(successor)
    assert told(await messages.publish()) == [(0, 2.0, 0)]


async def test_the_session_that_had_a_subscription_hears_it_with_its_next_publish(
    rested: Served, engineer: Client, successor: Client
) -> None:
    messages = await subscribed(engineer)

    await transfer(successor, messages.number)

    assert CODES.GoodSubscriptionTransferred == status_of(await messages.publish())
    assert CODES.BadNoSubscription == await failed(messages.publish())


async def test_a_refused_transfer_says_nothing_to_the_owner(rested: Served, engineer: Client, alone: Client) -> None:
    messages = await subscribed(engineer)

    result = await transfer(alone, messages.number)
    rested.exchange.set("AxisX.Position", 2.0)
    await rested.scan()

    assert result.StatusCode.value == CODES.BadUserAccessDenied
    assert told(await messages.publish()) == [(0, 2.0, 0)]


@pytest.mark.parametrize("delete", [False, True])
async def test_requests_of_a_session_that_is_closed_are_told_so(
    rested: Served, engineer: Client, delete: bool
) -> None:
    messages = await subscribed(engineer)
    requests = [asyncio.create_task(messages.publish()) for _ in range(3)]
    await waiting(rested, engineer, 3)

    await close_session(engineer, delete=delete)

    assert [CODES.BadSessionClosed] * 3 == [await failed(request) for request in requests]


async def test_who_takes_over_a_closed_sessions_subscription_misses_nothing(
    rested: Served, engineer: Client, successor: Client
) -> None:
    messages = await subscribed(engineer)
    request = asyncio.create_task(messages.publish())
    await waiting(rested, engineer, 1)
    await close_session(engineer, delete=False)
    for number in (6.0, 7.0):
        rested.exchange.set("AxisX.Position", number)
        await rested.scan()

    result = await transfer(successor, messages.number)

    assert CODES.BadSessionClosed == await failed(request)
    assert result.AvailableSequenceNumbers == [1]  # what the first session got and did not acknowledge
    messages.use(successor)
    assert told(await messages.publish()) == [(0, 6.0, 0), (0, 7.0, 0)]


async def test_another_session_of_the_connection_hears_nothing_of_the_one_that_was_closed(
    rested: Served, engineer: Client, successor: Client
) -> None:
    left = await subscribed(engineer)
    await close_session(engineer, delete=False)
    await engineer.create_session()
    await engineer.activate_session("engineer", PASSWORD)
    own = await subscribed(engineer)

    request = asyncio.create_task(own.publish())
    await waiting(rested, engineer, 1)
    rested.exchange.set("AxisX.Position", 2.0)
    await rested.scan()

    assert (await request).SubscriptionId == own.number
    await transfer(successor, left.number)
    left.use(successor)
    assert told(await left.publish()) == [(0, 2.0, 0)]
