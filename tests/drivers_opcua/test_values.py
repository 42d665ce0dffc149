import math
from datetime import UTC, datetime

import pytest
from asyncua import ua
from hypothesis import given
from hypothesis import strategies as st

from softplc.drivers.opcua.values import decode, encode, nanoseconds, overflowed, status_of
from softplc.sample import StatusCode

V = ua.VariantType
STAMP = datetime(2024, 5, 17, 8, 30, 0, 123456, UTC)
STAMP_NS = 1_715_934_600_123_456_000


def data(
    value: object, variant_type: ua.VariantType, status: int = 0, stamp: datetime | None = STAMP
) -> ua.DataValue:
    return ua.DataValue(ua.Variant(value, variant_type), ua.StatusCode(status), stamp)


@pytest.mark.parametrize(
    ("value", "variant_type", "number"),
    [
        (True, V.Boolean, 1.0),
        (False, V.Boolean, 0.0),
        (-128, V.SByte, -128.0),
        (255, V.Byte, 255.0),
        (-32768, V.Int16, -32768.0),
        (65535, V.UInt16, 65535.0),
        (-(2**31), V.Int32, -2147483648.0),
        (2**32 - 1, V.UInt32, 4294967295.0),
        (-(2**63), V.Int64, -9223372036854775808.0),
        (2**64 - 1, V.UInt64, 18446744073709551616.0),  # the nearest float64
        (0.5, V.Float, 0.5),
        (1e300, V.Double, 1e300),
    ],
)
def test_every_number_type_becomes_a_float(value: object, variant_type: ua.VariantType, number: float):
    assert (number, 0, STAMP_NS) == decode(data(value, variant_type), None)


def test_uncertain_keeps_its_value_and_bad_does_not():
    assert decode(data(6.0, V.Double, 0x40900000), None) == (6.0, 0x40900000, STAMP_NS)

    value, status, stamp = decode(data(6.0, V.Double, 0x808C0000), None)
    assert math.isnan(value)
    assert (status, stamp) == (0x808C0000, STAMP_NS)


def test_a_reserved_severity_counts_as_bad():
    assert math.isnan(decode(data(6.0, V.Double, 0xC0000000), None)[0])


def test_not_finite_with_good_status_is_passed_on():
    assert math.inf == decode(data(math.inf, V.Double), None)[0]
    assert decode(data(math.nan, V.Double), None)[1] == StatusCode.GOOD


@pytest.mark.parametrize(
    ("given_data", "index", "status"),
    [
        (data("7", V.String), None, StatusCode.BAD_TYPE_MISMATCH),
        (data(STAMP, V.DateTime), None, StatusCode.BAD_TYPE_MISMATCH),
        (data([1.0, 2.0], V.Double), None, StatusCode.BAD_TYPE_MISMATCH),
        (data(1.0, V.Double), 0, StatusCode.BAD_TYPE_MISMATCH),
        (data([1.0, 2.0], V.Double), 2, StatusCode.BAD_OUT_OF_RANGE),
        (data([], V.Double), 0, StatusCode.BAD_OUT_OF_RANGE),
        (data(None, V.Null), None, StatusCode.BAD_WAITING_FOR_INITIAL_DATA),
        (ua.DataValue(), None, StatusCode.BAD_WAITING_FOR_INITIAL_DATA),
    ],
)
def test_what_is_no_number_is_bad_with_the_reason(given_data: ua.DataValue, index: int | None, status: int):
    value, found, _ = decode(given_data, index)

    assert math.isnan(value)
    assert status == found


def test_array_elements_are_found_by_index_row_by_row():
    assert decode(data([1.0, 2.0], V.Double), 1)[0] == 2.0
    assert decode(data([[1, 2, 3], [4, 5, 6]], V.Int32), 3)[0] == 4.0


def test_overflow_of_the_servers_queue_is_noticed_and_does_not_show_in_the_status():
    full = data(1.0, V.Double, 0x00000480)
    assert overflowed(full)
    assert status_of(full) == StatusCode.GOOD
    limited = data(1.0, V.Double, 0x40940580)  # Uncertain, Overflow and LimitLow
    assert status_of(limited) == 0x40940500


@pytest.mark.parametrize(
    "stamp",
    [
        None,
        datetime(9999, 12, 31, 23, 59, 59, tzinfo=UTC),
        datetime(1601, 1, 1, tzinfo=UTC),
        datetime(1970, 1, 1, tzinfo=UTC),
    ],
)
def test_a_timestamp_that_stands_for_none_is_none(stamp: datetime | None):
    assert nanoseconds(stamp) is None


def test_a_naive_timestamp_is_utc():
    assert nanoseconds(STAMP.replace(tzinfo=None)) == STAMP_NS


@pytest.mark.parametrize(
    ("value", "variant_type", "written"),
    [
        (127.4, V.SByte, 127),
        (127.5, V.SByte, None),  # rounds to 128
        (-0.4, V.Byte, 0),
        (-1.0, V.UInt32, None),
        (70000.0, V.Int16, None),
        (2.5, V.Int32, 2),
        (1e19, V.Int64, None),
        (1e19, V.UInt64, 10**19),
        (1.0, V.Boolean, True),
        (0.0, V.Boolean, False),
        (2.0, V.Boolean, None),
        (1e39, V.Float, None),
        (3.4e38, V.Float, 3.4e38),
        (1e39, V.Double, 1e39),
        (math.nan, V.Double, None),
        (math.inf, V.Float, None),
        (1.0, V.String, None),
    ],
)
def test_a_number_is_written_as_the_variables_type_or_not_at_all(
    value: float, variant_type: ua.VariantType, written: object
):
    variant = encode(value, variant_type)

    assert written == (None if variant is None else variant.Value)
    assert variant is None or variant.VariantType == variant_type


@given(st.floats(allow_nan=True, allow_infinity=True))
def test_whatever_number_is_written_the_library_can_encode_it(value: float):
    from asyncua.ua.ua_binary import variant_from_binary, variant_to_binary

    for variant_type in V:
        variant = encode(value, variant_type)
        if variant is not None:
            back = variant_from_binary(ua.utils.Buffer(variant_to_binary(variant)))
            assert abs(back.Value - value) <= max(0.5, abs(value) * 2**-24)  # a rounded integer, or float32 precision
