"""The register map as a document: CSV, Markdown or JSON, all from the rows that the server serves."""

import csv
import io
import json
from typing import Final, Literal

from softplc.publishers.modbus.rows import RegisterMap, Row, Section

Format = Literal["csv", "md", "json"]
COLUMNS: Final = ("address", "input", "holding", "registers", "type", "order", "name", "unit", "description")


def render(register_map: RegisterMap, form: Format, byte_order: str = "ABCD") -> str:
    """The whole map as text that ends with a line feed; `byte_order` is the publisher's."""
    if form == "csv":
        return _csv(register_map, byte_order)
    if form == "json":
        return _json(register_map, byte_order)
    return "\n".join(_markdown(section, byte_order) for section in register_map.sections)


def _cells(row: Row, byte_order: str) -> tuple[int | str, ...]:
    """One row in the order of COLUMNS; a value of one register has no byte order."""
    order = byte_order if row.registers > 1 else ""
    return (
        row.address,
        row.input,
        row.holding,
        row.registers,
        row.type.value,
        order,
        row.name,
        row.unit,
        row.description,
    )


def _csv(register_map: RegisterMap, byte_order: str) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows(_cells(row, byte_order) for row in register_map.rows)
    return text.getvalue()


def _json(register_map: RegisterMap, byte_order: str) -> str:
    rows = [dict(zip(COLUMNS, _cells(row, byte_order), strict=True)) for row in register_map.rows]
    whole = {"size": register_map.size, "crc": register_map.crc, "byte_order": byte_order, "registers": rows}
    return json.dumps(whole, ensure_ascii=False, indent=1) + "\n"


def _markdown(section: Section, byte_order: str) -> str:
    """A heading and a table for one block."""
    lines = [
        f"### {section.name}: registers {section.first}…{section.last}\n",
        f"| {' | '.join(COLUMNS)} |",
        f"|{'---|' * len(COLUMNS)}",
    ]
    for row in section.rows:
        cells = [str(cell).replace("|", "\\|") for cell in _cells(row, byte_order)]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"
