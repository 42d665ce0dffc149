"""libmodbus and pyModbusTCP read every register, can write nothing, and understand every refusal."""

import asyncio
import ctypes

import pytest

from softplc.publishers.modbus.protocol import ILLEGAL_DATA_ADDRESS, ILLEGAL_FUNCTION
from tests.publishers_modbus.support import assert_equal, decode, serving
from tests.publishers_modbus.test_peers import chunks, wanted
from tests.support.libmodbus import LibmodbusClient, need_libmodbus


@pytest.mark.parametrize("unit", [1, 0, 255])
@pytest.mark.parametrize("table", [3, 4])
async def test_libmodbus_reads_every_register(table: int, unit: int):
    modbus = need_libmodbus()
    async with serving() as served:

        def read_all() -> bytes:
            with LibmodbusClient(modbus, served.port, unit) as client:
                return b"".join(client.read(table, first, count) for first, count in chunks(served))

        assert_equal(decode(served.server.map, await asyncio.to_thread(read_all)), wanted(served))


async def test_libmodbus_can_write_nothing_and_understands_the_exceptions():
    modbus = need_libmodbus()
    async with serving() as served:
        before, size = served.server.registers(), served.server.map.size
        words, bits = (ctypes.c_uint16 * 125)(), (ctypes.c_uint8 * 16)()

        def ask() -> list[int]:
            with LibmodbusClient(modbus, served.port) as client:
                refused = [
                    client.exception("write_bit", 0, 1),
                    client.exception("write_register", 0, 1),
                    client.exception("write_bits", 0, 2, bits),
                    client.exception("write_registers", 0, 2, words),
                    client.exception("mask_write_register", 0, 1, 2),
                    client.exception("write_and_read_registers", 0, 1, words, 0, 1, words),
                    client.exception("report_slave_id", 125, words),
                    client.exception("read_bits", 0, 1, bits),
                    client.exception("read_input_bits", 0, 1, bits),
                    client.exception("read_registers", size, 1, words),
                    client.exception("read_input_registers", size - 1, 2, words),
                ]
                client.read(3, 0, 1)  # and the connection goes on
            with LibmodbusClient(modbus, served.port, unit=9) as client:
                return [*refused, client.exception("read_registers", 0, 1, words)]

        assert await asyncio.to_thread(ask) == 9 * [ILLEGAL_FUNCTION] + 2 * [ILLEGAL_DATA_ADDRESS] + [0x0B]
        assert before == served.server.registers()


@pytest.mark.parametrize("unit", [1, 0, 255])
async def test_pymodbustcp_reads_every_register_of_both_tables(unit: int):
    from pyModbusTCP.client import ModbusClient

    async with serving() as served:

        def read_all(table: int) -> bytes:
            client = ModbusClient("127.0.0.1", served.port, unit, timeout=20)
            read = client.read_input_registers if table == 4 else client.read_holding_registers
            words = [word for first, count in chunks(served) for word in read(first, count)]
            client.close()
            return b"".join(word.to_bytes(2, "big") for word in words)

        for table in (3, 4):
            registers = await asyncio.to_thread(read_all, table)
            assert_equal(decode(served.server.map, registers), wanted(served))


async def test_pymodbustcp_can_write_nothing_and_understands_the_exceptions():
    from pyModbusTCP.client import ModbusClient

    async with serving() as served:
        before, size = served.server.registers(), served.server.map.size

        def ask() -> list[int]:
            client = ModbusClient("127.0.0.1", served.port, 1, timeout=20)
            codes = []
            for call, *arguments in (
                (client.write_single_coil, 0, True),
                (client.write_single_register, 0, 1),
                (client.write_multiple_coils, 0, [True, False]),
                (client.write_multiple_registers, 0, [1, 2]),
                (client.write_read_multiple_registers, 0, [1], 0, 1),
                (client.read_coils, 0, 1),
                (client.read_discrete_inputs, 0, 1),
                (client.read_device_identification, 1, 0),
                (client.read_holding_registers, size, 1),
                (client.read_input_registers, size - 1, 2),
            ):
                assert not call(*arguments)
                codes.append(client.last_except)
            assert client.read_holding_registers(0, 1) == [0x1234]
            client.close()
            return codes

        assert await asyncio.to_thread(ask) == 8 * [ILLEGAL_FUNCTION] + 2 * [ILLEGAL_DATA_ADDRESS]
        assert before == served.server.registers()
