"""Mutations of OPC-UA messages that know where lengths, types and the request header are."""

import random
import struct
from collections.abc import Sequence

from tests.fuzz.opcua_messages import TYPE_IDS, Message

_LENGTHS = (-1, -2, 0, 1, 2, 127, 255, 65535, 1 << 20, 0x7FFFFFFF, -0x80000000)
_ENCODINGS = bytes(
    (0, 1, 2, 3, 4, 5, 0x3F, 0x40, 0x80, 0xFF, *range(6, 26), *(0x80 | kind for kind in range(26)), 0xCB)
)
_DEEP = 3000


def _lengths(body: bytes | bytearray, first: int) -> list[int]:
    """Offsets behind `first` where an Int32 stands that may be a length or a count."""
    found = []
    for at in range(first, len(body) - 3):
        (number,) = struct.unpack_from("<i", body, at)
        if -1 <= number <= 1000 and (number or body[at : at + 8] == bytes(8)):
            found.append(at)
    return found


def mutate(message: Message, others: Sequence[Message], chance: random.Random) -> bytes:
    """The message's body, broken in one to four places; mostly behind the request header."""
    body = bytearray(message.body)
    first = 0 if chance.random() < 0.12 else message.payload
    for _ in range(chance.choice((1, 1, 1, 2, 3, 4))):
        _break(body, min(first, max(len(body) - 1, 0)), others, chance)
    return bytes(body)


def _break(body: bytearray, first: int, others: Sequence[Message], chance: random.Random) -> None:
    if not body:
        return
    at = chance.randrange(first, len(body))
    match chance.randrange(10):
        case 0:
            body[at] ^= 1 << chance.randrange(8)
        case 1:
            body[at] = chance.randrange(256)
        case 2 | 3:
            places = _lengths(body, first)
            if places:
                struct.pack_into("<i", body, chance.choice(places), chance.choice(_LENGTHS))
        case 4:
            body[at] = chance.choice(_ENCODINGS)
        case 5:
            del body[at:]
        case 6:
            stop = at + chance.randrange(1, 32)
            body[at:stop] = body[at:stop] * chance.choice((0, 0, 0, 2, 2, 3, 51))
        case 7:
            other = chance.choice(others).body
            body[at:] = other[chance.randrange(len(other)) :]
        case 8:
            _retype(body, chance)
        case _:
            body[at:at] = _nested(chance)


def _retype(body: bytearray, chance: random.Random) -> None:
    """Another service's number before this request, or none's."""
    number = chance.choice(TYPE_IDS) if chance.random() < 0.9 else chance.randrange(65536)
    body[2:4] = struct.pack("<H", number)


def _nested(chance: random.Random) -> bytes:
    """Something that contains itself, over and over: Variants, DiagnosticInfos, or just many bytes of one kind."""
    depth = _DEEP if chance.random() < 0.05 else chance.randrange(40)
    kinds = (b"\x98\x01\x00\x00\x00", b"\x18", b"\x40", b"\x99\x01\x00\x00\x00", b"\xff\xff\xff\xff")
    return chance.choice(kinds) * depth


def mutate_frame(frame: bytes, chance: random.Random) -> bytes:
    """A whole frame, broken in its header or anywhere."""
    broken = bytearray(frame)
    match chance.randrange(6):
        case 0:
            broken[chance.randrange(min(24, len(broken)))] ^= 1 << chance.randrange(8)
        case 1:
            broken[3] = chance.choice(b"FCAX\0")
        case 2:
            sizes = (0, 7, 8, 11, 12, 65535, 65536, 0x7FFFFFFF, 0xFFFFFFFF, len(broken) - 1, len(broken) + 1)
            size = chance.choice(sizes)
            struct.pack_into("<I", broken, 4, size)
        case 3:
            broken[:3] = chance.choice((b"MSG", b"OPN", b"CLO", b"HEL", b"ACK", b"ERR", b"RHE", b"GET"))
        case 4:
            place = chance.choice((8, 12, 16, 20))
            if len(broken) >= place + 4:
                struct.pack_into(
                    "<I", broken, place, chance.choice((0, 1, 13, 14, 0xFFFFFFFF, chance.getrandbits(32)))
                )
        case _:
            del broken[chance.randrange(len(broken)) :]
    return bytes(broken)
