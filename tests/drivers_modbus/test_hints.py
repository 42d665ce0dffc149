"""Hints on values that cannot be meant: every order × type × neighbour, and never a hint on what is right."""

import itertools
import math
import struct

import numpy as np
import pytest

from softplc.drivers.modbus.codec import REGISTERS, Decoder, Field, encode
from softplc.drivers.modbus.config import ByteOrder, ModbusTag, ModbusType
from softplc.drivers.modbus.hints import MOST, alternatives, better, candidates, makes_sense
from tests.drivers_modbus.support import tag

ORDERS: tuple[ByteOrder, ...] = ("ABCD", "CDAB", "BADC", "DCBA")
FLOATS: tuple[ModbusType, ...] = ("float32", "float64")
INTEGERS: tuple[ModbusType, ...] = ("int32", "uint32", "int64")
PLAUSIBLE = (0.1, 12.5, 123.456, 499.99, 1234.5678, 3.0)
RANGE = (-2000.0, 2000.0)
FIRST = 20  # register of the value; others of its kind before and behind
Memory = list[int]


def memory(
    data_type: ModbusType, order: ByteOrder, value: float, beside: tuple[float, ...] = (77.25, 310.5)
) -> Memory:
    """Registers of a device with a value between two of its kind, and zeros elsewhere."""
    registers = [0] * 60
    width = REGISTERS[data_type]
    for place, number in ((FIRST - width, beside[0]), (FIRST, value), (FIRST + width, beside[1])):
        registers[place : place + width] = words(number, data_type, order)
    return registers


def words(number: float, data_type: ModbusType, order: ByteOrder) -> list[int]:
    """A number as registers; NaN and infinity, which are never written, too."""
    wire = encode(number, data_type, order)
    if wire is None:
        assert data_type == "float32"
        wire = struct.pack(">f", number)
    return np.frombuffer(wire, ">u2").tolist()


def read(of: ModbusTag, order: ByteOrder, registers: Memory) -> float:
    start = 2 * of.location.offset
    if of.location.table != "holding":
        return math.nan
    wire = np.array(registers, ">u2").view(np.uint8)
    return float(Decoder([Field(start, of.data_type, of.byte_order or order, of.scale, of.offset)]).decode(wire)[0])


def told(
    of: ModbusTag, order: ByteOrder, reads: list[Memory], limits: tuple[float, float] | None
) -> list[str] | None:
    """The hints on a tag; None when it makes sense."""
    values = [read(of, order, registers) for registers in reads]
    if makes_sense(of, values, limits):
        return None
    found = candidates(of, order, values, limits)
    return [each.change for each in found if better(of, each, [read(each.tag, order, r) for r in reads], limits)][
        :MOST
    ]


def two(data_type: ModbusType, order: ByteOrder, value: float) -> list[Memory]:
    """Two reads of a value that moves a little."""
    step = 0.01 * value if data_type in FLOATS else 1.0
    return [memory(data_type, order, number) for number in (value, value + step)]


@pytest.mark.parametrize("limits", [RANGE, None])
@pytest.mark.parametrize("data_type", [*FLOATS, *INTEGERS, "int16", "uint16"])
def test_a_right_configuration_hears_nothing(data_type: ModbusType, limits: tuple[float, float] | None):
    for order, value, sign in itertools.product(ORDERS, (*PLAUSIBLE, 0.0, 1e-3, 1999.0), (1, -1)):
        if data_type not in FLOATS and (value * sign < 0 and data_type[0] == "u"):
            continue
        number = value * sign if data_type in FLOATS else round(value * sign)
        reads = two(data_type, order, max(min(number, 1900), -1900))
        assert told(tag(f"holding:{FIRST}", data_type), order, reads, limits) is None, (order, number)


def test_large_counts_without_a_range_hear_nothing():
    for value in (2**24 + 12345, 305_419_896, 1_000_000_007, -1_234_567_891, 2**31 - 2):
        for order in ORDERS:
            assert told(tag(f"holding:{FIRST}", "int32"), order, two("int32", order, value), None) is None, value


@pytest.mark.parametrize("limits", [RANGE, None])
@pytest.mark.parametrize("data_type", FLOATS)
def test_another_order_of_a_float_is_told_with_the_right_one(data_type: ModbusType, limits):
    missed = []
    for right, wrong, value, sign in itertools.product(ORDERS, ORDERS, PLAUSIBLE, (1, -1)):
        if right == wrong:
            continue
        hints = told(tag(f"holding:{FIRST}", data_type), wrong, two(data_type, right, sign * value), limits)
        if hints is None:
            missed.append((right, wrong, value * sign))  # it reads a number that may be meant
        else:
            assert f"byte_order: {right}" in hints, (right, wrong, value, hints)
    assert len(missed) <= 0.2 * len(ORDERS) * 3 * len(PLAUSIBLE) * 2, missed


@pytest.mark.parametrize("data_type", INTEGERS)
def test_another_order_of_an_integer_is_told(data_type: ModbusType):
    for right, wrong, value in itertools.product(ORDERS, ORDERS, (3, 120, 1234)):
        if right == wrong:
            continue
        of = tag(f"holding:{FIRST}", data_type)
        reads = two(data_type, right, value)
        hints = told(of, wrong, reads, RANGE)
        if hints is None:
            assert all(abs(read(of, wrong, registers)) <= RANGE[1] for registers in reads)  # it may be meant
        else:
            assert f"byte_order: {right}" in hints, (right, wrong, value, hints)
    hints = told(tag(f"holding:{FIRST}", "int32"), "ABCD", two("int32", "CDAB", 1234), None)
    assert hints is not None  # without a range, too
    assert "byte_order: CDAB" in hints


@pytest.mark.parametrize("limits", [RANGE, None])
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("data_type", FLOATS)
@pytest.mark.parametrize("step", [1, -1])
def test_the_register_beside_it_is_told(data_type: ModbusType, order: ByteOrder, step: int, limits):
    for value in PLAUSIBLE:
        hints = told(tag(f"holding:{FIRST - step}", data_type), order, two(data_type, order, value), limits)
        if limits is not None and data_type == "float32":  # half of a double's neighbours are doubles like it
            CAUGHT.append(hints is not None)
        assert not hints or any(hint.startswith(f"address: {40001 + FIRST}") for hint in hints), (value, hints)


CAUGHT: list[bool] = []


def test_most_neighbours_of_a_float_are_caught_where_the_axis_has_a_range():
    assert len(CAUGHT) == 48
    assert sum(CAUGHT) >= 0.5 * len(CAUGHT), sum(CAUGHT)  # as measured


TYPES = [
    ("int16", "float32"),
    ("uint16", "float32"),
    ("int32", "float32"),
    ("float32", "int32"),
    ("float32", "float64"),
]


@pytest.mark.parametrize(("right", "wrong"), TYPES)
def test_another_type_is_told(right: ModbusType, wrong: ModbusType):
    for value in (120.0, 1234.0, 57.0):
        reads = two(right, "ABCD", value)
        hints = told(tag(f"holding:{FIRST}", wrong), "ABCD", reads, RANGE)
        assert hints is not None
        assert f"data_type: {right}" in hints, (value, hints)


def test_a_broken_sensors_nan_or_sentinel_does_not_invent_an_address():
    for value in (math.nan, math.inf, -math.inf):
        registers = memory("float32", "ABCD", value, (0.0, 0.0))
        hints = told(tag(f"holding:{FIRST}"), "ABCD", [registers, registers], None)
        assert hints == [], hints


def test_what_does_not_stay_near_is_no_alternative():
    reads = [memory("float32", "CDAB", value) for value in (10.0, 900.0)]
    hints = told(tag(f"holding:{FIRST}"), "ABCD", reads, (0.0, 1000.0))
    assert hints is not None
    assert "byte_order: CDAB" not in hints


def test_bits_have_no_alternatives():
    assert alternatives(tag("coil:0", "bool"), "ABCD") == []


def test_the_other_table_is_offered_and_the_ends_of_a_table_are_kept():
    changes = [each.change for each in alternatives(tag("holding:0", "int16"), "ABCD")]
    assert "address: 30001 / input:0" in changes
    for each in (*alternatives(tag("holding:0"), "ABCD"), *alternatives(tag("holding:65534"), "ABCD")):
        place = each.tag.location
        assert place.offset >= 0
        assert place.offset + REGISTERS[each.tag.data_type] <= 65536
