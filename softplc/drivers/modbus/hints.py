"""What a value that makes no sense may be instead: another order, a register beside it, another type or table. Pure.

A wrong address or byte order is no error on Modbus: it reads some number. Only a number that makes no sense is looked
into, and only what makes sense instead, twice, is told: a right configuration hears nothing. NaN and infinity are
what a broken sensor sends; all that is told instead of them is an integer of as many registers within the range.

| read as | makes no sense |
|---|---|
| any type, the axis has a range | outside the range; a float also when it is not 0 and below 10⁻¹² of its width |
| float32, float64, without a range | NaN, infinite, not 0 and below 10⁻⁹ or above 10⁹ by amount |
| integer of several registers, without a range | from 2²⁴ on, in a register that is all 0 or all 1 in its last word |
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from softplc.drivers.modbus.address import LAST_OFFSET, Address, Table
from softplc.drivers.modbus.codec import REGISTERS
from softplc.drivers.modbus.config import ByteOrder, ModbusTag, ModbusType

MOST: Final = 4
"""Alternatives that are told of one tag."""
_ORDERS: Final[tuple[ByteOrder, ...]] = ("ABCD", "CDAB", "BADC", "DCBA")
_TYPES: Final[tuple[ModbusType, ...]] = ("float32", "int32", "uint32", "float64", "int16", "uint16")
_OTHER: Final = {Table.HOLDING: Table.INPUT, Table.INPUT: Table.HOLDING}
_LEAST, _MOST_OF_A_FLOAT, _LEAST_OF_THE_RANGE = 1e-9, 1e9, 1e-12
_LARGE_INTEGER: Final = 2.0**24
_NEAR: Final = 0.1  # of the range, or of the value: by how much two reads may differ

Range = tuple[float, float] | None


@dataclass(frozen=True, slots=True)
class Alternative:
    """Another reading of the same value: which keys to change to what, and the tag that results."""

    change: str
    tag: ModbusTag
    order_only: bool


def alternatives(tag: ModbusTag, order: ByteOrder) -> list[Alternative]:
    """What a tag may be instead, one change before two; `order` is that of its source. None for bits."""
    place = tag.location
    if place.table.bits or tag.data_type == "bool":
        return []
    own = tag.byte_order or order
    simple, both = list(_other_orders(tag, own, "")), list[Alternative]()
    for step in (1, -1):
        if 0 <= place.offset + step <= LAST_OFFSET:
            beside = Address(place.table, place.offset + step)
            moved = tag.model_copy(update={"address": f"{beside.table}:{beside.offset}"})
            simple.append(Alternative(f"address: {beside}", moved, False))
            both += _other_orders(moved, own, f"address: {beside} and ")
    for data_type in _TYPES:
        if data_type != tag.data_type:
            other = tag.model_copy(update={"data_type": data_type, "byte_order": None})
            simple.append(Alternative(f"data_type: {data_type}", other, False))
            both += _other_orders(other, order, f"data_type: {data_type} and ")
    if place.table in _OTHER:
        table = Address(_OTHER[place.table], place.offset)
        moved = tag.model_copy(update={"address": f"{table.table}:{table.offset}"})
        simple.append(Alternative(f"address: {table}", moved, False))
    every = (*simple, *both)
    return [each for each in every if each.tag.location.offset + REGISTERS[each.tag.data_type] <= LAST_OFFSET + 1]


def candidates(tag: ModbusTag, order: ByteOrder, values: Sequence[float], limits: Range) -> list[Alternative]:
    """The alternatives to a tag that read so, and made no sense."""
    found = alternatives(tag, order)
    if any(math.isfinite(value) for value in values):
        return found
    width = REGISTERS[tag.data_type]
    same = [each for each in found if each.tag.data_type.find("int") >= 0 and each.tag.address == tag.address]
    return [each for each in same if limits is not None and REGISTERS[each.tag.data_type] == width]


def makes_sense(tag: ModbusTag, values: Sequence[float], limits: Range) -> bool:
    """Whether these engineering values, read one after the other, may be what was meant."""
    if not all(math.isfinite(value) for value in values):
        return False
    is_float = tag.data_type.startswith("float")
    if limits is not None:
        least = _LEAST_OF_THE_RANGE * (limits[1] - limits[0]) if is_float else 0.0
        return all(limits[0] <= value <= limits[1] and (value == 0.0 or abs(value) >= least) for value in values)
    if is_float:
        return all(value == 0.0 or _LEAST <= abs(value) <= _MOST_OF_A_FLOAT for value in values)
    return REGISTERS[tag.data_type] == 1 or not all(_is_shifted(tag, value) for value in values)


def better(tag: ModbusTag, alternative: Alternative, values: Sequence[float], limits: Range) -> bool:
    """Whether an alternative that was read so is far saner than the tag, which makes no sense."""
    values = [value for value in values if math.isfinite(value)]
    if len(values) < 2 or not makes_sense(alternative.tag, values, limits) or not any(values):
        return False
    size = limits[1] - limits[0] if limits is not None else max(abs(value) for value in values)
    if max(values) - min(values) > _NEAR * size:
        return False
    if limits is not None:
        return True
    if tag.data_type.startswith("float"):
        return all(1e-3 <= abs(value) <= 1e6 for value in values)
    return alternative.order_only and all(abs(_raw(tag, value)) < _LARGE_INTEGER for value in values)


def _other_orders(tag: ModbusTag, own: ByteOrder, also: str) -> Iterator[Alternative]:
    if REGISTERS[tag.data_type] > 1:
        for order in _ORDERS:
            if order != own:
                other = tag.model_copy(update={"byte_order": order})
                yield Alternative(f"{also}byte_order: {order}", other, not also)


def _raw(tag: ModbusTag, value: float) -> float:
    return (value - tag.offset) / tag.scale


def _is_shifted(tag: ModbusTag, value: float) -> bool:
    """A large integer whose last word is empty, as a small one has it that is read in another order."""
    raw = round(_raw(tag, value))
    return abs(raw) >= _LARGE_INTEGER and raw & 0xFFFF in (0, 0xFFFF)
