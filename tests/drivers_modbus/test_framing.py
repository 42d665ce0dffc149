"""Frames of both kinds: only the whole and right reply gets through, whatever the bytes and however they arrive."""

import struct
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softplc.drivers.modbus.address import Address, Table
from softplc.drivers.modbus.pdu import ProtocolError, Refused, read_reply, read_request, write_reply, write_request
from softplc.drivers.modbus.plan import Limits, Span, plan
from softplc.drivers.modbus.rtu import RtuFraming, silence
from softplc.drivers.modbus.tcp import TcpFraming
from softplc.sample import StatusCode

READ_TEN = read_request(plan([Span(Table.HOLDING, 0, 10)], Limits())[0])
TEN = bytes([3, 20]) + bytes(range(20))


def test_requests_are_those_of_the_specification():
    # Modbus Application Protocol V1.1b3, the examples of 6.1, 6.2, 6.3, 6.4, 6.5, 6.6 and 6.12.
    assert read_request(plan([Span(Table.COIL, 0x13, 0x13)], Limits())[0]) == bytes.fromhex("0100130013")
    assert read_request(plan([Span(Table.DISCRETE, 0xC4, 0x16)], Limits())[0]) == bytes.fromhex("0200c40016")
    assert read_request(plan([Span(Table.HOLDING, 0x6B, 3)], Limits())[0]) == bytes.fromhex("03006b0003")
    assert read_request(plan([Span(Table.INPUT, 8, 1)], Limits())[0]) == bytes.fromhex("0400080001")
    assert write_request(Address(Table.COIL, 0xAC), b"\x00\x01") == bytes.fromhex("0500acff00")
    assert write_request(Address(Table.COIL, 0xAC), b"\x00\x00") == bytes.fromhex("0500ac0000")
    assert write_request(Address(Table.HOLDING, 1), b"\x00\x03") == bytes.fromhex("0600010003")
    assert write_request(Address(Table.HOLDING, 1), b"\x00\x0a\x01\x02") == bytes.fromhex("100001000204000a0102")


def test_replies_are_those_of_the_specification():
    # The same chapter: 19 coils in three bytes, three registers, an exception.
    coils = bytes.fromhex("0100130013")
    assert read_reply(coils, bytes.fromhex("0103cd6b05")) == bytes.fromhex("cd6b05")
    assert read_reply(bytes.fromhex("03006b0003"), bytes.fromhex("0306022b00000064")) == bytes.fromhex("022b00000064")
    assert read_reply(coils, bytes.fromhex("8102")) == Refused(2)


def test_a_write_is_good_only_when_the_device_confirms_all_of_it():
    coil, register, registers = (bytes.fromhex(pdu) for pdu in ("0500acff00", "0600010003", "100001000204000a0102"))

    assert write_reply(coil, coil) == write_reply(register, register) == StatusCode.GOOD
    assert write_reply(registers, registers[:5]) == StatusCode.GOOD
    assert write_reply(coil, bytes.fromhex("0500ac0000")) == StatusCode.BAD_OUT_OF_RANGE
    assert write_reply(registers, bytes.fromhex("9006")) == StatusCode.BAD_RESOURCE_UNAVAILABLE
    for wrong in ("1000010001", "1000020002", "100001", "", "0600010002"):
        with pytest.raises(ProtocolError):
            write_reply(registers, bytes.fromhex(wrong))


def test_a_tcp_frame_carries_transaction_protocol_length_and_unit():
    framing = TcpFraming(unit_id=0x11)

    assert framing.frame(READ_TEN) == bytes.fromhex("0001 0000 0006 11") + READ_TEN
    assert framing.frame(READ_TEN) == bytes.fromhex("0002 0000 0006 11") + READ_TEN


def test_transaction_ids_roll_over():
    framing = TcpFraming(unit_id=1)

    ids = [struct.unpack(">H", framing.frame(READ_TEN)[:2])[0] for _ in range(65537)]

    assert ids[-3:] == [65535, 0, 1]


@settings(deadline=None)  # a loaded machine is no failure
@given(st.lists(st.integers(0, 28), max_size=5))
def test_a_tcp_reply_is_complete_with_its_last_byte_however_it_is_cut(cuts):
    framing = TcpFraming(unit_id=1)
    framing.frame(READ_TEN)
    frame = struct.pack(">HHHB", 1, 0, len(TEN) + 1, 1) + TEN
    edges = [0, *sorted(cuts), len(frame)]
    chunks = [frame[a:b] for a, b in pairwise(edges) if b > a]

    assert [framing.feed(chunk) for chunk in chunks] == [None] * (len(chunks) - 1) + [TEN]


@settings(deadline=None)  # a loaded machine is no failure
@given(st.binary(max_size=40), st.integers(0, 28), st.integers(0, 255))
def test_no_other_tcp_bytes_become_data(noise, position, value):
    right = struct.pack(">HHHB", 1, 0, len(TEN) + 1, 1) + TEN
    changed = bytearray(right)
    changed[position] = value

    for frame in (noise, bytes(changed), right + noise, right[:position]):
        framing = TcpFraming(unit_id=1)
        framing.frame(READ_TEN)
        try:
            pdu = framing.feed(frame)
            data = None if pdu is None else read_reply(READ_TEN, pdu)
        except ProtocolError:
            continue
        if isinstance(data, bytes):  # a changed data byte is beyond what the protocol can tell
            assert len(frame) == len(right)
            assert frame[:9] == right[:9]
            assert data == frame[9:]


def test_an_rtu_frame_carries_unit_and_checksum():
    # The frame that every Modbus text shows: unit 1, ten holding registers from 0, CRC C5 CD.
    assert RtuFraming(unit_id=1).frame(READ_TEN) == bytes.fromhex("01 03 00 00 00 0a c5 cd")


def rtu_reply(unit: int = 1, pdu: bytes = TEN) -> bytes:
    body = bytes([unit]) + pdu
    return body + crc(body)


def crc(body: bytes) -> bytes:
    """Modbus over Serial Line V1.02, 6.2.2, bit by bit."""
    register = 0xFFFF
    for byte in body:
        register ^= byte
        for _ in range(8):
            register = (register >> 1) ^ (0xA001 if register & 1 else 0)
    return struct.pack("<H", register)


@settings(deadline=None)  # a loaded machine is no failure
@given(st.lists(st.integers(0, 25), max_size=5))
def test_an_rtu_reply_is_complete_with_its_last_byte_however_it_is_cut(cuts):
    framing = RtuFraming(unit_id=1)
    framing.frame(READ_TEN)
    frame = rtu_reply()
    edges = [0, *sorted(cuts), len(frame)]
    chunks = [frame[a:b] for a, b in pairwise(edges) if b > a]

    assert [framing.feed(chunk) for chunk in chunks] == [None] * (len(chunks) - 1) + [TEN]


@settings(deadline=None)  # a loaded machine is no failure
@given(st.integers(0, len(rtu_reply()) - 1), st.integers(1, 255))
def test_an_rtu_reply_with_any_byte_changed_is_no_reply(position, change):
    framing = RtuFraming(unit_id=1)
    framing.frame(READ_TEN)
    frame = bytearray(rtu_reply())
    frame[position] ^= change

    try:
        pdu = framing.feed(bytes(frame))
        data = None if pdu is None else read_reply(READ_TEN, pdu)
    except ProtocolError:
        return
    assert data is None


def test_a_wrong_checksum_is_an_error_at_once():
    framing = RtuFraming(unit_id=1)
    framing.frame(READ_TEN)

    with pytest.raises(ProtocolError, match="wrong checksum"):
        framing.feed(rtu_reply()[:-1] + b"\x00")


def test_a_reply_of_another_unit_is_passed_over():
    framing = RtuFraming(unit_id=1)
    framing.frame(READ_TEN)

    assert framing.feed(rtu_reply(unit=2)) is None
    assert framing.feed(rtu_reply()) == TEN


def test_a_line_that_only_makes_noise_is_an_error():
    framing = RtuFraming(unit_id=1)
    framing.frame(READ_TEN)

    with pytest.raises(ProtocolError, match="without a frame"):
        for _ in range(300):
            framing.feed(b"\x00")


def test_frames_are_separated_by_three_and_a_half_characters():
    assert silence(9600) == pytest.approx(3.5 * 11 / 9600)  # exact but for rounding
    assert silence(115200) == 0.00175
