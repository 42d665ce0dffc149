"""The Modbus TCP server: listens, admits clients up to a cap, and drops those that are idle or do not read."""

import asyncio
import socket
from typing import Final, cast

import structlog

from softplc.errors import ConfigError, SoftplcError
from softplc.exchange import Reader
from softplc.publishers.modbus import protocol
from softplc.publishers.modbus.config import ModbusPublisher
from softplc.publishers.modbus.image import RegisterImage
from softplc.publishers.modbus.map import build_map
from softplc.publishers.modbus.placement import PlacementError

STALL_TIMEOUT_S: Final = 5.0  # a client that does not take its answers for so long is dropped
_RECEIVE_BYTES: Final = 2048  # per client; some 170 requests are answered in one go
_SEND_BYTES: Final = 65_536  # answers waiting for a client, in the process and again in the kernel, before we pause
_CLOSE_TIMEOUT_S: Final = 1.0
_SWEEPS: Final = 4  # an idle client is dropped after 1 to 1 + 1/_SWEEPS of the idle timeout
_WARN_EVERY_S: Final = 60.0
_ANY_UNIT: Final = (0, 255)  # both mean the server itself (TCP/IP Implementation Guide V1.0b: unit identifier)

log = structlog.get_logger(__name__)


class ModbusServer:
    """Publisher of all tags as read-only registers over Modbus TCP; see docs/modbus-map.md.

    Raises ConfigError at construction when the register map does not fit.
    """

    def __init__(self, config: ModbusPublisher, reader: Reader, stall_timeout: float = STALL_TIMEOUT_S) -> None:
        try:
            self.map = build_map(reader.table, config)
        except PlacementError as error:
            raise ConfigError(*(f"Modbus register map: {text}" for _, text in error.problems)) from error
        self.units = frozenset({config.unit_id, *_ANY_UNIT})
        self.stall_timeout = stall_timeout
        self._config = config
        self._reader = reader
        self._image = RegisterImage(self.map, len(reader.table), config.bad_values)
        self._connections: set[_Connection] = set()
        self._deserted = asyncio.Event()
        self._deserted.set()
        self._server: asyncio.Server | None = None
        self._sweeper: asyncio.TimerHandle | None = None
        self._warned: dict[str, asyncio.TimerHandle] = {}

    async def open(self) -> str:
        """Listen; returns the endpoint as in `modbus://127.0.0.1:5020`."""
        host, port = self._config.host, self._config.port
        loop = asyncio.get_running_loop()
        try:
            self._server = await loop.create_server(lambda: _Connection(self), host, port)
        except OSError as error:
            raise SoftplcError(_cannot_listen(host, port, error)) from error
        self._sweep()
        bound = self._server.sockets[0].getsockname()[1]
        return f"modbus://{f'[{host}]' if ':' in host else host}:{bound}"

    async def publish(self) -> None:
        """Encode the newest snapshot, so that requests find it done."""
        self.registers()

    async def close(self) -> None:
        """Stop listening, drop every client."""
        for timer in (self._sweeper, *self._warned.values()):
            if timer is not None:
                timer.cancel()
        if self._server is None:
            return
        self._server.close()
        for connection in tuple(self._connections):
            connection.drop()
        try:
            async with asyncio.timeout(_CLOSE_TIMEOUT_S):
                await self._server.wait_closed()
                await self._deserted.wait()  # aborted ones leave in the loop's next turn
        except TimeoutError:
            log.warning("modbus server did not close in time", clients=len(self._connections))
        self._server = None

    @property
    def clients(self) -> int:
        """How many clients are connected."""
        return len(self._connections)

    def registers(self) -> bytes:
        """All registers as of the newest snapshot."""
        return self._image.encode(self._reader.snapshot())

    def admit(self, connection: "_Connection") -> bool:
        """Count a new client in, unless there are too many."""
        if len(self._connections) >= self._config.max_clients:
            self.warn("modbus client refused, too many are connected", limit=self._config.max_clients)
            return False
        self._connections.add(connection)
        self._deserted.clear()
        return True

    def leave(self, connection: "_Connection") -> None:
        """A connection is gone."""
        self._connections.discard(connection)
        if not self._connections:
            self._deserted.set()

    def warn(self, event: str, **fields: float) -> None:
        """Log what a client can bring about at will: each event once a minute at most."""
        if event not in self._warned:
            log.warning(event, clients=self.clients, **fields)
            loop = asyncio.get_running_loop()
            self._warned[event] = loop.call_later(_WARN_EVERY_S, self._warned.pop, event)

    def _sweep(self) -> None:
        """Drop those that asked nothing during the last sweeps."""
        for connection in tuple(self._connections):
            connection.quiet_sweeps += 1
            if connection.quiet_sweeps > _SWEEPS:
                connection.drop()
        interval = self._config.idle_timeout_s / _SWEEPS
        self._sweeper = asyncio.get_running_loop().call_later(interval, self._sweep)


class _Connection(asyncio.BufferedProtocol):
    """One client. What it holds is bounded: a receive buffer of fixed size, and answers up to the write limit.

    When the client does not take its answers, nothing more is read from it; after the stall timeout it is dropped.
    """

    _transport: asyncio.Transport

    def __init__(self, server: ModbusServer) -> None:
        self.quiet_sweeps = 0
        self._server = server
        self._buffer = bytearray(_RECEIVE_BYTES)
        self._view = memoryview(self._buffer)
        self._filled = 0
        self._stalled: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)
        if not self._server.admit(self):
            self._transport.abort()
            return
        sock: socket.socket = transport.get_extra_info("socket")
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BYTES)
        self._transport.set_write_buffer_limits(high=_SEND_BYTES)

    def connection_lost(self, exc: Exception | None) -> None:
        self._cancel_stall()
        self._server.leave(self)

    def get_buffer(self, sizehint: int) -> memoryview:
        return self._view[self._filled :]

    def buffer_updated(self, nbytes: int) -> None:
        filled = self._filled + nbytes
        answer = protocol.answer(self._buffer, filled, self._server.units, self._server.registers)
        self._filled = filled - answer.consumed
        if answer.consumed:
            self.quiet_sweeps = 0
            self._view[: self._filled] = self._view[answer.consumed : filled]
            self._transport.write(answer.replies)
        if answer.close:
            self._transport.close()

    def pause_writing(self) -> None:
        self._transport.pause_reading()
        loop = asyncio.get_running_loop()
        self._stalled = loop.call_later(self._server.stall_timeout, self._drop_stalled)

    def resume_writing(self) -> None:
        self._cancel_stall()
        self._transport.resume_reading()

    def drop(self) -> None:
        """Let go of the client at once."""
        self._transport.abort()

    def _drop_stalled(self) -> None:
        self._server.warn("modbus client dropped, it does not take its answers", seconds=self._server.stall_timeout)
        self.drop()

    def _cancel_stall(self) -> None:
        if self._stalled is not None:
            self._stalled.cancel()
            self._stalled = None


def _cannot_listen(host: str, port: int, error: OSError) -> str:
    text = f"Modbus server: cannot listen on {host}:{port}: {error.strerror or error}"
    if isinstance(error, PermissionError):
        return f"{text}; ports below 1024 need CAP_NET_BIND_SERVICE, or choose a port from 1024"
    return f"{text}; choose another host or port, or end the program that has it"
