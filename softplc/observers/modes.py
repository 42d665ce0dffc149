"""What an axis puts out while it has no usable sample, and how it comes back: the state machine of each axis.

INIT → RUN → (no usable sample) COAST, then HOLD or FAIL, or one of these or PASSTHROUGH at once, as the axis' policy
says → (samples are back) RUN, or after an outage REINIT → RUN. DISABLED from anywhere. Outputs are Good in RUN alone.
"""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from softplc.kernel.result import Result
from softplc.observers.axes import AxisPlace
from softplc.observers.judgement import Judgement
from softplc.observers.kernel import Flags, Kernel
from softplc.observers.published import Published
from softplc.observers.timestep import TimeStep
from softplc.sample import AxisState, Reason, StatusCode
from softplc.timing import Scan

_USE, _COAST, _HOLD, _FAIL, _PASS = range(5)  # what is shown of an axis in a scan
_WORDS: Final = {"hold": _HOLD, "coast": _COAST, "passthrough": _PASS, "fail": _FAIL}
_STATE_OF: Final = np.array(
    [AxisState.RUN, AxisState.COAST, AxisState.HOLD, AxisState.FAIL, AxisState.PASSTHROUGH], np.uint8
)
_STARTING: Final = np.isin(np.arange(len(Result)), (Result.INITIALISED, Result.WARMING_UP, Result.DT_INVALID))
_LOST: Final = np.isin(
    np.arange(max(Reason) + 1),
    (Reason.NO_COMMUNICATION, Reason.WAITING, Reason.STAMP_FROZEN, Reason.PROGRAM_STOPPED),
)
"""Reasons for which an unusable sample is as none at all."""
_STILL: Final = 0.1  # s; a value that stands still on a live link counts as a fresh one so often
_UNEXPLAINED: Final = 25.0
"""NIS, five σ: a sample at the end of a coast that the grown variance does not explain."""
_BAD: Final = np.uint32(StatusCode.BAD)


class Modes:
    """State and policy of n axes. Arrays[axes]; `begin` after the time steps, `finish` after the kernel.

    `state` uint8 AxisState. `carried`: rows that were carried on in this scan by the kernel's `coast`; `ahead`: by
    its `predict` alone; `passed`: what is read passes through. `values`: which axes have last values, as the group
    keeps them.
    """

    def __init__(self, places: Sequence[AxisPlace], kernel: Kernel, tags: Published, values: Flags) -> None:
        n, specs = len(places), [place.spec for place in places]
        self._kernel, self._tags, self._values = kernel, tags, values
        self._on_bad = np.array([_WORDS[spec.on_bad] for spec in specs], np.uint8)
        self._on_lost = np.array([_WORDS[spec.on_lost] for spec in specs], np.uint8)
        self._after = np.array([_WORDS[spec.after_coast] for spec in specs], np.uint8)
        self._longest = np.array([spec.coast_max for spec in specs])
        self._widest = np.array([spec.coast_max_sigma for spec in specs])
        self._wanted = np.array([spec.reinit_samples for spec in specs], np.int64)
        if np.isfinite(self._widest).any() and "P00" not in kernel.estimates:
            raise ValueError("coast_max_sigma for an observer without P00")

        self.state: NDArray[np.uint8] = np.full(n, AxisState.INIT, np.uint8)
        self.carried, self.ahead, self.passed = (np.zeros(n, np.bool_) for _ in range(3))
        self._ran: Flags = np.zeros(n, np.bool_)  # since the last start, enable or reset
        self._out: Flags = np.zeros(n, np.bool_)  # link lost and nothing carried on, or the state was no number
        self._coasted = np.zeros(n)
        self._left = np.zeros(n, np.int64)  # fresh samples that are still wanted
        self._late = np.zeros(n, np.int64)  # samples in time that are still wanted after a late one
        self._since = np.zeros(n)  # time since one was counted
        self._arrivals, self._stamps = np.full(n, np.nan), np.zeros(n, np.int64)  # of the last that was seen
        self._from = np.full(n, np.nan)  # where Position ramps from
        self._shown: NDArray[np.uint8] = np.zeros(n, np.uint8)
        self._lost: Flags = np.zeros(n, np.bool_)
        turns = [spec.signal.modulo if spec.signal else None for spec in specs]
        self._turning = np.flatnonzero([turn is not None for turn in turns])
        self._turn = np.array([turn for turn in turns if turn is not None])
        self._elapsed = 0.0
        self._all_run = self.quiet = False

    def clear(self, rows: Flags) -> None:
        """These axes start anew, as at the start of the service."""
        self.state[rows] = AxisState.INIT
        for flags in (self._ran, self._out):
            flags[rows] = False
        self._left[rows] = self._late[rows] = 0
        self._all_run = False

    def resume(self, other: "Modes", axes: NDArray[np.intp]) -> None:
        """Go on for these axes of another group, whose state is lost: those that ran come back as after an outage."""
        self._ran[:] = self._out[:] = other._ran[axes]
        self.state[:] = np.where(self._values, AxisState.HOLD, AxisState.INIT)

    def begin(self, scan: Scan, samples: Judgement, time: TimeStep, enabled: Flags) -> None:
        """Decide what is shown of axes without a usable sample; carries on those that coast."""
        self.quiet = self._all_run and bool(samples.usable.all() and time.in_time.all() and enabled.all())
        self.quiet &= samples.late is None or not samples.late.any()
        if self.quiet:
            return
        self._elapsed = scan.dt if 0.0 < scan.dt < math.inf else 0.0
        bad, reason = ~samples.usable, samples.reason
        missing = bad & (reason == Reason.CONFIGURATION)
        self._lost = bad & _LOST[reason]
        shown = np.where(self._lost, self._on_lost, self._on_bad)
        shown[missing] = _FAIL
        shown[~bad] = _USE
        self._lost |= missing

        self._coasted += self._elapsed
        self._coasted[~bad] = 0.0
        following = (self.state == AxisState.RUN) | (self.state == AxisState.COAST)
        coasting = (shown == _COAST) & following & enabled & self._kernel.init & (self._coasted <= self._longest)
        if coasting.any():
            coasting = self._carry_on(scan, time, coasting)
        else:
            self.carried.fill(False)
            self.ahead.fill(False)
        self._shown = np.where((shown == _COAST) & ~coasting, self._after, shown).astype(np.uint8)

        np.copyto(self._arrivals, time.arrivals, where=bad)
        np.copyto(self._stamps, time.timestamps, where=bad)
        ramps = following | (self.state == AxisState.HOLD) | (self.state == AxisState.REINIT)
        begins = self._left == 0
        begins |= self._left == self._wanted
        np.copyto(self._from, np.where(ramps & self._values, self._tags.row("Position"), np.nan), where=begins)

    def _carry_on(self, scan: Scan, time: TimeStep, rows: Flags) -> Flags:
        """Carry these rows on to now; returns those that may coast, for σ is not above its limit."""
        time.due(scan.period, rows)
        moving = rows & (time.dt > 0.0)
        committed = self._kernel.coast(time.dt, moving)
        time.carried(moving, committed=committed)
        if committed:
            P00 = self._kernel.estimates.get("P00")
            if P00 is not None:
                rows = rows & (np.sqrt(P00) <= self._widest)
        self.carried = moving & rows if committed else np.zeros_like(rows)
        self.ahead = np.zeros_like(rows) if committed else moving
        return rows

    def finish(
        self, samples: Judgement, time: TimeStep, enabled: Flags, results: NDArray[np.uint8], finite: Flags
    ) -> None:
        """Statuses, values and state of this scan; `finite` tells where the kernel's state is a number."""
        if self.quiet:  # what the kernel did makes a difference none the less
            self._lost = np.zeros_like(enabled)
            self._shown = np.zeros(len(enabled), np.uint8)
            self.carried.fill(False)
            self.ahead.fill(False)
        shown, lost = self._shown, self._lost
        broken = (shown == _COAST) & ~finite
        shown[broken] = self._after[broken]
        number = (samples.input_status < _BAD) & (np.abs(samples.z) <= samples.limit)
        shown[(shown == _PASS) & ~number] = _FAIL
        self.passed.fill(False)
        if shown.any():
            self._tell(samples, shown, lost)

        used = shown == _USE
        starting = used & _STARTING[results] & (time.rows | time.predict)
        if "NIS" in self._tags:
            coasted = used & time.rows & (self.state == AxisState.COAST)
            self._out |= coasted & (self._tags.row("NIS") > _UNEXPLAINED)
        self._settle(samples, time, used, enabled)
        state = _STATE_OF[shown]
        state[used & (self._left > 0)] = AxisState.REINIT
        state[starting] = np.where(self._ran[starting], AxisState.REINIT, AxisState.INIT)
        stuck = time.rows & ~finite & enabled
        self._out |= stuck & self._ran
        self._left[stuck] = np.where(self._left > 0, self._wanted, 0)[stuck]
        state[stuck] = np.where(self._values[stuck], AxisState.HOLD, AxisState.FAIL)
        state[~self._values & ((shown == _HOLD) | (shown == _FAIL))] = AxisState.INIT
        state[~enabled] = AxisState.DISABLED
        self._ran |= state == AxisState.RUN
        self._ran &= enabled
        self._ramp(samples, state == AxisState.REINIT)
        self._wait_after_late(samples, time, used & enabled)

        self.state[:] = state
        self._tags.row("State")[:] = state
        self._all_run = bool((state == AxisState.RUN).all()) and not self._late.any()

    def stamps(self, samples: Judgement, time: TimeStep) -> NDArray[np.int64]:
        """Source timestamps of what the estimates rest on: that of the newest used sample, or what passes through."""
        if self._all_run or not self.passed.any():
            return time.timestamps
        return np.where(self.passed, samples.timestamps, time.timestamps)

    def _tell(self, samples: Judgement, shown: NDArray[np.uint8], lost: Flags) -> None:
        """What the outputs are where there is no usable sample; Judgement has told what it is to hold or wait."""
        status, blank = samples.status, samples.blank
        if blank is None:
            samples.blank = blank = np.zeros(len(shown), np.bool_)
        old = (shown == _COAST) | ((shown == _HOLD) & lost & self._values)
        status[old] = np.where(
            lost,
            np.uint32(StatusCode.UNCERTAIN_NO_COMMUNICATION_LAST_USABLE_VALUE),
            np.uint32(StatusCode.UNCERTAIN_LAST_USABLE_VALUE),
        )[old]
        blank[old] = False

        fails = (shown == _FAIL) & ~lost
        stale = np.where(self._values, StatusCode.BAD_NO_COMMUNICATION, StatusCode.BAD_WAITING_FOR_INITIAL_DATA)
        own = np.where(samples.reason == Reason.STALE, stale, StatusCode.BAD_OUT_OF_RANGE)
        status[fails] = np.where(samples.input_status >= _BAD, samples.input_status, own.astype(np.uint32))[fails]
        blank[fails] = True

        self.passed = shown == _PASS
        if self.passed.any():
            np.copyto(self._tags.row("Position"), samples.z, where=self.passed)
            np.copyto(self._tags.row("Velocity"), 0.0, where=self.passed)
            status[self.passed] = StatusCode.UNCERTAIN_SUB_NORMAL
            samples.reason[self.passed] = Reason.PASSED_THROUGH
            blank[self.passed] = False
            self._values |= self.passed

    def _settle(self, samples: Judgement, time: TimeStep, used: Flags, enabled: Flags) -> None:
        """Count the fresh samples after an outage; a bad one starts the count anew."""
        self._out |= self._lost & self._ran & (self._shown != _COAST)
        owed = used & self._ran & (self._out | ~time.in_time) & (self._left == 0)
        counting = self._left > 0
        again = owed | (counting & ~used)
        self._left[again] = self._wanted[again]
        self._out[used] = False
        for numbers in (self._left, self._out):
            numbers[~enabled] = 0
        if not (owed | counting).any():
            return
        self._since += self._elapsed
        another = (samples.arrivals != self._arrivals) | (samples.timestamps != self._stamps)
        fresh = used & (self._left > 0) & time.rows & (another | (self._since >= _STILL))
        self._left[fresh] -= 1
        self._since[fresh] = 0.0
        np.copyto(self._arrivals, samples.arrivals, where=fresh)
        np.copyto(self._stamps, samples.timestamps, where=fresh)

    def _ramp(self, samples: Judgement, settling: Flags) -> None:
        """Position goes from where it was to the estimate, and what would be Good is not, while it settles."""
        if not settling.any():
            return
        position = self._tags.row("Position")
        way = (self._wanted - self._left) / self._wanted
        begin, rotary = self._from, self._turning
        if len(rotary):  # the short way round
            begin = begin.copy()
            begin[rotary] -= self._turn * np.rint((begin[rotary] - position[rotary]) / self._turn)
        ramped = begin * (1.0 - way) + position * way
        np.copyto(position, ramped, where=settling & (self._left > 0) & np.isfinite(ramped))
        _doubt(samples, settling)

    def _wait_after_late(self, samples: Judgement, time: TimeStep, used: Flags) -> None:
        """A late sample tells where the axis was and not when, so the velocity after it is wrong for a while."""
        self._late[~used] = 0
        if samples.late is not None:
            late = used & samples.late & self._ran
            self._late[late] = self._wanted[late] + 1
        waiting = self._late > 0
        if not waiting.any():
            return
        self._late[waiting & time.rows] -= 1
        _doubt(samples, self._late > 0)


def _doubt(samples: Judgement, rows: Flags) -> None:
    """What would be Good of these is not: the estimate settles."""
    plain = rows & ((samples.reason == Reason.NONE) | (samples.reason == Reason.PREDICTED))
    samples.reason[plain] = Reason.SETTLING
    samples.status[rows & (samples.status < np.uint32(StatusCode.UNCERTAIN))] = StatusCode.UNCERTAIN_INITIAL_VALUE
