"""From the tag table to the register map: one row for each served value; pure.

Every tag has a fixed offset within its block (`offsets.py`). A tag without one takes a free register at the end of
its block: values of two or more registers from the front, single registers from the back.
"""

import binascii
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Final

from softplc.publishers.modbus.offsets import FRAMES, Frame
from softplc.publishers.modbus.placement import HEADER, PlacementError, place
from softplc.publishers.modbus.rows import TYPE_OF, ByteOrder, Origin, RegisterMap, RegisterType, Row, Section
from softplc.tags import Block, DataType, Tag, TagTable

VERSION: Final = 1  # of the layout itself; the map of one plant is told by its CRC
CHECK_WORD: Final = 0x1234
CHECK_ONE: Final = 1.0
CHECK_NEGATIVE: Final = -123.456
_CRC: Final = "MapCrc"


def layout(
    table: TagTable, placements: Sequence[tuple[str, int]] = (), byte_order: ByteOrder = "ABCD"
) -> RegisterMap:
    """The map of a tag table; `placements` are (axis, first register).

    Tasks, sources and axes follow in the order of the table. Raises PlacementError when blocks overlap or do not
    fit, or when a block has more tags than registers.
    """
    blocks = {kind: [block for block in table.blocks if block.kind == kind] for kind in FRAMES}
    axes = [block.name for block in blocks["axis"]]
    starts = place(len(blocks["task"]), len(blocks["source"]), axes, placements)
    sections = [_header(table, blocks)]
    for kind, frame in FRAMES.items():
        for number, block in enumerate(blocks[kind]):
            start = starts[block.name] if kind == "axis" else frame.area.address(number)
            sections.append(_section(table, block, frame, start))
    sections.sort(key=lambda section: section.first)
    crc = _crc(sections)
    sections[0] = _with_crc(sections[0], crc)
    return RegisterMap(tuple(sections), sections[-1].last + 1, crc, byte_order)


def _header(table: TagTable, blocks: Mapping[str, Sequence[Block]]) -> Section:
    """The first hundred registers."""

    def constant(address: int, name: str, kind: RegisterType, value: float, description: str) -> Row:
        return Row(address, name, kind, "", description, Origin.CONSTANT, value=value)

    if not blocks["task"]:
        raise PlacementError([(None, "there is no task, so there is no heartbeat to serve")])
    heartbeat = blocks["task"][0].index("Heartbeat")
    rows = (
        constant(0, "CheckWord", RegisterType.UINT16, CHECK_WORD, "Always 4660 = 0x1234: the address is right"),
        constant(1, "MapVersion", RegisterType.UINT16, VERSION, "Version of this layout"),
        constant(2, "CheckOne", RegisterType.FLOAT32, CHECK_ONE, "Always 1.0: the word order is right"),
        constant(4, "CheckNegative", RegisterType.FLOAT32, CHECK_NEGATIVE, "Always -123.456: so is the byte order"),
        constant(6, _CRC, RegisterType.UINT16, 0, "Checksum of this map; another value means another map"),
        Row(7, "Heartbeat", RegisterType.UINT16, "", "Heartbeat of the first task", Origin.TAG, heartbeat),
        constant(8, "Axes", RegisterType.UINT16, len(blocks["axis"]), "How many axes there are"),
        constant(9, "Tasks", RegisterType.UINT16, len(blocks["task"]), "How many tasks there are"),
        constant(10, "Sources", RegisterType.UINT16, len(blocks["source"]), "How many sources there are"),
        Row(
            11,
            "Alive",
            RegisterType.UINT16,
            "",
            "1 while every task scans, 0 when one stands still",
            Origin.ALL_ALIVE,
        ),
    )
    return Section("Header", HEADER.start, HEADER.stop - 1, rows)


def _section(table: TagTable, block: Block, frame: Frame, start: int) -> Section:
    """The rows of one block."""
    offsets = _offsets(block, frame)
    rows = [
        _row(start + offset, tag, block.start + number)
        for number, (tag, offset) in enumerate(zip(block.tags, offsets, strict=True))
        if offset is not None
    ]
    leaves = {_leaf(tag): block.start + number for number, tag in enumerate(block.tags)}
    prefix = block.tags[0].name.rpartition(".")[0]
    for extra in frame.derived:
        if extra.of in leaves and extra.leaf not in leaves:
            index = table.section_of(block.start) if extra.origin is Origin.ALIVE else leaves[extra.of]
            name = f"{prefix}.{extra.leaf}"
            rows.append(
                Row(start + extra.offset, name, extra.type, extra.unit, extra.description, extra.origin, index)
            )
    rows.sort(key=lambda row: row.address)
    for row, following in pairwise(rows):
        if row.address + row.registers > following.address:
            raise PlacementError([(None, f"{row.name} and {following.name} share register {following.address}")])
    return Section(prefix, start, start + frame.area.stride - 1, tuple(rows))


def _offsets(block: Block, frame: Frame) -> list[int | None]:
    """The offset of each tag of a block: fixed by its leaf, else the next free one; None for one without register."""
    taken = _taken(block, frame)
    offsets: list[int | None] = []
    for tag in block.tags:
        fixed = frame.offsets.get(_leaf(tag))
        width = TYPE_OF[tag.data_type].registers
        if fixed is not None:
            offsets.append(fixed)
        elif _leaf(tag) in frame.absent:
            offsets.append(None)
        else:
            found = _free(frame, taken, width)
            if found is None:
                raise PlacementError([(None, f"{tag.name}: no register left in a block of {frame.area.stride}")])
            offsets.append(found)
            taken.update(range(found, found + width))
    return offsets


def _taken(block: Block, frame: Frame) -> set[int]:
    """Offsets that the block's tags with fixed ones occupy."""
    fixed = [(frame.offsets.get(_leaf(tag)), TYPE_OF[tag.data_type].registers) for tag in block.tags]
    return {offset for first, width in fixed if first is not None for offset in range(first, first + width)}


def _free(frame: Frame, taken: set[int], width: int) -> int | None:
    """The first free run of so many registers, the last one for a single register; None where there is none."""
    offsets = reversed(frame.free) if width == 1 else frame.free
    for first in offsets:
        run = range(first, first + width)
        if run.stop <= frame.free.stop and taken.isdisjoint(run):
            return first
    return None


def _row(address: int, tag: Tag, index: int) -> Row:
    kind = TYPE_OF[tag.data_type]
    boolean = tag.data_type is DataType.BOOLEAN
    description = f"{tag.description}: 1 yes, 0 no" if boolean else tag.description
    return Row(address, tag.name, kind, tag.unit, description, Origin.TAG, index, boolean=boolean)


def _leaf(tag: Tag) -> str:
    return tag.name.rpartition(".")[2]


def _crc(sections: Sequence[Section]) -> int:
    """CRC-16/CCITT-FALSE of one line `address type name` for each row, lines ended by a line feed."""
    lines = [f"{row.address} {row.type} {row.name}\n" for section in sections for row in section.rows]
    return binascii.crc_hqx("".join(lines).encode(), 0xFFFF)


def _with_crc(header: Section, crc: int) -> Section:
    rows = tuple(replace(row, value=crc) if row.name == _CRC else row for row in header.rows)
    return replace(header, rows=rows)
