"""Configuration of a Modbus source and of a tag in it."""

from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from softplc.clock import Clock
from softplc.drivers.modbus.address import Address, parse_address
from softplc.interfaces import Driver
from softplc.model import Host, Model, Name

ByteOrder = Literal["ABCD", "CDAB", "BADC", "DCBA"]
ModbusType = Literal["bool", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64"]


class TcpTransport(Model):
    """Modbus TCP."""

    type: Literal["tcp"] = "tcp"
    host: Host
    """Where the device is."""
    port: Annotated[int, Field(ge=1, le=65535)] = 502
    """TCP port."""


class RtuTransport(Model):
    """Modbus RTU over a serial line."""

    type: Literal["rtu"]
    device: Annotated[str, Field(min_length=1)]
    """Serial device, as in /dev/ttyUSB0."""
    baudrate: Annotated[int, Field(ge=300, le=1_000_000, json_schema_extra={"x-unit": "bit/s"})] = 19200
    """Speed of the line, bit/s."""
    parity: Literal["N", "E", "O"] = "E"
    """N none, E even, O odd."""
    stop_bits: Literal[1, 2] = 1
    """1, or 2 as is usual without parity."""


class RtuOverTcpTransport(Model):
    """Modbus RTU frames through a TCP socket of a serial gateway."""

    type: Literal["rtu_over_tcp"]
    host: Host
    """Where the serial gateway is."""
    port: Annotated[int, Field(ge=1, le=65535)] = 502
    """TCP port."""


def _tcp_by_default(transport: Any) -> Any:
    """A transport that does not say its type is TCP."""
    return {"type": "tcp", **transport} if isinstance(transport, dict) and "type" not in transport else transport


Transport = Annotated[
    TcpTransport | RtuTransport | RtuOverTcpTransport, Field(discriminator="type"), BeforeValidator(_tcp_by_default)
]


_ADDRESS = {"x-expected": "a Modbus address such as 40001, 400001 or holding:0"}


class ModbusHeartbeat(Model):
    """A value that the PLC's program changes for as long as it runs; what to does not matter."""

    address: Annotated[int | str, Field(json_schema_extra=_ADDRESS)]
    """`40001` or `400001` (numbered from 1, the first digit names the table), or `holding:0` (from 0)."""
    data_type: ModbusType = "uint16"
    """What the registers hold; coils and discrete inputs hold bool."""
    timeout_ms: Annotated[float, Field(ge=10, le=3_600_000)] = 1000.0
    """Unchanged for so long, all samples of the source are Uncertain; for three times as long, Bad, ms."""

    def tag(self, source: str) -> "ModbusTag":
        """The tag that is read for it."""
        return ModbusTag(source=source, address=self.address, data_type=self.data_type)


class ModbusSource(Model):
    """A PLC or device that speaks Modbus."""

    type: Literal["modbus"]
    name: Name
    """How tags refer to it."""
    transport: Transport
    """How it is reached."""
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
    in_flight: Annotated[int, Field(ge=1, le=64)] = 1
    """Most requests that are sent before the first of them is answered; Modbus TCP only."""
    timeout_ms: Annotated[float, Field(ge=10, le=60_000)] = 500.0
    """A request that takes longer means that the link is lost, ms."""
    connect_timeout_ms: Annotated[float, Field(ge=100, le=60_000)] = 4000.0
    """An attempt to connect that takes longer is given up, ms."""
    heartbeat: ModbusHeartbeat | None = None
    """A value that shows that the PLC's program runs; leave it out where there is none."""

    def build(
        self, readings: Sequence["ModbusTag"], writings: Sequence["ModbusTag"], clock: Clock, period: float
    ) -> Driver:
        """A driver for one connection; imports pymodbus now."""
        from softplc.drivers.modbus.driver import ModbusDriver  # noqa: PLC0415  heavy, and only for this source

        return ModbusDriver(self, readings, writings, clock)


class ModbusTag(Model):
    """One value of a Modbus source."""

    source: Name
    """Name of a Modbus source."""
    address: Annotated[int | str, Field(json_schema_extra=_ADDRESS)]
    """`40001` or `400001` (numbered from 1, the first digit names the table), or `holding:0` (from 0)."""
    data_type: ModbusType = "float32"
    """What the registers hold; coils and discrete inputs hold bool."""
    byte_order: ByteOrder | None = None
    """Byte order of this tag where it differs from the source's; only for values of two or more registers."""
    scale: float = 1.0
    """Engineering value = raw · scale + offset; not 0."""
    offset: Annotated[float, Field(json_schema_extra={"x-unit": "unit"})] = 0.0
    """Engineering value at raw 0, in the axis' unit."""

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
