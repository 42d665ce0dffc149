"""What the server does to clients that ask for anything, come in numbers, say nothing, or do not listen."""

import asyncio
import contextlib
import socket
import struct
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from softplc.publishers.modbus.protocol import answer
from tests.publishers_modbus.child import child, room_for_sockets
from tests.publishers_modbus.oracle import expected
from tests.publishers_modbus.support import Client, client_of, request, serving
from tests.publishers_modbus.test_protocol import IMAGE, UNITS, frame, pdu_of
from tests.support.network import eventually

CHECK_WORD = b"\x12\x34"


async def connect_from(address: str, port: int) -> Client:
    """A client whose packets come from this address of loopback."""
    return Client(*await asyncio.open_connection("127.0.0.1", port, local_addr=(address, 0)))


async def is_served(client: Client) -> bool:
    """Whether the server answers it, or else has disconnected it."""
    with contextlib.suppress(ConnectionError, asyncio.IncompleteReadError):
        return await asyncio.wait_for(client.read(0, 1), 30) == CHECK_WORD
    return False


def silent(address: str, port: int, count: int) -> list[socket.socket]:
    """So many connections from an address, none of which says anything."""
    return [socket.create_connection(("127.0.0.1", port), 30, (address, 0)) for _ in range(count)]


def test_every_function_code_with_every_length_has_the_answer_of_the_specification():
    for unit in (0, 1, 9, 255):
        frames = b"".join(
            frame(bytes([function]) + bytes(range(length - 2)), unit)
            for function in range(256)
            for length in range(2, 255)
        )
        found = answer(frames, len(frames), UNITS, lambda: IMAGE)
        assert (found.replies, found.consumed, found.close) == expected(frames, IMAGE)


@pytest.mark.parametrize("function", [3, 4])
def test_every_quantity_at_both_ends_of_the_table_has_the_answer_of_the_specification(function: int):
    served = len(IMAGE) // 2
    firsts = (0, served - 125, 65411)
    frames = b"".join(request(first, quantity, function) for first in firsts for quantity in range(65536))

    found = answer(frames, len(frames), UNITS, lambda: IMAGE)

    assert (found.replies, found.consumed, found.close) == expected(frames, IMAGE)


def test_every_header_of_a_wrong_protocol_or_length_asks_to_close():
    for length in (0, 1, *range(255, 65536)):
        found = answer(frame(b"\x03\x00\x00\x00\x01", length=length), 12, UNITS, lambda: IMAGE)
        assert (found.replies, found.consumed, found.close) == (b"", 0, True)
    for protocol in range(1, 65536):
        assert answer(frame(b"\x03\x00\x00\x00\x01", protocol=protocol), 12, UNITS, lambda: IMAGE).close


FOREIGN = {
    "1 read coils": "0100000001",
    "2 read discrete inputs": "0200000001",
    "5 write coil on": "050000ff00",
    "5 write coil with a value that is neither on nor off": "0500001234",
    "7 read exception status": "07",
    "8 return query data": "08000012345678",
    "8 force listen only mode": "0800040000",
    "11 get comm event counter": "0b",
    "12 get comm event log": "0c",
    "16 with a byte count that is not twice the quantity": "100000000203000102",
    "16 with the longest PDU": "100000007bf6" + 246 * "00",
    "17 report server id": "11",
    "20 read file record": "140706000400010002",
    "22 mask write register": "16000400f20025",
    "23 read and write registers": "17000000010000000102ffff",
    "24 read FIFO queue": "1804de",
    "43/14 read device identification": "2b0e0100",
    "43/13 CANopen": "2b0d0100",
    "0": "00",
    "128": "80",
    "255": "ff",
}


@pytest.mark.parametrize("pdu", FOREIGN.values(), ids=FOREIGN.keys())
async def test_a_function_that_is_not_served_is_illegal_and_the_connection_goes_on(pdu: str):
    raw = bytes.fromhex(pdu)
    async with serving() as served, client_of(served) as client:
        for unit in (0, 1, 255):
            assert (7, unit, bytes([raw[0] | 0x80, 1])) == await client.ask(frame(raw, unit))
        assert await client.read(0, 1) == CHECK_WORD


async def test_all_function_codes_over_one_connection_are_answered_one_by_one():
    async with serving() as served, client_of(served) as client:
        for function in range(256):
            _, _, pdu = await client.ask(frame(bytes([function, 0, 0, 0, 1])))
            wanted = b"\x02" + CHECK_WORD if function in (3, 4) else b"\x01"
            assert pdu == bytes([function if function in (3, 4) else function | 0x80]) + wanted


async def test_one_address_has_so_many_places_and_no_more():
    async with serving(max_clients=8, max_clients_per_address=3) as served:
        clients = [await connect_from("127.0.0.1", served.port) for _ in range(3)]
        assert all([await is_served(client) for client in clients])
        with capture_logs() as logs:
            for _ in range(4):
                refused = await connect_from("127.0.0.1", served.port)
                assert not await is_served(refused)
                await refused.close()
        assert [entry["event"] for entry in logs] == [
            "modbus client refused, too many are connected from its address"
        ]  # not four times
        other = await connect_from("127.0.0.2", served.port)
        assert await is_served(other)

        await clients[0].close()
        await eventually(lambda: served.server.clients == 3)
        clients[0] = await connect_from("127.0.0.1", served.port)
        assert await is_served(clients[0])
        for client in (*clients, other):
            await client.close()


async def test_when_all_places_are_taken_there_is_one_more_for_an_address_that_has_none():
    async with serving(max_clients=4, max_clients_per_address=2) as served:
        clients = [await connect_from(f"127.0.0.{2 + n // 2}", served.port) for n in range(4)]
        assert all([await is_served(client) for client in clients])
        operator = await connect_from("127.0.0.9", served.port)
        assert await is_served(operator)

        for address in ("127.0.0.9", "127.0.0.2", "127.0.0.10"):
            refused = await connect_from(address, served.port)
            assert not await is_served(refused)
            await refused.close()
        assert all([await is_served(client) for client in (*clients, operator)])
        for client in (*clients, operator):
            await client.close()


async def test_a_client_that_asks_nothing_gives_its_place_to_one_who_finds_none():
    """As when a PLC was restarted and its old connections are half-open."""
    async with serving(give_way=0.5, max_clients_per_address=3) as served:
        first, second = [await connect_from("127.0.0.1", served.port) for _ in range(2)]
        busy = await connect_from("127.0.0.1", served.port)
        await is_served(first)
        assert served.server.clients == 3

        newcomer = await connect_from("127.0.0.1", served.port)
        while not await is_served(newcomer):  # until one of the others has been quiet for long enough
            assert await is_served(busy)
            await newcomer.close()
            newcomer = await connect_from("127.0.0.1", served.port)

        assert await is_served(busy)
        assert [await one.closed() for one in (first, second) if one.reader.at_eof()] == [True]
        assert served.server.clients == 3
        for client in (first, second, busy, newcomer):
            await client.close()


async def test_answers_before_a_bad_header_are_sent_and_a_client_that_does_not_take_them_is_dropped():
    async with serving(stall_timeout=1.0) as served:
        sock = socket.socket()
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        sock.connect(("127.0.0.1", served.port))
        writer = (await asyncio.open_connection(sock=sock, limit=1))[1]
        writer.write(b"".join(request(3000, 125) for _ in range(8000)) + frame(b"\x03", protocol=1))
        await eventually(lambda: served.server.clients == 1)
        await eventually(lambda: served.server.clients == 0)
        writer.close()


async def test_a_thousand_silent_sockets_of_one_address_keep_nobody_else_out(tmp_path: Path):
    room_for_sockets(4096)
    with child(tmp_path) as server:
        before = server.resident
        crowd = await asyncio.to_thread(silent, "127.0.0.1", server.port, 1000)
        async with asyncio.timeout(10):  # seconds: a stall; it takes milliseconds
            operator = await connect_from("127.0.0.2", server.port)
            assert await is_served(operator)
        assert server.resident - before < 2**20
        assert server.log.stat().st_size < 1000
        for sock in crowd:
            sock.close()
        await operator.close()


async def test_a_thousand_clients_that_are_allowed_cost_little_and_are_dropped_when_idle(tmp_path: Path):
    room_for_sockets(4096)
    limits = {"max_clients": 1000, "max_clients_per_address": 1000, "idle_timeout_s": 3}
    with child(tmp_path, **limits) as server:
        idle_before, open_before = server.resident, server.descriptors
        crowd = await asyncio.to_thread(silent, "127.0.0.1", server.port, 1000)
        operator = await connect_from("127.0.0.2", server.port)
        assert await is_served(operator)
        assert server.resident - idle_before < 8 * 2**20  # 8 KiB each: the receive buffer is 2

        deadline = asyncio.get_running_loop().time() + 30
        while server.descriptors > open_before + 10 and asyncio.get_running_loop().time() < deadline:
            assert await is_served(operator)
            await asyncio.sleep(0.05)
        assert server.descriptors <= open_before + 10  # the operator, and what the child opens for itself
        for sock in crowd:
            sock.close()
        await operator.close()


async def test_without_descriptors_newcomers_are_sent_away_and_those_who_are_in_are_served(tmp_path: Path):
    limits = {"max_clients": 1000, "max_clients_per_address": 1000}
    with child(tmp_path, descriptors=64, **limits) as server:
        early = await connect_from("127.0.0.2", server.port)
        assert await is_served(early)
        crowd = [await connect_from("127.0.0.1", server.port) for _ in range(200)]
        served = [await is_served(client) for client in crowd]
        assert 30 < sum(served) < 64
        assert await is_served(early)
        late = await connect_from("127.0.0.3", server.port)
        assert not await is_served(late)
        await late.close()
        assert server.log.read_text().count("no file descriptor left") == 1
        assert server.log.stat().st_size < 1000

        for client in crowd:
            await client.close()
        await eventually(lambda: server.descriptors < 30)
        again = await connect_from("127.0.0.3", server.port)
        assert await is_served(again)
        assert await is_served(early)
        await again.close()
        await early.close()


async def test_a_response_is_never_mixed_up_among_clients_that_ask_at_once():
    async with serving(max_clients_per_address=16) as served:
        clients = [await Client.connect(served.port) for _ in range(16)]

        async def ask(number: int, client: Client) -> None:
            for n in range(50):
                transaction = (number << 8) + n
                assert await client.ask(request(0, 1, transaction=transaction)) == (
                    transaction,
                    1,
                    b"\x03\x02\x12\x34",
                )

        await asyncio.gather(*(ask(number, client) for number, client in enumerate(clients)))
        for client in clients:
            await client.close()


def test_the_reply_echoes_transaction_and_unit():
    for transaction in (0, 1, 0x8000, 0xFFFF):
        for unit in (0, 1, 255):
            reply = answer(request(5, 1, 3, unit, transaction), 12, UNITS, lambda: IMAGE).replies
            assert (struct.pack(">H", transaction), unit, b"\x03\x02\x00\x05") == (reply[:2], reply[6], pdu_of(reply))
