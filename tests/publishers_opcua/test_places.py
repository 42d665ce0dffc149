"""Not enough places for everybody: whoever crowds the server, an operator gets in, and everybody else goes on."""

import asyncio
import contextlib
import resource
import socket
from collections.abc import AsyncIterator, Callable, Iterator
from typing import Any

import pytest
from asyncua import Client, ua
from asyncua.server.internal_session import InternalSession

from softplc.publishers.opcua.hardened.limits import Limits
from tests.publishers_opcua.conftest import PASSWORD, Served, connections, refused, serve

CODES = ua.StatusCodes
POSITION = ua.NodeId("AxisX.Position", 2)
SOCKETS = 1000
CROWDED = Limits(
    connections=8,
    connections_per_address=6,
    sessions=5,
    sessions_per_address=3,
    sessions_reserved=2,
    subscriptions=4,
    subscriptions_per_address=3,
    subscriptions_per_session=2,
    items=20,
    items_per_address=15,
    items_per_session=10,
)


@pytest.fixture
def many_files() -> Iterator[None]:
    """Room for a thousand sockets in this process."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY and hard < 3 * SOCKETS:
        pytest.skip(f"this process may open {hard} files only")
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, 3 * SOCKETS), hard))
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


async def idle_sockets(port: int, count: int) -> list[socket.socket]:
    """Connections that say nothing."""
    loop = asyncio.get_running_loop()
    made = []
    for _ in range(count):
        one = socket.socket()
        one.setblocking(False)
        await loop.sock_connect(one, ("127.0.0.1", port))
        made.append(one)
    return made


async def test_a_thousand_sockets_that_say_nothing_keep_nobody_out(many_files: None) -> None:
    async with serve() as served:
        flood = await idle_sockets(served.port, SOCKETS)
        try:
            await connections(served, Limits().connections_per_address)

            await soon_in(served.client)
            await soon_in(lambda: served.client("engineer", PASSWORD))
        finally:
            for one in flood:
                one.close()


async def test_a_flood_that_comes_back_at_once_keeps_no_operator_out() -> None:
    hello = b"HEL" + b"F" + (32).to_bytes(4, "little") + bytes(24)

    async def again_and_again(port: int) -> None:
        while True:
            with contextlib.suppress(OSError):
                reader, writer = await asyncio.open_connection("127.0.0.1", port)
                try:
                    writer.write(hello)
                    while await reader.read(1000):
                        pass
                finally:
                    writer.transport.abort()

    async with serve() as served, asyncio.TaskGroup() as attackers:
        flood = [attackers.create_task(again_and_again(served.port)) for _ in range(100)]
        await connections(served, Limits().connections_per_address)
        try:
            await soon_in(lambda: served.client("engineer", PASSWORD))
        finally:
            for one in flood:
                one.cancel()


async def soon_in(make: Callable[[], Client]) -> None:
    """A client that tries again when it is turned away gets in and reads."""
    async with asyncio.timeout(60):
        while True:
            with contextlib.suppress(ua.UaError, OSError, TimeoutError):
                async with make() as client:
                    assert await client.get_namespace_array()
                    return


@contextlib.asynccontextmanager
async def crowd(served: Served, count: int) -> AsyncIterator[list[Client]]:
    """So many anonymous clients at one address."""
    async with contextlib.AsyncExitStack() as stack:
        yield [await stack.enter_async_context(served.client()) for _ in range(count)]


async def test_anonymous_sessions_leave_room_for_who_logs_in() -> None:
    async with serve(CROWDED) as served, crowd(served, CROWDED.sessions_per_address) as anonymous:
        counted = InternalSession._current_connections
        with pytest.raises(ua.UaStatusCodeError) as error:
            await served.client().connect()
        assert CODES.BadTooManySessions == refused(error)
        assert counted == InternalSession._current_connections  # at 1000, asyncua lets nobody in any more

        async with served.client("engineer", PASSWORD) as one, served.client("engineer", PASSWORD) as two:
            assert await one.get_namespace_array() == await two.get_namespace_array()
            with pytest.raises((ua.UaError, OSError)):
                await served.client("engineer", PASSWORD).connect()
        for client in anonymous:
            assert await client.get_namespace_array()


async def test_a_user_who_becomes_anonymous_needs_an_anonymous_place() -> None:
    async with (
        serve(CROWDED) as served,
        crowd(served, CROWDED.sessions_per_address),
        served.client("engineer", PASSWORD) as user,
    ):
        with pytest.raises(ua.UaStatusCodeError) as error:
            await user.activate_session()
        assert CODES.BadTooManySessions == refused(error)

        assert await user.get_namespace_array()


async def subscribed(client: Client, items: int = 0) -> Any:
    subscription = await client.create_subscription(50, None)
    if items:
        await subscription.subscribe_data_change([client.get_node(POSITION)] * items)
    return subscription


async def test_one_address_cannot_take_all_subscriptions_and_a_user_has_his_own() -> None:
    async with serve(CROWDED) as served, crowd(served, 2) as (first, second):
        for client in (first, first, second):
            await subscribed(client)
        with pytest.raises(ua.UaStatusCodeError) as error:
            await subscribed(second)
        assert CODES.BadTooManySubscriptions == refused(error)

        async with served.client("engineer", PASSWORD) as user:
            await subscribed(user, items=5)
            await subscribed(user, items=5)


async def test_one_address_cannot_take_all_monitored_items_and_a_user_has_his_own() -> None:
    async with serve(CROWDED) as served, crowd(served, 2) as (first, second):
        await subscribed(first, items=10)
        await subscribed(second, items=5)
        with pytest.raises(ua.UaStatusCodeError) as error:
            await subscribed(second, items=1)
        assert CODES.BadTooManyMonitoredItems == refused(error)

        async with served.client("engineer", PASSWORD) as user:
            await subscribed(user, items=10)


async def close_keeping_subscriptions(client: Client) -> None:
    request = ua.CloseSessionRequest(DeleteSubscriptions=False)
    await client.uaclient._send_request(request)
    client.uaclient.protocol.transport.abort()
    with contextlib.suppress(Exception):
        await client.disconnect()


async def test_subscriptions_that_nobody_can_take_over_end_with_their_session() -> None:
    async with serve(CROWDED) as served:
        held = served.server._server.iserver.subscription_service.subscriptions
        for _ in range(CROWDED.subscriptions + 2):
            client = served.client()
            await client.connect()
            await subscribed(client)
            await close_keeping_subscriptions(client)

        assert not held


async def transfer(client: Client, number: int) -> int:
    request = ua.TransferSubscriptionsRequest(Parameters=ua.TransferSubscriptionsParameters([number], True))
    response = await client.uaclient._send_request(request)
    (result,) = ua.ua_binary.struct_from_binary(ua.TransferSubscriptionsResponse, response).Parameters.Results
    return int(result.StatusCode.value)


async def test_a_user_takes_his_subscriptions_over_into_a_new_session_and_nobody_else_does() -> None:
    async with serve() as served:
        old = served.client("engineer", PASSWORD)
        await old.connect()
        number = (await subscribed(old, items=1)).subscription_id
        await close_keeping_subscriptions(old)

        async with served.client() as stranger, served.client("engineer", PASSWORD) as new:
            assert CODES.BadUserAccessDenied == await transfer(stranger, number)
            assert CODES.BadSubscriptionIdInvalid == await transfer(stranger, 1)
            assert CODES.Good == await transfer(new, number)

            own = await subscribed(new)  # whose client now asks for notifications
            heard = asyncio.Event()

            async def take(_: Any) -> None:
                heard.set()

            new.uaclient._subscription_callbacks[number] = take
            served.exchange.set("AxisX.Position", 77.0)
            await served.scan()
            async with asyncio.timeout(20):
                await heard.wait()
            assert own.subscription_id != number
