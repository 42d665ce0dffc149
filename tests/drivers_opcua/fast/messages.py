"""DataValues of every encoding, and the messages that carry them, as asyncua encodes them and as others may."""

import struct
from datetime import UTC, datetime, timedelta
from typing import Any
from unittest import mock

from asyncua import ua
from asyncua.common.utils import Buffer
from asyncua.ua import ua_binary
from asyncua.ua.ua_binary import struct_from_binary, struct_to_binary
from hypothesis import strategies as st

from softplc.drivers.opcua.values import INTEGER_RANGES

GOOD_BAD_UNCERTAIN = [0, 0x40930000, 0x808C0000, 0x80340000, 0x00000480, 0x40000780, 0x80000480, 0x00000580]
T = ua.VariantType
SIZES = {0: 0, 1: 1, 2: 1, 3: 1, 4: 2, 5: 2, 6: 4, 7: 4, 8: 8, 9: 8, 10: 4, 11: 8, 13: 8}
SCALARS = [T.Boolean, *INTEGER_RANGES, T.Float, T.Double]


def number_of(kind: ua.VariantType) -> st.SearchStrategy[Any]:
    if kind == T.Boolean:
        return st.booleans()
    if kind in INTEGER_RANGES:
        return st.integers(*INTEGER_RANGES[kind])
    return st.floats(width=32 if kind == T.Float else 64)


def numbers() -> st.SearchStrategy[ua.Variant]:
    return st.sampled_from(SCALARS).flatmap(lambda kind: number_of(kind).map(lambda value: ua.Variant(value, kind)))


def arrays() -> st.SearchStrategy[ua.Variant]:
    def of(kind: ua.VariantType) -> st.SearchStrategy[ua.Variant]:
        return st.lists(number_of(kind), max_size=4).map(lambda value: ua.Variant(value, kind, is_array=True))

    matrix = ua.Variant([[1.0, 2.0], [3.0, 4.0]], T.Double)
    return st.sampled_from(SCALARS).flatmap(of) | st.just(matrix)


def others() -> st.SearchStrategy[ua.Variant]:
    stamp = datetime(2024, 5, 17, tzinfo=UTC)
    return st.sampled_from(
        [
            ua.Variant(),
            ua.Variant("seven", T.String),
            ua.Variant(None, T.String),
            ua.Variant(b"\x01\x02", T.ByteString),
            ua.Variant(stamp, T.DateTime),
            ua.Variant(ua.NodeId("x", 2), T.NodeId),
            ua.Variant(ua.StatusCode(0x80000000), T.StatusCode),
            ua.Variant(ua.LocalizedText("text"), T.LocalizedText),
            ua.Variant(None, T.Double, is_array=True),
        ]
    )


def stamps() -> st.SearchStrategy[datetime | None]:
    """Of this age, with the µs that asyncua has; before 1970 and after all ages, as PLCs without a clock send."""
    usual = st.integers(0, 10**15).map(
        lambda micros: datetime(2020, 1, 1, tzinfo=UTC) + timedelta(microseconds=micros)
    )
    odd = [datetime(1601, 1, 1), datetime(1970, 1, 1), datetime(1969, 12, 31, 23, 59, 59, 999999)]
    late = [datetime(2261, 12, 31, 23, 59, 59, 999999), datetime(2262, 1, 1), datetime(9999, 12, 31, 23, 59, 59)]
    return st.none() | usual | st.sampled_from([stamp.replace(tzinfo=UTC) for stamp in odd + late])


def data_values(values: st.SearchStrategy[ua.Variant] | None = None) -> st.SearchStrategy[ua.DataValue]:
    statuses = st.none() | st.sampled_from(GOOD_BAD_UNCERTAIN) | st.integers(0, 2**32 - 1)
    pico = st.none() | st.integers(0, 9999)
    return st.builds(
        ua.DataValue,
        numbers() | arrays() | others() if values is None else values,
        statuses.map(lambda status: None if status is None else ua.StatusCode(status)),
        stamps(),
        stamps(),
        pico,
        pico,
    )


@st.composite
def encoded_values(draw: st.DrawFn) -> bytes:
    """One DataValue as bytes, by asyncua's encoder or, with and without each part, put together here."""
    data = draw(data_values())
    if draw(st.booleans()):
        return struct_to_binary(data)
    mask = draw(st.integers(0, 63))
    kind, size = draw(st.sampled_from(list(SIZES.items())))
    ticks = draw(st.integers(-(2**63), 2**63 - 1) | st.integers(132 * 10**15, 134 * 10**15))
    parts = [
        (0x01, bytes([kind]) + draw(st.binary(min_size=size, max_size=size))),
        (0x02, draw(st.sampled_from(GOOD_BAD_UNCERTAIN)).to_bytes(4, "little")),
        (0x04, struct.pack("<q", ticks)),
        (0x08, draw(st.binary(min_size=8, max_size=8))),
        (0x10, draw(st.binary(min_size=2, max_size=2))),
        (0x20, draw(st.binary(min_size=2, max_size=2))),
    ]
    return bytes([mask]) + b"".join(part for bit, part in parts if mask & bit)


@st.composite
def value_lists(draw: st.DrawFn) -> list[bytes]:
    """Records as they come: runs of equal layout, single ones between them."""
    records: list[bytes] = []
    for _ in range(draw(st.integers(0, 6))):
        records += [draw(encoded_values())] * draw(st.sampled_from([1, 1, 2, 7, 9, 70, 600]))
    return records


def read_response(records: list[bytes], tail: bytes = b"\xff\xff\xff\xff", count: int | None = None) -> bytes:
    """A Good ReadResponse with these results."""
    empty = struct_to_binary(ua.ReadResponse())
    return empty[:28] + struct.pack("<i", len(records) if count is None else count) + b"".join(records) + tail


def reference(response: type, body: bytes) -> Any:
    """What asyncua's codec makes of a body, where no array has more nulls than bytes: it would make them all."""
    with mock.patch.object(ua_binary, "unpack_uatype_array", _bounded_array):
        return struct_from_binary(response, Buffer(body))


_unbounded_array = ua_binary.unpack_uatype_array


def _bounded_array(kind: ua.VariantType, data: Buffer) -> list[Any] | None:
    if kind == T.Null and int.from_bytes(data.copy().read(4), "little", signed=True) > len(data):
        raise ua.UaError("more nulls than bytes")
    return _unbounded_array(kind, data)
