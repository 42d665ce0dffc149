"""Servers that die, hang, come back different or never answer: the link is told at once, and the next one works."""

import asyncio
import contextlib
import gc
import os
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from softplc.clock import SystemClock
from softplc.drivers.opcua.driver import REBIND, OpcUaDriver
from softplc.errors import LinkError
from softplc.sample import StatusCode
from softplc.tags import Image
from tests.drivers_opcua.conftest import StartPlc
from tests.drivers_opcua.opened import ForwardClock, Tag, make_driver, opened, read, read_until
from tests.drivers_opcua.servers import NodePlc
from tests.support.network import eventually, free_port

AXIS = "ns=2;s=PLC.Axis"
PATIENCE = 20.0  # less than the requests' own timeout where this is to tell the two apart
Answer = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]
both_modes = pytest.mark.parametrize("mode", ["poll", "subscribe"])


def close_without_waiting(driver: OpcUaDriver) -> None:
    """Close must not wait for anything: its coroutine ends at its first step."""
    with pytest.raises(StopIteration):
        driver.close().send(None)


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def sessions(plc: NodePlc) -> tuple[int, ...]:
    """Sessions and subscriptions that the server has."""
    return tuple(int(count) for count in plc.do("count").split())


@asynccontextmanager
async def opened_twice(url: str, tags: list[str], **config: Any) -> AsyncIterator[tuple[OpcUaDriver, OpcUaDriver]]:
    """A polling and a subscribing driver on the same server."""
    async with (
        opened(url, tags, mode="poll", **config) as one,
        opened(url, tags, mode="subscribe", **config) as other,
    ):
        yield one, other


async def until_link_error(driver: OpcUaDriver, seconds: float = PATIENCE) -> LinkError:
    """Read as scans do, until the link is told."""
    image = Image(len(driver._latest))
    async with asyncio.timeout(seconds):
        while True:
            try:
                await driver.read(image)
            except LinkError as error:
                return error
            await asyncio.sleep(0.01)


async def test_a_killed_server_is_noticed_without_waiting_for_a_timeout(start_plc: StartPlc):
    plc = start_plc()
    patient = {"timeout_ms": 60_000.0, "stale_after_ms": 60_000.0}
    async with opened_twice(plc.url, [f"{AXIS}.Ramp"], **patient) as drivers:
        plc.signal(signal.SIGSTOP)
        waiting = [asyncio.create_task(until_link_error(driver)) for driver in drivers]
        await asyncio.sleep(0)
        plc.kill()

        for error in await asyncio.gather(*waiting):
            assert plc.url in str(error)
        for driver in drivers:
            close_without_waiting(driver)


async def test_a_hung_server_is_noticed_within_the_limit_and_let_go_at_once(start_plc: StartPlc):
    plc = start_plc()
    async with opened_twice(plc.url, [f"{AXIS}.Held"], timeout_ms=500.0, stale_after_ms=1000.0) as drivers:
        plc.signal(signal.SIGSTOP)
        for driver in drivers:
            await until_link_error(driver)
            close_without_waiting(driver)

    plc.signal(signal.SIGCONT)
    async with opened_twice(plc.url, [f"{AXIS}.Held"]) as drivers:
        for driver in drivers:
            assert (await read(driver, 1)).values[0] == 3.0


async def test_a_restarted_server_with_other_indices_and_types_is_read_right_or_not_at_all(start_plc: StartPlc):
    tags = ["nsu=urn:softplc:test:plc;s=PLC.Axis.Float", "/Objects/nsu=urn:softplc:test:plc;PLC/3:Axis/3:Int16"]
    tags += ["ns=2;s=PLC.Axis.Double", "nsu=urn:softplc:test:plc;s=PLC.Axis.Byte"]
    plc = start_plc()
    async with opened_twice(plc.url, tags) as drivers:
        plc.kill()
        for driver in drivers:
            await until_link_error(driver)

    again = start_plc(plc.port, shift=True, **{"as": {"Byte": "String"}})
    async with opened_twice(again.url, tags) as drivers:
        for driver in drivers:
            image = await read(driver, len(tags))
            assert image.values[:2].tolist() == [0.5, -32768.0]
            assert image.statuses[2:].tolist() == [StatusCode.BAD_NODE_ID_UNKNOWN, StatusCode.BAD_TYPE_MISMATCH]


async def test_a_tag_that_the_plc_offers_later_comes_alive_by_itself(start_plc: StartPlc):
    plc = start_plc(without=["Held"])
    clock = ForwardClock()
    tags = [f"{AXIS}.Held", "/Objects/2:PLC/2:Axis/2:Held", f"{AXIS}.Float"]
    async with opened_twice(plc.url, tags, clock=clock) as drivers:
        images = [await read(driver, 3) for driver in drivers]
        for command in ("add Held", "remove Held", "add Held"):
            plc.do(command)
            clock.ahead += REBIND
            for driver, image in zip(drivers, images, strict=True):
                await read_until(driver, image, partial(_shows, driver, image, command == "add Held"))


def _shows(driver: OpcUaDriver, image: Image, held: bool) -> bool:
    """All is well, or the two tags at Held are Bad; the third one always lives."""
    assert (image.values[2], image.statuses[2]) == (0.5, StatusCode.GOOD)
    if held:
        return image.values.tolist() == [3.0, 3.0, 0.5] and not driver.problems
    return image.statuses[:2].tolist() == [StatusCode.BAD_NODE_ID_UNKNOWN] * 2 and len(driver.problems) == 2


async def test_a_good_tag_stays_good_while_a_wrong_one_at_the_same_variable_is_looked_for_again(plc: NodePlc):
    clock = ForwardClock()
    words = "/Objects/2:PLC/2:Axis/2:Words"
    tags: list[Tag] = [(words, 1), (words, 9)]
    async with opened(plc.url, tags, clock=clock) as driver:
        for _ in range(30):
            clock.ahead += REBIND
            assert (await read(driver, 2)).statuses.tolist() == [StatusCode.GOOD, StatusCode.BAD_OUT_OF_RANGE]


async def test_the_channels_token_is_renewed_and_reading_goes_on(plc: NodePlc):
    clock = ForwardClock()
    async with opened(plc.url, [f"{AXIS}.Float"], clock=clock) as driver:
        clock.ahead += 3600.0
        session = driver._session
        assert session.renewal_due
        image = await read(driver, 1)
        await read_until(driver, image, lambda: not session.renewal_due)
        for _ in range(5):
            assert (await read(driver, 1)).values[0] == 0.5


@asynccontextmanager
async def listening(
    answer: Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]],
) -> AsyncIterator[str]:
    """A TCP server that is no OPC-UA server."""
    writers: list[asyncio.StreamWriter] = []

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writers.append(writer)
        await answer(reader, writer)

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    try:
        yield f"opc.tcp://127.0.0.1:{server.sockets[0].getsockname()[1]}"
    finally:
        server.close()
        for writer in writers:
            writer.transport.abort()


async def silence(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    await reader.read()


async def garbage(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    await reader.read(8)
    writer.write(b"HTTP/1.1 400 Bad Request\r\n\r\n" * 10)


async def giant(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    await reader.read(8)
    writer.write(b"MSGF" + struct.pack("<I", 2**31 - 1) + bytes(4096))
    await reader.read()


@pytest.mark.parametrize("answer", [silence, garbage, giant])
async def test_a_peer_that_does_not_speak_opcua_is_given_up(answer: Answer):
    async with listening(answer) as url, asyncio.timeout(PATIENCE):
        driver = make_driver(url, [f"{AXIS}.Float"], connect_timeout_ms=500.0)
        with pytest.raises(LinkError, match=url):
            await driver.open()
        close_without_waiting(driver)


async def test_a_peer_that_says_nothing_has_only_as_long_as_a_request():
    async with listening(silence) as url, asyncio.timeout(PATIENCE):
        driver = make_driver(url, [f"{AXIS}.Float"], connect_timeout_ms=60_000.0, timeout_ms=300.0)
        with pytest.raises(LinkError, match="cannot connect"):
            await driver.open()


async def test_an_announced_giant_is_refused_unbuffered():
    async with listening(giant) as url, asyncio.timeout(PATIENCE):
        driver = make_driver(url, [f"{AXIS}.Float"], connect_timeout_ms=60_000.0)
        with pytest.raises(LinkError, match="cannot connect"):
            await driver.open()


async def test_a_port_where_nobody_listens_is_told_at_once():
    url = f"opc.tcp://127.0.0.1:{free_port()}"
    with pytest.raises(LinkError, match=r"cannot connect to .*127\.0\.0\.1"):
        await make_driver(url, [f"{AXIS}.Float"]).open()


async def test_a_connect_that_gets_no_answer_at_all_ends_in_time():
    with socket.socket() as full:
        full.bind(("127.0.0.1", 0))
        full.listen(0)
        url = f"opc.tcp://127.0.0.1:{full.getsockname()[1]}"
        fillers = [socket.socket() for _ in range(4)]  # the queue of connections not accepted is full from here
        try:
            for filler in fillers:
                filler.setblocking(False)
                filler.connect_ex(full.getsockname())
            async with asyncio.timeout(PATIENCE):
                with pytest.raises(LinkError, match="no answer"):
                    await make_driver(url, [f"{AXIS}.Float"], connect_timeout_ms=300.0).open()
        finally:
            for filler in fillers:
                filler.close()


async def test_a_cancelled_open_leaves_nothing_behind(plc: NodePlc):
    tasks, fds = len(asyncio.all_tasks()), descriptors()
    with contextlib.closing(SystemClock()) as clock:
        for turns in range(0, 60, 3):
            driver = make_driver(plc.url, [f"{AXIS}.Float"], clock=clock, mode="subscribe")
            opening = asyncio.create_task(driver.open())
            for _ in range(turns):
                await asyncio.sleep(0.001)
            opening.cancel()
            await asyncio.gather(opening, return_exceptions=True)
            await driver.close()

    await eventually(lambda: len(asyncio.all_tasks()) <= tasks and descriptors() <= fds)


@both_modes
async def test_twenty_connections_leave_no_task_no_descriptor_and_no_session(plc: NodePlc, mode: str):
    gc.collect()
    tasks, fds, before = len(asyncio.all_tasks()), descriptors(), sessions(plc)
    with contextlib.closing(SystemClock()) as clock:
        for _ in range(20):
            async with opened(plc.url, [f"{AXIS}.Float", f"{AXIS}.Nope"], clock=clock, mode=mode) as driver:
                assert (await read(driver, 2)).values[0] == 0.5

    gc.collect()
    await eventually(lambda: len(asyncio.all_tasks()) <= tasks and descriptors() <= fds)
    assert sessions(plc) <= before


async def test_a_program_that_ends_right_after_close_ends_clean(plc: NodePlc):
    script = f"""
import asyncio
from tests.drivers_opcua.opened import opened, read

async def main():
    for mode in ("poll", "subscribe"):
        async with opened({plc.url!r}, ["{AXIS}.Float"], mode=mode) as driver:
            print((await read(driver, 1)).values[0])

asyncio.run(main())
"""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-X", "dev", "-W", "ignore::DeprecationWarning", "-c", script]
    done = await asyncio.to_thread(
        subprocess.run, command, capture_output=True, text=True, env=environment, timeout=100
    )

    assert done.stdout.split() == ["0.5", "0.5"], done.stderr
    for complaint in ("destroyed", "never retrieved", "never awaited", "unclosed", "Traceback"):
        assert complaint not in done.stderr
