"""Sources, tags and peers of the Modbus driver's tests."""

import asyncio
import json
import os
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from pymodbus import FramerType
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from softplc.clock import SystemClock
from softplc.drivers.modbus.config import ModbusSource, ModbusTag, TcpTransport
from softplc.drivers.modbus.driver import ModbusDriver
from softplc.tags import Image
from tests.support.peers import need_npm

GENEROUS = 20_000.0  # ms: no test waits for it, a loaded machine may come near a short one
MODBUS_SERVER_JS = Path(__file__).parent.parent / "peers" / "modbus_server.js"


def source(port: int, **fields: Any) -> ModbusSource:
    """A source on loopback, by TCP unless another transport is given."""
    fields = {
        "transport": TcpTransport(host="127.0.0.1", port=port),
        "timeout_ms": GENEROUS,
        "connect_timeout_ms": GENEROUS,
        **fields,
    }
    return ModbusSource(type="modbus", name="plc", **fields)


def tag(address: int | str, data_type: str = "float32", **fields: Any) -> ModbusTag:
    return ModbusTag(source="plc", address=address, data_type=data_type, **fields)


@asynccontextmanager
async def opened(
    config: ModbusSource, readings: Sequence[ModbusTag], writings: Sequence[ModbusTag] = ()
) -> AsyncIterator[ModbusDriver]:
    """An open driver under the system clock, closed at the end."""
    clock = SystemClock()
    driver = ModbusDriver(config, readings, writings, clock)
    try:
        await driver.open()
        yield driver
    finally:
        await driver.close()
        clock.close()


async def read(driver: ModbusDriver, n: int) -> Image:
    image = Image(n)
    await driver.read(image)
    return image


class Peer:
    """The third-party server of tests/peers/modbus_server.js in a process of its own."""

    def __init__(self, process: asyncio.subprocess.Process, port: int) -> None:
        self._process = process
        self.port = port

    @property
    def pid(self) -> int:
        return self._process.pid

    async def ask(self, op: str, **fields: Any) -> dict[str, Any]:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps({"op": op, **fields}).encode() + b"\n")
        return await _line(self._process)

    async def put(self, table: str, offset: int, value: Any, data_type: str = "bool", order: str = "ABCD") -> None:
        text = str(value).lower() if isinstance(value, bool) else repr(value)
        await self.ask("put", table=table, offset=offset, type=data_type, order=order, value=text)

    async def get(self, table: str, offset: int, data_type: str = "bool", order: str = "ABCD") -> str:
        return (await self.ask("get", table=table, offset=offset, type=data_type, order=order))["value"]

    async def refuse(self, table: str, offset: int, code: int) -> None:
        """Answer this exception wherever the offset is touched; 0 answers it again."""
        await self.ask("refuse", table=table, offset=offset, code=code)

    async def requests(self) -> list[tuple[int, int, int]]:
        """Function, address and count of the requests since this was last asked."""
        return [tuple(request) for request in (await self.ask("requests"))["requests"]]


async def _line(process: asyncio.subprocess.Process) -> dict[str, Any]:
    assert process.stdout is not None
    async with asyncio.timeout(60):
        line = await process.stdout.readline()
    assert line, "the peer ended"
    return json.loads(line)


@asynccontextmanager
async def running_peer() -> AsyncIterator[Peer]:
    """A peer that listens; ended at the end, stopped or not."""
    folder = need_npm("modbus-serial")
    process = await asyncio.create_subprocess_exec(
        "node",
        str(MODBUS_SERVER_JS),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        env={**os.environ, "NODE_PATH": str(folder / "node_modules")},
    )
    try:
        yield Peer(process, (await _line(process))["port"])
    finally:
        process.kill()
        await process.wait()


@asynccontextmanager
async def pymodbus_server(device: SimDevice, framer: FramerType = FramerType.SOCKET) -> AsyncIterator[int]:
    """pymodbus' own TCP server; yields its port."""
    server = ModbusTcpServer(device, framer=framer, address=("127.0.0.1", 0))
    await server.serve_forever(background=True)
    try:
        yield server.transport.sockets[0].getsockname()[1]
    finally:
        await server.shutdown()


def plain_device(unit: int = 1) -> SimDevice:
    """Coils and discrete inputs 0–15, holding and input registers 0–99 with their own numbers, nothing else."""
    return SimDevice(
        id=unit,
        simdata=(
            [SimData(0, values=[i % 3 == 0 for i in range(16)], datatype=DataType.BITS)],
            [SimData(0, values=[i % 2 == 0 for i in range(16)], datatype=DataType.BITS)],
            [SimData(0, values=list(range(100)), datatype=DataType.REGISTERS)],
            [SimData(0, values=list(range(1000, 1100)), datatype=DataType.REGISTERS)],
        ),
    )


def descriptors() -> int:
    """How many files, sockets and ports this process has open."""
    return len(list(Path("/proc/self/fd").iterdir()))
