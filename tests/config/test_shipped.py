"""The files in config/: they load, they fit the shipped schema, and they show what they are meant to show."""

import json
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from ruamel.yaml import YAML

from softplc.app.demo import PORTS, demo_config
from softplc.config import schema
from softplc.config.load import load
from softplc.config.models import Config
from softplc.config.remarks import remarks
from softplc.config.source_tag import WritableEnable
from softplc.drivers.modbus.config import ModbusSource, ModbusTag
from softplc.drivers.opcua.config import OpcUaSource, OpcUaTag

FOLDER = Path(__file__).parents[2] / "config"
SCHEMA = FOLDER / "softplc.schema.json"
FILES = (
    "minimal.yaml",
    "demo.yaml",
    "plant.yaml",
    "observers.yaml",
    "end_stops.yaml",
    "signal.yaml",
    "coast.yaml",
    "replay.yaml",
    "thousand.yaml",
    "table.yaml",
)
MODELINE = "# yaml-language-server: $schema=./softplc.schema.json\n"
DRAFTS = {"2020-12": jsonschema.Draft202012Validator, "draft-07, as editors read it": jsonschema.Draft7Validator}


def errors(draft: str, data: Any) -> list[str]:
    validator = DRAFTS[draft](json.loads(SCHEMA.read_text(encoding="utf-8")))
    return [f"{error.json_path}: {error.message}" for error in validator.iter_errors(data)]


@pytest.mark.parametrize("name", FILES)
def test_a_shipped_file_loads_and_names_its_schema(name: str) -> None:
    assert (FOLDER / name).read_text(encoding="utf-8").startswith(MODELINE)
    assert isinstance(load(FOLDER / name), Config)


@pytest.mark.parametrize("name", FILES)
def test_a_shipped_file_crosses_to_the_processes_as_it_is(name: str) -> None:
    config = load(FOLDER / name)
    assert Config.model_validate_json(config.as_json()) == config


def test_the_file_of_all_observers_has_all_of_them_beside_the_one_with_stops() -> None:
    shown = {axis.observer.type for name in ("observers", "end_stops") for axis in load(FOLDER / f"{name}.yaml").axes}
    assert shown == set(schema.schema(Config)["$defs"]["Axis"]["properties"]["observer"][schema.CHOICES])


@pytest.mark.parametrize("draft", DRAFTS)
@pytest.mark.parametrize("name", FILES)
def test_a_shipped_file_is_valid_under_the_shipped_schema(name: str, draft: str) -> None:
    assert errors(draft, YAML(typ="safe", pure=True).load(FOLDER / name)) == []


def test_the_shipped_schema_is_the_generated_one() -> None:
    assert SCHEMA.read_text(encoding="utf-8") == schema.text(), "write schema.text() into config/softplc.schema.json"


@pytest.mark.parametrize("draft", DRAFTS)
def test_the_schema_is_valid_in_both_drafts(draft: str) -> None:
    DRAFTS[draft].check_schema(json.loads(SCHEMA.read_text(encoding="utf-8")))


@pytest.mark.parametrize("draft", DRAFTS)
@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("tasks", 0, "period_ms"), "50"),
        (("sources", 0, "type"), "opcuas"),
        (("sources", 1, "transport", "port"), 70000),
        (("axes", 0, "range"), [1]),
        (("axes", 0, "range"), [1, 2, 3]),
        (("axes", 0, "enable"), {"writable": False}),
        (("axes", 0, "observer", "q_xdot"), 1),
        (("axes", 0, "input", "address"), 40001),
        (("axes", 1, "observer", "r_x"), 0),
        (("publishers", 0, "users"), [{"name": "joe", "password": "hunter2"}]),
    ],
)
def test_the_schema_refuses_what_the_loader_refuses(path: tuple[Any, ...], value: Any, draft: str) -> None:
    data = YAML(typ="safe", pure=True).load(FOLDER / "demo.yaml")
    parent = data
    for key in path[:-1]:
        parent = parent[key]
    parent[path[-1]] = value

    assert errors(draft, data)


def test_minimal_has_at_most_fifteen_lines_and_both_servers() -> None:
    assert len((FOLDER / "minimal.yaml").read_text(encoding="utf-8").splitlines()) <= 15
    assert [publisher.type for publisher in load(FOLDER / "minimal.yaml").publishers] == ["opcua", "modbus"]


def test_demo_is_the_experiment_of_the_paper_over_both_protocols() -> None:
    config = load(FOLDER / "demo.yaml")

    assert [task.period_ms for task in config.tasks] == [50]
    opcua, modbus = config.sources
    assert isinstance(opcua, OpcUaSource)
    assert opcua.url == "opc.tcp://127.0.0.1:4841"
    assert isinstance(modbus, ModbusSource)
    assert (modbus.transport.host, modbus.transport.port) == ("127.0.0.1", 5021)  # type: ignore[union-attr]
    x, y = config.axes
    assert x.input == OpcUaTag(source=opcua.name, node="ns=2;s=AxisX.Position")
    assert y.input == ModbusTag(source=modbus.name, address="holding:120", data_type="float32")
    for axis in (x, y):
        assert axis.unit == "mm"
        assert (axis.observer.q_x, axis.observer.q_x_dot, axis.observer.r_x) == (0.01, 0.1, 1.3333)
    assert [(publisher.type, publisher.port) for publisher in config.publishers] == [
        ("opcua", 4840),
        ("modbus", 5020),
    ]


def test_demo_is_what_the_demo_command_runs() -> None:
    assert load(FOLDER / "demo.yaml") == demo_config(PORTS)


@pytest.mark.parametrize("name", FILES)
def test_a_shipped_file_gives_no_cause_for_remarks(name: str) -> None:
    assert remarks(load(FOLDER / name)) == []


def test_plant_shows_most_of_what_can_be_configured() -> None:
    config = load(FOLDER / "plant.yaml")

    assert len(config.axes) >= 12
    assert len(config.tasks) >= 3
    assert {source.type for source in config.sources} == {"opcua", "modbus"}
    transports = {source.transport.type for source in config.sources if isinstance(source, ModbusSource)}
    assert transports == {"tcp", "rtu", "rtu_over_tcp"}
    assert {type(axis.enable) for axis in config.axes} == {bool, WritableEnable, OpcUaTag, ModbusTag}
    orders = {source.byte_order for source in config.sources if isinstance(source, ModbusSource)}
    assert len(orders | {getattr(axis.input, "byte_order", None) for axis in config.axes} - {None}) >= 3
    assert any(axis.write_back for axis in config.axes)
    assert {axis.dt_source for axis in config.axes} == {"scan", "source", "arrival"}


def test_every_key_has_a_description_and_every_measured_number_a_unit_in_its_title() -> None:
    made = json.loads(SCHEMA.read_text(encoding="utf-8"))

    for name, block in {"Config": made, **made["$defs"]}.items():
        for key, field in block["properties"].items():
            described = field.get("description") or "$ref" in field  # then the block has one
            assert key == "type" or described, f"{name}.{key} has no description"
            if key.endswith(("_ms", "_s")):
                assert field["title"] == f"{key}, {key.rpartition('_')[2]}"
    assert made["$defs"]["AoiConfig"]["properties"]["q_x_dot"]["title"] == "q_x_dot, (unit/s)²"
    assert "Bigger" in made["$defs"]["AoiConfig"]["properties"]["r_x"]["description"]
