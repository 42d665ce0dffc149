"""Where the DataValues of a message lie: records of known size, runs of equal ones, and pieces to decode at once.

A DataValue is (OPC 10000-6, 5.2.2.17): a mask, and each part that the mask names.

| bit | part | bytes |
|---|---|---|
| 0x01 | Variant: its type, the value | 1 + size |
| 0x02 | StatusCode | 4 |
| 0x04 | SourceTimestamp, 100 ns since 1601 | 8 |
| 0x10 | SourcePicoseconds | 2 |
| 0x08 | ServerTimestamp | 8 |
| 0x20 | ServerPicoseconds | 2 |

In a notification the client's handle, 4 bytes, stands before each (OPC 10000-4, 7.25.2).

Mask and type of a Variant that is a single value of fixed size say how long the record is. So when the first record
begins where it should, and every record's mask and type are those of a layout, that layout is the message's.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from softplc.sample import StatusCode

NUMBERS: Final[dict[int, str]] = {
    1: "?",  # Boolean
    2: "i1",  # SByte
    3: "u1",  # Byte
    4: "<i2",  # Int16
    5: "<u2",  # UInt16
    6: "<i4",  # Int32
    7: "<u4",  # UInt32
    8: "<i8",  # Int64
    9: "<u8",  # UInt64
    10: "<f4",  # Float
    11: "<f8",  # Double
}
"""Number types by their built-in type id, as numpy types on the wire (OPC 10000-6, 5.1.2)."""
BOOLEAN: Final = 1
NULL: Final = 0
DATE_TIME: Final = 13
NO_VALUE: Final = -1

_VALUE, _STATUS, _SOURCE, _SERVER, _SOURCE_PICO, _SERVER_PICO = 0x01, 0x02, 0x04, 0x08, 0x10, 0x20
_LONG_RUN: Final = 64
_LOOK_AHEAD: Final = 8
_MOST_RUNS: Final = 16

Bytes = NDArray[np.uint8]


class OddBodyError(Exception):
    """The body of a message is not what the standard says; the text tells how."""


@dataclass(frozen=True, eq=False)
class Record:
    """A DataValue of one layout: how it begins, and its parts.

    `verdict` is the status where the server's own is not Bad and there is no number; None where there is one.
    `lead` bytes of handle stand before the head.
    """

    head: bytes
    dtype: np.dtype[Any]
    boolean: bool
    has_status: bool
    has_stamp: bool
    verdict: int | None
    lead: int = 0

    @property
    def kind(self) -> int:
        """Built-in type id of the value; NO_VALUE where there is none."""
        return self.head[1] if len(self.head) > 1 else NO_VALUE

    @property
    def size(self) -> int:
        """Bytes of one record."""
        return int(self.dtype.itemsize)


@dataclass(frozen=True, slots=True)
class Run:
    """`count` records of equal layout from record `first`, bytes `offset` to `end`; `record` None: one odd record."""

    first: int
    count: int
    offset: int
    end: int
    record: Record | None


@dataclass(frozen=True, slots=True)
class Piece:
    """Records of equal layout that are decoded at once; `where` are their positions.

    `heads` are mask and type of all of them. They lie one after the other from `offset`, or at `offsets`.
    """

    record: Record
    where: slice | NDArray[np.intp]
    count: int
    offset: int
    heads: bytes
    offsets: NDArray[np.intp] | None = None

    def take(self, body: bytes) -> NDArray[Any] | None:
        """The records in this body; None when it has other ones there."""
        record = self.record
        if self.offsets is None:
            if self.offset + self.count * record.size > len(body):
                return None
            found = np.frombuffer(body, record.dtype, self.count, self.offset)
        else:
            if self.offset + record.size > len(body):  # where the last one begins
                return None
            raw = np.frombuffer(body, np.uint8)
            found = raw[self.offsets].view(record.dtype)[:, 0]
        return found if found["head"].tobytes() == self.heads else None


@dataclass(frozen=True, slots=True)
class Layout:
    """Where the records of a message are: what to decode at once, the odd ones (position, offset, end).

    `always_good`: there are but numbers, and no status with any.
    """

    start: int
    pieces: tuple[Piece, ...]
    odd: tuple[tuple[int, int, int], ...]
    end: int
    always_good: bool


def _record(mask: int, kind: int, lead: int) -> Record:
    fields: list[tuple[str, str]] = [("handle", "<u4")] if lead else []
    fields.append(("head", "V2" if mask & _VALUE else "V1"))
    if kind in NUMBERS:
        fields.append(("value", NUMBERS[kind] if kind != BOOLEAN else "u1"))
    elif kind == DATE_TIME:
        fields.append(("time", "V8"))
    if mask & _STATUS:
        fields.append(("status", "<u4"))
    if mask & _SOURCE:
        fields.append(("source", "<i8"))
    rest = 2 * bool(mask & _SOURCE_PICO) + 8 * bool(mask & _SERVER) + 2 * bool(mask & _SERVER_PICO)
    if rest:
        fields.append(("rest", f"V{rest}"))
    verdict = None
    if kind not in NUMBERS:
        verdict = StatusCode.BAD_TYPE_MISMATCH if kind == DATE_TIME else StatusCode.BAD_WAITING_FOR_INITIAL_DATA
    head = bytes([mask, kind]) if mask & _VALUE else bytes([mask])
    dtype = np.dtype(fields)
    return Record(head, dtype, kind == BOOLEAN, bool(mask & _STATUS), bool(mask & _SOURCE), verdict, lead)


def _all_records(lead: int) -> dict[int, Record]:
    """Every layout of fixed size, by mask and, above it, the type."""
    known = {mask: _record(mask, NO_VALUE, lead) for mask in range(0, 0x40, 2)}
    for kind in (NULL, *NUMBERS, DATE_TIME):
        known |= {mask | kind << 8: _record(mask, kind, lead) for mask in range(1, 0x40, 2)}
    return known


HANDLE: Final = 4
"""Bytes of a handle."""
_RECORDS: Final = {lead: _all_records(lead) for lead in (0, HANDLE)}


def find_runs(
    body: bytes, start: int, count: int, odd_end: Callable[[int], int], lead: int = 0
) -> tuple[list[Run], int]:
    """The runs of `count` records from byte `start`, each behind a handle of `lead` bytes, and where they end.

    `odd_end` gives the end of a record whose layout is none of the known. Raises OddBodyError when the body is short.
    """
    known, raw = _RECORDS[lead], np.frombuffer(body, np.uint8)
    runs: list[Run] = []
    first, offset, length = 0, start, len(body)
    while first < count:
        at = offset + lead
        if at >= length:
            raise OddBodyError("the answer is cut short")
        key = body[at]
        if key & _VALUE and at + 1 < length:
            key |= body[at + 1] << 8
        record = known.get(key)
        if record is None:
            end = odd_end(offset)
            runs.append(Run(first, 1, offset, end, None))
            first, offset = first + 1, end
            continue
        most = min(count - first, (length - offset) // record.size)
        if most < 1:
            raise OddBodyError("the answer is cut short")
        equal = _run_length(body, raw, offset, record, most)
        end = offset + equal * record.size
        runs.append(Run(first, equal, offset, end, record))
        first, offset = first + equal, end
    return runs, offset


def _run_length(body: bytes, raw: Bytes, offset: int, record: Record, most: int) -> int:
    """How many records of this layout follow each other; one by one at first, then in growing strides."""
    size, head, lead = record.size, record.head, record.lead
    equal = 1
    while equal < min(most, _LOOK_AHEAD):
        if not body.startswith(head, offset + lead + equal * size):
            return equal
        equal += 1
    stride = _LONG_RUN
    while equal < most:
        stride = min(stride * 8, most - equal)
        begin = offset + equal * size
        heads = raw[begin : begin + stride * size].reshape(stride, size)
        same = heads[:, lead] == head[0]
        if len(head) == 2:
            same &= heads[:, lead + 1] == head[1]
        if not same.all():
            return equal + int(same.argmin())
        equal += stride
    return equal


def lay_out(runs: Sequence[Run], start: int, end: int) -> Layout:
    """The layout of these runs: long ones each a piece, short ones of the same layout gathered into one."""
    few = len(runs) <= _MOST_RUNS
    pieces: list[Piece] = []
    odd: list[tuple[int, int, int]] = []
    short: dict[Record, list[Run]] = {}
    for run in runs:
        if run.record is None:
            odd.append((run.first, run.offset, run.end))
        elif few or run.count >= 8 * _LONG_RUN:
            heads = run.record.head * run.count
            pieces.append(Piece(run.record, slice(run.first, run.first + run.count), run.count, run.offset, heads))
        else:
            short.setdefault(run.record, []).append(run)
    pieces += [_gather(record, scattered) for record, scattered in short.items()]
    good = not odd and not any(p.record.has_status or p.record.verdict is not None for p in pieces)
    return Layout(start, tuple(pieces), tuple(odd), end, good)


def _gather(record: Record, runs: Sequence[Run]) -> Piece:
    counts = np.array([run.count for run in runs])
    within = np.arange(counts.sum()) - np.repeat(counts.cumsum() - counts, counts)
    where = np.repeat(np.array([run.first for run in runs]), counts) + within
    begins = np.repeat(np.array([run.offset for run in runs]), counts) + within * record.size
    offsets = begins[:, None] + np.arange(record.size)
    return Piece(record, where, len(where), int(begins[-1]), record.head * len(where), offsets)
