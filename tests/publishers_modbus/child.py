"""A Modbus server in a process of its own: `python -m tests.publishers_modbus.child FIELDS [DESCRIPTORS]`.

Serves the full table, a new scan every 50 ms, until standard input closes. Prints its port; logs to standard error.
FIELDS are those of its configuration as JSON, with `give_way` and `stall_timeout` of the server beside them.
"""

import asyncio
import json
import os
import resource
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import structlog

from softplc.clock import SystemClock
from softplc.publishers.modbus.server import ModbusServer
from tests.publishers_modbus.support import any_port, full_exchange

PERIOD = 0.05


@dataclass
class Child:
    """Where it listens, and what it uses."""

    port: int
    pid: int
    log: Path

    @property
    def resident(self) -> int:
        """Its memory, bytes."""
        return int(Path(f"/proc/{self.pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")

    @property
    def descriptors(self) -> int:
        return len(list(Path(f"/proc/{self.pid}/fd").iterdir()))


@contextmanager
def child(folder: Path, descriptors: int | None = None, **fields: Any) -> Iterator[Child]:
    """A child that listens, ended at the end; its log is in the folder."""
    log = folder / "server.log"
    command = [sys.executable, "-m", __name__, json.dumps(fields), *([str(descriptors)] if descriptors else [])]
    root = Path(__file__).parent.parent.parent
    with log.open("wb") as errors:
        process = subprocess.Popen(
            command, cwd=root, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True
        )
        try:
            assert process.stdout is not None
            port = process.stdout.readline()
            assert port, log.read_text()
            yield Child(int(port), process.pid, log)
            assert process.poll() is None, log.read_text()
        finally:
            process.kill()
            process.communicate()


def room_for_sockets(count: int) -> None:
    """Let this process have so many descriptors as well."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft < count:
        resource.setrlimit(resource.RLIMIT_NOFILE, (min(count, hard), hard))


async def _serve(fields: dict[str, Any]) -> None:
    clock = SystemClock()
    own = {name: fields.pop(name) for name in ("give_way", "stall_timeout") if name in fields}
    exchange = full_exchange(clock)
    exchange.publish()
    server = ModbusServer(any_port(**fields), exchange.reader, **own)
    print((await server.open()).rpartition(":")[2], flush=True)
    ended = asyncio.get_running_loop().run_in_executor(None, sys.stdin.read)
    deadline = clock.monotonic()
    while not ended.done():
        exchange.publish(PERIOD)
        await server.publish()
        deadline += PERIOD
        await clock.sleep_until(deadline)


if __name__ == "__main__":
    if len(sys.argv) > 2:
        resource.setrlimit(resource.RLIMIT_NOFILE, (int(sys.argv[2]), int(sys.argv[2])))
    structlog.configure(logger_factory=structlog.PrintLoggerFactory(sys.stderr))
    asyncio.run(_serve(json.loads(sys.argv[1])))
