"""A server that lies: never a wrong number, always a LinkError or a status."""

import asyncio
import struct
from collections.abc import Callable

import numpy as np
import pytest

from softplc.drivers.modbus.config import RtuOverTcpTransport
from softplc.drivers.modbus.rtu import RtuFraming
from softplc.errors import LinkError
from softplc.sample import StatusCode
from softplc.tags import Image
from tests.drivers_modbus.scripted import REGISTERS, SHORT, TAGS, answering, honest, server
from tests.drivers_modbus.support import opened, read, source
from tests.support.drivers import write_values


def patched(position: int, value: int) -> Callable[[bytes], bytes]:
    """The honest reply with one byte changed: 0 and 1 transaction, 2 and 3 protocol, 4 and 5 length, 6 unit."""

    def make(request: bytes) -> bytes:
        frame = bytearray(honest(request))
        frame[position] = value
        return bytes(frame)

    return make


def with_pdu(pdu: bytes) -> Callable[[bytes], bytes]:
    """A frame that is right but for its PDU."""
    return lambda request: request[:4] + struct.pack(">H", len(pdu) + 1) + request[6:7] + pdu


WRONG = {
    "transaction id": (patched(1, 77), "reply to transaction 77, the outstanding one is 3"),
    "transaction id 0": (patched(1, 0), "reply to transaction 0"),
    "protocol id": (patched(3, 1), "protocol id 1"),
    "length 0": (patched(5, 0), "announces 0 bytes"),
    "length 2": (patched(5, 2), "announces 2 bytes"),
    "length 65284": (patched(4, 255), "announces 65284 bytes"),
    "unit id": (patched(6, 9), "from unit 9, unit 1 was asked"),
    "function code 4": (with_pdu(b"\x04\x04\x01\x02\x01\x02"), "function code 4, function 1 was asked for"),
    "function code 0": (with_pdu(b"\x00\x01"), "function code 0"),
    "exception of another function": (with_pdu(b"\x84\x02"), "function code 132"),
    "exception without a code": (with_pdu(b"\x81\x02\x00"), "exception response has 3 bytes"),
    "too few bytes": (with_pdu(b"\x01\x00"), "carries 0 bytes of data"),
    "too many bytes": (with_pdu(b"\x01\x02\xff\xff"), "carries 2 bytes of data"),
    "byte count beyond the frame": (with_pdu(b"\x01\x05\xff"), "carries 1 bytes of data"),
    "byte count 0 before data": (with_pdu(b"\x01\x00\xff"), "carries 1 bytes of data"),
    "two replies": (lambda request: 2 * honest(request), "10 bytes follow the reply"),
    "garbage": (lambda _: b"HTTP/1.1 400 Bad Request\r\n\r\n", "protocol id"),
}


@pytest.mark.parametrize("wrong", WRONG)
async def test_a_reply_that_does_not_fit_its_request_ends_the_link(wrong):
    make, message = WRONG[wrong]
    async with server(answering(make)) as port, opened(source(port), TAGS) as driver:
        image = Image(len(TAGS))
        with pytest.raises(LinkError, match=message):
            await driver.read(image)
        assert np.isnan(image.values).all()  # nothing of it came through

        with pytest.raises(LinkError):
            await driver.read(image)


WRONG_REGISTERS = {
    "function code 4": with_pdu(b"\x04\x04\x01\x02\x01\x02"),
    "one register for two": with_pdu(b"\x03\x02\x01\x02"),
    "three registers for two": with_pdu(b"\x03\x06\x01\x02\x01\x02\x01\x02"),
    "odd byte count": with_pdu(b"\x03\x03\x01\x02\x01"),
    "odd byte count in a whole frame": with_pdu(b"\x03\x03\x01\x02\x01\x02"),
}


@pytest.mark.parametrize("wrong", WRONG_REGISTERS)
async def test_registers_are_taken_only_when_all_that_were_asked_for_came(wrong):
    async with server(answering(WRONG_REGISTERS[wrong])) as port, opened(source(port), REGISTERS) as driver:
        assert (await read(driver, 2)).values.tolist() == [258.0, 258.0]  # the second honest answer
        with pytest.raises(LinkError, match=r"40001 / holding:0 and the next 1: .*(code 4|were asked for)"):
            await read(driver, 2)


async def test_after_one_wrong_reply_right_ones_are_not_taken_either():
    lies = iter([with_pdu(b"\x03\x02\x01\x02")])

    def reply(request: bytes) -> bytes:
        return next(lies, honest)(request)

    async with server(answering(reply)) as port, opened(source(port), REGISTERS) as driver:
        await read(driver, 2)
        for _ in range(2):
            with pytest.raises(LinkError):
                await read(driver, 2)


@pytest.mark.parametrize(
    ("pdu", "status"),
    [
        (b"\x86\x04", StatusCode.BAD_DEVICE_FAILURE),
        (b"\x06\x00\x00\x00\x09", StatusCode.BAD_OUT_OF_RANGE),
    ],
)
async def test_a_write_that_the_device_refuses_or_changes_is_a_status(pdu, status):
    async with server(answering(with_pdu(pdu))) as port, opened(source(port), TAGS, TAGS[:1]) as driver:
        assert await write_values(driver, {0: 5.0}) == {0: status}


@pytest.mark.parametrize(
    "pdu", [b"\x06\x00\x01\x00\x05", b"\x06\x00\x00\x00", b"\x05\x00\x00\x00\x05", b"\x10\x00\x00\x00\x01"]
)
async def test_a_reply_that_does_not_fit_its_write_ends_the_link(pdu):
    async with server(answering(with_pdu(pdu))) as port, opened(source(port), TAGS, TAGS[:1]) as driver:
        with pytest.raises(LinkError, match="40001 / holding:0: reply"):
            await write_values(driver, {0: 5.0})


async def test_half_a_reply_and_then_silence_is_a_lost_link():
    half = answering(lambda request: honest(request)[:-1])
    async with server(half) as port, opened(source(port, timeout_ms=SHORT), TAGS) as driver:
        with pytest.raises(LinkError, match=r"no reply within 1 s"):
            await read(driver, len(TAGS))


async def test_a_reply_byte_by_byte_is_a_reply():
    async def trickle(request: bytes, writer: asyncio.StreamWriter) -> None:
        for byte in honest(request):
            writer.write(bytes([byte]))
            await writer.drain()
            await asyncio.sleep(0)

    async with server(trickle) as port, opened(source(port), TAGS) as driver:
        assert (await read(driver, len(TAGS))).values.tolist() == [258.0, 258.0, 1.0]


async def test_bytes_that_nobody_asked_for_end_the_link():
    hung_up = asyncio.Event()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        request = await reader.read(300)
        writer.write(honest(request))
        await asyncio.sleep(0.05)  # longer than the driver takes to end its read
        writer.write(honest(request))
        while await reader.read(300):
            pass
        hung_up.set()
        writer.close()

    listener = await asyncio.start_server(serve, "127.0.0.1", 0)
    port = listener.sockets[0].getsockname()[1]
    async with listener, opened(source(port), REGISTERS) as driver:
        await asyncio.wait_for(hung_up.wait(), 30)
        with pytest.raises(LinkError, match="13 bytes came, nothing was asked for"):
            await read(driver, 2)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda frame: frame[:-1] + bytes([frame[-1] ^ 1]), "wrong checksum"),
        (lambda frame: b"\x09" + frame[1:], "wrong checksum"),
        (lambda frame: frame[:-1], "no reply within 1 s"),
        (lambda frame: b"\x00" * 300, "without a frame"),
        (lambda _: b"", "no reply within 1 s"),
    ],
)
async def test_an_rtu_reply_that_is_spoilt_ends_the_link(spoil, message):
    frame = RtuFraming(unit_id=1).frame(b"\x03\x02\x00\x07")  # a reply is framed as a request is

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        served = 0
        while await reader.read(300):
            writer.write(frame if served == 0 else spoil(frame))
            served += 1
        writer.close()

    async with await asyncio.start_server(serve, "127.0.0.1", 0) as listener:
        port = listener.sockets[0].getsockname()[1]
        gateway = RtuOverTcpTransport(type="rtu_over_tcp", host="127.0.0.1", port=port)
        async with opened(source(1, transport=gateway, timeout_ms=SHORT), TAGS[:1]) as driver:
            with pytest.raises(LinkError, match=message):
                await read(driver, 1)
