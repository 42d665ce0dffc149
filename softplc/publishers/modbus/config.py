"""Configuration of the Modbus server."""

from typing import Annotated, Literal

from pydantic import Field

from softplc.exchange import Reader
from softplc.interfaces import Publisher
from softplc.model import Host, Model, Name


class AxisPlacement(Model):
    """A fixed place in the register map for one axis."""

    axis: Name
    """Name of the axis."""
    address: Annotated[int, Field(ge=0, le=65535, multiple_of=2)]
    """First register of the axis' block, from 0; even, so that floats lie at even offsets."""


class ModbusPublisher(Model):
    """Modbus TCP server with every published tag, read-only."""

    type: Literal["modbus"]
    host: Host = "127.0.0.1"
    """Address to listen on; 0.0.0.0 for all."""
    port: Annotated[int, Field(ge=1, le=65535)] = 5020
    """TCP port; below 1024 it needs permission."""
    unit_id: Annotated[int, Field(ge=1, le=247)] = 1
    """Unit id that is answered; 0 and 255 are answered as well."""
    byte_order: Literal["ABCD", "CDAB", "BADC", "DCBA"] = "ABCD"
    """Order of the bytes of values in two registers."""
    bad_values: Literal["hold", "nan"] = "hold"
    """What a Bad value reads as: the last usable one beside quality 0, or NaN."""
    placements: tuple[AxisPlacement, ...] = ()
    """Axes that need a fixed place; the others follow in the order of the file."""
    max_clients: Annotated[int, Field(ge=1, le=1000)] = 32
    """Connections at the same time; beyond them there is one more for an address that has none."""
    max_clients_per_address: Annotated[int, Field(ge=1, le=1000)] = 16
    """Connections at the same time from one address."""
    idle_timeout_s: Annotated[float, Field(ge=1, le=86_400)] = 600.0
    """A client that asks nothing for so long is disconnected, s."""

    def build(self, reader: Reader) -> Publisher:
        """The server."""
        from softplc.publishers.modbus.server import ModbusServer  # noqa: PLC0415  only where it is served

        return ModbusServer(self, reader)
