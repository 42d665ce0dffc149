"""Two PLCs to read from: node-opcua as a process of its own, asyncua in a thread with its own event loop."""

import asyncio
import json
import os
import select
import signal
import subprocess
import threading
import time
from collections.abc import Coroutine
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

from asyncua import Server, ua

from tests.support.network import free_port
from tests.support.peers import need_npm

T = TypeVar("T")
URI = "urn:softplc:test:plc"
SCRIPT = Path(__file__).parent.parent / "peers" / "opcua_server.js"
STAMP = datetime(2024, 5, 17, 8, 30, 0, 123000, UTC)
STAMP_NS = 1_715_934_600_123_000_000
NEVER = datetime(9999, 12, 31, 23, 59, 59, tzinfo=UTC)
NUMBERS = {
    "Bool": 1.0,
    "SByte": -128.0,
    "Byte": 255.0,
    "Int16": -32768.0,
    "UInt16": 65535.0,
    "Int32": -2147483648.0,
    "UInt32": 4294967295.0,
    "Int64": -1234567890123.0,
    "UInt64": 1234567890123.0,
    "Float": 0.5,
    "Double": 1e300,
}


class NodePlc:
    """tests/peers/opcua_server.js: an independent implementation, killed, stopped and continued by its pid."""

    def __init__(self, folder: Path, port: int | None = None, **options: Any) -> None:
        peers = need_npm("node-opcua")
        self.port = port or free_port()
        self.url = f"opc.tcp://127.0.0.1:{self.port}"
        environment = {
            **os.environ,
            "NODE_PATH": str(peers / "node_modules"),
            "HOME": str(folder),
            "XDG_CONFIG_HOME": str(folder),
        }
        self._process = subprocess.Popen(
            ["node", str(SCRIPT), str(self.port), str(folder), json.dumps(options)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
            cwd=folder,
        )
        self._said = b""
        self._wait_for("ready", 60.0)

    def do(self, command: str) -> str:
        """One command, as the script's head lists them; returns what it gives, when it is done."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{command}\n".encode())
        self._process.stdin.flush()
        return self._wait_for("ok", 20.0)

    @property
    def pid(self) -> int:
        return self._process.pid

    def signal(self, number: signal.Signals) -> None:
        self._process.send_signal(number)

    def kill(self) -> None:
        """End at once, as when the power fails."""
        self._process.kill()
        self._process.wait()

    def close(self) -> None:
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGCONT)
            self._process.kill()
            self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()

    def _wait_for(self, word: str, seconds: float) -> str:
        assert self._process.stdout is not None
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            while b"\n" in self._said:
                line, _, self._said = self._said.partition(b"\n")
                first, _, rest = line.decode().strip().partition(" ")
                if first == word:
                    return rest
            if select.select([self._process.stdout], [], [], 0.1)[0]:
                more = os.read(self._process.stdout.fileno(), 65536)
                assert more, f"the server ended while {word!r} was awaited"
                self._said += more
        raise AssertionError(f"the server did not say {word!r} within {seconds} s")


class AsyncuaPlc:
    """asyncua's own server, with what node-opcua's does not show: odd timestamps, Good without value, more nodes."""

    def __init__(self) -> None:
        self.port = free_port()
        self.url = f"opc.tcp://127.0.0.1:{self.port}"
        self.loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self.loop.run_forever, name="asyncua plc", daemon=True)
        self._thread.start()
        self.server = Server()
        self.run(self._start())

    def run(self, work: Coroutine[Any, Any, T]) -> T:
        """Do this in the server's loop."""
        return asyncio.run_coroutine_threadsafe(work, self.loop).result(60.0)

    def write(self, name: str, value: ua.DataValue) -> None:
        """Give a variable another value."""
        node = ua.NodeId(name, self.index)
        self.run(self.server.write_attribute_value(node, value))

    def close(self) -> None:
        self.run(self.server.stop())
        self.loop.call_soon_threadsafe(self.loop.stop)
        self._thread.join(10.0)
        self.loop.close()

    async def _start(self) -> None:
        await self.server.init()
        self.server.set_endpoint(self.url)
        self.server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        self.index = await self.server.register_namespace(URI)
        self.server.iserver.aspace._is_expected_variant_type = lambda *_: True  # a PLC may load another program
        plc = await self.server.nodes.objects.add_object(ua.NodeId("PLC", self.index), f"{self.index}:PLC")
        double = ua.VariantType.Double
        values = {
            "Plain": ua.DataValue(ua.Variant(1.5, double), SourceTimestamp=STAMP),
            "NoStamp": ua.DataValue(ua.Variant(2.5, double)),
            "Year9999": ua.DataValue(ua.Variant(3.5, double), SourceTimestamp=NEVER),
            "Moving": ua.DataValue(ua.Variant(0.0, double), SourceTimestamp=STAMP),
            "Target": ua.DataValue(ua.Variant(0.0, double), SourceTimestamp=STAMP),
        }
        for name, value in values.items():
            node = await plc.add_variable(ua.NodeId(name, self.index), f"{self.index}:{name}", 0.0, double)
            await self.server.write_attribute_value(node.nodeid, value)
            if name == "Target":
                await node.set_writable()
        empty = ua.NodeId("Empty", self.index)
        await plc.add_variable(
            empty, f"{self.index}:Empty", None, ua.VariantType.Null, ua.NodeId(ua.ObjectIds.Double)
        )
        twice = await plc.add_object(ua.NodeId("Twice", self.index), f"{self.index}:Twice")
        for number in (1.0, 2.0):
            await twice.add_variable(ua.NodeId(f"Same{number:g}", self.index), f"{self.index}:Same", number, double)
        await self.server.start()
