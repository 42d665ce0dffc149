"""Scenarios as a file would give them, and the emulated PLC in a process of its own."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any
from urllib.parse import urlsplit

from softplc.emulator.run import Endpoints, run_emulator
from softplc.emulator.scenario import Scenario

START_WITHIN = 90.0  # seconds; asyncua's address space alone takes 2 to 4 on an idle core


def scenario(*axes: dict[str, Any], **fields: Any) -> Scenario:
    """A scenario as it comes from a file; without a server named it has Modbus on any free port."""
    if "opcua" not in fields and "modbus" not in fields:
        fields["modbus"] = {"port": 0}
    return Scenario.model_validate_json(json.dumps({"axes": axes or [{"name": "AxisX"}], **fields}))


@dataclass
class Emulator:
    """A running emulated PLC."""

    process: BaseProcess
    endpoints: Endpoints

    def port(self, protocol: str) -> int:
        port = urlsplit(self.endpoints[protocol]).port
        assert port is not None
        return port


def spawn(chosen: Scenario) -> tuple[BaseProcess, Connection]:
    """The process, started, and our end of its connection."""
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=run_emulator, args=(chosen, theirs))
    process.start()
    theirs.close()
    return process, ours


@contextmanager
def emulator(chosen: Scenario) -> Iterator[Emulator]:
    """The emulated PLC while the block runs."""
    process, connection = spawn(chosen)
    try:
        assert connection.poll(START_WITHIN), "the emulated PLC did not start"
        word, endpoints = connection.recv()
        assert word == "ready", endpoints
        yield Emulator(process, endpoints)
    finally:
        process.terminate()
        process.join(20)
        if process.is_alive():
            process.kill()
        connection.close()
