"""What every observer shares: the axis as configured, its tags, and its place in the images."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

from softplc.interfaces import Observer
from softplc.observers.leaves import LEAVES, Leaf
from softplc.tags import Block, Role, Tag

DtSource = Literal["scan", "source", "arrival"]
OnRepeat = Literal["update", "predict"]
SkippedTime = Literal["accumulate", "lose"]


@dataclass(frozen=True, slots=True)
class AxisSpec:
    """One axis as the observer sees it: no protocol, no file. Times in seconds.

    `range`: samples outside are rejected. `enable`: the state at start, until a client or an enable tag changes it.
    `held_after`: repetition after which `predict` takes a value as held. `reinit_after`: time without a usable
    sample, beside the task's period, after which the observer starts anew. `skipped_time`: what becomes of the time
    of scans without a usable sample; `lose` only with `dt_source` scan.
    """

    name: str
    unit: str = ""
    range: tuple[float, float] | None = None
    enable: bool = True
    enable_writable: bool = False
    dt_source: DtSource = "scan"
    on_repeat: OnRepeat = "update"
    held_after: float = 1.0
    reinit_after: float = 1.0
    skipped_time: SkippedTime = "accumulate"


@dataclass(frozen=True, slots=True)
class AxisPlace:
    """Where an axis reads and writes: its inputs index the inputs' image, `block` lies in the outputs."""

    spec: AxisSpec
    measurement: int
    enable: int | None
    block: Block
    contact: int | None = None


class ObserverModel(Protocol):
    """What every observer's config model offers beside its own fields."""

    @property
    def type(self) -> str:
        """The word that the configuration chooses it by."""
        ...

    @property
    def group_key(self) -> tuple[Any, ...]:
        """Axes of one task whose configurations have the same type, key and leaves are stepped by one observer."""
        ...

    @property
    def estimates(self) -> tuple[str, ...]:
        """Leaves that the observer estimates beside Position and Velocity, in the order of their tags."""
        ...

    @property
    def tuning(self) -> tuple[str, ...]:
        """Leaves of the tuning, in the order of their tags."""
        ...

    @staticmethod
    def build(places: Sequence[AxisPlace], configs: Sequence[Any]) -> Observer:
        """One observer that steps all these axes; `configs` has one entry for each place."""
        ...


def leaves_of(observer: ObserverModel) -> tuple[str, ...]:
    """The leaves of an axis' tags in their order: outputs, input, estimates, state, commands, tuning."""
    state = ("Dt", "Age", "Skipped", "Quality", "Reason", "Enabled", "Enable")
    return ("Position", "Velocity", "Raw", *observer.estimates, *state, *observer.tuning)


def axis_tags(spec: AxisSpec, observer: ObserverModel) -> tuple[Tag, ...]:
    """The published tags of one axis, in order."""
    return tuple(_tag(spec, leaf, observer) for leaf in leaves_of(observer))


def _tag(spec: AxisSpec, name: str, observer: ObserverModel) -> Tag:
    variants: Mapping[str, Leaf] = getattr(observer, "variants", {})  # where an option gives a leaf another unit
    leaf = variants.get(name, LEAVES[name])
    role, limits, writable = Role.DIAGNOSTIC, None, False
    if name in ("Position", "Velocity"):
        role = Role.OUTPUT
    elif name == "Raw":
        role = Role.INPUT
    elif name == "Enable":
        role, writable = Role.TUNING, spec.enable_writable
    elif name in observer.tuning:
        role = Role.TUNING
    if name in ("Position", "Raw"):
        limits = spec.range
    unit = leaf.unit_of(spec.unit)
    return Tag(f"{spec.name}.{name}", unit, leaf.description, role, leaf.data_type, limits, writable)
