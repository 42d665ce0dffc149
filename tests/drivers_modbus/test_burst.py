"""Several requests in flight: every reply is the one it says it is, or nothing of it is taken."""

import asyncio
import random
import struct
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymodbus.simulator import DataType, SimData, SimDevice
from structlog.testing import capture_logs

from softplc.clock import SystemClock
from softplc.drivers.modbus.address import Table
from softplc.drivers.modbus.burst import BurstState
from softplc.drivers.modbus.config import RtuOverTcpTransport
from softplc.drivers.modbus.driver import ModbusDriver
from softplc.drivers.modbus.pdu import MixedUpError, ProtocolError, Refused
from softplc.drivers.modbus.plan import Limits, Request, Span, plan
from softplc.errors import ConfigError, LinkError
from softplc.sample import StatusCode
from softplc.tags import Image
from tests.drivers_modbus.scripted import SHORT
from tests.drivers_modbus.support import opened, pymodbus_server, read, source, tag
from tests.publishers_modbus.support import serving

FRAME = 12


def registers(request: bytes) -> bytes:
    """The reply of a device whose registers hold their own number plus the last digit of the function times 1000."""
    transaction, _, _, unit, function, first, count = struct.unpack(">HHHBBHH", request)
    data = struct.pack(f">{count}H", *(n + 1000 * function & 0xFFFF for n in range(first, first + count)))
    return struct.pack(">HHHBBB", transaction, 0, 3 + len(data), unit, function, len(data)) + data


def numbered(count: int, unit: int = 1) -> BurstState:
    """So many requests of 1, 2, 3 … registers, 200 apart."""
    spans = [Span(Table.HOLDING, 200 * n, 1 + n % 3) for n in range(count)]
    return BurstState([Request(Table.HOLDING, span.start, span.length, (span,)) for span in spans], unit)


def frames_of(sent: bytes) -> list[bytes]:
    return [sent[at : at + FRAME] for at in range(0, len(sent), FRAME)]


def values(burst: BurstState) -> list[list[int]]:
    """The registers of each reply."""
    found = []
    for number in range(len(burst)):
        reply = burst.reply(number)
        assert isinstance(reply, bytes)
        found.append(list(struct.unpack(f">{len(reply) // 2}H", reply)))
    return found


def right(count: int) -> list[list[int]]:
    return [[3000 + 200 * n + k for k in range(1 + n % 3)] for n in range(count)]


@settings(deadline=None)  # a loaded machine is no failure
@given(st.integers(1, 40), st.integers(1, 64), st.integers(0, 65535), st.randoms(use_true_random=False))
def test_replies_in_any_order_and_cut_anywhere_end_in_their_places(
    count: int, in_flight: int, first: int, chance: random.Random
):
    burst = numbered(count)
    for turn in range(3):
        burst.start(first + turn * count & 0xFFFF)
        waiting: list[bytes] = []
        while not burst.done:
            waiting += frames_of(burst.due(in_flight))
            assert burst.outstanding == len(waiting) <= in_flight
            some = [waiting.pop(chance.randrange(len(waiting))) for _ in range(chance.randint(1, len(waiting)))]
            stream = b"".join(registers(one) for one in some)
            cuts = sorted(chance.randrange(len(stream)) for _ in range(chance.randrange(4)))
            done = [burst.feed(stream[a:b], float(turn), turn) for a, b in pairwise([0, *cuts, len(stream)]) if b > a]
            assert sum(done) == len(some)
        assert values(burst) == right(count)
        assert burst.due(in_flight) == b""
        assert (burst.arrivals.tolist(), burst.timestamps.tolist()) == ([float(turn)] * count, [turn] * count)


def test_the_frames_are_those_of_the_specification_and_only_the_ids_change():
    burst = numbered(2, unit=0x11)
    burst.start(0xFFFF)
    assert burst.due(9) == bytes.fromhex("ffff00000006110300000001 00000000000611 0300c80002".replace(" ", ""))
    burst = numbered(1)
    burst.start(1)
    assert burst.due(1) == bytes.fromhex("000100000006010300000001")


def test_the_arrival_of_each_reply_is_its_own():
    burst = numbered(2)
    burst.start(1)
    first, second = frames_of(burst.due(2))
    burst.feed(registers(second) + registers(first)[:9], 1.0, 10)
    burst.feed(registers(first)[9:], 2.0, 20)

    assert (burst.arrivals.tolist(), burst.timestamps.tolist()) == ([2.0, 1.0], [20, 10])


def test_a_refusal_is_an_answer_and_the_others_are_taken():
    burst = numbered(3)
    burst.start(1)
    one, two, three = frames_of(burst.due(3))
    refusal = two[:4] + b"\x00\x03\x01\x83\x02"
    assert burst.feed(registers(one) + refusal + registers(three), 0.0, 0) == 3

    assert burst.done
    assert [burst.reply(n) for n in range(3)] == [b"\x0b\xb8", Refused(2), struct.pack(">3H", 3400, 3401, 3402)]
    burst.start(4)
    assert burst.refused == {}


WRONG = {
    "an id that was never sent": lambda sent: b"\x00\x09" + registers(sent[0])[2:],
    "an id of a request that is not sent yet": lambda sent: b"\x00\x04" + registers(sent[0])[2:],
    "the same reply twice": lambda sent: 2 * registers(sent[0]),
    "an early reply twice": lambda sent: 2 * registers(sent[1]),
    "one more after all": lambda sent: b"".join(map(registers, sent)) + registers(sent[0]),
    "a byte too many": lambda sent: b"".join(map(registers, sent)) + b"\x00",
}


@pytest.mark.parametrize("wrong", WRONG)
def test_a_reply_to_what_is_not_outstanding_is_a_mix_up(wrong: str):
    burst = numbered(4)
    burst.start(1)
    with pytest.raises(MixedUpError):
        burst.feed(WRONG[wrong](frames_of(burst.due(3))), 0.0, 0)


@pytest.mark.parametrize(
    ("position", "value"), [(2, 1), (3, 1), (4, 1), (5, 0), (5, 2), (5, 4), (6, 2), (7, 4), (7, 0x84), (8, 1), (8, 4)]
)
def test_a_reply_with_anything_else_in_its_head_is_a_fault(position: int, value: int):
    burst = numbered(1)
    burst.start(1)
    reply = bytearray(registers(burst.due(1)))
    reply[position] = value
    with pytest.raises(ProtocolError):
        burst.feed(bytes(reply) + bytes(300), 0.0, 0)


@asynccontextmanager
async def device(reply: Callable[[list[bytes]], bytes]) -> AsyncIterator[int]:
    """A device that answers with `reply` whatever requests it finds in its buffer; yields the port."""
    writers = []

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writers.append(writer)
        while data := await reader.read(4096):
            writer.write(reply(frames_of(data)))
        writer.close()

    async with await asyncio.start_server(serve, "127.0.0.1", 0) as listener:
        yield listener.sockets[0].getsockname()[1]
        for writer in writers:
            writer.close()


TAGS = [tag(f"holding:{200 * n}", "uint16") for n in range(20)]
VALUES = [float(3000 + 200 * n) for n in range(20)]


def in_order(requests: list[bytes]) -> bytes:
    return b"".join(map(registers, requests))


def backwards(requests: list[bytes]) -> bytes:
    return b"".join(map(registers, reversed(requests)))


@pytest.mark.parametrize("reply", [in_order, backwards])
@pytest.mark.parametrize("in_flight", [1, 2, 8, 64])
async def test_a_device_is_read_right_with_any_number_in_flight(reply, in_flight: int):
    most = []

    def counting(requests: list[bytes]) -> bytes:
        most.append(len(requests))
        return reply(requests)

    async with device(counting) as port, opened(source(port, in_flight=in_flight), TAGS) as driver:
        for _ in range(5):
            image = await read(driver, 20)
            assert image.values.tolist() == VALUES
            assert (image.statuses == StatusCode.GOOD).all()
    assert max(most) == (1 if in_flight == 1 else min(in_flight, 64))  # the probe asks so many at once


def only_first(requests: list[bytes]) -> bytes:
    return registers(requests[0])


def doubled(requests: list[bytes]) -> bytes:
    return b"".join(map(registers, requests)) + (registers(requests[-1]) if len(requests) > 1 else b"")


def crossed(requests: list[bytes]) -> bytes:
    """Data of one under the id of the next."""
    return b"".join(
        registers(one)[:2].replace(one[:2], other[:2]) + registers(one)[2:]
        for one, other in zip(requests, requests[1:] + requests[:1], strict=True)
    )


@pytest.mark.parametrize("lossy", [only_first, doubled, crossed])
async def test_a_device_that_loses_or_mixes_up_replies_is_asked_one_at_a_time_and_says_so_once(lossy):
    wide = [tag("holding:0", "float64"), *TAGS[1:]]  # four registers, so that the probe has replies of four lengths
    async with device(lossy) as port:
        config = source(port, in_flight=4, timeout_ms=SHORT)
        with capture_logs() as logs:
            for _ in range(2):
                async with opened(config, wide) as driver:
                    for _ in range(3):
                        assert (await read(driver, 20)).values.tolist()[1:] == VALUES[1:]
        assert [(entry["event"], entry["device"]) for entry in logs] == [
            ("modbus device asked one request at a time from now on", f"127.0.0.1:{port}, unit 1")
        ]


async def test_a_device_that_mixes_up_later_loses_its_link_and_is_asked_one_at_a_time_from_then_on():
    calls = iter(range(1000))

    def later(requests: list[bytes]) -> bytes:
        return doubled(requests) if next(calls) > 30 else in_order(requests)

    async with device(later) as port:
        config = source(port, in_flight=4)
        async with opened(config, TAGS) as driver:
            with pytest.raises(LinkError, match=r"reply to transaction|follow the reply"):
                for _ in range(50):
                    assert (await read(driver, 20)).values.tolist() == VALUES
        async with opened(config, TAGS) as driver:
            assert (await read(driver, 20)).values.tolist() == VALUES


async def test_pymodbus_server_which_answers_one_of_several_is_read_all_the_same():
    whole = SimDevice(1, simdata=[SimData(0, count=4000, values=7, datatype=DataType.REGISTERS)])
    async with (
        pymodbus_server(whole) as port,
        opened(source(port, in_flight=8, timeout_ms=SHORT), TAGS) as driver,
    ):
        assert (await read(driver, 20)).values.tolist() == [7.0] * 20


async def test_our_own_server_is_read_with_eight_in_flight():
    async with serving() as served:
        tags = [tag("holding:2"), tag("holding:4"), *(tag(f"input:{n}", "uint16") for n in range(0, 3128, 200))]
        async with opened(source(served.port, in_flight=8), tags) as driver:
            image = await read(driver, len(tags))
            assert image.values[:2].tolist() == [1.0, float(np.float32(-123.456))]
            assert (image.statuses == StatusCode.GOOD).all()


async def test_what_a_device_refuses_among_several_in_flight_is_bad_and_the_rest_is_good():
    def some(requests: list[bytes]) -> bytes:
        def one(request: bytes) -> bytes:
            first, count = struct.unpack(">HH", request[8:12])
            unknown = first <= 1000 < first + count
            return request[:4] + b"\x00\x03\x01\x83\x02" if unknown else registers(request)

        return b"".join(map(one, requests))

    async with device(some) as port, opened(source(port, in_flight=8), TAGS) as driver:
        for _ in range(3):
            image = await read(driver, 20)
            assert np.isnan(image.values[5])
            assert image.statuses[5] == StatusCode.BAD_CONFIGURATION_ERROR
            good = [n for n in range(20) if n != 5]
            assert image.values[good].tolist() == [VALUES[n] for n in good]
            assert (image.statuses[good] == StatusCode.GOOD).all()


async def test_a_read_that_nobody_waits_for_any_more_sends_nothing_more_and_leaves_the_next_one_right():
    gate, asked = asyncio.Event(), []

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while data := await reader.read(4096):
            asked.extend(frames_of(data))
            if len(asked) > 30:
                await gate.wait()
            writer.write(in_order(frames_of(data)))
        writer.close()

    async with await asyncio.start_server(serve, "127.0.0.1", 0) as listener:
        port = listener.sockets[0].getsockname()[1]
        async with opened(source(port), TAGS) as driver:  # 20 requests
            given_up = asyncio.create_task(read(driver, 20))
            while len(asked) <= 30:
                await asyncio.sleep(0.001)
            given_up.cancel()
            await asyncio.gather(given_up, return_exceptions=True)
            before = len(asked)
            gate.set()
            assert (await read(driver, 20)).values.tolist() == VALUES
            assert len(asked) == before + 20


async def test_silence_in_the_middle_of_a_burst_is_a_lost_link():
    answered = []

    def some(requests: list[bytes]) -> bytes:
        answered.extend(requests)
        return in_order(requests) if len(answered) < 30 else b""

    async with device(some) as port, opened(source(port, timeout_ms=SHORT), TAGS) as driver:
        image = Image(20)
        with pytest.raises(LinkError, match="no reply within 1 s"):
            await driver.read(image)
        assert np.isnan(image.values).all()


def test_several_in_flight_on_a_serial_line_are_a_configuration_error():
    gateway = RtuOverTcpTransport(type="rtu_over_tcp", host="127.0.0.1", port=502)
    with pytest.raises(ConfigError, match=r"in_flight 2 needs transaction ids"):
        ModbusDriver(source(1, transport=gateway, in_flight=2), TAGS, (), SystemClock())


def test_a_plan_of_both_tables_fills_one_stretch_of_bytes():
    spans = [Span(Table.COIL, 3, 1), Span(Table.HOLDING, 7, 2)]
    burst = BurstState(plan(spans, Limits()), 1)
    burst.start(5)
    coil, word = frames_of(burst.due(2))
    replies = coil[:4] + b"\x00\x04\x01\x01\x01\x01" + registers(word)

    assert burst.feed(replies, 0.0, 0) == 2
    assert burst.wire.tobytes() == b"\x01" + struct.pack(">2H", 3007, 3008)
