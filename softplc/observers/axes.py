"""What every observer shares: the axis as configured, its tags, and its place in the images."""

import math
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Final, Literal, Protocol

import numpy as np

from softplc.interfaces import Observer
from softplc.observers.bounds import bounds_of
from softplc.observers.consistency import consistency_leaves
from softplc.observers.leaves import COMMANDS, LEAVES, NOW, Leaf
from softplc.observers.signal_config import SignalSpec
from softplc.tags import Block, DataType, Role, Tag

DtSource = Literal["scan", "source", "arrival", "nominal"]
OnRepeat = Literal["update", "predict"]
SkippedTime = Literal["accumulate", "lose"]
Policy = Literal["hold", "coast", "passthrough", "fail"]

_REAL_MAX: Final = float(np.finfo(np.float32).max)
_REAL_TINY: Final = float(np.finfo(np.float32).tiny)


@dataclass(frozen=True, slots=True)
class AxisSpec:
    """One axis as the observer sees it: no protocol, no file. Times in seconds.

    `range`: samples outside are rejected. `enable`: the state at start, until a client or an enable tag changes it.
    `held_after`: repetition after which `predict` takes a value as held. `reinit_after`: time without a usable
    sample, beside the task's period, after which the observer starts anew. `skipped_time`: what becomes of the time
    of scans without a usable sample; `lose` only with `dt_source` scan. `tuning_writable`: clients may write the
    tuning. `writes`: outputs are written into a source. `consistency`: window and lags of the consistency tags, None
    for none. `shadow`: which of position and velocity the PLC estimates itself; `shadow_settling`: time after a start
    before their largest differences count.
    `on_bad`, `on_lost`: what is shown where no sample is usable, while the link lives and while it does not.
    `coast_max`, `coast_max_sigma` (in `unit`): where a coast ends, and `after_coast` comes. `reinit_samples`: fresh
    samples after an outage until the outputs are Good.
    `signal`: conditioning of the measurement. `dead_time`: what was measured is older than its sample by this, None
    for no tags of the state carried on to now.
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
    tuning_writable: bool = False
    writes: bool = False
    consistency: tuple[int, int] | None = None
    shadow: tuple[Literal["position", "velocity"], ...] = ()
    shadow_settling: float = 0.0
    on_bad: Policy = "hold"
    on_lost: Policy = "fail"
    coast_max: float = 0.5
    coast_max_sigma: float = math.inf
    after_coast: Literal["hold", "fail"] = "fail"
    reinit_samples: int = 3
    signal: SignalSpec | None = None
    dead_time: float | None = None


@dataclass(frozen=True, slots=True)
class AxisPlace:
    """Where an axis reads and writes: its inputs index the inputs' image, `block` lies in the outputs."""

    spec: AxisSpec
    measurement: int
    enable: int | None
    block: Block
    contact: int | None = None
    shadow_position: int | None = None
    shadow_velocity: int | None = None
    shadow_dt: int | None = None


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


def require_one_group(places: Sequence[AxisPlace], configs: Sequence[ObserverModel]) -> None:
    """Raises ValueError unless there is one configuration for each place, all with the same `group_key`."""
    if len(places) != len(configs) or len({config.group_key for config in configs}) != 1:
        raise ValueError("expected one configuration for each axis, all with the same group_key")


def leaves_of(spec: AxisSpec, observer: ObserverModel) -> tuple[str, ...]:
    """The leaves of an axis' tags in their order: outputs, input, estimates, judgements, state, commands, tuning."""
    judged = consistency_leaves(observer.estimates) if spec.consistency else ()
    for quantity in spec.shadow:
        judged += (f"{quantity.capitalize()}Delta", f"{quantity.capitalize()}DeltaMax")
    writes = ("WriteState",) if spec.writes else ()
    state = ("Dt", "Age", "Skipped", "State", "Quality", "Reason", "Enabled", *writes, *COMMANDS)
    now = () if spec.dead_time is None else NOW
    return ("Position", "Velocity", "Raw", *observer.estimates, *now, *judged, *state, *observer.tuning)


def axis_tags(spec: AxisSpec, observer: ObserverModel) -> tuple[Tag, ...]:
    """The published tags of one axis, in order."""
    return tuple(Tag(f"{spec.name}.{leaf}", *rest) for leaf, rest in _alike(replace(spec, name=""), observer))  # type: ignore[arg-type]


@lru_cache(maxsize=64)
def _alike(spec: AxisSpec, observer: ObserverModel) -> tuple[tuple[str, tuple[Any, ...]], ...]:
    """Leaves, and what their tags are beside the name: thousands of axes that are configured alike have the same."""
    variants: Mapping[str, Leaf] = getattr(observer, "variants", {})  # where an option gives a leaf another unit
    tuning = frozenset(observer.tuning)
    return tuple(
        (name, _tag(spec, name, variants.get(name, LEAVES[name]), observer, tuning))
        for name in leaves_of(spec, observer)
    )


def _tag(spec: AxisSpec, name: str, leaf: Leaf, observer: ObserverModel, tuning: Set[str]) -> tuple[Any, ...]:
    """The fields of a tag after its name."""
    role, span, limits, writable = Role.DIAGNOSTIC, None, None, False
    if name in ("Position", "Velocity", "PositionNow", "VelocityNow"):
        role = Role.OUTPUT
    elif name == "Raw":
        role = Role.INPUT
    elif name in COMMANDS:
        role = Role.TUNING
        writable = spec.enable_writable or (name == "Reset" and spec.tuning_writable)
    elif name in tuning:
        role = Role.TUNING
        writable = spec.tuning_writable and leaf.limits is not None
        limits = _limits(leaf, observer) if writable else None
    signal = spec.signal or SignalSpec()
    if name in ("Position", "PositionNow"):
        span = spec.range if signal.modulo is None else (0.0, signal.modulo)
    elif name == "Raw" and signal.counter is None:
        span = spec.range
    return leaf.unit_of(spec.unit), leaf.description, role, leaf.data_type, span, writable, limits


def _limits(leaf: Leaf, observer: ObserverModel) -> tuple[float, float] | None:
    """What may be written to a tuning tag: in REAL a number that stays within the limits when it is rounded.

    They are those of the field that the leaf is from; a model whose options narrow them has them by leaf in `limits`.
    """
    if leaf.limits is None:
        return None
    narrower: Mapping[str, tuple[float, float]] = getattr(observer, "limits", {})
    each = [pair for pair in (leaf.limits, bounds_of(observer, leaf.name), narrower.get(leaf.name)) if pair]
    limits = max(low for low, _ in each), min(high for _, high in each)
    if leaf.data_type is not DataType.DOUBLE or getattr(observer, "precision", "") != "real":
        return limits
    low, high = (float(bound) for bound in np.clip(limits, -_REAL_MAX, _REAL_MAX))
    low = max(low, _REAL_TINY) if low > 0.0 else low
    nearest = np.float32(high)
    return low, float(np.nextafter(nearest, np.float32(-np.inf)) if float(nearest) > high else nearest)
