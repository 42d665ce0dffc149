"""Modbus TCP, strictly: requests out of a byte buffer, responses out of the register image; pure.

Frame (Modbus Messaging on TCP/IP Implementation Guide V1.0b, 3.1.3): transaction, protocol = 0, length of what
follows, unit; then the PDU: function and data (Application Protocol Specification V1.1b3, 4.1). Served are
functions 3 (holding registers) and 4 (input registers); both read the same image.
"""

from collections.abc import Callable
from struct import Struct
from typing import Final, NamedTuple

READ_HOLDING: Final = 3
READ_INPUT: Final = 4
MOST_REGISTERS: Final = 125  # in one read (V1.1b3, 6.3)
LONGEST_FRAME: Final = 260  # 7 bytes of header and 253 of PDU

ILLEGAL_FUNCTION: Final = 1
ILLEGAL_DATA_ADDRESS: Final = 2
ILLEGAL_DATA_VALUE: Final = 3
GATEWAY_TARGET_FAILED: Final = 0x0B

_HEADER: Final = Struct(">HHH")  # transaction, protocol, length
_READ: Final = Struct(">HH")  # first register, quantity
_REPLY: Final = Struct(">HHHBBB")  # transaction, protocol, length, unit, function, byte count or exception code
_SHORTEST: Final = 2  # length: unit and function
_LONGEST: Final = LONGEST_FRAME - _HEADER.size
_READ_LENGTH: Final = 6  # length: unit, function, first register, quantity


class Answer(NamedTuple):
    """What to send, how many bytes of the buffer are used up, and whether the connection is beyond repair."""

    replies: bytes
    consumed: int
    close: bool


def answer(buffer: bytes | bytearray, filled: int, units: frozenset[int], image: Callable[[], bytes]) -> Answer:
    """Answer every complete frame in the first `filled` bytes, in order; an incomplete one at the end waits.

    `units` are the unit ids that are answered. `image` gives all registers as big-endian bytes; it is called at
    most once, so that all answers of one burst show the same scan. A header that is not Modbus TCP asks to close:
    where the next frame begins can no longer be known.
    """
    replies: list[bytes] = []
    registers = b""
    at = 0
    while filled - at >= _HEADER.size:
        transaction, protocol, length = _HEADER.unpack_from(buffer, at)
        if protocol != 0 or not _SHORTEST <= length <= _LONGEST:
            return Answer(b"".join(replies), at, close=True)
        body = at + _HEADER.size
        if filled - body < length:
            break
        at = body + length
        unit, function = buffer[body], buffer[body + 1]
        if unit not in units:
            fault = GATEWAY_TARGET_FAILED
        elif function not in (READ_HOLDING, READ_INPUT):
            fault = ILLEGAL_FUNCTION
        elif length != _READ_LENGTH:
            fault = ILLEGAL_DATA_VALUE
        else:
            first, quantity = _READ.unpack_from(buffer, body + 2)
            registers = registers or image()
            fault = _fault(first, quantity, len(registers) // 2)
            if not fault:
                count = 2 * quantity
                replies.append(_REPLY.pack(transaction, 0, 3 + count, unit, function, count))
                replies.append(registers[2 * first : 2 * first + count])
                continue
        replies.append(_REPLY.pack(transaction, 0, 3, unit, function | 0x80, fault))
    return Answer(b"".join(replies), at, close=False)


def _fault(first: int, quantity: int, served: int) -> int:
    """Exception code of a read of `quantity` registers from `first`, 0 when it is right (V1.1b3, 6.3)."""
    if not 1 <= quantity <= MOST_REGISTERS:
        return ILLEGAL_DATA_VALUE
    if first + quantity > served:
        return ILLEGAL_DATA_ADDRESS
    return 0
