"""A sample is a value with its status and source timestamp; the status is the raw OPC UA StatusCode."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Final, overload

import numpy as np
from numpy.typing import NDArray


class StatusCode(IntEnum):
    """The OPC UA StatusCodes that softplc itself sets (OPC 10000-6, annex A.2); any other passes through raw."""

    GOOD = 0x00000000
    UNCERTAIN = 0x40000000
    UNCERTAIN_NO_COMMUNICATION_LAST_USABLE_VALUE = 0x408F0000
    UNCERTAIN_LAST_USABLE_VALUE = 0x40900000
    UNCERTAIN_INITIAL_VALUE = 0x40920000
    UNCERTAIN_SENSOR_NOT_ACCURATE = 0x40930000
    UNCERTAIN_ENGINEERING_UNITS_EXCEEDED = 0x40940000
    UNCERTAIN_SUB_NORMAL = 0x40950000
    BAD = 0x80000000
    BAD_INTERNAL_ERROR = 0x80020000
    BAD_RESOURCE_UNAVAILABLE = 0x80040000
    BAD_TIMEOUT = 0x800A0000
    BAD_WAITING_FOR_INITIAL_DATA = 0x80320000
    BAD_USER_ACCESS_DENIED = 0x801F0000
    BAD_NODE_ID_INVALID = 0x80330000
    BAD_NODE_ID_UNKNOWN = 0x80340000
    BAD_ATTRIBUTE_ID_INVALID = 0x80350000
    BAD_NOT_READABLE = 0x803A0000
    BAD_NOT_WRITABLE = 0x803B0000
    BAD_OUT_OF_RANGE = 0x803C0000
    BAD_NOT_SUPPORTED = 0x803D0000
    BAD_DATA_ENCODING_INVALID = 0x80380000
    BAD_TYPE_MISMATCH = 0x80740000
    BAD_CONFIGURATION_ERROR = 0x80890000
    BAD_NOT_CONNECTED = 0x808A0000
    BAD_DEVICE_FAILURE = 0x808B0000
    BAD_SENSOR_FAILURE = 0x808C0000
    BAD_OUT_OF_SERVICE = 0x808D0000
    BAD_NO_COMMUNICATION = 0x80310000


class Quality(IntEnum):
    """The severity of a StatusCode, as Modbus clients and operators read it."""

    BAD = 0
    UNCERTAIN = 1
    GOOD = 2


class Reason(IntEnum):
    """Why an axis' outputs are not plainly Good; 0 when they are. Published as `<axis>.Reason`."""

    NONE = 0
    WAITING = 1  # no sample has arrived since start
    INITIALISING = 2  # the observer started on this sample; velocity is still an assumption
    DISABLED = 3  # enable is off: position passes through, velocity is 0
    DT_INVALID = 4  # the time step is not usable
    INPUT_NOT_FINITE = 5  # NaN or Inf, rejected before the observer
    INPUT_OUT_OF_RANGE = 6  # outside the axis' range, rejected before the observer
    INPUT_BAD = 7  # the source marks the sample Bad
    INPUT_UNCERTAIN = 8  # the source marks the sample Uncertain
    STALE = 9  # no proof of life from the source within its limit
    NO_COMMUNICATION = 10  # the link is down
    PREDICTED = 11  # no new sample; the published state is the prediction to now
    INNOVATION_VARIANCE = 12  # S <= 0: the update is skipped and stays so until re-initialised
    NOT_FINITE = 13  # the state itself is not finite; the axis re-initialises
    CONFIGURATION = 14  # the tag is missing at the source or has another type
    INTERNAL_ERROR = 15  # this observer failed; it is parked, the others run
    INNOVATION_GATE = 16  # the sample lies too far from the prediction to be believed; predicted instead
    HELD_AT_STOP = 17  # the estimate reached an end stop before the axis did and waits there for the contact
    FAR_OFF = 18  # the measurement is a thousand σ from the prediction: one of the two is not to be believed
    RATE_EXCEEDED = 19  # faster than the axis can move, rejected before the observer
    SETTLING = 20  # samples are fresh again after an outage; there are too few of them yet
    PASSED_THROUGH = 21  # the input is no measurement; its number is shown as it is
    STAMP_FROZEN = 22  # the source's timestamp of this sample stands still
    PROGRAM_STOPPED = 23  # the heartbeat of the source's program stands still
    TURNS_UNKNOWN = 24  # while samples were missing the counter may have rolled over unseen: off by whole spans


REASON_TEXT: Final[dict[Reason, str]] = {
    Reason.NONE: "",
    Reason.WAITING: "waiting for the first sample",
    Reason.INITIALISING: "started on this sample, velocity not yet observed",
    Reason.DISABLED: "disabled, position passes through",
    Reason.DT_INVALID: "time step not usable, position passes through",
    Reason.INPUT_NOT_FINITE: "input is NaN or infinite, rejected",
    Reason.INPUT_OUT_OF_RANGE: "input outside the range of the axis, rejected",
    Reason.INPUT_BAD: "the source marks the input Bad",
    Reason.INPUT_UNCERTAIN: "the source marks the input Uncertain",
    Reason.STALE: "no sign of life from the source within its limit",
    Reason.NO_COMMUNICATION: "no connection to the source",
    Reason.PREDICTED: "no new sample, predicted to now",
    Reason.INNOVATION_VARIANCE: "innovation variance not positive, update skipped",
    Reason.NOT_FINITE: "state not finite, re-initialising",
    Reason.CONFIGURATION: "tag missing at the source or of another type",
    Reason.INTERNAL_ERROR: "the observer failed and is parked",
    Reason.INNOVATION_GATE: "innovation beyond the gate, sample rejected",
    Reason.HELD_AT_STOP: "estimate waits at the end stop for the contact",
    Reason.FAR_OFF: "measurement and prediction are a thousand sigma apart",
    Reason.RATE_EXCEEDED: "faster than the axis can move, rejected",
    Reason.SETTLING: "fresh samples after an outage, the estimate settles",
    Reason.PASSED_THROUGH: "input not usable as a measurement, passed through",
    Reason.STAMP_FROZEN: "the source's timestamp stands still",
    Reason.PROGRAM_STOPPED: "the heartbeat of the source's program stands still",
    Reason.TURNS_UNKNOWN: "the counter may have rolled over unseen, off by whole spans",
}


class AxisState(IntEnum):
    """What the outputs of an axis are made of; published as `<axis>.State`. Outputs are Good in RUN alone."""

    INIT = 0  # nothing has been estimated yet, or the first samples are
    RUN = 1  # the observer follows its input
    COAST = 2  # no usable sample: the state is carried on, and its variance grows
    HOLD = 3  # no usable sample: the last values
    FAIL = 4  # no usable sample: no values
    REINIT = 5  # samples are back: the observer settles on them
    PASSTHROUGH = 6  # no usable sample: the input's own number
    DISABLED = 7  # the observer does not run
    PARKED = 8  # the observer of this axis failed and is parked


AXIS_STATE_TEXT: Final[dict[AxisState, str]] = {
    AxisState.INIT: "initialising",
    AxisState.RUN: "running",
    AxisState.COAST: "coasting without a sample",
    AxisState.HOLD: "holding the last values",
    AxisState.FAIL: "no values",
    AxisState.REINIT: "settling on fresh samples",
    AxisState.PASSTHROUGH: "input passes through",
    AxisState.DISABLED: "disabled",
    AxisState.PARKED: "parked after a failure",
}


class WriteState(IntEnum):
    """How a write-back is; the worst of an axis is its tag `WriteState`. Higher numbers are worse."""

    NONE = 0  # nothing was due yet
    WRITTEN = 1  # the source took the newest value that was due, and gives it back where that is asked
    WAITING = 2  # for the source's answer, or for the value to be read back
    WITHHELD = 3  # the output is not Good, or the link is down
    REFUSED = 4  # the source refused the newest value
    UNVERIFIED = 5  # the written tag cannot be read
    MISMATCH = 6  # the source gives back another value
    PARKED = 7  # a defect of our own


WRITE_STATE_TEXT: Final[dict[WriteState, str]] = {
    WriteState.NONE: "nothing was due",
    WriteState.WRITTEN: "written",
    WriteState.WAITING: "waiting for the source",
    WriteState.WITHHELD: "withheld, the output is not Good",
    WriteState.REFUSED: "refused by the source",
    WriteState.UNVERIFIED: "cannot be read back",
    WriteState.MISMATCH: "another value is read back",
    WriteState.PARKED: "parked after a failure",
}


@dataclass(frozen=True, slots=True)
class Sample:
    """One value of one tag. `value` is NaN exactly when `status` is Bad; `source_timestamp` is ns UTC."""

    value: float
    status: int
    source_timestamp: int | None


_QUALITY_OF_SEVERITY: Final = np.array([2, 1, 0, 0], np.uint8)


@overload
def quality(status: int) -> Quality: ...
@overload
def quality(status: NDArray[np.uint32]) -> NDArray[np.uint8]: ...
def quality(status: int | NDArray[np.uint32]) -> Quality | NDArray[np.uint8]:
    """Severity of raw StatusCodes: the top two bits, 00 Good, 01 Uncertain, 1x Bad (OPC 10000-4, 7.39)."""
    if isinstance(status, np.ndarray):
        qualities: NDArray[np.uint8] = _QUALITY_OF_SEVERITY[status >> np.uint32(30)]
        return qualities
    return Quality(max(2 - (status >> 30), 0))


def is_bad(status: int) -> bool:
    """True when the severity of a raw StatusCode is Bad."""
    return bool(status & 0x80000000)


def status_name(status: int) -> str:
    """A raw StatusCode as OPC UA writes it, as in UncertainLastUsableValue; the number when it is none of ours."""
    try:
        return "".join(word.capitalize() for word in StatusCode(status).name.split("_"))
    except ValueError:
        return f"0x{status:08X}"
