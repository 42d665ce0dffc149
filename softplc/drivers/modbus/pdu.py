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

ILLEGAL_ADDRESS: Final = 2
ILLEGAL_VALUE: Final = 3

_ON, _OFF = 0xFF00, 0x0000
_EXCEPTION_BIT: Final = 0x80

_STATUS_OF_EXCEPTION: Final = {
    1: StatusCode.BAD_NOT_SUPPORTED,  # illegal function
    2: StatusCode.BAD_CONFIGURATION_ERROR,  # illegal data address
    3: StatusCode.BAD_CONFIGURATION_ERROR,  # illegal data value
    4: StatusCode.BAD_DEVICE_FAILURE,  # server device failure
    5: StatusCode.BAD_RESOURCE_UNAVAILABLE,  # acknowledge: still busy with it
    6: StatusCode.BAD_RESOURCE_UNAVAILABLE,  # server device busy
    7: StatusCode.BAD_NOT_SUPPORTED,  # negative acknowledge
    8: StatusCode.BAD_DEVICE_FAILURE,  # memory parity error
    10: StatusCode.BAD_NO_COMMUNICATION,  # gateway path unavailable
    11: StatusCode.BAD_NO_COMMUNICATION,  # gateway target failed to respond
}


class ProtocolError(LinkError):
    """The device answered against the protocol, or with the answer to something else."""


class MixedUpError(ProtocolError):
    """A reply carries the transaction id of no request that is outstanding."""


_EXCEPTION_NAMES: Final = {
    1: "illegal function",
    2: "illegal data address",
    3: "illegal data value",
    4: "server device failure",
    5: "acknowledge",
    6: "server device busy",
    8: "memory parity error",
    10: "gateway path unavailable",
    11: "gateway target device failed to respond",
}
"""Modbus application protocol V1.1b3, section 7."""


@dataclass(frozen=True, slots=True)
class Refused:
    """The device answered that it will not: the exception code of its reply."""

    code: int

    def __str__(self) -> str:
        return f"exception {self.code}, {_EXCEPTION_NAMES.get(self.code, 'of its own')}"

    @property
    def status(self) -> int:
        """The raw OPC UA StatusCode of the tags that were asked for."""
        return int(_STATUS_OF_EXCEPTION.get(self.code, StatusCode.BAD))


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
        raise ProtocolError(
            f"reply carries {max(len(reply) - 2, 0)} bytes of data ({announced}), {size} were asked for"
        )
    return reply[2:]


def write_reply(request: bytes, reply: bytes) -> int:
    """The raw StatusCode of a write from its reply. Raises ProtocolError.

    Functions 5 and 6 echo the value: a device that echoes another one, as one that clamps does, did not take ours.
    """
    refused = _refusal(request, reply)
    if refused is not None:
        return refused.status
    if reply == request[:5]:
        return int(StatusCode.GOOD)
    if len(reply) == 5 and reply[:3] == request[:3] and request[0] != WRITE_REGISTERS:
        return int(StatusCode.BAD_OUT_OF_RANGE)
    raise ProtocolError(f"reply {reply.hex(' ')} does not answer the write request {request[:5].hex(' ')}")


def _refusal(request: bytes, reply: bytes) -> Refused | None:
    function = request[0]
    if not reply:
        raise ProtocolError("reply is empty")
    if reply[0] == function:
        return None
    if reply[0] != function | _EXCEPTION_BIT:
        raise ProtocolError(f"reply has function code {reply[0]}, function {function} was asked for")
    if len(reply) != 2:
        raise ProtocolError(f"exception response has {len(reply)} bytes, expected 2")
    return Refused(reply[1])
