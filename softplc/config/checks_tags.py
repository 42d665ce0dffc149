"""Tags against their sources (protocol, address, data type, byte order) and against each other (overlaps, loops)."""

from collections.abc import Iterator
from typing import Final

from softplc.config.checks_loops import loops
from softplc.config.checks_names import at
from softplc.config.facts import KEY_OF_KIND, Facts, Item, TagUse
from softplc.config.problem import LONG, Problem, shown
from softplc.config.spans import Span, by_table, canonical, device_of, key_of
from softplc.config.tree import Scalar, below, text_at, where
from softplc.drivers.modbus.address import LAST_OFFSET, Address, parse_address
from softplc.drivers.modbus.config import ModbusHeartbeat, ModbusTag
from softplc.drivers.opcua.node import parse_address as parse_node

REGISTERS: Final = {
    "bool": 1,
    "int16": 1,
    "uint16": 1,
    "int32": 2,
    "uint32": 2,
    "float32": 2,
    "int64": 4,
    "uint64": 4,
    "float64": 4,
}
_DEFAULT_TYPE: Final[str] = ModbusTag.model_fields["data_type"].default
_TYPE_OF_HEARTBEAT: Final[str] = ModbusHeartbeat.model_fields["data_type"].default


def check(facts: Facts) -> Iterator[Problem]:
    """All problems with tags."""
    spans: list[Span] = []
    for tag in facts.tags:
        source = facts.source_of(tag)
        if source is not None and tag.kind not in facts.kinds_named.get(source.name or "", ()):
            yield from _protocol(tag, source)
        if tag.kind == "modbus":
            yield from _modbus(tag, source, spans)
        elif tag.kind == "opcua":
            yield from _opcua(tag, source, spans)
        if tag.role == "write_back":
            yield from _recording(tag, source, facts)
    yield from _overlaps([span for span in spans if span.tag.role != "write_back"], partial=True)
    yield from _overlaps([span for span in spans if span.tag.role == "write_back"], partial=False)
    yield from loops(spans)
    for item in facts.sources:
        if item.text("type") == "modbus":
            yield from _split(item, facts)


def _problem(tag: TagUse, key: str, text: str) -> Problem:
    return Problem(*at(below(tag.block, key), tag.block), (*tag.path, key), text)


def _protocol(tag: TagUse, source: Item) -> Iterator[Problem]:
    kind = source.text("type")
    if tag.kind is None or kind not in KEY_OF_KIND:
        return
    entry = tag.block.entries[key_of(tag)]
    named = shown(source.name or "")
    text = f"found {key_of(tag)}, but {named} is a source of type {kind}, expected {KEY_OF_KIND[kind]}"
    yield Problem(entry.line, entry.column, (*tag.path, key_of(tag)), text)


def _recording(tag: TagUse, source: Item | None, facts: Facts) -> Iterator[Problem]:
    if tag.kind == "replay" or (source is not None and source.text("type") == "replay"):
        yield _problem(tag, "source", "found a recording, expected a source that can be written")
        return
    fed_by = facts.source_named.get(text_at(tag.axis.block, "input", "source") or "")
    if fed_by is not None and fed_by.text("type") == "replay":
        name = shown(tag.axis.name or "")
        yield _problem(tag, "source", f"found a write-back of {name}, which a recording feeds, expected none")


def _modbus(tag: TagUse, source: Item | None, spans: list[Span]) -> Iterator[Problem]:
    node = below(tag.block, "address")
    if tag.role == "input":
        yield from _tells_no_time(tag)
    data_type = _data_type(tag)
    width = REGISTERS.get(data_type or "")
    yield from _byte_order(tag, data_type, width)
    if not isinstance(node, Scalar) or isinstance(node.value, bool) or not isinstance(node.value, int | str):
        return
    try:
        address = parse_address(node.value)
    except ValueError as error:
        yield _problem(tag, "address", shown(str(error), LONG))
        return
    if tag.role == "write_back" and not address.table.writable:
        yield _problem(
            tag, "address", f"found {address}, which nobody can write, expected a holding register or a coil"
        )
    if data_type is None or width is None:
        return
    if address.table.bits and data_type != "bool":
        key = "data_type" if "data_type" in tag.block.entries else "address"
        yield _problem(tag, key, f"found {data_type}, but {address} is a single bit, expected data_type: bool")
        return
    if address.offset + width - 1 > LAST_OFFSET:
        last = Address(address.table, LAST_OFFSET)
        text = f"found {address}, but {data_type} takes {width} registers and {last} is the last"
        yield _problem(tag, "address", f"{text}, expected a lower address")
        return
    if source is not None:
        label = f"{data_type} at {address}"
        spans.append(Span(device_of(source), address.table, address.offset, address.offset + width, tag, label))


def _data_type(tag: TagUse) -> str | None:
    default = _TYPE_OF_HEARTBEAT if tag.role == "heartbeat" else _DEFAULT_TYPE
    return text_at(tag.block, "data_type") if "data_type" in tag.block.entries else default


def _split(source: Item, facts: Facts) -> Iterator[Problem]:
    """A request that is shorter than a value: once for each source, with the first of its widest values."""
    limit = below(source.block, "max_registers")
    most = limit.value if isinstance(limit, Scalar) else None
    if (
        limit is None
        or not isinstance(most, int)
        or isinstance(most, bool)
        or not 1 <= most < max(REGISTERS.values())
    ):
        return
    tags = [tag for tag in facts.tags if tag.kind == "modbus" and facts.source_of(tag) is source]
    widths = [REGISTERS.get(_data_type(tag) or "", 0) for tag in tags]
    width = max(widths, default=0)
    if width > most:
        tag = tags[widths.index(width)]
        what = f"{tag} ({_data_type(tag)}, {where(below(tag.block, 'address') or tag.block)})"
        text = f"found {most}, but {what} takes {width} registers, which one request must bring"
        path = (*source.path, "max_registers")
        yield Problem(*at(limit, limit), path, f"{text}, expected {width} or more")


def _tells_no_time(tag: TagUse) -> Iterator[Problem]:
    limit = below(tag.axis.block, "stale_after_ms")
    if isinstance(limit, Scalar) and limit.value is not None:
        text = "found stale_after_ms with a Modbus input, which has no timestamps, expected heartbeat: of the source"
        yield Problem(*at(limit, tag.block), (*tag.axis.path, "stale_after_ms"), text)


def _byte_order(tag: TagUse, data_type: str | None, width: int | None) -> Iterator[Problem]:
    order = below(tag.block, "byte_order")
    if width == 1 and isinstance(order, Scalar) and order.value is not None:
        found = f"found {shown(order.text)}, but {data_type} is a value of one register, which has no order of words"
        yield _problem(tag, "byte_order", f"{found}, expected none; leave byte_order out")


def _opcua(tag: TagUse, source: Item | None, spans: list[Span]) -> Iterator[Problem]:
    text, index = text_at(tag.block, "node"), below(tag.block, "index")
    if text is None:
        return
    try:
        address = parse_node(text)
    except ValueError as error:
        yield _problem(tag, "node", shown(str(error), LONG))
        return
    if source is not None:
        element = index.value if isinstance(index, Scalar) else None
        spans.append(Span(device_of(source), (canonical(address), element), 0, 1, tag, str(address)))


def _overlaps(spans: list[Span], *, partial: bool) -> Iterator[Problem]:
    """Neighbours that share registers; `partial`: tags that start alike are the same value, read twice."""
    for table in by_table(spans).values():
        table.sort(key=lambda span: (span.start, span.stop))
        furthest = table[0]
        for span in table[1:]:
            if span.start < furthest.stop and not (partial and span.start == furthest.start):
                first, second = sorted((furthest, span), key=lambda each: each.line)
                same = (first.start, first.stop) == (second.start, second.stop)
                how = "is written already" if same else f"overlaps {first.label}"
                text = f"{second.label} {how} ({first.tag}, {first.where}), expected another address"
                yield _problem(second.tag, key_of(second.tag), text)
            if span.stop > furthest.stop:
                furthest = span
