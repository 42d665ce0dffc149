"""A served exchange, a bare client, and what every register must read, decoded without softplc's codec."""

import asyncio
import struct
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from softplc.clock import Clock, VirtualClock
from softplc.exchange import Reader, Writer, size
from softplc.observers.aoi import AoiConfig
from softplc.observers.axes import AxisSpec, axis_tags
from softplc.publishers.modbus.config import ModbusPublisher
from softplc.publishers.modbus.rows import Origin, RegisterMap, RegisterType
from softplc.publishers.modbus.server import ModbusServer
from softplc.scan import source_tags, task_tags
from softplc.snapshot import Snapshot
from softplc.tags import DataType, Image, TagTable
from tests.support.exchange import AXES, OBSERVER, Exchange

WIDTH = {RegisterType.UINT16: 1, RegisterType.UINT32: 2, RegisterType.FLOAT32: 2, RegisterType.INT64: 4}
FORMAT = {RegisterType.UINT16: ">H", RegisterType.UINT32: ">I", RegisterType.FLOAT32: ">f", RegisterType.INT64: ">q"}


def full_table() -> TagTable:
    """What a configuration with one task, one source and two axes publishes, with every tag."""
    table = TagTable()
    table.add_block("main", "task", task_tags("main"))
    table.add_block("plc1", "source", source_tags("plc1"))
    for spec in AXES:
        table.add_block(spec.name, "axis", axis_tags(spec, OBSERVER))
    table.close_section("main")
    return table


def plant(tasks: int = 1, sources: int = 1, axes: int = 2) -> TagTable:
    """Tables of any size: task0, task1 …, all sources and axes in the first."""
    table = TagTable()
    observer = AoiConfig(type="aoi", r_x=1.0)
    for task in range(tasks):
        table.add_block(f"task{task}", "task", task_tags(f"task{task}"))
        if task == 0:
            for source in range(sources):
                table.add_block(f"plc{source}", "source", source_tags(f"plc{source}"))
            for axis in range(axes):
                spec = AxisSpec(f"Axis{axis}")
                table.add_block(spec.name, "axis", axis_tags(spec, observer))
        table.close_section(f"task{task}")
    return table


def full_exchange(clock: Clock | None = None) -> Exchange:
    """An exchange over the full table; every tag Good, every value different and exact in float32."""
    clock = clock or VirtualClock()
    table = full_table()
    buffer = bytearray(size(table))
    exchange = Exchange(table, Image(len(table)), Writer(buffer, table), Reader(buffer, table, clock), clock, buffer)
    for index, tag in enumerate(table):
        double, boolean = tag.data_type is DataType.DOUBLE, tag.data_type is DataType.BOOLEAN
        exchange.set(tag.name, index % 2 if boolean else (1 - index % 2 * 2) * (index + 0.125) if double else index)
    for axis in AXES:
        exchange.set(f"{axis.name}.Age", 0.0625)
        exchange.set(f"{axis.name}.Quality", 2)
    return exchange


def any_port(**fields: Any) -> ModbusPublisher:
    """A publisher's configuration on a port that the system chooses."""
    return ModbusPublisher(type="modbus", **fields).model_copy(update={"port": 0})


@dataclass
class Served:
    """A server that listens, and the exchange behind it."""

    server: ModbusServer
    exchange: Exchange
    port: int


@asynccontextmanager
async def serving(
    exchange: Exchange | None = None, stall_timeout: float = 5.0, give_way: float = 10.0, **fields: Any
) -> AsyncIterator[Served]:
    """Serve an exchange that has published once."""
    exchange = exchange or full_exchange()
    exchange.publish()
    server = ModbusServer(any_port(**fields), exchange.reader, stall_timeout, give_way)
    endpoint = await server.open()
    try:
        yield Served(server, exchange, int(endpoint.rpartition(":")[2]))
    finally:
        await server.close()


def request(address: int, count: int, function: int = 3, unit: int = 1, transaction: int = 1) -> bytes:
    """A read request as the specification has it."""
    return struct.pack(">HHHBBHH", transaction, 0, 6, unit, function, address, count)


class Client:
    """The least Modbus client: frames out, frames in."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    @classmethod
    async def connect(cls, port: int) -> "Client":
        return cls(*await asyncio.open_connection("127.0.0.1", port))

    async def receive(self) -> tuple[int, int, bytes]:
        """The next response: transaction, unit, PDU."""
        transaction, protocol, length, unit = struct.unpack(">HHHB", await self.reader.readexactly(7))
        assert protocol == 0
        return transaction, unit, await self.reader.readexactly(length - 1)

    async def ask(self, frame: bytes) -> tuple[int, int, bytes]:
        """One request and its response."""
        self.writer.write(frame)
        return await self.receive()

    async def read(self, address: int, count: int, function: int = 3) -> bytes:
        """The bytes of so many registers."""
        _, _, pdu = await self.ask(request(address, count, function))
        assert pdu[:2] == bytes([function, 2 * count])
        return pdu[2:]

    async def read_all(self, count: int, function: int = 3) -> bytes:
        """The bytes of the registers from 0, in as many requests as it takes."""
        parts = [await self.read(first, min(125, count - first), function) for first in range(0, count, 125)]
        return b"".join(parts)

    async def closed(self) -> bool:
        """Wait until the server let go; True when no byte came before."""
        try:
            return await asyncio.wait_for(self.reader.read(1), 30) == b""
        except ConnectionResetError:
            return True

    async def close(self) -> None:
        self.writer.close()
        await asyncio.gather(self.writer.wait_closed(), return_exceptions=True)


@asynccontextmanager
async def client_of(served: Served) -> AsyncIterator[Client]:
    """A bare client, closed in the end."""
    client = await Client.connect(served.port)
    try:
        yield client
    finally:
        await client.close()


def to_abcd(raw: bytes, order: str) -> bytes:
    """The bytes of one value, sent in this order, put back as ABCD (longer values alike)."""
    words = [raw[at : at + 2] for at in range(0, len(raw), 2)]
    if order in ("CDAB", "DCBA"):
        words.reverse()
    if order in ("BADC", "DCBA"):
        words = [word[::-1] for word in words]
    return b"".join(words)


def decode(register_map: RegisterMap, registers: bytes, order: str = "ABCD") -> dict[str, float]:
    """Every value of the map out of all its registers, by name."""
    values = {}
    for row in register_map.rows:
        raw = registers[2 * row.address : 2 * (row.address + WIDTH[row.type])]
        values[row.name] = struct.unpack(FORMAT[row.type], to_abcd(raw, order) if len(raw) > 2 else raw)[0]
    return values


def expected(register_map: RegisterMap, snapshot: Snapshot) -> dict[str, float]:
    """What the registers must read for a snapshot without Bad tags, worked out value by value."""
    return {row.name: float(_expected(row, snapshot)) for row in register_map.rows}


def _expected(row: Any, snapshot: Snapshot) -> Any:
    if row.origin is Origin.CONSTANT:
        return np.float32(row.value) if row.type is RegisterType.FLOAT32 else row.value
    if row.origin is Origin.TAG:
        value = snapshot.values[row.index]
        return np.float32(value) if row.type is RegisterType.FLOAT32 else value
    if row.origin is Origin.STATUS:
        return snapshot.statuses[row.index]
    if row.origin is Origin.MILLISECONDS:
        return round(snapshot.values[row.index] * 1000)
    return all(snapshot.alive)


def assert_equal(found: dict[str, float], wanted: dict[str, float], skip: Sequence[str] = ()) -> None:
    """Equal by name, NaN equal to NaN; says which are not."""
    both = [(name, found[name], wanted[name]) for name in wanted if name not in skip]
    assert [
        entry for entry in both if not (entry[1] == entry[2] or (np.isnan(entry[1]) and np.isnan(entry[2])))
    ] == []
