"""docs/modbus-map.md shows what the code does: its tables are made by the code. Running this module writes them."""

import re
import struct
from pathlib import Path

import numpy as np

from softplc.observers.axes import axis_tags
from softplc.publishers.modbus.map import build_map, render
from softplc.sample import REASON_TEXT, Reason, StatusCode
from softplc.scan import source_tags, task_tags
from softplc.tags import TagTable
from tests.publishers_modbus.support import any_port, to_abcd
from tests.support.exchange import AXES, OBSERVER

DOCUMENT = Path(__file__).parent.parent.parent / "docs" / "modbus-map.md"
INDENT = "   "  # the table of orders stands in a numbered list


def standard_map() -> str:
    table = TagTable()
    table.add_block("main", "task", task_tags("main"))
    table.add_block("plc1", "source", source_tags("plc1", heartbeat=True, skew=True))
    table.add_block("AxisX", "axis", axis_tags(AXES[0], OBSERVER))
    table.close_section("main")
    return render(build_map(table, any_port()), "md")


def reasons() -> str:
    rows = [f"| {reason.value} | {REASON_TEXT[reason] or 'nothing to say'} |" for reason in Reason]
    return "\n".join(["| Reason | means |", "|---|---|", *rows, ""])


def statuses() -> str:
    rows = [f"| {code:08X} | {code} | {code.name.title().replace('_', '')} |" for code in sorted(StatusCode)]
    return "\n".join(["| hexadecimal | decimal | StatusCode |", "|---|---|---|", *rows, ""])


def orders() -> str:
    def read(value: float, order: str) -> np.float32:
        return np.frombuffer(to_abcd(struct.pack(">f", value), order), ">f4").astype(np.float32)[0]

    lines = [
        "| registers 2, 3 | registers 4, 5 | the server sends | 1.0 read as ABCD | −123.456 read as ABCD |",
        "|---|---|---|---|---|",
    ]
    for order in ("ABCD", "CDAB", "BADC", "DCBA"):
        one, negative = (to_abcd(struct.pack(">f", value), order).hex(" ", 2).upper() for value in (1.0, -123.456))
        lines.append(f"| {one} | {negative} | {order} | {read(1.0, order):g} | {read(-123.456, order):g} |")
    return "\n".join(f"{INDENT}{line}" for line in lines) + "\n"


PARTS = {"orders": orders, "reasons": reasons, "statuses": statuses, "map": standard_map}


def written(document: str, part: str) -> str:
    """What stands between the marks of a part."""
    found = re.search(rf"<!-- begin {part} -->\n(.*?) *<!-- end {part} -->", document, re.DOTALL)
    assert found is not None, f"no marks for {part}"
    return found.group(1).strip("\n")


def test_the_tables_of_the_document_are_those_of_the_code():
    document = DOCUMENT.read_text(encoding="utf-8")
    for part, make in PARTS.items():
        assert make().strip("\n") == written(document, part), f"run python -m {__name__} in the folder of the project"


def write() -> None:
    document = DOCUMENT.read_text(encoding="utf-8")
    for part, make in PARTS.items():
        indent = INDENT if part == "orders" else ""
        marks = rf"<!-- begin {part} -->\n.*?<!-- end {part} -->"
        text = f"<!-- begin {part} -->\n\n{make().strip(chr(10))}\n\n{indent}<!-- end {part} -->"
        document = re.sub(marks, lambda _, text=text: text, document, flags=re.DOTALL)
    DOCUMENT.write_text(document, encoding="utf-8")


if __name__ == "__main__":
    write()
