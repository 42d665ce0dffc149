"""Configuration of a Modbus source and of a tag in it."""

from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator, model_validator

from softplc.clock import Clock
from softplc.drivers.modbus.address import LAST_OFFSET, Address, parse_address
from softplc.drivers.modbus.codec import REGISTERS, ByteOrder, ModbusType
from softplc.interfaces import Driver
from softplc.model import Model, Name


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

    @model_validator(mode="after")
    def _serial_units(self) -> "ModbusSource":
        if self.unit_id == 0 and not isinstance(self.transport, TcpTransport):
            raise ValueError("unit_id 0 is the broadcast of a serial line, which nobody answers; expected 1 to 247")
        return self

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

    @field_validator("address")
    @classmethod
    def _is_an_address(cls, value: int | str) -> int | str:
        parse_address(value)
        return value

    @field_validator("data_type")
    @classmethod
    def _fits_the_address(cls, value: ModbusType, info: ValidationInfo) -> ModbusType:
        if "address" not in info.data:  # it has an error of its own
            return value
        address = parse_address(info.data["address"])
        if address.table.bits and value != "bool":
            raise ValueError(f"{address} is a single bit, {value} is not; expected bool")
        if not address.table.bits and address.offset + REGISTERS[value] > LAST_OFFSET + 1:
            raise ValueError(f"{value} takes {REGISTERS[value]} registers, {address} leaves fewer to the table's end")
        return value

    @field_validator("byte_order")
    @classmethod
    def _has_an_order(cls, value: ByteOrder | None, info: ValidationInfo) -> ByteOrder | None:
        data_type = info.data.get("data_type")
        if value is not None and data_type is not None and REGISTERS[data_type] == 1:
            raise ValueError(f"{data_type} takes one register and knows no byte order; expected no byte_order here")
        return value

    @field_validator("scale")
    @classmethod
    def _scales(cls, value: float) -> float:
        if value == 0.0:
            raise ValueError("a scale of 0 makes every value the same; expected any other number")
        return value

    @property
    def location(self) -> Address:
        """Table and offset that the address means."""
        return parse_address(self.address)

    def __str__(self) -> str:
        return f"{self.location} {self.data_type}"
