"""The Modbus driver: polls its readings with as few requests as the device allows, and writes its writings.

Each read asks for everything once, one request after the other, or several in flight where the configuration allows
it and the device stands the test. An exception response is the status of the tags of that request (`pdu.py`); any
reply that does not fit its request, and silence, end the connection with a LinkError. Modbus carries no timestamps:
the source timestamp of a sample is the wall time at which its reply arrived.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from softplc.clock import Clock
from softplc.drivers.modbus.address import LAST_OFFSET, Address, parse_address
from softplc.drivers.modbus.burst import BurstState
from softplc.drivers.modbus.client import Client, connect, framing_of
from softplc.drivers.modbus.codec import REGISTERS, Field, encode
from softplc.drivers.modbus.config import ModbusSource, ModbusTag, ModbusType
from softplc.drivers.modbus.in_flight import seen
from softplc.drivers.modbus.pdu import (
    WRITE_REGISTER,
    MixedUpError,
    ProtocolError,
    read_reply,
    write_reply,
    write_request,
)
from softplc.drivers.modbus.plan import Limits, Request, Span
from softplc.drivers.modbus.polling import Answer, PollState, Question, Round, Value
from softplc.drivers.modbus.tcp import TcpFraming
from softplc.errors import ConfigError, LinkError
from softplc.interfaces import Positions
from softplc.sample import StatusCode
from softplc.tags import Image

T = TypeVar("T")

_MOST_IN_A_BURST: Final = 0xFFFF  # transaction ids
_SEARCH_SHARE: Final = 0.25  # of a read's time limit, for finding which addresses a device does not know


class ModbusDriver:
    """One connection to one unit of a Modbus device, over TCP, a serial line, or a serial line behind TCP."""

    remarks: tuple[str, ...] = ()
    writes_at_once = 1  # another value may be newer by the time that the first is confirmed

    def __init__(
        self, config: ModbusSource, readings: Sequence[ModbusTag], writings: Sequence[ModbusTag], clock: Clock
    ) -> None:
        self._spans = [checked(config, tag) for tag in readings]
        places = [checked(config, tag) for tag in writings]
        self._addresses = [Address(place.table, place.start) for place in places]
        self._config, self._readings, self._writings, self._clock = config, readings, writings, clock
        self._framing = framing_of(config)
        self._poll: PollState | None = None
        self._client: Client | None = None
        self._single_writes = True  # until the device refuses function 6
        self._burst: BurstState | None = None
        self._burst_of: list[Question] = []
        self._in_flight = 1

    @property
    def problems(self) -> tuple[str, ...]:
        """The readings that the device refuses, with its own exception."""
        refused = {} if self._poll is None else self._poll.refused
        return tuple(
            f"{tag}: the device answers {refused[span]}"
            for span, tag in zip(self._spans, self._readings, strict=True)
            if span in refused
        )

    async def open(self) -> None:
        """Connect and read everything once, which shows that the device answers and finds what it does not know.

        Raises LinkError when the device cannot be reached or does not answer as Modbus asks.
        """
        await self._open()
        wanted = seen.allowed(self._device, self._config.in_flight)
        if wanted > 1 and self._poll is not None and self._poll.live:
            try:
                await self._probe(self._poll.live, wanted)
                self._in_flight = wanted
            except LinkError as error:
                await self.close()
                await self._open()  # it does answer when it is asked one thing at a time
                seen.lower(self._device, str(error))

    async def read(self, into: Image) -> None:
        """Fill `into`, one entry for each reading, from the device. Raises LinkError."""
        await self._read(into, _SEARCH_SHARE * self._config.timeout_ms / 1000.0)

    async def write(self, positions: Positions, values: NDArray[np.float64]) -> NDArray[np.uint32]:
        """Write engineering values to these writings; returns the raw StatusCode of each. Raises LinkError.

        Every value is written in one request, so that the device never sees half of it. BadNotWritable for a
        read-only table, BadOutOfRange for what the data type cannot hold.
        """
        pairs = zip(positions.tolist(), values.tolist(), strict=True)
        return np.array([await self._write(position, value) for position, value in pairs], np.uint32)

    async def close(self) -> None:
        """Let go of the connection, at once and without raising."""
        if self._client is not None:
            await self._client.close()

    @property
    def _device(self) -> str:
        return f"{self._connected().name}, unit {self._config.unit_id}"

    async def _open(self) -> None:
        self._client = await connect(self._config, self._framing, self._clock)
        try:
            self._poll = self._plan()  # not before: attempts to reach a device that is away are cheap
            await self._read(Image(len(self._readings)), _SEARCH_SHARE * self._config.connect_timeout_ms / 1000.0)
        except BaseException:
            await self._client.close()
            raise

    async def _probe(self, live: Sequence[Question], in_flight: int) -> None:
        """Ask so many things at once, of different lengths as far as may be, so that no reply passes for another.

        Raises LinkError when the device loses one or mixes them up.
        """
        widest = max((question.request for question in live), key=lambda request: request.count)
        parts = [Request(widest.table, widest.start, 1 + n % widest.count, ()) for n in range(in_flight)]
        await self._connected().read(BurstState(parts, self._config.unit_id), in_flight)

    def _plan(self) -> PollState:
        order = self._config.byte_order
        values = [
            Value(span, Field(0, tag.data_type, tag.byte_order or order, tag.scale, tag.offset))
            for span, tag in zip(self._spans, self._readings, strict=True)
        ]
        return PollState(values, Limits(self._config.max_registers, self._config.max_bits, self._config.max_gap))

    async def _read(self, into: Image, search: float) -> None:
        """One read; after what the device does not know is searched for at most `search` seconds, at least once."""
        if self._poll is None:
            raise LinkError(f"source {self._config.name} is not open")
        until = self._clock.monotonic() + search
        polled = self._poll.start()
        asked = isinstance(self._framing, TcpFraming) and 0 < len(self._poll.live) <= _MOST_IN_A_BURST
        if asked:
            burst = await self._read_live(self._poll.live)
            if not burst.refused and self._poll.settled:
                self._poll.fill(burst.wire, burst.arrivals, burst.timestamps, into)
                return
            _take(burst, self._poll.live, polled)
        for question in polled.due(lambda: self._clock.monotonic() < until, live=not asked):
            polled.take(await self._ask(question))
        self._poll.finish(polled, into)

    async def _read_live(self, live: list[Question]) -> BurstState:
        """All live questions answered, by frames made when they were first asked."""
        burst = self._burst
        if burst is None or self._burst_of != live:
            burst = self._burst = BurstState([question.request for question in live], self._config.unit_id)
            self._burst_of = live
        client = self._connected()
        try:
            await client.read(burst, self._in_flight)
        except MixedUpError as error:
            if self._in_flight > 1:
                seen.lower(self._device, str(error))
            raise
        return burst

    async def _ask(self, question: Question) -> Answer:
        reply = await self._exchange(question.pdu, read_reply, question.request)
        return Answer(question, reply, self._connected().heard, self._clock.utc_ns())

    async def _write(self, position: int, value: float) -> int:
        tag, address = self._writings[position], self._addresses[position]
        if not address.table.writable:
            return int(StatusCode.BAD_NOT_WRITABLE)
        order = tag.byte_order or self._config.byte_order
        registers = encode(value, tag.data_type, order, tag.scale, tag.offset)
        if registers is None:
            return int(StatusCode.BAD_OUT_OF_RANGE)
        request = write_request(address, registers, multiple=not self._single_writes)
        status = await self._exchange(request, write_reply, address)
        if status == StatusCode.BAD_NOT_SUPPORTED and request[0] == WRITE_REGISTER:
            self._single_writes = False  # some devices write with function 16 only
            request = write_request(address, registers, multiple=True)
            status = await self._exchange(request, write_reply, address)
        return status

    async def _exchange(self, request: bytes, check: Callable[[bytes, bytes], T], place: Request | Address) -> T:
        """What `check` makes of the reply; a reply that it does not accept is the connection's end."""
        client = self._connected()
        reply = await client.request(request)
        try:
            return check(request, reply)
        except ProtocolError as error:
            await client.close()
            raise LinkError(f"{client.name}: {place}: {error}") from error

    def _connected(self) -> Client:
        if self._client is None:
            raise LinkError(f"source {self._config.name} is not open")
        return self._client


def _take(burst: BurstState, live: Sequence[Question], polled: Round) -> None:
    """Hand over the replies of a burst one by one."""
    for number, question in enumerate(live):
        arrival, timestamp = float(burst.arrivals[number]), int(burst.timestamps[number])
        polled.take(Answer(question, burst.reply(number), arrival, timestamp))


def checked(config: ModbusSource, tag: ModbusTag) -> Span:
    """What a tag occupies in the device. Raises ConfigError when it cannot be read or written as configured."""
    try:
        span = _span(tag.address, tag.data_type)
    except ValueError as error:
        raise ConfigError(f"source {config.name}: {error}") from error
    if tag.scale == 0.0:
        raise ConfigError(f"source {config.name}: {tag}: found scale 0, expected any other number")
    if span.length > config.max_registers:
        raise ConfigError(
            f"source {config.name}: {tag}: found max_registers {config.max_registers}, but a value of {span.length} "
            f"registers must not be split; expected {span.length} or more"
        )
    return span


@lru_cache(maxsize=65536)  # the same tags again with every connection
def _span(address: int | str, data_type: ModbusType) -> Span:
    place, registers = parse_address(address), REGISTERS[data_type]
    if place.table.bits and data_type != "bool":
        raise ValueError(f"{place} is a single bit, found {data_type}, expected bool")
    if place.offset + registers > LAST_OFFSET + 1:
        last = Address(place.table, LAST_OFFSET)
        raise ValueError(
            f"{place}: {data_type} takes {registers} registers, but {last} is the last; expected a lower one"
        )
    return Span(place.table, place.offset, registers)
