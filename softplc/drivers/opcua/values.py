"""DataValues to samples and numbers to Variants. Pure: no I/O, no clock.

What a DataValue becomes:

| DataValue | value | status |
|---|---|---|
| Good or Uncertain, number or Boolean | the number, 1.0 or 0.0; NaN and Inf as they are | the server's |
| Bad, with or without a value | NaN | the server's |
| no value yet (null) | NaN | BadWaitingForInitialData |
| text, structure, time, …; array without index, scalar with index | NaN | BadTypeMismatch |
| array shorter than the index | NaN | BadOutOfRange |

Int64 and UInt64 beyond ±2⁵³ lose their last digits: inside, every value is a float64.
"""

import math
from datetime import UTC, datetime
from typing import Any, Final

from asyncua import ua

from softplc.sample import StatusCode

INTEGER_RANGES: Final[dict[ua.VariantType, tuple[int, int]]] = {
    ua.VariantType.SByte: (-(2**7), 2**7 - 1),
    ua.VariantType.Byte: (0, 2**8 - 1),
    ua.VariantType.Int16: (-(2**15), 2**15 - 1),
    ua.VariantType.UInt16: (0, 2**16 - 1),
    ua.VariantType.Int32: (-(2**31), 2**31 - 1),
    ua.VariantType.UInt32: (0, 2**32 - 1),
    ua.VariantType.Int64: (-(2**63), 2**63 - 1),
    ua.VariantType.UInt64: (0, 2**64 - 1),
}
NUMBER_TYPES: Final = frozenset(
    {ua.VariantType.Boolean, *INTEGER_RANGES, ua.VariantType.Float, ua.VariantType.Double}
)
LARGEST_FLOAT32: Final = (2.0 - 2.0**-23) * 2.0**127

_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_LAST_YEAR: Final = 2262  # int64 nanoseconds end in it
_BAD: Final = 0x80000000
_OVERFLOW: Final = 0x0480  # InfoType DataValue with the Overflow bit (OPC 10000-4, 7.39.1)
_LIMIT_BITS: Final = 0x0300

Decoded = tuple[float, int, int | None]
"""Value, raw StatusCode, source timestamp in ns UTC or None."""


def decode(data: ua.DataValue, index: int | None) -> Decoded:
    """The sample in a DataValue, or in one element of it (row by row where there are several dimensions)."""
    status = status_of(data)
    stamp = nanoseconds(data.SourceTimestamp)
    if status & _BAD:
        return math.nan, status, stamp
    variant = data.Value
    if variant is None or (variant.Value is None and not variant.is_array):
        return math.nan, StatusCode.BAD_WAITING_FOR_INITIAL_DATA, stamp
    if variant.VariantType not in NUMBER_TYPES or bool(variant.is_array) is (index is None):
        return math.nan, StatusCode.BAD_TYPE_MISMATCH, stamp
    if index is None:
        return float(variant.Value), status, stamp
    elements = flat(variant.Value)
    if index >= len(elements):
        return math.nan, StatusCode.BAD_OUT_OF_RANGE, stamp
    return float(elements[index]), status, stamp


def encode(value: float, variant_type: ua.VariantType) -> ua.Variant | None:
    """The number as this type, integers rounded half to even; None when it does not fit or is not finite."""
    if not math.isfinite(value):
        return None
    if variant_type == ua.VariantType.Boolean:
        return ua.Variant(value == 1.0, variant_type) if value in (0.0, 1.0) else None
    if variant_type in INTEGER_RANGES:
        lowest, highest = INTEGER_RANGES[variant_type]
        number = round(value)
        return ua.Variant(number, variant_type) if lowest <= number <= highest else None
    if variant_type == ua.VariantType.Float:
        return ua.Variant(value, variant_type) if abs(value) <= LARGEST_FLOAT32 else None
    if variant_type == ua.VariantType.Double:
        return ua.Variant(value, variant_type)
    return None


def write_value(node: ua.NodeId, number: ua.Variant, index: int | None) -> ua.WriteValue:
    """The request for one number, or element of an array; no status and timestamps, which many PLCs refuse."""
    variant = number if index is None else ua.Variant([number.Value], number.VariantType, is_array=True)
    return ua.WriteValue(
        NodeId=node,
        AttributeId=ua.AttributeIds.Value,
        IndexRange=None if index is None else str(index),
        Value=ua.DataValue(variant, StatusCode=None),
    )


def range_text(variant_type: ua.VariantType) -> str:
    """What `encode` accepts for this type, for a person."""
    if variant_type in INTEGER_RANGES:
        return "{} … {}".format(*INTEGER_RANGES[variant_type])
    return {ua.VariantType.Boolean: "0 or 1", ua.VariantType.Float: f"±{LARGEST_FLOAT32:.4g}"}.get(
        variant_type, "any number"
    )


def status_of(data: ua.DataValue) -> int:
    """The raw StatusCode, Good where there is none, without Overflow: that speaks of the server's queue."""
    status = 0 if data.StatusCode is None else int(data.StatusCode.value)
    if status & _OVERFLOW == _OVERFLOW:
        status &= ~_OVERFLOW if not status & _LIMIT_BITS else ~0x80
    return status


def overflowed(data: ua.DataValue) -> bool:
    """True when the server's queue dropped samples before this one."""
    return data.StatusCode is not None and int(data.StatusCode.value) & _OVERFLOW == _OVERFLOW


def nanoseconds(stamp: datetime | None) -> int | None:
    """A timestamp in ns UTC; None where there is none or it stands for none (before 1970, year 9999)."""
    if stamp is None or not 1970 <= stamp.year < _LAST_YEAR:
        return None
    since = stamp - (_EPOCH if stamp.tzinfo else _EPOCH.replace(tzinfo=None))
    nanos = (since.days * 86_400 + since.seconds) * 1_000_000_000 + since.microseconds * 1_000
    return nanos or None


def flat(elements: Any) -> list[Any]:
    """The elements of an array of any number of dimensions, row by row."""
    while elements and isinstance(elements[0], list):
        elements = [element for row in elements for element in row]
    return elements or []
