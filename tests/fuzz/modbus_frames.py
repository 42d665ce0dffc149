"""Malformed Modbus TCP streams: mutants of every request of the specification, and what else arrives on a port.

A stream is some frames whose headers are right, whatever is behind them, and an end that is not: so that each stream
is looked at whole before it closes its connection. No frame comes twice.
"""

import random
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

# A request of each function, after the examples of the Application Protocol Specification V1.1b3, 6.1 to 6.21.
REQUESTS = [
    bytes.fromhex(text)
    for text in (
        "0100130013",
        "0200c40016",
        "03006b0003",
        "030bb8007d",
        "0400080001",
        "040000007d",
        "0500acff00",
        "0500001234",
        "0600010003",
        "07",
        "080000a537",
        "0800040000",
        "0b",
        "0c",
        "0f0013000a02cd01",
        "100001000204000a0102",
        "100000007bf6" + 246 * "5a",
        "11",
        "140e0600040001000206000300090002",
        "150d0600040007000306af04be100d",
        "16000400f20025",
        "170003000600 0e00030600ff00ff00ff",
        "1804de",
        "2b0e0100",
        "2b0d000102",
        "83",
        "00",
        "5a0001",  # Schneider's own
        "80",
        "ff00",
    )
]
UNITS = (0, 0, 1, 1, 1, 1, 1, 2, 17, 247, 248, 254, 255, 255)
EDGES = (0, 1, 2, 3, 7, 8, 99, 124, 125, 126, 127, 2000, 2001, 3000, 3127, 3128, 32767, 32768, 65410, 65534, 65535)
STREAM = 40  # frames of a stream, about
_POOL, _POOLED_STREAMS = 400, 400  # a pool of mutants serves so many streams, a bit of each frame flipped every time

FOREIGN = [
    b"GET / HTTP/1.1\r\nHost: plc\r\n\r\n",
    b"SSH-2.0-OpenSSH_9.2\r\n",
    bytes.fromhex("16030100c2010000be0303") + bytes(40),  # a TLS hello
    b"HELF\x39\x00\x00\x00" + bytes(49),  # OPC-UA
    bytes.fromhex("010300000001840a"),  # RTU
    b":010300000001FB\r\n",  # ASCII
    bytes.fromhex("0300001611e00000000100c0010ac1020100c2020102"),  # ISO on TCP, S7
    bytes(64),
    b"\xff" * 64,
]


@dataclass(frozen=True, slots=True)
class Stream:
    """Bytes for one connection, and how many frames they were made of."""

    data: bytes
    frames: int


def frame(pdu: bytes, unit: int = 1, transaction: int = 0) -> bytes:
    """A frame whose header is right."""
    return struct.pack(">HHHB", transaction, 0, 1 + len(pdu), unit) + pdu


def mutant(chance: random.Random) -> bytes:
    """A frame with a right header, whose PDU is a request of the specification with something done to it."""
    pdu = bytearray(chance.choice(REQUESTS))

    def edge(at: int) -> Callable[[], None]:
        return lambda: pdu.__setitem__(slice(at, at + 2), struct.pack(">H", chance.choice(EDGES)))

    changes: tuple[Callable[[], object], ...] = (
        lambda: None,
        edge(1),  # where the address is
        edge(3),  # where the quantity is
        lambda: pdu.__setitem__(slice(5, 6), chance.randbytes(1)),  # where the byte count is
        lambda: pdu.__setitem__(0, chance.randrange(256)),
        lambda: pdu.__delitem__(slice(chance.randrange(1, len(pdu) + 1), None)),
        lambda: pdu.extend(chance.randbytes(chance.randrange(1, 20))),
        lambda: pdu.__setitem__(slice(1, None), chance.randbytes(chance.randrange(253))),
        lambda: pdu.extend(frame(chance.choice(REQUESTS))),  # a frame inside a frame
        lambda: pdu.__setitem__(slice(None), struct.pack(">BHH", 3, chance.choice(EDGES), chance.choice(EDGES))),
        lambda: pdu.__setitem__(slice(None), b"\x04" + chance.randbytes(4)),
    )
    for _ in range(chance.choice((0, 1, 1, 1, 2, 3))):
        chance.choice(changes)()
    return frame(bytes(pdu[:253]) or b"\x03", chance.choice(UNITS))


def bad_end(chance: random.Random) -> bytes:
    """What no connection survives, or what waits for the rest for ever."""
    whole = bytearray(mutant(chance))
    kind = chance.randrange(6)
    if kind == 0:
        whole[2 + chance.randrange(2)] ^= 1 << chance.randrange(8)  # protocol
    elif kind == 1:
        whole[4:6] = struct.pack(">H", chance.choice((0, 1, 255, 256, 260, 65535, chance.randrange(255, 65536))))
    elif kind == 2:
        del whole[chance.randrange(len(whole)) :]
    elif kind == 3:
        whole[:] = chance.choice(FOREIGN)
    elif kind == 4:
        whole[:] = chance.randbytes(chance.randrange(1, 300))
    else:
        whole[4:6] = struct.pack(">H", min(254, len(whole) + chance.randrange(1, 100)))  # announces more than it has
    return bytes(whole)


def streams(seed: int) -> Iterator[Stream]:
    """Streams without end."""
    chance, numbers = random.Random(seed), np.random.default_rng(seed)
    while True:
        pool = [mutant(chance) for _ in range(_POOL)]
        for _ in range(_POOLED_STREAMS):
            count = chance.randrange(1, 2 * STREAM)
            chosen = chance.choices(pool, k=count)
            yield Stream(_varied(chosen, numbers) + bad_end(chance), count + 1)


def _varied(frames: Sequence[bytes], numbers: np.random.Generator) -> bytes:
    """The frames one after the other, each with an id by lot and one of two with a bit of its unit or PDU flipped."""
    data = np.frombuffer(b"".join(frames), np.uint8).copy()
    lengths = np.array([len(one) for one in frames])
    starts = np.cumsum(lengths) - lengths
    ids = numbers.integers(0, 256, (2, len(frames)), np.uint8)
    data[starts], data[starts + 1] = ids[0], ids[1]
    places = starts + 6 + (numbers.random(len(frames)) * (lengths - 6)).astype(np.intp)
    data[places] ^= np.uint8(1) << numbers.integers(0, 16, len(frames), np.uint8)  # 8 to 15: no bit of a byte
    return data.tobytes()
