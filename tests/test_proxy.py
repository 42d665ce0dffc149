"""The fault proxy does what the chaos suite takes for granted."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from tests.support.network import eventually
from tests.support.proxy import Mode, Proxy


@asynccontextmanager
async def proxied() -> AsyncIterator[Proxy]:
    """A proxy before a server that sends back what it gets."""

    async def echo(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while data := await reader.read(1000):
            writer.write(data)
        writer.close()

    async with await asyncio.start_server(echo, "127.0.0.1", 0) as server:
        port = server.sockets[0].getsockname()[1]
        async with Proxy(port) as proxy:
            yield proxy


async def exchange(proxy: Proxy, text: bytes = b"hello") -> bytes:
    reader, writer = await asyncio.open_connection("127.0.0.1", proxy.port)
    writer.write(text)
    try:
        return await reader.read(1000)
    finally:
        writer.close()


async def silent(reader: asyncio.StreamReader) -> bool:
    try:
        async with asyncio.timeout(0.1):
            await reader.read(1)
    except TimeoutError:
        return True
    return False


async def test_pass_delay_and_spoil():
    async with proxied() as proxy:
        assert await exchange(proxy) == b"hello"
        proxy.delay = 0.05
        begun = asyncio.get_running_loop().time()
        assert await exchange(proxy) == b"hello"
        assert asyncio.get_running_loop().time() - begun >= 0.1  # there and back
        proxy.delay, proxy.spoil = 0.0, bytes.upper
        assert await exchange(proxy) == b"HELLO"


async def test_a_stall_holds_back_and_goes_on():
    async with proxied() as proxy:
        await proxy.switch(Mode.STALL)
        reader, writer = await asyncio.open_connection("127.0.0.1", proxy.port)
        writer.write(b"hello")
        assert await silent(reader)
        await proxy.switch(Mode.PASS)
        assert await reader.read(10) == b"hello"
        writer.close()


async def test_a_connection_that_was_in_a_blackhole_is_dead_for_ever_and_nobody_is_told():
    async with proxied() as proxy:
        before = await asyncio.open_connection("127.0.0.1", proxy.port)
        before[1].write(b"a")
        assert await before[0].read(1) == b"a"
        await proxy.switch(Mode.BLACKHOLE)
        within = await asyncio.open_connection("127.0.0.1", proxy.port)
        await eventually(lambda: proxy.open == 2)
        await proxy.switch(Mode.PASS)
        for reader, writer in (before, within):
            writer.write(b"hello")
            assert await silent(reader)
        assert await exchange(proxy) == b"hello"
        for _, writer in (before, within):
            writer.close()


async def test_reset_truncate_and_refuse():
    async with proxied() as proxy:
        reader, writer = await asyncio.open_connection("127.0.0.1", proxy.port)
        writer.write(b"a")
        await reader.read(1)
        assert proxy.reset() == 1
        with pytest.raises(ConnectionResetError):
            await reader.read(1)
        proxy.truncate()
        assert await exchange(proxy, b"truncate") == b"trun"
        await proxy.switch(Mode.REFUSE)
        with pytest.raises(OSError):
            await exchange(proxy)
        await proxy.switch(Mode.PASS)
        assert await exchange(proxy) == b"hello"
        assert (proxy.accepted, proxy.resets) == (3, 1)
