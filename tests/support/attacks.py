"""Clients that mean harm to both servers, each as the body of a process: `ports` are OPC-UA's and Modbus'."""

import asyncio
import contextlib
import random
import resource
import struct
from typing import Any

SOCKETS = 1000
_HELLO_BODY = struct.pack("<IIIIIi", 0, 65536, 65536, 0, 0, 23) + b"opc.tcp://127.0.0.1:484"
_HELLO = b"HELF" + struct.pack("<I", 8 + len(_HELLO_BODY)) + _HELLO_BODY
_MODBUS = struct.pack(">HHHBBHH", 1, 0, 6, 1, 4, 0, 100)
_BAD_OPCUA = (
    b"HELF" + struct.pack("<I", 2**31) + bytes(64),
    b"MSGF" + struct.pack("<I", 64) + bytes(56),
    b"HELF" + struct.pack("<I", 32) + struct.pack("<IIIII", 0, 0, 0, 0, 2**32 - 1) + bytes(4),
    _HELLO + b"OPNF" + struct.pack("<I", 132) + random.Random(1).randbytes(124),
    random.Random(2).randbytes(300),
)
_BAD_MODBUS = (
    struct.pack(">HHHBB", 1, 7, 6, 1, 4) + bytes(4),
    struct.pack(">HHH", 1, 0, 0),
    struct.pack(">HHH", 1, 0, 65535) + bytes(300),
    struct.pack(">HHHBBHHB", 1, 0, 8, 1, 16, 0, 60000, 255) + bytes(1),
    random.Random(3).randbytes(300),
)


def flood(ports: tuple[int, int], stop: Any) -> None:
    """A thousand sockets, half on each server, each asking twice a second and coming back when it is thrown out."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, min(hard, 4096)), hard))

    async def one(number: int) -> None:
        port, ask = (ports[0], _HELLO) if number % 2 else (ports[1], _MODBUS)
        await asyncio.sleep(number / SOCKETS)
        while not stop.is_set():
            with contextlib.suppress(OSError):
                reader, writer = await asyncio.open_connection("127.0.0.1", port)
                try:
                    while not stop.is_set():
                        writer.write(ask)
                        await asyncio.sleep(0.5)
                        if reader.at_eof() or reader.exception() is not None:
                            break
                finally:
                    writer.transport.abort()
            await asyncio.sleep(0.5)

    async def run() -> None:
        await asyncio.gather(*(one(number) for number in range(SOCKETS)))

    asyncio.run(run())


def malform(ports: tuple[int, int], stop: Any) -> None:
    """Twenty connections at a time, each with one malformed message, as fast as they are answered or closed."""

    async def one(number: int) -> None:
        chance = random.Random(number)
        while not stop.is_set():
            port, frames = chance.choice(((ports[0], _BAD_OPCUA), (ports[1], _BAD_MODBUS)))
            with contextlib.suppress(OSError, TimeoutError):
                reader, writer = await asyncio.open_connection("127.0.0.1", port)
                try:
                    writer.write(chance.choice(frames))
                    async with asyncio.timeout(0.05):
                        await reader.read(1000)
                finally:
                    writer.transport.abort()

    async def run() -> None:
        await asyncio.gather(*(one(number) for number in range(20)))

    asyncio.run(run())
