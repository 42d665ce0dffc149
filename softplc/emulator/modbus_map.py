"""The register map of the emulated PLC and its codec: pure, and shared with nobody.

Holding registers, numbered from 0; input registers read the same:

```
0        Heartbeat            uint16   +1 each step, rolls over at 65535
1        Axes                 uint16   number of axes
2–3      Step                 uint32   steps since the start
4        Check16              uint16   0x1234
6–7      CheckOne             float32  1.0
8–9      CheckNegative        float32  -123.456
10–19    0                             reserved
axis i at 100 + 20·i:
+0–1     Position             float32  measured
+2–3     TruePosition         float32
+4–5     TrueVelocity         float32
+6–7     Count                int32    measured, as the encoder counts
+8–9     FilteredPosition     float32  writable
+10–11   FilteredVelocity     float32  writable
+12      Quality              uint16   of the measurement: 2 good, 1 uncertain, 0 bad
+13      ContactWord          uint16   1 while the limit switch at a stop is closed
+14–15   dt                   float32  ms, of the PLC's own AOI, where it runs one; 0 otherwise, as the next two
+16–17   y                    float32
+18–19   y_dot                float32
```
Coil i is Enable of axis i, writable; discrete input i reads the same, discrete input 2000 + i is its Contact. Any
other address answers exception 2.
The byte order of the scenario holds for values in two registers; a single register is always big-endian.
"""

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from softplc.emulator.bounce import Bounce
from softplc.emulator.memory import MemoryState
from softplc.emulator.plant import PlantStep
from softplc.emulator.scenario import Scenario
from softplc.sample import quality
from softplc.units import per_second

HEADER: Final = 20
AXES_AT: Final = 100
STRIDE: Final = 20
FILTERED_POSITION: Final = 8
FILTERED_VELOCITY: Final = 10
WRITABLE: Final = range(8, 12)
CONTACTS_AT: Final = 2000

_ORDERS: Final = {"ABCD": (0, 1, 2, 3), "CDAB": (2, 3, 0, 1), "BADC": (1, 0, 3, 2), "DCBA": (3, 2, 1, 0)}


def axis_at(index: int) -> int:
    """First holding register of an axis."""
    return AXES_AT + STRIDE * index


def float_words(value: float, order: str) -> list[int]:
    """The two registers of a float32; a value beyond float32 becomes an infinity."""
    try:
        return _words(struct.pack(">f", value), order)
    except OverflowError:
        return _words(struct.pack(">f", math.copysign(math.inf, value)), order)


def float_value(words: Sequence[int], order: str) -> float:
    """The float32 in two registers."""
    wire = struct.pack(">HH", *words)
    swapped = bytes(wire[position] for position in _ORDERS[order])  # each order is its own inverse
    return float(struct.unpack(">f", swapped)[0])


def _words(big_endian: bytes, order: str) -> list[int]:
    return list(struct.unpack(">HH", bytes(big_endian[position] for position in _ORDERS[order])))


def registers(step: PlantStep, memory: MemoryState, order: str) -> list[int]:
    """All holding registers from 0 in one step of the plant, [100 + 20 · axes]."""
    words = [step.number % 65536, len(step.axes), *_words(struct.pack(">I", step.number % 2**32), order), 0x1234, 0]
    words += [*float_words(1.0, order), *float_words(-123.456, order)]
    words += [0] * (AXES_AT - len(words))
    for index, axis in enumerate(step.axes):
        words += float_words(axis.position, order)
        words += float_words(axis.true_position, order)
        words += float_words(axis.true_velocity, order)
        words += _words(struct.pack(">i", axis.count), order)
        words += float_words(memory.filtered_position[index], order)
        words += float_words(memory.filtered_velocity[index], order)
        words += [int(quality(axis.status)), int(axis.contact)]
        if axis.aoi is not None:
            for value in (axis.aoi.dt, axis.aoi.y, axis.aoi.y_dot):
                words += float_words(value, order)
        words += [0] * (axis_at(index + 1) - len(words))
    return words


def take(words: Sequence[int], first: int, count: int, memory: MemoryState, order: str) -> None:
    """Bring into the memory what a client wrote into `count` registers from `first`; `words` are all registers."""
    written = range(first, first + count)
    for index in range(memory.axes):
        for offset, values in (
            (FILTERED_POSITION, memory.filtered_position),
            (FILTERED_VELOCITY, memory.filtered_velocity),
        ):
            at = axis_at(index) + offset
            if at in written or at + 1 in written:
                values[index] = float_value(words[at : at + 2], order)


@dataclass(frozen=True, slots=True)
class Row:
    """One value of the map: where it is, in both notations, and what it is."""

    table: str
    offset: int
    number: str
    name: str
    data_type: str
    unit: str
    writable: bool
    description: str


def rows(scenario: Scenario) -> list[Row]:
    """The map of a scenario, in order of address. Input registers and discrete inputs mirror it."""
    found = [
        _row("Heartbeat", 0, "uint16", "", "+1 each step, rolls over at 65535"),
        _row("Axes", 1, "uint16", "", "Number of axes"),
        _row("Step", 2, "uint32", "", "Steps since the start"),
        _row("Check16", 4, "uint16", "", "Always 0x1234"),
        _row("CheckOne", 6, "float32", "", "Always 1.0"),
        _row("CheckNegative", 8, "float32", "", "Always -123.456"),
    ]
    for index, axis in enumerate(scenario.axes):
        at, speed = axis_at(index), per_second(axis.unit)
        found += [
            _row(f"{axis.name}.Position", at, "float32", axis.unit, "Measured position"),
            _row(f"{axis.name}.TruePosition", at + 2, "float32", axis.unit, "Position without noise"),
            _row(f"{axis.name}.TrueVelocity", at + 4, "float32", speed, "Velocity without noise"),
            _row(f"{axis.name}.Count", at + 6, "int32", "count", "Measured position in encoder counts"),
            _row(f"{axis.name}.FilteredPosition", at + 8, "float32", axis.unit, "For write-back", writable=True),
            _row(f"{axis.name}.FilteredVelocity", at + 10, "float32", speed, "For write-back", writable=True),
            _row(f"{axis.name}.Quality", at + 12, "uint16", "", "2 good, 1 uncertain, 0 bad"),
        ]
        if axis.aoi is not None:
            found += [
                _row(f"{axis.name}.dt", at + 14, "float32", "ms", "Time step of the PLC's own AOI"),
                _row(f"{axis.name}.y", at + 16, "float32", axis.unit, "Filtered position of the PLC's own AOI"),
                _row(f"{axis.name}.y_dot", at + 18, "float32", speed, "Filtered velocity of the PLC's own AOI"),
            ]
    found += [
        Row("coil", index, f"{index + 1:05}", f"{axis.name}.Enable", "bool", "", True, "Enable of the observer")
        for index, axis in enumerate(scenario.axes)
    ]
    found += [
        _row(f"{axis.name}.ContactWord", axis_at(index) + 13, "uint16", "", "Limit switch at the stops, as a number")
        for index, axis in enumerate(scenario.axes)
        if isinstance(axis.motion, Bounce)
    ]
    found += [
        _discrete(CONTACTS_AT + index, f"{axis.name}.Contact", "Limit switch at the stops")
        for index, axis in enumerate(scenario.axes)
        if isinstance(axis.motion, Bounce)
    ]
    return found


def _discrete(offset: int, name: str, description: str) -> Row:
    return Row("discrete", offset, str(10001 + offset), name, "bool", "", False, description)


def _row(name: str, offset: int, data_type: str, unit: str, description: str, *, writable: bool = False) -> Row:
    number = 40001 + offset if offset < 9999 else 400001 + offset
    return Row("holding", offset, str(number), name, data_type, unit, writable, description)


def text(scenario: Scenario) -> str:
    """The map as an aligned table, one value a line, under a line of headings."""
    lines = [("ADDRESS", "NUMBER", "NAME", "TYPE", "UNIT", "ACCESS", "DESCRIPTION")]
    lines += [
        (
            f"{row.table}:{row.offset}",
            row.number,
            row.name,
            row.data_type,
            row.unit,
            "read/write" if row.writable else "read",
            row.description,
        )
        for row in rows(scenario)
    ]
    widths = [max(len(line[column]) for line in lines) for column in range(len(lines[0]))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in lines
    )
