"""Clients that others wrote read every published register, in every byte order, and can write nothing."""

import asyncio
import json
import re
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args

import pytest

from softplc.publishers.modbus.protocol import ILLEGAL_DATA_ADDRESS, ILLEGAL_FUNCTION
from softplc.publishers.modbus.rows import ByteOrder, RegisterType, Row
from tests.publishers_modbus.support import Served, assert_equal, decode, expected, serving
from tests.support.peers import need_npm, need_program

LIBRARIES = ("modbus-serial", "jsmodbus")
SCRIPT = Path(__file__).parent.parent / "peers" / "modbus_client.js"


async def run(*command: str, given: str = "", folder: Path | None = None) -> tuple[int, str, str]:
    """Exit code, standard output and error of a program that ends by itself."""
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(*command, stdin=pipe, stdout=pipe, stderr=pipe, cwd=folder)
    try:
        out, err = await asyncio.wait_for(process.communicate(given.encode()), 90)
    except TimeoutError:
        process.kill()
        await process.wait()
        raise
    return process.returncode or 0, out.decode(), err.decode()


async def node(library: str, served: Served, work: Sequence[Any], unit: int = 1) -> list[dict[str, Any]]:
    """Results of the work, in order."""
    folder = need_npm(library)
    command = ("node", str(SCRIPT), library, str(served.port), str(unit))
    code, out, err = await run(*command, given=json.dumps(work), folder=folder)
    assert (code, err) == (0, "")
    results: list[dict[str, Any]] = json.loads(out)
    return results


def wanted(served: Served) -> dict[str, float]:
    return expected(served.server.map, served.exchange.reader.snapshot())


def chunks(served: Served) -> list[tuple[int, int]]:
    size = served.server.map.size
    return [(first, min(125, size - first)) for first in range(0, size, 125)]


def float_runs(served: Served) -> list[list[Row]]:
    """Floats whose registers follow each other, as an HMI reads them."""
    runs: list[list[Row]] = []
    for row in served.server.map.rows:
        if row.type is RegisterType.FLOAT32:
            if runs and runs[-1][-1].address + 2 == row.address:
                runs[-1].append(row)
            else:
                runs.append([row])
    return runs


@pytest.mark.parametrize("unit", [1, 0, 255])
@pytest.mark.parametrize("library", LIBRARIES)
async def test_npm_clients_read_every_register_of_both_tables(library: str, unit: int):
    async with serving() as served:
        for table in (3, 4):
            work = [("read", table, first, count) for first, count in chunks(served)]
            registers = b"".join(bytes.fromhex(result["hex"]) for result in await node(library, served, work, unit))
            assert_equal(decode(served.server.map, registers), wanted(served))


@pytest.mark.parametrize("byte_order", get_args(ByteOrder))
@pytest.mark.parametrize("library", LIBRARIES)
async def test_npm_clients_decode_every_float_in_the_configured_order(library: str, byte_order: ByteOrder):
    async with serving(byte_order=byte_order) as served:
        runs = float_runs(served)
        work = [("floats", 3 + n % 2, rows[0].address, 2 * len(rows), byte_order) for n, rows in enumerate(runs)]
        results = await node(library, served, work)
        found = {
            row.name: value
            for rows, result in zip(runs, results, strict=True)
            for row, value in zip(rows, result["floats"], strict=True)
        }

        assert_equal(found, {name: value for name, value in wanted(served).items() if name in found})
        assert (1.0, struct.unpack(">f", struct.pack(">f", -123.456))[0]) == (
            found["CheckOne"],
            found["CheckNegative"],
        )


WRITES_OF = {
    "modbus-serial": [
        ("writeCoil", 0, True),
        ("writeRegister", 0, 1),
        ("writeCoils", 0, [True, False]),
        ("writeRegisters", 3000, [1, 2]),
        ("maskWriteRegister", 0, 1, 2),
        ("readWriteRegisters", 0, 1, 0, 1, [1]),
    ],
    "jsmodbus": [
        ("writeSingleCoil", 0, True),
        ("writeSingleRegister", 0, 1),
        ("writeMultipleCoils", 0, [True, False]),
        ("writeMultipleRegisters", 3000, [1, 2]),
    ],
}


@pytest.mark.parametrize("library", LIBRARIES)
async def test_npm_clients_can_write_nothing(library: str):
    async with serving() as served:
        before = served.server.registers()
        results = await node(library, served, [("write", *write) for write in WRITES_OF[library]])

        assert [ILLEGAL_FUNCTION] * len(results) == [result.get("exception") for result in results], results
        assert before == served.server.registers()


@pytest.mark.parametrize("library", LIBRARIES)
async def test_npm_clients_understand_the_exceptions(library: str):
    async with serving() as served:
        size = served.server.map.size
        results = await node(library, served, [("read", 3, size, 1), ("read", 4, size - 1, 2)])
        assert [result.get("exception") for result in results] == [ILLEGAL_DATA_ADDRESS] * 2

        (result,) = await node(library, served, [("read", 3, 0, 1)], unit=9)
        assert result.get("exception") == 0x0B


def mbpoll(served: Served, *options: str) -> tuple[str, ...]:
    return (
        need_program("mbpoll"),
        "-m",
        "tcp",
        "-p",
        str(served.port),
        "-0",
        "-1",
        "-o",
        "10",
        *options,
        "127.0.0.1",
    )


def polled(output: str) -> dict[int, str]:
    """Address → text, as mbpoll prints them."""
    return {int(address): text for address, text in re.findall(r"^\[(\d+)\]:\s+(\S+)", output, re.MULTILINE)}


@pytest.mark.parametrize("table", ["3", "4"])
async def test_mbpoll_reads_every_register(table: str):
    async with serving() as served:
        words: dict[int, str] = {}
        for first, count in chunks(served):
            options = ("-t", f"{table}:hex", "-r", str(first), "-c", str(count))
            code, out, err = await run(*mbpoll(served, *options))
            assert code == 0, err
            words |= polled(out)
        registers = b"".join(int(words[n], 16).to_bytes(2, "big") for n in range(served.server.map.size))

        assert_equal(decode(served.server.map, registers), wanted(served))


@pytest.mark.parametrize(("byte_order", "options"), [("ABCD", ("-B",)), ("CDAB", ())])
@pytest.mark.parametrize("table", ["3", "4"])
async def test_mbpoll_decodes_floats_and_integers_in_its_two_orders(
    table: str, byte_order: ByteOrder, options: tuple[str, ...]
):
    async with serving(byte_order=byte_order) as served:
        found: dict[int, float] = {}
        for rows in float_runs(served):
            asked = ("-t", f"{table}:float", *options, "-r", str(rows[0].address), "-c", str(len(rows)))
            code, out, err = await run(*mbpoll(served, *asked))
            assert code == 0, err
            found |= {address: float(text) for address, text in polled(out).items()}
        values = wanted(served)
        floats = {row.address: values[row.name] for row in served.server.map.rows if row.type is RegisterType.FLOAT32}

        assert floats == pytest.approx(found, rel=1e-5)  # it prints six digits
        _, out, _ = await run(*mbpoll(served, "-t", f"{table}:int", *options, "-r", "102", "-c", "2"))
        assert [values["Tasks.main.ScanNumber"], values["Tasks.main.Overruns"]] == [
            int(n) for n in polled(out).values()
        ]


@pytest.mark.parametrize("write", [("-t", "0", "-r", "0"), ("-t", "4", "-r", "0"), ("-t", "4:float", "-r", "3000")])
async def test_mbpoll_can_write_nothing(write: tuple[str, ...]):
    async with serving() as served:
        before = served.server.registers()
        for values in (("1",), ("1", "0")):
            code, out, err = await run(*mbpoll(served, *write), *values)
            assert code != 0
            assert "Illegal function" in out + err
        assert before == served.server.registers()


async def test_pymodbus_reads_every_register_and_decodes_its_two_orders():
    from pymodbus.client import AsyncModbusTcpClient

    types = AsyncModbusTcpClient.DATATYPE
    of = {RegisterType.FLOAT32: types.FLOAT32, RegisterType.UINT32: types.UINT32, RegisterType.UINT16: types.UINT16}
    for byte_order, word_order in (("ABCD", "big"), ("CDAB", "little")):
        async with serving(byte_order=byte_order) as served:
            client = AsyncModbusTcpClient("127.0.0.1", port=served.port, timeout=20)
            assert await client.connect()
            for read in (client.read_holding_registers, client.read_input_registers):
                words: list[int] = []
                for first, count in chunks(served):
                    words += (await read(first, count=count, device_id=1)).registers
                found = {
                    row.name: client.convert_from_registers(
                        words[row.address : row.address + row.registers], of[row.type], word_order=word_order
                    )
                    for row in served.server.map.rows
                }
                assert_equal(found, wanted(served))
            client.close()


async def test_pymodbus_can_write_nothing_and_understands_the_exceptions():
    from pymodbus.client import AsyncModbusTcpClient

    async with serving() as served:
        before = served.server.registers()
        client = AsyncModbusTcpClient("127.0.0.1", port=served.port, timeout=20)
        assert await client.connect()
        replies = [
            await client.write_coil(0, True),
            await client.write_register(0, 1),
            await client.write_coils(0, [True, False]),
            await client.write_registers(3000, [1, 2]),
            await client.mask_write_register(address=0, and_mask=0, or_mask=1),
            await client.readwrite_registers(read_address=0, read_count=1, write_address=0, values=[1]),
            await client.read_coils(0, count=1),
            await client.read_discrete_inputs(0, count=1),
            await client.read_holding_registers(served.server.map.size, count=1),
            await client.read_holding_registers(0, count=1, device_id=9),
        ]
        client.close()

        assert [reply.exception_code for reply in replies] == [1, 1, 1, 1, 1, 1, 1, 1, 2, 0x0B]
        assert before == served.server.registers()
