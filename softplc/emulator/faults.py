"""Faults of a sensor at given times, seeded where they are left to chance: pure functions of the step."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, Final, Literal

from pydantic import Field

from softplc.model import Model
from softplc.sample import StatusCode


@dataclass(frozen=True, slots=True)
class Reading:
    """What a sensor reports in one step.

    `value` and `encoder` are in the axis' unit: `Position` is made of the first, `Count`, which cannot be NaN,
    of the second. `status` is an OPC UA StatusCode; `step` is the one whose time is the source timestamp.
    """

    value: float
    encoder: float
    status: int
    step: int


class _Fault(Model):
    at_s: Annotated[float, Field(ge=0)]
    """When it begins, seconds after the start."""
    for_s: Annotated[float, Field(ge=0)] = 0.0
    """How long it lasts, s; at least one step."""
    every_s: Annotated[float, Field(gt=0)] | None = None
    """Begins again after so long, for ever; leave it out for once."""
    probability: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Share of the steps in that time that are hit, chosen by the scenario's seed."""

    def begin(self, step: int, period: float) -> int | None:
        """First step of the occurrence that a step falls into; None outside."""
        elapsed = step - round(self.at_s / period)
        if elapsed < 0:
            return None
        if self.every_s is not None:
            elapsed %= max(round(self.every_s / period), 1)
        return step - elapsed if elapsed < max(round(self.for_s / period), 1) else None


class NanFault(_Fault):
    """Position reads NaN with a Good status; Count stays right."""

    type: Literal["nan"]

    def apply(self, reading: Reading, begin: int, healthy: Callable[[int], Reading]) -> Reading:
        """The reading with its value NaN."""
        return replace(reading, value=float("nan"))


class JumpFault(_Fault):
    """The measured position is off by an offset, as after homing or an encoder slip."""

    type: Literal["jump"]
    offset: float
    """In the axis' unit."""

    def apply(self, reading: Reading, begin: int, healthy: Callable[[int], Reading]) -> Reading:
        """The reading displaced by the offset."""
        return replace(reading, value=reading.value + self.offset, encoder=reading.encoder + self.offset)


class FreezeFault(_Fault):
    """The measurement stays as it was when the fault began."""

    type: Literal["freeze"]
    timestamp: Literal["running", "frozen"] = "running"
    """running: the source timestamp goes on. frozen: it stands still as well."""

    def apply(self, reading: Reading, begin: int, healthy: Callable[[int], Reading]) -> Reading:
        """What the sensor reported in the first step of the fault, with the status that it has now."""
        frozen = replace(healthy(begin), status=reading.status)
        return frozen if self.timestamp == "frozen" else replace(frozen, step=reading.step)


class StatusFault(_Fault):
    """The measurement comes with another status than Good; Modbus shows it in the axis' Quality register."""

    type: Literal["status"]
    status: Literal[
        "BadSensorFailure",
        "BadDeviceFailure",
        "BadOutOfService",
        "BadNoCommunication",
        "UncertainLastUsableValue",
        "UncertainSensorNotAccurate",
    ] = "BadSensorFailure"
    """OPC UA name of the status."""

    def apply(self, reading: Reading, begin: int, healthy: Callable[[int], Reading]) -> Reading:
        """The reading with the status."""
        return replace(reading, status=_CODES[self.status])


_CODES: Final[dict[str, int]] = {
    "BadSensorFailure": StatusCode.BAD_SENSOR_FAILURE,
    "BadDeviceFailure": StatusCode.BAD_DEVICE_FAILURE,
    "BadOutOfService": StatusCode.BAD_OUT_OF_SERVICE,
    "BadNoCommunication": StatusCode.BAD_NO_COMMUNICATION,
    "UncertainLastUsableValue": StatusCode.UNCERTAIN_LAST_USABLE_VALUE,
    "UncertainSensorNotAccurate": StatusCode.UNCERTAIN_SENSOR_NOT_ACCURATE,
}

Fault = Annotated[NanFault | JumpFault | FreezeFault | StatusFault, Field(discriminator="type")]
