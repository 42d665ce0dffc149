"""Chunks of a channel without security: the same bytes out as asyncua's, and only what is in order is taken in."""

import asyncio
import struct

import pytest
from asyncua import ua
from asyncua.client.ua_client import UASocketProtocol
from asyncua.common.connection import SecureConnection, TransportLimits
from asyncua.crypto.security_policies import SecurityPolicyNone
from hypothesis import given
from hypothesis import strategies as st

from softplc.drivers.opcua.fast.seam import MORE, take_answer, to_chunks
from softplc.drivers.opcua.transport import _BoundedProtocol

LARGEST = 8192


def make_connection(sequence: int) -> SecureConnection:
    connection = SecureConnection(SecurityPolicyNone(), TransportLimits(LARGEST, LARGEST, 0, 0))
    connection.security_token = ua.ChannelSecurityToken(ChannelId=7, TokenId=13)
    connection._sequence_number = sequence
    return connection


@given(st.integers(1, 40_000), st.sampled_from([0, 5, 2**32 - 3, 2**32 - 2, 2**32 - 1]), st.integers(1, 2**32 - 1))
def test_requests_are_cut_into_the_chunks_that_asyncua_makes(size: int, sequence: int, number: int):
    body = bytes(number % 251 for number in range(size))
    ours, theirs = make_connection(sequence), make_connection(sequence)

    assert to_chunks(ours, memoryview(body), number) == theirs.message_to_binary(body, request_id=number)
    assert ours._sequence_number == theirs._sequence_number


def chunk(kind: bytes = b"MSGF", channel: int = 7, token: int = 13, sequence: int = 5, number: int = 3) -> bytes:
    body = b"the body"
    return struct.pack("<4sIIIII", kind, 24 + len(body), channel, token, sequence, number) + body


def make_protocol() -> UASocketProtocol:
    protocol = UASocketProtocol(1.0, SecurityPolicyNone())
    protocol._connection = make_connection(0)
    protocol._connection._peer_sequence_number = 4
    protocol._callbackmap[3] = asyncio.get_running_loop().create_future()
    return protocol


async def test_a_whole_answer_in_order_is_taken_as_asyncua_takes_it():
    ours, theirs = make_protocol(), make_protocol()
    waiting = [protocol._callbackmap[3] for protocol in (ours, theirs)]
    assert take_answer(ours, chunk()) == len(chunk())
    theirs.data_received(chunk())

    assert [bytes(answer.result()) for answer in waiting] == [b"the body"] * 2
    assert ours._connection._peer_sequence_number == theirs._connection._peer_sequence_number == 5
    assert ours._callbackmap == theirs._callbackmap == {}


@pytest.mark.parametrize(
    "data",
    [
        chunk(b"OPNF"),
        chunk(b"MSGA"),
        chunk(b"MSGC") + chunk(b"MSGA", sequence=6),
        chunk(b"MSGC") + chunk(b"MSGF", sequence=7),
        chunk(b"MSGC") + chunk(b"MSGF", sequence=6, number=4),
        chunk(b"MSGC") + chunk(b"MSGF", sequence=6, token=14),
        chunk(b"MSGC")[:4] + struct.pack("<I", 23) + chunk(b"MSGC")[8:],
        chunk(b"MSGC")[:4] + struct.pack("<I", LARGEST + 1) + chunk(b"MSGC")[8:],
        chunk(channel=8),
        chunk(token=14),
        chunk(sequence=4),
        chunk(sequence=6),
        chunk(number=4),
        chunk()[:20],
        b"",
    ],
)
async def test_anything_else_is_left_to_asyncua_untouched(data: bytes):
    protocol = make_protocol()
    assert not take_answer(protocol, data)
    assert (protocol._connection._peer_sequence_number, list(protocol._callbackmap)) == (4, [3])


def sequence_of(count: int, number: int = 3, first: int = 5) -> bytes:
    kinds = [b"MSGC"] * (count - 1) + [b"MSGF"]
    return b"".join(chunk(kind, sequence=first + at, number=number) for at, kind in enumerate(kinds))


@given(count=st.integers(1, 6), cuts=st.lists(st.integers(1, 250), max_size=6))
def test_an_answer_of_several_chunks_is_taken_in_whatever_pieces_it_comes(count: int, cuts: list[int]):
    async def run() -> None:
        ours, theirs = _BoundedProtocol(1.0, SecurityPolicyNone()), make_protocol()
        other = make_protocol()
        ours._connection, ours._callbackmap = other._connection, other._callbackmap
        ours._callbackmap[4] = asyncio.get_running_loop().create_future()
        theirs._callbackmap[4] = asyncio.get_running_loop().create_future()
        waiting = [[protocol._callbackmap[number] for number in (3, 4)] for protocol in (ours, theirs)]
        data = sequence_of(count) + sequence_of(2, 4, 5 + count)
        at = 0
        for end in (*sorted(cuts), len(data)):
            ours.data_received(data[at:end])
            at = max(at, end)
        theirs.data_received(data)

        assert [[bytes(each.result()) for each in answers] for answers in waiting] == [
            [b"the body" * count, b"the body" * 2]
        ] * 2
        assert ours._connection._peer_sequence_number == theirs._connection._peer_sequence_number == 6 + count
        assert ours._callbackmap == theirs._callbackmap == {}
        assert not ours.receive_buffer

    asyncio.run(run())


async def test_an_answer_that_is_longer_than_agreed_is_not_held():
    protocol = make_protocol()
    protocol._connection._limits.max_message_size = 40

    assert take_answer(protocol, sequence_of(1)[:30]) == MORE
    assert take_answer(protocol, sequence_of(2)) == 0
