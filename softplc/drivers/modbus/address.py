"""A Modbus address names a table and an offset; people write it in two ways, and both are always shown.

| table    | holds                     | numbered from 1          | named, from 0  | short |
|----------|---------------------------|--------------------------|----------------|-------|
| coil     | bits, read and write      | 00001 … 09999, 0xxxxx    | `coil:0`       | C0    |
| discrete | bits, read only           | 10001 … 19999, 1xxxxx    | `discrete:0`   | DI0   |
| input    | 16-bit words, read only   | 30001 … 39999, 3xxxxx    | `input:0`      | IR0   |
| holding  | 16-bit words, read, write | 40001 … 49999, 4xxxxx    | `holding:0`    | HR0   |

Six digits reach the whole table (400001 … 465536). The offset is what travels on the wire (Modbus Application
Protocol V1.1b3, 4.4): 40001 is offset 0.
"""

import re
from dataclasses import dataclass
from difflib import get_close_matches
from enum import StrEnum
from typing import Final

LAST_OFFSET: Final = 65535


class Table(StrEnum):
    """One of the four address spaces of a Modbus device."""

    COIL = "coil"
    DISCRETE = "discrete"
    INPUT = "input"
    HOLDING = "holding"

    @property
    def bits(self) -> bool:
        """True where an address is a single bit, false where it is a 16-bit register."""
        return self in (Table.COIL, Table.DISCRETE)

    @property
    def writable(self) -> bool:
        """True where a client may write."""
        return self in (Table.COIL, Table.HOLDING)


_DIGIT: Final = {Table.COIL: 0, Table.DISCRETE: 1, Table.INPUT: 3, Table.HOLDING: 4}
_TABLE_OF_DIGIT: Final = {str(digit): table for table, digit in _DIGIT.items()}
_SHORT: Final = {"C": Table.COIL, "DI": Table.DISCRETE, "IR": Table.INPUT, "HR": Table.HOLDING}
_FORMS: Final = "holding:0, input:12, coil:3, discrete:7, or a number such as 40001"


@dataclass(frozen=True, slots=True, order=True)
class Address:
    """A place in a device: the table, and the offset from 0 as it travels on the wire."""

    table: Table
    offset: int

    @property
    def number(self) -> str:
        """The address numbered from 1: five digits as far as they reach, six beyond."""
        width = 4 if self.offset < 9999 else 5
        return f"{_DIGIT[self.table]}{self.offset + 1:0{width}d}"

    def __str__(self) -> str:
        """Both notations, as in `40001 / holding:0`."""
        return f"{self.number} / {self.table.value}:{self.offset}"


def parse_address(text: int | str) -> Address:
    """The address that a person wrote, in any of the notations above.

    Raises ValueError that says what was found and what would be right.
    """
    if isinstance(text, int):
        return _numbered(str(text), str(text))
    stripped = text.strip()
    if re.fullmatch(r"[+-]?\d+", stripped):
        return _numbered(stripped, repr(text))
    named = re.fullmatch(r"([A-Za-z]+)\s*:\s*([+-]?\d+)", stripped)
    if named:
        return _named(named[1], int(named[2]), repr(text))
    short = re.fullmatch(r"([A-Za-z]+)(\d+)", stripped)
    if short and short[1].upper() in _SHORT:
        return _at(_SHORT[short[1].upper()], int(short[2]), repr(text))
    raise ValueError(f"{text!r} is not a Modbus address, expected {_FORMS}")


def _named(name: str, offset: int, found: str) -> Address:
    names = [table.value for table in Table]
    if name.lower() in names:
        return _at(Table(name.lower()), offset, found)
    close = get_close_matches(name.lower(), names, n=1)
    meant = f"did you mean {close[0]}:{offset}?" if close else f"expected one of {', '.join(names)}"
    raise ValueError(f"{found}: there is no table {name!r}, {meant}")


def _at(table: Table, offset: int, found: str) -> Address:
    if not 0 <= offset <= LAST_OFFSET:
        first, last = Address(table, 0), Address(table, LAST_OFFSET)
        raise ValueError(f"{found}: offset {offset} is outside 0…{LAST_OFFSET}, expected {first} to {last}")
    return Address(table, offset)


def _numbered(digits: str, found: str) -> Address:
    if not digits.isdigit() or len(digits) not in (5, 6):
        number = int(digits)
        hint = f", or holding:{number} if it counts from 0" if 0 <= number <= LAST_OFFSET else ""
        raise ValueError(f"{found} names no table, expected five or six digits such as 40001 or 400001{hint}")
    table = _TABLE_OF_DIGIT.get(digits[0])
    if table is None:
        raise ValueError(
            f"{found}: first digit {digits[0]} names no table, "
            f"expected 0 (coil), 1 (discrete), 3 (input) or 4 (holding), or a form such as holding:0"
        )
    number = int(digits[1:])
    if not 1 <= number <= LAST_OFFSET + 1:
        first = f"{digits[0]}{1:0{len(digits) - 1}d}"
        last = f"{digits[0]}{9999 if len(digits) == 5 else LAST_OFFSET + 1}"
        raise ValueError(f"{found} is outside {first}…{last}: numbers count from 1, {first} is {table.value}:0")
    return Address(table, number - 1)
