"""What a hostile or broken client tries, and that the server and its other clients do not notice."""

import asyncio
import contextlib
import logging
import random
import struct
from collections.abc import AsyncIterator
from typing import Any

import pytest
import pytest_asyncio
from asyncua import Client, ua
from asyncua.ua.ua_binary import struct_to_binary, uatcp_to_binary

from softplc.publishers.opcua.hardened.channel import frame_size
from softplc.publishers.opcua.hardened.limits import Limits
from tests.publishers_opcua.conftest import PASSWORD, Served, serve
from tests.support.network import eventually

pytestmark = pytest.mark.asyncio(loop_scope="module")

CODES = ua.StatusCodes
POSITION = ua.NodeId("AxisX.Position", 2)
LIMITS = Limits(
    connections=12,
    connections_per_address=8,
    sessions_per_address=5,
    subscriptions_per_session=3,
    items_per_session=20,
    operations=30,
    unread_bytes=1 << 16,
    activation_seconds=0.5,
)
HELLO = uatcp_to_binary(ua.MessageType.Hello, ua.Hello(0, 65535, 65535, 0, 0, "opc.tcp://127.0.0.1:4840"))


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def limited() -> AsyncIterator[Served]:
    async with serve(LIMITS) as served:
        yield served


@pytest_asyncio.fixture(loop_scope="module")
async def quiet(limited: Served) -> Served:
    """No connection and no session is left of the test before."""
    inner = limited.server._server.iserver
    for session in list(inner._external_sessions.values()):
        await session.close_session()
    await eventually(lambda: not limited.server._listener.clients, what="connections of the test before")
    return limited


def refused(error: Any) -> int:
    return int(error.value.code)


async def connections(served: Served, count: int) -> None:
    await eventually(lambda: len(served.server._listener.clients) == count)


async def closed(reader: asyncio.StreamReader) -> bytes:
    """Everything that still comes until the server closes the connection."""
    async with asyncio.timeout(20):
        try:
            return await reader.read(-1)
        except ConnectionError:
            return b""


@pytest.mark.parametrize(
    ("head", "expected"),
    [
        (b"HELF" + struct.pack("<I", 40), 40),
        (b"MSGC" + struct.pack("<I", 65535), 65535),
        (b"MSGA" + struct.pack("<I", 13), 13),
        (b"CLOF" + struct.pack("<I", 13), 13),
        (b"MSGF" + struct.pack("<I", 65536), None),
        (b"MSGF" + struct.pack("<I", 0x80000000), None),
        (b"MSGF" + struct.pack("<I", 12), None),
        (b"HELF" + struct.pack("<I", 8), None),
        (b"HELF" + struct.pack("<I", 0), None),
        (b"MSGX" + struct.pack("<I", 40), None),
        (b"ACKF" + struct.pack("<I", 40), None),
        (b"GET / HT", None),
    ],
)
async def test_a_frame_header_is_judged_before_anything_is_kept(head: bytes, expected: int | None) -> None:
    assert expected == frame_size(head, 65535)


async def test_a_header_that_declares_too_much_ends_the_connection(quiet: Served) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", quiet.port)
    writer.write(HELLO + b"MSGF" + struct.pack("<I", 0x80000000) + bytes(100_000))

    answer = await closed(reader)

    assert b"ERRF" in answer
    writer.close()


async def test_a_request_of_endless_chunks_ends_the_connection(quiet: Served) -> None:
    client = quiet.client()
    await client.connect_sessionless()
    transport = client.uaclient.protocol.transport
    connection = client.uaclient.protocol._connection
    closed_by_server = asyncio.get_running_loop().create_future()
    client.uaclient.protocol.connection_lost = lambda _: closed_by_server.set_result(None)
    channel, token = connection.security_token.ChannelId, connection.security_token.TokenId
    for number in range(100):
        sequence = connection._sequence_number + 1 + number
        body = struct.pack("<IIII", channel, token, sequence, 99) + bytes(60_000)
        if transport.is_closing():
            break
        transport.write(b"MSGC" + struct.pack("<I", 8 + len(body)) + body)

    async with asyncio.timeout(20):
        await closed_by_server
    await connections(quiet, 0)


@pytest.mark.parametrize(
    "frame",
    [
        b"MSGF" + struct.pack("<I", 40) + bytes(32),
        b"OPNF" + struct.pack("<I", 40) + b"\xff" * 32,
        b"CLOF" + struct.pack("<I", 24) + b"\xff" * 16,
        b"MSGF" + struct.pack("<III", 24, 7, 9) + bytes(12),
    ],
)
async def test_a_frame_that_breaks_the_protocol_ends_the_connection(quiet: Served, frame: bytes) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", quiet.port)
    writer.write(HELLO + frame)

    await closed(reader)

    writer.close()
    await connections(quiet, 0)


async def test_services_before_a_channel_is_open_are_refused(quiet: Served) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", quiet.port)
    request = struct_to_binary(ua.CreateSessionRequest())
    body = struct.pack("<IIII", 0, 0, 1, 1) + request
    writer.write(HELLO + b"MSGF" + struct.pack("<I", 8 + len(body)) + body)

    async with asyncio.timeout(20):
        answer = await reader.readuntil(struct.pack("<I", CODES.BadSecureChannelIdInvalid))

    assert b"MSGF" in answer
    assert not quiet.server._server.iserver._external_sessions
    writer.close()
    await connections(quiet, 0)


async def test_a_connection_that_activates_no_session_is_closed(quiet: Served) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", quiet.port)
    writer.write(HELLO)

    assert (await closed(reader))[:4] == b"ACKF"
    writer.close()


async def test_one_address_cannot_take_all_connections(quiet: Served) -> None:
    pairs = [
        await asyncio.open_connection("127.0.0.1", quiet.port) for _ in range(LIMITS.connections_per_address + 2)
    ]
    refused_ones = [reader for reader, _ in pairs[LIMITS.connections_per_address :]]
    for reader in refused_ones:
        assert await closed(reader) == b""

    _, writer = await asyncio.open_connection("127.0.0.1", quiet.port, local_addr=("127.0.0.2", 0))
    await connections(quiet, LIMITS.connections_per_address + 1)

    for _, open_writer in pairs:
        open_writer.close()
    writer.close()


async def test_one_connection_has_one_session(quiet: Served) -> None:
    async with quiet.client() as client:
        with pytest.raises(ua.UaStatusCodeError) as error:
            await client.create_session()

        assert CODES.BadTooManySessions == refused(error)
        assert len(quiet.server._server.iserver._external_sessions) == 1


async def test_a_lost_session_gives_way_to_a_new_client_and_a_living_one_does_not(quiet: Served) -> None:
    sessions = quiet.server._server.iserver._external_sessions
    async with contextlib.AsyncExitStack() as stack:
        for _ in range(LIMITS.sessions_per_address):
            await stack.enter_async_context(quiet.client())
        with pytest.raises(ua.UaStatusCodeError) as error:
            await quiet.client().connect()
        assert CODES.BadTooManySessions == refused(error)
        next(iter(sessions.values())).processor = None  # as after a cut line with a subscription

        async with quiet.client() as newcomer:
            assert await newcomer.get_namespace_array()
            assert LIMITS.sessions_per_address == len(sessions)


async def test_session_tokens_are_256_random_bits(quiet: Served) -> None:
    tokens = set()
    for _ in range(3):
        async with quiet.client() as client:
            token = client.uaclient.protocol.authentication_token
            assert (ua.NodeIdType.ByteString, 32) == (token.NodeIdType, len(token.Identifier))
            tokens.add(token.Identifier)

    assert len(tokens) == 3


async def test_a_session_answers_only_to_its_own_token(quiet: Served) -> None:
    async with quiet.client() as client:
        own = client.uaclient.protocol.authentication_token
        client.uaclient.protocol.authentication_token = ua.NodeId(bytes(32), 0, ua.NodeIdType.ByteString)
        with pytest.raises(ua.UaStatusCodeError) as error:
            await client.get_namespace_array()
        client.uaclient.protocol.authentication_token = own

        assert CODES.BadSessionIdInvalid == refused(error)
        assert await client.get_namespace_array()


async def test_a_guessed_token_takes_over_no_session(quiet: Served) -> None:
    async with quiet.client() as victim:
        thief = quiet.client()
        await thief.connect_sessionless()
        for guess in (ua.NodeId(1001), ua.NodeId(bytes(32), 0, ua.NodeIdType.ByteString), ua.NodeId()):
            thief.uaclient.protocol.authentication_token = guess
            with pytest.raises(ua.UaStatusCodeError) as error:
                await thief.uaclient.activate_session(ua.ActivateSessionParameters())
            assert CODES.BadSessionIdInvalid == refused(error)
        await thief.disconnect_sessionless()

        assert await victim.get_namespace_array()


async def test_a_session_moves_to_a_new_connection_and_leaves_the_old_one(quiet: Served) -> None:
    old, new = quiet.client(), quiet.client()
    await old.connect()
    await new.connect_sessionless()
    new.uaclient.protocol.authentication_token = old.uaclient.protocol.authentication_token

    await new.activate_session()

    assert await new.get_namespace_array()
    with pytest.raises(ua.UaStatusCodeError) as error:
        await old.get_namespace_array()
    assert CODES.BadSessionIdInvalid == refused(error)
    old.uaclient.protocol.transport.abort()
    with contextlib.suppress(Exception):
        await old.disconnect()
    await connections(quiet, 1)
    assert await new.get_namespace_array()  # the old connection did not take the session with it
    await new.disconnect()


async def test_a_wrong_password_on_a_new_connection_leaves_nothing_behind(quiet: Served) -> None:
    async with quiet.client() as owner:
        other = quiet.client()
        await other.connect_sessionless()
        other.uaclient.protocol.authentication_token = owner.uaclient.protocol.authentication_token
        with pytest.raises(ua.UaStatusCodeError) as error:
            await other.activate_session(username="engineer", password="wrong")
        assert CODES.BadIdentityTokenRejected == refused(error)
        with pytest.raises(ua.UaStatusCodeError):
            await other.get_namespace_array()
        await other.disconnect_sessionless()

        assert await owner.get_namespace_array()


async def subscribed(client: Client, count: int = 1) -> Any:
    subscription = await client.create_subscription(20, None)
    await subscription.subscribe_data_change([client.get_node(POSITION)] * count)
    return subscription


async def republish(client: Client, subscription_id: int, sequence_number: int) -> int:
    parameters = ua.RepublishParameters(subscription_id, sequence_number)
    with pytest.raises(ua.UaStatusCodeError) as error:
        await client.uaclient._send_request(ua.RepublishRequest(Parameters=parameters))
    return refused(error)


async def test_republish_says_what_is_not_there(quiet: Served) -> None:
    async with quiet.client() as client:
        subscription = await subscribed(client)

        assert CODES.BadSubscriptionIdInvalid == await republish(client, 1, 1)
        assert CODES.BadMessageNotAvailable == await republish(client, subscription.subscription_id, 4711)


async def test_a_session_cannot_touch_anothers_subscription(quiet: Served) -> None:
    async with quiet.client() as owner, quiet.client() as stranger:
        subscription = await subscribed(owner)
        number = subscription.subscription_id
        service = stranger.uaclient

        (deleted,) = await service.delete_subscriptions([number])
        (moded,) = await service.set_publishing_mode(ua.SetPublishingModeParameters(False, [number]))
        transferred = await service._send_request(
            ua.TransferSubscriptionsRequest(Parameters=ua.TransferSubscriptionsParameters([number], True))
        )
        assert CODES.BadSubscriptionIdInvalid == deleted.value == moded.value
        assert transferred is not None
        for request in (
            service.modify_subscription(ua.ModifySubscriptionParameters(number, 10)),
            service.create_monitored_items(
                ua.CreateMonitoredItemsParameters(number, ItemsToCreate=[ua.MonitoredItemCreateRequest()])
            ),
            service.delete_monitored_items(ua.DeleteMonitoredItemsParameters(number, [112])),
            service.modify_monitored_items(ua.ModifyMonitoredItemsParameters(number)),
        ):
            with pytest.raises(ua.UaStatusCodeError) as error:
                await request
            assert CODES.BadSubscriptionIdInvalid == refused(error)
        assert CODES.BadSubscriptionIdInvalid == await republish(stranger, number, 1)

        subscriptions = quiet.server._server.iserver.subscription_service.subscriptions
        assert (subscriptions[number]._publishing_enabled, len(subscriptions[number].monitored_item_srv)) == (True, 1)


async def test_subscriptions_and_items_of_one_session_are_limited(quiet: Served) -> None:
    async with quiet.client() as client:
        with pytest.raises(ua.UaStatusCodeError) as items:
            await subscribed(client, LIMITS.items_per_session + 1)
        for _ in range(LIMITS.subscriptions_per_session - 1):
            await client.create_subscription(20, None)
        with pytest.raises(ua.UaStatusCodeError) as subscriptions:
            await client.create_subscription(20, None)

        assert (CODES.BadTooManyMonitoredItems, CODES.BadTooManySubscriptions) == (
            refused(items),
            refused(subscriptions),
        )
        async with quiet.client() as other:
            await subscribed(other)


async def test_a_request_for_too_many_nodes_is_refused_and_the_limit_is_told(quiet: Served) -> None:
    async with quiet.client() as client:
        told = ua.ObjectIds.Server_ServerCapabilities_OperationLimits_MaxNodesPerRead
        assert LIMITS.operations == await client.get_node(told).read_value()
        for count, expected in ((LIMITS.operations + 1, CODES.BadTooManyOperations), (0, CODES.BadNothingToDo)):
            with pytest.raises(ua.UaStatusCodeError) as error:
                await client.uaclient.read_attributes([POSITION] * count, ua.AttributeIds.Value)
            assert expected == refused(error)


async def test_a_modified_item_that_does_not_exist_is_told(quiet: Served) -> None:
    async with quiet.client() as client:
        subscription = await subscribed(client)
        request = ua.ModifyMonitoredItemsParameters(subscription.subscription_id)
        request.ItemsToModify = [ua.MonitoredItemModifyRequest(MonitoredItemId=4711)]

        (result,) = await client.uaclient.modify_monitored_items(request)

        assert CODES.BadMonitoredItemIdInvalid == result.StatusCode.value


@pytest.mark.parametrize("interval", [0.0, -5.0, float("nan"), float("inf"), 1e-300])
async def test_an_absurd_publishing_interval_is_revised(quiet: Served, interval: float) -> None:
    async with quiet.client() as client:
        parameters = ua.CreateSubscriptionParameters(interval, 0, 0, 0, True, 0)

        result = await client.uaclient.create_subscription(parameters, lambda _: None)

        assert LIMITS.min_publishing_ms <= result.RevisedPublishingInterval <= LIMITS.max_publishing_ms
        assert result.RevisedLifetimeCount >= 3 * result.RevisedMaxKeepAliveCount


async def test_a_client_that_does_not_read_is_dropped_and_the_others_go_on(quiet: Served) -> None:
    async with quiet.client() as other:
        lazy = quiet.client()
        await lazy.connect()
        lazy.uaclient.protocol.transport.pause_reading()
        browse = ua.BrowseParameters(NodesToBrowse=[ua.BrowseDescription(ua.NodeId(2253))] * LIMITS.operations)
        request = ua.BrowseRequest(Parameters=browse)
        asking = [asyncio.ensure_future(lazy.uaclient._send_request(request, timeout=60)) for _ in range(400)]
        await connections(quiet, 1)  # answers of some 50 MB, more than the system buffers for a socket

        assert await other.get_namespace_array()
        lazy.uaclient.protocol.transport.abort()
        await asyncio.gather(*asking, return_exceptions=True)
        with contextlib.suppress(Exception):
            await lazy.disconnect()


def requests(token: Any) -> list[bytes]:
    """One request of many services, as the session with this token sends them."""
    subscription, item = 78, ua.MonitoredItemCreateRequest(ua.ReadValueId(POSITION, 13))
    filtered = ua.MonitoredItemCreateRequest(
        ua.ReadValueId(POSITION, 13),
        RequestedParameters=ua.MonitoringParameters(1, 0.0, ua.DataChangeFilter(), 1, True),
    )
    made = [
        ua.ReadRequest(Parameters=ua.ReadParameters(NodesToRead=[ua.ReadValueId(POSITION, 13)])),
        ua.WriteRequest(Parameters=ua.WriteParameters([ua.WriteValue(POSITION, 13, None, ua.DataValue(1.0))])),
        ua.BrowseRequest(Parameters=ua.BrowseParameters(NodesToBrowse=[ua.BrowseDescription(ua.NodeId(85))])),
        ua.CreateSubscriptionRequest(Parameters=ua.CreateSubscriptionParameters(100, 10, 10, 0, True, 0)),
        ua.CreateMonitoredItemsRequest(
            Parameters=ua.CreateMonitoredItemsParameters(subscription, ItemsToCreate=[item, filtered])
        ),
        ua.CallRequest(Parameters=ua.CallParameters([ua.CallMethodRequest()])),
        ua.PublishRequest(Parameters=ua.PublishParameters([ua.SubscriptionAcknowledgement(subscription, 1)])),
        ua.ActivateSessionRequest(Parameters=ua.ActivateSessionParameters()),
    ]
    for request in made:
        request.RequestHeader.AuthenticationToken = token
    return [struct_to_binary(request) for request in made]


async def test_mutated_requests_leave_no_trace_in_the_log_and_no_client_suffers(
    quiet: Served, caplog: pytest.LogCaptureFixture
) -> None:
    generator = random.Random(4840)
    sent = 0
    caplog.set_level(logging.INFO)
    async with quiet.client() as other:
        for _ in range(60):
            attacker = quiet.client("engineer", PASSWORD)
            await attacker.connect()
            protocol = attacker.uaclient.protocol
            transport = protocol.transport
            transport.set_protocol(asyncio.Protocol())  # asyncua's client would end the connection over odd answers
            originals = requests(protocol.authentication_token)
            for _ in range(40):
                body = bytearray(generator.choice(originals))
                first = generator.choice((0, 80, 80, 80, 80, 80, 80, 80))  # mostly behind the request's header
                for _ in range(generator.randint(1, 4)):
                    body[generator.randrange(min(first, len(body) - 1), len(body))] = generator.randrange(256)
                protocol._request_id += 1
                frame = protocol._connection.message_to_binary(bytes(body), request_id=protocol._request_id)
                transport.write(frame)
                await asyncio.sleep(0)
                sent += 1
                if transport.is_closing():
                    break
            assert await other.get_namespace_array()
            transport.abort()
            protocol.connection_lost(None)
            with contextlib.suppress(Exception):
                await attacker.disconnect()

        assert sent > 1000
        assert [record for record in caplog.records if "server" in record.name or record.name == "asyncio"] == []
        assert quiet.exchange.writer.commands() == []
        assert await other.get_node(POSITION).read_value() is not None
