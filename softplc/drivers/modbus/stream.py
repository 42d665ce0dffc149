"""A TCP connection straight on its socket: what comes goes to its owner at once, what is sent leaves at once.

asyncio's own transport makes room for 256 KiB with every reply, which costs more than all else that is done for a
request of Modbus.
"""

import asyncio
import socket
from typing import Any, Final, Protocol

_MOST_AT_ONCE: Final = 16_384  # bytes; a Modbus reply has 260


class Owner(Protocol):
    """Who is told what comes; see asyncio.Protocol."""

    def data_received(self, data: bytes) -> None:
        """Bytes came."""
        ...

    def connection_lost(self, exc: Exception | None) -> None:
        """The connection is gone; None when the other side closed it."""
        ...


class Stream:
    """A connected, non-blocking socket and its owner."""

    def __init__(self, sock: socket.socket, owner: Owner) -> None:
        self._socket, self._owner = sock, owner
        self._loop = asyncio.get_running_loop()
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._loop.add_reader(sock, self._readable)

    def write(self, data: bytes) -> None:
        """Send. Requests are small and few: a device that does not take one whole is lost."""
        try:
            sent = self._socket.send(data)
        except (BlockingIOError, InterruptedError):
            sent = 0
        except OSError as error:
            self._lose(error)
            return
        if sent < len(data):
            self._lose(OSError("the device takes no more requests"))

    def abort(self) -> None:
        """Let go at once; the owner is not told."""
        if self._socket.fileno() >= 0:
            self._loop.remove_reader(self._socket)
            self._socket.close()

    def _readable(self) -> None:
        try:
            data = self._socket.recv(_MOST_AT_ONCE)
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:
            self._lose(error)
            return
        if data:
            self._owner.data_received(data)
        else:
            self._lose(None)

    def _lose(self, error: OSError | None) -> None:
        if self._socket.fileno() >= 0:
            self.abort()
            self._owner.connection_lost(error)


async def connect(host: str, port: int, owner: Owner) -> Stream:
    """A connection to the first address of the host that takes it. Raises OSError, UnicodeError for no host name."""
    loop = asyncio.get_running_loop()
    last: OSError | None = None
    places = _literal(host, port)
    if not places:
        found = await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        places = [(entry[0], entry[4]) for entry in found]
    for family, address in places:
        try:
            sock = socket.socket(family, socket.SOCK_STREAM)
        except OSError as error:  # a family that is switched off here
            last = error
            continue
        try:
            sock.setblocking(False)
            await loop.sock_connect(sock, address)
            return Stream(sock, owner)
        except OSError as error:
            sock.close()
            last = error
        except BaseException:
            sock.close()
            raise
    raise last or OSError(f"{host} has no address")


def _literal(host: str, port: int) -> list[tuple[int, Any]]:
    """What a host that is an address already stands for; nothing to look up, which would take a thread."""
    for family in (socket.AF_INET, socket.AF_INET6):
        try:
            socket.inet_pton(family, host)
        except OSError:
            continue
        return [(family, (host, port))]
    return []
