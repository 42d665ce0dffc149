"""A connection to a Modbus device: every wait has an end, a fault ends the connection.

One request is outstanding, unless a burst of reads is allowed more; replies are then told by their transaction ids.

Modbus TCP is framed here (`tcp.py`) rather than by pymodbus: MBAP is seven bytes, and what the driver needs is what
pymodbus' client leaves out: a reply is refused unless transaction, unit, function and length are those of the
request; a lost connection wakes the one who waits at once; nothing is retried or reconnected behind the link's back;
the bytes of the reply reach numpy untouched. Serial lines and RTU through a TCP gateway are pymodbus' (`rtu.py`).
"""

import asyncio
import os
from typing import Protocol

from softplc.clock import Clock
from softplc.drivers.modbus import stream
from softplc.drivers.modbus.burst import BurstState
from softplc.drivers.modbus.config import ModbusSource, RtuOverTcpTransport, RtuTransport, TcpTransport
from softplc.drivers.modbus.pdu import MixedUpError, ProtocolError
from softplc.drivers.modbus.tcp import TcpFraming
from softplc.errors import ConfigError, LinkError


class Framing(Protocol):
    """How PDUs become bytes on one kind of connection and back; see TcpFraming, RtuFraming."""

    @property
    def pause(self) -> float:
        """Seconds of silence between what came last and the next request."""
        ...

    @property
    def drops_unasked(self) -> bool:
        """True when bytes that nobody asked for are noise, false when they are a fault."""
        ...

    def frame(self, pdu: bytes) -> bytes:
        """The bytes of a request."""
        ...

    def feed(self, data: bytes) -> bytes | None:
        """The reply's PDU when these bytes complete it. Raises ProtocolError."""
        ...


class Wire(Protocol):
    """What takes requests to the device: a Stream, or the transport of a serial line."""

    def write(self, data: bytes) -> None:
        """Send."""
        ...

    def abort(self) -> None:
        """Let go at once."""
        ...


class Client(asyncio.Protocol):
    """One open connection. After the first fault every request raises LinkError with that fault's text.

    `name` is the device's endpoint as a person knows it, `heard` the monotonic time at which the last bytes came.
    """

    def __init__(self, framing: Framing, name: str, timeout: float, clock: Clock) -> None:
        self.name = name
        self._framing, self._timeout, self._clock = framing, timeout, clock
        self._loop = asyncio.get_running_loop()
        self._wire: Wire | None = None
        self._turn = asyncio.Lock()  # held from a request's sending until its reply, whoever still waits for it
        self._reply: asyncio.Future[bytes] | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._due = 0.0  # loop time at which the device has kept us waiting for too long
        self._burst: BurstState | None = None
        self._in_flight = 1
        self.heard = float("-inf")
        self._fault: str | None = None

    async def request(self, pdu: bytes) -> bytes:
        """Send a request PDU and return the reply PDU. Raises LinkError."""
        await self._turn.acquire()
        try:
            reply = await self._send(pdu)
        except BaseException:
            self._turn.release()
            raise
        return await reply

    async def read(self, burst: BurstState, in_flight: int) -> None:
        """Have every request of the burst answered, at most so many outstanding. Modbus TCP. Raises LinkError."""
        await self._turn.acquire()
        try:
            reply = self._begin()
        except BaseException:
            self._turn.release()
            raise
        assert isinstance(self._framing, TcpFraming)
        burst.start(self._framing.take_ids(len(burst)))
        self._burst, self._in_flight = burst, in_flight
        self._write(burst.due(in_flight))
        await reply

    async def close(self) -> None:
        """Let go of the socket or port."""
        self._fail("closed")
        await asyncio.sleep(0)  # the transport closes its socket in the loop's next turn

    def connected(self, wire: Wire) -> None:
        """Where requests go from now on."""
        self._wire = wire

    def data_received(self, data: bytes) -> None:
        """asyncio: bytes came."""
        self.heard = self._clock.monotonic()
        if self._reply is None:
            if not self._framing.drops_unasked:
                self._fail(f"{len(data)} bytes came, nothing was asked for")
            return
        try:
            pdu = self._framing.feed(data) if self._burst is None else self._next(self._burst, data)
        except ProtocolError as error:
            self._fail(str(error), mixed_up=isinstance(error, MixedUpError))
            return
        if pdu is not None:
            reply = self._finish()
            if reply is not None:
                reply.set_result(pdu)

    def connection_lost(self, exc: Exception | None) -> None:
        """asyncio: the connection is gone."""
        self._fail(f"connection lost: {exc}" if exc else "connection closed by the device")

    async def _send(self, pdu: bytes) -> asyncio.Future[bytes]:
        ready = self.heard + self._framing.pause
        if self._framing.pause and self._clock.monotonic() < ready:
            await self._clock.sleep_until(ready)
        reply = self._begin()
        self._write(self._framing.frame(pdu))
        return reply

    def _begin(self) -> asyncio.Future[bytes]:
        """What the one who asks waits for, from now on for so long and no longer."""
        if self._fault is not None or self._wire is None:
            raise LinkError(self._fault or f"{self.name}: not connected")
        self._reply = self._loop.create_future()
        self._due = self._loop.time() + self._timeout
        self._timer = self._loop.call_at(self._due, self._late)
        return self._reply

    def _write(self, frames: bytes) -> None:
        assert self._wire is not None
        self._wire.write(frames)

    def _next(self, burst: BurstState, data: bytes) -> bytes | None:
        """Take what came and send what is due; an empty PDU when the burst is over. Raises ProtocolError."""
        if burst.feed(data, self.heard, self._clock.utc_ns()):
            self._due = self._loop.time() + self._timeout
        if burst.done:
            return b""
        if self._reply is not None and self._reply.done():  # nobody waits any more: only what was sent is awaited
            return None if burst.outstanding else b""
        frames = burst.due(self._in_flight)
        if frames:
            self._write(frames)
        return None

    def _late(self) -> None:
        """The time for a reply is up, unless one of a burst came meanwhile."""
        if self._loop.time() < self._due:
            self._timer = self._loop.call_at(self._due, self._late)
        else:
            self._fail(f"no reply within {self._timeout:g} s")

    def _fail(self, reason: str, *, mixed_up: bool = False) -> None:
        """The first fault is the connection's end: the one who waits is told, and the transport goes at once."""
        if self._fault is not None:
            return
        self._fault = f"{self.name}: {reason}"
        reply = self._finish()
        if reply is not None:
            reply.set_exception((MixedUpError if mixed_up else LinkError)(self._fault))
        if self._wire is not None:
            self._wire.abort()

    def _finish(self) -> asyncio.Future[bytes] | None:
        """The outstanding request is over; its future, if someone still waits for it."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        reply, self._reply, self._burst = self._reply, None, None
        if reply is None:
            return None
        self._turn.release()
        return None if reply.done() else reply


def framing_of(source: ModbusSource) -> Framing:
    """The frames of a source's transport; imports pymodbus where it is needed.

    Raises ConfigError for unit 0 on a serial line, and for several requests in flight there.
    """
    if source.in_flight > 1 and not isinstance(source.transport, TcpTransport):
        raise ConfigError(
            f"source {source.name}: in_flight {source.in_flight} needs transaction ids, which only Modbus TCP has; "
            f"expected 1"
        )
    if source.unit_id == 0 and not isinstance(source.transport, TcpTransport):
        raise ConfigError(
            f"source {source.name}: unit_id 0 is the broadcast of a serial line, nobody answers it; expected 1 to 247"
        )
    match source.transport:
        case TcpTransport():
            return TcpFraming(source.unit_id)
        case RtuOverTcpTransport():
            from softplc.drivers.modbus.rtu import RtuFraming  # noqa: PLC0415  pymodbus, only for RTU

            return RtuFraming(source.unit_id)
        case RtuTransport(baudrate=baudrate):
            from softplc.drivers.modbus.rtu import RtuFraming, silence  # noqa: PLC0415

            return RtuFraming(source.unit_id, silence(baudrate))


async def connect(source: ModbusSource, framing: Framing, clock: Clock) -> Client:
    """A connection to the source's device. Raises LinkError when there is none within its timeout."""
    transport = source.transport
    timeout = source.timeout_ms / 1000.0
    if isinstance(transport, RtuTransport):
        from softplc.drivers.modbus.rtu import open_serial  # noqa: PLC0415

        client = Client(framing, transport.device, timeout, clock)
        client.connected(open_serial(transport, client))
        return client
    name = f"{transport.host}:{transport.port}"
    limit = min(timeout, source.connect_timeout_ms / 1000.0)  # a handshake is no slower than a request
    client = Client(framing, name, timeout, clock)
    try:
        async with asyncio.timeout(limit):
            client.connected(await stream.connect(transport.host, transport.port, client))
    except TimeoutError as error:
        raise LinkError(f"{name}: no connection within {limit:g} s") from error
    except OSError as error:
        raise LinkError(f"{name}: cannot connect: {_reason(error)}") from error
    except UnicodeError as error:  # an empty or too long part of a host name
        raise LinkError(f"{name}: cannot connect: {transport.host!r} is no host name") from error
    return client


def _reason(error: OSError) -> str:
    """What the system says; asyncio's own text would name host and port once more."""
    if error.errno is not None and error.errno > 0:  # the resolver's numbers are negative
        return os.strerror(error.errno)
    return error.strerror or str(error)
