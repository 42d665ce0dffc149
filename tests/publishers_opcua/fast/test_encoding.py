"""Bytes against asyncua's own codec: the same snapshot in, the same bytes out."""

import math

import numpy as np
import pytest
from asyncua import ua
from asyncua.ua.ua_binary import struct_to_binary
from hypothesis import given
from hypothesis import strategies as st

from softplc.publishers.opcua.fast.encoding import canonical, classes_of, encode, with_timestamps
from softplc.publishers.opcua.values import stamped
from softplc.sample import StatusCode
from softplc.tags import DataType
from tests.publishers_opcua.fast.conftest import TYPES, Sampled, served

NOW = 1_700_000_000_123_456_789
STAMPS = st.one_of(st.sampled_from([0, 1, 999, 1_000, NOW]), st.integers(-(2**63), 2**63 - 1))
STATUSES = st.one_of(st.just(0), st.sampled_from([int(code) for code in StatusCode]), st.integers(0, 2**32 - 1))
NUMBERS = {
    DataType.DOUBLE: st.floats(),
    DataType.BOOLEAN: st.sampled_from([0.0, 1.0, 0.5, -3.0]),
    DataType.UINT16: st.floats(0, 65535),
    DataType.UINT32: st.floats(0, 2**32 - 1),
    DataType.INT64: st.one_of(st.floats(-(2.0**63), 2.0**63), st.integers(-(2**53), 2**53).map(float)),
}
SAMPLES = st.sampled_from(TYPES).flatmap(
    lambda kind: st.tuples(st.just(kind), st.one_of(NUMBERS[kind], st.floats()), STATUSES, STAMPS)
)


@given(
    samples=st.one_of(st.lists(SAMPLES, min_size=1, max_size=12), SAMPLES.map(lambda sample: [sample] * 3)),
    wanted=st.sampled_from([0, 1, 2, 3]),
)
def test_values_are_encoded_as_asyncua_encodes_them(samples: list[Sampled], wanted: int) -> None:
    values = served(samples, NOW)

    found = encode(
        with_timestamps(classes_of(values.table), np.uint8(wanted)),
        values.values,
        values.statuses,
        values.source_timestamps,
        NOW,
    )

    timestamps = ua.TimestampsToReturn(wanted)
    assert found == b"".join(
        struct_to_binary(stamped(values.data_value(index), timestamps)) for index in range(len(samples))
    )


@given(samples=st.lists(st.tuples(SAMPLES, st.integers(0, 2**32 - 1), st.integers(0, 3)), min_size=1, max_size=12))
def test_notifications_are_encoded_as_asyncua_encodes_them(samples: list[tuple[Sampled, int, int]]) -> None:
    values = served([sample for sample, _, _ in samples], NOW)
    handles, wanted = (np.array([sample[field] for sample in samples]) for field in (1, 2))
    servers = NOW + np.arange(len(samples)) * 7_000

    found = encode(
        with_timestamps(classes_of(values.table), wanted.astype(np.uint8)),
        values.values,
        values.statuses,
        values.source_timestamps,
        servers,
        handles,
    )

    expected = b""
    for index, (_, handle, stamps) in enumerate(samples):
        values.take(values.snapshot, int(servers[index]))  # type: ignore[arg-type]
        value = stamped(values.data_value(index), ua.TimestampsToReturn(stamps))
        expected += struct_to_binary(ua.MonitoredItemNotification(handle, value))
    assert found == expected


@pytest.mark.parametrize(
    ("data_type", "value", "expected"),
    [
        (DataType.DOUBLE, -1.5, -1.5),
        (DataType.BOOLEAN, 0.5, 1.0),
        (DataType.BOOLEAN, 0.0, 0.0),
        (DataType.UINT16, 7.9, 7.0),
        (DataType.INT64, -7.9, -7.0),
    ],
)
def test_the_canonical_value_is_the_one_that_a_client_sees(
    data_type: DataType, value: float, expected: float
) -> None:
    values = served([(data_type, value, 0, NOW), (data_type, value, StatusCode.BAD, NOW)], NOW)
    numbers = values.values.copy()

    canonical(classes_of(values.table), numbers, values.statuses)

    assert numbers[0] == expected
    assert math.isnan(numbers[1])
