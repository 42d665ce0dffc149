"""A client that says what was recorded: a session for a few milliseconds, and whatever bytes after it."""

import asyncio
import contextlib
from typing import Any

from asyncua import ua
from asyncua.common.utils import Buffer
from asyncua.ua.ua_binary import struct_from_binary

from tests.fuzz.opcua_messages import Channel, Message, corpus, frame

_MESSAGES = corpus()
_FIRST = {message.service: message for message in reversed(_MESSAGES)}
_ANONYMOUS = next(
    message for message in _MESSAGES if message.service == "ActivateSessionRequest" and b"anonymous" in message.body
)


class RecordedClient:
    """One connection. Every wait ends after `timeout` seconds with TimeoutError."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, timeout: float) -> None:
        self.reader, self.writer, self.timeout = reader, writer, timeout
        self.channel = Channel()

    @classmethod
    async def connect(cls, port: int, timeout: float = 20.0) -> "RecordedClient":
        """A TCP connection, nothing said yet."""
        async with asyncio.timeout(timeout):
            return cls(*await asyncio.open_connection("127.0.0.1", port), timeout)

    async def open_channel(self, spoil: Any = bytes) -> None:
        """Hello and OpenSecureChannel; `spoil` is applied to both frames."""
        self.writer.write(spoil(frame(b"HEL", _FIRST["Hello"].body)))
        await self.answer(b"ACK")
        self.writer.write(spoil(frame(b"OPN", self.channel.opening(_FIRST["OpenSecureChannel"].body))))
        self.channel.opened(await self.answer(b"OPN"))

    async def log_in(self, *, anonymous: bool = False) -> None:
        """Create and activate a session. Raises PermissionError when it is refused."""
        await self.ask(_FIRST["CreateSessionRequest"], ua.CreateSessionResponse)
        activate = _ANONYMOUS if anonymous else _FIRST["ActivateSessionRequest"]
        await self.ask(activate, ua.ActivateSessionResponse)

    async def subscribe(self) -> None:
        """A subscription with what was monitored when it was recorded."""
        await self.ask(_FIRST["CreateSubscriptionRequest"], ua.CreateSubscriptionResponse)
        await self.ask(_FIRST["CreateMonitoredItemsRequest"], ua.CreateMonitoredItemsResponse)

    async def log_out(self) -> None:
        """CloseSession."""
        await self.ask(_FIRST["CloseSessionRequest"], ua.CloseSessionResponse)

    async def ask(self, message: Message, kind: Any) -> Any:
        """Send a recorded request and wait for an answer of this kind; notes session and subscription."""
        self.writer.write(self.channel.message(self.channel.fill(message.body)))
        content = await self.answer(b"MSG")
        found = struct_from_binary(kind, Buffer(content[16:]))
        if found.ResponseHeader.ServiceResult.value & 0x80000000:
            raise PermissionError(found.ResponseHeader.ServiceResult.name)
        if kind is ua.CreateSessionResponse:
            self.channel.session = found.Parameters.AuthenticationToken.Identifier
        if kind is ua.CreateSubscriptionResponse:
            self.channel.subscription = found.Parameters.SubscriptionId.to_bytes(4, "little")
        return found

    async def answer(self, kind: bytes) -> bytes:
        """The content of the server's next frame. Raises ConnectionError when it is of another kind."""
        async with asyncio.timeout(self.timeout):
            head = await self.reader.readexactly(8)
            content = await self.reader.readexactly(int.from_bytes(head[4:], "little") - 8)
        if head[:3] != kind:
            raise ConnectionError(f"{head[:3]!r} for {kind!r}")
        return content

    def drop(self) -> None:
        """Cut the line."""
        with contextlib.suppress(OSError):
            self.writer.transport.abort()
