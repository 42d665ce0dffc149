"""The register image: what every value reads as, good or bad, in every byte order."""

import math
import struct
from typing import get_args

import numpy as np
import pytest

from softplc.clock import VirtualClock
from softplc.exchange import Reader, Writer, size
from softplc.publishers.modbus.image import RegisterImage
from softplc.publishers.modbus.layout import layout
from softplc.publishers.modbus.rows import BadValues, ByteOrder
from softplc.sample import AxisState, Reason, StatusCode
from softplc.snapshot import Snapshot
from softplc.tags import DataType, Image, Tag, TagTable
from softplc.timing import Scan
from tests.publishers_modbus.support import assert_equal, decode, expected, full_exchange, full_table
from tests.support.exchange import Exchange

BAD = StatusCode.BAD_NO_COMMUNICATION


class Bench:
    """An exchange with its image and map, and what the registers read after each scan."""

    def __init__(self, byte_order: ByteOrder = "ABCD", bad_values: BadValues = "hold") -> None:
        self.clock = VirtualClock()
        self.exchange: Exchange = full_exchange(self.clock)
        self.map = layout(self.exchange.table, byte_order=byte_order)
        self.image = RegisterImage(self.map, len(self.exchange.table), bad_values)

    def read(self) -> dict[str, float]:
        registers = self.image.encode(self.exchange.reader.snapshot())
        assert len(registers) == 2 * self.map.size
        return decode(self.map, registers, self.map.byte_order)

    def scan(self) -> dict[str, float]:
        self.exchange.publish()
        return self.read()


@pytest.mark.parametrize("byte_order", get_args(ByteOrder))
def test_every_register_reads_its_tag_in_every_byte_order(byte_order: ByteOrder):
    bench = Bench(byte_order)
    found = bench.scan()

    assert_equal(found, expected(bench.map, bench.exchange.reader.snapshot()))


@pytest.mark.parametrize(
    ("byte_order", "bytes_of_one", "bytes_of_negative"),
    [
        ("ABCD", "3f80 0000", "c2f6 e979"),
        ("CDAB", "0000 3f80", "e979 c2f6"),
        ("BADC", "803f 0000", "f6c2 79e9"),
        ("DCBA", "0000 803f", "79e9 f6c2"),
    ],
)
def test_the_check_constants_lie_on_the_wire_as_the_order_says(
    byte_order: ByteOrder, bytes_of_one: str, bytes_of_negative: str
):
    bench = Bench(byte_order)
    registers = bench.image.encode(bench.exchange.reader.snapshot())

    assert bytes.fromhex("1234 0001" + bytes_of_one + bytes_of_negative) == registers[:12]


def test_registers_without_a_row_read_zero():
    bench = Bench()
    bench.exchange.publish()
    registers = np.frombuffer(bench.image.encode(bench.exchange.reader.snapshot()), ">u2").copy()
    for row in bench.map.rows:
        registers[row.address : row.address + row.registers] = 0

    assert not registers.any()


def test_a_snapshot_is_encoded_once():
    bench = Bench()
    bench.exchange.publish()
    first = bench.image.encode(bench.exchange.reader.snapshot())

    assert first is bench.image.encode(bench.exchange.reader.snapshot())
    bench.exchange.publish()
    assert first is not bench.image.encode(bench.exchange.reader.snapshot())


def test_an_image_once_given_never_changes():
    bench = Bench()
    bench.exchange.publish()
    first = bench.image.encode(bench.exchange.reader.snapshot())
    copy = bytes(bytearray(first))
    bench.exchange.set("AxisX.Position", -7.5)
    bench.scan()

    assert copy == first


def test_hold_keeps_the_last_usable_value_beside_the_bad_quality():
    bench = Bench()
    bench.exchange.set("AxisX.Position", 12.5)
    bench.scan()
    bench.exchange.set("AxisX.Position", math.nan, BAD)
    bench.exchange.set("AxisX.Quality", 0)
    found = bench.scan()

    assert (found["AxisX.Position"], found["AxisX.Quality"], found["AxisX.Status"]) == (12.5, 0, BAD)
    bench.exchange.set("AxisX.Position", 13.5)
    assert bench.scan()["AxisX.Position"] == 13.5


def test_nan_shows_a_bad_value_as_nan_and_holds_integers():
    bench = Bench(bad_values="nan")
    bench.exchange.set("AxisX.Enabled", 1)
    bench.scan()
    bench.exchange.set("AxisX.Position", math.nan, BAD)
    bench.exchange.set("AxisX.Enabled", math.nan, BAD)
    found = bench.scan()

    assert math.isnan(found["AxisX.Position"])
    assert found["AxisX.Enabled"] == 1


def test_an_uncertain_value_is_shown():
    bench = Bench()
    bench.exchange.set("AxisX.Position", 3.5, StatusCode.UNCERTAIN_LAST_USABLE_VALUE)
    bench.exchange.set("AxisX.Quality", 1)
    found = bench.scan()

    assert (found["AxisX.Position"], found["AxisX.Quality"]) == (3.5, 1)
    assert found["AxisX.Status"] == StatusCode.UNCERTAIN_LAST_USABLE_VALUE


@pytest.mark.parametrize("bad_values", get_args(BadValues))
def test_before_the_first_scan_floats_read_nan_and_the_reason_is_waiting(bad_values: BadValues):
    bench = Bench(bad_values=bad_values)
    found = bench.read()

    assert all(math.isnan(found[f"AxisX.{leaf}"]) for leaf in ("Position", "Velocity", "Age", "q_x"))
    assert (found["AxisX.Quality"], found["AxisX.Reason"], found["AxisX.AgeMs"]) == (0, Reason.WAITING, 65535)
    assert found["AxisX.Status"] == StatusCode.BAD_WAITING_FOR_INITIAL_DATA
    assert found["AxisX.State"] == AxisState.INIT
    assert (found["Alive"], found["Tasks.main.Alive"], found["Heartbeat"]) == (0, 0, 0)
    assert (found["CheckOne"], found["Axes"]) == (1.0, 2)


def test_a_dead_scan_process_is_quality_0_and_alive_0_and_the_heartbeat_stands_still():
    bench = Bench()
    bench.exchange.set("Sources.plc1.Connected", 1)
    bench.exchange.set("AxisX.Position", 12.5)
    alive = bench.scan()
    bench.clock.advance(1.0)
    dead = bench.read()

    names = ("Alive", "Tasks.main.Alive", "AxisX.Quality", "AxisY.Quality", "Sources.plc1.Connected")
    assert [alive[name] for name in names] == [1, 1, 2, 2, 1]
    assert [dead[name] for name in names] == [0, 0, 0, 0, 0]
    assert tuple(dead[f"AxisX.{n}"] for n in ("Status", "Reason", "AgeMs")) == (BAD, Reason.NO_COMMUNICATION, 65535)
    assert dead["AxisX.State"] == AxisState.FAIL
    assert (12.5, alive["Heartbeat"]) == (dead["AxisX.Position"], dead["Heartbeat"])
    assert bench.scan()["Alive"] == 1


def test_alive_of_the_header_needs_every_task_and_that_of_a_task_only_its_own():
    table = TagTable()
    for name in ("fast", "slow"):
        table.add_block(name, "task", [Tag(f"Tasks.{name}.Heartbeat", data_type=DataType.UINT16)])
        table.close_section(name)
    register_map = layout(table)
    image = RegisterImage(register_map, len(table), "hold")
    arrays = np.array([5.0, 6.0]), np.zeros(2, np.uint32), np.zeros(2, np.int64)
    found = decode(register_map, image.encode(Snapshot(1, *arrays, (None, None), (True, False))))

    assert (found["Alive"], found["Tasks.fast.Alive"], found["Tasks.slow.Alive"]) == (0, 1, 0)
    assert (found["Heartbeat"], found["Tasks.fast.Heartbeat"], found["Tasks.slow.Heartbeat"]) == (5, 5, 6)


@pytest.mark.parametrize(
    ("tag", "value", "reads"),
    [
        ("AxisX.Position", 1e39, math.inf),
        ("AxisX.Position", -1e39, -math.inf),
        ("AxisX.Raw", math.inf, math.inf),
        ("AxisX.Raw", math.nan, math.nan),
        ("AxisX.Position", 0.1, struct.unpack(">f", struct.pack(">f", 0.1))[0]),
        ("AxisX.Position", -0.0, 0.0),
        ("Tasks.main.ScanNumber", 2.0**32 - 1, 2**32 - 1),
        ("Tasks.main.ScanNumber", 2.0**32, 2**32 - 1),
        ("Tasks.main.Heartbeat", 65535, 65535),
        ("AxisX.Reason", 70000, 65535),
        ("AxisX.Reason", -1, 0),
        ("AxisX.Reason", math.nan, 0),
        ("AxisX.Reason", math.inf, 65535),
        ("AxisX.Enabled", 1, 1),
        ("AxisX.Enabled", 17, 1),
    ],
)
def test_values_beyond_their_type_saturate(tag: str, value: float, reads: float):
    bench = Bench()
    if tag == "Tasks.main.Heartbeat":
        bench.exchange.scans = int(value) - 1
    bench.exchange.set(tag, value)

    assert_equal(bench.scan(), {tag: reads})


@pytest.mark.parametrize(
    ("age", "milliseconds"), [(0.0, 0), (0.057, 57), (1.2346, 1235), (65.535, 65535), (1e9, 65535), (math.inf, 65535)]
)
def test_age_in_milliseconds_saturates(age: float, milliseconds: int):
    bench = Bench()
    bench.exchange.set("AxisX.Age", age)

    assert milliseconds == bench.scan()["AxisX.AgeMs"]


@pytest.mark.parametrize("byte_order", get_args(ByteOrder))
@pytest.mark.parametrize(
    ("value", "reads"), [(-5.0, -5), (1e18, 10**18), (1e30, 2**63 - 1024), (-1e30, -(2**63)), (2.0**62, 2**62)]
)
def test_a_value_of_four_registers_follows_the_byte_order_as_well(byte_order: ByteOrder, value: float, reads: int):
    table = TagTable()
    table.add_block(
        "main",
        "task",
        [
            Tag("Tasks.main.Heartbeat", data_type=DataType.UINT16),
            Tag("Tasks.main.Count", data_type=DataType.INT64),
        ],
    )
    table.close_section("main")
    register_map = layout(table, byte_order=byte_order)
    image = RegisterImage(register_map, len(table), "hold")
    arrays = np.array([1.0, value]), np.zeros(2, np.uint32), np.zeros(2, np.int64)
    registers = image.encode(Snapshot(1, *arrays, (None,), (True,)))

    assert reads == decode(register_map, registers, byte_order)["Tasks.main.Count"]


def test_random_snapshots_read_back_exactly():
    """Ten thousand random float32 patterns, NaN and infinities among them, in hold and through the real exchange."""
    random = np.random.default_rng(11)
    clock = VirtualClock()
    table = full_table()
    buffer = bytearray(size(table))
    writer, reader, image = Writer(buffer, table), Reader(buffer, table, clock), Image(len(table))
    register_map = layout(table)
    registers = RegisterImage(register_map, len(table), "hold")
    floats = [(row.address, row.index) for row in register_map.rows if row.type == "float32" and row.origin == "tag"]
    addresses, indices = (np.array(column) for column in zip(*floats, strict=True))
    image.statuses[:] = StatusCode.GOOD
    for number in range(1 + 10_000 // len(floats)):
        wanted = random.integers(0, 2**32, len(table), np.uint64).astype(np.uint32).view(np.float32)
        with np.errstate(invalid="ignore"):  # signalling NaNs are among the patterns
            image.values[:] = wanted
        writer.publish(0, Scan(number, clock.monotonic(), 0, 0.05, 0.05, 0), image)
        words = np.frombuffer(registers.encode(reader.snapshot()), ">u2").astype(np.uint32)
        found = (words[addresses] << 16 | words[addresses + 1]).astype(np.uint32).view(np.float32)

        assert np.array_equal(wanted[indices], found, equal_nan=True)
