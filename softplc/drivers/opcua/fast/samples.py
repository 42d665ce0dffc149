"""The samples of a message as arrays: what `values.decode` makes of one DataValue, for all of them at once."""

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from asyncua import ua
from numpy.typing import NDArray

from softplc.drivers.opcua.fast.records import Layout, OddBodyError, Piece, find_runs, lay_out
from softplc.drivers.opcua.values import Decoded, decode, overflowed, status_of
from softplc.sample import StatusCode
from softplc.tags import NO_TIMESTAMP

OddValue = Callable[[bytes, int], tuple[ua.DataValue, int]]
"""The DataValue at a byte of a body, and where it ends, by asyncua's decoder. Raises OddBodyError."""
Accept = Callable[[int], None]
"""Looks at what is behind the records, which end at this byte, and raises when that makes no sense."""

BAD: Final = np.uint32(0x80000000)
MISMATCH: Final = np.uint32(StatusCode.BAD_TYPE_MISMATCH)
_OVERFLOW: Final = np.uint32(0x0480)  # InfoType DataValue with the Overflow bit (OPC 10000-4, 7.39.1)
_OVERFLOW_BIT: Final = np.uint32(0x0080)
_LIMIT_BITS: Final = np.uint32(0x0300)
_REMEMBERED: Final = 4
"""Layouts that are remembered, by the length of the message: a tag turns Bad, and Good again."""
_EPOCH_US: Final = 11_644_473_600_000_000  # 1601 to 1970, µs
_FIRST_TICK: Final = _EPOCH_US * 10
_LAST_TICK: Final = (_EPOCH_US + 9_214_646_400_000_000) * 10  # the year 2262 begins: int64 nanoseconds end in it


class Samples:
    """The samples of messages with always the same `count` of records, in the order of the records.

    `values` float64, NaN where Bad. `statuses` uint32, raw, what the sample is worth. `told` uint32, what the server
    says, without the Overflow bit; None when it says of every record that it is Good. `stamps` int64 ns UTC,
    NO_TIMESTAMP where there is none, in whole µs as asyncua's; `stamped` when all have one. `odd` are the DataValues
    of records that are no single number, by position. `layout` is that of the message: another object where any
    record has another type than before. `handles` uint32, of each record, where the records have some; `overflowed`
    says which had the Overflow bit, None: no one. Valid until the next message.
    """

    def __init__(self, count: int, lead: int = 0) -> None:
        self.handles: NDArray[np.uint32] | None = np.zeros(count, np.uint32) if lead else None
        self.overflowed: NDArray[np.bool_] | None = None
        self._lead = lead
        self.values: NDArray[np.float64] = np.full(count, np.nan)
        self.statuses: NDArray[np.uint32] = np.zeros(count, np.uint32)
        self.stamps: NDArray[np.int64] = np.zeros(count, np.int64)
        self.told: NDArray[np.uint32] | None = None
        self.stamped = False
        self.odd: dict[int, ua.DataValue] = {}
        self.layout: Layout | None = None
        self._told: NDArray[np.uint32] = np.zeros(count, np.uint32)
        self._layouts: dict[int, Layout] = {}
        self._count = count

    def __len__(self) -> int:
        return self._count

    def element(self, record: int, index: int) -> Decoded:
        """One element of an array; a single value where an array was expected has the wrong type."""
        data = self.odd.get(record)
        if data is not None:
            return decode(data, index)
        own = self.statuses[record]
        return np.nan, int(own if own & BAD else MISMATCH), int(self.stamps[record]) or None

    def decode(self, body: bytes, start: int, odd_value: OddValue, accept: Accept) -> None:
        """Take the records from byte `start`, if what follows them is accepted. Raises OddBodyError."""
        layouts, length = self._layouts, len(body) - start
        layout = layouts.get(length)
        if layout is None or layout.start != start or not self._take(body, layout, odd_value, accept):
            runs, end = find_runs(
                body, start, self._count, lambda offset: odd_value(body, offset + self._lead)[1], self._lead
            )
            layout = lay_out(runs, start, end)
            if not self._take(body, layout, odd_value, accept):
                raise OddBodyError("the layout of the answer makes no sense")
            layouts.pop(length, None)
            if len(layouts) >= _REMEMBERED:
                del layouts[next(iter(layouts))]
            layouts[length] = layout

    def _take(self, body: bytes, layout: Layout, odd_value: OddValue, accept: Accept) -> bool:
        """Decode a body that has this layout; False, and nothing taken, when it turns out that it has another."""
        taken: list[tuple[Piece, NDArray[Any]]] = []
        for piece in layout.pieces:
            records = piece.take(body)
            if records is None:
                return False
            taken.append((piece, records))
        odd: dict[int, ua.DataValue] = {}
        for position, offset, behind in layout.odd:
            data, end = odd_value(body, offset + self._lead)
            if end != behind:
                return False
            odd[position] = data
        accept(layout.end)
        self.layout = layout
        for piece, records in taken:
            self._put(piece, records)
        if self.handles is not None:
            for position, offset, _ in layout.odd:
                self.handles[position] = int.from_bytes(body[offset : offset + self._lead], "little")
        self._to_nanoseconds()
        self.overflowed = None
        if layout.always_good:
            self.statuses.fill(0)
            self.told = None
        else:
            self._judge(layout, odd)
        self.odd = odd
        return True

    def _put(self, piece: Piece, records: NDArray[Any]) -> None:
        """Raw values, statuses and ticks of one piece."""
        record, where = piece.record, piece.where
        if self.handles is not None:
            self.handles[where] = records["handle"]
        if record.verdict is not None:
            self.values[where] = np.nan
        elif record.boolean:
            self.values[where] = records["value"] != 0
        else:
            self.values[where] = records["value"]
        self.stamps[where] = records["source"] if record.has_stamp else 0
        if record.has_status:
            self._told[where] = records["status"]

    def _to_nanoseconds(self) -> None:
        """Ticks to ns UTC, in place."""
        ticks = self.stamps
        self.stamped = bool(
            ticks.size and np.minimum.reduce(ticks) > _FIRST_TICK + 9 and np.maximum.reduce(ticks) < _LAST_TICK
        )
        none = None if self.stamped else (ticks < _FIRST_TICK) | (ticks >= _LAST_TICK)
        ticks //= 10
        ticks -= _EPOCH_US
        ticks *= 1000
        if none is not None:
            ticks[none] = NO_TIMESTAMP

    def _judge(self, layout: Layout, odd: dict[int, ua.DataValue]) -> None:
        """Statuses without overflow, what each sample is worth, NaN where it is Bad, odd ones in their place."""
        told, statuses = self._told, self.statuses
        self.told = told
        for piece in layout.pieces:
            if not piece.record.has_status:
                told[piece.where] = 0
        flagged = (told & _OVERFLOW) == _OVERFLOW
        if flagged.any():
            told[flagged] &= np.where(told[flagged] & _LIMIT_BITS, ~_OVERFLOW_BIT, ~_OVERFLOW)
        statuses[:] = told
        for piece in layout.pieces:
            if piece.record.verdict is not None:
                own = told[piece.where]
                statuses[piece.where] = np.where(own & BAD, own, np.uint32(piece.record.verdict))
        self.values[(statuses & BAD) != 0] = np.nan
        for position, data in odd.items():
            value, status, stamp = decode(data, None)
            self.values[position] = value
            self.statuses[position] = status
            self.stamps[position] = NO_TIMESTAMP if stamp is None else stamp
            told[position] = status_of(data)
            flagged[position] = overflowed(data)
            self.stamped = False
        self.overflowed = flagged if flagged.any() else None
