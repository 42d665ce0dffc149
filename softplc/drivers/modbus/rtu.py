"""Modbus RTU by pymodbus: its frames with CRC, and its asyncio transport over a serial port.

The only module that imports pymodbus. What is used of it: `FramerRTU` (finds the frame in the bytes, checks the
CRC) and `SerialTransport`; not its client, which takes replies with a wrong function code or too few registers for
good, retries by itself, and does not wake the one who waits when the connection is lost.
"""

import asyncio
import termios
from typing import Final

from pymodbus.framer.rtu import FramerRTU
from pymodbus.pdu import DecodePDU
from pymodbus.transport.serialtransport import SerialTransport

from softplc.drivers.modbus.config import RtuTransport
from softplc.drivers.modbus.pdu import ProtocolError
from softplc.errors import LinkError

_LONGEST: Final = 256  # of a frame, Modbus over Serial Line V1.02, 2.5.1
_BITS: Final = 11  # of a character on the line, 2.5.1.1


class RtuFraming:
    """Frames one request, then takes bytes until its reply is whole.

    A line knows no transaction ids: what comes while nobody asked is noise, or an answer that came too late, and is
    passed over; so are frames of other units.
    """

    drops_unasked: Final = True

    def __init__(self, unit_id: int, pause: float = 0.0) -> None:
        self.pause = pause
        self._unit = unit_id
        self._framer = FramerRTU(DecodePDU(False))
        self._buffer = b""

    def frame(self, pdu: bytes) -> bytes:
        """The bytes of the next request."""
        self._buffer = b""
        return bytes(self._framer.encode(pdu, self._unit, 0))

    def feed(self, data: bytes) -> bytes | None:
        """The reply's PDU when these bytes complete it, None when there is more to come. Raises ProtocolError."""
        self._buffer += data
        used, unit, _, pdu = self._framer.decode(self._buffer)
        if not used:
            if len(self._buffer) > _LONGEST:
                raise ProtocolError(f"{len(self._buffer)} bytes without a frame, the longest frame has {_LONGEST}")
            return None
        if not pdu:
            raise ProtocolError("reply with a wrong checksum (CRC)")
        self._buffer = self._buffer[used:]
        return bytes(pdu) if unit == self._unit else None


def silence(baudrate: int) -> float:
    """Seconds of silence that separate two frames on a line: 3.5 characters, 1.75 ms above 19200 Bd (2.5.1.1)."""
    return 3.5 * _BITS / baudrate if baudrate <= 19200 else 0.00175


def open_serial(port: RtuTransport, protocol: asyncio.Protocol) -> asyncio.Transport:
    """A transport over the serial port, which is ours alone from here. Raises LinkError."""
    try:
        transport = SerialTransport(
            asyncio.get_running_loop(), protocol, port.device, port.baudrate, 8, port.parity, port.stop_bits, 0
        )
    except RuntimeError as error:
        raise LinkError("serial lines need pyserial, which is not installed: pip install pyserial") from error
    except termios.error as error:
        settings = f"{port.baudrate} Bd, parity {port.parity}, {port.stop_bits} stop bits"
        raise LinkError(f"{port.device} does not take {settings}: {error.args[-1]}") from error
    except (OSError, ValueError) as error:
        raise LinkError(f"cannot open {port.device}: {error}") from error
    transport.setup()
    assert isinstance(transport, asyncio.Transport)
    return transport
