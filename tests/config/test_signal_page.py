"""What the page of signal conditioning shows as configuration loads as it stands, and is what is shipped."""

import re
from pathlib import Path

from softplc.config.load import load

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "signal.md").read_text(encoding="utf-8")
_PLANT = """\
sources:
  - {name: plc, type: modbus, transport: {host: 127.0.0.1, port: 5021}}
publishers:
  - type: modbus
"""


def test_its_examples_load_and_are_those_of_the_shipped_file(tmp_path: Path):
    shipped = {axis.name: axis for axis in load(ROOT / "config" / "signal.yaml").axes}
    for example in re.findall(r"```yaml\n(.*?)```", PAGE, flags=re.DOTALL):
        file = tmp_path / "softplc.yaml"
        file.write_text(_PLANT + example, encoding="utf-8")
        (axis,) = load(file).axes
        assert axis == shipped.pop(axis.name)
    assert not shipped


def test_its_links_lead_somewhere():
    for target in re.findall(r"\]\(([^)#]+)\)", PAGE):
        assert (ROOT / "docs" / target).exists(), target
