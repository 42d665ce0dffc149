"""Whether an axis' input can be the counter that its signal says it is."""

from collections.abc import Iterator
from typing import Final

from softplc.config.checks_names import at
from softplc.config.facts import Facts, TagUse
from softplc.config.problem import Problem
from softplc.config.tree import Scalar, below, text_at
from softplc.drivers.modbus.config import ModbusTag

_BITS: Final = {"int16": 16, "uint16": 16, "int32": 32, "uint32": 32, "int64": 64, "uint64": 64}
_DEFAULT_TYPE: Final[str] = ModbusTag.model_fields["data_type"].default


def check(facts: Facts) -> Iterator[Problem]:
    """All problems with counters; what an OPC-UA variable holds is known when it is read."""
    for tag in facts.tags:
        if tag.role == "input" and tag.kind == "modbus":
            yield from _counter(tag)


def _counter(tag: TagUse) -> Iterator[Problem]:
    node = below(tag.axis.block, "signal", "counter_bits")
    if not isinstance(node, Scalar) or node.value not in (16, 32):
        return
    stated = "data_type" in tag.block.entries
    data_type = text_at(tag.block, "data_type") if stated else _DEFAULT_TYPE
    if data_type is None or (data_type not in _BITS and data_type not in ("float32", "float64", "bool")):
        return
    bits, path = _BITS.get(data_type), (*tag.axis.path, "signal", "counter_bits")
    if bits is None:
        found = f"found a counter of {node.value} bits in an input of {data_type}{'' if stated else ', its default'}"
        text = f"{found}, expected data_type: int{node.value} or uint{node.value}"
    elif bits < node.value:
        text = f"found {node.value}, but the input is {data_type}, which rolls over after {bits}, expected {bits}"
    else:
        return
    yield Problem(*at(node, node), path, text)
