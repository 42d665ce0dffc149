"""The Modbus driver: polls its readings with as few requests as the device allows, and writes its writings.

Each read asks for everything once, one request after the other. An exception response is the status of the tags of
that request (`pdu.py`); any reply that does not fit its request, and silence, end the connection with a LinkError.
Modbus carries no timestamps: the source timestamp of a sample is the wall time at which its reply arrived.
"""

from collections.abc import Mapping, Sequence
from typing import Final

from softplc.clock import Clock
from softplc.drivers.modbus.client import Client, connect, framing_of
from softplc.drivers.modbus.codec import REGISTERS, Field, encode
from softplc.drivers.modbus.config import ModbusSource, ModbusTag
from softplc.drivers.modbus.pdu import (
    ILLEGAL_FUNCTION,
    WRITE_REGISTER,
    ProtocolError,
    Refused,
    read_reply,
    write_reply,
    write_request,
)
from softplc.drivers.modbus.plan import Limits, Span
from softplc.drivers.modbus.polling import Answer, PollState, Question, Value
from softplc.errors import ConfigError, LinkError
from softplc.sample import StatusCode
from softplc.tags import Image

_SEARCH_SHARE: Final = 0.25  # of a read's time limit, for finding which addresses a device does not know


class ModbusDriver:
    """One connection to one unit of a Modbus device, over TCP, a serial line, or a serial line behind TCP."""

    def __init__(
        self, config: ModbusSource, readings: Sequence[ModbusTag], writings: Sequence[ModbusTag], clock: Clock
    ) -> None:
        longest = max((REGISTERS[tag.data_type] for tag in readings), default=1)
        if longest > config.max_registers:
            raise ConfigError(
                f"source {config.name}: max_registers is {config.max_registers}, but there is a value of {longest} "
                f"registers, which must not be split; expected max_registers of {longest} or more"
            )
        self._config, self._readings, self._writings, self._clock = config, readings, writings, clock
        self._framing = framing_of(config)
        self._poll: PollState | None = None
        self._client: Client | None = None
        self._single_writes = True  # until the device refuses function 6

    async def open(self) -> None:
        """Connect and read everything once, which shows that the device answers and finds what it does not know.

        Raises LinkError when the device cannot be reached or does not answer as Modbus asks.
        """
        self._client = await connect(self._config, self._framing, self._clock)
        try:
            self._poll = _poll(self._config, self._readings)  # not before: while a device is away, attempts are cheap
            await self._read(Image(len(self._readings)), _SEARCH_SHARE * self._config.connect_timeout_ms / 1000.0)
        except BaseException:
            await self._client.close()
            raise

    async def read(self, into: Image) -> None:
        """Fill `into`, one entry for each reading, from the device. Raises LinkError."""
        await self._read(into, _SEARCH_SHARE * self._config.timeout_ms / 1000.0)

    async def write(self, values: Mapping[int, float]) -> dict[int, int]:
        """Write engineering values to the writings by position; returns the raw StatusCode of each. Raises LinkError.

        Every value is written in one request, so that the device never sees half of it. BadNotWritable for a
        read-only table, BadOutOfRange for what the data type cannot hold.
        """
        return {position: await self._write(self._writings[position], value) for position, value in values.items()}

    async def close(self) -> None:
        """Let go of the connection, at once and without raising."""
        if self._client is not None:
            await self._client.close()

    async def _read(self, into: Image, search: float) -> None:
        """One read; after what the device does not know is searched for at most `search` seconds, at least once."""
        if self._poll is None:
            raise LinkError(f"source {self._config.name} is not open")
        until = self._clock.monotonic() + search
        polled = self._poll.start()
        for question in polled.due(lambda: self._clock.monotonic() < until):
            polled.take(await self._ask(question))
        self._poll.finish(polled, into)

    async def _ask(self, question: Question) -> Answer:
        client = self._connected()
        pdu = await client.request(question.pdu)
        try:
            reply = read_reply(question.pdu, pdu)
        except ProtocolError as error:
            raise LinkError(f"{client.name}: {question.request}: {error}") from error
        return Answer(question, reply, client.heard, self._clock.utc_ns())

    async def _write(self, tag: ModbusTag, value: float) -> int:
        address = tag.location
        if not address.table.writable:
            return int(StatusCode.BAD_NOT_WRITABLE)
        order = tag.byte_order or self._config.byte_order
        registers = encode(value, tag.data_type, order, tag.scale, tag.offset)
        if registers is None:
            return int(StatusCode.BAD_OUT_OF_RANGE)
        client = self._connected()
        request = write_request(address, registers, multiple=not self._single_writes)
        try:
            status = write_reply(request, await client.request(request))
            if status == Refused(ILLEGAL_FUNCTION).status and request[0] == WRITE_REGISTER:
                self._single_writes = False  # some devices write with function 16 only
                request = write_request(address, registers, multiple=True)
                status = write_reply(request, await client.request(request))
        except ProtocolError as error:
            raise LinkError(f"{client.name}: {address}: {error}") from error
        return status

    def _connected(self) -> Client:
        if self._client is None:
            raise LinkError(f"source {self._config.name} is not open")
        return self._client


def _poll(config: ModbusSource, tags: Sequence[ModbusTag]) -> PollState:
    return PollState(
        [_value(config, tag) for tag in tags], Limits(config.max_registers, config.max_bits, config.max_gap)
    )


def _value(config: ModbusSource, tag: ModbusTag) -> Value:
    address = tag.location
    span = Span(address.table, address.offset, 1 if address.table.bits else REGISTERS[tag.data_type])
    return Value(span, Field(0, tag.data_type, tag.byte_order or config.byte_order, tag.scale, tag.offset))
