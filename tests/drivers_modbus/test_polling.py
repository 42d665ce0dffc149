"""Against any device: what it gives is read, what it refuses is Bad, and neither harms the other."""

import struct

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from softplc.drivers.modbus.address import Table
from softplc.drivers.modbus.codec import Field
from softplc.drivers.modbus.pdu import Refused
from softplc.drivers.modbus.plan import Limits, Span
from softplc.drivers.modbus.polling import Answer, PollState, Question, Value
from softplc.sample import StatusCode
from softplc.tags import Image


class Device:
    """Registers that hold their own number plus `base`; some are unknown, and no request may be for over `most`."""

    def __init__(self, unknown: set[int], most: int = 125) -> None:
        self.unknown, self.most, self.base, self.asked = unknown, most, 0, 0

    def read(self, poll: PollState, into: Image, hurry: bool = False) -> None:
        self.asked = 0
        polled = poll.start()
        for question in polled.due(lambda: not hurry):
            polled.take(Answer(question, self._reply(question), 1.0, 1))
        poll.finish(polled, into)

    def _reply(self, question: Question) -> bytes | Refused:
        self.asked += 1
        _, start, count = struct.unpack(">BHH", question.pdu)
        offsets = range(start, start + count)
        if count > self.most:
            return Refused(3)
        if self.unknown.intersection(offsets):
            return Refused(2)
        return b"".join(struct.pack(">H", self.base + offset) for offset in offsets)


def values_at(offsets: list[int]) -> list[Value]:
    return [Value(Span(Table.HOLDING, offset, 1), Field(0, "uint16")) for offset in offsets]


def assert_read(image: Image, offsets: list[int], device: Device) -> None:
    known = np.array([offset not in device.unknown for offset in offsets], bool)
    expected = np.array(offsets, float) + device.base
    assert (image.values[known] == expected[known]).all()
    assert np.isnan(image.values[~known]).all()
    assert (image.statuses[known] == StatusCode.GOOD).all()
    assert (image.statuses[~known] == StatusCode.BAD_CONFIGURATION_ERROR).all()


OFFSETS = st.lists(st.integers(0, 80), min_size=1, max_size=30)


@settings(deadline=None)  # a loaded machine is no failure
@given(OFFSETS, st.sets(st.integers(0, 80), max_size=10), st.integers(1, 125), st.integers(0, 8))
def test_what_the_device_gives_is_good_and_what_it_refuses_is_bad_from_the_first_read(offsets, unknown, most, gap):
    device, poll, image = (
        Device(unknown, most),
        PollState(values_at(offsets), Limits(max_gap=gap)),
        Image(len(offsets)),
    )

    for base in (0, 1000, 2000):
        device.base = base
        device.read(poll, image)
        assert_read(image, offsets, device)

    # No read is longer than asking for every value alone, and all that is refused costs one request.
    assert device.asked <= len(set(offsets) - unknown) + bool(unknown.intersection(offsets))


@settings(deadline=None)  # a loaded machine is no failure
@given(OFFSETS, st.sets(st.integers(0, 80), max_size=10), st.sets(st.integers(0, 80), max_size=10))
def test_addresses_that_appear_are_found_and_those_that_vanish_turn_bad(offsets, before, after):
    device, poll, image = Device(before), PollState(values_at(offsets), Limits()), Image(len(offsets))
    device.read(poll, image)
    device.unknown = after

    for _ in range(len(offsets) + 1):  # one of those refused is asked again in each read
        device.read(poll, image)

    assert_read(image, offsets, device)


def test_when_all_addresses_are_given_again_the_reads_are_as_few_as_at_first():
    offsets = list(range(60))
    device, poll, image = Device(set(range(60))), PollState(values_at(offsets), Limits()), Image(60)
    device.read(poll, image)
    device.unknown = set()

    for _ in range(61):
        device.read(poll, image)

    assert_read(image, offsets, device)
    assert device.asked == 1


@settings(deadline=None)  # a loaded machine is no failure
@given(OFFSETS, st.sets(st.integers(0, 80), max_size=10), st.integers(1, 125))
def test_without_time_to_search_each_read_costs_two_requests_more_and_the_end_is_the_same(offsets, unknown, most):
    device, poll, image = Device(unknown, most), PollState(values_at(offsets), Limits()), Image(len(offsets))
    plain = 0

    for _ in range(4 * len(offsets)):  # a binary search asks for less than twice the values
        device.read(poll, image, hurry=True)
        given = image.statuses == StatusCode.GOOD
        assert (image.values[given] == np.array(offsets)[given]).all()
        assert np.isnan(image.values[~given]).all()
        assert device.asked <= plain + 2 or plain == 0
        plain = device.asked

    assert_read(image, offsets, device)


def test_a_read_that_was_given_up_leaves_the_next_one_whole():
    device, poll, image = Device({3}), PollState(values_at(list(range(8))), Limits()), Image(8)
    polled = poll.start()
    for question in polled.due(lambda: True):
        polled.take(Answer(question, Refused(2), 0.0, 0))
        break

    device.read(poll, image)

    assert_read(image, list(range(8)), device)


def test_a_refused_value_that_is_busy_when_asked_again_stays_apart():
    poll, image = PollState(values_at([0, 1]), Limits()), Image(2)
    Device({1}).read(poll, image)
    polled = poll.start()

    for question, reply in zip(polled.due(lambda: True), (b"\x00\x07", Refused(6)), strict=True):
        polled.take(Answer(question, reply, 2.0, 2))
    poll.finish(polled, image)

    assert image.statuses.tolist() == [StatusCode.GOOD, StatusCode.BAD_RESOURCE_UNAVAILABLE]
    assert [q.request.start for q in poll.start().due(lambda: True)] == [0, 1]
