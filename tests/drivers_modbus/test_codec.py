"""Registers ↔ engineering values, against struct and byte patterns written out by hand."""

import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from softplc.drivers.modbus.codec import REGISTERS, Decoder, Field, encode

ORDERS = ("ABCD", "CDAB", "BADC", "DCBA")
WIRE_32 = dict(zip(ORDERS, ORDERS, strict=True))  # the name of a 32-bit order is its picture
WIRE_64 = {"ABCD": "ABCDEFGH", "CDAB": "GHEFCDAB", "BADC": "BADCFEHG", "DCBA": "HGFEDCBA"}
STRUCT = {
    "int16": ">h",
    "uint16": ">H",
    "int32": ">i",
    "uint32": ">I",
    "int64": ">q",
    "uint64": ">Q",
    "float32": ">f",
    "float64": ">d",
}
INTEGERS = [name for name in STRUCT if "int" in name]
VALUES = {
    "int16": [0, 1, -1, -32768, 32767, -12345],
    "uint16": [0, 1, 65535, 0x1234],
    "int32": [0, -1, -(2**31), 2**31 - 1, 0x01020304],
    "uint32": [0, 2**32 - 1, 0x01020304],
    "int64": [0, -1, -(2**63), 2**53, -(2**53), 0x0102030405060708 >> 4],
    "uint64": [0, 2**53, 0x000A020304050607],
    "float32": [0.0, -0.0, 1.0, -123.456, 3.4028234663852886e38, 1e-45, math.inf, -math.inf, math.nan],
    "float64": [0.0, -123.456, 1.7976931348623157e308, 5e-324, math.inf, math.nan],
}


def on_the_wire(plain: bytes, order: str) -> bytes:
    """Big-endian bytes put in the order that the table of the codec's docstring draws."""
    if len(plain) == 2:
        return plain
    picture = (WIRE_32 if len(plain) == 4 else WIRE_64)[order]
    return bytes(plain[ord(letter) - ord("A")] for letter in picture)


def decode(wire: bytes, *fields: Field) -> list[float]:
    return Decoder(fields).decode(np.frombuffer(wire, np.uint8)).tolist()


CASES = [(name, order, value) for name in STRUCT for order in ORDERS for value in VALUES[name]]


@pytest.mark.parametrize(("name", "order", "value"), CASES)
def test_every_type_and_order_decodes_what_struct_packed(name, order, value):
    plain = struct.pack(STRUCT[name], value)
    expected = float(struct.unpack(STRUCT[name], plain)[0])

    (decoded,) = decode(b"\xff" + on_the_wire(plain, order) + b"\xff", Field(1, name, order))

    assert struct.pack(">d", decoded) == struct.pack(">d", expected)  # bit for bit: -0.0 and NaN too


@pytest.mark.parametrize(("name", "order", "value"), [case for case in CASES if math.isfinite(case[2])])
def test_every_type_and_order_encodes_to_the_bytes_of_struct(name, order, value):
    assert encode(value, name, order) == on_the_wire(struct.pack(STRUCT[name], value), order)


@pytest.mark.parametrize(
    ("wire", "name", "order", "value"),
    [
        ("3f800000", "float32", "ABCD", 1.0),
        ("00003f80", "float32", "CDAB", 1.0),
        ("803f0000", "float32", "BADC", 1.0),
        ("0000803f", "float32", "DCBA", 1.0),
        ("c2f6e979", "float32", "ABCD", struct.unpack(">f", struct.pack(">f", -123.456))[0]),
        ("e979c2f6", "float32", "CDAB", struct.unpack(">f", struct.pack(">f", -123.456))[0]),
        ("00010000", "int32", "ABCD", 65536),
        ("00010000", "int32", "CDAB", 1),
        ("00010000", "int32", "BADC", 2**24),
        ("00010000", "int32", "DCBA", 256),
        ("3ff0000000000000", "float64", "ABCD", 1.0),
        ("0000000000003ff0", "float64", "CDAB", 1.0),
        ("f03f000000000000", "float64", "BADC", 1.0),
        ("000000000000f03f", "float64", "DCBA", 1.0),
        ("0001000200030004", "uint64", "ABCD", 0x0001000200030004),
        ("0004000300020001", "uint64", "CDAB", 0x0001000200030004),
        ("0100020003000400", "uint64", "BADC", 0x0001000200030004),
        ("0400030002000100", "uint64", "DCBA", 0x0001000200030004),
        ("ff85", "int16", "DCBA", -123),
    ],
)
def test_known_byte_patterns(wire, name, order, value):
    assert decode(bytes.fromhex(wire), Field(0, name, order)) == [value]
    assert encode(value, name, order) == bytes.fromhex(wire)


def test_a_bool_is_a_bit_or_a_register_that_is_not_zero():
    wire = bytes([0b1000_0001, 0b0000_0010, 0x00, 0x00, 0x01, 0x00])

    bits = [Field(i // 8, "bool", bit=i % 8) for i in range(16)]
    registers = [Field(2, "bool"), Field(4, "bool", "DCBA")]

    assert decode(wire, *bits) == [1, 0, 0, 0, 0, 0, 0, 1, 0, 1, 0, 0, 0, 0, 0, 0]
    assert decode(wire, *registers) == [0, 1]
    assert encode(0.0, "bool", "ABCD") == b"\x00\x00"
    assert encode(-0.5, "bool", "ABCD") == b"\x00\x01"


def test_scale_and_offset_apply_both_ways():
    assert decode(b"\xff\x9c", Field(0, "int16", scale=0.01, offset=20.0)) == [-100 * 0.01 + 20.0]
    assert decode(b"\x01", Field(0, "bool", bit=0, scale=-1.0, offset=1.0)) == [0.0]
    assert encode(19.0, "int16", "ABCD", scale=0.01, offset=20.0) == b"\xff\x9c"


@pytest.mark.parametrize(
    ("value", "name"),
    [
        (32768, "int16"),
        (-32769, "int16"),
        (32767.5, "int16"),
        (-1, "uint16"),
        (65536, "uint16"),
        (2.0**31, "int32"),
        (-1, "uint32"),
        (2.0**63, "int64"),
        (2.0**64, "uint64"),
        (1e39, "float32"),
        (math.nan, "float32"),
        (math.inf, "float64"),
        (math.nan, "int16"),
        (-math.inf, "bool"),
    ],
)
def test_a_value_that_the_type_cannot_hold_is_not_encoded(value, name):
    assert encode(value, name, "ABCD") is None


def test_a_quotient_that_overflows_is_not_encoded():
    assert encode(1e300, "float64", "ABCD", scale=1e-300) is None


def test_integers_round_to_nearest_halves_to_even():
    assert [encode(v, "int16", "ABCD")[1] for v in (0.5, 1.5, 2.4, 2.5, 2.6)] == [0, 2, 2, 2, 3]


def test_integers_beyond_2_to_the_53_become_the_nearest_float64():
    wire = struct.pack(">Qq", 2**53 + 1, -(2**63))

    assert decode(wire, Field(0, "uint64"), Field(8, "int64")) == [2.0**53, -(2.0**63)]


@given(st.data(), st.sampled_from(list(REGISTERS)), st.sampled_from(ORDERS))
def test_what_is_encoded_decodes_to_the_same_value(data, name, order):
    scale = data.draw(st.sampled_from([1.0, 0.01, -4.0]))
    offset = data.draw(st.sampled_from([0.0, 100.0]))
    raw = data.draw(_raw_values(name))
    value = raw * scale + offset

    wire = encode(value, name, order, scale, offset)

    assert wire is not None
    assert len(wire) == 2 * REGISTERS[name]
    (back,) = decode(wire, Field(0, name, order, scale, offset))
    # The engineering value carries the rounding of two float64 operations; float32 rounds the raw value to 24 bits.
    step = abs(scale) * (abs(raw) * 2.0**-23 if name == "float32" else abs(raw) * 2.0**-50)
    assert back == pytest.approx(value, rel=2.0**-50, abs=step + 1e-13)


def _raw_values(name: str) -> st.SearchStrategy[float]:
    if name == "bool":
        return st.sampled_from([0.0, 1.0])
    if name.startswith("float"):
        return st.floats(-(2.0**100), 2.0**100, width=32 if name == "float32" else 64)
    bits = min(16 * REGISTERS[name] - (name.startswith("int")), 53)
    low = -(2**bits) if name.startswith("int") and bits < 53 else 0
    return st.integers(low + 1, 2**bits - 1).map(float)


@given(st.lists(st.tuples(st.sampled_from(list(STRUCT)), st.sampled_from(ORDERS), st.binary(min_size=8, max_size=8))))
def test_a_mixture_of_fields_decodes_each_as_if_it_were_alone(parts):
    wire = b"".join(data for _, _, data in parts)
    fields = [Field(8 * i, name, order) for i, (name, order, _) in enumerate(parts)]

    together = decode(wire, *fields)

    for value, (name, order, data) in zip(together, parts, strict=True):
        width = struct.calcsize(STRUCT[name])
        plain = on_the_wire(data[:width], order)  # every order is its own inverse
        expected = float(struct.unpack(STRUCT[name], plain)[0])
        assert value == expected or (math.isnan(value) and math.isnan(expected))
