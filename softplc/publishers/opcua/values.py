"""The newest snapshot as OPC-UA DataValues: changes are found in arrays, a DataValue is made when someone needs it.

A tag that nobody reads or monitors costs a few nanoseconds per publish, whatever the number of tags.
"""

import heapq
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any, Final

import numpy as np
from asyncua import ua
from numpy.typing import NDArray

from softplc.sample import StatusCode
from softplc.snapshot import Snapshot
from softplc.tags import NO_TIMESTAMP, DataType, TagTable

_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_NULL: Final = ua.Variant(None, ua.VariantType.Null)
_BAD: Final = np.uint32(0x80000000)

VARIANT_TYPES: Final[dict[DataType, Any]] = {data_type: ua.VariantType[data_type.value] for data_type in DataType}
_LIMITS: Final = {
    DataType.BOOLEAN: (-np.inf, np.inf),
    DataType.UINT16: (0.0, 65535.0),
    DataType.UINT32: (0.0, 4294967295.0),
    DataType.INT64: (-(2.0**63), np.nextafter(2.0**63, 0.0)),
}
_PYTHON: Final = {
    DataType.DOUBLE: float,
    DataType.BOOLEAN: bool,
    DataType.UINT16: int,
    DataType.UINT32: int,
    DataType.INT64: int,
}


def utc(ns: int) -> datetime:
    """Wall time of nanoseconds since 1970 UTC; asyncua encodes whole microseconds, the rest is cut off."""
    return _EPOCH + timedelta(microseconds=ns // 1000)


def stamped(value: Any, wanted: Any) -> Any:
    """The DataValue with those of its timestamps that this TimestampsToReturn asks for."""
    source = wanted in (ua.TimestampsToReturn.Source, ua.TimestampsToReturn.Both)
    server = wanted in (ua.TimestampsToReturn.Server, ua.TimestampsToReturn.Both)
    return replace(
        value,
        SourceTimestamp=value.SourceTimestamp if source else None,
        ServerTimestamp=value.ServerTimestamp if server else None,
    )


class TagValues:
    """Every tag's value, status and source timestamp as the last `take` found them; `server_timestamp` is its time.

    A Bad value is Null on the wire (OPC 10000-4, 7.11); a value that the tag's data type cannot hold is
    BadOutOfRange. A source timestamp of 0 becomes the time of the scan that wrote the tag, and before the first
    scan the time given at construction (ns UTC).
    """

    def __init__(self, table: TagTable, opened: int) -> None:
        n = len(table)
        self.table = table
        self.snapshot: Snapshot | None = None
        self.values: NDArray[np.float64] = np.full(n, np.nan)
        self.statuses: NDArray[np.uint32] = np.full(n, StatusCode.BAD_WAITING_FOR_INITIAL_DATA, np.uint32)
        self.source_timestamps: NDArray[np.int64] = np.full(n, opened, np.int64)
        self._opened = opened
        self.server_timestamp = opened
        self._taken_at = utc(opened)
        self._types = [(VARIANT_TYPES[tag.data_type], _PYTHON[tag.data_type]) for tag in table]
        self._typed = np.array([i for i, tag in enumerate(table) if tag.data_type in _LIMITS], np.intp)
        limits = np.array([_LIMITS[tag.data_type] for tag in table if tag.data_type in _LIMITS]).reshape(-1, 2)
        self._low, self._high = limits[:, 0], limits[:, 1]
        self._codes: dict[int, Any] = {}
        self._stamps: dict[int, datetime] = {}

    def take(self, snapshot: Snapshot, now: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]] | None:
        """Make this snapshot the served one; `now` (ns UTC) becomes the server timestamp.

        Returns two masks over the tags: value or status changed, source timestamp changed. None when the
        snapshot is the one already served.
        """
        self.server_timestamp = now
        self._taken_at = utc(now)
        if snapshot is self.snapshot:
            return None
        values, statuses = snapshot.values, self._representable(snapshot)
        stamps = self._effective_timestamps(snapshot)
        moved = (values.view(np.int64) != self.values.view(np.int64)) | (statuses != self.statuses)
        restamped = stamps != self.source_timestamps
        self.snapshot, self.values, self.statuses, self.source_timestamps = snapshot, values, statuses, stamps
        self._stamps.clear()
        return moved, restamped

    def data_value(self, index: int) -> Any:
        """The tag's DataValue as it stands."""
        status = int(self.statuses[index])
        code = self._codes.get(status)
        if code is None:
            code = self._codes.setdefault(status, ua.StatusCode(status))
        if status & 0x80000000:
            variant = _NULL
        else:
            variant_type, python = self._types[index]
            variant = ua.Variant(python(self.values[index]), variant_type, None, False)
        stamp = int(self.source_timestamps[index])
        source = self._stamps.get(stamp)
        if source is None:
            source = self._stamps.setdefault(stamp, utc(stamp))
        return ua.DataValue(variant, code, source, self._taken_at)

    def alive(self, index: int) -> bool:
        """The task that scans this tag is scanning."""
        return self.snapshot is not None and self.snapshot.alive[self.table.section_of(index)]

    def _representable(self, snapshot: Snapshot) -> NDArray[np.uint32]:
        values, statuses = snapshot.values[self._typed], snapshot.statuses[self._typed]
        wrong = ~(np.isfinite(values) & (values >= self._low) & (values <= self._high)) & (statuses & _BAD == 0)
        if not wrong.any():
            return snapshot.statuses
        corrected = snapshot.statuses.copy()
        corrected[self._typed[wrong]] = StatusCode.BAD_OUT_OF_RANGE
        return corrected

    def _effective_timestamps(self, snapshot: Snapshot) -> NDArray[np.int64]:
        missing = snapshot.source_timestamps == NO_TIMESTAMP
        if not missing.any():
            return snapshot.source_timestamps
        stamps = snapshot.source_timestamps.copy()
        for (_, start, stop), scan in zip(self.table.sections, snapshot.scans, strict=True):
            section = stamps[start:stop]
            section[missing[start:stop]] = self._opened if scan is None else scan.timestamp
        return stamps


class Watch:
    """Which tags have monitored items, so that publishing touches only those.

    `index` has each tag's by its node id. `interval` is the publisher's own, in seconds; `now` the monotonic time of
    the publish in progress.
    """

    def __init__(self, index: Mapping[Any, int], interval: float) -> None:
        self.index = index
        self.interval = interval
        self.now = 0.0
        self._items = np.zeros(len(index), np.int32)
        self._watched = np.zeros(len(index), np.bool_)
        self._stamped = np.zeros(len(index), np.bool_)
        self._later: list[tuple[float, int]] = []

    def add(self, index: int, *, stamped: bool) -> None:
        """One more monitored item on this tag; `stamped` when it wants to hear of new source timestamps alone."""
        self._items[index] += 1
        self._watched[index] = True
        self._stamped[index] |= stamped

    def want_stamps(self, index: int) -> None:
        """A monitored item of this tag now wants to hear of new source timestamps alone."""
        self._stamped[index] = True

    def remove(self, index: int) -> None:
        """One monitored item less."""
        self._items[index] -= 1
        if not self._items[index]:
            self._watched[index] = self._stamped[index] = False

    def postpone(self, index: int, due: float) -> None:
        """A monitored item samples this tag only at `due` (monotonic seconds): look at it again then."""
        heapq.heappush(self._later, (due, index))

    def due(self, changes: tuple[NDArray[np.bool_], NDArray[np.bool_]] | None, now: float) -> list[int]:
        """Tags whose monitored items must be looked at now."""
        self.now = now
        found: list[int] = []
        if changes is not None:
            moved, restamped = changes
            found = np.flatnonzero((moved & self._watched) | (restamped & self._stamped)).tolist()
        soon = now + self.interval / 2  # half a publish early is nearer than half late
        if not self._later or self._later[0][0] > soon:
            return found
        late = set(found)
        while self._later and self._later[0][0] <= soon:
            late.add(heapq.heappop(self._later)[1])
        return sorted(late)
