"""A process with softplc's OPC-UA server and somebody who feeds its connections with mutants, without sockets.

Started by `tests.fuzz.opcua`; one JSON request per line on standard input, one JSON answer per line on standard
output, and on standard error what the server logs:

    {"feed": seed, "count": n}     n mutants; answers what came of them
    {"replay": [[hex, …], …]}      each list of frames and bodies over a session of its own
    {}                             nothing

Every answer has the resident memory in MiB after a garbage collection, `stall`, the longest that a scan came late
since the answer before, and `surprises`, what asyncua caught because nobody had expected it.
"""

import asyncio
import gc
import json
import logging
import os
import random
import resource
import sys
import time
import traceback
from collections import Counter
from pathlib import Path
from typing import Any

import structlog

from softplc.clock import SystemClock
from softplc.publishers.opcua.config import OpcUaPublisher
from softplc.publishers.opcua.hardened.limits import Limits
from softplc.publishers.opcua.server import OpcUaServer
from tests.fuzz.opcua_messages import Channel, Message, corpus, frame
from tests.fuzz.opcua_mutate import mutate, mutate_frame
from tests.publishers_opcua.conftest import USERS
from tests.support.exchange import make_exchange

PERIOD = 0.02  # seconds between two scans
_TOLD = 0.5  # the period that clients are told: the feeder may hold the scans up, and nobody is to call them dead
_FRAMES = 0.04  # share of mutants that are broken as frames; most of those end their connection
_SLOW = 0.25  # seconds; a message that takes longer is told with its bytes


class Wire(asyncio.Transport):
    """The server's end of a connection that has no socket; keeps the answers until they are taken."""

    def __init__(self) -> None:
        super().__init__({"peername": ("192.0.2.1", 4840), "sockname": ("127.0.0.1", 4840)})
        self.sent = bytearray()
        self.closed = False
        self.protocol: Any = None

    def write(self, data: Any) -> None:
        self.sent += data
        if len(self.sent) > 1 << 20:
            self.sent.clear()

    def get_write_buffer_size(self) -> int:
        return 0

    def is_closing(self) -> bool:
        return self.closed

    def close(self) -> None:
        if not self.closed:
            self.closed = True
            asyncio.get_running_loop().call_soon(self.protocol.connection_lost, None)

    abort = close

    def pause_reading(self) -> None:
        """Frames come one at a time."""

    resume_reading = pause_reading


class Connection:
    """An engineer's session with one subscription of three items, on a wire."""

    def __init__(self, listener: Any, messages: list[Message]) -> None:
        self.wire = Wire()
        self.channel = Channel()
        self._messages = {(message.service): message for message in reversed(messages)}
        self.protocol = self.wire.protocol = listener._make_protocol()
        self.protocol.connection_made(self.wire)

    def usable(self) -> bool:
        processor = self.protocol.processor
        session = processor.session if processor is not None else None
        return not self.wire.closed and session is not None and session.is_activated() and bool(session.own())

    async def open(self) -> None:
        hello, opening = self._messages["Hello"], self._messages["OpenSecureChannel"]
        await self.feed(frame(b"HEL", hello.body))
        self.wire.sent.clear()
        await self.feed(frame(b"OPN", self.channel.opening(opening.body)))
        self.channel.opened(bytes(self.wire.sent[8:]))
        for service in ("CreateSession", "ActivateSession", "CreateSubscription", "CreateMonitoredItems"):
            await self.feed(self.channel.message(self.channel.fill(self._messages[f"{service}Request"].body)))
            session = self.protocol.processor.session
            self.channel.session = session.auth_token.Identifier
            own = session.own()
            if own:
                self.channel.subscription = min(own).to_bytes(4, "little")
        self.wire.sent.clear()

    async def feed(self, data: bytes) -> None:
        """Hand the bytes to the server and wait until it has done with them."""
        self.protocol.data_received(data)
        for _ in range(50):
            await asyncio.sleep(0)
            if not self.protocol.messages.qsize():
                break
        await asyncio.sleep(0)

    async def close(self) -> None:
        session = self.protocol.processor.session if self.protocol.processor else None
        self.wire.close()
        if session is not None:
            await session.close_session()
        number = int.from_bytes(self.channel.subscription, "little")
        await self.protocol.iserver.subscription_service.delete_subscriptions([number])
        await asyncio.sleep(0)


class Surprises(logging.Handler):
    """What asyncua catches because it did not expect it, by the place where it was raised."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.found: Counter[str] = Counter()

    def emit(self, record: logging.LogRecord) -> None:
        if record.exc_info and record.exc_info[2]:
            last = traceback.extract_tb(record.exc_info[2])[-1]
            self.found[f"{record.exc_info[0].__name__} {Path(last.filename).name}:{last.lineno} {last.name}"] += 1  # type: ignore[union-attr]


class Host:
    """The server, its scans, and the feeder."""

    def __init__(self, port: int, limits: Limits | None = None) -> None:
        self.exchange = make_exchange(SystemClock())
        self.exchange.publish(_TOLD)
        self.server = OpcUaServer(OpcUaPublisher(type="opcua", port=port, users=USERS), self.exchange.reader, limits)
        self.messages = corpus()
        self.requests = [message for message in self.messages if message.kind == b"MSG"]
        self.surprises = Surprises()
        self.stall = 0.0  # the longest that a scan came late

    async def scan(self) -> None:
        clock, begun, number = self.exchange.clock, time.monotonic(), 0
        while True:
            number += 1
            await clock.sleep_until(begun + number * PERIOD)
            late = time.monotonic() - begun - number * PERIOD
            self.stall = max(self.stall, late)
            number += int(late / PERIOD)
            self.exchange.writer.commands()
            self.exchange.publish(_TOLD)
            await self.server.publish()

    async def feed(self, seed: int, count: int) -> dict[str, Any]:
        chance = random.Random(seed)
        connection: Connection | None = None
        begun, opened, worst, slow = time.monotonic(), 0, 0.0, []
        for _ in range(count):
            if connection is None or not connection.usable():
                if connection is not None:
                    await connection.close()
                connection = Connection(self.server._listener, self.messages)
                await connection.open()
                opened += 1
            data = self._mutant(connection.channel, chance)
            at = time.monotonic()
            await connection.feed(data)
            took = time.monotonic() - at
            worst = max(worst, took)
            if took > _SLOW:
                slow.append([round(took, 3), data.hex()])
        if connection is not None:
            await connection.close()
        seconds = time.monotonic() - begun
        return {"seconds": seconds, "connections": opened, "worst": worst, "slow": slow[:20]}

    def _mutant(self, channel: Channel, chance: random.Random) -> bytes:
        message = chance.choice(self.requests)
        if chance.random() < _FRAMES:
            return mutate_frame(channel.message(channel.fill(message.body)), chance)
        body = channel.fill(mutate(message, self.requests, chance))
        cuts = tuple(chance.randrange(len(body) + 1) for _ in range(2)) if chance.random() < 0.02 else ()
        return channel.message(body, cuts=cuts)

    async def replay(self, cases: list[list[str]]) -> dict[str, Any]:
        """Each case over a connection of its own."""
        worst = 0.0
        for case in cases:
            connection = Connection(self.server._listener, self.messages)
            await connection.open()
            for text in case:
                at = time.monotonic()
                body = connection.channel.fill(bytes.fromhex(text))
                await connection.feed(connection.channel.message(body))
                worst = max(worst, time.monotonic() - at)
            await connection.close()
        return {"worst": worst}


def rss() -> float:
    """Resident memory, MiB."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGESIZE") / 2**20


async def main(port: int, limits: str, files: int) -> None:
    if files:
        resource.setrlimit(resource.RLIMIT_NOFILE, (files, files))
    structlog.configure(logger_factory=structlog.PrintLoggerFactory(sys.stderr))
    host = Host(port, Limits(**json.loads(limits)))
    url = await host.server.open()
    processor = logging.getLogger("asyncua.server.uaprocessor")
    processor.setLevel(logging.ERROR)
    processor.propagate = False
    processor.addHandler(host.surprises)
    scanning = asyncio.create_task(host.scan())
    print(json.dumps({"url": url}), flush=True)
    lines = asyncio.StreamReader(limit=1 << 26)
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(lines), sys.stdin)
    while line := await lines.readline():
        request = json.loads(line)
        answer: dict[str, Any] = {"rss": rss()}
        if "feed" in request:
            answer |= await host.feed(request["feed"], request["count"])
        if "replay" in request:
            answer |= await host.replay(request["replay"])
        answer |= {"rss": rss(), "surprises": host.surprises.found.most_common(), "stall": host.stall}
        host.stall = 0.0
        print(json.dumps(answer), flush=True)
    scanning.cancel()
    await host.server.close()


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1]), sys.argv[2], int(sys.argv[3])))
