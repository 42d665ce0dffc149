"""docs/not-good.md: every Reason stands in its table, and the registers that it names are those of the map."""

import re
from pathlib import Path

from softplc.publishers.modbus.offsets import AXIS, SOURCE
from softplc.sample import Reason

PAGE = (Path(__file__).parents[2] / "docs" / "not-good.md").read_text(encoding="utf-8")


def test_every_reason_has_its_row():
    cells = re.findall(r"^\| ([\d, ]+) \| [^|]+ \| [^|]+ \| [^|]+ \|$", PAGE, flags=re.MULTILINE)
    listed = [int(number) for cell in cells for number in cell.split(",")]

    assert sorted(listed) == sorted(reason for reason in Reason if reason not in (Reason.NONE, Reason.PREDICTED))


def test_the_registers_are_those_of_the_map():
    assert f"| {1000 + SOURCE.offsets['Connected']} is 1 |" in PAGE
    assert f"| {3000 + AXIS.offsets['Reason']}, {3000 + AXIS.offsets['State']} |" in PAGE


def test_its_links_lead_somewhere():
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", PAGE):
        assert (Path(__file__).parents[2] / "docs" / target).exists(), target
