"""Sockets and frames: what reaches asyncua's server at all."""

import asyncio
import contextlib
import os
import socket
from typing import Any, Final

from asyncua import ua
from asyncua.common.utils import Buffer
from asyncua.server.binary_server_asyncio import BinaryServer, OPCUAProtocol
from asyncua.ua.ua_binary import header_from_binary, uatcp_to_binary

from softplc.publishers.opcua.hardened.answers import ClientLimits
from softplc.publishers.opcua.hardened.frames import HEADER_BYTES, frame_size, hello_fault
from softplc.publishers.opcua.hardened.limits import Limits
from softplc.publishers.opcua.hardened.places import Stage, give_way
from softplc.publishers.opcua.hardened.secured import Refused
from softplc.publishers.opcua.hardened.services import Processor

_WAITING: Final = 100  # connections that the system holds until they are accepted
_DRAIN_SECONDS: Final = 0.2  # time to send what is buffered when the server closes


class Protocol(OPCUAProtocol):  # type: ignore[misc]  # asyncua is untyped here
    """One connection.

    asyncua: a frame is buffered whatever length its header declares, and copied with every packet; one address
    may take all connections; 500 requests of 64 kB wait for each; a frame that breaks the protocol is logged with
    a traceback and the connection goes on.
    """

    def __init__(self, own_limits: Limits, **options: Any) -> None:
        super().__init__(**options)
        self.closed: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._own_limits = own_limits
        self._received = bytearray()
        self._paused = False
        self._talking = False
        self.address = ""
        self.made = asyncio.get_running_loop().time()

    def connection_made(self, transport: Any) -> None:
        """Accept the connection if there is a place for it, or one that makes its place."""
        self.address = _address(transport)
        room, weakest = give_way(self.clients, self.address, self._own_limits, self.made)
        if weakest is not None:
            weakest.transport.abort()
        if not room:
            transport.abort()
            return
        super().connection_made(transport)
        if self.transport is not None:
            self.processor = Processor(self.iserver, self.transport, self.limits, self._own_limits)
            self.processor.set_policies(self.policies)

    def stage(self) -> Stage:
        """How far the client has come."""
        if self.processor.session is not None:
            return Stage.ACTIVE if self.processor.session.is_activated() else Stage.SESSION
        if self.processor._connection.is_open():
            return Stage.CHANNEL
        return Stage.TALKING if self._talking else Stage.SILENT

    def connection_lost(self, ex: BaseException | None) -> None:
        """Tell the server that waits for this in `stop`."""
        super().connection_lost(ex)
        if not self.closed.done():
            self.closed.set_result(None)
            if self.processor is not None:  # asyncua keeps what is closed for up to 10 s
                self.closing_tasks[-1].add_done_callback(self._forget)

    def data_received(self, data: bytes) -> None:
        """Cut frames out of the stream and queue them; the size is checked before anything is kept."""
        if self.transport is None or self.transport.is_closing():
            return
        self._talking = True
        received = self._received
        received += data
        while len(received) >= HEADER_BYTES:
            size = frame_size(received, self._own_limits.chunk_bytes)
            if size is None:
                self._end(ua.StatusCodes.BadTcpMessageTypeInvalid)
                return
            if len(received) < size:
                break
            cut = bytes(received[:size])
            del received[:size]
            fault = hello_fault(cut)
            if fault:
                self._end(fault)
                return
            frame = Buffer(cut)
            self.messages.put_nowait((header_from_binary(frame), frame))
        if self.messages.qsize() >= self._own_limits.waiting_requests and not self._paused:
            self._paused = True
            self.transport.pause_reading()

    async def _process_one_msg(self, header: Any, buf: Any) -> bool:
        try:
            going_on = await super()._process_one_msg(header, buf)
        except Refused as refused:
            self._end(refused.code)
            return False
        except Exception:  # whatever the frame broke, asyncua's state for this connection is not to be trusted
            secured = self.processor._connection.is_secured  # which step failed would tell of the keys
            self._end(ua.StatusCodes.BadSecurityChecksFailed if secured else ua.StatusCodes.BadTcpInternalError)
            return False
        if self._paused and not self.messages.qsize() and self.transport is not None:
            self._paused = False
            self.transport.resume_reading()
        return bool(going_on)

    def _forget(self, task: asyncio.Task[Any]) -> None:
        if task in self.closing_tasks:
            self.closing_tasks.remove(task)

    def _end(self, code: int) -> None:
        self._received.clear()
        if self.transport is not None and not self.transport.is_closing():
            message = ua.ErrorMessage(ua.StatusCode(code), "")
            self.transport.write(uatcp_to_binary(ua.MessageType.Error, message))
            self.transport.close()


class Listener(BinaryServer):  # type: ignore[misc]  # asyncua is untyped here
    """The listening socket.

    asyncua: binds and accepts at once, when its address space is long built; stops listening last, and waits for
    ever for a client that does not read.
    """

    def __init__(self, server: Any, host: str, port: int, limits: Limits) -> None:
        chunks = -(-limits.message_bytes // limits.chunk_bytes)
        transport = ClientLimits(limits.chunk_bytes, limits.chunk_bytes, chunks, limits.message_bytes)
        super().__init__(server, host, port, transport)
        self._own_limits = limits

    async def bind(self) -> None:
        """Take the port, without accepting anyone yet. Raises OSError."""
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(
            self._make_protocol, self.hostname, self.port, backlog=self._own_limits.backlog, start_serving=False
        )

    async def start(self) -> None:
        """Accept connections from now on. Raises OSError."""
        await self._server.start_serving()
        for listening in self._server.sockets:  # asyncio takes the number that it accepts at once for this as well
            with socket.socket(fileno=os.dup(listening.fileno())) as same:
                same.listen(_WAITING)
        self.cleanup_task = asyncio.create_task(self._close_task_loop())

    async def stop(self) -> None:
        """Stop listening, drop the clients and wait until they are gone."""
        if self._server is None:
            return
        self._server.close()
        clients = list(self.clients)
        for client in clients:
            client.transport.close()
        if clients:
            _, unread = await asyncio.wait([client.closed for client in clients], timeout=_DRAIN_SECONDS)
            for client in clients:
                client.transport.abort()
            if unread:
                await asyncio.wait(unread, timeout=_DRAIN_SECONDS)
        if self.cleanup_task is not None:
            self.cleanup_task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self.cleanup_task
        await self._close_tasks()

    def _make_protocol(self) -> Protocol:
        return Protocol(
            self._own_limits,
            iserver=self.iserver,
            policies=self._policies,
            clients=self.clients,
            closing_tasks=self.closing_tasks,
            limits=self.limits,
        )


def _address(transport: Any) -> str:
    peer = transport.get_extra_info("peername") if transport is not None else None
    return str(peer[0]) if peer else ""
