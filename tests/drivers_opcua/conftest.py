import logging
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.drivers_opcua.servers import AsyncuaPlc, NodePlc

StartPlc = Callable[..., NodePlc]


@pytest.fixture(scope="session")
def plc_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the node-opcua servers keep their certificates, which are made once."""
    return tmp_path_factory.mktemp("plc")


@pytest.fixture(scope="session")
def plc(plc_folder: Path) -> Iterator[NodePlc]:
    """A node-opcua server that nobody kills."""
    server = NodePlc(plc_folder)
    yield server
    server.close()


@pytest.fixture
def start_plc(plc_folder: Path) -> Iterator[StartPlc]:
    """Starts node-opcua servers that a test may kill."""
    servers: list[NodePlc] = []

    def start(port: int | None = None, **options: Any) -> NodePlc:
        servers.append(NodePlc(plc_folder, port, **options))
        return servers[-1]

    yield start
    for server in servers:
        server.close()


@pytest.fixture(scope="session")
def asyncua_plc() -> Iterator[AsyncuaPlc]:
    """An asyncua server."""
    server = AsyncuaPlc()
    yield server
    server.close()


@pytest.fixture(autouse=True)
def nothing_is_left_and_nothing_complains(caplog: pytest.LogCaptureFixture) -> Iterator[None]:
    """No forgotten task or exception (asyncio logs those), and not a line from the library's client."""
    yield
    told = [record for record in caplog.get_records("call") if record.levelno >= logging.WARNING]
    assert not [
        record for record in told if record.name.startswith(("asyncio", "asyncua.client", "asyncua.uaprotocol"))
    ]
