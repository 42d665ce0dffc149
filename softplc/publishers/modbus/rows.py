"""What the register map is made of: register types, rows, blocks, and how an address is written."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Final, Literal

from softplc.tags import DataType

ByteOrder = Literal["ABCD", "CDAB", "BADC", "DCBA"]
"""Order in which the bytes of a value of several registers are sent; A is the most significant."""
BadValues = Literal["hold", "nan"]
"""What a Bad float reads as: its last usable value, or NaN."""

LAST_5_DIGIT: Final = 9998  # 40001 numbers register 0, 49999 register 9998; beyond it takes six digits


class RegisterType(StrEnum):
    """How a value lies in its registers."""

    UINT16 = "uint16"
    UINT32 = "uint32"
    INT64 = "int64"
    FLOAT32 = "float32"

    @property
    def registers(self) -> int:
        """How many registers a value takes."""
        return _WIDTH[self]


_WIDTH: Final = {RegisterType.UINT16: 1, RegisterType.UINT32: 2, RegisterType.INT64: 4, RegisterType.FLOAT32: 2}
TYPE_OF: Final = {
    DataType.DOUBLE: RegisterType.FLOAT32,
    DataType.BOOLEAN: RegisterType.UINT16,
    DataType.UINT16: RegisterType.UINT16,
    DataType.UINT32: RegisterType.UINT32,
    DataType.INT64: RegisterType.INT64,
}


class Origin(StrEnum):
    """What a register shows; `Row.index` says of which tag, or of which section."""

    CONSTANT = "constant"  # Row.value, for ever
    TAG = "tag"  # the tag's value
    STATUS = "status"  # the tag's raw StatusCode
    MILLISECONDS = "milliseconds"  # the tag's value · 1000; 65535 when longer or unknown
    ALIVE = "alive"  # 1 while the section's task scans
    ALL_ALIVE = "all alive"  # 1 while every task scans


@dataclass(frozen=True, slots=True)
class Row:
    """One value of the map. `address` counts from 0 and is the same among input and holding registers."""

    address: int
    name: str
    type: RegisterType
    unit: str
    description: str
    origin: Origin
    index: int = 0
    value: float = 0.0
    boolean: bool = False

    @property
    def registers(self) -> int:
        """How many registers the value takes."""
        return self.type.registers

    @property
    def input(self) -> str:
        """The first register's number among the input registers: 30001 is the first; six digits beyond 39999."""
        return numbered(3, self.address)

    @property
    def holding(self) -> str:
        """The first register's number among the holding registers: 40001 is the first; six digits beyond 49999."""
        return numbered(4, self.address)


def numbered(table: int, address: int) -> str:
    """An address from 0 as people write it, numbered from 1 after the table's digit."""
    return f"{table}{address + 1:04}" if address <= LAST_5_DIGIT else f"{table}{address + 1:05}"


@dataclass(frozen=True, slots=True)
class Section:
    """The rows of one block of the map and the registers that it takes, first to last."""

    name: str
    first: int
    last: int
    rows: tuple[Row, ...]


@dataclass(frozen=True, slots=True)
class RegisterMap:
    """All blocks in order of address. `size` registers are served, from 0; those without a row read 0."""

    sections: tuple[Section, ...]
    size: int
    crc: int
    byte_order: ByteOrder

    @property
    def rows(self) -> tuple[Row, ...]:
        """Every row, in order of address."""
        return tuple(row for section in self.sections for row in section.rows)
