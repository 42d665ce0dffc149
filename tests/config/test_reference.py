"""docs/configuration.md: its tables are the generated ones, its examples load, its report is the real one."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from softplc.config.load import load
from softplc.config.models import Config
from softplc.config.reference import renewed
from softplc.config.schema import schema
from softplc.errors import ConfigError

PAGE = Path(__file__).parents[2] / "docs/configuration.md"
TEXT = PAGE.read_text(encoding="utf-8")
EXAMPLES = re.findall(r"(?<!wrong\.yaml -->\n)```yaml\n(.*?)```", TEXT, re.S)
REST: dict[str, Any] = {
    "sources": [
        {"name": "plc1", "type": "opcua", "url": "opc.tcp://192.168.0.10:4840"},
        {"name": "plc2", "type": "modbus", "transport": {"host": "192.168.0.11"}},
    ],
    "axes": [
        {
            "name": "AxisX",
            "input": {"source": "plc1", "node": "ns=2;s=AxisX.Position"},
            "observer": {"type": "aoi", "r_x": 1},
        }
    ],
}


def test_the_tables_are_the_generated_ones() -> None:
    assert renewed(TEXT) == TEXT, "run python -m softplc.config.reference in the project's folder"


def test_every_block_and_key_of_the_schema_is_in_the_tables() -> None:
    top = schema(Config)

    for block in [top, *top["$defs"].values()]:
        for key in block["properties"]:
            assert f"| `{key}` |" in TEXT


@pytest.mark.parametrize("number", range(len(EXAMPLES)))
def test_an_example_loads_beside_what_it_leaves_out(number: int, tmp_path: Path) -> None:
    path = tmp_path / "example.yaml"
    path.write_text(json.dumps(REST | YAML(typ="safe", pure=True).load(EXAMPLES[number])), encoding="utf-8")

    assert load(path).axes


def test_the_report_of_the_wrong_example_is_the_real_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    example = re.search(r"<!-- example: wrong.yaml -->\n```yaml\n(.*?)```", TEXT, re.S)
    shown = re.search(r"<!-- report: wrong.yaml -->\n```\n(.*?)```", TEXT, re.S)
    assert example is not None
    assert shown is not None
    Path("wrong.yaml").write_text(example[1], encoding="utf-8")

    with pytest.raises(ConfigError) as raised:
        load("wrong.yaml")

    assert list(raised.value.lines) == shown[1].splitlines()


def test_links_lead_to_headings_and_files() -> None:
    headings = re.findall(r"^#+ (.*)$", TEXT, re.M)
    anchors = {
        "".join(letter for letter in heading.lower() if letter.isalnum() or letter in " -_").replace(" ", "-")
        for heading in headings
    }

    for target in re.findall(r"\]\(([^)]+)\)", TEXT):
        if target.startswith("#"):
            assert target[1:] in anchors
        else:
            assert (PAGE.parent / target).exists(), target
