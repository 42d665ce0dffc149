"""Frames in, frames out: every rule of the protocol as a table, and no bytes that could break it."""

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softplc.publishers.modbus.protocol import Answer, answer
from tests.publishers_modbus.support import request

SERVED = 300  # registers; register n reads n
IMAGE = struct.pack(f">{SERVED}H", *range(SERVED))
UNITS = frozenset({0, 1, 255})


def ask(frames: bytes) -> Answer:
    return answer(frames, len(frames), UNITS, lambda: IMAGE)


def frame(pdu: bytes, unit: int = 1, transaction: int = 7, protocol: int = 0, length: int | None = None) -> bytes:
    return struct.pack(">HHHB", transaction, protocol, 1 + len(pdu) if length is None else length, unit) + pdu


def pdu_of(reply: bytes) -> bytes:
    """The PDU of exactly one response; checks the header against the specification."""
    _, protocol, length = struct.unpack(">HHH", reply[:6])
    assert (0, len(reply) - 6) == (protocol, length)
    return reply[7:]


@pytest.mark.parametrize("function", [3, 4])
@pytest.mark.parametrize(("first", "count"), [(0, 1), (0, 125), (175, 125), (299, 1), (100, 2)])
def test_both_tables_read_the_same_registers(function: int, first: int, count: int):
    reply = ask(request(first, count, function, transaction=0xBEEF)).replies

    assert reply[:2] == b"\xbe\xef"
    assert reply[6] == 1
    assert bytes([function, 2 * count]) + IMAGE[2 * first : 2 * (first + count)] == pdu_of(reply)


@pytest.mark.parametrize("unit", [0, 1, 255])
def test_the_configured_unit_and_0_and_255_are_answered(unit: int):
    reply = ask(request(0, 1, unit=unit)).replies

    assert (unit, b"\x03\x02\x00\x00") == (reply[6], pdu_of(reply))


@pytest.mark.parametrize("unit", [2, 100, 247, 254])
def test_another_unit_is_a_gateway_target_that_failed_to_respond(unit: int):
    reply = ask(request(0, 1, unit=unit)).replies

    assert (unit, b"\x83\x0b") == (reply[6], pdu_of(reply))


def test_every_other_function_is_illegal():
    for function in (*range(3), *range(5, 256)):
        for data in (b"", b"\x00", b"\x00\x00\x00\x01", b"\x00\x00\xff\x00", bytes(251)):
            reply = ask(frame(bytes([function]) + data)).replies
            assert bytes([function | 0x80, 1]) == pdu_of(reply)


WRITES = {
    "5 write single coil": b"\x05\x00\x00\xff\x00",
    "6 write single register": b"\x06\x00\x00\x00\x01",
    "15 write multiple coils": b"\x0f\x00\x00\x00\x01\x01\x01",
    "16 write multiple registers": b"\x10\x00\x00\x00\x01\x02\x00\x01",
    "21 write file record": b"\x15\x09\x06\x00\x04\x00\x07\x00\x01\x00\x01",
    "22 mask write register": b"\x16\x00\x04\x00\xf2\x00\x25",
    "23 read and write registers": b"\x17\x00\x00\x00\x01\x00\x00\x00\x01\x02\x00\x01",
}


@pytest.mark.parametrize("pdu", WRITES.values(), ids=WRITES.keys())
@pytest.mark.parametrize("unit", [0, 1, 255])
def test_every_write_function_is_refused(pdu: bytes, unit: int):
    assert bytes([pdu[0] | 0x80, 1]) == pdu_of(ask(frame(pdu, unit)).replies)


@pytest.mark.parametrize("function", [3, 4])
@pytest.mark.parametrize(
    ("first", "count", "code"),
    [
        (0, 0, 3),
        (0, 126, 3),
        (0, 65535, 3),
        (65535, 0, 3),
        (65535, 65535, 3),
        (300, 1, 2),
        (299, 2, 2),
        (176, 125, 2),
        (65535, 1, 2),
        (65535, 125, 2),
    ],
)
def test_a_read_that_cannot_be_says_why(function: int, first: int, count: int, code: int):
    assert bytes([function | 0x80, code]) == pdu_of(ask(request(first, count, function)).replies)


@pytest.mark.parametrize("function", [3, 4])
@pytest.mark.parametrize("data", [b"", b"\x00", b"\x00\x00\x00", b"\x00\x00\x00\x01\x00", bytes(252)])
def test_a_read_of_the_wrong_length_has_an_illegal_value(function: int, data: bytes):
    assert bytes([function | 0x80, 3]) == pdu_of(ask(frame(bytes([function]) + data)).replies)


@pytest.mark.parametrize(
    "bad",
    [
        frame(b"\x03\x00\x00\x00\x01", protocol=1),
        frame(b"\x03\x00\x00\x00\x01", protocol=0xFFFF),
        frame(b"\x03\x00\x00\x00\x01", length=0),
        frame(b"\x03\x00\x00\x00\x01", length=1),
        frame(b"\x03\x00\x00\x00\x01", length=255),
        frame(b"\x03\x00\x00\x00\x01", length=65535),
        b"GET / HTTP/1.1\r\n\r\n",
    ],
)
def test_a_header_that_is_not_modbus_closes_after_the_requests_before_it(bad: bytes):
    before = request(5, 1) + request(6, 1)
    found = ask(before + bad + request(7, 1))

    assert (True, len(before)) == (found.close, found.consumed)
    assert ask(before).replies == found.replies


def test_twenty_requests_in_one_segment_are_all_answered_in_order():
    found = ask(b"".join(request(n, 2, 3 + n % 2, transaction=1000 + n) for n in range(20)))
    replies = [found.replies[at : at + 13] for at in range(0, len(found.replies), 13)]

    assert (found.consumed, found.close) == (240, False)
    assert [1000 + n for n in range(20)] == [struct.unpack(">H", reply[:2])[0] for reply in replies]
    assert [bytes([3 + n % 2, 4]) + IMAGE[2 * n : 2 * n + 4] for n in range(20)] == [pdu_of(r) for r in replies]


def test_a_part_of_a_frame_waits_for_the_rest():
    whole = request(5, 1)
    for part in range(len(whole)):
        found = ask(request(4, 1) + whole[:part])
        assert (12, False, ask(request(4, 1)).replies) == (found.consumed, found.close, found.replies)


def test_one_burst_reads_one_image():
    calls = []

    def image() -> bytes:
        calls.append(1)
        return struct.pack(">2H", len(calls), len(calls))

    frames = request(0, 1) + request(1, 1) + request(0, 2)
    answer(frames, len(frames), UNITS, image)
    assert len(calls) == 1


def test_what_needs_no_register_reads_no_image():
    def image() -> bytes:
        raise AssertionError("nobody asked for a register")

    frames = request(0, 1, unit=9) + request(0, 1, function=6) + request(0, 0)[:8]
    assert not answer(frames, len(frames), UNITS, image).close


def test_bytes_beyond_what_is_filled_are_not_looked_at():
    frames = request(0, 1) + request(1, 1)

    assert answer(bytearray(frames), 15, UNITS, lambda: IMAGE).consumed == 12


FRAMES = st.one_of(
    st.builds(request, st.integers(0, 65535), st.integers(0, 65535), st.integers(0, 255), st.integers(0, 255)),
    st.builds(frame, st.binary(min_size=1, max_size=253), st.sampled_from((0, 1, 2, 255))),
    st.binary(max_size=40),
)


@settings(max_examples=300, deadline=None)
@given(st.lists(FRAMES, max_size=8), st.data())
def test_how_the_bytes_arrive_does_not_matter(frames: list[bytes], data: st.DataObject):
    stream = b"".join(frames)
    whole = ask(stream)
    waiting, replies, closed = b"", b"", False
    at = 0
    while at < len(stream) and not closed:
        step = data.draw(st.integers(1, len(stream) - at))
        waiting += stream[at : at + step]
        at += step
        found = ask(waiting)
        waiting, replies, closed = waiting[found.consumed :], replies + found.replies, found.close

    assert (whole.replies, whole.close) == (replies, closed)
