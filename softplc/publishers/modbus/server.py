"""The Modbus TCP server: listens, admits clients up to its caps, and drops those that are idle or do not read."""

import asyncio
import math
import socket
from collections import Counter
from typing import Final

import structlog

from softplc.errors import ConfigError, SoftplcError
from softplc.exchange import Reader
from softplc.publishers.modbus.config import ModbusPublisher
from softplc.publishers.modbus.connection import Connection
from softplc.publishers.modbus.image import RegisterImage
from softplc.publishers.modbus.listener import Listener
from softplc.publishers.modbus.map import build_map
from softplc.publishers.modbus.placement import PlacementError

STALL_TIMEOUT_S: Final = 5.0  # a client that does not take its answers for so long is dropped
GIVE_WAY_S: Final = 10.0  # a client that asked nothing for so long gives its place to one who finds none
_RESERVED: Final = 1  # places beyond max_clients, for an address that has none
_SWEEP_S: Final = 1.0
_SWEEPS: Final = 4  # at least so many in any of these times: they end at most a quarter late
_WARN_EVERY_S: Final = 60.0
_ANY_UNIT: Final = (0, 255)  # both mean the server itself (TCP/IP Implementation Guide V1.0b: unit identifier)

log = structlog.get_logger(__name__)


class ModbusServer:
    """Publisher of all tags as read-only registers over Modbus TCP; see docs/modbus-map.md.

    Raises ConfigError at construction when the register map does not fit.
    """

    def __init__(
        self,
        config: ModbusPublisher,
        reader: Reader,
        stall_timeout: float = STALL_TIMEOUT_S,
        give_way: float = GIVE_WAY_S,
    ) -> None:
        try:
            self.map = build_map(reader.table, config)
        except PlacementError as error:
            raise ConfigError(*(f"Modbus register map: {text}" for _, text in error.problems)) from error
        self.units = frozenset({config.unit_id, *_ANY_UNIT})
        self.stall_timeout = stall_timeout
        self._config = config
        self._reader = reader
        self._image = RegisterImage(self.map, len(reader.table), config.bad_values)
        self._connections: set[Connection] = set()
        self._of_address: Counter[str] = Counter()
        self._listener: Listener | None = None
        self._sweep_s = min(_SWEEP_S, config.idle_timeout_s / _SWEEPS, give_way / _SWEEPS)
        self._idle_sweeps = math.ceil(config.idle_timeout_s / self._sweep_s)
        self._give_way_sweeps = math.ceil(give_way / self._sweep_s)
        self._sweeper: asyncio.TimerHandle | None = None
        self._warned: dict[str, int] = {}
        self._timers: dict[str, asyncio.TimerHandle] = {}

    async def open(self) -> str:
        """Listen; returns the endpoint as in `modbus://127.0.0.1:5020`."""
        host, port = self._config.host, self._config.port
        self._listener = Listener(self._newcomer, self._exhausted)
        try:
            bound = await self._listener.open(host, port)
        except OSError as error:
            raise SoftplcError(_cannot_listen(host, port, error)) from error
        self._sweep()
        return f"modbus://{f'[{host}]' if ':' in host else host}:{bound}"

    async def publish(self) -> None:
        """Encode the newest snapshot, so that requests find it done."""
        self.registers()

    async def close(self) -> None:
        """Stop listening, drop every client."""
        for timer in (self._sweeper, *self._timers.values()):
            if timer is not None:
                timer.cancel()
        if self._listener is not None:
            self._listener.close()
        for connection in tuple(self._connections):
            connection.drop()

    @property
    def clients(self) -> int:
        """How many clients are connected."""
        return len(self._connections)

    def registers(self) -> bytes:
        """All registers as of the newest snapshot."""
        return self._image.encode(self._reader.snapshot())

    def leave(self, connection: Connection) -> None:
        """A connection is gone."""
        self._connections.discard(connection)
        self._of_address[connection.address] -= 1
        if not self._of_address[connection.address]:
            del self._of_address[connection.address]

    def stalled(self, connection: Connection) -> None:
        """A connection was dropped since the client did not take its answers."""
        self._warn("modbus client dropped, it does not take its answers", seconds=self.stall_timeout)

    def _newcomer(self, sock: socket.socket, address: str) -> None:
        """Let a client in when there is a place for it, or when one who asks nothing gives way."""
        limit = self._config.max_clients_per_address
        if self._of_address[address] >= limit:
            admitted = self._make_room(address)
            event, field = "modbus client refused, too many are connected from its address", "limit_per_address"
        else:
            limit = self._config.max_clients
            places = limit if address in self._of_address else limit + _RESERVED
            admitted = len(self._connections) < places or self._make_room()
            event, field = "modbus client refused, too many are connected", "limit"
        if not admitted:
            sock.close()
            self._warn(event, **{field: limit})
            return
        try:
            self._connections.add(Connection(self, sock, address))
        except OSError:  # the client is gone already
            sock.close()
            return
        self._of_address[address] += 1

    def _make_room(self, address: str | None = None) -> bool:
        """Drop the client that has asked nothing for the longest time, if that is long; of one address, or of all."""
        chosen = [one for one in self._connections if address in (None, one.address)]
        quietest = max(chosen, key=lambda one: one.quiet, default=None)
        if quietest is None or quietest.quiet < self._give_way_sweeps:
            return False
        quietest.drop()
        return True

    def _exhausted(self) -> None:
        self._warn("modbus client refused, this process has no file descriptor left")

    def _sweep(self) -> None:
        """Drop those that asked nothing for too long."""
        for connection in tuple(self._connections):
            connection.quiet += 1
            if connection.quiet > self._idle_sweeps:
                connection.drop()
        self._sweeper = asyncio.get_running_loop().call_later(self._sweep_s, self._sweep)

    def _warn(self, event: str, **fields: float) -> None:
        """Log what a client can bring about at will: each event once a minute at most, and how often it came."""
        if event in self._warned:
            self._warned[event] += 1
            return
        self._warned[event] = 0
        log.warning(event, clients=self.clients, **fields)
        self._timers[event] = asyncio.get_running_loop().call_later(_WARN_EVERY_S, self._warn_again, event, fields)

    def _warn_again(self, event: str, fields: dict[str, float]) -> None:
        times = self._warned.pop(event)
        del self._timers[event]
        if times:
            self._warn(event, **{**fields, "times": times})


def _cannot_listen(host: str, port: int, error: OSError) -> str:
    text = f"Modbus server: cannot listen on {host}:{port}: {error.strerror or error}"
    if isinstance(error, PermissionError):
        return f"{text}; ports below 1024 need CAP_NET_BIND_SERVICE, or choose a port from 1024"
    return f"{text}; choose another host or port, or end the program that has it"
