"""Bodies in and out of asyncua's channel: all that the fast path needs of asyncua 2.1.0's private names.

A request that is already encoded goes to the secure channel as asyncua's own requests do: it is cut into chunks, gets
its sequence number, is signed and encrypted. The answer is what asyncua made of the answer's chunks: the plain body.
On a channel without security a message's chunks are put together and a whole answer is taken apart here.
"""

import asyncio
import struct
from typing import Any, Final, NoReturn, TypeVar

from asyncua import ua
from asyncua.client.ua_client import UaClient, UASocketProtocol
from asyncua.common.connection import SecureConnection
from asyncua.common.utils import Buffer
from asyncua.crypto.security_policies import CryptographyNone
from asyncua.ua.ua_binary import nodeid_from_binary, nodeid_to_binary, struct_from_binary, struct_to_binary

from softplc import asyncua_version
from softplc.drivers.opcua.fast.records import OddBodyError

_CHUNK: Final = struct.Struct("<4sIIIII")
"""Kind and size, channel, token, sequence number, request id: what stands before the body (OPC 10000-6, 6.7.2)."""
_MOST_HELD: Final = 2**20
"""Bytes of an answer that are held until its end is there; longer ones are put together by asyncua."""
_NULL_ARRAYS: Final = (b"\x80", b"\xc0")
_EPOCH_TICKS: Final = 116_444_736_000_000_000  # 1601 to 1970, 100 ns
_STAMP_AND_HANDLE: Final = struct.Struct("<qI")
T = TypeVar("T")


def proven() -> bool:
    """The client's fast path was compared with the installed asyncua."""
    return asyncua_version.proven("client")


class Request:
    """A request, encoded once; each sending patches its timestamp and its handle.

    `response` is the type of its answer, which the server may give when it likes where the request is not `timed`.
    """

    def __init__(self, client: UaClient, request: Any, response: type, timed: bool = True) -> None:
        protocol, header = client.protocol, request.RequestHeader
        header.AuthenticationToken = protocol.authentication_token
        header.TimeoutHint = int(protocol.timeout * 1000) if timed else 0
        self.timed = timed
        self.response = response
        self.answer_head = nodeid_to_binary(response().TypeId)
        self.body = bytearray(struct_to_binary(request))
        self._at = len(nodeid_to_binary(request.TypeId)) + len(nodeid_to_binary(header.AuthenticationToken))

    def patch(self, now: int, handle: int) -> memoryview:
        """The body with this time (ns UTC) and handle."""
        _STAMP_AND_HANDLE.pack_into(self.body, self._at, now // 100 + _EPOCH_TICKS, handle & 0xFFFFFFFF)
        return memoryview(self.body)


async def exchange(client: UaClient, request: Request, now: int) -> bytes:
    """Send a request, at the time `now` in ns UTC, and wait for the body of its answer: without end if not timed.

    Raises what asyncua raises: ConnectionError, TimeoutError, UaStatusCodeError for a ServiceFault.
    """
    protocol = client.protocol
    if protocol is None or protocol.transport is None:
        raise ConnectionError("Connection is not open")
    protocol._request_handle += 1
    body = request.patch(now, protocol._request_handle)
    protocol.revolve_security_token()
    number = protocol._request_id + 1
    message = to_chunks(protocol._connection, body, number)
    protocol._request_id = number
    loop = asyncio.get_running_loop()
    answer: asyncio.Future[Buffer] = loop.create_future()
    protocol._callbackmap[number] = answer
    protocol.transport.write(message)
    if request.timed:
        alarm = loop.call_later(protocol.timeout, _expire, answer)
        try:
            buffer = await answer
        finally:
            alarm.cancel()
    else:
        buffer = await answer
    found = bytes(buffer)
    if not found.startswith(request.answer_head):
        _refuse(client, request, buffer)
    return found


def to_chunks(connection: SecureConnection, body: memoryview, number: int) -> bytes:
    """The chunks of a request; on a channel without security put together here, to the same bytes."""
    if type(connection.security_policy.symmetric_cryptography) is not CryptographyNone:
        message: bytes = connection.message_to_binary(body, request_id=number)
        return message
    channel, token = connection.security_token.ChannelId, connection.security_token.TokenId
    most = connection._limits.max_send_buffer - _CHUNK.size
    parts: list[bytes | memoryview] = []
    for begin in range(0, len(body), most):
        part = body[begin : begin + most]
        kind = b"MSGF" if begin + most >= len(body) else b"MSGC"
        sequence = connection._sequence_number = (connection._sequence_number + 1) % 2**32 or 1
        parts += (_CHUNK.pack(kind, _CHUNK.size + len(part), channel, token, sequence, number), part)
    return b"".join(parts)


MORE: Final = -1


def take_answer(protocol: UASocketProtocol, data: bytes) -> int:
    """Take the answer that `data` begins with, on a channel without security; how many bytes it was.

    0: what comes is something else, and left as it is. MORE: it is an answer, of which the end is still to come.
    """
    connection = protocol._connection
    if (
        len(data) < _CHUNK.size
        or type(connection.security_policy.symmetric_cryptography) is not CryptographyNone
        or connection._incoming_parts
        or connection._peer_sequence_number is None
    ):
        return 0
    limits, token = connection._limits, connection.security_token
    expected, request = connection._peer_sequence_number, _CHUNK.unpack_from(data)[5]
    answer = protocol._callbackmap.get(request)
    if answer is None or answer.done():
        return 0
    bounds: list[tuple[int, int]] = []
    offset, kind = 0, b"MSGC"
    while kind == b"MSGC":
        if len(data) - offset < _CHUNK.size:
            return MORE
        kind, size, channel, used, sequence, number = _CHUNK.unpack_from(data, offset)
        expected += 1
        if (
            kind not in (b"MSGC", b"MSGF")
            or not _CHUNK.size <= size <= limits.max_recv_buffer
            or offset + size > _MOST_HELD
            or (limits.max_message_size and offset + size > limits.max_message_size)
            or (limits.max_chunk_count and len(bounds) >= limits.max_chunk_count)
            or (channel, used) != (token.ChannelId, token.TokenId)
            or (sequence, number) != (expected, request)
        ):
            return 0
        bounds.append((offset + _CHUNK.size, offset + size))
        offset += size
    if offset > len(data):
        return MORE
    connection._peer_sequence_number = expected
    del protocol._callbackmap[request]
    whole = data if offset == len(data) else data[:offset]
    if len(bounds) == 1:
        answer.set_result(Buffer(whole, _CHUNK.size))
    else:
        answer.set_result(Buffer(b"".join([memoryview(whole)[begin:end] for begin, end in bounds])))
    return offset


def _expire(answer: "asyncio.Future[Buffer]") -> None:
    if not answer.done():
        answer.set_exception(TimeoutError())


def _refuse(client: UaClient, request: Request, buffer: Buffer) -> NoReturn:
    """Raise what the server answered instead of the response that was due."""
    client.protocol.check_answer(buffer, "")
    found = nodeid_from_binary(buffer.copy())
    raise ua.UaError(f"was answered with {found.to_string()}; expected a {request.response.__name__}")


def decode_message(response: type[T], body: bytes) -> T:
    """The whole answer, by asyncua's decoder, with a Good result of the service. Raises anything on garbage."""
    answer: Any = struct_from_binary(response, Buffer(body))
    answer.ResponseHeader.ServiceResult.check()
    return answer  # type: ignore[no-any-return]


def decode_head(body: bytes) -> int:
    """Where the head of a response ends whose service result is Good, by asyncua's decoder. Raises anything."""
    buffer = Buffer(body)
    nodeid_from_binary(buffer)
    struct_from_binary(ua.ResponseHeader, buffer).ServiceResult.check()
    return int(buffer.cur_pos)


def decode_value(body: bytes, offset: int) -> tuple[ua.DataValue, int]:
    """The DataValue at this byte, by asyncua's decoder, and where it ends. Raises OddBodyError on garbage."""
    if body[offset] & 1 and body[offset + 1 : offset + 2] in _NULL_ARRAYS:
        # its elements have no bytes: asyncua would make as many of them as four bytes of garbage say
        claimed = int.from_bytes(body[offset + 2 : offset + 6], "little", signed=True)
        if claimed > len(body) - offset:
            raise OddBodyError(f"an array of {claimed} nulls in {len(body)} bytes")
    buffer = Buffer(body, offset)
    try:
        return struct_from_binary(ua.DataValue, buffer), buffer.cur_pos
    except Exception as error:
        raise OddBodyError(f"{type(error).__name__}: {error}") from error
