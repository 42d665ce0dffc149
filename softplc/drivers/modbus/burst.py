"""All reads of a plan as Modbus TCP frames made once, and their replies put where they belong as they come. Pure.

From one read to the next only the transaction ids change, in one numpy operation. A reply in order whose nine bytes
up to the byte count are those expected is taken by comparing them; any other is looked at closely: a refusal, one
that overtook another, or a fault. The data of all replies end up one after the other in `wire`.
"""

import struct
from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from softplc.drivers.modbus.pdu import MixedUpError, ProtocolError, Refused, read_reply, read_request
from softplc.drivers.modbus.plan import Request
from softplc.drivers.modbus.tcp import HEADER, PREFIX, announced

_FRAME: Final = 12  # bytes of a read request
_HEAD: Final = 9  # of its reply: MBAP, function, byte count


class BurstState:
    """The reads `requests` of one unit. `start`, then send what `due` gives and `feed` what comes until `done`.

    `arrivals` and `timestamps` [requests]: when each reply was whole, in monotonic seconds and ns UTC.
    """

    def __init__(self, requests: Sequence[Request], unit_id: int) -> None:
        count = len(requests)
        self.requests = requests
        self.arrivals: NDArray[np.float64] = np.zeros(count)
        self.timestamps: NDArray[np.int64] = np.zeros(count, np.int64)
        self.refused: dict[int, Refused] = {}
        self._unit = unit_id
        self._pdus = [read_request(request) for request in requests]
        sizes = [request.size for request in requests]
        ends = np.cumsum([0, *sizes]).tolist()
        self._places = [slice(start, stop) for start, stop in pairwise(ends)]
        self._buffer = bytearray(ends[-1])
        self.wire: NDArray[np.uint8] = np.frombuffer(self._buffer, np.uint8)
        frames = b"".join(struct.pack(">HHHB", 0, 0, 6, unit_id) + pdu for pdu in self._pdus)
        heads = b"".join(
            struct.pack(">HHHBBB", 0, 0, 3 + size, unit_id, pdu[0], size)
            for pdu, size in zip(self._pdus, sizes, strict=True)
        )
        self._frames: NDArray[np.uint8] = np.frombuffer(bytearray(frames), np.uint8).reshape(count, _FRAME)
        self._heads: NDArray[np.uint8] = np.frombuffer(bytearray(heads), np.uint8).reshape(count, _HEAD)
        self._numbers = np.arange(count)
        self._first = 0
        self._wires: bytes = b""
        self._expected: bytes = b""
        self._rest = b""
        self._sent = self._next = self._open = 0
        self._early: set[int] = set()

    def __len__(self) -> int:
        return len(self._pdus)

    @property
    def done(self) -> bool:
        """Every request was sent and answered."""
        return self._next == len(self._pdus)

    @property
    def outstanding(self) -> int:
        """How many requests were sent and not answered yet."""
        return self._open

    def start(self, first: int) -> None:
        """Once more from the first request, which has this transaction id; the others count up from it."""
        ids = (self._numbers + first) & 0xFFFF
        for array in (self._frames, self._heads):
            array[:, 0] = ids >> 8
            array[:, 1] = ids & 0xFF
        self._wires, self._expected = self._frames.tobytes(), self._heads.tobytes()
        self._first, self._rest = first, b""
        self._sent = self._next = self._open = 0
        self._early.clear()
        self.refused.clear()

    def due(self, in_flight: int) -> bytes:
        """The frames to send now so that at most so many requests are outstanding."""
        start = self._sent
        self._sent = stop = min(start + in_flight - self._open, len(self._pdus))
        self._open += stop - start
        return self._wires[start * _FRAME : stop * _FRAME]

    def feed(self, data: bytes, arrival: float, timestamp: int) -> int:
        """Take bytes that came; how many replies they completed. Raises ProtocolError."""
        buffer = self._rest + data if self._rest else data
        at, size, before, number = 0, len(buffer), self._open, self._next
        while self._open and size - at >= HEADER.size:
            if (
                number < self._sent
                and buffer[at : at + _HEAD] == self._expected[number * _HEAD : (number + 1) * _HEAD]
            ):
                place = self._places[number]
                stop = at + _HEAD + place.stop - place.start
                if stop > size:
                    break
                self._buffer[place] = buffer[at + _HEAD : stop]
                answered = number
            else:
                found = self._closely(buffer, at)
                if found is None:
                    break
                answered, stop = found
            self.arrivals[answered], self.timestamps[answered] = arrival, timestamp
            self._open -= 1
            at = stop
            if answered == number:
                number += 1
                while number in self._early:
                    self._early.discard(number)
                    number += 1
            else:
                self._early.add(answered)
            self._next = number
        self._rest = buffer[at:]
        if self._rest and not self._open:
            raise MixedUpError(f"{size - at} bytes follow the reply, nothing else was asked for")
        return before - self._open

    def reply(self, number: int) -> bytes | Refused:
        """The data of one reply, or the refusal."""
        return self.refused.get(number) or bytes(self._buffer[self._places[number]])

    def _closely(self, buffer: bytes, at: int) -> tuple[int, int] | None:
        """Which request is answered and where its reply ends; None when that is not whole. Raises ProtocolError."""
        length = announced(buffer, at)
        transaction = int.from_bytes(buffer[at : at + 2], "big")
        number = (transaction - self._first) & 0xFFFF
        if number >= self._sent or number < self._next or number in self._early:
            raise MixedUpError(f"reply to transaction {transaction}, {self._awaited()}")
        if buffer[at + PREFIX] != self._unit:
            raise ProtocolError(f"reply from unit {buffer[at + PREFIX]}, unit {self._unit} was asked")
        stop = at + PREFIX + length
        if stop > len(buffer):
            return None
        try:
            reply = read_reply(self._pdus[number], buffer[at + HEADER.size : stop])
        except ProtocolError as error:
            raise ProtocolError(f"{self.requests[number]}: {error}") from None
        if isinstance(reply, Refused):
            self.refused[number] = reply
        else:
            self._buffer[self._places[number]] = reply
        return number, stop

    def _awaited(self) -> str:
        ids = [n + self._first & 0xFFFF for n in range(self._next, self._sent) if n not in self._early]
        return f"the outstanding one is {ids[0]}" if len(ids) == 1 else f"outstanding are {ids}"
