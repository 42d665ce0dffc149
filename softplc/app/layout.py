"""From the configuration to the tag table and to what each task reads, observes and writes: pure, no I/O.

The scan process and the gateway both build the layout from the same configuration, so that an index means the
same tag in both.
"""

import gc
import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from softplc.config.axis import Axis, WriteBack
from softplc.config.models import Config, Source, Task
from softplc.life import Heartbeat, Life, Stamps
from softplc.observers.aoi import AoiConfig
from softplc.observers.axes import AxisPlace, AxisSpec, axis_tags, leaves_of
from softplc.observers.leaves import ALWAYS_WRITTEN
from softplc.scan import source_tags, task_tags
from softplc.tags import Block, TagTable


@dataclass(slots=True)
class SourceLayout:
    """One source of a task: its tag models with their positions, and where its readings go in the inputs."""

    source: Source
    block: Block
    start: int = 0
    readings: dict[Any, int] = field(default_factory=dict)
    reading_names: list[str] = field(default_factory=list)
    writings: list[Any] = field(default_factory=list)
    writing_names: list[str] = field(default_factory=list)
    stale_after: dict[int, float] = field(default_factory=dict)  # seconds, by position of the reading
    heartbeat: int | None = None  # its position among the readings

    def life(self) -> Life:
        """What a link needs to tell whether this source lives."""
        settings = getattr(self.source, "heartbeat", None)
        heartbeat = None
        if settings is not None and self.heartbeat is not None:
            heartbeat = Heartbeat(self.heartbeat, settings.timeout_ms / 1000.0)
        return Life(heartbeat, Stamps(len(self.readings), self.stale_after) if self.tells_time else None)

    @property
    def tells_time(self) -> bool:
        """Its samples carry timestamps of its own clock."""
        return _tells_time(self.source)


@dataclass(frozen=True, slots=True)
class WriteBackLayout:
    """One write-back: published tag, source, position among the source's writings; `name` as in AxisX.Velocity.

    `state`: the axis' tag WriteState. `judge`: the tag that has to be Good, which the axis' Position is in State RUN
    alone; Quality and State themselves are always written. `read_back`: where the written tag is read along in the
    inputs, if it is.
    """

    config: WriteBack
    index: int
    source: str
    position: int
    name: str
    state: int
    judge: int
    read_back: int | None


@dataclass(frozen=True, slots=True)
class ObserverLayout:
    """All axes that one observer object steps: equal task, type, group key and leaves."""

    places: tuple[AxisPlace, ...]
    configs: tuple[Any, ...]


@dataclass(frozen=True, slots=True)
class TaskLayout:
    """Everything that one task is made of."""

    task: Task
    section: int
    block: Block
    sources: tuple[SourceLayout, ...]
    observers: tuple[ObserverLayout, ...]
    write_backs: tuple[WriteBackLayout, ...]
    inputs: int


@dataclass(frozen=True, slots=True)
class Layout:
    """The tag table and its tasks."""

    table: TagTable
    tasks: tuple[TaskLayout, ...]


def build_layout(config: Config) -> Layout:
    """Lay out the tasks that have axes, in the order of the file."""
    collecting = gc.isenabled()
    gc.disable()  # nothing here becomes garbage, and looking through ten thousand axes again and again costs as much
    try:
        return _build_layout(config)
    finally:
        if collecting:
            gc.enable()


def _build_layout(config: Config) -> Layout:
    table = TagTable()
    sources = {source.name: source for source in config.sources}
    tasks: list[TaskLayout] = []
    for task in config.tasks:
        axes = [axis for axis in config.axes if config.task_of(axis) is task]
        if axes:
            tasks.append(_lay_out_task(table, task, axes, sources, len(tasks)))
    return Layout(table, tuple(tasks))


def axis_spec(axis: Axis) -> AxisSpec:
    """The axis as the observers see it."""
    enable = axis.enable
    return AxisSpec(
        name=axis.name,
        unit=axis.unit,
        range=axis.range,
        enable=enable if isinstance(enable, bool) else getattr(enable, "initial", False),
        enable_writable=hasattr(enable, "writable"),
        dt_source=axis.dt_source,
        on_repeat=axis.on_repeat,
        held_after=axis.held_after_ms / 1000.0,
        reinit_after=axis.reinit_after_ms / 1000.0,
        skipped_time=axis.observer.skipped_time if isinstance(axis.observer, AoiConfig) else "accumulate",
        tuning_writable=axis.writable_tuning,
        writes=bool(axis.write_back),
        consistency=axis.window,
        shadow=axis.shadow.quantities if axis.shadow else (),
        on_bad=axis.on_bad,
        on_lost=axis.policy_when_lost,
        coast_max=axis.coast_max_ms / 1000.0,
        coast_max_sigma=math.inf if axis.coast_max_sigma is None else axis.coast_max_sigma,
        after_coast=axis.after_coast,
        reinit_samples=axis.reinit_samples,
        shadow_settling=axis.shadow.settle_ms / 1000.0 if axis.shadow else 0.0,
        signal=axis.signal.spec(getattr(axis.input, "scale", 1.0), getattr(axis.input, "offset", 0.0))
        if axis.signal
        else None,
        dead_time=None if axis.dead_time_ms is None else axis.dead_time_ms / 1000.0,
    )


def _lay_out_task(
    table: TagTable, task: Task, axes: Sequence[Axis], sources: dict[str, Source], section: int
) -> TaskLayout:
    block = table.add_block(task.name, "task", task_tags(task.name))
    used = _sources_of(table, axes, sources)
    for axis in axes:
        for tag, leaf in _inputs(axis):
            _read(used, tag, f"{axis.name}.{leaf}")
        for write_back in axis.write_back:
            if write_back.verify:
                _read(used, write_back.tag, f"{axis.name}.{write_back.output}.ReadBack")
        if axis.stale_after_ms is not None:
            _limit_age(used[axis.input.source], axis.input, axis.stale_after_ms / 1000.0)
    for source in used.values():
        beat = getattr(source.source, "heartbeat", None)
        if beat is not None:
            tag = beat.tag(source.source.name)
            _read(used, tag, f"Sources.{source.source.name}.Heartbeat")
            source.heartbeat = source.readings[tag]
    start = 0
    for source in used.values():
        source.start = start
        start += len(source.readings)
    groups: dict[Any, list[tuple[AxisPlace, Any]]] = defaultdict(list)
    write_backs: list[WriteBackLayout] = []
    for axis in axes:
        place = _place(table, used, axis)
        observer = axis.observer
        key = observer.type, observer.group_key, place.spec.consistency, leaves_of(place.spec, observer)
        groups[key].append((place, observer))
        write_backs += [_write(used, axis.name, place.block, write_back) for write_back in axis.write_back]
    table.close_section(task.name)
    observers = tuple(
        ObserverLayout(tuple(place for place, _ in group), tuple(config for _, config in group))
        for group in groups.values()
    )
    return TaskLayout(task, section, block, tuple(used.values()), observers, tuple(write_backs), start)


def _inputs(axis: Axis) -> list[tuple[Any, str]]:
    """The tags that an axis reads, each with the leaf that it stands for."""
    tags: list[tuple[Any, str]] = [(axis.input, "Raw"), (axis.enable, "Enable"), (axis.contact, "Contact")]
    if axis.shadow is not None:
        tags += [(getattr(axis.shadow, part), f"Shadow.{part}") for part in ("position", "velocity", "dt")]
    return [(tag, leaf) for tag, leaf in tags if hasattr(tag, "source")]


def _sources_of(table: TagTable, axes: Sequence[Axis], sources: dict[str, Source]) -> dict[str, SourceLayout]:
    names: dict[str, None] = {}
    for axis in axes:
        names.update((tag.source, None) for tag, _ in _inputs(axis))
        for write_back in axis.write_back:
            names[write_back.tag.source] = None
    layouts: dict[str, SourceLayout] = {}
    for name in names:
        source = sources[name]
        tags = source_tags(name, getattr(source, "heartbeat", None) is not None, _tells_time(source))
        layouts[name] = SourceLayout(source, table.add_block(name, "source", tags))
    return layouts


def _tells_time(source: Source) -> bool:
    """Its samples carry timestamps of its own clock."""
    return getattr(source, "tells_time", False)


def _limit_age(source: SourceLayout, tag: Any, seconds: float) -> None:
    """Of two axes with the same input the shorter limit holds for both."""
    position = source.readings[tag]
    source.stale_after[position] = min(seconds, source.stale_after.get(position, seconds))


def _read(used: dict[str, SourceLayout], tag: Any, name: str) -> None:
    source = used[tag.source]
    if tag not in source.readings:  # two axes may share an enable tag
        source.readings[tag] = len(source.readings)
        source.reading_names.append(name)


def _place(table: TagTable, used: dict[str, SourceLayout], axis: Axis) -> AxisPlace:
    spec = axis_spec(axis)
    position = {leaf: used[tag.source].start + used[tag.source].readings[tag] for tag, leaf in _inputs(axis)}
    block = table.add_block(axis.name, "axis", axis_tags(spec, axis.observer))
    return AxisPlace(
        spec,
        position["Raw"],
        position.get("Enable"),
        block,
        position.get("Contact"),
        *(position.get(f"Shadow.{part}") for part in ("position", "velocity", "dt")),
    )


def _write(used: dict[str, SourceLayout], axis: str, block: Block, write_back: WriteBack) -> WriteBackLayout:
    source = used[write_back.tag.source]
    source.writings.append(write_back.tag)
    source.writing_names.append(f"{axis}.{write_back.output}")
    read_back = source.start + source.readings[write_back.tag] if write_back.verify else None
    return WriteBackLayout(
        write_back,
        block.index(write_back.output),
        write_back.tag.source,
        len(source.writings) - 1,
        source.writing_names[-1],
        block.index("WriteState"),
        block.index(write_back.output if write_back.output in ALWAYS_WRITTEN else "Position"),
        read_back,
    )
