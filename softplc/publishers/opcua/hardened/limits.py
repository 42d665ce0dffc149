"""How much one client, and all clients together, may take of the server."""

import resource
from collections.abc import Sized
from dataclasses import dataclass, replace
from pathlib import Path

from asyncua import ua
from asyncua.common.utils import ServiceError


@dataclass(frozen=True, slots=True)
class Limits:
    """What clients may have open at once. The caps for one address leave room for somebody at another one.

    `sessions`, `subscriptions` and `items` are what clients that did not log in may have together; users have
    `sessions_reserved` and a session's worth of subscriptions and items on top.
    """

    connections: int = 120
    connections_per_address: int = 60
    backlog: int = 100  # connections that are accepted at once
    sessions: int = 100
    sessions_per_address: int = 50
    sessions_reserved: int = 10
    subscriptions: int = 500
    subscriptions_per_address: int = 250
    subscriptions_per_session: int = 20
    items: int = 100_000
    items_per_address: int = 50_000
    items_per_session: int = 20_000
    queue_size: int = 100  # notifications kept for one monitored item
    unacknowledged: int = 100  # messages kept for Republish, per subscription
    operations: int = 5_000  # nodes or items in one request; also told as OperationLimits
    references: int = 20_000  # references looked at for one Browse
    continuation_points: int = 10
    chunk_bytes: int = 65_535
    message_bytes: int = 1 << 20
    unread_bytes: int = 8 << 20  # answers that a client leaves unread before it is dropped
    waiting_requests: int = 64  # requests of one connection after which it is not read any further
    activation_seconds: float = 10.0  # from connection to an activated session
    grace_seconds: float = 0.2  # for which a new connection gives way to nobody
    min_publishing_ms: float = 10.0
    max_publishing_ms: float = 3_600_000.0

    def within(self, files: int) -> "Limits":
        """The same, with no more connections than fit when this process may open so many more files.

        Where files run out, asyncio logs every failed accept with a traceback, megabytes a second. It accepts
        `backlog` connections in one turn of its loop and one more, and up to four turns' are open at a time.
        """
        backlog = max(min(self.backlog, files // 12), 1)
        most = max(files - 4 * (backlog + 1), 2)
        connections = min(self.connections, most)
        here = self.connections_per_address
        if connections < self.connections:
            here = min(here, connections - connections // 6)
        return replace(self, backlog=backlog, connections=connections, connections_per_address=here)

    def check_operations(self, items: Sized | None) -> None:
        """Raises ServiceError when a request asks for nothing or for too much at once."""
        if not items:
            raise ServiceError(ua.StatusCodes.BadNothingToDo)
        if len(items) > self.operations:
            raise ServiceError(ua.StatusCodes.BadTooManyOperations)


def free_files() -> int:
    """How many more files this process may open."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return (soft if soft != resource.RLIM_INFINITY else 1 << 20) - sum(1 for _ in Path("/dev/fd").iterdir())
