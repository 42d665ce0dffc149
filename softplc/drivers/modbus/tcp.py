"""Modbus TCP frames: PDUs with the MBAP header, for one outstanding request at a time. Pure.

MBAP (Modbus Messaging on TCP/IP V1.0b, 3.1.3): transaction id, protocol id 0, length of what follows, unit id. Any
header that is not the answer to the request just sent raises at once: there is nothing to wait for.
"""

import struct
from typing import Final

from softplc.drivers.modbus.pdu import ProtocolError

HEADER: Final = struct.Struct(">HHHB")
PREFIX: Final = 6  # what the length does not count
_SHORTEST, _LONGEST = 3, 254  # of unit id and PDU together


class TcpFraming:
    """Frames one request, then takes bytes until its reply is whole."""

    pause: Final = 0.0
    drops_unasked: Final = False

    def __init__(self, unit_id: int) -> None:
        self._unit = unit_id
        self._transaction = 0
        self._buffer = b""

    def frame(self, pdu: bytes) -> bytes:
        """The bytes of the next request; its transaction id is the one that the reply must carry."""
        self.take_ids(1)
        self._buffer = b""
        return HEADER.pack(self._transaction, 0, len(pdu) + 1, self._unit) + pdu

    def take_ids(self, count: int) -> int:
        """The first of so many transaction ids that nobody else will use until they come round again."""
        first = self._transaction + 1 & 0xFFFF
        self._transaction = self._transaction + count & 0xFFFF
        return first

    def feed(self, data: bytes) -> bytes | None:
        """The reply's PDU when these bytes complete it, None when there is more to come. Raises ProtocolError."""
        buffer = self._buffer = self._buffer + data if self._buffer else data
        if len(buffer) < HEADER.size:
            return None
        length = announced(buffer, 0)
        transaction, _, _, unit = HEADER.unpack_from(buffer)
        if transaction != self._transaction:
            raise ProtocolError(f"reply to transaction {transaction}, the outstanding one is {self._transaction}")
        if unit != self._unit:
            raise ProtocolError(f"reply from unit {unit}, unit {self._unit} was asked")
        missing = PREFIX + length - len(buffer)
        if missing > 0:
            return None
        if missing < 0:
            raise ProtocolError(f"{-missing} bytes follow the reply, nothing else was asked for")
        return buffer[HEADER.size :]


def announced(buffer: bytes, at: int) -> int:
    """The length in the header at this place, of unit id and PDU. Raises ProtocolError when that is not Modbus."""
    _, protocol, length, _ = HEADER.unpack_from(buffer, at)
    if protocol != 0:
        raise ProtocolError(f"reply has protocol id {protocol}, Modbus is 0")
    if not _SHORTEST <= length <= _LONGEST:
        raise ProtocolError(f"reply announces {length} bytes, expected {_SHORTEST} to {_LONGEST}")
    return int(length)
