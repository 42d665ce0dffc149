"""Broken chunks on signed and encrypted channels."""

import asyncio
import random
import struct
from collections.abc import AsyncIterator
from dataclasses import replace

import pytest
import pytest_asyncio
from asyncua import Client, ua
from asyncua.common.connection import MessageChunk
from asyncua.ua.ua_binary import struct_to_binary

from tests.fuzz.opcua import Neighbour
from tests.fuzz.opcua_messages import frames
from tests.publishers_opcua.certificates import HMI, Application, Secured, serve_secured
from tests.support.network import eventually
from tests.support.relay import Relay

pytestmark = pytest.mark.asyncio(loop_scope="module")

OTHER = Application("other", pair="other")


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def server(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Secured]:
    async with serve_secured(tmp_path_factory.mktemp("secured")) as server:
        server.trust(HMI, OTHER)
        yield server


def sealed(client: Client, body: bytes, kind: ua.ChunkType = ua.ChunkType.Single, skip: int = 0) -> bytes:
    """A chunk of this body, signed and encrypted as the client would."""
    connection = client.uaclient.protocol._connection
    chunk = MessageChunk(connection.security_policy.symmetric_cryptography, body, chunk_type=kind)
    connection._sequence_number += 1 + skip
    chunk.SecurityHeader.TokenId = connection.security_token.TokenId
    chunk.MessageHeader.ChannelId = connection.security_token.ChannelId
    chunk.SequenceHeader.SequenceNumber, chunk.SequenceHeader.RequestId = connection._sequence_number, 7
    return chunk.to_binary()


def damaged(frame: bytes, place: int) -> bytes:
    return frame[:place] + bytes([frame[place] ^ 1]) + frame[place + 1 :]


def endless(client: Client) -> bytes:
    return b"".join(sealed(client, bytes(60_000), ua.ChunkType.Intermediate) for _ in range(20))


READ = struct_to_binary(ua.ReadRequest())
BROKEN = {
    "a bit of the cipher text": lambda client: damaged(sealed(client, READ), 40),
    "a bit of the signature": lambda client: damaged(sealed(client, READ), -1),
    "a bit of the header that is signed": lambda client: damaged(sealed(client, READ), 12),
    "no whole block": lambda client: b"MSGF" + struct.pack("<I", 45) + sealed(client, READ)[8:45],
    "nothing but the header": lambda client: b"MSGF" + struct.pack("<I", 16) + sealed(client, READ)[8:16],
    "in clear": lambda client: b"MSGF" + struct.pack("<I", 24 + len(READ)) + sealed(client, READ)[8:24] + READ,
    "a sequence number left out": lambda client: sealed(client, READ, skip=1),
    "a chunk again": lambda client: sealed(client, READ, ua.ChunkType.Intermediate) * 2,
    "longer than any chunk": lambda client: b"MSGF" + struct.pack("<I", 1 << 20) + bytes(1000),
    "more than a message may have": endless,
    "opened anew in clear": lambda _: b"OPNF" + struct.pack("<II", 40, 0) + bytes(28),
}


@pytest.mark.parametrize("what", BROKEN)
@pytest.mark.parametrize("mode", ["Sign", "SignAndEncrypt"])
async def test_a_broken_chunk_ends_its_channel_and_no_other(server: Secured, mode: str, what: str) -> None:
    neighbour = Neighbour()
    async with server.client(OTHER) as other:
        subscription = await other.create_subscription(20, neighbour)
        await subscription.subscribe_data_change(other.get_node("ns=2;s=AxisX.K0"), queuesize=100)
        attacker = server.client(mode=mode)
        await attacker.connect()
        gone = asyncio.get_running_loop().create_future()
        attacker.uaclient.protocol.connection_lost = lambda _: gone.set_result(None)

        attacker.uaclient.protocol.transport.write(BROKEN[what](attacker))
        async with asyncio.timeout(20):
            await gone

        attacker.disconnect_socket()
        for number in range(5):
            server.served.exchange.set("AxisX.K0", float(number))
            await server.served.scan()
            await eventually(lambda number=number: neighbour.beats[-1:] == [number], what=f"{number} notified")
        assert await other.get_namespace_array()


MUTANTS = 150


async def recorded_opening(server: Secured) -> tuple[bytes, bytes]:
    """Hello and OpenSecureChannel as a trusted client sends them."""
    async with Relay(server.served.port) as relay:
        client = Secured(replace(server.served, url=f"opc.tcp://127.0.0.1:{relay.port}"), server.folder).client()
        await client.connect_socket()
        await client.send_hello()
        await client.open_secure_channel()
        client.disconnect_socket()
    hello, opening, *_ = frames(bytes(relay.streams[0]))
    return hello, opening


def mutant(frame: bytes, chance: random.Random) -> bytes:
    """The frame with bytes changed, cut out or doubled; its size is told as it is."""
    body = bytearray(frame[8:])
    for _ in range(chance.choice((1, 1, 1, 4, 16))):
        place = chance.randrange(len(body) if chance.random() < 0.5 else 120)  # headers and names are at the start
        what = chance.randrange(4)
        if what == 0:
            body[place] = chance.randrange(256)
        elif what == 1:
            body[place : place + 4] = chance.choice((b"\xff" * 4, bytes(4), b"\xff\xff\xff\x7f", b"\x00\x00\x01\x00"))
        elif what == 2:
            del body[place : place + chance.randrange(1, 64)]
        else:
            body[place:place] = body[place : place + chance.randrange(1, 64)]
    return frame[:4] + struct.pack("<I", 8 + len(body)) + bytes(body)


async def test_broken_openings_open_nothing_and_disturb_nobody(server: Secured) -> None:
    hello, opening = await recorded_opening(server)
    chance = random.Random(20260801)
    codes = set()
    async with server.client(OTHER) as other:
        for _ in range(MUTANTS):
            reader, writer = await asyncio.open_connection("127.0.0.1", server.served.port)
            broken = mutant(opening, chance)
            writer.write(hello + broken)
            async with asyncio.timeout(20):
                answers = list(frames(await reader.read())) if broken != opening else []
            writer.close()
            assert [answer[:3] for answer in answers] in ([b"ACK", b"ERR"], [])
            codes.update(int.from_bytes(answer[8:12], "little") for answer in answers[1:])
        assert await other.get_namespace_array()

    known = ua.StatusCodes
    assert known.BadSecurityChecksFailed in codes
    assert known.BadCertificateInvalid in codes
