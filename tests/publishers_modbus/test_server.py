"""The server on real sockets: answers, caps, time limits, ordered close."""

import asyncio
import socket
import struct

import pytest
from structlog.testing import capture_logs

from softplc.clock import VirtualClock
from softplc.errors import ConfigError, SoftplcError
from softplc.publishers.modbus.config import AxisPlacement
from softplc.publishers.modbus.server import ModbusServer
from tests.publishers_modbus.support import (
    Client,
    Served,
    any_port,
    assert_equal,
    client_of,
    decode,
    expected,
    full_exchange,
    request,
    serving,
)
from tests.publishers_modbus.test_protocol import WRITES, frame
from tests.support.network import eventually


@pytest.mark.parametrize("function", [3, 4])
async def test_both_tables_read_what_is_published(function: int):
    async with serving() as served, client_of(served) as client:
        register_map = served.server.map
        found = decode(register_map, await client.read_all(register_map.size, function))

        assert_equal(found, expected(register_map, served.exchange.reader.snapshot()))


async def test_a_request_sees_the_newest_scan_without_waiting_for_the_feed():
    async with serving() as served, client_of(served) as client:
        for value in (1.5, -2.5, 1e6):
            served.exchange.set("AxisX.Position", value)
            served.exchange.publish()
            assert struct.pack(">f", value) == await client.read(3000, 2)


async def test_publish_encodes_ahead_of_the_requests():
    async with serving() as served:
        await served.server.publish()
        assert served.server.registers() is served.server.registers()


async def test_a_dead_scan_process_reads_quality_0_and_alive_0():
    clock = VirtualClock()
    async with serving(full_exchange(clock)) as served, client_of(served) as client:
        heartbeat = await client.read(7, 1)
        assert (await client.read(11, 1), await client.read(3042, 1)) == (b"\x00\x01", b"\x00\x02")
        clock.advance(1.0)

        assert (await client.read(11, 1), await client.read(3042, 1)) == (b"\x00\x00", b"\x00\x00")
        assert heartbeat == await client.read(7, 1)


async def test_twenty_requests_in_one_send_are_all_answered_in_order():
    async with serving() as served, client_of(served) as client:
        for _ in range(10):
            client.writer.write(b"".join(request(n, 2, transaction=n) for n in range(20)))
            replies = [await client.receive() for _ in range(20)]

            assert list(range(20)) == [transaction for transaction, _, _ in replies]
            assert [await client.read(n, 2) for n in range(20)] == [pdu[2:] for _, _, pdu in replies]


async def test_a_frame_that_comes_byte_by_byte_is_answered():
    async with serving() as served, client_of(served) as client:
        for byte in request(0, 1):
            client.writer.write(bytes([byte]))
            await client.writer.drain()
            await asyncio.sleep(0)
        assert await client.receive() == (1, 1, b"\x03\x02\x12\x34")


async def test_a_frame_across_the_end_of_the_receive_buffer_is_answered():
    """2048 bytes hold 170 requests of 12 bytes and a part of the next."""
    async with serving() as served, client_of(served) as client:
        client.writer.write(b"".join(request(0, 1, transaction=n) for n in range(1000)))
        assert list(range(1000)) == [(await client.receive())[0] for _ in range(1000)]


@pytest.mark.parametrize(
    ("bad", "reply"),
    [
        (request(0, 0), b"\x83\x03"),
        (request(0, 126), b"\x83\x03"),
        (request(3128, 1), b"\x83\x02"),
        (request(3120, 9, 4), b"\x84\x02"),
        (request(0, 1, unit=9), b"\x83\x0b"),
        (request(0, 1, 1), b"\x81\x01"),
        (request(0, 1, 2), b"\x82\x01"),
        (frame(b"\x03\x00"), b"\x83\x03"),
        *((frame(pdu), bytes([pdu[0] | 0x80, 1])) for pdu in WRITES.values()),
    ],
)
async def test_a_malformed_or_refused_request_gets_its_exception_and_the_connection_lives(bad: bytes, reply: bytes):
    async with serving() as served, client_of(served) as client:
        assert reply == (await client.ask(bad))[2]
        assert await client.read(0, 1) == b"\x12\x34"


@pytest.mark.parametrize("bad", [frame(b"\x03", protocol=1), frame(b"\x03", length=1), frame(b"\x03", length=255)])
async def test_a_bad_header_closes_the_connection_and_no_other(bad: bytes):
    async with serving() as served, client_of(served) as victim, client_of(served) as other:
        assert await other.read(0, 1)
        victim.writer.write(request(0, 1, transaction=5) + bad + request(0, 1, transaction=6))

        assert (await victim.receive())[0] == 5
        assert await victim.closed()
        assert await other.read(0, 1)


@pytest.mark.parametrize("unit", [7, 0, 255])
async def test_the_configured_unit_id_is_echoed(unit: int):
    async with serving(unit_id=7) as served, client_of(served) as client:
        assert (1, unit, b"\x03\x02\x12\x34") == await client.ask(request(0, 1, unit=unit))
        assert (await client.ask(request(0, 1, unit=1)))[2] == b"\x83\x0b"


async def test_small_answers_are_sent_without_delay():
    async with serving() as served, client_of(served) as client:
        await client.read(0, 1)
        (connection,) = served.server._connections
        assert connection._socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


async def test_clients_above_the_cap_are_refused_until_one_leaves():
    async with serving(max_clients=3) as served:
        clients = [await Client.connect(served.port) for _ in range(3)]
        for client in clients:
            await client.read(0, 1)
        with capture_logs() as logs:
            for _ in range(5):
                refused = await Client.connect(served.port)
                assert await refused.closed()
                await refused.close()
        assert [entry["event"] for entry in logs] == [
            "modbus client refused, too many are connected"
        ]  # not five times

        await clients.pop().close()
        await eventually(lambda: served.server.clients == 2)
        async with client_of(served) as fourth:
            assert await fourth.read(0, 1)
        for client in clients:
            assert await client.read(0, 1)
            await client.close()


async def test_an_idle_client_is_dropped_and_a_busy_one_is_not():
    async with serving(idle_timeout_s=1) as served, client_of(served) as idle, client_of(served) as busy:
        dropped = asyncio.create_task(idle.closed())
        while not dropped.done():
            await busy.read(0, 1)
            await asyncio.sleep(0.02)
        assert dropped.result()
        assert await busy.read(0, 1)


async def test_a_client_that_never_completes_a_frame_is_dropped_as_idle():
    async with serving(idle_timeout_s=1) as served, client_of(served) as client:
        dropped = asyncio.create_task(client.closed())
        for byte in frame(b"\x10" + bytes(250)) * 1000:
            if dropped.done():
                break
            client.writer.write(bytes([byte]))
            await asyncio.sleep(0.02)  # 256 bytes take five times the idle timeout
        assert dropped.result()


async def stalled(served: Served) -> Client:
    """A client that asked for much and reads nothing, until the server stopped reading from it."""
    sock = socket.socket()
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    sock.connect(("127.0.0.1", served.port))
    # a limit of one byte makes the stream reader stop reading from its socket at once
    client = Client(*await asyncio.open_connection(sock=sock, limit=1))
    client.writer.write(b"".join(request(3000, 125, transaction=n) for n in range(8000)))
    await eventually(lambda: any(c.waiting for c in served.server._connections), what="the server to pause")
    return client


async def test_a_client_that_does_not_read_is_dropped_and_the_others_are_served_meanwhile():
    async with serving(stall_timeout=2.0) as served, client_of(served) as other:
        await other.read(0, 1)
        slow = await stalled(served)
        assert served.server.clients == 2
        (connection,) = (c for c in served.server._connections if c.waiting)
        assert connection.waiting <= 2048 // 12 * 259  # the answers to one receive buffer of requests

        with capture_logs() as logs:
            while served.server.clients == 2:
                assert await other.read(0, 1)
        assert [entry["event"] for entry in logs] == ["modbus client dropped, it does not take its answers"]
        assert await other.read(0, 1)
        await slow.close()


async def test_a_client_that_reads_late_gets_every_answer_in_order():
    async with serving(stall_timeout=60.0) as served:
        slow = await stalled(served)
        assert list(range(8000)) == [(await slow.receive())[0] for _ in range(8000)]
        await slow.close()


async def test_close_drops_every_client_at_once_and_frees_the_port():
    exchange = full_exchange()
    server = ModbusServer(any_port(), exchange.reader, stall_timeout=60.0)
    port = int((await server.open()).rpartition(":")[2])
    served = Served(server, exchange, port)
    quiet, slow = await Client.connect(port), await stalled(served)
    await eventually(lambda: server.clients == 2)

    await asyncio.wait_for(server.close(), 30)
    assert server.clients == 0
    assert await quiet.closed()
    again = ModbusServer(any_port().model_copy(update={"port": port}), exchange.reader)
    await again.open()
    await again.close()
    for client in (quiet, slow):
        await client.close()


async def test_close_before_open_and_twice_is_harmless():
    server = ModbusServer(any_port(), full_exchange().reader)
    await server.close()
    await server.open()
    await server.close()
    await server.close()


async def test_a_port_that_is_taken_is_an_error_that_names_it():
    async with serving() as served:
        second = ModbusServer(any_port().model_copy(update={"port": served.port}), served.exchange.reader)
        with pytest.raises(SoftplcError, match=rf"cannot listen on 127\.0\.0\.1:{served.port}: .*in use"):
            await second.open()


async def test_a_host_that_is_not_here_is_an_error_that_names_it():
    server = ModbusServer(any_port(host="192.0.2.1"), full_exchange().reader)  # TEST-NET-1, RFC 5737
    with pytest.raises(SoftplcError, match=r"cannot listen on 192\.0\.2\.1:0"):
        await server.open()


async def test_the_endpoint_is_written_as_a_person_would_type_it():
    async with serving() as served:
        assert served.port > 0
    server = ModbusServer(any_port(), full_exchange().reader)
    assert (await server.open()).startswith("modbus://127.0.0.1:")
    await server.close()


def test_a_map_that_does_not_fit_is_a_configuration_error():
    placements = (AxisPlacement(axis="AxisX", address=3000), AxisPlacement(axis="AxisY", address=3010))
    with pytest.raises(ConfigError, match=r"Modbus register map: AxisY at 3010…3073 overlaps AxisX at 3000…3063"):
        ModbusServer(any_port(placements=placements), full_exchange().reader)
