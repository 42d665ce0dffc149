"""One axis of the configuration file as a model: its input, its observer, and everything that belongs to it."""

from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Discriminator, Field, Tag, model_validator
from pydantic_core import PydanticCustomError

from softplc.config.source_tag import Enable, SourceTag
from softplc.drivers.modbus.config import ModbusTag
from softplc.model import Model, Name
from softplc.observers.aoi import AoiConfig
from softplc.observers.axes import Policy
from softplc.observers.config import ObserverConfig
from softplc.observers.consistency import NEEDS, consistency_leaves
from softplc.observers.ducekf import DucekfConfig
from softplc.observers.leaves import NOW, WRITE_BACK
from softplc.observers.signal_config import Signal

_OUTPUT = "a tag that the axis' observer estimates, as Position or Velocity, or Quality or State"


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
    verify: bool = False
    """Read the tag back; a value other than the written one is told as a mismatch."""
    tolerance: Annotated[float, Field(ge=0, json_schema_extra={"x-unit": "unit"})] = 0.0
    """verify: how far the value that is read back may be off, in the output's unit, beside the rounding of a REAL."""
    verify_within_ms: Annotated[float, Field(ge=0, le=3_600_000)] = 1000.0
    """verify: so long an older value may still be read back, ms."""

    @model_validator(mode="after")
    def _verifies_what_it_says(self) -> Self:
        unused = [key for key in ("tolerance", "verify_within_ms") if key in self.model_fields_set]
        if unused and not self.verify:
            raise ValueError(f"{unused[0]} without verify: true, expected verify: true, or no {unused[0]}")
        return self

    @property
    def rounding(self) -> float:
        """What the tag's own type rounds off, in the output's unit: half a step of a whole number."""
        whole = isinstance(self.tag, ModbusTag) and "int" in self.tag.data_type
        return 0.5 * abs(self.tag.scale) if isinstance(self.tag, ModbusTag) and whole else 0.0


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


_OF_A_COAST = ("coast_max_ms", "coast_max_sigma", "after_coast")


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
    signal: Signal | None = None
    """What is done with the measured position before the observer; leave it out for nothing."""
    dead_time_ms: Annotated[float, Field(ge=0, le=60_000)] | None = None
    """Publishes PositionNow and VelocityNow: the state carried on by the sample's age and by this, ms. Bigger looks
    further ahead. What passes in sensor, bus and PLC before the sample is ours; 0 for the sample's age alone."""
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
    on_bad: Policy = "hold"
    """No usable sample on a live link: hold the last values, coast (carry them on), pass its number through, fail."""
    on_lost: Policy | None = None
    """The same for a link that is down; left out it is as on_bad, but fail where that is hold."""
    coast_max_ms: Annotated[float, Field(gt=0, le=3_600_000)] = 500.0
    """Longest coast, ms; after_coast follows. Bigger bridges more and may be further off."""
    coast_max_sigma: Annotated[float, Field(gt=0, json_schema_extra={"x-unit": "unit"})] | None = None
    """A coast also ends when the standard deviation of the position, √P00, is above this, unit."""
    after_coast: Literal["hold", "fail"] = "fail"
    """What follows a coast that was too long: hold the last values, or fail."""
    reinit_samples: Annotated[int, Field(ge=1, le=1000)] = 3
    """Fresh samples after an outage until the outputs are Good. Bigger trusts a source later that has come back."""
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
    def _turns_with_its_observer(self) -> Self:
        if self.signal is not None and self.signal.modulo is not None and isinstance(self.observer, DucekfConfig):
            raise ValueError(
                "signal.modulo with observer ducekf, whose stops do not turn with the axis, expected another observer"
            )
        return self

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
    def _can_coast(self) -> Self:
        coasts = "coast" in (self.on_bad, self.on_lost)
        if coasts and isinstance(self.observer, AoiConfig) and self.observer.skipped_time == "lose":
            raise ValueError("a coast with skipped_time: lose, which forgets the time, expected accumulate")
        if not coasts:
            unused = [name for name in _OF_A_COAST if getattr(self, name) != type(self).model_fields[name].default]
            if unused:
                raise ValueError(f"{', '.join(unused)} without a coast, expected on_bad or on_lost: coast")
        if self.coast_max_sigma is not None and "P00" not in self.observer.estimates:
            raise ValueError(
                f"coast_max_sigma of observer {self.observer.type}, which has no variance P00, "
                "expected coast_max_ms alone"
            )
        return self

    @model_validator(mode="after")
    def _writes_what_it_has(self) -> Self:
        own = ["Position", "Velocity", *self.observer.estimates, "Dt", "Quality", "State"]
        if self.consistency:
            own += [leaf for leaf in consistency_leaves(self.observer.estimates) if leaf in WRITE_BACK]
        own += NOW if self.dead_time_ms is not None else ()
        if self.shadow is not None:
            own += [f"{part.capitalize()}{leaf}" for part in self.shadow.quantities for leaf in ("Delta", "DeltaMax")]
        for write_back in self.write_back:
            if write_back.output in NOW and self.dead_time_ms is None:
                raise ValueError(f"write_back of {write_back.output} without dead_time_ms, expected both")
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
    def policy_when_lost(self) -> Policy:
        """`on_lost`, or what follows from `on_bad`."""
        if self.on_lost is not None:
            return self.on_lost
        return "fail" if self.on_bad == "hold" else self.on_bad

    @property
    def window(self) -> tuple[int, int] | None:
        """Window and lags of the consistency tags, None for none."""
        if self.consistency is False:
            return None
        chosen = self.consistency if isinstance(self.consistency, Consistency) else Consistency()
        return chosen.window, chosen.lags
