"""Many DataValues as bytes at once, exactly as asyncua encodes each of them.

A DataValue (OPC 10000-6, 5.2.2.17) is here: mask 1, type 1, the value 0 to 8, status 4, source timestamp 0 or 8,
server timestamp 0 or 8 bytes; before it, in a notification, the client's handle 4. What belongs to a value's *class*,
its type or that it is Bad and which timestamps are wanted, says which of these bytes there are. Values of one class
are laid out as an array of records. Where classes differ, each class's records are then put where they belong.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from softplc.tags import DataType, TagTable

_EPOCH_TICKS: Final = 116_444_736_000_000_000  # 1601 to 1970, 100 ns
_TYPES: Final = (  # by class: data type, id of the built-in type, numpy type
    (DataType.DOUBLE, 11, "<f8"),
    (DataType.BOOLEAN, 1, "u1"),
    (DataType.UINT16, 5, "<u2"),
    (DataType.UINT32, 7, "<u4"),
    (DataType.INT64, 8, "<i8"),
)
_DOUBLE: Final = 0
_BOOLEAN: Final = 1
_BAD: Final = len(_TYPES)  # Null, whatever the type
_CLASSES: Final = _BAD + 1  # for each TimestampsToReturn
_BIT_BAD: Final = np.uint32(0x80000000)
_CLASS_OF: Final = {data_type: number for number, (data_type, _, _) in enumerate(_TYPES)}

SOURCE, SERVER, BOTH, NEITHER = range(4)
"""TimestampsToReturn (OPC 10000-4, 7.40)."""
_WITH_SOURCE: Final = (SOURCE, BOTH)
_WITH_SERVER: Final = (SERVER, BOTH)


def ticks(ns: Any) -> Any:
    """DateTime of nanoseconds since 1970 UTC, in whole microseconds as `values.utc` cuts them; one or an array."""
    return ns // 1000 * 10 + _EPOCH_TICKS


def classes_of(table: TagTable) -> NDArray[np.uint8]:
    """The class of each tag's value while it is not Bad, with the source's timestamp alone."""
    return np.array([_CLASS_OF[tag.data_type] for tag in table], np.uint8)


def with_timestamps(classes: Any, stamps: Any) -> Any:
    """These classes, of values with these TimestampsToReturn."""
    return classes % _CLASSES + _CLASSES * stamps


def canonical(classes: NDArray[np.uint8], values: NDArray[np.float64], statuses: NDArray[np.uint32]) -> None:
    """Make each value what a client sees of it, in place: integers are cut off, Booleans 0 or 1, Bad ones NaN."""
    kinds = classes % np.uint8(_CLASSES)
    whole = kinds != _DOUBLE
    if whole.any():
        booleans = kinds == _BOOLEAN
        values[booleans] = values[booleans] != 0
        np.trunc(values, out=values, where=whole)
    values[(statuses & _BIT_BAD) != 0] = np.nan


def encode(
    classes: NDArray[np.uint8],
    values: NDArray[np.float64],
    statuses: NDArray[np.uint32],
    sources: NDArray[np.int64],
    server: NDArray[np.int64] | int,
    handles: NDArray[np.uint32] | None = None,
) -> bytes:
    """The DataValues, each after its handle where there are handles; timestamps are ns UTC.

    A value is one that its class can hold, unless its status is Bad.
    """
    bad = (statuses & _BIT_BAD) != 0
    if bad.any():
        classes = np.where(bad, classes // _CLASSES * _CLASSES + _BAD, classes)
    first = int(classes[0])
    if (classes == first).all():
        return _records(first, values, statuses, sources, server, handles).tobytes()
    sizes = _SIZES[int(handles is not None)][classes]
    offsets = np.cumsum(sizes)
    total = int(offsets[-1])
    offsets -= sizes
    raw = np.empty(total, np.uint8)
    for number in np.flatnonzero(np.bincount(classes)).tolist():
        which = np.flatnonzero(classes == number)
        servers = server if isinstance(server, int) else server[which]
        own = None if handles is None else handles[which]
        found = _records(number, values[which], statuses[which], sources[which], servers, own)
        # a record at every byte; only those are written that begin where one belongs
        places = np.ndarray(total - found.itemsize + 1, found.dtype, raw, strides=(1,))
        places[offsets[which]] = found
    return raw.tobytes()


def _records(
    number: int,
    values: NDArray[np.float64],
    statuses: NDArray[np.uint32],
    sources: NDArray[np.int64],
    server: NDArray[np.int64] | int,
    handles: NDArray[np.uint32] | None,
) -> NDArray[Any]:
    """The DataValues of one class."""
    stamps, kind = divmod(number, _CLASSES)
    found = np.empty(len(values), (_PLAIN if handles is None else _WITH_HANDLE)[number])
    if handles is not None:
        found["handle"] = handles
    found["mask"] = 0x03 | 0x04 * (stamps in _WITH_SOURCE) | 0x08 * (stamps in _WITH_SERVER)
    found["type"] = _TYPES[kind][1] if kind != _BAD else 0
    if kind == _BOOLEAN:
        found["value"] = values != 0
    elif kind != _BAD:
        found["value"] = values
    found["status"] = statuses
    if stamps in _WITH_SOURCE:
        found["source"] = ticks(sources)
    if stamps in _WITH_SERVER:
        found["server"] = ticks(server)
    return found


def _layout(number: int, *before: tuple[str, str]) -> np.dtype[Any]:
    stamps, kind = divmod(number, _CLASSES)
    fields = [*before, ("mask", "u1"), ("type", "u1")]
    if kind != _BAD:
        fields.append(("value", _TYPES[kind][2]))
    fields.append(("status", "<u4"))
    fields += [("source", "<i8")] * (stamps in _WITH_SOURCE) + [("server", "<i8")] * (stamps in _WITH_SERVER)
    return np.dtype(fields)


_PLAIN: Final = [_layout(number) for number in range(4 * _CLASSES)]
_WITH_HANDLE: Final = [_layout(number, ("handle", "<u4")) for number in range(4 * _CLASSES)]
_SIZES: Final = np.array([[layout.itemsize for layout in layouts] for layouts in (_PLAIN, _WITH_HANDLE)])
LARGEST: Final = max(layout.itemsize for layout in _WITH_HANDLE)
"""The most bytes that a value takes, handle included."""
