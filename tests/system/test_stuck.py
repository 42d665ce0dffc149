"""A process that is stopped: its values are Bad, its writes refused, and in time it is killed and started anew."""

import asyncio
import os
import signal
import socket
import struct
import time
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
import pytest_asyncio
from asyncua import Client, Node, ua

from softplc.publishers.modbus.offsets import AXIS
from softplc.sample import StatusCode
from tests.drivers_modbus.support import plain_device, pymodbus_server
from tests.support.network import free_port
from tests.support.program import Program

ALIVE, SCAN_NUMBER, QUALITY = 11, 102, 3000 + AXIS.offsets["Quality"]
CONFIG = """
tasks:
  - {{name: main, period_ms: 50}}
sources:
  - {{name: drive, type: modbus, transport: {{host: 127.0.0.1, port: {drive}}}}}
axes:
  - name: AxisX
    input: {{source: drive, address: 40011, data_type: uint16}}
    enable: {{writable: true}}
    observer: {{type: aoi, r_x: 1.0}}
publishers:
  - type: opcua
    port: {opcua}
    users:
      - {{name: engineer, password: {{env: TEST_PASSWORD}}}}
  - {{type: modbus, port: {modbus}}}
"""
pytestmark = pytest.mark.asyncio(loop_scope="module")


class Plant:
    """A running softplc, its Modbus port, its OPC-UA endpoint, and the service manager's socket."""

    def __init__(self, program: Program, opcua: str, port: int, manager: socket.socket) -> None:
        self.program, self.opcua, self.port, self.manager = program, opcua, port, manager

    async def registers(self, first: int, count: int = 1) -> tuple[int, ...]:
        """Input registers; none while the server cannot be reached."""
        try:
            async with asyncio.timeout(2):
                reader, writer = await asyncio.open_connection("127.0.0.1", self.port)
                try:
                    writer.write(struct.pack(">HHHBBHH", 1, 0, 6, 1, 4, first, count))
                    reply = await reader.readexactly(9 + 2 * count)
                finally:
                    writer.close()
        except (OSError, EOFError, TimeoutError):
            return ()
        return struct.unpack(f">{count}H", reply[9:])

    async def until(self, address: int, wanted: int) -> None:
        async with asyncio.timeout(90):
            while await self.registers(address) != (wanted,):
                await asyncio.sleep(0.05)

    async def scans(self) -> int:
        high, low = await self.registers(SCAN_NUMBER, 2)
        return high << 16 | low

    async def until_another(self, child: str, than: int) -> None:
        async with asyncio.timeout(90):
            while self.program.children().get(child) in (than, None):
                await asyncio.sleep(0.1)

    def fed(self) -> int:
        """How often the service manager's watchdog was fed since the last call."""
        count = 0
        while True:
            try:
                count += self.manager.recv(4096) == b"WATCHDOG=1"
            except BlockingIOError:
                return count


async def until_bad(node: Node) -> None:
    async with asyncio.timeout(60):
        while (await node.read_data_value(raise_on_bad_status=False)).StatusCode.is_good():
            await asyncio.sleep(0.01)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def plant(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Plant]:
    folder: Path = tmp_path_factory.mktemp("stuck")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(folder / "notify"))
        manager.setblocking(False)
        async with pymodbus_server(plain_device()) as drive:
            ports = {"opcua": free_port(), "modbus": free_port()}
            (folder / "plant.yaml").write_text(CONFIG.format(drive=drive, **ports))
            more = {"NOTIFY_SOCKET": str(folder / "notify"), "WATCHDOG_USEC": "1000000", "TEST_PASSWORD": "a secret"}
            with Program("run", str(folder / "plant.yaml"), "--json", **more) as program:
                facts = await asyncio.to_thread(program.ready)
                plant = Plant(program, facts["endpoints"]["opcua"], ports["modbus"], manager)
                await plant.until(QUALITY, 2)
                yield plant


async def test_nobody_is_killed_when_everybody_was_stopped_for_longer_than_the_limits(plant):
    children, supervisor = plant.program.children(), plant.program.process.pid
    everybody = [supervisor, *children.values()]
    for pid in everybody:
        os.kill(pid, signal.SIGSTOP)
    await asyncio.sleep(6.0)  # a scan process may stand still for 5 s
    for pid in everybody:
        os.kill(pid, signal.SIGCONT)
    await plant.until(QUALITY, 2)
    await asyncio.sleep(1.5)  # three looks of the supervisor
    assert plant.program.children() == children


async def test_a_scan_process_that_was_stopped_for_two_seconds_goes_on_by_itself(plant):
    scan = plant.program.children()["scan"]
    os.kill(scan, signal.SIGSTOP)
    stopped = time.monotonic()
    await plant.until(ALIVE, 0)
    await asyncio.sleep(max(0.0, stopped + 2.0 - time.monotonic()))
    os.kill(scan, signal.SIGCONT)
    await plant.until(QUALITY, 2)
    assert plant.program.children()["scan"] == scan


async def test_a_stuck_scan_process_is_bad_takes_no_writes_starves_the_watchdog_and_is_started_anew(plant):
    async with asyncio.timeout(60):
        while not plant.fed():
            await asyncio.sleep(0.1)
    client = Client(plant.opcua, timeout=30)
    client.set_user("engineer")
    client.set_password("a secret")
    async with client:
        names = ("AxisX.Position", "AxisX.Velocity", "Tasks.main.Heartbeat", "Sources.drive.Connected")
        nodes = [client.get_node(f"ns=2;s={name}") for name in names]
        enable = client.get_node("ns=2;s=AxisX.Enable")
        await enable.write_value(ua.DataValue(ua.Variant(True, ua.VariantType.Boolean)))
        scan = plant.program.children()["scan"]
        os.kill(scan, signal.SIGSTOP)
        await plant.until(ALIVE, 0)
        await until_bad(nodes[-1])  # each server looks at the scans by itself, in its own turn
        plant.fed()
        values = [await node.read_data_value(raise_on_bad_status=False) for node in nodes]
        assert {value.StatusCode.value for value in values} == {StatusCode.BAD_NO_COMMUNICATION}
        assert await plant.registers(QUALITY) == (0,)
        with pytest.raises(ua.UaStatusCodeError) as refused:
            await enable.write_value(ua.DataValue(ua.Variant(False, ua.VariantType.Boolean)))
        assert refused.value.code == StatusCode.BAD_NO_COMMUNICATION
        assert plant.fed() == 0
        await plant.until_another("scan", scan)
        await plant.until(QUALITY, 2)
    async with asyncio.timeout(60):
        while not plant.fed():
            await asyncio.sleep(0.1)
    (told,) = [line for line in plant.program.err if "process stuck, killed" in line]
    assert "no scan of task main" in told


async def test_a_stuck_gateway_is_started_anew_while_scans_go_on(plant):
    gateway, before = plant.program.children()["gateway"], await plant.scans()
    scan = plant.program.children()["scan"]
    os.kill(gateway, signal.SIGSTOP)
    stopped = time.monotonic()
    await plant.until_another("gateway", gateway)
    await plant.until(QUALITY, 2)
    passed = time.monotonic() - stopped
    assert plant.program.children()["scan"] == scan
    # 20 scans a second; a busy machine may let some of them go by, but it never stood still
    assert await plant.scans() - before > 5 * passed
    (told,) = [line for line in plant.program.err if "its event loop does not turn" in line]
    assert "gateway" in told


async def test_it_ends_in_order_after_all_that(plant):
    assert await asyncio.to_thread(plant.program.end, signal.SIGTERM) == 0
