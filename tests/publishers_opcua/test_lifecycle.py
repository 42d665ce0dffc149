"""Opening, closing, and everything that is left behind: nothing."""

import asyncio
import contextlib
import errno
import gc
import logging
import socket

import pytest
from asyncua import Client
from structlog.testing import capture_logs

from softplc.errors import ConfigError, SoftplcError
from softplc.model import Secret
from softplc.publishers.opcua.config import OpcUaPublisher, OpcUaServerUser
from softplc.publishers.opcua.server import OpcUaServer, _explain
from tests.publishers_opcua.conftest import Served, serve
from tests.support.exchange import make_exchange
from tests.support.network import eventually, free_port


def config(port: int, **fields: object) -> OpcUaPublisher:
    return OpcUaPublisher.model_validate({"type": "opcua", "port": port, **fields})


async def test_after_close_the_port_is_free_and_no_task_remains() -> None:
    before = asyncio.all_tasks()
    async with serve() as served:
        async with served.client() as client:
            subscription = await client.create_subscription(10, None)
            await subscription.subscribe_data_change(client.get_node("ns=2;s=AxisX.Position"))
            await eventually(lambda: bool(served.server._sweep))
        await abandon(served)
        assert await client_count(served) == 1
        port = served.port

    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind(("127.0.0.1", port))
        probe.listen()
    await eventually(lambda: asyncio.all_tasks() <= before, what="tasks of the server that is closed")


async def abandon(served: Served) -> None:
    """A client with a subscription whose line is cut: its session lives on in the server."""
    client = served.client()
    await client.connect()
    subscription = await client.create_subscription(10, None)
    await subscription.subscribe_data_change(client.get_node("ns=2;s=AxisX.Position"))
    client.uaclient.protocol.transport.abort()
    with contextlib.suppress(Exception):
        await client.disconnect()


async def client_count(served: Served) -> int:
    sessions = served.server._server.iserver._external_sessions
    await eventually(lambda: all(session.processor is None for session in sessions.values()))
    return len(sessions)


async def test_close_does_not_wait_for_a_client_that_does_not_read() -> None:
    async with serve() as served:
        _, writer = await asyncio.open_connection("127.0.0.1", served.port)
        await eventually(lambda: len(served.server._listener.clients) == 1)
        served.server._listener.clients[0].transport.write(b"x" * (8 << 20))

        async with asyncio.timeout(10):
            await served.server.close()
        writer.transport.abort()


async def test_close_before_open_and_twice_is_nothing() -> None:
    server = OpcUaServer(config(free_port()), make_exchange().reader)

    await server.close()
    await server.open()
    await server.close()
    await server.close()
    await server.publish()


async def test_a_port_in_use_is_told_with_host_and_port() -> None:
    before = asyncio.all_tasks()
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]

        with pytest.raises(SoftplcError, match=rf"127\.0\.0\.1:{port}: the port is in use"):
            await OpcUaServer(config(port), make_exchange().reader).open()
    await eventually(lambda: asyncio.all_tasks() <= before)


async def test_two_servers_cannot_share_a_port() -> None:
    async with serve() as served:
        with pytest.raises(SoftplcError, match="in use"):
            await OpcUaServer(config(served.port), make_exchange().reader).open()
        async with served.client() as client:
            assert await client.get_namespace_array()


async def test_an_address_that_is_not_ours_is_told() -> None:
    with pytest.raises(SoftplcError, match="does not have that address"):
        await OpcUaServer(config(free_port(), host="192.0.2.1"), make_exchange().reader).open()


def test_why_the_server_cannot_listen_is_said_with_what_to_do() -> None:
    assert "another port" in _explain(OSError(errno.EADDRINUSE, "in use"))
    assert "privilege" in _explain(OSError(errno.EACCES, "denied"))
    assert "host name" in _explain(socket.gaierror(socket.EAI_NONAME, "unknown"))
    assert _explain(OSError(errno.EIO, "broken")) == "broken"


async def test_a_password_that_is_not_there_stops_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SOFTPLC_TEST_NO_PASSWORD", raising=False)
    users = (OpcUaServerUser(name="engineer", password=Secret(env="SOFTPLC_TEST_NO_PASSWORD")),)
    server = OpcUaServer(OpcUaPublisher(type="opcua", port=free_port(), users=users), make_exchange().reader)

    with pytest.raises(ConfigError, match="SOFTPLC_TEST_NO_PASSWORD"):
        await server.open()


@pytest.mark.parametrize(
    ("host", "warnings"),
    [("127.0.0.1", 0), ("::1", 0), ("localhost", 0), ("0.0.0.0", 1), ("192.168.0.7", 1), ("plc", 1)],
)
def test_only_a_server_that_the_network_reaches_warns_of_missing_encryption(host: str, warnings: int) -> None:
    server = OpcUaServer(config(4840, host=host), make_exchange().reader)
    with capture_logs() as logs:
        server._warn_of_network()

    assert warnings == sum(entry["log_level"] == "warning" for entry in logs)


async def test_the_endpoint_is_one_that_a_client_connects_to() -> None:
    server = OpcUaServer(config(free_port()), make_exchange().reader)
    url = await server.open()
    async with Client(url, timeout=20) as client:
        assert url == (await client.get_endpoints())[0].EndpointUrl
    await server.close()


async def test_the_garbage_collector_works_again_after_open() -> None:
    async with serve():
        assert gc.isenabled()


async def test_asyncua_does_not_log() -> None:
    async with serve():
        assert not logging.getLogger("asyncua.server.uaprocessor").isEnabledFor(logging.CRITICAL)
