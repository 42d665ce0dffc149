"""Write-backs into third-party servers, read back from them."""

import asyncio
import json
from contextlib import asynccontextmanager

import pytest
import structlog

from softplc.app.layout import build_layout
from softplc.app.scan_process import build_tasks, start_tasks
from softplc.clock import SystemClock
from softplc.config.models import Config
from softplc.exchange import Reader, Writer, size
from softplc.sample import WriteState
from tests.drivers_modbus.support import running_peer
from tests.drivers_opcua.servers import NodePlc
from tests.support.network import eventually


class Scans:
    """A configuration that scans in this process, and its tags as a publisher sees them."""

    def __init__(self, document):
        self.clock = SystemClock()
        layout = build_layout(Config.model_validate_json(json.dumps(document)))
        buffer = bytearray(size(layout.table))
        self.table = layout.table
        self.tasks = build_tasks(layout, Writer(buffer, layout.table), self.clock)
        self._reader = Reader(buffer, layout.table, self.clock)

    def value(self, name):
        return float(self._reader.snapshot().values[self.table.index(name)])

    async def until(self, name, wanted):
        await eventually(lambda: self.value(name) == wanted, 30.0, f"{name} is {wanted}")


@asynccontextmanager
async def scanning(document):
    scans = Scans(document)
    async with asyncio.TaskGroup() as group:
        running = start_tasks(group, scans.tasks)
        try:
            yield scans
        finally:
            for task in running:
                task.cancel()
    scans.clock.close()


def axis(source, tag, written, **options):
    return {
        "name": "A",
        "input": {"source": source, **tag},
        "observer": {"type": "finite_difference"},
        "write_back": [
            {"output": "Position", "tag": {"source": source, **written}, "verify": True, "verify_within_ms": 500}
            | options
        ],
    }


async def test_a_modbus_plc_that_clamps_is_a_mismatch_until_it_takes_the_value():
    async with running_peer() as drive:
        await drive.put("holding", 100, 10.5, "float32")
        document = {
            "sources": [{"type": "modbus", "name": "drive", "transport": {"host": "127.0.0.1", "port": drive.port}}],
            "axes": [axis("drive", {"address": "holding:100"}, {"address": "holding:110", "data_type": "float32"})],
        }
        with structlog.testing.capture_logs() as lines:
            async with scanning(document) as scans:
                await scans.until("A.WriteState", WriteState.WRITTEN)
                assert float(await drive.get("holding", 110, "float32")) == 10.5

                await drive.put("holding", 110, 7.0, "float32")  # the PLC's program clamps it
                await scans.until("A.WriteState", WriteState.MISMATCH)
                assert scans.value("Sources.drive.WriteMismatches") == 1

                await drive.put("holding", 100, 3.0, "float32")
                await scans.until("A.WriteState", WriteState.WRITTEN)
                assert float(await drive.get("holding", 110, "float32")) == 3.0
    told = [line for line in lines if line["event"] == "written value reads back different"]
    assert [(line["wrote"], line["found"]) for line in told] == [(10.5, 7.0)]


@pytest.mark.parametrize("mode", ["poll", "subscribe"])
async def test_an_opcua_plc_gives_a_ramp_back_as_it_was_written(mode, tmp_path):
    plc = NodePlc(tmp_path)
    try:
        node = "nsu=urn:softplc:test:plc;s=PLC.Axis."
        document = {
            "sources": [{"type": "opcua", "name": "plc", "url": plc.url, "mode": mode}],
            "axes": [axis("plc", {"node": f"{node}Ramp"}, {"node": f"{node}Target"}, every_scans=1)],
        }
        async with scanning(document) as scans:
            await scans.until("A.WriteState", WriteState.WRITTEN)
            await eventually(lambda: scans.value("Sources.plc.Writes") > 20, 30.0)
            assert scans.value("Sources.plc.WriteMismatches") == 0
    finally:
        plc.close()
