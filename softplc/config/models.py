"""The configuration file as models: tasks, sources, axes, publishers, logging, real-time options."""

from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Discriminator, Field, Tag, field_validator, model_validator
from pydantic_core import PydanticCustomError

from softplc.drivers.modbus.config import ModbusSource, ModbusTag
from softplc.drivers.opcua.config import OpcUaSource, OpcUaTag
from softplc.drivers.replay import ReplaySource, ReplayTag
from softplc.kernel.compiled import available
from softplc.model import Model, Name
from softplc.observers.aoi import AoiConfig
from softplc.observers.config import ObserverConfig
from softplc.observers.consistency import NEEDS, consistency_leaves
from softplc.observers.ducekf import DucekfConfig
from softplc.observers.leaves import WRITE_BACK
from softplc.publishers.modbus.config import ModbusPublisher
from softplc.publishers.opcua.config import OpcUaPublisher

Source = Annotated[OpcUaSource | ModbusSource | ReplaySource, Field(discriminator="type")]
Publisher = Annotated[OpcUaPublisher | ModbusPublisher, Field(discriminator="type")]


def _protocol_of(tag: Any) -> str | None:
    """A tag is of the protocol whose key it has: node, address or column."""
    for key, protocol in (("node", "opcua"), ("address", "modbus"), ("column", "replay")):
        if (key in tag) if isinstance(tag, dict) else hasattr(tag, key):
            return protocol
    return None


SourceTag = Annotated[
    Annotated[OpcUaTag, Tag("opcua")] | Annotated[ModbusTag, Tag("modbus")] | Annotated[ReplayTag, Tag("replay")],
    Discriminator(
        _protocol_of,
        custom_error_type="source_tag",
        custom_error_message="a tag: source, and one of node (OPC-UA), address (Modbus) or column (recording)",
    ),
]


class Task(Model):
    """A cyclic task (IEC 61131-3): its axes are scanned together on a fixed time grid."""

    name: Name = "main"
    """How axes refer to it."""
    period_ms: Annotated[float, Field(ge=1, le=60_000)] = 50.0
    """Time between scans, ms. q_x and q_x_dot are per scan: another period makes another filter."""
    priority: Annotated[int, Field(ge=0, le=31)] = 16
    """Of tasks due at the same instant the lowest number goes first; 0 is the highest priority."""


class WritableEnable(Model):
    """Enable is a tag that a client may write (see the OPC-UA publisher's users)."""

    writable: Literal[True]
    """Clients that have logged in may write it."""
    initial: bool = True
    """State after start."""


def _form_of_enable(value: Any) -> str | None:
    """Of the three forms of enable the one that a value has."""
    if isinstance(value, bool):
        return "state"
    if isinstance(value, WritableEnable) or (isinstance(value, dict) and "writable" in value):
        return "writable"
    return _protocol_of(value)


Enable = Annotated[
    Annotated[bool, Tag("state")]
    | Annotated[WritableEnable, Tag("writable")]
    | Annotated[OpcUaTag, Tag("opcua")]
    | Annotated[ModbusTag, Tag("modbus")]
    | Annotated[ReplayTag, Tag("replay")],
    Discriminator(
        _form_of_enable,
        custom_error_type="enable",
        custom_error_message="true, false, writable: true, or a tag: source, and one of node, address or column",
    ),
]


_OUTPUT = "a tag that the axis' observer estimates, as Position or Velocity, or Quality"


def _known_output(value: str) -> str:
    if value not in WRITE_BACK:
        raise PydanticCustomError("output", "not a tag that can be written back")
    return value


class WriteBack(Model):
    """One output of an axis that is written into a source PLC. Only Good values are written."""

    output: Annotated[
        str, AfterValidator(_known_output), Field(json_schema_extra={"enum": [*WRITE_BACK], "x-expected": _OUTPUT})
    ]
    """Which published tag of the axis, one that its observer has."""
    tag: SourceTag
    """Where it goes."""
    deadband: Annotated[float, Field(ge=0)] = 0.0
    """Write when the value moved by more than this since the last write, in the output's unit. Bigger writes less."""
    every_scans: Annotated[int, Field(ge=1, le=1_000_000)] | None = None
    """Write in every n-th scan, changed or not; leave out to write on change."""
    min_interval_ms: Annotated[float, Field(ge=0, le=3_600_000)] = 0.0
    """At least so long between two writes, ms; the newest value wins."""


_WINDOW = "a multiple of 10 from 50 to 10000"


class Consistency(Model):
    """Tags that tell whether the tuning fits, from the innovations of the last updates."""

    window: Annotated[int, Field(ge=50, le=10_000, multiple_of=10, json_schema_extra={"x-expected": _WINDOW})] = 200
    """Updates that are looked at. Bigger is surer, and later to see a change."""
    lags: Annotated[int, Field(ge=1, le=20)] = 5
    """Autocorrelations of the innovations that are looked at. Bigger sees slower patterns, each less surely."""


def _form_of_consistency(value: Any) -> str | None:
    """true or false, or a block."""
    return "switch" if isinstance(value, bool) else "block" if isinstance(value, dict | Consistency) else None


ConsistencyTags = Annotated[
    Annotated[bool, Tag("switch")] | Annotated[Consistency, Tag("block")],
    Discriminator(
        _form_of_consistency,
        custom_error_type="consistency",
        custom_error_message="true, false for no such tags, or a block with window and lags",
    ),
]


class Shadow(Model):
    """What the PLC's own observer of the same axis puts out; the differences are published as tags."""

    position: SourceTag | None = None
    """The PLC's own y."""
    velocity: SourceTag | None = None
    """The PLC's own y_dot."""
    dt: SourceTag | None = None
    """The time step that the PLC's observer used, ms; ours uses it instead of measuring one."""
    settle_ms: Annotated[float, Field(ge=0, le=3_600_000)] = 0.0
    """Time after a start before the largest differences count, ms: two that started apart need time to agree."""

    @model_validator(mode="after")
    def _something_to_compare(self) -> Self:
        if not self.quantities:
            raise ValueError("found neither position nor velocity, expected at least one of them")
        return self

    @property
    def quantities(self) -> tuple[Literal["position", "velocity"], ...]:
        """What there is to compare."""
        found: list[Literal["position", "velocity"]] = []
        if self.position is not None:
            found.append("position")
        if self.velocity is not None:
            found.append("velocity")
        return tuple(found)


class Axis(Model):
    """One position that is filtered.

    `unit: mm` makes q_x mm² per scan, q_x_dot (mm/s)² per scan, r_x mm² per sample, and velocity mm/s.
    """

    name: Name
    """First part of the names of its tags, as in AxisX.Position."""
    input: SourceTag
    """The measured position."""
    observer: ObserverConfig
    """Which observer filters it, with its tuning."""
    unit: Annotated[str, Field(max_length=16)] = ""
    """Unit of the position, as in mm, deg, in, count; velocity is in unit/s."""
    range: Annotated[tuple[float, float] | None, Field(json_schema_extra={"x-unit": "unit"})] = None
    """Lowest and highest plausible position; a sample outside is rejected. Also the EURange for HMIs."""
    task: Name | None = None
    """The task that scans this axis; the first one when left out."""
    enable: Enable = True
    """true or false; or a Boolean tag of a source; or `writable: true` for a tag that clients may write."""
    dt_source: Literal["scan", "source", "arrival", "nominal"] = "scan"
    """Δt of the observer: the measured scan interval, the samples' own timestamps, their arrivals, or the period."""
    on_repeat: Literal["update", "predict"] = "update"
    """When no new sample came: take the held value as a measurement, or predict only and publish the prediction."""
    held_after_ms: Annotated[float, Field(ge=0, le=3_600_000)] = 1000.0
    """predict: a value unchanged for so long on a live link is held, and counts as a measurement, ms."""
    reinit_after_ms: Annotated[float, Field(ge=1, le=3_600_000)] = 1000.0
    """A gap longer than this, beside the period, starts the observer anew; a shorter one is one long step, ms."""
    stale_after_ms: Annotated[float, Field(ge=1, le=3_600_000)] | None = None
    """For sources that stamp every sample, changed or not: a source timestamp that stands still for so long makes the
    input Uncertain, for three times as long Bad, ms. Leave it out where a held value keeps its timestamp."""
    contact: SourceTag | None = None
    """A Boolean tag, a limit switch or a force, that is not 0 while the axis touches its stop; for ducekf."""
    writable_tuning: bool = False
    """Clients that have logged in may write the tuning tags and Reset; a change keeps position and velocity."""
    consistency: ConsistencyTags = True
    """Tags that tell whether the tuning fits, where the observer estimates an innovation; false for none."""
    shadow: Shadow | None = None
    """Tags of the same observer in the PLC, to compare with."""
    write_back: tuple[WriteBack, ...] = ()
    """Outputs that are written into a source."""

    @model_validator(mode="after")
    def _can_tell_its_consistency(self) -> Self:
        asked = isinstance(self.consistency, Consistency)
        if asked and not set(NEEDS) <= set(self.observer.estimates):
            raise ValueError(
                f"consistency of observer {self.observer.type}, which estimates no innovation, expected none"
            )
        return self

    @model_validator(mode="after")
    def _loses_the_time_of_scans(self) -> Self:
        lose = isinstance(self.observer, AoiConfig) and self.observer.skipped_time == "lose"
        if lose and self.dt_source not in ("scan", "nominal"):
            raise ValueError(f"skipped_time: lose with dt_source: {self.dt_source}, expected dt_source: scan")
        return self

    @model_validator(mode="after")
    def _writes_what_it_has(self) -> Self:
        own = ["Position", "Velocity", *self.observer.estimates, "Dt", "Quality"]
        if self.consistency:
            own += [leaf for leaf in consistency_leaves(self.observer.estimates) if leaf in WRITE_BACK]
        if self.shadow is not None:
            own += [f"{part.capitalize()}{leaf}" for part in self.shadow.quantities for leaf in ("Delta", "DeltaMax")]
        for write_back in self.write_back:
            if write_back.output not in own:
                raise ValueError(
                    f"write_back of {write_back.output}, which observer {self.observer.type} does not have, "
                    f"expected one of {', '.join(own)}"
                )
        return self

    @model_validator(mode="after")
    def _has_the_contact_that_it_needs(self) -> Self:
        if self.contact is not None and not isinstance(self.observer, DucekfConfig):
            raise ValueError(f"contact with observer {self.observer.type}, which takes none, expected ducekf")
        if self.contact is None and isinstance(self.observer, DucekfConfig) and self.observer.needs_contact:
            raise ValueError(
                "no contact, which the observer takes its impacts from, expected a tag or contact_from: position"
            )
        return self

    @property
    def window(self) -> tuple[int, int] | None:
        """Window and lags of the consistency tags, None for none."""
        if self.consistency is False:
            return None
        chosen = self.consistency if isinstance(self.consistency, Consistency) else Consistency()
        return chosen.window, chosen.lags


KernelChoice = Literal["auto", "numpy", "compiled"]


class RealTime(Model):
    """Options of the scan process that may need permission; one that is refused is a warning and nothing more."""

    cpu_affinity: tuple[Annotated[int, Field(ge=0)], ...] | None = None
    """CPUs that the scan process may run on."""
    fifo_priority: Annotated[int, Field(ge=1, le=99)] | None = None
    """SCHED_FIFO with this priority (CAP_SYS_NICE). Bigger goes before more of the machine's other work."""
    lock_memory: bool = False
    """mlockall: no page of the scan process is swapped out (CAP_IPC_LOCK)."""
    gc_freeze: bool = True
    """Take what exists at start out of the garbage collector's sight, and collect the rest between scans only."""
    kernel: KernelChoice = "auto"
    """How the AOI computes, with the same bits either way. compiled needs the extra of that name and compiles before
    the first scan; auto does so from 10 000 axes in one task, where it is installed."""

    @field_validator("kernel")
    @classmethod
    def _is_installed(cls, kernel: KernelChoice) -> KernelChoice:
        if kernel == "compiled" and not available():
            raise ValueError(
                "compiled needs numba, which is not installed here, expected auto or numpy, "
                "or: pip install 'softplc[compiled]'"
            )
        return kernel


class Log(Model):
    """What is logged and how."""

    level: Literal["debug", "info", "warning", "error"] = "info"
    """The least that is logged."""
    format: Literal["auto", "console", "json"] = "auto"
    """auto: console on a terminal, JSON otherwise."""


class Config(Model):
    """A softplc configuration: sources are read by tasks, axes are observed, publishers serve them."""

    tasks: Annotated[tuple[Task, ...], Field(min_length=1)] = (Task(),)
    """Cyclic tasks; one named main at 50 ms when left out."""
    sources: Annotated[tuple[Source, ...], Field(min_length=1)]
    """Where positions come from: PLCs, devices, recordings."""
    axes: Annotated[tuple[Axis, ...], Field(min_length=1)]
    """The positions that are filtered."""
    publishers: tuple[Publisher, ...] = ()
    """Servers for HMIs and PLCs."""
    realtime: RealTime = RealTime()
    """Options of the scan process that may need permission."""
    log: Log = Log()
    """What is logged and how."""

    def as_json(self) -> str:
        """What the file sets, for another process; defaults are left out, for a model may refuse an unused key."""
        return self.model_dump_json(exclude_unset=True)

    def task_of(self, axis: Axis) -> Task:
        """The task that scans an axis. Raises StopIteration when load() did not check the name."""
        return self.tasks[0] if axis.task is None else next(task for task in self.tasks if task.name == axis.task)
