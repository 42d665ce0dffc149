"""Services: which there are, and what one connection may ask of them."""

from typing import Any, Final

from asyncua import ua
from asyncua.common.connection import TransportLimits
from asyncua.common.utils import NotEnoughData, ServiceError
from asyncua.server.internal_session import SessionState
from asyncua.server.uaprocessor import UaProcessor
from asyncua.ua.ua_binary import struct_to_binary
from cryptography.exceptions import InvalidSignature

from softplc.publishers.opcua.hardened.decoding import decoded
from softplc.publishers.opcua.hardened.limits import Limits
from softplc.publishers.opcua.hardened.outstanding import publish
from softplc.publishers.opcua.hardened.secured import Secured


def _requests(*names: str) -> frozenset[Any]:
    ids = (getattr(ua.ObjectIds, f"{name}Request_Encoding_DefaultBinary") for name in names)
    return frozenset(ua.NodeId(request) for request in ids)


_CREATE_SESSION: Final = _requests("CreateSession")
_ACTIVATE_SESSION: Final = _requests("ActivateSession")
_BROWSE_NEXT: Final = _requests("BrowseNext")
_PUBLISH: Final = _requests("Publish")
_DISCOVERY: Final = _requests("FindServers", "GetEndpoints", "CloseSecureChannel")
_WITHOUT_SESSION: Final = _DISCOVERY | _CREATE_SESSION
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
    a session that could not be activated stays with the connection; any channel takes over a session; answers pile
    up for who does not read, and are of any size.
    """

    def __init__(self, server: Any, transport: Any, transport_limits: TransportLimits, limits: Limits) -> None:
        super().__init__(server, transport, transport_limits)
        self.session: Any = None
        self._own_limits = limits
        self._connection: Any = Secured(self._limits, server.trust, str((self.name or ("",))[0]))

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
        bar = self._connection.bar
        if bar != ua.StatusCodes.Good and typeid not in _DISCOVERY:
            raise ServiceError(bar)
        if self.session is not None and self.session.state is SessionState.Closed:
            self.session = None
        before = self.session
        if typeid in _CREATE_SESSION:
            self._connection.check_session(decoded(ua.CreateSessionParameters, body.copy()))
        await self._admit(typeid, requesthdr.AuthenticationToken)
        try:
            return await self._serve(typeid, requesthdr, seqhdr, body)
        except BaseException as error:
            if typeid in _ACTIVATE_SESSION:
                self.session = before
            if isinstance(error, NotEnoughData):  # CloseSession without its parameter
                raise ServiceError(ua.StatusCodes.BadDecodingError) from error
            if isinstance(error, InvalidSignature) and typeid in _ACTIVATE_SESSION:
                raise ServiceError(ua.StatusCodes.BadApplicationSignatureInvalid) from error
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
                session = self.session or self.iserver.lookup_external_session(token)
                if session is not None and session.channel != self._connection.identity:
                    raise ServiceError(ua.StatusCodes.BadSecurityChecksFailed)
                await self.iserver.make_room_for(token)

    def _adopt(self, session: Any) -> None:
        """A session that was made or activated here is no longer that of the connection it came from."""
        session.channel = self._connection.identity
        if session.processor is not None:
            session.processor.session = None
        session.processor, session.address = self, str(self.name[0])

    async def _make_room(self) -> None:
        if self.session is not None:
            raise ServiceError(ua.StatusCodes.BadTooManySessions)
        if self._session_watchdog_task is not None:
            self._session_watchdog_task.cancel()
        await self.iserver.make_room(self.name[0])
