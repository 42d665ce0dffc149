"""Modbus PDUs, the part of a message that every transport shares: requests out, checked replies in. Pure.

Modbus Application Protocol V1.1b3, chapter 6. A reply that does not answer its request to the letter is never
decoded: it raises ProtocolError. A refusal by the device (an exception response) is an answer.
"""

import struct
from dataclasses import dataclass
from typing import Final

from softplc.drivers.modbus.address import Address, Table
from softplc.drivers.modbus.plan import Request
from softplc.errors import LinkError
from softplc.sample import StatusCode

READ: Final = {Table.COIL: 1, Table.DISCRETE: 2, Table.HOLDING: 3, Table.INPUT: 4}
WRITE_COIL: Final = 5
WRITE_REGISTER: Final = 6
WRITE_REGISTERS: Final = 16

ILLEGAL_FUNCTION: Final = 1
ILLEGAL_ADDRESS: Final = 2
ILLEGAL_VALUE: Final = 3

_ON, _OFF = 0xFF00, 0x0000
_EXCEPTION_BIT: Final = 0x80

_EXCEPTIONS: Final = {
    1: ("illegal function", StatusCode.BAD_NOT_SUPPORTED),
    2: ("illegal data address", StatusCode.BAD_CONFIGURATION_ERROR),
    3: ("illegal data value", StatusCode.BAD_CONFIGURATION_ERROR),
    4: ("server device failure", StatusCode.BAD_DEVICE_FAILURE),
    5: ("acknowledge, still busy", StatusCode.BAD_RESOURCE_UNAVAILABLE),
    6: ("server device busy", StatusCode.BAD_RESOURCE_UNAVAILABLE),
    7: ("negative acknowledge", StatusCode.BAD_NOT_SUPPORTED),
    8: ("memory parity error", StatusCode.BAD_DEVICE_FAILURE),
    10: ("gateway path unavailable", StatusCode.BAD_NO_COMMUNICATION),
    11: ("gateway target failed to respond", StatusCode.BAD_NO_COMMUNICATION),
}


class ProtocolError(LinkError):
    """The device answered against the protocol, or with the answer to something else."""


@dataclass(frozen=True, slots=True)
class Refused:
    """The device answered that it will not: the exception code of its reply."""

    code: int

    @property
    def status(self) -> int:
        """The raw OPC UA StatusCode of the tags that were asked for."""
        return int(_EXCEPTIONS[self.code][1]) if self.code in _EXCEPTIONS else int(StatusCode.BAD)

    def __str__(self) -> str:
        text = _EXCEPTIONS[self.code][0] if self.code in _EXCEPTIONS else "not in the standard"
        return f"exception {self.code} ({text})"


def read_request(request: Request) -> bytes:
    """Function 1, 2, 3 or 4."""
    return struct.pack(">BHH", READ[request.table], request.start, request.count)


def write_request(address: Address, registers: bytes, multiple: bool = False) -> bytes:
    """Function 5 for a coil, 6 for one register, 16 for several or where `multiple` asks for it.

    `registers` are the value's bytes in the order of the wire; of a coil, any byte that is not 0 means on.
    """
    if address.table is Table.COIL:
        return struct.pack(">BHH", WRITE_COIL, address.offset, _ON if any(registers) else _OFF)
    if len(registers) == 2 and not multiple:
        return struct.pack(">BH", WRITE_REGISTER, address.offset) + registers
    size = len(registers)
    return struct.pack(">BHHB", WRITE_REGISTERS, address.offset, size // 2, size) + registers


def read_reply(request: bytes, reply: bytes) -> bytes | Refused:
    """The data bytes of the reply to a read request. Raises ProtocolError."""
    refused = _refusal(request, reply)
    if refused is not None:
        return refused
    function, _, count = struct.unpack(">BHH", request)
    size = (count + 7) // 8 if function <= 2 else 2 * count
    if len(reply) < 2 or reply[1] != size or len(reply) != 2 + size:
        announced = f"{reply[1]} announced" if len(reply) > 1 else "none announced"
        raise ProtocolError(f"reply carries {max(len(reply) - 2, 0)} bytes of data ({announced}), {size} were asked for")
    return reply[2:]


def write_reply(request: bytes, reply: bytes) -> int:
    """The raw StatusCode of a write from its reply. Raises ProtocolError.

    Functions 5 and 6 echo the value: a device that echoes another one, as one that clamps does, did not take ours.
    """
    refused = _refusal(request, reply)
    if refused is not None:
        return refused.status
    if len(reply) != 5 or reply[:3] != request[:3]:
        raise ProtocolError(f"reply {reply.hex(' ')} does not answer the write request {request[:5].hex(' ')}")
    if reply[3:5] == request[3:5]:
        return int(StatusCode.GOOD)
    if request[0] == WRITE_REGISTERS:
        raise ProtocolError(f"reply {reply.hex(' ')} does not answer the write request {request[:5].hex(' ')}")
    return int(StatusCode.BAD_OUT_OF_RANGE)


def _refusal(request: bytes, reply: bytes) -> Refused | None:
    function = request[0]
    if reply[0] == function:
        return None
    if reply[0] != function | _EXCEPTION_BIT:
        raise ProtocolError(f"reply has function code {reply[0]}, function {function} was asked for")
    if len(reply) != 2:
        raise ProtocolError(f"exception response has {len(reply)} bytes, expected 2")
    return Refused(reply[1])
