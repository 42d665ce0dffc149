"""The Modbus client under lying devices: every kind of wrong reply, each judged by a second reading of the bytes.

What a read gives is Good with the values that are in the bytes, or it is a refusal, or the link is lost. There is no
fourth: no other exception, no value from a reply that does not answer its request, no waiting for what cannot come.
"""

import asyncio
import random
import struct
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from softplc.clock import SystemClock
from softplc.drivers.modbus.address import Table
from softplc.drivers.modbus.burst import BurstState
from softplc.drivers.modbus.client import Client
from softplc.drivers.modbus.codec import Field
from softplc.drivers.modbus.pdu import ProtocolError, Refused, read_reply
from softplc.drivers.modbus.plan import Limits, Span
from softplc.drivers.modbus.polling import PollState, Value
from softplc.drivers.modbus.rtu import RtuFraming
from softplc.drivers.modbus.tcp import TcpFraming
from softplc.errors import LinkError
from softplc.sample import StatusCode
from softplc.tags import Image
from tests.fuzz.modbus_frames import FOREIGN
from tests.fuzz.modbus_server import Result, WrongError, resident

UNIT = 1
_REQUEST = 12
_WARM = 20


@dataclass(slots=True)
class Verdict:
    """What the bytes of a device amount to: `replies` by request, data or exception code; `fault` when they lie."""

    replies: dict[int, bytes | int]
    fault: bool = False


def verdict(requests: Sequence[bytes], pieces: Sequence[tuple[int, bytes]]) -> Verdict:
    """Judge what a device sent, after the specification; each piece with how many requests were sent before it."""
    found = Verdict({})
    stream = b""
    for sent, piece in pieces:
        stream += piece
        while len(stream) >= 7 and len(found.replies) < sent and not found.fault:
            transaction, protocol, length, unit = struct.unpack_from(">HHHB", stream)
            ids = [struct.unpack_from(">H", request)[0] for request in requests[:sent]]
            waiting = [n for n in range(sent) if n not in found.replies and ids[n] == transaction]
            if protocol or not 3 <= length <= 254 or unit != UNIT or not waiting:
                found.fault = True
            elif len(stream) < 6 + length:
                break
            else:
                reply = _data(requests[waiting[0]][7:], stream[7 : 6 + length])
                found.fault = reply is None
                if reply is not None:
                    found.replies[waiting[0]] = reply
                stream = stream[6 + length :]
        found.fault |= bool(stream) and len(found.replies) == sent
        if found.fault:
            break
    return found


def _data(request: bytes, pdu: bytes) -> bytes | int | None:
    """The registers of a reply, the exception code of a refusal, None for what is neither."""
    function, _, count = struct.unpack(">BHH", request)
    if len(pdu) == 2 and pdu[0] == function | 0x80:
        return pdu[1]
    if len(pdu) == 2 + 2 * count and pdu[0] == function and pdu[1] == 2 * count:
        return pdu[2:]
    return None


def honest(request: bytes, chance: random.Random) -> bytes:
    """The reply of a device whose registers hold anything."""
    function, _, count = struct.unpack(">BHH", request[7:])
    if chance.random() < 0.03:
        return request[:4] + struct.pack(
            ">HBBB", 3, UNIT, function | 0x80, chance.choice((1, 2, 3, 4, 6, 10, 11, 77))
        )
    data = chance.randbytes(2 * count)
    return request[:4] + struct.pack(">HBBB", 3 + len(data), UNIT, function, len(data)) + data


def lies(replies: list[bytes], chance: random.Random) -> bytes:
    """Right replies with something done to one of them, or to their order."""
    at = chance.randrange(len(replies))
    one = bytearray(replies[at])
    other = bytearray(chance.choice(replies))

    def consistent() -> None:
        """Fewer or more registers than were asked for, and every count in the frame says so."""
        size = 2 * chance.randrange(126)
        one[4:] = struct.pack(">HBBB", 3 + size, UNIT, one[7], size) + bytes(size)

    changes: tuple[Callable[[], object], ...] = (
        lambda: one.__setitem__(chance.randrange(min(9, len(one))), chance.randrange(256)),
        lambda: one.__setitem__(chance.randrange(min(9, len(one))), chance.randrange(4)),
        lambda: one.__setitem__(chance.randrange(len(one)), chance.randrange(256)),  # perhaps data, which is right
        lambda: one.__setitem__(slice(4, 6), struct.pack(">H", chance.choice((0, 2, 3, 4, 5, 254, 255, 65535)))),
        lambda: one.__setitem__(slice(0, 2), struct.pack(">H", int.from_bytes(one[:2], "big") + 1 & 0xFFFF)),
        lambda: one.__setitem__(slice(0, 2), other[:2]),
        lambda: one.__setitem__(slice(7, None), other[7:]),
        lambda: one.__delitem__(slice(chance.randrange(len(one)), None)),
        lambda: one.extend(chance.randbytes(chance.randrange(1, 10))),
        lambda: one.extend(other),
        one.clear,
        lambda: one.__setitem__(slice(None), chance.choice(FOREIGN)),
        lambda: one.__setitem__(slice(None), chance.randbytes(chance.randrange(1, 300))),
        lambda: one.__setitem__(slice(2, None), chance.randbytes(chance.randrange(1, 300))),
        lambda: chance.shuffle(replies),  # right, when all of them come
        consistent,
    )
    chance.choice(changes)()
    replies[at] = bytes(one)
    return b"".join(replies)


class _Wire:
    """What the client writes to, and whether it let go."""

    def __init__(self) -> None:
        self.sent, self.gone = b"", False

    def write(self, data: bytes) -> None:
        self.sent += data

    def abort(self) -> None:
        self.gone = True


class _Rounds:
    """Reads of a few requests each, one after the other over connections that end with the first fault."""

    def __init__(self, seed: int) -> None:
        self.chance = random.Random(seed)
        self.clock = SystemClock()
        places = [300 * n + k for n in range(3) for k in range(1 + n)]  # three requests of one to three registers
        spans = [Span(table, place, 1) for table in (Table.HOLDING, Table.INPUT) for place in places]
        self.image = Image(len(spans))
        self.poll = PollState([Value(span, Field(0, "uint16")) for span in spans], Limits())
        self.client: Client | None = None
        self.replies = 0

    async def one(self) -> None:
        """A read and its end. Raises WrongError."""
        if self.client is None:
            self.framing = TcpFraming(UNIT)
            self.framing.take_ids(self.chance.randrange(65536))
            self.client, self.wire = Client(self.framing, "plc", 60.0, self.clock), _Wire()
            self.client.connected(self.wire)
        client, wire, chance = self.client, self.wire, self.chance
        burst = BurstState([question.request for question in self.poll.live], UNIT)
        wire.sent = b""
        reading = asyncio.create_task(client.read(burst, chance.choice((1, 2, 3, 8))))
        await asyncio.sleep(0)
        answered, lied, pieces = 0, False, []
        while not wire.gone and (waiting := self._requests()[answered:]):
            answered += len(waiting)
            replies = [honest(request, chance) for request in waiting]
            lie = not lied and chance.random() < 0.5
            stream = lies(replies, chance) if lie else b"".join(replies)
            lied |= lie
            cut = chance.randrange(len(stream) + 1) if chance.random() < 0.3 else 0
            for piece in (stream[:cut], stream[cut:]):
                if piece and not wire.gone:
                    pieces.append((len(self._requests()), piece))
                    client.data_received(piece)
        self.replies += answered
        self._judge(burst, reading, verdict(self._requests(), pieces), wire.gone)
        if not reading.done() and not wire.gone:
            client.connection_lost(None)  # as when the device gives up: what is missing never comes
        try:
            await reading
        except LinkError:
            self.client = None
        if wire.gone:
            self.client = None

    def _requests(self) -> list[bytes]:
        return [self.wire.sent[at : at + _REQUEST] for at in range(0, len(self.wire.sent), _REQUEST)]

    def _judge(self, burst: BurstState, reading: "asyncio.Task[None]", right: Verdict, gone: bool) -> None:
        if gone != right.fault:
            raise WrongError(f"link lost: {gone}, but the bytes lie: {right.fault}")
        if gone:
            return
        if burst.done != (len(right.replies) == len(burst)):
            raise WrongError(f"done: {burst.done}, but {len(right.replies)} of {len(burst)} replies came")
        if not burst.done:
            return
        for number in range(len(burst)):
            reply = burst.reply(number)
            if (reply.code if isinstance(reply, Refused) else reply) != right.replies[number]:
                raise WrongError(f"reply {number} is {reply!r}, the bytes say {right.replies[number]!r}")
        if not burst.refused:
            self.poll.fill(burst.wire, burst.arrivals, burst.timestamps, self.image)
            data = b"".join(reply for _, reply in sorted(right.replies.items()) if isinstance(reply, bytes))
            if not np.array_equal(self.image.values, np.frombuffer(data, ">u2")):
                raise WrongError(f"values {self.image.values}, the bytes say {data.hex()}")
            assert (self.image.statuses == StatusCode.GOOD).all()


def tcp(replies: int, seed: int) -> Result:
    """So many replies of lying devices to the client over TCP."""

    async def run() -> Result:
        rounds, before, begun = _Rounds(seed), 0, time.perf_counter()
        while rounds.replies < replies:
            try:
                await rounds.one()
            except WrongError:
                raise
            except Exception as error:
                raise WrongError(f"seed {seed}, reply {rounds.replies}: {error!r}") from error
            if not before and rounds.replies * _WARM >= replies:
                before = resident()
        rounds.clock.close()
        return Result(rounds.replies, time.perf_counter() - begun, resident() - before)

    return asyncio.run(run())


def rtu(replies: int, seed: int) -> Result:
    """So many replies of lying devices, as on a serial line: a PDU is taken only with its unit and checksum."""
    chance, before, begun = random.Random(seed), 0, time.perf_counter()
    framing, sender = RtuFraming(UNIT), RtuFraming(UNIT)
    for done in range(replies):
        count = chance.randrange(1, 126)
        request = struct.pack(">BHH", chance.choice((3, 4)), chance.randrange(65536), count)
        refusal = bytes([request[0] | 0x80, chance.randrange(1, 12)])
        pdu = refusal if chance.random() < 0.2 else request[:1] + bytes([2 * count]) + chance.randbytes(2 * count)
        right = sender.frame(pdu)
        stream = _spoilt(right, chance) if chance.random() < 0.8 else right
        cut = chance.randrange(len(stream) + 1)
        framing.frame(request)
        try:
            taken = _take(framing, request, [piece for piece in (stream[:cut], stream[cut:]) if piece])
        except Exception as error:
            raise WrongError(f"{error!r} at {stream.hex()}, cut at {cut}") from error
        if (taken is None and stream == right) or (taken is not None and sender.frame(taken) not in stream):
            raise WrongError(f"{taken!r} taken from {stream.hex()}, cut at {cut}")
        if done * _WARM == replies:
            before = resident()
    return Result(replies, time.perf_counter() - begun, resident() - before)


def _take(framing: RtuFraming, request: bytes, pieces: Sequence[bytes]) -> bytes | None:
    """The reply that a client makes of the pieces, when it answers the request."""
    try:
        for piece in pieces:
            pdu = framing.feed(piece)
            if pdu is not None:
                read_reply(request, pdu)
                return pdu
    except ProtocolError:
        pass
    return None


def _spoilt(right: bytes, chance: random.Random) -> bytes:
    frame = bytearray(right)
    kind = chance.randrange(7)
    if kind == 0:
        frame[chance.randrange(len(frame))] ^= 1 << chance.randrange(8)
    elif kind == 1:
        del frame[chance.randrange(len(frame)) :]
    elif kind == 2:
        frame[0:0] = chance.randbytes(chance.randrange(1, 20))
    elif kind == 3:
        frame.extend(chance.randbytes(chance.randrange(1, 20)))
    elif kind == 4:
        frame[:] = chance.randbytes(chance.randrange(300))
    elif kind == 5:
        frame[0:0] = RtuFraming(chance.choice((1, 2, 9))).frame(chance.randbytes(chance.randrange(1, 20)))
    else:
        frame[:] = chance.choice(FOREIGN)
    return bytes(frame)
