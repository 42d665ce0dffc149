"""asyncua's inner server: what all sessions share."""

import sys
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.server.internal_server import InternalServer
from asyncua.server.user_managers import UserManager

from softplc.publishers.opcua.access import Access
from softplc.publishers.opcua.fast.items import SweptItems
from softplc.publishers.opcua.fast.reads import Reads
from softplc.publishers.opcua.fast.sweep import Sweep
from softplc.publishers.opcua.hardened.items import MonitoredItems
from softplc.publishers.opcua.hardened.limits import Limits
from softplc.publishers.opcua.hardened.places import (
    anonymous_session_that_gives_way,
    session_that_gives_way,
)
from softplc.publishers.opcua.hardened.secured import open_password
from softplc.publishers.opcua.hardened.session import Session
from softplc.publishers.opcua.hardened.subscriptions import Subscriptions
from softplc.publishers.opcua.hardened.trust import Trust
from softplc.publishers.opcua.hardened.view import ReferenceTypes
from softplc.publishers.opcua.values import Watch

_ANONYMOUS = User(UserRole.Anonymous)


class ClosedServer(InternalServer):  # type: ignore[misc]  # asyncua is untyped here
    """asyncua's inner server with softplc's sessions, subscriptions and rules.

    asyncua: user `admin` with any password is an administrator; sessions are counted for the whole process.
    """

    access: Access
    trust: Trust | None = None  # None: there is only SecurityPolicy None
    watch: Watch
    reads: Reads | None = None  # None: every Read takes the ordinary way
    sweep: Sweep | None = None  # None: so does every monitored item

    def __init__(self, users: UserManager, limits: Limits) -> None:
        super().__init__(user_manager=users)
        self.limits = limits
        self.allow_remote_admin = False
        self.disabled_clock = True  # server time comes from softplc's clock with every publish
        self.supported_tokens = (ua.AnonymousIdentityToken, ua.UserNameIdentityToken)
        self.max_connections = sys.maxsize  # counted by Protocol
        self.max_pending_messages_per_connection = 0  # bounded by not reading on, see Protocol
        self.max_pending_activation_seconds = limits.activation_seconds
        self.max_subscriptions = sys.maxsize  # counted by Session
        self.max_unacked_messages_per_subscription = limits.unacknowledged
        self.max_monitored_item_queue_size = limits.queue_size
        self.reference_types = ReferenceTypes(self.aspace)
        self.subscription_service = Subscriptions(self.aspace, self)
        self.isession.subscription_service = self.subscription_service

    def create_session(self, name: Any, user: Any = _ANONYMOUS, external: bool = True) -> Session:
        """A session for a connection; `make_room` was asked before."""
        return Session(self, name, user)

    def decrypt_user_token(self, isession: Any, token: Any) -> tuple[Any, str]:
        """User name and password. Raises ValueError, and what cryptography raises."""
        return token.UserName, open_password(token, self.private_key, isession.nonce, isession.channel)

    def monitored_items(self, sub: Any) -> MonitoredItems:
        """The monitored items of a new subscription."""
        if self.sweep is None:
            return MonitoredItems(sub, self.aspace, self.watch)
        return SweptItems(sub, self.aspace, self.watch, self.sweep)

    async def make_room(self, address: str) -> None:
        """Room for one more session from this address. Raises ServiceError BadTooManySessions."""
        room, weakest = session_that_gives_way(self._external_sessions.values(), address, self.limits)
        if not room:
            raise ServiceError(ua.StatusCodes.BadTooManySessions)
        if weakest is not None:
            await weakest.close_session()

    async def make_room_for(self, token: Any) -> None:
        """If there is no place without a log-in for this token's session, one whose connection was lost gives way."""
        session = self._external_sessions.get(token)
        if session is not None:
            _, weakest = anonymous_session_that_gives_way(self._external_sessions.values(), session, self.limits)
            if weakest is not None:
                await weakest.close_session()

    def is_crowded_for(self, session: Session) -> bool:
        """There is no place for this session without a log-in."""
        room, weakest = anonymous_session_that_gives_way(self._external_sessions.values(), session, self.limits)
        return not room or weakest is not None

    async def stop(self) -> None:
        """Close what clients left open, then the rest."""
        for session in list(self._external_sessions.values()):
            await session.close_session()
        await super().stop()
