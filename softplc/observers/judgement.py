"""Which input samples may enter an observer, and what the outputs show where they may not."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import DTypeLike, NDArray

from softplc.observers.axes import AxisPlace
from softplc.observers.signal import Signal
from softplc.sample import Reason, StatusCode
from softplc.tags import Image
from softplc.timing import Scan

_CODE: Final = np.uint32(0xFFFF0000)  # severity and subcode; the low half holds information bits
_BAD: Final = np.uint32(StatusCode.BAD)

_NO_COMMUNICATION: Final = (
    StatusCode.BAD_NO_COMMUNICATION,
    StatusCode.BAD_NOT_CONNECTED,
    StatusCode.BAD_TIMEOUT,
)
_CONFIGURATION: Final = (
    StatusCode.BAD_USER_ACCESS_DENIED,
    StatusCode.BAD_NODE_ID_INVALID,
    StatusCode.BAD_NODE_ID_UNKNOWN,
    StatusCode.BAD_ATTRIBUTE_ID_INVALID,
    StatusCode.BAD_TYPE_MISMATCH,
    StatusCode.BAD_NOT_READABLE,
    StatusCode.BAD_CONFIGURATION_ERROR,
)
_LAST_USABLE: Final = (
    StatusCode.UNCERTAIN_LAST_USABLE_VALUE,
    StatusCode.UNCERTAIN_NO_COMMUNICATION_LAST_USABLE_VALUE,
)

_USED: Final = (Reason.NONE, Reason.INPUT_UNCERTAIN, Reason.STAMP_FROZEN, Reason.PROGRAM_STOPPED)
_NO_OUTPUT: Final = (Reason.NO_COMMUNICATION, Reason.WAITING, Reason.CONFIGURATION)
_HELD_AS: Final = {
    Reason.INPUT_BAD: StatusCode.UNCERTAIN_LAST_USABLE_VALUE,
    Reason.INPUT_NOT_FINITE: StatusCode.UNCERTAIN_LAST_USABLE_VALUE,
    Reason.INPUT_OUT_OF_RANGE: StatusCode.UNCERTAIN_ENGINEERING_UNITS_EXCEEDED,
    Reason.STALE: StatusCode.UNCERTAIN_LAST_USABLE_VALUE,
    Reason.RATE_EXCEEDED: StatusCode.UNCERTAIN_ENGINEERING_UNITS_EXCEEDED,
}
_NOTHING_TO_HOLD: Final = {  # for an input whose own status is not Bad
    Reason.INPUT_NOT_FINITE: StatusCode.BAD_OUT_OF_RANGE,
    Reason.INPUT_OUT_OF_RANGE: StatusCode.BAD_OUT_OF_RANGE,
    Reason.STALE: StatusCode.BAD_WAITING_FOR_INITIAL_DATA,
    Reason.RATE_EXCEEDED: StatusCode.BAD_OUT_OF_RANGE,
}


def _by_reason(entries: Any) -> NDArray[Any]:
    """A lookup table indexed by Reason; 0 where there is no entry."""
    table = np.zeros(max(Reason) + 1, np.uint32)
    for reason, status in dict(entries).items():
        table[reason] = status
    return table


_USED_TABLE: Final = _by_reason((reason, 1) for reason in _USED).astype(np.bool_)
_NO_OUTPUT_TABLE: Final = _by_reason((reason, 1) for reason in _NO_OUTPUT).astype(np.bool_)
_HELD_AS_TABLE: Final = _by_reason(_HELD_AS)
_NOTHING_TO_HOLD_TABLE: Final = _by_reason(_NOTHING_TO_HOLD)


def _is_any(code: NDArray[np.uint32], of: Sequence[StatusCode]) -> NDArray[np.bool_]:
    """Element by element; several times faster than numpy's isin for so few."""
    found: NDArray[np.bool_] = code == np.uint32(of[0])
    for status in of[1:]:
        found |= code == np.uint32(status)
    return found


class Judgement:
    """The input samples of one scan with a verdict on each. Arrays[axes], valid until the next `judge`.

    `read` float64 as read, `z` what the observer gets of it (the same array where no axis has a `signal`),
    `input_status` uint32, `timestamps` int64 ns, `arrivals` monotonic seconds;
    `usable`: the sample may enter the observer; `status` and `reason` of the outputs as far as the input decides;
    `blank`: the outputs have no value, None where every axis has one; `late`: samples that came after the scan for
    which they were asked, None where there is none; `raw`, `raw_status`: what Raw shows.
    `limit`: the largest number that there is in the kernel's precision.
    `signal`: the conditioning of those axes that have one, None where none has.
    """

    def __init__(self, places: Sequence[AxisPlace], dtype: DTypeLike) -> None:
        n, limit = len(places), float(np.finfo(dtype).max)
        ranges = [place.spec.range or (-np.inf, np.inf) for place in places]
        self._index = np.array([place.measurement for place in places], np.intp)
        self.limit = limit
        self._low = np.array([max(low, -limit) for low, _ in ranges])
        self._high = np.array([min(high, limit) for _, high in ranges])
        self._last_arrivals = np.full(n, np.nan)
        self._flag = np.zeros(n, np.bool_)
        self.z = self.read = np.zeros(n)
        self.signal = Signal(places) if any(place.spec.signal for place in places) else None
        if self.signal is not None:
            self.z = np.zeros(n)
        self._too_fast: NDArray[np.bool_] | None = None
        self._causes = np.zeros(n, np.uint8)
        self.input_status = np.zeros(n, np.uint32)
        self.timestamps = np.zeros(n, np.int64)
        self.arrivals = np.zeros(n)
        self.usable = np.zeros(n, np.bool_)
        self.status = np.zeros(n, np.uint32)
        self.reason = np.zeros(n, np.uint8)
        self.blank: NDArray[np.bool_] | None = None
        self.late: NDArray[np.bool_] | None = None
        self.raw, self.raw_status = self.read, self.input_status

    def judge(self, scan: Scan, inputs: Image, has_values: NDArray[np.bool_], unseen: NDArray[np.float64]) -> None:
        """Judge the latched samples.

        `has_values[axes]`: which outputs have a last value to hold. `unseen[axes]`: `TimeStep.unseen`.
        """
        self._last_arrivals, self.arrivals = self.arrivals, self._last_arrivals
        np.take(inputs.values, self._index, out=self.read)  # raises when an index is not in the image
        np.take(inputs.statuses, self._index, out=self.input_status, mode="clip")
        np.take(inputs.source_timestamps, self._index, out=self.timestamps, mode="clip")
        np.take(inputs.arrivals, self._index, out=self.arrivals, mode="clip")
        position = self.read if self.signal is None else self.signal.unwrap(scan, self, unseen)
        np.greater_equal(position, self._low, out=self.usable)
        np.less_equal(position, self._high, out=self._flag)
        np.logical_and(self.usable, self._flag, out=self.usable)  # false for NaN, too
        self.status.fill(StatusCode.GOOD)
        self.reason.fill(Reason.NONE)
        self.blank = self.late = None
        self.raw, self.raw_status = self.read, self.input_status
        if self.signal is not None:
            self._judge_speed(self.signal)
        if self.input_status.any() or not self.usable.all():
            np.take(inputs.causes, self._index, out=self._causes, mode="clip")
            self._judge_closely(has_values)
        if self.signal is not None:
            self.signal.take(scan, self)

    def _judge_speed(self, signal: Signal) -> None:
        """Samples faster than the axis are not usable; one after many of them may be, where it is."""
        if self.input_status.any():
            np.logical_and(self.usable, self.input_status < _BAD, out=self.usable)
        self._too_fast = signal.judge(self, self._low, self._high)
        if self._too_fast is not None:
            self._too_fast &= self.usable  # out of range says more
            self.usable[self._too_fast] = False

    def _judge_closely(self, has_values: NDArray[np.bool_]) -> None:
        """Some sample is not plainly Good, finite and in range."""
        z, own = self.read, self.input_status
        code = own & _CODE
        bad = own >= _BAD
        caused = self._causes != 0  # our link doubts the sample, not its source
        old = _is_any(code, _LAST_USABLE) & ~caused
        no_reply = old & ((self.arrivals == self._last_arrivals) | np.isnan(self.arrivals))
        self.late = old & ~no_reply
        first_that_holds = (
            (_is_any(code, _NO_COMMUNICATION), Reason.NO_COMMUNICATION),
            (code == np.uint32(StatusCode.BAD_WAITING_FOR_INITIAL_DATA), Reason.WAITING),
            (_is_any(code, _CONFIGURATION), Reason.CONFIGURATION),
            (bad, Reason.INPUT_BAD),
            (~(np.abs(z) <= self.limit), Reason.INPUT_NOT_FINITE),
            (False if self._too_fast is None else self._too_fast, Reason.RATE_EXCEEDED),
            (~self.usable, Reason.INPUT_OUT_OF_RANGE),
            (no_reply, Reason.STALE),
            (own >= np.uint32(StatusCode.UNCERTAIN), Reason.INPUT_UNCERTAIN),
        )
        conditions, reasons = zip(*first_that_holds, strict=True)
        self.reason[:] = np.select(conditions, [int(reason) for reason in reasons], int(Reason.NONE))
        doubted = caused & ((self.reason == Reason.INPUT_BAD) | (self.reason == Reason.INPUT_UNCERTAIN))
        np.copyto(self.reason, self._causes, where=doubted)
        self.usable[:] = _USED_TABLE[self.reason] & ~bad

        held_as = _HELD_AS_TABLE[self.reason]
        self.status[:] = np.where(held_as != 0, held_as, np.where(self.reason == Reason.NONE, 0, own))
        no_output = _NO_OUTPUT_TABLE[self.reason] | (doubted & bad)
        nothing = ~self.usable & ~no_output & ~has_values
        self.status[nothing] = np.where(bad, own, _NOTHING_TO_HOLD_TABLE[self.reason])[nothing]
        self.blank = no_output | nothing

        nan_not_bad = np.isnan(z) & ~bad  # NaN means Bad on every published tag
        self.raw = np.where(bad, np.nan, z)
        self.raw_status = np.where(nan_not_bad, np.uint32(StatusCode.BAD_OUT_OF_RANGE), own)
