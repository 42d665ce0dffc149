"""`softplc check --connect`: what is right is left alone, and what cannot be meant is told with what would be."""

import asyncio
import json

from softplc.app.budget import budgets, warnings
from softplc.app.checking import read_once
from softplc.app.layout import build_layout
from softplc.config.models import Config
from softplc.drivers.modbus.config import ModbusSource
from softplc.drivers.modbus.driver import ModbusDriver
from softplc.drivers.opcua.config import OpcUaSource
from tests.drivers_modbus.support import running_peer
from tests.support.network import free_port
from tests.support.proxy import Proxy

OBSERVER = {"type": "aoi", "q_x": 0.001, "q_x_dot": 0.5, "r_x": 0.01}


def axis(name: str, **tag: object) -> dict[str, object]:
    return {"name": name, "range": [-500, 500], "observer": OBSERVER, "input": {"source": "plc", **tag}}


async def test_orders_neighbours_types_and_tables_are_told_and_nothing_of_what_is_right():
    async with running_peer() as peer:
        for table in ("holding", "input"):
            for offset, value in ((0, 123.456), (2, 310.5), (10, -77.125), (12, 12.5)):
                if table == "holding" or offset < 10:
                    await peer.put(table, offset, value, "float32", "CDAB")
        await peer.put("holding", 20, -321, "int32", "CDAB")
        axes = [
            axis("Right", address="holding:0", byte_order="CDAB"),
            axis("Order", address="holding:0"),
            axis("Beside", address="holding:13", byte_order="CDAB"),
            axis("Type", address="holding:20", byte_order="CDAB"),
            axis("RightCount", address="holding:20", data_type="int32", byte_order="CDAB"),
        ]
        document = {
            "tasks": [{"name": "main", "period_ms": 50.0}],
            "sources": [{"type": "modbus", "name": "plc", "transport": {"host": "127.0.0.1", "port": peer.port}}],
            "axes": axes,
            "publishers": [],
        }
        rows, texts, _ = await asyncio.to_thread(read_once, Config.model_validate_json(json.dumps(document)))

    told = {text.partition(":")[0]: text for text in texts}
    assert set(told) == {"Order.Raw", "Beside.Raw", "Type.Raw"}
    assert "byte_order: CDAB reads 123.456" in told["Order.Raw"]
    assert "the axis' range is -500 … 500" in told["Order.Raw"]
    assert "address: 40013 / holding:12 reads 12.5" in told["Beside.Raw"]
    assert "data_type: int32" in told["Type.Raw"]
    assert "reads -321" in told["Type.Raw"]
    by_name = {row["tag"]: row for row in rows}
    assert by_name["Right.Raw"]["quality"] == "Good"
    assert by_name["Right.Raw"]["new_per_s"] == 0.0  # it stands still


def test_every_driver_is_built_before_the_first_opens(monkeypatch):
    """Building one imports its library, asyncua for half a second and more: as long as a handshake may take."""
    events = []

    def told(kind: type, name: str, event: str) -> None:
        original = getattr(kind, name)

        def wrapped(*arguments: object) -> object:
            events.append(event)
            return original(*arguments)

        monkeypatch.setattr(kind, name, wrapped)

    told(ModbusSource, "build", "built")
    told(OpcUaSource, "build", "built")
    told(ModbusDriver, "open", "opens")
    port = free_port()  # nobody listens
    document = {
        "sources": [
            {"type": "modbus", "name": "plc", "transport": {"host": "127.0.0.1", "port": port}},
            {"type": "opcua", "name": "ua", "url": f"opc.tcp://127.0.0.1:{port}"},
        ],
        "axes": [
            axis("A", address="holding:0"),
            {"name": "B", "observer": OBSERVER, "input": {"source": "ua", "node": "ns=2;s=B"}},
        ],
    }

    rows, _, answers = read_once(Config.model_validate_json(json.dumps(document)))

    assert events == ["built", "built", "opens"]
    assert all(row["error"] for row in rows)
    assert answers == {}


async def test_the_answer_of_a_source_is_measured_for_the_budget():
    async with running_peer() as peer, Proxy(peer.port) as proxy:
        proxy.delay = 0.02  # either way
        document = {
            "sources": [{"type": "modbus", "name": "plc", "transport": {"host": "127.0.0.1", "port": proxy.port}}],
            "axes": [axis("A", address="holding:0")],
        }
        config = Config.model_validate_json(json.dumps(document))
        found = await asyncio.to_thread(read_once, config)

    ((place, answer),) = found.answers.items()
    assert place == ("main", "plc")
    assert answer >= 38.0  # ms; timers may be a little early
    (predicted,) = budgets(build_layout(config), answers=found.answers)
    assert predicted.slowest.basis == "measured"
    assert "the answer of plc was measured to take" in next(warnings((predicted,)))
