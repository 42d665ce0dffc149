"""What the pages of docs/observers show as configuration loads as it stands."""

import re
from pathlib import Path

import pytest

from softplc.config.load import load

ROOT = Path(__file__).parents[2]
PAGES = ("baselines.md", "cv_accel.md", "ducekf.md")
_PLANT = """\
sources:
  - {name: plc1, type: opcua, url: "opc.tcp://127.0.0.1:4841"}
publishers:
  - type: opcua
"""


@pytest.mark.parametrize("page", PAGES)
def test_its_example_loads(page: str, tmp_path: Path):
    text = (ROOT / "docs/observers" / page).read_text(encoding="utf-8")
    (example,) = re.findall(r"```yaml\n(.*?)```", text, flags=re.DOTALL)
    file = tmp_path / "softplc.yaml"
    file.write_text(_PLANT + example, encoding="utf-8")

    assert len(load(file).axes) == example.count("- name:")
