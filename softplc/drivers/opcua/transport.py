"""The library's client with bounds: frames, times, its end, its log. All that rests on asyncua 2.1.0's private names.

- A frame that the server announces larger than agreed ends the connection before it is buffered.
- The library's gate and tasks for its own reconnecting are left out.
- `farewell` sends CloseSession in the very call; a task of at most FAREWELL seconds waits for the answer and drops
  the socket, whatever the server does.
"""

import asyncio
import logging
from collections.abc import Callable
from typing import Any, Final

from asyncua import Client, ua
from asyncua.client.ua_client import UaClient, UASocketProtocol, UASocketState
from asyncua.ua.ua_binary import nodeid_from_binary, struct_from_binary

from softplc.drivers.opcua.fast.seam import MORE, proven, take_answer

MAX_MESSAGE: Final = 16 * 2**20
"""The largest message that is taken, bytes."""
FAREWELL: Final = 1.0
_SMALLEST_CHUNK: Final = 8192  # what every peer has to take (OPC 10000-6, 6.7.1)

_RESPONSE: Final = 3  # from the id of a request's encoding to that of its response's (OPC 10000-6, A.3)

_leaving: set[asyncio.Task[None]] = set()  # held here because the event loop holds its tasks weakly


class Transport(UaClient):  # type: ignore[misc]  # asyncua is untyped
    """Socket and secure channel, with our protocol and without the gate for reconnecting."""

    def set_timeout(self, seconds: float) -> None:
        """Timeout of every request from here on."""
        self._timeout = seconds
        if self.protocol is not None:
            self.protocol.timeout = seconds

    async def greet(self, url: str) -> None:
        """Hello and Acknowledge; keeps what each side takes, which the library confuses and does not bound."""
        acknowledge = await self.send_hello(url, MAX_MESSAGE, 0)
        limits = self.protocol._connection._limits
        limits.max_recv_buffer = min(int(acknowledge.SendBufferSize) or MAX_MESSAGE, MAX_MESSAGE)
        limits.max_send_buffer = int(acknowledge.ReceiveBufferSize) or _SMALLEST_CHUNK
        limits.max_message_size = MAX_MESSAGE
        limits.max_chunk_count = MAX_MESSAGE // _SMALLEST_CHUNK

    async def request(self, request: Any, response_type: Any) -> Any:
        """One request for which the library has no plain call. Raises what the library raises."""
        data = await self._send_request(request)
        response = struct_from_binary(response_type, data)
        response.ResponseHeader.ServiceResult.check()
        return response

    def farewell(self, left_behind: Callable[[], None]) -> None:
        """Let go of session and socket, at once; `left_behind` is called when the session could not be closed."""
        protocol = self.protocol
        if protocol is None or protocol.transport is None:
            left_behind()
            return
        answer = self._close_session(protocol)
        if answer is None:
            protocol.transport.abort()
            left_behind()
            return
        leaving = _leave(protocol.transport, answer, left_behind)
        task = asyncio.get_running_loop().create_task(leaving, name="opcua farewell")
        _leaving.add(task)
        task.add_done_callback(_leaving.discard)

    async def _send_request(
        self, request: Any, timeout: float | None = None, message_type: ua.MessageType = ua.MessageType.SecureMessage
    ) -> Any:
        """The body of the answer, if it is the one to this request: the library would decode any as that."""
        body = await super()._send_request(request, timeout, message_type)
        found, due = nodeid_from_binary(body.copy()), request.TypeId.Identifier + _RESPONSE
        if (found.NamespaceIndex, found.Identifier) != (0, due):
            raise ua.UaError(f"was answered with {found.to_string()}; expected i={due}")
        return body

    def _close_session(self, protocol: UASocketProtocol) -> "asyncio.Future[Any] | None":
        """Send CloseSession; the future is its answer. None when there is no session, or no way to say it."""
        if protocol.state is not UASocketState.OPEN or self.session.authentication_token.is_null():
            return None
        try:
            answer: asyncio.Future[Any] = protocol._send_request(ua.CloseSessionRequest(DeleteSubscriptions=True))
        except (OSError, ValueError, RuntimeError, ua.UaError):  # the channel is beyond sending
            return None
        return answer

    def _make_protocol(self) -> UASocketProtocol:
        self.protocol = _BoundedProtocol(self._timeout, security_policy=self.security_policy)
        return self.protocol


class _BoundedProtocol(UASocketProtocol):  # type: ignore[misc]
    """Refuses a frame whose header announces more than was agreed."""

    receive_buffer: bytes | None

    def data_received(self, data: bytes) -> None:
        if self.receive_buffer:
            data, self.receive_buffer = self.receive_buffer + data, None
        while proven():
            taken = take_answer(self, data)
            if taken == MORE:
                self.receive_buffer = data
                return
            if not taken:
                break
            if taken == len(data):
                return
            data = data[taken:]
        super().data_received(data)
        begun = self.receive_buffer
        largest = max(self._connection._limits.max_recv_buffer, _SMALLEST_CHUNK)
        if (
            begun
            and len(begun) >= 8
            and int.from_bytes(begun[4:8], "little") > largest
            and self.transport is not None
        ):
            self.receive_buffer = None
            self.transport.abort()


def make_client(url: str, timeout: float) -> Client:
    """The library's client for sessions and security, on our transport and with its log turned off."""
    for name in ("asyncua.client", "asyncua.uaprotocol", "asyncua.crypto.uacrypto"):
        logger = logging.getLogger(name)
        if logger.level == logging.NOTSET:  # a level that somebody set on purpose stays
            logger.setLevel(logging.CRITICAL + 1)  # all of it is raised as LinkError
    client = Client(url, timeout=timeout)
    client.uaclient = Transport(timeout)
    return client


async def _leave(
    transport: asyncio.Transport, answer: "asyncio.Future[Any]", left_behind: Callable[[], None]
) -> None:
    try:
        await asyncio.wait({answer}, timeout=FAREWELL)
    finally:
        if answer.cancel() or answer.cancelled() or answer.exception() is not None:
            left_behind()
        transport.abort()
