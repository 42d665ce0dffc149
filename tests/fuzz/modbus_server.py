"""The Modbus server under malformed frames: in this process by the million, and over sockets."""

import asyncio
import contextlib
import os
import random
import struct
import time
import zlib
from dataclasses import dataclass
from pathlib import Path

from softplc.publishers.modbus.protocol import answer
from tests.fuzz.modbus_frames import Stream, streams
from tests.publishers_modbus.child import Child, child
from tests.publishers_modbus.oracle import expected
from tests.publishers_modbus.support import Client, request

CORPUS = Path(__file__).parent / "corpus" / "modbus"
UNITS = frozenset({0, 1, 255})
IMAGE = struct.pack(">3128H", *range(3128))
_AT_ONCE = 8
_WARM = 20  # one part in so many is not measured: caches of the interpreter fill with the first ones


@dataclass(frozen=True, slots=True)
class Result:
    """What came of it. `growth` is resident memory, bytes; `log` bytes; the neighbour's slowest answer in seconds."""

    frames: int
    seconds: float
    growth: int
    log: int = 0
    neighbour: int = 0
    slowest: float = 0.0


class WrongError(AssertionError):
    """The server did other than the specification says; the stream is kept in the corpus."""


def resident() -> int:
    """Memory of this process, bytes."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def keep(data: bytes, folder: Path = CORPUS) -> Path:
    """Put a stream into the corpus."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"found-{zlib.crc32(data):08x}.bin"
    path.write_bytes(data)
    return path


def check(stream: bytes, cuts: tuple[int, ...] = ()) -> None:
    """Answer a stream that arrives in pieces, and hold that against the specification. Raises WrongError."""
    waiting, replies, used, closed = b"", [], 0, False
    start = 0
    for stop in (*cuts, len(stream)):
        waiting += stream[start:stop]
        start = stop
        found = answer(waiting, len(waiting), UNITS, lambda: IMAGE)
        replies.append(found.replies)
        waiting, used, closed = waiting[found.consumed :], used + found.consumed, found.close
        if closed:
            break
    if (b"".join(replies), used, closed) != expected(stream, IMAGE):
        raise WrongError(f"not as specified, cut at {cuts}")


def in_process(frames: int, seed: int) -> Result:
    """So many frames through the protocol, every response compared with what the specification says."""
    chance = random.Random(seed)
    done, before, begun = 0, 0, time.perf_counter()
    for stream in streams(seed):
        size = len(stream.data)
        cuts = tuple(sorted(chance.randrange(size) for _ in range(chance.choice((0, 0, 1, 2)))))
        try:
            check(stream.data, cuts)
        except Exception as error:
            raise WrongError(f"{error!r}, cuts {cuts}: {keep(stream.data)}") from error
        done += stream.frames
        if not before and done * _WARM >= frames:
            before = resident()
        if done >= frames:
            break
    return Result(done, time.perf_counter() - begun, resident() - before)


def over_sockets(frames: int, seed: int, folder: Path) -> Result:
    """So many frames to a server in its own process, while a neighbour reads from it all the time."""
    with child(folder, max_clients_per_address=_AT_ONCE + 8) as server:
        return asyncio.run(_attack(server, frames, seed))


async def _attack(server: Child, frames: int, seed: int) -> Result:
    supply, done, before = streams(seed), 0, 0
    reads: list[float] = []
    neighbour = asyncio.create_task(_neighbour(server.port, reads))
    begun = time.perf_counter()

    async def attacker() -> None:
        nonlocal done, before
        while done < frames:
            stream = next(supply)
            await _one(server.port, stream)
            done += stream.frames
            if not before and done * _WARM >= frames:
                before = server.resident

    async with asyncio.TaskGroup() as group:
        for _ in range(_AT_ONCE):
            group.create_task(attacker())
    seconds = time.perf_counter() - begun
    neighbour.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await neighbour
    last = await Client.connect(server.port)
    assert (await last.ask(request(0, 1)))[2] == b"\x03\x02\x12\x34"
    await last.close()
    growth, log = server.resident - before, server.log.stat().st_size
    return Result(done, seconds, growth, log, len(reads), max(reads))


async def _one(port: int, stream: Stream) -> None:
    """Send a stream and compare what comes back: all headers and codes; data change with every scan."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    received, whole = b"", False
    try:
        async with asyncio.timeout(60):
            with contextlib.suppress(OSError):
                writer.write(stream.data)
                writer.write_eof()
                while piece := await reader.read(65536):
                    received += piece
                whole = True
    except TimeoutError as error:
        raise WrongError(f"no end within 60 s: {keep(stream.data)}") from error
    finally:
        writer.transport.abort()
    replies, used, closed = expected(stream.data, IMAGE)
    found, wanted = _shape(received), _shape(replies)
    if closed and not whole:  # closed before it had read all that followed: a reset, which may overtake answers
        wanted = wanted[: len(found)]
    if found != wanted:
        raise WrongError(f"not as specified, {used} bytes used: {keep(stream.data)}")


async def _neighbour(port: int, reads: list[float]) -> None:
    """A client that reads one thing after the other and must never be answered wrong, or dropped."""
    client = Client(*await asyncio.open_connection("127.0.0.1", port, local_addr=("127.0.0.2", 0)))
    number = 0
    while True:
        number = (number + 1) % 65536
        begun = time.perf_counter()
        transaction, unit, pdu = await client.ask(request(0, 6, transaction=number))
        reads.append(time.perf_counter() - begun)
        assert (transaction, unit) == (number, 1)
        assert pdu[:4] == b"\x03\x0c\x12\x34"
        assert pdu[6:14] == struct.pack(">ff", 1.0, -123.456)
        await asyncio.sleep(0.002)


def _shape(replies: bytes) -> list[bytes]:
    """Each response up to its byte count or exception code."""
    found, at = [], 0
    while at < len(replies):
        found.append(replies[at : at + 9])
        at += 6 + int.from_bytes(replies[at + 4 : at + 6], "big")
    return found
