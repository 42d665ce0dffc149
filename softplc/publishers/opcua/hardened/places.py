"""Who gets a place when there are not enough: the one who has come further stays, users who log in have their own."""

import random
from collections.abc import Iterable
from enum import IntEnum
from typing import Any

from asyncua.server.internal_session import SessionState

from softplc.publishers.opcua.hardened.limits import Limits


class Stage(IntEnum):
    """How far a connection has come."""

    SILENT = 0
    TALKING = 1  # bytes came
    CHANNEL = 2
    SESSION = 3
    ACTIVE = 4  # with an activated session; such a connection never gives way


def give_way(connections: Iterable[Any], address: str, limits: Limits, now: float) -> tuple[bool, Any]:
    """Whether one more connection from this address has a place, and which connection gives way to it, if any.

    Of those that are still on their way to a session after `grace_seconds`, the one that has come the least far gives
    way, by lot. So who opens sockets and says nothing keeps nobody out; under a flood that comes back at once, a
    client may have to try more than once, but when it has a place there is time to log in. `now` as `made`: monotonic
    seconds.
    """
    alive = [connection for connection in connections if not connection.transport.is_closing()]
    same = [connection for connection in alive if connection.address == address]
    if len(same) >= limits.connections_per_address:
        crowd = same
    elif len(alive) >= limits.connections:
        crowd = alive
    else:
        return True, None
    late = (connection for connection in crowd if now - connection.made >= limits.grace_seconds)
    waiting = [
        (stage, random.random(), connection) for connection in late if (stage := connection.stage()) < Stage.ACTIVE
    ]
    if not waiting:
        return False, None
    return True, min(waiting, key=lambda found: found[:2])[2]


def session_that_gives_way(sessions: Iterable[Any], address: str, limits: Limits) -> tuple[bool, Any]:
    """Whether one more session from this address has a place, not yet knowing whose it is, and which gives way.

    A session whose connection was lost gives way first, the one that was used least lately; then one that was never
    activated.
    """
    everyone = list(sessions)
    same = [session for session in everyone if session.address == address]
    if len(same) >= limits.sessions_per_address + limits.sessions_reserved:
        crowd = same
    elif len(everyone) >= limits.sessions + limits.sessions_reserved:
        crowd = everyone
    else:
        return True, None
    return _weakest(crowd, SessionState.Created)


def anonymous_session_that_gives_way(sessions: Iterable[Any], own: Any, limits: Limits) -> tuple[bool, Any]:
    """The same for a session `own` that is about to be activated without a log-in: it has no reserved place."""
    everyone = [
        session
        for session in sessions
        if session is not own and session.state is SessionState.Activated and session.user.name is None
    ]
    same = [session for session in everyone if session.address == own.address]
    if len(same) >= limits.sessions_per_address:
        return _weakest(same)
    if len(everyone) >= limits.sessions:
        return _weakest(everyone)
    return True, None


def _weakest(crowd: list[Any], *states: SessionState) -> tuple[bool, Any]:
    lost = [session for session in crowd if session.processor is None]
    weak = lost or [session for session in crowd if session.state in states]
    if not weak:
        return False, None
    return True, min(weak, key=lambda session: session._last_activity)


def has_room(subscriptions: Iterable[Any], own: Any, subscription: int, items: int, limits: Limits) -> bool:
    """Session `own` may have so many more subscriptions and monitored items, beside what everybody has.

    Who did not log in shares a quota with its address, and one with everybody; a user has a session's worth on top.
    """
    held = [(sub.address, len(sub.monitored_item_srv)) for sub in subscriptions]
    is_user = own.user.name is not None
    most = limits.subscriptions + is_user * limits.subscriptions_per_session
    most_items = limits.items + is_user * limits.items_per_session
    if len(held) + subscription > most or sum(count for _, count in held) + items > most_items:
        return False
    same = [count for address, count in held if address == own.address]
    return is_user or (
        len(same) + subscription <= limits.subscriptions_per_address and sum(same) + items <= limits.items_per_address
    )
