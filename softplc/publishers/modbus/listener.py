"""Listening sockets of our own, and what becomes of newcomers when the process has no file descriptor left.

asyncio's server answers a lack of descriptors with a traceback for each place of its backlog, every second, and lets
the newcomers wait. Here one descriptor is held in reserve: it is given up to take the newcomer in, who is
disconnected at once, and taken back. Whoever is connected is served meanwhile.
"""

import asyncio
import errno
import os
import socket
from collections.abc import Callable
from typing import Final

_BACKLOG: Final = 1024
_AT_ONCE: Final = 32  # newcomers taken in before those who are connected have their turn
_PAUSE_S: Final = 0.5
_NO_ROOM: Final = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)


class Listener:
    """Takes in whoever comes and hands over the socket, non-blocking, and the address it comes from.

    `exhausted` is called for each newcomer who was sent away because descriptors ran out.
    """

    def __init__(self, newcomer: Callable[[socket.socket, str], None], exhausted: Callable[[], None]) -> None:
        self._newcomer, self._exhausted = newcomer, exhausted
        self._loop = asyncio.get_running_loop()
        self._sockets: list[socket.socket] = []
        self._pauses: dict[socket.socket, asyncio.TimerHandle] = {}
        self._reserve = -1

    async def open(self, host: str, port: int) -> int:
        """Listen on every address of the host; returns the port. Raises OSError when there is none to listen on."""
        found = await self._loop.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        last: OSError | None = None
        for family, address in dict.fromkeys((entry[0], entry[4]) for entry in found):
            try:
                self._sockets.append(_listening(family, address))
            except OSError as error:  # a host may have addresses of a family that is switched off here
                last = error
                if error.errno not in (errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT):
                    break
        if not self._sockets or (last is not None and last.errno == errno.EADDRINUSE):
            self.close()
            raise last or OSError(f"{host} has no address")
        self._reserve = _reserve()
        for sock in self._sockets:
            self._loop.add_reader(sock, self._accept, sock)
        return int(self._sockets[0].getsockname()[1])

    def close(self) -> None:
        """Listen no more."""
        for pause in self._pauses.values():
            pause.cancel()
        for sock in self._sockets:
            self._loop.remove_reader(sock)
            sock.close()
        self._pauses.clear()
        self._sockets.clear()
        if self._reserve >= 0:
            os.close(self._reserve)
            self._reserve = -1

    def _accept(self, sock: socket.socket) -> None:
        for _ in range(_AT_ONCE):
            try:
                newcomer, address = sock.accept()
            except (BlockingIOError, InterruptedError, ConnectionAbortedError):
                return
            except OSError as error:
                if error.errno not in _NO_ROOM or not self._send_away(sock):
                    self._pause(sock)
                return
            newcomer.setblocking(False)
            self._newcomer(newcomer, str(address[0]))

    def _send_away(self, sock: socket.socket) -> bool:
        """Take in and disconnect one newcomer with the descriptor in reserve; false when there is none left."""
        if self._reserve < 0:
            self._reserve = _reserve()
        if self._reserve < 0:
            return False
        os.close(self._reserve)
        try:
            newcomer, _ = sock.accept()
            newcomer.close()
        except BlockingIOError:  # nobody was there: the kernel looks for a descriptor first
            return True
        except OSError:
            return False
        finally:
            self._reserve = _reserve()
        self._exhausted()
        return True

    def _pause(self, sock: socket.socket) -> None:
        """Let newcomers wait for a while rather than try without end."""
        self._loop.remove_reader(sock)
        self._pauses[sock] = self._loop.call_later(_PAUSE_S, self._resume, sock)

    def _resume(self, sock: socket.socket) -> None:
        del self._pauses[sock]
        self._loop.add_reader(sock, self._accept, sock)


def _reserve() -> int:
    """A descriptor to keep; -1 when there is none to be had."""
    try:
        return os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return -1


def _listening(family: int, address: tuple[object, ...]) -> socket.socket:
    sock = socket.socket(family, socket.SOCK_STREAM)
    try:
        sock.setblocking(False)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if family == socket.AF_INET6:
            sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        sock.bind(address)
        sock.listen(_BACKLOG)
    except OSError:
        sock.close()
        raise
    return sock
