"""Replies as no server should send them: functions from what came to what the client gets."""

import random
import struct
from collections.abc import Callable

Spoil = Callable[[bytes], bytes]
PUBLISH_RESPONSE = bytes((1, 0)) + struct.pack("<H", 829)  # node id of its binary encoding (OPC 10000-6)
_random = random.Random(4)


def garbage(data: bytes) -> bytes:
    return _random.randbytes(len(data))


def zeros(data: bytes) -> bytes:
    return bytes(len(data))


def twice(data: bytes) -> bytes:
    return data + data


def with_a_tail(data: bytes) -> bytes:
    return data + b"\x00\x01\x02"


def nothing(_: bytes) -> bytes:
    return b""


def text(_: bytes) -> bytes:
    return b"HTTP/1.1 400 Bad Request\r\n\r\n"


class WithoutPublishResponses:
    """OPC-UA without security: every message but the answers to Publish; a subscription falls silent, reads work.

    The sequence numbers of what follows are put right, so that the channel has nothing to complain about.
    """

    def __init__(self) -> None:
        self.dropped = 0

    def __call__(self, data: bytes) -> bytes:
        kept = b""
        while len(data) >= 8:
            length = int.from_bytes(data[4:8], "little")
            message, data = data[:length], data[length:]
            if message[:3] == b"ACK":
                self.dropped = 0  # a new connection counts from the start
            if message[:3] == b"MSG" and message[24:28] == PUBLISH_RESPONSE:
                self.dropped += 1
            elif message[:3] == b"MSG":
                number = int.from_bytes(message[16:20], "little") - self.dropped
                kept += message[:16] + struct.pack("<I", number) + message[20:]
            else:
                kept += message
        return kept + data


def patched(position: int, change: int) -> Spoil:
    """A Modbus reply with one byte increased."""

    def patch(data: bytes) -> bytes:
        reply = bytearray(data)
        if len(reply) > position:
            reply[position] = reply[position] + change & 0xFF
        return bytes(reply)

    return patch


def shorter(data: bytes) -> bytes:
    """A whole Modbus frame with one register too few, and a header that says so."""
    size = data[8] - 2 if len(data) > 10 else 0
    return data[:4] + struct.pack(">H", size + 3) + data[6:8] + bytes([size]) + data[9 : 9 + size]


ANY = {"garbage": garbage, "zeros": zeros, "text": text, "nothing": nothing, "twice": twice, "a tail": with_a_tail}
MODBUS = {
    "transaction id": patched(1, 1),
    "protocol id": patched(3, 1),
    "length": patched(5, 1),
    "unit id": patched(6, 1),
    "function code": patched(7, 1),
    "exception of another function": patched(7, 0x81),
    "byte count": patched(8, 1),
    "one register too few": shorter,
}
