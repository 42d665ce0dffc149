"""What a tag's variable is besides its value: its type definition, and properties that never change."""

from collections.abc import Callable
from typing import Any, Final, NamedTuple

from asyncua import ua

from softplc.kernel.diagnosis import DIAGNOSIS_TEXT, Diagnosis
from softplc.sample import AXIS_STATE_TEXT, REASON_TEXT, WRITE_STATE_TEXT, AxisState, Quality, Reason, WriteState
from softplc.tags import Block, DataType, Tag
from softplc.units import UNECE_NAMESPACE, unit

OWN_UNITS_URI: Final = "urn:softplc:units"  # of units that UNECE has no code for

# EURange where the configuration gives none: what an HMI's bar or trend starts with, no limit of anything.
DEFAULT_RANGES: Final[dict[str, tuple[float, float]]] = {
    "%": (0.0, 100.0),
    "deg": (-360.0, 360.0),
    "rad": (-6.283185307179586, 6.283185307179586),
    "s": (0.0, 1.0),
    "ms": (0.0, 1000.0),
}
DEFAULT_RANGE: Final = (-1000.0, 1000.0)

# Enumerations among the tags of a block kind: what each number means.
_STATES: Final[dict[tuple[str, str], tuple[str, ...]]] = {
    ("axis", "Reason"): tuple(REASON_TEXT[reason] or "none" for reason in Reason),
    ("axis", "Consistency"): tuple(DIAGNOSIS_TEXT[diagnosis] for diagnosis in Diagnosis),
    ("axis", "State"): tuple(AXIS_STATE_TEXT[state] for state in AxisState),
    ("axis", "WriteState"): tuple(WRITE_STATE_TEXT[state] for state in WriteState),
    ("axis", "Quality"): tuple(quality.name.capitalize() for quality in Quality),
}


def eu_range(tag: Tag) -> tuple[float, float]:
    """The tag's range, or the default of its unit."""
    return tag.range or DEFAULT_RANGES.get(tag.unit, DEFAULT_RANGE)


def engineering_units(symbol: str) -> Any:
    """EUInformation of a unit (OPC 10000-8, 5.6.4); unit id −1 in softplc's own namespace where UNECE has no code."""
    found = unit(symbol)
    uri = OWN_UNITS_URI if found.code is None else UNECE_NAMESPACE
    return ua.EUInformation(uri, found.unit_id, ua.LocalizedText(found.symbol), ua.LocalizedText(found.name))


def leaf_of(tag: Tag) -> str:
    """The last part of the tag's name."""
    return tag.name.rpartition(".")[2]


def type_of(block: Block, tag: Tag) -> int:
    """ObjectIds number of the type definition of the tag's variable."""
    if _is_analog(tag):
        return int(ua.ObjectIds.AnalogUnitRangeType)
    states = (block.kind, leaf_of(tag)) in _STATES
    return int(ua.ObjectIds.MultiStateDiscreteType if states else ua.ObjectIds.BaseDataVariableType)


def _is_analog(tag: Tag) -> bool:
    return tag.data_type is DataType.DOUBLE and (bool(tag.unit) or tag.range is not None)


class Constant(NamedTuple):
    """A property that never changes: those with the same `key` share what `make` returns."""

    name: str
    data_type: int
    key: tuple[Any, ...]
    make: Callable[[], Any]


def constants_of(block: Block, tag: Tag) -> tuple[Constant, ...]:
    """The properties of a tag's variable."""
    ids, states = ua.ObjectIds, _STATES.get((block.kind, leaf_of(tag)))
    if _is_analog(tag):
        low, high = eu_range(tag)
        units = ("unit", tag.unit)
        return (
            Constant("EURange", ids.Range, ("range", low, high), lambda: ua.Range(low, high)),
            Constant("EngineeringUnits", ids.EUInformation, units, lambda: engineering_units(tag.unit)),
        )
    if states:
        texts = ("states", states)
        return (
            Constant("EnumStrings", ids.LocalizedText, texts, lambda: [ua.LocalizedText(each) for each in states]),
        )
    return ()
