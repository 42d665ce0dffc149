"""docs/emulator.md: its tables are those of the code, and its CI example runs as it stands."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from softplc.cli.emulated import block
from softplc.config.load import load_model
from softplc.config.reference import renewed
from softplc.config.schema import schema
from softplc.emulator import modbus_map, opcua_server
from softplc.emulator.scenario import Scenario
from tests.emulator.scenarios import scenario
from tests.support.network import free_port
from tests.support.program import ROOT, environment

TEXT = (ROOT / "docs" / "emulator.md").read_text(encoding="utf-8")
EVERYTHING = scenario({"name": "AxisX", "aoi": {}, "motion": {"type": "bounce", "velocity": 1.0, "gravity": 1.0}})


def test_the_tables_of_keys_are_made_from_the_models() -> None:
    assert renewed(TEXT, Scenario) == TEXT, "run python -m softplc.config.reference in the project's folder"
    top = schema(Scenario)
    keys = {key for part in [top, *top["$defs"].values()] for key in part["properties"]}
    assert [key for key in sorted(keys) if f"| `{key}` |" not in TEXT] == []


def test_every_register_and_bit_stands_on_the_page_with_its_type() -> None:
    rows = modbus_map.rows(EVERYTHING)
    shown = {f"| `{row.table}:{row.offset}` {row.name.rpartition('.')[2]} | {row.data_type} |" for row in rows}
    assert [row for row in sorted(shown) if row not in TEXT] == []
    assert len(re.findall(r"^\| `(?:holding|coil|discrete):", TEXT, re.M)) == len(rows)


def test_every_node_stands_on_the_page_with_its_type() -> None:
    program = EVERYTHING.axes[0].aoi.model_copy(update={"precision": "lreal"})
    nodes = [*opcua_server._AXIS_NODES, opcua_server._CONTACT, *opcua_server._aoi_nodes(program)]
    shown = {f"| `ns=2;s=AxisX.{node.name}` | {node.variant.name} |" for node in nodes}
    assert [row for row in sorted(shown) if row not in TEXT] == []
    assert len(re.findall(r"^\| `ns=2;s=", TEXT, re.M)) == len(nodes) + 1  # and the heartbeat


def test_what_it_prints_is_what_the_page_shows() -> None:
    chosen = load_model(ROOT / "config" / "end_stops_plc.yaml", Scenario)
    endpoints = [("opcua", "opc.tcp://127.0.0.1:4841"), ("modbus", "tcp://127.0.0.1:5021")]
    assert "\n".join(block("emulated PLC config/end_stops_plc.yaml", chosen, endpoints)) in TEXT


def test_its_links_lead_somewhere() -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", TEXT):
        assert (ROOT / "docs" / target).exists(), target


@pytest.mark.timeout(240)
def test_the_example_for_ci_passes(tmp_path: Path) -> None:
    ports = {port: str(free_port()) for port in ("5021", "5020")}
    for name, text in re.findall(r"<!-- file: (\S+) -->\n```\w+\n(.*?)```", TEXT, re.S):
        own = re.sub("|".join(ports), lambda port: ports[port[0]], text)
        (tmp_path / name).write_text(own, encoding="utf-8")
    (tmp_path / "bin").mkdir()
    for name, words in (("softplc", "-m softplc"), ("python", "")):
        program = tmp_path / "bin" / name
        program.write_text(f'#!/bin/sh\nexec "{sys.executable}" {words} "$@"\n', encoding="utf-8")
        program.chmod(0o755)

    path = f"{tmp_path / 'bin'}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "job.sh"],
        cwd=tmp_path,
        env=environment(PATH=path),
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
