"""A PLC whose server answers while its program stands still, over OPC-UA and Modbus."""

import asyncio
import itertools
import json
from collections.abc import Iterator

import pytest
from asyncua import ua

from softplc.config.models import Config
from softplc.sample import Reason, StatusCode
from tests.chaos.rig import running
from tests.drivers_modbus.support import running_peer
from tests.drivers_opcua.paths import every_path, on
from tests.drivers_opcua.servers import AsyncuaPlc
from tests.links.plant import PATIENCE, Plant, add, number, plant

V = ua.VariantType
TYPES = {
    V.Boolean: (False, True),
    V.Byte: (254, 255, 0, 1),
    V.Int16: (32766, 32767, -32768, -32767),
    V.UInt32: (2**32 - 1, 0),
    V.Int64: (2**63 - 1, -(2**63)),
    V.Float: (0.25, 0.5),
}
STOPPED = (StatusCode.UNCERTAIN_LAST_USABLE_VALUE, Reason.PROGRAM_STOPPED)
LOST = (StatusCode.BAD_OUT_OF_SERVICE, Reason.PROGRAM_STOPPED)


@pytest.fixture(scope="module")
def plc() -> Iterator[AsyncuaPlc]:
    server = AsyncuaPlc()
    server.run(add(server, ["A", "B", "Beat"]))
    yield server
    server.close()


async def judge(axes: Plant, names: list[str]) -> None:
    """From alive to lost and back: every axis of the source, in this order and none of it Good."""

    def all_show(what: tuple[int, int]) -> bool:
        return all((axes.shown[name].status, axes.shown[name].reason) == what for name in names)

    await axes.until(lambda: all_show(STOPPED), "Uncertain")
    assert axes.value("Sources.plc.Heartbeat") == 0.0
    mark = {name: len(axes.history[name]) for name in names}
    await axes.until(lambda: all_show(LOST), "Bad")
    for name in names:
        told = [(seen.status, seen.reason) for seen in axes.history[name][mark[name] :]]
        assert [each for each, _ in itertools.groupby(told)] == [STOPPED, LOST]


@every_path
async def test_a_program_that_stops_is_seen_whatever_type_its_heartbeat_has(plc: AsyncuaPlc, path: str):
    for number_of_run, (variant_type, values) in enumerate(TYPES.items()):
        turns = itertools.cycle(values)

        def beat(turns: Iterator[object] = turns, kind: ua.VariantType = variant_type) -> None:
            plc.write("Beat", ua.DataValue(ua.Variant(next(turns), kind)))

        beat()
        for name in ("A", "B"):
            plc.write(name, number(5.0))
        settings: dict[str, object] = {"heartbeat": {"node": f"ns={plc.index};s=Beat", "timeout_ms": 300.0}}
        settings["queue_size"] = 20 + number_of_run  # another source: this one remembers no types
        with on(path) as mode:
            async with plant(plc, ["A", "B"], mode, keep=True, source=settings) as axes:
                await axes.until(lambda: all(s.status == 0 for s in axes.shown.values()) and bool(axes.shown), "Good")
                for _ in range(12):  # twice the limit
                    beat()
                    await axes.scan()
                assert axes.value("Sources.plc.Heartbeat") == 1.0
                assert {seen.reason for seen in axes.history["A"][-4:]} == {Reason.NONE}
                if variant_type in (V.Boolean, V.Int64):
                    await judge(axes, ["A", "B"])
                    async with asyncio.timeout(PATIENCE):  # values that stand still take the limit to settle
                        while not all(shown.status == 0 for shown in axes.shown.values()):
                            beat()
                            await axes.scan()


async def test_a_modbus_device_whose_program_stops_is_seen_by_its_heartbeat_register():
    async with running_peer() as peer:
        await peer.put("holding", 0, 5.0, "float32")
        observer = {"type": "aoi", "q_x": 0.001, "q_x_dot": 0.5, "r_x": 0.01}
        source = {"type": "modbus", "name": "plc", "transport": {"host": "127.0.0.1", "port": peer.port}}
        document = {
            "tasks": [{"name": "main", "period_ms": 50.0}],
            "sources": [{**source, "timeout_ms": 20_000, "heartbeat": {"address": "holding:9", "timeout_ms": 300}}],
            "axes": [{"name": "A", "input": {"source": "plc", "address": "holding:0"}, "observer": observer}],
            "publishers": [],
        }
        config = Config.model_validate_json(json.dumps(document))
        async with running(config) as task:
            axes = Plant(task, config, keep=True)
            count = itertools.count(65530)
            await peer.put("holding", 9, next(count) % 65536, "uint16")
            await axes.until(lambda: bool(axes.shown) and axes.shown["A"].status == 0, "Good")
            for _ in range(12):
                await peer.put("holding", 9, next(count) % 65536, "uint16")
                await axes.scan()
            assert axes.value("Sources.plc.Heartbeat") == 1.0
            await judge(axes, ["A"])
            await peer.put("holding", 9, next(count) % 65536, "uint16")
            await axes.until(lambda: axes.shown["A"].status == 0, "Good again")
            assert "Sources.plc.Skew" not in axes.index  # Modbus carries no time
