"""What the sweep reports, against the rules item by item, and what the queues keep."""

import numpy as np
import pytest
from asyncua import ua
from asyncua.ua.ua_binary import struct_to_binary
from hypothesis import given
from hypothesis import strategies as st

from softplc.publishers.opcua.fast.items import data_change
from softplc.publishers.opcua.fast.queue import ENTRY, Queue, keep
from softplc.publishers.opcua.fast.sweep import NO_BAND, Sweep, Terms
from softplc.publishers.opcua.hardened.filters import reportable
from softplc.publishers.opcua.values import TagValues, Watch
from softplc.sample import StatusCode
from softplc.snapshot import Snapshot
from softplc.tags import DataType
from tests.publishers_opcua.fast.conftest import TYPES, Sampled, served

NOW = 1_700_000_000_000_000_000
PERIOD = 50_000_000


def terms(**other: object) -> Terms:
    plain = {
        "handle": 7, "stamps": 2, "valued": True, "stamped": False, "band": NO_BAND, "interval": 0.0, "size": 10,
        "oldest": True,
    }  # fmt: skip
    return Terms(**{**plain, **other})  # type: ignore[arg-type]


class Swept:
    """Tags, a sweep over them, and its queues."""

    def __init__(self, samples: list[Sampled], queues: int = 1) -> None:
        self.values: TagValues = served(samples, NOW)
        self.watch = Watch({str(index): index for index in range(len(samples))}, 0.05)
        self.sweep = Sweep(self.values, self.watch)
        self.queues = [Queue() for _ in range(queues)]
        self.numbers = [self.sweep.open(queue) for queue in self.queues]
        self.scans = 0

    def add(self, tag: int, queue: int = 0, **other: object) -> int:
        slot = self.sweep.add(tag, self.numbers[queue], terms(**other), active=True)
        self.sweep.look(np.array([slot]))
        return slot

    def scan(self, samples: list[Sampled]) -> None:
        self.scans += 1
        self.watch.now += 0.05
        columns = [np.array([sample[field] for sample in samples]) for field in (1, 2, 3)]
        types = (float, np.uint32, np.int64)
        arrays = [column.astype(kind) for column, kind in zip(columns, types, strict=True)]
        self.values.take(Snapshot(self.scans, *arrays, (None,), (True,)), NOW + self.scans * PERIOD)  # type: ignore[arg-type]
        self.sweep.look()

    def take(self, queue: int = 0, most: int = 1 << 20) -> list[tuple[int, float]]:
        entries = self.sweep.take(self.numbers[queue], most)
        return [(int(entry["slot"]), float(entry["value"])) for entry in entries]


def double(value: float, status: int = 0, stamp: int = NOW) -> Sampled:
    return DataType.DOUBLE, value, status, stamp


STEPS = st.tuples(
    st.sampled_from([0.0, 1.0, 1.4, 2.0, 65535.0, -1.7e308, 1.7e308, float("nan"), float("inf")]),
    st.sampled_from([0, 0, 0, int(StatusCode.UNCERTAIN), int(StatusCode.BAD), int(StatusCode.BAD_TIMEOUT)]),
    st.sampled_from([NOW, NOW + 1, NOW + 5_000]),
)


@given(
    kind=st.sampled_from(TYPES),
    steps=st.lists(STEPS, min_size=1, max_size=8),
    trigger=st.sampled_from([0, 1, 2]),
    band=st.one_of(st.none(), st.sampled_from([0.0, 0.5, 1.0])),
)
def test_a_sweep_reports_what_the_rules_say(
    kind: DataType, steps: list[tuple[float, int, int]], trigger: int, band: float | None
) -> None:
    samples = [(kind, *step) for step in steps]
    swept = Swept([samples[0]])
    dead_band = ua.DeadbandType.None_ if band is None else ua.DeadbandType.Absolute
    flt = ua.uaprotocol_auto.DataChangeFilter(ua.DataChangeTrigger(trigger), dead_band, band or 0.0)
    swept.add(
        0, band=NO_BAND if band is None else band, valued=trigger > 0, stamped=trigger == 2 and band is None, size=100
    )
    expected = [swept.values.data_value(0)]

    for sample in samples[1:]:
        swept.scan([sample])
        new = swept.values.data_value(0)
        if reportable(flt, expected[-1], new, lambda: 1.0):
            expected.append(new)

    body = data_change(swept.sweep.take(swept.numbers[0], 1000))
    notification = ua.DataChangeNotification([ua.MonitoredItemNotification(7, value) for value in expected])
    assert body == struct_to_binary(notification)


def test_items_of_two_subscriptions_report_each_to_its_own() -> None:
    swept = Swept([double(1.0), double(2.0)], queues=2)
    first, second = swept.add(0, 0), swept.add(1, 1)

    swept.scan([double(3.0), double(4.0)])

    assert swept.take(0) == [(first, 1.0), (first, 3.0)]
    assert swept.take(1) == [(second, 2.0), (second, 4.0)]


def test_a_queue_keeps_the_newest_and_says_that_some_were_lost() -> None:
    swept = Swept([double(0.0), double(0.0)])
    one, three = swept.add(0, size=1), swept.add(1, size=3)
    for number in range(1, 6):
        swept.scan([double(number), double(number)])

    entries = swept.sweep.take(swept.numbers[0], 100)

    found = [(int(e["slot"]), float(e["value"]), int(e["status"])) for e in entries]
    assert found == [(three, 3.0, 0x480), (three, 4.0, 0), (one, 5.0, 0), (three, 5.0, 0)]


def test_a_queue_that_discards_the_newest_replaces_the_last() -> None:
    swept = Swept([double(0.0)])
    swept.add(0, size=3, oldest=False)
    for number in range(1, 6):
        swept.scan([double(number)])

    entries = swept.sweep.take(swept.numbers[0], 100)

    assert list(zip(entries["value"].tolist(), entries["status"].tolist(), strict=True)) == [
        (0.0, 0), (1.0, 0), (5.0, 0x480)
    ]  # fmt: skip


def test_a_queue_that_nobody_takes_from_stays_bounded() -> None:
    swept = Swept([double(0.0)] * 100)
    for tag in range(100):
        swept.add(tag, size=2)
    for number in range(1, 500):
        swept.scan([double(number)] * 100)
        assert len(swept.queues[0]) <= 4_200

    assert len(swept.take()) == 200


@given(
    slots=st.lists(st.integers(0, 3), min_size=1, max_size=30),
    sizes=st.lists(st.integers(1, 4), min_size=4, max_size=4),
    oldest=st.booleans(),
    cut=st.integers(0, 30),
)
def test_keeping_in_two_steps_keeps_the_same(slots: list[int], sizes: list[int], oldest: bool, cut: int) -> None:
    entries = np.zeros(len(slots), ENTRY)
    entries["slot"], entries["value"] = slots, np.arange(len(slots))
    size, discard = np.array(sizes, np.int32), np.full(4, oldest)

    at_once = keep(entries, size, discard)
    begun = keep(entries[:cut], size, discard) if cut else entries[:0]
    in_steps = keep(np.concatenate([begun, entries[cut:]]), size, discard)

    values = at_once["value"].tolist()
    assert values == in_steps["value"].tolist()
    for slot in range(4):
        own = [number for number, other in enumerate(slots) if other == slot]
        kept = own[-sizes[slot] :] if oldest or len(own) <= sizes[slot] else [*own[: sizes[slot] - 1], own[-1]]
        assert [int(value) for value in values if slots[int(value)] == slot] == kept


def test_what_is_not_taken_at_once_waits() -> None:
    swept = Swept([double(0.0), double(1.0)])
    first, second = swept.add(0, size=2), swept.add(1, size=2)
    swept.scan([double(2.0), double(3.0)])

    assert swept.take(most=3) == [(first, 0.0), (second, 1.0), (first, 2.0)]
    swept.scan([double(4.0), double(5.0)])
    assert swept.take() == [(second, 3.0), (first, 4.0), (second, 5.0)]
    assert len(swept.queues[0]) == 0


def test_a_slot_that_is_free_is_used_again_and_starts_anew() -> None:
    swept = Swept([double(0.0), double(1.0)])
    slot = swept.add(0, size=1)
    swept.sweep.remove(slot)
    swept.queues[0].pull(np.array([slot], np.intp))

    assert slot == swept.add(1)
    assert swept.take() == [(slot, 1.0)]
    assert len(swept.sweep) == 1


def test_more_items_than_there_was_room_for() -> None:
    swept = Swept([double(float(number)) for number in range(1000)])
    slots = [swept.add(tag) for tag in range(1000)]

    assert swept.take() == [(slot, float(tag)) for tag, slot in enumerate(slots)]
    swept.scan([double(number + 1.0) for number in range(1000)])
    assert len(swept.take()) == 1000


@pytest.mark.parametrize("active", [True, False])
def test_an_item_that_is_disabled_keeps_still(active: bool) -> None:
    swept = Swept([double(0.0)])
    slot = swept.add(0)
    swept.sweep.set_mode(np.array([slot]), swept.numbers[0], active=active)

    swept.scan([double(1.0)])

    assert len(swept.take()) == 2 * active  # one that is disabled forgets what it had to say
