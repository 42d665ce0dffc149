"""Reported changes decoded all at once against asyncua's codec: same samples, same counts, or asyncua's decoder."""

import struct
from typing import Any

import numpy as np
import pytest
from asyncua import ua
from asyncua.ua.ua_binary import nodeid_to_binary, struct_to_binary
from hypothesis import given, settings
from hypothesis import strategies as st

from softplc.clock import SystemClock
from softplc.drivers.opcua.binding import put
from softplc.drivers.opcua.fast.notification import Changes, read_published
from softplc.drivers.opcua.fast.plain import SlowState
from softplc.drivers.opcua.subscription import Subscription
from softplc.errors import LinkError
from softplc.tags import Image
from tests.drivers_opcua.fast.messages import data_values, numbers, reference, value_lists
from tests.drivers_opcua.fast.test_read_codec import ARRIVAL, NOW, bind, same

few = settings(max_examples=60, deadline=None)
READINGS = 7
ID = 9


class Line:
    """Stands where the session stands, for a subscription that is given its messages directly."""

    url = "opc.tcp://plc"


def notification(items: list[tuple[int, bytes]], tail: bytes = b"\xff\xff\xff\xff") -> bytes:
    records = b"".join(struct.pack("<I", handle) + record for handle, record in items)
    body = struct.pack("<i", len(items)) + records + tail
    kind = nodeid_to_binary(ua.NodeId(ua.ObjectIds.DataChangeNotification_Encoding_DefaultBinary))
    return kind + b"\x01" + struct.pack("<i", len(body)) + body


def published(
    notifications: list[bytes],
    number: int = 1,
    available: tuple[int, ...] = (1,),
    results: bytes = b"\xff\xff\xff\xff",
    tail: bytes = b"\xff\xff\xff\xff",
    subscription: int = ID,
) -> bytes:
    """A Good PublishResponse with these notifications."""
    head = struct_to_binary(ua.PublishResponse())[:28] + struct.pack("<Ii", subscription, len(available))
    head += b"".join(struct.pack("<I", each) for each in available)
    message = struct.pack("<?IqI", False, number, 133 * 10**15, len(notifications)) + b"".join(notifications)
    return head + message + results + tail


class Rig:
    """A subscription on the fast path, and what it delivers."""

    def __init__(self, uses: list[list[int | None]]) -> None:
        self.slow = SlowState()
        self.bindings = bind(uses)
        self.image = Image(sum(map(len, uses)))
        self.changes = Changes(self.bindings, self.image)
        self.handles: list[int] = []
        deliver, changed = self._deliver, self._changed
        self.subscription = Subscription(Line(), SystemClock(), 0.05, 3.0, deliver, self.slow, changed)  # type: ignore[arg-type]
        self.subscription._id = ID

    def _deliver(self, handle: int, data: ua.DataValue, _: float) -> None:
        self.handles.append(handle)
        put(self.bindings[handle], data, self.image, ARRIVAL, NOW)

    def _changed(self, body: bytes, message: Any, _: float) -> None:
        self.handles += self.changes.take(body, message, ARRIVAL, NOW)

    def take(self, body: bytes) -> list[ua.SubscriptionAcknowledgement]:
        return self.subscription._take_body(body, self._changed)

    @property
    def skipped(self) -> int:
        return self.subscription.skipped + self.changes.skipped


def compare(items: list[tuple[int, bytes]], uses: list[list[int | None]], body: bytes) -> Rig:
    """What our decoder makes of a message, and asyncua's."""
    ours, theirs = Rig(uses), Rig(uses)
    acknowledged = ours.take(body)
    expected = theirs.subscription._take(reference(ua.PublishResponse, body))

    same(ours.image, theirs.image)
    assert sorted(ours.handles) == sorted(theirs.handles) == sorted({handle for handle, _ in items})
    assert ours.skipped == theirs.skipped
    assert [binding.problem for binding in ours.bindings] == [binding.problem for binding in theirs.bindings]
    assert acknowledged == expected
    return ours


def all_uses() -> st.SearchStrategy[list[list[int | None]]]:
    one = st.lists(st.none() | st.integers(0, 3), max_size=3)
    return st.lists(one, min_size=READINGS, max_size=READINGS)


@few
@given(records=value_lists(), uses=all_uses(), data=st.data(), results=st.sampled_from([(), (0,), (0x80000000, 0)]))
def test_every_encoding_of_a_change_gives_what_asyncua_gives(
    records: list[bytes], uses: list[list[int | None]], data: st.DataObject, results: tuple[int, ...]
) -> None:
    handles = data.draw(st.lists(st.integers(0, READINGS - 1), min_size=1, max_size=9))
    items = [(handles[number % len(handles)], record) for number, record in enumerate(records)]
    told = struct.pack(f"<i{len(results)}I", len(results), *results)

    ours = compare(items, uses, published([notification(items)], results=told))

    assert ours.slow.messages == 0


@few
@given(
    values=st.lists(data_values(numbers()), min_size=READINGS, max_size=READINGS), number=st.integers(0, 2**32 - 1)
)
def test_messages_that_asyncua_encodes_are_not_decoded_by_it(values: list[ua.DataValue], number: int) -> None:
    items = [ua.MonitoredItemNotification(handle, value) for handle, value in enumerate(values)]
    response = ua.PublishResponse()
    response.Parameters.SubscriptionId = ID
    response.Parameters.NotificationMessage.SequenceNumber = number
    response.Parameters.NotificationMessage.NotificationData = [ua.DataChangeNotification(MonitoredItems=items)]
    records = [(handle, struct_to_binary(value)) for handle, value in enumerate(values)]

    ours = compare(records, [[None]] * READINGS, struct_to_binary(response))

    assert (ours.slow.messages, ours.changes.values) == (0, 0)


@few
@given(records=value_lists(), data=st.data())
def test_a_message_cut_short_or_spoilt_is_what_asyncua_takes_it_for_or_a_link_error(
    records: list[bytes], data: st.DataObject
) -> None:
    whole = published([notification([(number % READINGS, record) for number, record in enumerate(records)])])
    at = data.draw(st.integers(28, len(whole) - 1))
    cut = data.draw(st.booleans())
    body = whole[:at] if cut else whole[:at] + bytes([data.draw(st.integers(0, 255))]) + whole[at + 1 :]
    uses: list[list[int | None]] = [[None]] * READINGS
    ours, theirs = Rig(uses), Rig(uses)
    try:
        theirs.subscription._take(reference(ua.PublishResponse, body))
    except Exception:  # of any kind: it is garbage to asyncua
        with pytest.raises(LinkError):
            ours.take(body)
        return
    try:
        ours.take(body)
    except LinkError:
        return  # stricter than asyncua is well
    same(ours.image, theirs.image)
    assert ours.skipped == theirs.skipped


def test_a_keep_alive_delivers_nothing_and_is_not_acknowledged() -> None:
    rig = Rig([[None]])

    assert rig.take(published([], number=5, available=())) == []
    assert (rig.handles, rig.slow.messages) == ([], 0)


def test_what_is_no_plain_message_of_changes_goes_to_asyncua() -> None:
    record = struct_to_binary(ua.DataValue(ua.Variant(1.0, ua.VariantType.Double)))
    one = notification([(0, record)])
    cases = [
        published([one, notification([(0, record)])]),
        published([notification([(0, record)], tail=b"\x01\0\0\0\0")]),
        published([one], tail=b"\x01\0\0\0\0"),
    ]
    for body in cases:
        rig = Rig([[None]])

        rig.take(body)

        assert rig.slow.messages == 1
        assert rig.image.values.tolist() == [1.0]


def test_a_gap_a_foreign_subscription_and_an_unknown_item_are_link_errors() -> None:
    record = struct_to_binary(ua.DataValue(ua.Variant(1.0, ua.VariantType.Double)))
    rig = Rig([[None]])
    rig.take(published([notification([(0, record)])], number=4))
    for body, text in (
        (published([notification([(0, record)])], number=6), "notification 5 is missing"),
        (published([notification([(0, record)])], number=5, subscription=8), "which is not ours"),
        (published([notification([(1, record)])], number=5), "Publish"),
    ):
        with pytest.raises(LinkError, match=text):
            rig.take(body)


def test_garbage_in_place_of_counts_makes_nothing_large() -> None:
    body = bytearray(published([notification([(0, b"\0")])]))
    for at in range(28, len(body) - 3):
        spoilt = bytes(body[:at]) + b"\xff\xff\xff\x7f" + bytes(body[at + 4 :])
        message = read_published(spoilt)
        assert message is None or message.items <= len(body)


def test_the_newest_of_each_item_is_taken_and_older_ones_are_counted() -> None:
    double = ua.VariantType.Double
    items = [(n % 3, struct_to_binary(ua.DataValue(ua.Variant(float(n), double)))) for n in range(3000)]
    rig = compare(items, [[None], [None, None], []], published([notification(items)]))

    assert rig.image.values.tolist() == [2997.0, 2998.0, 2998.0]
    assert rig.skipped == 2997
    assert np.isfinite(rig.image.arrivals).all()
