"""Configuration of a Modbus source and of a tag in it."""

from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import Field

from softplc.clock import Clock
from softplc.drivers.modbus.address import Address, parse_address
from softplc.interfaces import Driver
from softplc.model import Model, Name

ByteOrder = Literal["ABCD", "CDAB", "BADC", "DCBA"]
ModbusType = Literal["bool", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64"]


class TcpTransport(Model):
    """Modbus TCP."""

    type: Literal["tcp"] = "tcp"
    host: str
    port: Annotated[int, Field(ge=1, le=65535)] = 502


class RtuTransport(Model):
    """Modbus RTU over a serial line."""

    type: Literal["rtu"]
    device: str
    """Serial device, as in /dev/ttyUSB0."""
    baudrate: Annotated[int, Field(ge=300, le=1_000_000)] = 19200
    parity: Literal["N", "E", "O"] = "E"
    stop_bits: Literal[1, 2] = 1


class RtuOverTcpTransport(Model):
    """Modbus RTU frames through a TCP socket of a serial gateway."""

    type: Literal["rtu_over_tcp"]
    host: str
    port: Annotated[int, Field(ge=1, le=65535)] = 502


Transport = Annotated[TcpTransport | RtuTransport | RtuOverTcpTransport, Field(discriminator="type")]


class ModbusSource(Model):
    """A PLC or device that speaks Modbus."""

    type: Literal["modbus"]
    name: Name
    transport: Transport
    unit_id: Annotated[int, Field(ge=0, le=255)] = 1
    """Unit (slave, device) id."""
    byte_order: ByteOrder = "ABCD"
    """Order of the bytes of a value in two or more registers; ABCD is big-endian, CDAB swaps the words."""
    max_registers: Annotated[int, Field(ge=1, le=125)] = 125
    """Most registers that the device gives in one request."""
    max_bits: Annotated[int, Field(ge=1, le=2000)] = 2000
    """Most coils or discrete inputs that the device gives in one request."""
    max_gap: Annotated[int, Field(ge=0, le=124)] = 8
    """Unused registers (or bits) that may lie between two tags of one request; 0 reads exactly what is declared."""
    timeout_ms: Annotated[float, Field(ge=10, le=60_000)] = 500.0
    """A request that takes longer means that the link is lost, ms."""
    connect_timeout_ms: Annotated[float, Field(ge=100, le=60_000)] = 4000.0
    """An attempt to connect that takes longer is given up, ms."""

    def build(
        self, readings: Sequence["ModbusTag"], writings: Sequence["ModbusTag"], clock: Clock, period: float
    ) -> Driver:
        """A driver for one connection; imports pymodbus now."""
        from softplc.drivers.modbus.driver import ModbusDriver  # noqa: PLC0415  heavy, and only for this source

        return ModbusDriver(self, readings, writings, clock)


class ModbusTag(Model):
    """One value of a Modbus source."""

    source: Name
    address: int | str
    """`40001` or `400001` (numbered from 1, the first digit names the table), or `holding:0` (from 0)."""
    data_type: ModbusType = "float32"
    byte_order: ByteOrder | None = None
    """Byte order of this tag where it differs from the source's; only for values of two or more registers."""
    scale: float = 1.0
    """Engineering value = raw · scale + offset."""
    offset: float = 0.0

    @property
    def location(self) -> Address:
        """Table and offset that the address means. Raises ValueError where it means none."""
        return parse_address(self.address)

    def __str__(self) -> str:
        """The address in both notations, as far as it is one, and the type."""
        try:
            return f"{self.location} {self.data_type}"
        except ValueError:
            return f"{self.address} {self.data_type}"
