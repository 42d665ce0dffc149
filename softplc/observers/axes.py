"""What every observer shares: the axis as configured, its standard tags, and its place in the images."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from softplc.tags import Block, DataType, Role, Tag
from softplc.units import per_second, squared

DtSource = Literal["scan", "source", "arrival"]
OnRepeat = Literal["update", "predict"]


@dataclass(frozen=True, slots=True)
class AxisSpec:
    """One axis as the observer sees it: no protocol, no file. Times in seconds.

    `range`: samples outside are rejected. `enable`: the state at start, until a client or an enable tag changes it.
    `held_after`: repetition after which `predict` takes a value as held. `reinit_after`: time without a usable
    sample, beside the task's period, after which the observer starts anew.
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


@dataclass(frozen=True, slots=True)
class AxisPlace:
    """Where an axis reads and writes: `measurement` and `enable` index the inputs, `block` lies in the outputs."""

    spec: AxisSpec
    measurement: int
    enable: int | None
    block: Block


def axis_tags(spec: AxisSpec, tuning: Sequence[Tag]) -> tuple[Tag, ...]:
    """The published tags of one axis, in order: the standard ones, then the observer's tuning tags."""
    unit, speed = spec.unit, per_second(spec.unit)

    def tag(
        leaf: str,
        unit: str,
        description: str,
        role: Role = Role.DIAGNOSTIC,
        data_type: DataType = DataType.DOUBLE,
        *,
        writable: bool = False,
        limits: tuple[float, float] | None = None,
    ) -> Tag:
        return Tag(f"{spec.name}.{leaf}", unit, description, role, data_type, limits, writable)

    return (
        tag("Position", unit, "Filtered position", Role.OUTPUT, limits=spec.range),
        tag("Velocity", speed, "Filtered velocity", Role.OUTPUT),
        tag("Raw", unit, "Position as read from the source", Role.INPUT, limits=spec.range),
        tag("Innovation", unit, "Measurement minus predicted position, y"),
        tag("S", squared(unit), "Innovation variance"),
        tag("K0", "", "Kalman gain for the position"),
        tag("K1", "1/s", "Kalman gain for the velocity"),
        tag("P00", squared(unit), "Variance of the position estimate"),
        tag("P01", f"{squared(unit)}/s", "Covariance of position and velocity estimates"),
        tag("P11", squared(speed), "Variance of the velocity estimate"),
        tag("NIS", "", "Normalised innovation squared, y²/S; its mean is 1 when the tuning is consistent"),
        tag("Dt", "s", "Time step that the observer used in this scan"),
        tag("Age", "s", "Time since the newest sample arrived"),
        tag("Quality", "", "0 Bad, 1 Uncertain, 2 Good", data_type=DataType.UINT16),
        tag("Reason", "", "Why the outputs are not Good; 0 when they are", data_type=DataType.UINT16),
        tag("Enabled", "", "The observer runs", data_type=DataType.BOOLEAN),
        tag("Enable", "", "Command: run the observer", Role.TUNING, DataType.BOOLEAN, writable=spec.enable_writable),
        *tuning,
    )
