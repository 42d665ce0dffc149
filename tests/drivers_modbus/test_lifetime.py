"""A server that stalls or goes, readers that give up, connections that come and go: always an end, always in time."""

import asyncio
import os
import signal
import socket
import struct
import time

import pytest

from softplc.clock import SystemClock
from softplc.drivers.modbus.config import TcpTransport
from softplc.drivers.modbus.driver import ModbusDriver
from softplc.errors import LinkError
from softplc.tags import Image
from tests.drivers_modbus.scripted import REGISTERS, SHORT, TAGS, answering, honest, server
from tests.drivers_modbus.support import GENEROUS, descriptors, opened, read, running_peer, source
from tests.support.drivers import write_values
from tests.support.network import eventually, free_port


@pytest.mark.parametrize("way", ["reset", "closed"])
async def test_a_connection_that_goes_wakes_the_reader_at_once(way):
    async def leave(_: bytes, writer: asyncio.StreamWriter) -> None:
        if way == "reset":
            raw = writer.get_extra_info("socket")
            raw.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        writer.transport.abort()

    async with server(leave) as port, opened(source(port), TAGS) as driver:
        begun = time.monotonic()
        with pytest.raises(LinkError, match=r"connection lost|connection closed by the device"):
            await read(driver, len(TAGS))
        assert time.monotonic() - begun < GENEROUS / 1000 / 2  # well before the request's own timeout


async def test_a_stopped_server_is_a_lost_link_within_the_timeout():
    async with running_peer() as peer, opened(source(peer.port, timeout_ms=SHORT), TAGS) as driver:
        await read(driver, len(TAGS))
        os.kill(peer.pid, signal.SIGSTOP)
        try:
            with pytest.raises(LinkError, match=r"no reply within 1 s"):
                async with asyncio.timeout(30):
                    await read(driver, len(TAGS))
        finally:
            os.kill(peer.pid, signal.SIGCONT)


async def test_a_server_that_never_answered_fails_the_opening():
    async def silent(_: asyncio.StreamReader, __: asyncio.StreamWriter) -> None:
        await asyncio.sleep(0)

    async with await asyncio.start_server(silent, "127.0.0.1", 0) as listener:
        port = listener.sockets[0].getsockname()[1]
        with pytest.raises(LinkError, match=r"no reply|connection closed"):
            async with opened(source(port, timeout_ms=SHORT), TAGS):
                pass


async def test_a_port_where_nobody_listens_is_named():
    port = free_port()
    with pytest.raises(LinkError, match=rf"127\.0\.0\.1:{port}: cannot connect: Connection refused"):
        async with opened(source(port), TAGS):
            pass


async def test_a_host_name_that_is_none_is_named():
    nowhere = TcpTransport.model_construct(host="plc..local", port=502)
    with pytest.raises(LinkError, match=r"cannot connect: 'plc\.\.local' is no host name"):
        async with opened(source(502, transport=nowhere), TAGS):
            pass


@pytest.mark.parametrize("shorter", ["connect_timeout_ms", "timeout_ms"])
async def test_a_host_that_does_not_answer_is_given_up_within_the_shorter_timeout(shorter):
    with socket.socket() as full:
        full.bind(("127.0.0.1", 0))
        full.listen(0)
        port = full.getsockname()[1]
        fillers = [socket.socket() for _ in range(4)]  # the backlog is full: further SYNs are dropped
        for filler in fillers:
            filler.setblocking(False)
            filler.connect_ex(("127.0.0.1", port))
        try:
            with pytest.raises(LinkError, match=r"no connection within 0\.3 s"):
                async with opened(source(port, **{shorter: 300.0}), TAGS):
                    pass
        finally:
            for filler in fillers:
                filler.close()


async def test_a_reader_that_gave_up_leaves_no_stale_reply_to_the_next_one():
    pending: list[bytes] = []

    async def late(request: bytes, writer: asyncio.StreamWriter) -> None:
        pending.append(request)
        if len(pending) == 1:  # the answer to the first request comes when the second reader waits already
            await asyncio.sleep(0.05)
        writer.write(honest(request))

    async with server(late) as port, opened(source(port), REGISTERS) as driver:
        await read(driver, 2)
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.01):
                await read(driver, 2)
        assert (await read(driver, 2)).values.tolist() == [258.0, 258.0]

    assert [struct.unpack(">H", request[:2])[0] for request in pending] == [3, 4]


async def test_a_read_and_a_write_at_once_never_have_two_requests_outstanding():
    outstanding, most = 0, 0

    async def slow(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        async def answer(request: bytes) -> None:
            nonlocal outstanding
            await asyncio.sleep(0.005)  # time enough for a second request to come
            outstanding -= 1
            writer.write(honest(request))

        nonlocal outstanding, most
        async with asyncio.TaskGroup() as tasks:
            while request := await reader.read(300):
                outstanding += 1
                most = max(most, outstanding)
                tasks.create_task(answer(request))
        writer.close()

    async with await asyncio.start_server(slow, "127.0.0.1", 0) as listener:
        port = listener.sockets[0].getsockname()[1]
        async with opened(source(port), TAGS, TAGS) as driver:
            images = [Image(len(TAGS)) for _ in range(5)]
            async with asyncio.TaskGroup() as tasks:
                for image in images:
                    tasks.create_task(driver.read(image))
                    tasks.create_task(write_values(driver, {0: 258.0, 2: 1.0}))

    assert most == 1
    assert all(image.values.tolist() == [258.0, 258.0, 1.0] for image in images)


async def test_twenty_connections_leave_no_tasks_and_no_file_descriptors():
    async with server(answering(honest)) as port:
        clock = SystemClock()

        async def cycle(i: int) -> None:
            driver = ModbusDriver(source(port), TAGS, [], clock)
            await driver.open()
            if i % 2:
                await driver.read(Image(len(TAGS)))
            await driver.close()
            await driver.close()

        await cycle(0)
        await eventually(lambda: len(asyncio.all_tasks()) == 1, what="the server's side of the first cycle is gone")
        before = descriptors()
        for i in range(20):
            await cycle(i)
        await eventually(lambda: descriptors() == before, what="file descriptors are back")
        await eventually(lambda: len(asyncio.all_tasks()) == 1, what="no task is left")
        clock.close()
