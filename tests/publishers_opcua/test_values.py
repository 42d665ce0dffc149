"""From snapshots to DataValues, and which tags are worth a look: without a server."""

import math

import numpy as np
import pytest
from asyncua import ua

from softplc.clock import VirtualClock
from softplc.publishers.opcua.hardened.filters import reportable
from softplc.publishers.opcua.values import TagValues, Watch, utc
from softplc.sample import StatusCode
from tests.support.exchange import Exchange, make_exchange


@pytest.fixture
def exchange() -> Exchange:
    return make_exchange(VirtualClock())


def taken(exchange: Exchange) -> TagValues:
    values = TagValues(exchange.table, exchange.clock.utc_ns())
    values.take(exchange.reader.snapshot(), exchange.clock.utc_ns())
    return values


@pytest.mark.parametrize(
    ("name", "value", "variant_type", "expected"),
    [
        ("AxisX.Position", 1.25, "Double", 1.25),
        ("AxisX.Enabled", 1.0, "Boolean", True),
        ("AxisX.Enabled", 0.0, "Boolean", False),
        ("AxisX.Reason", 9.0, "UInt16", 9),
        ("Tasks.main.Heartbeat", 65535.0, "UInt16", 65535),
        ("Sources.plc1.ReadErrors", 4294967295.0, "UInt32", 4294967295),
    ],
)
def test_values_have_the_type_of_their_tag(
    exchange: Exchange, name: str, value: float, variant_type: str, expected: object
) -> None:
    index = exchange.table.index(name)
    exchange.publish()
    exchange.set(name, value)
    exchange.writer.publish(0, exchange.reader.snapshot().scans[0], exchange.image)  # type: ignore[arg-type]

    found = taken(exchange).data_value(index)

    assert (variant_type, expected) == (found.Value.VariantType.name, found.Value.Value)
    assert type(expected) is type(found.Value.Value)


@pytest.mark.parametrize("status", [0x80000000, 0x80310000, 0xC0000000, 0x80AB0000])
def test_a_bad_value_is_null_and_keeps_its_status_and_time(exchange: Exchange, status: int) -> None:
    index = exchange.table.index("AxisX.Position")
    exchange.set("AxisX.Position", math.nan, status, stamp=1_600_000_000_123_456_789)
    exchange.publish()

    found = taken(exchange).data_value(index)

    assert (None, status) == (found.Value.Value, found.StatusCode.value)
    assert utc(1_600_000_000_123_456_000) == found.SourceTimestamp


@pytest.mark.parametrize("value", [-1.0, 65536.0, math.nan, math.inf])
def test_a_number_that_the_type_cannot_hold_is_out_of_range(exchange: Exchange, value: float) -> None:
    index = exchange.table.index("AxisX.Reason")
    exchange.set("AxisX.Reason", value)
    exchange.publish()

    found = taken(exchange).data_value(index)

    assert (found.StatusCode.value, found.Value.Value) == (StatusCode.BAD_OUT_OF_RANGE, None)


def test_a_tag_without_source_timestamp_has_that_of_its_scan(exchange: Exchange) -> None:
    exchange.set("AxisX.Position", 1.0, stamp=0)
    exchange.clock.advance(3.0)  # type: ignore[attr-defined]
    scan = exchange.publish()

    found = taken(exchange).data_value(exchange.table.index("AxisX.Position"))

    assert utc(scan.timestamp) == found.SourceTimestamp


def test_before_the_first_scan_everything_waits_for_initial_data(exchange: Exchange) -> None:
    values = taken(exchange)

    found = [values.data_value(index) for index in range(len(exchange.table))]

    assert {StatusCode.BAD_WAITING_FOR_INITIAL_DATA} == {value.StatusCode.value for value in found}
    assert {None} == {value.Value.Value for value in found}
    assert {utc(exchange.clock.utc_ns())} == {value.SourceTimestamp for value in found}


def test_only_what_changed_is_marked(exchange: Exchange) -> None:
    table = exchange.table
    exchange.set("AxisX.Position", math.nan, StatusCode.BAD_TIMEOUT)
    exchange.publish()
    values = taken(exchange)
    assert values.take(exchange.reader.snapshot(), 0) is None

    exchange.set("AxisX.Velocity", 7.5)
    exchange.image.source_timestamps[table.index("AxisX.Raw")] += 1_000
    exchange.image.statuses[table.index("AxisX.S")] = StatusCode.UNCERTAIN
    exchange.publish()
    changes = values.take(exchange.reader.snapshot(), exchange.clock.utc_ns())

    assert changes is not None
    moved, restamped = ([table.tags[i].name for i in np.flatnonzero(mask)] for mask in changes)
    assert moved == ["Tasks.main.Heartbeat", "AxisX.Velocity", "AxisX.S"]
    assert restamped == ["AxisX.Raw"]


def test_a_watch_looks_only_at_monitored_tags_that_changed() -> None:
    watch = Watch({"a": 0, "b": 1, "c": 2}, 0.05)
    watch.add(0, stamped=False)
    watch.add(1, stamped=True)
    every = np.array([True, True, True])
    none = np.array([False, False, False])

    assert watch.due((every, none), 0.0) == [0, 1]
    assert watch.due((none, every), 0.0) == [1]
    assert watch.due(None, 0.0) == []
    watch.remove(0)
    assert watch.due((every, none), 0.0) == [1]


def test_a_postponed_tag_is_looked_at_again_when_it_is_due() -> None:
    watch = Watch({"a": 0, "b": 1}, 0.05)
    watch.postpone(1, 1.0)

    assert watch.due(None, 0.9) == []
    assert watch.due(None, 1.0) == [1]
    assert watch.due(None, 1.1) == []


def value(number: object, status: int = 0, stamp: int = 0) -> ua.DataValue:
    return ua.DataValue(ua.Variant(number), ua.StatusCode(status), utc(stamp))


def banded(kind: str, width: float, trigger: str = "StatusValue") -> ua.DataChangeFilter:
    trigger_value = getattr(ua.DataChangeTrigger, trigger)
    return ua.uaprotocol_auto.DataChangeFilter(trigger_value, getattr(ua.DeadbandType, kind), width)


@pytest.mark.parametrize(
    ("flt", "reported", "new", "expected"),
    [
        (None, None, value(1.0), True),
        (None, value(1.0), value(1.0, stamp=5_000), False),
        (None, value(1.0), value(1.1), True),
        (None, value(1.0), value(None, StatusCode.BAD), True),
        (None, value(1.0), value(1.0, StatusCode.UNCERTAIN), True),
        (None, value(math.nan), value(math.nan), False),
        (None, value(1.0), value(math.nan), True),
        (banded("None_", 0.0, "Status"), value(1.0), value(2.0), False),
        (banded("None_", 0.0, "Status"), value(1.0), value(1.0, StatusCode.UNCERTAIN), True),
        (banded("None_", 0.0, "StatusValueTimestamp"), value(1.0), value(1.0, stamp=5_000), True),
        (banded("None_", 0.0, "StatusValueTimestamp"), value(1.0), value(1.0), False),
        (banded("Absolute", 0.5), value(1.0), value(1.5), False),
        (banded("Absolute", 0.5), value(1.0), value(1.6), True),
        (banded("Absolute", 0.5), value(1.0), value(None, StatusCode.BAD), True),
        (banded("Absolute", 0.5), value(None, StatusCode.BAD), value(1.0), True),
        (banded("Absolute", 0.5), value(1.0), value(math.nan), True),
        (banded("Absolute", 0.5), value(1.0), value(1.1, StatusCode.UNCERTAIN), True),
        (banded("Absolute", 0.5, "StatusValueTimestamp"), value(1.0), value(1.0, stamp=5_000), False),
        (banded("Percent", 1.0), value(1.0), value(2.9), False),  # 1 % of 200 is 2
        (banded("Percent", 1.0), value(1.0), value(3.1), True),
    ],
)
def test_what_a_monitored_item_reports(
    flt: ua.DataChangeFilter, reported: ua.DataValue, new: ua.DataValue, expected: bool
) -> None:
    assert expected == reportable(flt, reported, new, lambda: 200.0)
