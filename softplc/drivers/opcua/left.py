"""Sessions that lost their connection before they could be closed, and how they are closed over the next one.

A server keeps a session whose connection broke until its timeout, often for half a minute, and has few: ten by
default at some. A link that is reset every few seconds would soon find the server full of its own dead sessions. So
what it takes to take a session up again (OPC 10000-4, 5.7.3: ActivateSession over another channel) is kept here,
and the next connection closes it, subscriptions included, before it creates its own.
"""

import contextlib
from collections import defaultdict, deque
from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any, Final

from asyncua import Client, ua

MOST: Final = 8
"""Sessions that are remembered for one server and user; the oldest are forgotten first."""


@dataclass(frozen=True, slots=True)
class LeftSession:
    """What ActivateSession needs of an earlier session; `expires` on the monotonic clock."""

    token: Any
    nonce: bytes | None
    policies: Any
    peer_certificate: bytes | None
    expires: float


def session_of(client: Client, now: float) -> LeftSession | None:
    """The session that this client has, None when it has none."""
    token = client.uaclient.session.authentication_token
    if token.is_null():
        return None
    peer, expires = client.security_policy.peer_certificate, now + client.session_timeout / 1000.0
    return LeftSession(token, client._server_nonce, client._policy_ids, peer, expires)


class LeftSessionsState:
    """The sessions left behind, by server and user; shared by all connections of this process."""

    def __init__(self) -> None:
        self._left: dict[Hashable, deque[LeftSession]] = defaultdict(lambda: deque(maxlen=MOST))

    def add(self, key: Hashable, session: LeftSession | None) -> None:
        """Remember a session to be closed."""
        if session is not None:
            self._left[key].append(session)

    def count(self, key: Hashable) -> int:
        """How many are remembered."""
        return len(self._left.get(key, ()))

    async def close_all(self, key: Hashable, client: Client, now: float, **login: str | None) -> None:
        """Close them over this client's fresh channel, which has no session yet.

        What the server says to it does not matter: a session that it does not know is gone as well. Raises what the
        library raises when the server does not answer.
        """
        left = self._left.get(key)
        while left:
            session = left[0]
            if session.expires > now:
                await _close(client, session, login)
            if left and left[0] is session:
                left.popleft()
        self._left.pop(key, None)


async def _close(client: Client, left: LeftSession, login: dict[str, str | None]) -> None:
    transport, policy = client.uaclient, client.security_policy
    before = policy.peer_certificate
    client._server_nonce, client._policy_ids = left.nonce, left.policies
    policy.peer_certificate = before or left.peer_certificate
    transport.session.restore_authentication_token(left.token)
    try:
        with contextlib.suppress(ua.UaStatusCodeError):
            await client.activate_session(**login)
            await transport.close_session(True)
    finally:
        policy.peer_certificate = before
        client._server_nonce = None
        transport.session.reset_authentication_token()


LEFT_SESSIONS: Final = LeftSessionsState()
