"""The daemon between third-party servers and third-party clients, and what happens when its parts die."""

import asyncio
import json
import os
import signal
import struct
import subprocess
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio

from softplc.publishers.modbus.offsets import AXIS
from softplc.sample import StatusCode
from tests.drivers_modbus.support import Peer, running_peer
from tests.drivers_opcua.servers import NodePlc
from tests.publishers_opcua.conftest import NodeClient, node_client
from tests.support.network import free_port
from tests.support.peers import need_npm, need_program
from tests.support.program import Program, softplc

AXIS_X, AXIS_Y = 3000, 3064
CONFIG = """
tasks:
  - {{name: main, period_ms: 50}}
sources:
  - {{name: plc, type: opcua, url: "{url}"}}
  - {{name: drive, type: modbus, transport: {{type: tcp, host: 127.0.0.1, port: {drive}}}, byte_order: CDAB}}
axes:
  - name: AxisX
    unit: mm
    input: {{source: plc, node: "nsu=urn:softplc:test:plc;s=PLC.Axis.Ramp"}}
    observer: {{type: aoi, q_x: 0.001, q_x_dot: 0.1, r_x: 0.01}}
    write_back:
      - {{output: Velocity, tag: {{source: plc, node: "nsu=urn:softplc:test:plc;s=PLC.Axis.Target"}}, every_scans: 2}}
  - name: AxisY
    unit: deg
    input: {{source: drive, address: 40101, data_type: float32, scale: 2.0, offset: -1.0}}
    observer: {{type: aoi, precision: real, q_x: 0.01, q_x_dot: 0.1, r_x: 1.0}}
  - name: AxisZ
    input: {{source: drive, address: 40101, data_type: float32, scale: 2.0, offset: -1.0}}
    enable: {{source: plc, node: "nsu=urn:softplc:test:plc;s=PLC.Axis.Flag"}}
    observer: {{type: aoi, r_x: 1.0}}
  - name: AxisW
    input: {{source: drive, address: 40101, data_type: float32, scale: 2.0, offset: -1.0}}
    enable: {{writable: true, initial: false}}
    observer: {{type: aoi, r_x: 1.0}}
publishers:
  - type: opcua
    port: {opcua}
    users:
      - {{name: engineer, password: {{env: TEST_PASSWORD}}}}
  - {{type: modbus, port: {modbus}}}
"""


class Plant:
    """A running softplc with a node-opcua server and a modbus-serial server as its PLCs."""

    def __init__(self, program: Program, plc: NodePlc, drive: Peer, facts: dict[str, Any], config: Path) -> None:
        self.program, self.plc, self.drive, self.facts, self.config = program, plc, drive, facts, config
        self.opcua = facts["endpoints"]["opcua"]
        self.port = int(facts["endpoints"]["modbus"].rpartition(":")[2])
        self.peers = need_npm("modbus-serial")

    def registers(self, first: int, count: int, library: str = "modbus-serial", table: int = 4) -> bytes:
        """Registers as the third-party client got them."""
        script = Path(__file__).parents[1] / "peers" / "modbus_client.js"
        done = subprocess.run(
            ["node", str(script), library, str(self.port), "1"],
            input=json.dumps([["read", table, first, count]]),
            cwd=self.peers,
            capture_output=True,
            text=True,
            timeout=60,
            check=True,
        )
        return bytes.fromhex(json.loads(done.stdout)[0]["hex"])

    def quality(self, axis: int) -> int:
        """The axis' quality; -1 while the server cannot be reached."""
        try:
            return int.from_bytes(self.registers(axis + AXIS.offsets["Quality"], 1), "big")
        except subprocess.CalledProcessError:
            return -1

    async def until_quality(self, axis: int, wanted: int) -> None:
        async with asyncio.timeout(60):
            while await asyncio.to_thread(self.quality, axis) != wanted:
                await asyncio.sleep(0.05)


@pytest.fixture(scope="module")
def plc(tmp_path_factory: pytest.TempPathFactory) -> Iterator[NodePlc]:
    server = NodePlc(tmp_path_factory.mktemp("plc"))
    yield server
    server.close()


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def plant(plc: NodePlc, tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Plant]:
    async with running_peer() as drive:
        await drive.put("holding", 100, 10.5, "float32", "CDAB")
        config = tmp_path_factory.mktemp("run") / "plant.yaml"
        ports = {"opcua": free_port(), "modbus": free_port()}
        config.write_text(CONFIG.format(url=plc.url, drive=drive.port, **ports))
        with Program("run", str(config), "--json", TEST_PASSWORD="a secret") as program:
            facts = await asyncio.to_thread(program.ready)
            plant = Plant(program, plc, drive, facts, config)
            await plant.until_quality(AXIS_X, 2)
            await plant.until_quality(AXIS_Y, 2)
            yield plant


@pytest_asyncio.fixture(loop_scope="module")
async def client(plant: Plant, tmp_path: Path) -> AsyncIterator[NodeClient]:
    async with node_client(tmp_path) as client:
        await client.ask(connect=plant.opcua)
        yield client


async def read(client: NodeClient, *names: str) -> dict[str, dict[str, Any]]:
    answer = await client.ask(read=[[f"ns=2;s={name}", 13] for name in names])
    return dict(zip(names, answer["samples"], strict=True))


pytestmark = pytest.mark.asyncio(loop_scope="module")


async def test_velocity_of_a_third_party_ramp_is_read_by_a_third_party_client(plant, client):
    async with asyncio.timeout(60):
        while True:
            sample = await read(client, "AxisX.Velocity", "AxisX.Position", "AxisX.Raw")
            if abs(sample["AxisX.Velocity"]["value"] - 1.0) < 0.1:
                break
    assert sample["AxisX.Velocity"]["status"] == StatusCode.GOOD
    # the estimate rests on the same sample as Raw, and carries its time
    assert sample["AxisX.Position"]["source"] == sample["AxisX.Raw"]["source"]
    assert abs(sample["AxisX.Position"]["value"] - sample["AxisX.Raw"]["value"]) < 0.2


async def test_scale_offset_and_word_order_of_a_modbus_source(plant, client):
    sample = await read(client, "AxisY.Raw", "AxisY.Position", "AxisY.Velocity")
    assert sample["AxisY.Raw"]["value"] == 20.0
    assert sample["AxisY.Position"]["value"] == pytest.approx(20.0)
    assert sample["AxisY.Velocity"]["value"] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("library", ["modbus-serial", "jsmodbus"])
@pytest.mark.parametrize("table", [3, 4])
async def test_opcua_and_modbus_clients_read_the_same(plant, client, library, table):
    raw = plant.registers(AXIS_Y, 6, library, table)
    sample = await read(client, "AxisY.Position", "AxisY.Velocity", "AxisY.Raw")
    assert struct.unpack(">3f", raw) == pytest.approx([entry["value"] for entry in sample.values()], abs=1e-4)


async def test_mbpoll_reads_the_check_constants(plant):
    mbpoll = need_program("mbpoll")
    command = [mbpoll, "-m", "tcp", "-p", str(plant.port), "-a", "1", "-0", "-1", "-q", "-B", "-t", "3:float"]
    done = subprocess.run(
        [*command, "-r", "2", "-c", "2", "127.0.0.1"], capture_output=True, text=True, timeout=30, check=True
    )
    assert "-123.456" in done.stdout


async def test_the_velocity_is_written_back_into_the_plc(plant, client):
    async with node_client(Path(plant.config.parent)) as at_plc:
        namespaces = (await at_plc.ask(connect=plant.plc.url))["namespaces"]
        target = f"ns={namespaces.index('urn:softplc:test:plc')};s=PLC.Axis.Target"
        async with asyncio.timeout(60):
            while True:
                value = (await at_plc.ask(read=[[target, 13]]))["samples"][0]["value"]
                if abs(value - 1.0) < 0.2:
                    break
    counted = await read(client, "Sources.plc.Writes", "Sources.plc.WriteErrors")
    assert counted["Sources.plc.Writes"]["value"] > 0
    assert counted["Sources.plc.WriteErrors"]["value"] == 0


async def test_enable_follows_a_boolean_of_the_plc(plant, client):
    for flag, enabled, status in ((1, True, StatusCode.GOOD), (0, False, StatusCode.UNCERTAIN_SUB_NORMAL)):
        plant.plc.do(f"set Flag {flag}")
        async with asyncio.timeout(60):
            while True:
                sample = await read(client, "AxisZ.Enabled", "AxisZ.Position")
                if (sample["AxisZ.Enabled"]["value"], sample["AxisZ.Position"]["status"]) == (enabled, status):
                    break


async def test_enable_is_written_by_the_configured_user_and_by_nobody_else(plant, client, tmp_path):
    write = ["ns=2;s=AxisW.Enable", 13, "Boolean", True]
    assert (await client.ask(write=write))["status"] & 0x80000000
    assert not (await read(client, "AxisW.Enabled"))["AxisW.Enabled"]["value"]
    async with node_client(tmp_path / "engineer") as engineer:
        await engineer.ask(connect=plant.opcua, user="engineer", password="a secret")
        assert (await engineer.ask(write=write))["status"] >> 30 == 0  # Good, completes asynchronously
    async with asyncio.timeout(60):
        while not (await read(client, "AxisW.Enabled"))["AxisW.Enabled"]["value"]:
            await asyncio.sleep(0.05)
    sample = await read(client, "AxisW.Position", "AxisW.Enable")
    assert sample["AxisW.Position"]["value"] == pytest.approx(20.0)
    assert sample["AxisW.Enable"]["value"]


async def test_health_is_ok_while_it_scans(plant):
    assert (await asyncio.to_thread(softplc, "health", str(plant.config))).returncode == 0


async def test_check_connect_reads_every_tag_once(plant):
    done = await asyncio.to_thread(softplc, "check", str(plant.config), "--connect", "--json")
    assert done.returncode == 0, done.stderr
    rows = {row["tag"]: row for row in json.loads(done.stdout)}
    assert rows["AxisY.Raw"]["value"] == 20.0
    assert rows["AxisY.Raw"]["unit"] == "deg"
    assert rows["AxisX.Raw"]["status"] == "Good"
    assert rows["AxisX.Raw"]["age_s"] is not None


async def test_a_killed_gateway_is_restarted_while_scans_go_on(plant, client):
    before = (await read(client, "Tasks.main.ScanNumber"))["Tasks.main.ScanNumber"]["value"]
    gateway = plant.program.children()["gateway"]
    os.kill(gateway, signal.SIGKILL)
    async with asyncio.timeout(60):
        while plant.program.children().get("gateway") in (gateway, None):
            await asyncio.sleep(0.1)
    await plant.until_quality(AXIS_Y, 2)
    async with node_client(Path(plant.config.parent)) as again:
        await again.ask(connect=plant.opcua)
        after = (await read(again, "Tasks.main.ScanNumber"))["Tasks.main.ScanNumber"]["value"]
    assert after > before  # it never started from 0 again


async def test_a_stopped_scan_process_makes_every_value_bad_and_a_killed_one_is_restarted(plant):
    scan = plant.program.children()["scan"]
    os.kill(scan, signal.SIGSTOP)
    await plant.until_quality(AXIS_X, 0)
    os.kill(scan, signal.SIGCONT)
    await plant.until_quality(AXIS_X, 2)
    os.kill(scan, signal.SIGKILL)
    async with asyncio.timeout(60):
        while plant.program.children().get("scan") in (scan, None):
            await asyncio.sleep(0.1)
    await plant.until_quality(AXIS_X, 2)


async def test_a_source_that_dies_is_bad_and_its_neighbour_stays_good(plant, plc):
    plc.kill()
    await plant.until_quality(AXIS_X, 0)
    assert plant.quality(AXIS_Y) == 2
    plant.plc = NodePlc(plant.config.parent, plc.port)
    try:
        await plant.until_quality(AXIS_X, 2)
    finally:
        plant.plc.close()


async def test_a_taken_port_is_one_line_and_exit_code_1(plant):
    done = await asyncio.to_thread(softplc, "run", str(plant.config))
    assert done.returncode == 1
    assert "in use" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


async def test_sigterm_ends_with_exit_0_and_no_traceback(plant):
    assert await asyncio.to_thread(plant.program.end, signal.SIGTERM) == 0
    assert "Traceback" not in plant.program.text()
