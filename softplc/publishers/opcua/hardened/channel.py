"""Sockets, frames and services: what reaches asyncua's server at all."""

import asyncio
import contextlib
import os
import socket
from typing import Any, Final

from asyncua import ua
from asyncua.common.connection import TransportLimits
from asyncua.common.utils import Buffer, NotEnoughData, ServiceError
from asyncua.server.binary_server_asyncio import BinaryServer, OPCUAProtocol
from asyncua.server.internal_session import SessionState
from asyncua.server.uaprocessor import UaProcessor
from asyncua.ua.ua_binary import header_from_binary, struct_to_binary, uatcp_to_binary

from softplc.publishers.opcua.hardened.answers import ClientLimits
from softplc.publishers.opcua.hardened.decoding import decoded
from softplc.publishers.opcua.hardened.frames import HEADER_BYTES, frame_size, hello_fault
from softplc.publishers.opcua.hardened.limits import Limits
from softplc.publishers.opcua.hardened.outstanding import publish
from softplc.publishers.opcua.hardened.places import Stage, give_way

_WAITING: Final = 100  # connections that the system holds until they are accepted
_DRAIN_SECONDS: Final = 0.2  # time to send what is buffered when the server closes


def _requests(*names: str) -> frozenset[Any]:
    ids = (getattr(ua.ObjectIds, f"{name}Request_Encoding_DefaultBinary") for name in names)
    return frozenset(ua.NodeId(request) for request in ids)


_CREATE_SESSION: Final = _requests("CreateSession")
_ACTIVATE_SESSION: Final = _requests("ActivateSession")
_BROWSE_NEXT: Final = _requests("BrowseNext")
_PUBLISH: Final = _requests("Publish")
_WITHOUT_SESSION: Final = _requests("FindServers", "GetEndpoints", "CreateSession", "CloseSecureChannel")
# All others answer BadServiceUnsupported: RegisterServer, AddNodes, DeleteNodes, the references, HistoryUpdate, …
_SERVICES: Final = _WITHOUT_SESSION | _requests(
    "ActivateSession", "CloseSession", "Read", "Write", "Browse", "BrowseNext", "TranslateBrowsePathsToNodeIds",
    "RegisterNodes", "UnregisterNodes", "Call", "HistoryRead",
    "CreateSubscription", "ModifySubscription", "DeleteSubscriptions", "TransferSubscriptions", "SetPublishingMode",
    "Publish", "Republish",
    "CreateMonitoredItems", "ModifyMonitoredItems", "DeleteMonitoredItems", "SetMonitoringMode",
)  # fmt: skip


class Processor(UaProcessor):  # type: ignore[misc]  # asyncua is untyped here
    """One connection's services.

    asyncua: services of administration for everyone, RegisterServer even without a session; messages before a
    channel is open; any number of CreateSession on one connection; requests of one session with another's token;
    a session that could not be activated stays with the connection; answers pile up for who does not read, and are of
    any size.
    """

    def __init__(self, server: Any, transport: Any, transport_limits: TransportLimits, limits: Limits) -> None:
        super().__init__(server, transport, transport_limits)
        self.session: Any = None
        self._own_limits = limits

    def send_response(
        self, requesthandle: int, seqhdr: Any, response: Any, msgtype: Any = ua.MessageType.SecureMessage
    ) -> None:
        """Answer, unless the client left too much unread: then the connection ends."""
        response.ResponseHeader.RequestHandle = requesthandle
        self._send(requesthandle, seqhdr, struct_to_binary(response), msgtype)

    def room(self) -> int:
        """The most bytes that the client takes as one answer."""
        return int(self._limits.room(self._connection.security_policy.symmetric_cryptography))

    async def process_message(self, seqhdr: Any, body: Any) -> Any:
        """Serve a request; one that only reads tags is answered out of the arrays."""
        session, reads = self.session, self.iserver.reads
        if reads is not None and session is not None and session.is_activated() and self._connection.is_open():
            found = reads.answer(bytes(body), session.auth_token)
            if found is not None:
                session.touch()
                self.session_last_activity = session._last_activity
                self._send(found.handle, seqhdr, found.body)
                return True
        return await super().process_message(seqhdr, body)

    def _send(self, handle: int, seqhdr: Any, body: bytes, kind: Any = ua.MessageType.SecureMessage) -> None:
        if self._transport.get_write_buffer_size() > self._own_limits.unread_bytes:
            self._transport.abort()
            return
        if len(body) > self.room():
            fault = ua.ServiceFault()
            fault.ResponseHeader.RequestHandle = handle
            fault.ResponseHeader.ServiceResult = ua.StatusCode(ua.StatusCodes.BadResponseTooLarge)
            body = struct_to_binary(fault)
        self._transport.write(
            self._connection.message_to_binary(body, message_type=kind, request_id=seqhdr.RequestId)
        )

    async def close(self) -> None:
        """The connection is gone; its session may live on for a while, for a client that comes back."""
        if self.session is not None and self.session.processor is self:
            self.session.processor = None
        await super().close()

    async def _process_message(self, typeid: Any, requesthdr: Any, seqhdr: Any, body: Any) -> Any:
        if not self._connection.is_open():
            raise ServiceError(ua.StatusCodes.BadSecureChannelIdInvalid)
        if typeid not in _SERVICES:
            raise ServiceError(ua.StatusCodes.BadServiceUnsupported)
        if self.session is not None and self.session.state is SessionState.Closed:
            self.session = None
        before = self.session
        await self._admit(typeid, requesthdr.AuthenticationToken)
        try:
            return await self._serve(typeid, requesthdr, seqhdr, body)
        except BaseException as error:
            if typeid in _ACTIVATE_SESSION:
                self.session = before
            if isinstance(error, NotEnoughData):  # CloseSession without its parameter
                raise ServiceError(ua.StatusCodes.BadDecodingError) from error
            raise
        finally:
            if self.session is not None and self.session is not before:
                self._adopt(self.session)

    async def _serve(self, typeid: Any, requesthdr: Any, seqhdr: Any, body: Any) -> Any:
        """By asyncua, but for what it has not or does otherwise."""
        if typeid in _BROWSE_NEXT:
            return await self._browse_next(requesthdr, seqhdr, body)
        if typeid in _PUBLISH:
            return await publish(self, requesthdr, seqhdr, decoded(ua.PublishParameters, body))
        return await super()._process_message(typeid, requesthdr, seqhdr, body)

    async def _browse_next(self, requesthdr: Any, seqhdr: Any, body: Any) -> bool:
        """BrowseNext, which asyncua has not."""
        if not self.session.is_activated():
            raise ServiceError(ua.StatusCodes.BadSessionNotActivated)
        self.session.touch()
        response = ua.BrowseNextResponse()
        response.Parameters.Results = await self.session.browse_next(decoded(ua.BrowseNextParameters, body))
        self.send_response(requesthdr.RequestHandle, seqhdr, response)
        return True

    async def _admit(self, typeid: Any, token: Any) -> None:
        """Who asks may, and there is room for the session that he asks for. Raises ServiceError."""
        if typeid in _CREATE_SESSION:
            await self._make_room()
        elif typeid not in _WITHOUT_SESSION:
            if self.session is None and typeid not in _ACTIVATE_SESSION:
                raise ServiceError(ua.StatusCodes.BadSessionIdInvalid)
            if self.session is not None and token != self.session.auth_token:
                raise ServiceError(ua.StatusCodes.BadSessionIdInvalid)
            if typeid in _ACTIVATE_SESSION:
                await self.iserver.make_room_for(token)

    def _adopt(self, session: Any) -> None:
        """A session that was activated here is no longer that of the connection it came from."""
        if session.processor is not None:
            session.processor.session = None
        session.processor, session.address = self, str(self.name[0])

    async def _make_room(self) -> None:
        if self.session is not None:
            raise ServiceError(ua.StatusCodes.BadTooManySessions)
        if self._session_watchdog_task is not None:
            self._session_watchdog_task.cancel()
        await self.iserver.make_room(self.name[0])


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
        except Exception:  # whatever the frame broke, asyncua's state for this connection is not to be trusted
            self._end(ua.StatusCodes.BadTcpInternalError)
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
