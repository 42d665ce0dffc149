"""What docs/observers/shadow.md shows as configuration loads as it stands."""

import json
import re
from pathlib import Path

from ruamel.yaml import YAML

from softplc.config.load import load
from softplc.emulator.scenario import Scenario

PAGE = (Path(__file__).parents[2] / "docs/observers/shadow.md").read_text(encoding="utf-8")
PLANT, PLC = re.findall(r"```yaml\n(.*?)```", PAGE, flags=re.DOTALL)


def test_the_plant_loads(tmp_path: Path):
    file = tmp_path / "softplc.yaml"
    source = 'sources:\n  - {name: plc, type: opcua, url: "opc.tcp://127.0.0.1:4841"}\n'
    file.write_text(source + PLANT, encoding="utf-8")
    (axis,) = load(file).axes
    assert axis.shadow is not None
    assert axis.shadow.quantities == ("position", "velocity")


def test_the_emulated_plc_loads():
    scenario = Scenario.model_validate_json(json.dumps(YAML(typ="safe").load(PLC) | {"opcua": {}}))
    assert scenario.axes[0].aoi is not None
