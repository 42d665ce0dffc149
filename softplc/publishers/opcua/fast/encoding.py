"""Many DataValues as bytes at once, exactly as asyncua encodes each of them.

A DataValue (OPC 10000-6, 5.2.2.17) is here: mask 1, type 1, the value 0 to 8, status 4, source timestamp 0 or 8,
server timestamp 0 or 8 bytes; before it, in a notification, the client's handle 4. What belongs to a value's *class*,
its type or that it is Bad and which timestamps are wanted, says which of these bytes there are. Values of one class
are laid out as an array of records. Where classes differ, each value gets all 38 bytes, and those it has are kept.
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

_HANDLE: Final = 4
_WIDE: Final = np.dtype(
    {
        "names": ["handle", "mask", "type", "value", "status", "source", "server"],
        "formats": ["<u4", "u1", "u1", "<i8", "<u4", "<i8", "<i8"],
    }
)


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

    A value is one that its class can hold, unless its status is Bad. `values` is contiguous.
    """
    bad = (statuses & _BIT_BAD) != 0
    if bad.any():
        classes = np.where(bad, classes // _CLASSES * _CLASSES + _BAD, classes)
    number = int(classes[0])
    dtype = _WIDE if (classes != number).any() else _RECORDS[number]
    out = np.empty(len(classes), dtype)
    fields = dtype.names or ()
    out["mask"], out["type"] = _MASKS[classes], _IDS[classes]
    if "value" in fields:
        out["value"] = values if number % _CLASSES == _DOUBLE and dtype is not _WIDE else _bits(classes, values)
    out["status"] = statuses
    if "source" in fields:
        out["source"] = ticks(sources)
    if "server" in fields:
        out["server"] = ticks(server)
    if handles is not None:
        out["handle"] = handles
    begin = 0 if handles is not None else _HANDLE
    raw = out.view(np.uint8).reshape(len(out), -1)[:, begin:]
    return raw.tobytes() if dtype is not _WIDE else raw[_KEPT[classes, begin:]].tobytes()


def _bits(classes: NDArray[np.uint8], values: NDArray[np.float64]) -> NDArray[np.int64]:
    """Each value's bytes as an integer, the first ones in its lowest bits."""
    kinds = classes % np.uint8(_CLASSES)
    bits: NDArray[np.int64] = values.view(np.int64).copy()
    whole = (kinds > _BOOLEAN) & (kinds != _BAD)
    bits[whole] = values[whole].astype(np.int64)
    booleans = kinds == _BOOLEAN
    bits[booleans] = values[booleans] != 0
    return bits


def _record(number: int) -> np.dtype[Any]:
    stamps, kind = divmod(number, _CLASSES)
    fields = [("handle", "<u4"), ("mask", "u1"), ("type", "u1")]
    if kind != _BAD:
        fields.append(("value", _TYPES[kind][2]))
    fields.append(("status", "<u4"))
    fields += [("source", "<i8")] * (stamps in _WITH_SOURCE) + [("server", "<i8")] * (stamps in _WITH_SERVER)
    return np.dtype(fields)


def _kept(record: np.dtype[Any]) -> NDArray[np.bool_]:
    """Which bytes of a wide record belong to this one."""
    kept = np.zeros(_WIDE.itemsize, np.bool_)
    wide: Any = _WIDE.fields
    for name, field in (record.fields or {}).items():
        begin = wide[name][1]
        kept[begin : begin + field[0].itemsize] = True
    return kept


LARGEST: Final = _WIDE.itemsize
"""The most bytes that a value takes, handle included."""
_RECORDS: Final = [_record(number) for number in range(4 * _CLASSES)]
_KEPT: Final = np.array([_kept(record) for record in _RECORDS])
_IDS: Final = np.array([*(number for _, number, _ in _TYPES), 0] * 4, np.uint8)
_MASKS: Final = np.repeat(
    np.array([0x03 | 0x04 * (s in _WITH_SOURCE) | 0x08 * (s in _WITH_SERVER) for s in range(4)], np.uint8), _CLASSES
)
