"""A served exchange on a virtual clock, clients of it, and node-opcua as a peer."""

import asyncio
import contextlib
import json
import os
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio
from asyncua import Client, ua

from softplc.clock import VirtualClock
from softplc.model import Secret
from softplc.publishers.opcua.config import OpcUaPublisher, OpcUaServerSecurity, OpcUaServerUser
from softplc.publishers.opcua.hardened.limits import Limits
from softplc.publishers.opcua.server import OpcUaServer
from tests.support.exchange import Exchange, make_exchange
from tests.support.network import eventually, free_port
from tests.support.peers import need_npm

CLIENT_JS = Path(__file__).parent.parent / "peers" / "opcua_client.js"
PASSWORD = "opensesame"
os.environ["SOFTPLC_TEST_OPCUA_PASSWORD"] = PASSWORD
USERS = (OpcUaServerUser(name="engineer", password=Secret(env="SOFTPLC_TEST_OPCUA_PASSWORD")),)


@dataclass
class Served:
    """An exchange and the server that publishes it."""

    exchange: Exchange
    clock: VirtualClock
    server: OpcUaServer
    url: str
    port: int

    async def scan(self, after: float = 0.05) -> None:
        """One more scan `after` virtual seconds, published."""
        self.clock.advance(after)
        self.exchange.publish()
        await self.server.publish()

    def client(self, user: str | None = None, password: str | None = None) -> Client:
        """An asyncua client, not yet connected."""
        client = Client(self.url, timeout=20)
        if user is not None:
            client.set_user(user)
            client.set_password(password)
        return client


@contextlib.asynccontextmanager
async def serve(
    limits: Limits | None = None,
    *,
    scanned: bool = True,
    port: int | None = None,
    fast: bool = True,
    security: OpcUaServerSecurity | None = None,
) -> AsyncIterator[Served]:
    """A server on this or a free port over a hand-made exchange; a secured one has today's date."""
    clock = VirtualClock() if security is None else VirtualClock(utc_ns=time.time_ns())
    exchange = make_exchange(clock)
    if scanned:
        exchange.publish()
    port = port or free_port()
    server = OpcUaServer(
        OpcUaPublisher(type="opcua", port=port, users=USERS, security=security), exchange.reader, limits, fast=fast
    )
    url = await server.open()
    try:
        yield Served(exchange, clock, server, url, port)
    finally:
        await server.close()


def refused(error: Any) -> int:
    """Status of the UaStatusCodeError that pytest.raises caught."""
    return int(error.value.code)


async def connections(served: Served, count: int) -> None:
    """Return when the server has so many connections."""
    await eventually(lambda: len(served.server._listener.clients) == count, what=f"{count} connections")


LIMITS = Limits(
    connections=12,
    connections_per_address=8,
    sessions_per_address=5,
    subscriptions_per_session=3,
    items_per_session=20,
    operations=30,
    references=300,
    continuation_points=3,
    unread_bytes=1 << 16,
    activation_seconds=3.0,
)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def limited() -> AsyncIterator[Served]:
    """A server with small limits."""
    async with serve(LIMITS) as served:
        yield served


@pytest_asyncio.fixture(loop_scope="module")
async def quiet(limited: Served) -> Served:
    """The server with small limits, without a connection or session of the test before."""
    inner = limited.server._server.iserver
    for session in list(inner._external_sessions.values()):
        await session.close_session()
    await connections(limited, 0)
    return limited


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def served() -> AsyncIterator[Served]:
    async with serve() as served:
        yield served


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def client(served: Served) -> AsyncIterator[Client]:
    """A connected anonymous client."""
    async with served.client() as client:
        yield client


@pytest_asyncio.fixture(loop_scope="module")
async def calm(served: Served) -> Served:
    """Every tag Good and 1, published."""
    for tag in served.exchange.table:
        served.exchange.set(tag.name, 1.0)
    await served.scan()
    return served


@pytest_asyncio.fixture(scope="module", loop_scope="module", params=[True, False], ids=["fast", "ordinary"])
async def either(request: pytest.FixtureRequest) -> AsyncIterator[Served]:
    """A server with the fast path, and one without."""
    async with serve(fast=request.param) as served:
        yield served


@pytest_asyncio.fixture(loop_scope="module")
async def rested(either: Served) -> Served:
    """Every tag Good and 1, published."""
    for tag in either.exchange.table:
        either.exchange.set(tag.name, 1.0)
    await either.scan(1.0)
    return either


@pytest_asyncio.fixture(loop_scope="module")
async def alone(rested: Served) -> AsyncIterator[Client]:
    """A client of its own."""
    async with rested.client() as client:
        yield client


class Notifications:
    """Collects the DataValues of data changes."""

    def __init__(self) -> None:
        self.values: list[ua.DataValue] = []

    def datachange_notification(self, _node: Any, _value: Any, data: Any) -> None:
        self.values.append(data.monitored_item.Value)

    def numbers(self) -> list[Any]:
        return [value.Value.Value for value in self.values]


class NodeClient:
    """tests/peers/opcua_client.js as a process."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self._process = process
        self.notifications: list[dict[str, Any]] = []

    async def ask(self, **request: Any) -> dict[str, Any]:
        """Send one request; notifications that come before its answer are kept."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(request).encode() + b"\n")
        async with asyncio.timeout(60):
            while "answer" not in (line := await self._line()):
                self.notifications.append(line)
        return line

    async def notified(self, condition: Callable[[list[dict[str, Any]]], bool]) -> list[dict[str, Any]]:
        """All notifications so far, as soon as the condition holds for them."""
        async with asyncio.timeout(60):
            while not condition(self.notifications):
                self.notifications.append(await self._line())
        return self.notifications

    async def _line(self) -> dict[str, Any]:
        """The next JSON line; node-opcua's own warnings between them are passed over."""
        assert self._process.stdout is not None
        while line := await self._process.stdout.readline():
            with contextlib.suppress(ValueError):
                found = json.loads(line)
                if isinstance(found, dict):
                    return found
        raise AssertionError("the node-opcua client ended")


@contextlib.asynccontextmanager
async def node_client(folder: Path) -> AsyncIterator[NodeClient]:
    """A node-opcua client; skips the test when it is not installed."""
    peers = need_npm("node-opcua")
    process = await asyncio.create_subprocess_exec(
        "node",
        str(CLIENT_JS),
        str(folder / "pki"),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.DEVNULL,
        env={**os.environ, "NODE_PATH": str(peers / "node_modules")},
        limit=1 << 24,
    )
    try:
        yield NodeClient(process)
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await process.wait()
