"""A TCP proxy on loopback between a client and a server, whose faults are switched while it runs."""

import asyncio
import socket
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum

MOST = 512  # connections at once; more are refused
PIECE = 65536  # bytes; the most that is held of one direction, beside the kernel's own buffers
_LINGER_RESET = struct.pack("ii", 1, 0)

Spoil = Callable[[bytes], bytes]


class Mode(StrEnum):
    """What becomes of the bytes."""

    PASS = "pass"
    STALL = "stall"  # connections are accepted, nothing is forwarded; what was held goes on with the next mode
    HOLD = "hold"  # the same for what the server sends alone; the client's requests reach it
    BLACKHOLE = "blackhole"  # as when the cable is pulled: nothing comes and nobody is told, for ever, on any
    # connection that saw it; new ones are accepted and as dead
    REFUSE = "refuse"  # nobody listens; what is connected is reset


@dataclass(eq=False)
class _Connection:
    writers: list[asyncio.StreamWriter]
    dead: bool = False
    ahead: int = 0
    tasks: list["asyncio.Task[None]"] = field(default_factory=list)

    def end(self, reset: bool = False) -> None:
        for writer in self.writers:
            if reset and (raw := writer.get_extra_info("socket")) is not None:
                raw.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER_RESET)
            writer.transport.abort()
        for task in self.tasks:
            if task is not asyncio.current_task():
                task.cancel()


class Proxy:
    """Listens on `port` and forwards to `target`; `delay` in seconds holds each piece back, in order.

    `spoil` is applied to each piece that the server sends, b"" drops it; `truncate` cuts the next one in half and
    hangs up. Counts `accepted`, `refused` (too many) and `resets`; `most_ahead` is the most that a client had asked
    without an answer, in pieces.
    """

    def __init__(self, target: int) -> None:
        self.target = target
        self.port = 0
        self.delay = 0.0
        self.spoil: Spoil | None = None
        self.accepted = self.refused = self.resets = 0
        self.most_ahead = 0
        self._truncate = False
        self._mode = Mode.PASS
        self._changed = asyncio.Event()
        self._listener: asyncio.Server | None = None
        self._connections: set[_Connection] = set()

    async def __aenter__(self) -> "Proxy":
        await self._listen()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._deafen()
        self.forget()

    @property
    def open(self) -> int:
        """Connections that are held, dead ones included."""
        return len(self._connections)

    @property
    def mode(self) -> Mode:
        return self._mode

    async def switch(self, mode: Mode) -> None:
        """From here on the bytes fare so."""
        self._mode = mode
        if mode is Mode.BLACKHOLE:
            for connection in self._connections:
                connection.dead = True
        if mode is Mode.REFUSE:
            await self._deafen()
            self.reset()
        elif self._listener is None:
            await self._listen()
        self._changed.set()
        self._changed = asyncio.Event()

    def reset(self) -> int:
        """RST on both sides of every connection; returns how many there were."""
        count = self.forget(reset=True)
        self.resets += count
        return count

    def truncate(self) -> None:
        """The next piece of the server is cut in half and the connection closed after it."""
        self._truncate = True

    def forget(self, reset: bool = False) -> int:
        """Drop every connection, dead ones too."""
        connections, self._connections = self._connections, set()
        for connection in connections:
            connection.end(reset)
        return len(connections)

    def _forget_a_dead_one(self) -> None:
        """Of connections that nobody will ever hear of again the proxy has only so many."""
        dead = next((connection for connection in self._connections if connection.dead), None)
        if dead is not None:
            self._connections.discard(dead)
            dead.end()

    async def _listen(self) -> None:
        self._listener = await asyncio.start_server(self._serve, "127.0.0.1", self.port, limit=PIECE)
        self.port = self._listener.sockets[0].getsockname()[1]

    async def _deafen(self) -> None:
        if self._listener is not None:
            self._listener.close()
            self._listener = None
            await asyncio.sleep(0)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        connection = _Connection([writer], dead=self._mode is Mode.BLACKHOLE)
        if len(self._connections) >= MOST:
            self._forget_a_dead_one()
        if len(self._connections) >= MOST:
            self.refused += 1
            connection.end(reset=True)
            return
        self.accepted += 1
        self._connections.add(connection)
        try:
            upstream, downstream = await asyncio.open_connection("127.0.0.1", self.target, limit=PIECE)
        except OSError:
            self._connections.discard(connection)
            connection.end(reset=True)
            return
        connection.writers.append(downstream)
        if connection not in self._connections:  # forgotten meanwhile
            connection.end()
            return
        connection.tasks = [
            asyncio.create_task(self._pump(connection, reader, downstream, 0), name="proxy up"),
            asyncio.create_task(self._pump(connection, upstream, writer, 1), name="proxy down"),
        ]

    async def _pump(
        self, connection: _Connection, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, way: int
    ) -> None:
        loop = asyncio.get_running_loop()
        try:
            while True:
                data = await reader.read(PIECE)
                connection.ahead += 1 if way == 0 else -1
                self.most_ahead = max(self.most_ahead, connection.ahead)
                until = loop.time() + self.delay
                while self._mode is Mode.STALL or (self._mode is Mode.HOLD and way == 1):
                    await self._changed.wait()
                if connection.dead:
                    await loop.create_future()  # for ever; `forget` ends it
                if until > loop.time():
                    await asyncio.sleep(until - loop.time())
                if not data:
                    break
                if way == 1 and self.spoil is not None:
                    data = self.spoil(data)
                if way == 1 and self._truncate:
                    self._truncate = False
                    writer.write(data[: len(data) // 2])
                    writer.write_eof()
                    break
                writer.write(data)
                await writer.drain()
        except OSError:
            pass
        if connection in self._connections:
            self._connections.discard(connection)
            for end in connection.writers:
                end.close()
            connection.tasks[1 - way].cancel()
