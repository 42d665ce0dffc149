"""A Modbus server on a socket that answers as a test wants, and what is read from it."""

import asyncio
import struct
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

from tests.drivers_modbus.support import tag

Reply = Callable[[bytes, asyncio.StreamWriter], Awaitable[None]]
TAGS = [tag("holding:0", "uint16"), tag("holding:1", "uint16"), tag("coil:0", "bool")]
REGISTERS = TAGS[:2]
SHORT = 1000.0  # ms until silence is a lost link; what is honest must be quicker on a loaded machine


def honest(request: bytes) -> bytes:
    """The right reply to a read: every register 0x0102, every bit on; to a write its echo."""
    function, _, count = struct.unpack(">BHH", request[7:12])
    size = {1: (count + 7) // 8, 3: 2 * count}.get(function)
    if size is None:
        return request[:4] + b"\x00\x06" + request[6:12]
    data = b"\xff" * size if function == 1 else b"\x01\x02" * count
    return request[:4] + struct.pack(">HBBB", 3 + size, request[6], function, size) + data


@asynccontextmanager
async def server(reply: Reply) -> AsyncIterator[int]:
    """Answers the first requests honestly (those of open), then everything with `reply`; yields the port."""
    writers = []

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writers.append(writer)
        served = 0
        while request := await reader.read(300):
            if served < 2:
                writer.write(honest(request))
            else:
                await reply(request, writer)
            served += 1
        writer.close()

    listener = await asyncio.start_server(serve, "127.0.0.1", 0)
    async with listener:
        yield listener.sockets[0].getsockname()[1]
        for writer in writers:
            writer.close()


def answering(make: Callable[[bytes], bytes]) -> Reply:
    async def reply(request: bytes, writer: asyncio.StreamWriter) -> None:
        writer.write(make(request))

    return reply
