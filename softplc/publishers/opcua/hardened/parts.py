"""The part of a value that a ReadValueId asks for by IndexRange and DataEncoding (OPC 10000-4, 7.29 and 7.27)."""

import re
from dataclasses import replace
from typing import Any, Final

from asyncua import ua

_RANGE: Final = re.compile(r"([0-9]{1,9})(?::([0-9]{1,9}))?")
_BINARY: Final = (0, "Default Binary")


def part_of(value: Any, asked: Any) -> Any:
    """The DataValue with what is asked for of it; with a Bad status where that cannot be had.

    asyncua: all of the value, whatever was asked for.
    """
    if not asked.IndexRange and not asked.DataEncoding.Name:
        return value
    try:
        slices = [_slice(text) for text in asked.IndexRange.split(",")] if asked.IndexRange else []
    except ValueError:
        return _failed(ua.StatusCodes.BadIndexRangeInvalid)
    status = 0 if value.StatusCode.is_bad() else _encoding_status(value, asked)
    if status:
        return _failed(status)
    if value.StatusCode.is_bad() or not slices:
        return value
    try:
        cut = _cut(None if value.Value is None else value.Value.Value, slices)
    except LookupError:
        return replace(value, Value=ua.Variant(), StatusCode=ua.StatusCode(ua.StatusCodes.BadIndexRangeNoData))
    return replace(value, Value=ua.Variant(cut, value.Value.VariantType, is_array=isinstance(cut, list)))


def _failed(status: int) -> Any:
    return ua.DataValue(StatusCode=ua.StatusCode(status))


def _encoding_status(value: Any, asked: Any) -> int:
    """0 when the value can be encoded as asked, else the status that says why not; only structures have a choice."""
    encoding = asked.DataEncoding
    if not encoding.Name:
        return 0
    structured = value.Value is not None and value.Value.VariantType == ua.VariantType.ExtensionObject
    if asked.AttributeId != ua.AttributeIds.Value or not structured:
        return int(ua.StatusCodes.BadDataEncodingInvalid)
    known = (encoding.NamespaceIndex, encoding.Name) == _BINARY
    return 0 if known else int(ua.StatusCodes.BadDataEncodingUnsupported)


def _slice(text: str) -> slice:
    """The elements that one dimension of a NumericRange names. Raises ValueError when it is none."""
    found = _RANGE.fullmatch(text)
    if found is None:
        raise ValueError(text)
    first = int(found[1])
    last = first if found[2] is None else int(found[2])
    if found[2] is not None and last <= first:
        raise ValueError(text)
    return slice(first, last + 1)


def _cut(value: Any, slices: list[slice]) -> Any:
    """These elements of an array, a text or bytes, and of each of them in turn. Raises LookupError without any."""
    if not isinstance(value, list | str | bytes) or (len(slices) > 1 and not isinstance(value, list)):
        raise LookupError
    part = value[slices[0]]
    if not part:
        raise LookupError
    return part if len(slices) == 1 else [_cut(each, slices[1:]) for each in part]
