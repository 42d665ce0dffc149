"""The register map of a publisher, and the same as a document: CSV, Markdown or JSON."""

import csv
import io
import json
from typing import Final

from softplc.publishers.modbus.config import ModbusPublisher
from softplc.publishers.modbus.layout import layout
from softplc.publishers.modbus.rows import ByteOrder, RegisterMap, Row, Section
from softplc.tags import TagTable

COLUMNS: Final = ("address", "input", "holding", "registers", "type", "order", "name", "unit", "description")


def build_map(table: TagTable, config: ModbusPublisher) -> RegisterMap:
    """The map that this publisher serves. Raises PlacementError when blocks overlap or do not fit."""
    return layout(table, [(placed.axis, placed.address) for placed in config.placements], config.byte_order)


def render(register_map: RegisterMap, style: str) -> str:
    """The whole map as text that ends with a line feed; `style` is csv, md or json."""
    return {"csv": _csv, "md": _markdown, "json": _json}[style](register_map)


def _cells(row: Row, byte_order: ByteOrder) -> tuple[int | str, ...]:
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


def _csv(register_map: RegisterMap) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows(_cells(row, register_map.byte_order) for row in register_map.rows)
    return text.getvalue()


def _json(register_map: RegisterMap) -> str:
    rows = [dict(zip(COLUMNS, _cells(row, register_map.byte_order), strict=True)) for row in register_map.rows]
    whole = {"size": register_map.size, "crc": register_map.crc, "registers": rows}
    return json.dumps(whole, ensure_ascii=False, indent=1) + "\n"


def _markdown(register_map: RegisterMap) -> str:
    return "\n".join(_table(section, register_map.byte_order) for section in register_map.sections)


def _table(section: Section, byte_order: ByteOrder) -> str:
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
