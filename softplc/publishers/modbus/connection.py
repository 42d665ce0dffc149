"""One Modbus client: bytes in, answers out, and what it may hold of us is bounded.

Straight on the socket rather than on asyncio's transport, which would add a layer and buffers of its own: there is
one receive buffer of fixed size, and the answers to at most one such buffer of requests. Nothing more is read from a
client until it has taken those.
"""

import asyncio
import socket
from typing import Final, Protocol

from softplc.publishers.modbus import protocol

RECEIVE_BYTES: Final = 2048  # per client; some 170 requests are answered in one go
_SEND_BYTES: Final = 65_536  # answers that wait for a client in the kernel; it doubles the figure


class Host(Protocol):
    """What a connection needs of the server that it belongs to."""

    units: frozenset[int]
    stall_timeout: float

    def registers(self) -> bytes:
        """All registers as of the newest snapshot."""
        ...

    def leave(self, connection: "Connection") -> None:
        """A connection is gone."""
        ...

    def stalled(self, connection: "Connection") -> None:
        """A connection was dropped since the client did not take its answers."""
        ...


class Connection:
    """A client at `address`. `quiet` counts the server's sweeps since its last whole request."""

    def __init__(self, host: Host, sock: socket.socket, address: str) -> None:
        self.address = address
        self.quiet = 0
        self._host, self._socket = host, sock
        self._loop = asyncio.get_running_loop()
        self._buffer = bytearray(RECEIVE_BYTES)
        self._view = memoryview(self._buffer)
        self._filled = 0
        self._pending = b""  # answers that the client has not taken yet
        self._stall: asyncio.TimerHandle | None = None
        self._last = False  # nothing more is to be read: close when the client has its answers
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BYTES)
        self._loop.add_reader(sock, self._readable)

    @property
    def waiting(self) -> int:
        """Bytes of answers that wait for the client in this process; while there are any, nothing is read from it."""
        return len(self._pending)

    def drop(self) -> None:
        """Let go of the client at once."""
        if self._stall is not None:
            self._stall.cancel()
            self._stall = None
        if self._socket.fileno() >= 0:
            self._loop.remove_reader(self._socket)
            self._loop.remove_writer(self._socket)
            self._socket.close()
            self._host.leave(self)

    def _readable(self) -> None:
        try:
            count = self._socket.recv_into(self._view[self._filled :])
        except (BlockingIOError, InterruptedError):
            return
        except OSError:
            self.drop()
            return
        if not count:
            self.drop()
            return
        filled = self._filled + count
        try:
            answer = protocol.answer(self._buffer, filled, self._host.units, self._host.registers)
        except BaseException:  # a defect of ours must not come back with every packet
            self.drop()
            raise
        self._filled = filled - answer.consumed
        if self._filled and answer.consumed:
            self._view[: self._filled] = self._view[answer.consumed : filled]
        self._last = answer.close
        if answer.replies:
            self.quiet = 0
            self._send(answer.replies)
        elif answer.close:
            self.drop()

    def _send(self, replies: bytes) -> None:
        """Give the kernel what it takes; what is left waits, and the client is not read from meanwhile."""
        sent = self._give(replies)
        if sent is None:
            return
        if sent < len(replies):
            self._pending = replies[sent:]
            self._loop.remove_reader(self._socket)
            self._loop.add_writer(self._socket, self._writable)
            self._stall = self._loop.call_later(self._host.stall_timeout, self._drop_stalled)
        elif self._last:
            self.drop()

    def _writable(self) -> None:
        sent = self._give(self._pending)
        if sent is None:
            return
        self._pending = self._pending[sent:]
        if self._pending:
            return
        if self._last:
            self.drop()
            return
        if self._stall is not None:
            self._stall.cancel()
            self._stall = None
        self._loop.remove_writer(self._socket)
        self._loop.add_reader(self._socket, self._readable)

    def _give(self, replies: bytes) -> int | None:
        """How many bytes the kernel took; None when the connection is gone."""
        try:
            return self._socket.send(replies)
        except (BlockingIOError, InterruptedError):
            return 0
        except OSError:
            self.drop()
            return None

    def _drop_stalled(self) -> None:
        self.drop()
        self._host.stalled(self)
