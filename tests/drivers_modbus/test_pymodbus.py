"""The driver against pymodbus' server: TCP, RTU over a serial line (a pair of ptys), RTU through TCP."""

import asyncio
import os
import tty
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest
from pymodbus import FramerType
from pymodbus.server import ModbusSerialServer

from softplc.drivers.modbus.config import RtuOverTcpTransport, RtuTransport
from softplc.errors import LinkError
from softplc.sample import StatusCode
from tests.drivers_modbus.support import descriptors, opened, plain_device, pymodbus_server, read, source, tag
from tests.support.drivers import write_values
from tests.support.network import eventually

TAGS = [
    tag("coil:3", "bool"),
    tag("coil:4", "bool"),
    tag("discrete:2", "bool"),
    tag("holding:7", "uint16"),
    tag("holding:20", "uint32"),
    tag("input:5", "uint16"),
    tag("holding:200", "uint16"),
]
EXPECTED = [1.0, 0.0, 1.0, 7.0, 20 * 65536.0 + 21, 1005.0]


async def assert_reads_and_writes(config) -> None:
    async with opened(config, TAGS, TAGS) as driver:
        image = await read(driver, len(TAGS))
        assert image.values[:6].tolist() == EXPECTED
        assert image.statuses.tolist() == [StatusCode.GOOD] * 6 + [StatusCode.BAD_CONFIGURATION_ERROR]
        assert await write_values(driver, {1: 1.0, 3: 77.0, 4: 3e9}) == dict.fromkeys((1, 3, 4), StatusCode.GOOD)
        image = await read(driver, len(TAGS))
        assert image.values[[1, 3, 4]].tolist() == [1.0, 77.0, 3e9]


@asynccontextmanager
async def serial_line() -> AsyncIterator[tuple[str, str]]:
    """Two serial devices joined by a cable: what is written into one comes out of the other."""
    loop = asyncio.get_running_loop()
    (near, near_port), (far, far_port) = os.openpty(), os.openpty()
    for port in (near_port, far_port):
        tty.setraw(port)
    loop.add_reader(near, lambda: os.write(far, os.read(near, 1024)))
    loop.add_reader(far, lambda: os.write(near, os.read(far, 1024)))
    try:
        yield os.ttyname(near_port), os.ttyname(far_port)
    finally:
        for end in (near, far):
            loop.remove_reader(end)
        for end in (near, far, near_port, far_port):
            os.close(end)


@asynccontextmanager
async def serial_server(device: str, unit: int) -> AsyncIterator[None]:
    server = ModbusSerialServer(plain_device(unit), port=device, baudrate=115200, parity="N")
    await server.serve_forever(background=True)
    try:
        yield
    finally:
        await server.shutdown()


def serial(device: str, parity: str = "N", **fields):
    """A source on a serial device; a pty has no parity bit."""
    return source(1, transport=RtuTransport(type="rtu", device=device, baudrate=115200, parity=parity), **fields)


async def test_tcp_reads_and_writes_every_table():
    async with pymodbus_server(plain_device()) as port:
        await assert_reads_and_writes(source(port))


async def test_rtu_over_a_serial_line_reads_and_writes_every_table():
    async with serial_line() as (near, far), serial_server(far, unit=5):
        await assert_reads_and_writes(serial(near, unit_id=5))


async def test_rtu_through_tcp_reads_and_writes_every_table():
    async with pymodbus_server(plain_device(unit=9), framer=FramerType.RTU) as port:
        await assert_reads_and_writes(
            source(1, transport=RtuOverTcpTransport(type="rtu_over_tcp", host="127.0.0.1", port=port), unit_id=9)
        )


async def test_a_silent_serial_line_is_a_lost_link_and_the_port_can_be_opened_again():
    async with serial_line() as (near, far):
        with pytest.raises(LinkError, match=rf"{near}: no reply within 0\.1 s"):
            async with opened(serial(near, timeout_ms=100.0), TAGS):
                pass
        async with serial_server(far, unit=1), opened(serial(near), TAGS[:1]) as driver:
            assert (await read(driver, 1)).values.tolist() == [1.0]


async def test_twenty_openings_of_a_serial_port_leave_no_tasks_and_no_file_descriptors():
    async with serial_line() as (near, far), serial_server(far, unit=1):
        before = descriptors(), len(asyncio.all_tasks())
        for _ in range(20):
            async with opened(serial(near), TAGS) as driver:
                await read(driver, len(TAGS))
        await eventually(lambda: (descriptors(), len(asyncio.all_tasks())) == before)


async def test_a_serial_port_that_another_one_holds_is_refused():
    async with serial_line() as (near, far), serial_server(far, unit=1), opened(serial(near), TAGS):
        with pytest.raises(LinkError, match=f"cannot open {near}"):
            async with opened(serial(near), TAGS):
                pass


async def test_a_serial_port_that_is_not_there_is_named():
    with pytest.raises(LinkError, match="cannot open /dev/ttyNone"):
        async with opened(serial("/dev/ttyNone"), TAGS):
            pass


async def test_settings_that_a_serial_port_does_not_take_are_named():
    async with serial_line() as (near, _):
        with pytest.raises(LinkError, match=f"{near} does not take 115200 Bd, parity E, 1 stop bits"):
            async with opened(serial(near, parity="E"), TAGS):
                pass
