"""Registers and bits ↔ engineering values: engineering value = raw · scale + offset. Pure.

A register travels as two bytes, high byte first. A value of several registers has its most significant byte A
first and register 0 lowest; the byte orders say where each byte of the value is found on the wire:

| order | 32 bit   | 64 bit           | meaning                                              |
|-------|----------|------------------|------------------------------------------------------|
| ABCD  | A B C D  | A B C D E F G H  | big-endian                                           |
| CDAB  | C D A B  | G H E F C D A B  | the order of the words (registers) reversed          |
| BADC  | B A D C  | B A D C F E H G  | the two bytes within each word swapped               |
| DCBA  | D C B A  | H G F E D C B A  | all bytes reversed: little-endian                    |

Values of one register know no order. A bool is a bit of the coils or discrete inputs, or a register that is not 0.
Every value becomes a float64, which holds integers exactly up to 2⁵³ = 9 007 199 254 740 992: of an int64 or
uint64 beyond that, the nearest float64 is given.
"""

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

ByteOrder = Literal["ABCD", "CDAB", "BADC", "DCBA"]
ModbusType = Literal["bool", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64"]

REGISTERS: Final[dict[ModbusType, int]] = {
    "bool": 1,
    "int16": 1,
    "uint16": 1,
    "int32": 2,
    "uint32": 2,
    "int64": 4,
    "uint64": 4,
    "float32": 2,
    "float64": 4,
}
"""How many registers a value of each type takes; in the coils and discrete inputs a bool takes one bit."""

_FORMAT: Final[dict[ModbusType, str]] = {
    "bool": ">H",
    "int16": ">h",
    "uint16": ">H",
    "int32": ">i",
    "uint32": ">I",
    "int64": ">q",
    "uint64": ">Q",
    "float32": ">f",
    "float64": ">d",
}
"""Each type in ABCD, for struct and for numpy."""


def byte_positions(order: ByteOrder, registers: int) -> tuple[int, ...]:
    """For each byte of a value, most significant first: where it lies on the wire. Each order is its own inverse."""
    width = 2 * registers
    if registers == 1 or order == "ABCD":
        return tuple(range(width))
    if order == "CDAB":
        return tuple(width - 2 - i + 2 * (i % 2) for i in range(width))
    if order == "BADC":
        return tuple(i ^ 1 for i in range(width))
    return tuple(range(width - 1, -1, -1))


def encode(value: float, data_type: ModbusType, order: ByteOrder, scale: float = 1.0, offset: float = 0.0) -> bytes | None:
    """The registers of an engineering value as they travel on the wire; None when the type cannot hold it.

    Integers are rounded to the nearest, halves to even; a bool is on for anything but 0. NaN and ±Inf are never
    written.
    """
    raw = (value - offset) / scale
    if not math.isfinite(raw):
        return None
    try:
        if data_type == "bool":
            plain = struct.pack(_FORMAT[data_type], raw != 0.0)
        elif data_type.startswith("float"):
            plain = struct.pack(_FORMAT[data_type], raw)
        else:
            plain = struct.pack(_FORMAT[data_type], round(raw))
    except (struct.error, OverflowError):
        return None
    return bytes(plain[i] for i in byte_positions(order, REGISTERS[data_type]))


@dataclass(frozen=True, slots=True)
class Field:
    """Where one value lies in the bytes that came over the wire, and what it means.

    `byte` is the index of its first byte; for a coil or discrete input `bit` is the bit of that byte, 0 the lowest.
    """

    byte: int
    data_type: ModbusType
    order: ByteOrder = "ABCD"
    scale: float = 1.0
    offset: float = 0.0
    bit: int | None = None


class Decoder:
    """Decodes all fields of a read at once: one gather of bytes and one numpy view for each data type.

    The byte order is part of the gather's indices, so that a mixture of orders costs nothing.
    """

    def __init__(self, fields: Sequence[Field]) -> None:
        self._raw = np.zeros(len(fields))
        self._scale = np.array([field.scale for field in fields], np.float64)
        self._offset = np.array([field.offset for field in fields], np.float64)
        self._scaled = any(field.scale != 1.0 or field.offset != 0.0 for field in fields)
        bits = [i for i, field in enumerate(fields) if field.bit is not None]
        self._bit_targets = np.array(bits, np.intp)
        self._bit_bytes = np.array([fields[i].byte for i in bits], np.intp)
        self._bit_shifts = np.array([fields[i].bit for i in bits], np.uint8)
        self._words = [
            _words(data_type, fields)
            for data_type in REGISTERS
            if any(field.data_type == data_type and field.bit is None for field in fields)
        ]

    def decode(self, wire: NDArray[np.uint8]) -> NDArray[np.float64]:
        """Engineering values, float64[fields], of the bytes `wire`; the array is the decoder's own until the next call.

        NaN and Inf that the device sends come out as they are.
        """
        raw = self._raw
        with np.errstate(all="ignore"):  # a signalling NaN, or a scale that overflows, is the device's data, not a fault
            for group in self._words:
                raw[group.targets] = group.raw(wire)
            if len(self._bit_targets):
                raw[self._bit_targets] = (wire.take(self._bit_bytes) >> self._bit_shifts) & 1
            if not self._scaled:
                return raw
            scaled: NDArray[np.float64] = raw * self._scale
            scaled += self._offset
            return scaled


@dataclass(frozen=True, slots=True)
class _Words:
    """All fields of one data type that lie in registers: their places in the result, and their bytes on the wire."""

    targets: NDArray[np.intp]
    bytes: NDArray[np.intp]  # [fields, width], most significant byte first
    dtype: np.dtype[np.generic]
    truth: bool

    def raw(self, wire: NDArray[np.uint8]) -> NDArray[np.generic]:
        plain = wire.take(self.bytes).view(self.dtype)[:, 0]
        return plain != 0 if self.truth else plain


def _words(data_type: ModbusType, fields: Sequence[Field]) -> _Words:
    targets = [i for i, field in enumerate(fields) if field.data_type == data_type and field.bit is None]
    positions = [
        [fields[i].byte + position for position in byte_positions(fields[i].order, REGISTERS[data_type])] for i in targets
    ]
    return _Words(
        np.array(targets, np.intp), np.array(positions, np.intp), np.dtype(_FORMAT[data_type]), data_type == "bool"
    )
