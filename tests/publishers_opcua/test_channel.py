"""Sockets and frames: what a hostile or broken client sends, and that the server and the others do not notice."""

import asyncio
import contextlib
import logging
import random
import socket
import struct
from typing import Any

import pytest
from asyncua import ua
from asyncua.ua.ua_binary import struct_to_binary, uatcp_to_binary

from softplc.publishers.opcua.hardened.frames import frame_size
from tests.publishers_opcua.conftest import LIMITS, PASSWORD, Served, connections

pytestmark = pytest.mark.asyncio(loop_scope="module")

CODES = ua.StatusCodes
POSITION = ua.NodeId("AxisX.Position", 2)
HELLO = uatcp_to_binary(ua.MessageType.Hello, ua.Hello(0, 65535, 65535, 0, 0, "opc.tcp://127.0.0.1:4840"))


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


@pytest.mark.parametrize("sizes", [(0, 65535), (34, 65535), (65535, 0), (8191, 8191)])
async def test_a_hello_that_wants_its_answers_in_crumbs_ends_the_connection(
    quiet: Served, sizes: tuple[int, int]
) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", quiet.port)
    writer.write(uatcp_to_binary(ua.MessageType.Hello, ua.Hello(0, *sizes, 0, 0, "opc.tcp://127.0.0.1:4840")))

    answer = await closed(reader)

    assert answer[:3] == b"ERR"
    assert struct.pack("<I", CODES.BadConnectionRejected) in answer
    writer.close()


@pytest.mark.parametrize(("length", "kind"), [(4096, b"ACK"), (4097, b"ERR"), (60_000, b"ERR")])
async def test_a_hello_with_an_endless_url_ends_the_connection(quiet: Served, length: int, kind: bytes) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", quiet.port)
    hello = ua.Hello(0, 65535, 65535, 0, 0, "opc.tcp://127.0.0.1:4840/".ljust(length, "x"))
    writer.write(uatcp_to_binary(ua.MessageType.Hello, hello))

    async with asyncio.timeout(20):
        head = await reader.readexactly(8)
        body = await reader.readexactly(int.from_bytes(head[4:], "little") - len(head))

    assert head[:3] == kind
    if kind == b"ERR":
        assert struct.pack("<I", CODES.BadTcpEndpointUrlInvalid) == body[:4]
        assert not await closed(reader)
    writer.close()


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
    await connections(quiet, LIMITS.connections_per_address)

    _, writer = await asyncio.open_connection("127.0.0.1", quiet.port, local_addr=("127.0.0.2", 0))
    await connections(quiet, LIMITS.connections_per_address + 1)

    for _, open_writer in pairs:
        open_writer.close()
    writer.close()


async def test_a_client_that_does_not_read_is_dropped_and_the_others_go_on(quiet: Served) -> None:
    async with quiet.client() as other:
        lazy = quiet.client()
        await lazy.connect()
        transport = lazy.uaclient.protocol.transport
        transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        transport.pause_reading()
        browse = ua.BrowseParameters(NodesToBrowse=[ua.BrowseDescription(ua.NodeId(2253))] * LIMITS.operations)
        request = ua.BrowseRequest(Parameters=browse)
        asking = [asyncio.ensure_future(lazy.uaclient.protocol.send_request(request, 60)) for _ in range(1500)]
        await connections(quiet, 1)  # answers of some 20 MB, more than the system buffers for a socket

        assert await other.get_namespace_array()
        transport.abort()
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


async def test_an_array_that_is_longer_than_its_message_costs_nobody_anything(quiet: Served) -> None:
    value = ua.DataValue(ua.Variant([True], ua.VariantType.Boolean, is_array=True))
    request = ua.WriteRequest(Parameters=ua.WriteParameters([ua.WriteValue(POSITION, 13, None, value)]))
    async with quiet.client() as other:
        attacker = quiet.client()
        await attacker.connect()
        protocol = attacker.uaclient.protocol
        request.RequestHeader.AuthenticationToken = protocol.authentication_token
        body = struct_to_binary(request)
        one_boolean, nulls = struct.pack("<Bi?", 0x81, 1, True), struct.pack("<Bi", 0x80, 400_000_000)
        assert body.count(one_boolean) == 1
        protocol._request_id += 1
        frame = protocol._connection.message_to_binary(
            body.replace(one_boolean, nulls), request_id=protocol._request_id
        )
        protocol.transport.write(frame)

        async with asyncio.timeout(20):  # making them takes minutes
            assert await other.get_namespace_array()
        with contextlib.suppress(Exception):
            await attacker.disconnect()


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
