import re
import struct
import subprocess
from collections.abc import AsyncIterator, Iterator

import pytest
import pytest_asyncio
from pymodbus.client import AsyncModbusTcpClient
from pymodbus.client.mixin import ModbusClientMixin

from softplc.emulator.plant import Plant
from tests.emulator.scenarios import Emulator, emulator, scenario
from tests.support.network import eventually
from tests.support.peers import need_program

# Ramps of an hour: the true position alone tells the step.
PLC = scenario(
    {"name": "AxisX", "motion": {"type": "ramp_hold", "slope": 10.0, "segment_s": 3600.0}},
    {"name": "AxisY", "motion": {"type": "ramp_hold", "slope": -5.0, "segment_s": 3600.0}},
    {"name": "AxisZ", "motion": {"type": "constant", "value": -123.456}, "noise": {"type": "none"}},
    modbus={"port": 0, "byte_order": "CDAB"},
)
FLOAT32 = ModbusClientMixin.DATATYPE.FLOAT32
INT32 = ModbusClientMixin.DATATYPE.INT32


@pytest.fixture(scope="module")
def plc() -> Iterator[Emulator]:
    with emulator(PLC) as running:
        yield running


@pytest_asyncio.fixture
async def client(plc: Emulator) -> AsyncIterator[AsyncModbusTcpClient]:
    async with AsyncModbusTcpClient("127.0.0.1", port=plc.port("modbus"), timeout=30) as connected:
        yield connected


def mbpoll(plc: Emulator, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Debian's mbpoll, an independent client; its 32-bit values have the low word first unless told -B: CDAB."""
    command = [need_program("mbpoll"), "-m", "tcp", "-p", str(plc.port("modbus")), "-1", "-o", "10", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def polled(plc: Emulator, *arguments: str) -> list[float]:
    """The values that mbpoll reads, of lines as `[101]: <tab>-1.64002`."""
    result = mbpoll(plc, *arguments, "127.0.0.1")
    assert result.returncode == 0, result.stderr
    return [float(value.split()[0]) for value in re.findall(r"^\[\d+\]: \t(.*)$", result.stdout, re.MULTILINE)]


async def test_one_read_sees_one_step_of_the_plant_in_truth_measurement_and_count(client: AsyncModbusTcpClient):
    plant = Plant(PLC)
    steps: set[int] = set()

    def decoded(words: list[int], kind: ModbusClientMixin.DATATYPE) -> float:
        return client.convert_from_registers(words, kind, word_order="little")

    while len(steps) < 10:
        words = (await client.read_holding_registers(100, count=40, device_id=1)).registers
        step = plant.at(round(decoded(words[2:4], FLOAT32) / 0.5))
        steps.add(step.number)
        for axis, at in zip(step.axes[:2], (0, 20), strict=True):
            floats = [decoded(words[at + k : at + k + 2], FLOAT32) for k in (0, 2, 4)]
            # 1e-6: float32
            assert floats == pytest.approx([axis.position, axis.true_position, axis.true_velocity], rel=1e-6)
            assert decoded(words[at + 6 : at + 8], INT32) == axis.count
            assert words[at + 12] == 2


async def test_the_heartbeat_counts_steps_and_the_header_tells_the_byte_order(client: AsyncModbusTcpClient):
    words = (await client.read_holding_registers(0, count=20, device_id=1)).registers

    assert words[0] == words[2] and words[3] == 0  # the step, low word first
    assert words[1] == 3
    assert words[4] == 0x1234
    assert words[6:10] == [0x0000, 0x3F80, 0xE979, 0xC2F6]
    seen = {words[0]}
    while len(seen) < 5:
        seen.add((await client.read_holding_registers(0, count=1, device_id=1)).registers[0])


async def test_input_registers_and_discrete_inputs_mirror_holding_registers_and_coils(client: AsyncModbusTcpClient):
    await client.write_coil(2, False, device_id=1)

    assert (await client.read_input_registers(140, count=20, device_id=1)).registers == (
        await client.read_holding_registers(140, count=20, device_id=1)
    ).registers
    assert (await client.read_discrete_inputs(0, count=3, device_id=1)).bits[:3] == [True, True, False]
    assert (await client.read_coils(0, count=3, device_id=1)).bits[:3] == [True, True, False]
    await client.write_coil(2, True, device_id=1)


async def test_write_back_registers_and_coils_are_writable(client: AsyncModbusTcpClient):
    words = list(struct.unpack(">HH", struct.pack(">f", 12.25)))[::-1]

    assert not (await client.write_registers(108, words, device_id=1)).isError()
    assert (await client.read_holding_registers(108, count=2, device_id=1)).registers == words
    assert not (await client.write_registers(128, words + words, device_id=1)).isError()
    assert (await client.read_input_registers(128, count=4, device_id=1)).registers == words + words
    assert not (await client.write_coils(0, [False, True, False], device_id=1)).isError()
    assert (await client.read_coils(0, count=3, device_id=1)).bits[:3] == [False, True, False]
    assert not (await client.write_coils(0, [True] * 3, device_id=1)).isError()


async def test_what_was_written_outlives_the_next_steps(client: AsyncModbusTcpClient):
    await client.write_registers(150, [0x0000, 0x4000], device_id=1)
    start = (await client.read_holding_registers(0, count=1, device_id=1)).registers[0]

    while (await client.read_holding_registers(0, count=1, device_id=1)).registers[0] - start < 3:
        assert (await client.read_holding_registers(150, count=2, device_id=1)).registers == [0x0000, 0x4000]


@pytest.mark.parametrize("address", [0, 4, 100, 106, 107, 112, 119])
async def test_nothing_else_is_writable(client: AsyncModbusTcpClient, address: int):
    before = (await client.read_holding_registers(140, count=20, device_id=1)).registers

    assert (await client.write_register(address, 7, device_id=1)).exception_code == 2
    assert (await client.write_registers(address, [7, 7], device_id=1)).exception_code == 2
    assert (await client.read_holding_registers(140, count=20, device_id=1)).registers == before


async def test_a_write_that_runs_over_read_only_registers_changes_nothing(client: AsyncModbusTcpClient):
    before = (await client.read_holding_registers(108, count=4, device_id=1)).registers

    assert (await client.write_registers(108, [1] * 5, device_id=1)).exception_code == 2
    assert (await client.read_holding_registers(108, count=4, device_id=1)).registers == before


@pytest.mark.parametrize(("address", "count"), [(20, 1), (19, 2), (99, 1), (98, 4), (160, 1), (159, 2), (65535, 1)])
async def test_registers_that_do_not_exist_answer_exception_2(client: AsyncModbusTcpClient, address: int, count: int):
    for read in (client.read_holding_registers, client.read_input_registers):
        assert (await read(address, count=count, device_id=1)).exception_code == 2


async def test_coils_without_an_axis_are_not_writable(client: AsyncModbusTcpClient):
    assert (await client.write_coil(3, False, device_id=1)).exception_code == 2
    assert (await client.write_coils(2, [False, False], device_id=1)).exception_code == 2
    assert (await client.read_coils(2, count=1, device_id=1)).bits[0] is True
    assert (await client.read_coils(16, count=1, device_id=1)).exception_code == 2


async def test_every_unit_id_is_answered(client: AsyncModbusTcpClient):
    for unit in (0, 1, 17, 255):
        assert (await client.read_holding_registers(4, device_id=unit)).registers == [0x1234]


def test_mbpoll_reads_the_truth_and_a_measurement_within_the_noise(plc: Emulator):
    position, truth, velocity = polled(plc, "-t", "4:float", "-r", "101", "-c", "3")

    # 1e-4: mbpoll prints six digits
    assert truth / 0.5 == pytest.approx(round(truth / 0.5), rel=1e-4)
    assert abs(position - truth) <= 2.0 + 1e-4 * abs(truth)
    assert velocity == 10.0
    assert polled(plc, "-t", "3:float", "-r", "141", "-c", "3") == [pytest.approx(-123.456)] * 2 + [0.0]
    assert polled(plc, "-t", "4:int", "-r", "147", "-c", "1") == [-123_456]


def test_mbpoll_writes_a_float_and_reads_it_back_but_not_into_the_measurement(plc: Emulator):
    written = mbpoll(plc, "-t", "4:float", "-r", "149", "127.0.0.1", "2.5")
    refused = mbpoll(plc, "-t", "4:float", "-r", "141", "127.0.0.1", "2.5")

    assert written.returncode == 0, written.stderr
    assert polled(plc, "-t", "4:float", "-r", "149", "-c", "1") == [2.5]
    assert "Illegal data address" in refused.stderr
    assert polled(plc, "-t", "4:float", "-r", "141", "-c", "1") == [pytest.approx(-123.456)]


async def test_several_clients_are_served(plc: Emulator):
    clients = [AsyncModbusTcpClient("127.0.0.1", port=plc.port("modbus"), timeout=30) for _ in range(20)]
    for one in clients:
        assert await one.connect()
    await eventually(lambda: all(one.connected for one in clients))
    for one in clients:
        assert (await one.read_holding_registers(4, device_id=1)).registers == [0x1234]
        one.close()
