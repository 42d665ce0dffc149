"""TCP straight on the socket: bytes there and back, and every end of a connection reaches its owner once."""

import asyncio
import socket
import struct

import pytest

from softplc.drivers.modbus.stream import connect
from tests.support.network import eventually, free_port


class Owner:
    def __init__(self) -> None:
        self.received = b""
        self.ends: list[Exception | None] = []

    def data_received(self, data: bytes) -> None:
        self.received += data

    def connection_lost(self, exc: Exception | None) -> None:
        self.ends.append(exc)


def hosts() -> list[str]:
    """What this machine can be reached by from itself."""
    try:
        socket.create_server(("::1", 0), family=socket.AF_INET6).close()
    except OSError:
        return ["127.0.0.1", "localhost"]
    return ["127.0.0.1", "localhost", "::1"]


@pytest.mark.parametrize("host", hosts())
async def test_an_address_and_a_name_are_connected_to_and_bytes_go_both_ways(host: str):
    async def echo(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while data := await reader.read(100):
            writer.write(data)
        writer.close()

    listener = await asyncio.start_server(echo, host, 0)
    async with listener:
        owner = Owner()
        port = listener.sockets[-1].getsockname()[1]
        stream = await connect(host, port, owner)
        stream.write(b"request")
        await eventually(lambda: owner.received == b"request")
        stream.abort()
        stream.abort()
        await asyncio.sleep(0)
        assert owner.ends == []  # who lets go need not be told


async def test_nobody_there_is_the_systems_own_error():
    with pytest.raises(ConnectionRefusedError):
        await connect("127.0.0.1", free_port(), Owner())


@pytest.mark.parametrize("way", ["closed", "reset"])
async def test_the_end_of_a_connection_is_told_once(way: str):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        owner = Owner()
        stream = await connect("127.0.0.1", listener.getsockname()[1], owner)
        other, _ = listener.accept()
        if way == "reset":
            other.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        other.close()
        await eventually(lambda: bool(owner.ends))
        stream.write(b"too late")
        assert [type(end) for end in owner.ends] == [type(None) if way == "closed" else ConnectionResetError]


async def test_a_device_that_takes_no_requests_is_lost():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        owner = Owner()
        stream = await connect("127.0.0.1", listener.getsockname()[1], owner)
        other, _ = listener.accept()
        with other:
            for _ in range(10_000):
                if owner.ends:
                    break
                stream.write(bytes(65_536))
            (end,) = owner.ends
            assert "takes no more requests" in str(end)
