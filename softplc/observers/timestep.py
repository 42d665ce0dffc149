"""The time step of each axis: measured, never lost, never negative; and what a repeated sample is worth."""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from softplc.observers.axes import AxisPlace
from softplc.observers.judgement import Judgement
from softplc.timing import Scan

Flags = NDArray[np.bool_]

_SAME_STEP: Final = 1.5  # the PLC's step and ours are the same when they differ by less than this factor


class TimeStep:
    """Decides for each axis and scan whether the observer steps and by how much. Arrays[axes], times in seconds.

    `dt`: the step where `rows` is true, the time to predict over where `predict` is true. `rows`: the observer
    takes this sample (or passes it through, where it is disabled). `predict`: it does not, and what is published
    is the state carried on to now. `timestamps`: source timestamp of the newest used sample, ns. `skipped`: scans
    since start in which an enabled axis had no usable sample or no time went by. `in_time`: it was not too long
    without a usable sample. `arrivals`: monotonic seconds of the newest used sample.
    """

    def __init__(self, places: Sequence[AxisPlace]) -> None:
        n, specs = len(places), [place.spec for place in places]
        self._by_arrival = np.array([spec.dt_source == "arrival" for spec in specs])
        self._by_stamp = np.array([spec.dt_source in ("source", "arrival") for spec in specs])
        self._nominal = np.array([spec.dt_source == "nominal" for spec in specs])
        self._may_predict = np.array([spec.on_repeat == "predict" for spec in specs])
        self._held_after = np.array([spec.held_after for spec in specs])
        self._reinit_after = np.array([spec.reinit_after for spec in specs])
        self._loses = np.array([spec.skipped_time == "lose" for spec in specs])
        self._by_scan_only = not (self._by_stamp.any() or self._may_predict.any())

        self._pending = np.zeros(n)  # measured time since the last step
        self.unseen = np.zeros(n)
        self._repeated_for = np.zeros(n)
        self._ahead = np.zeros(n)  # how far the state's time is ahead of the last used sample's stamp
        self._read = np.full(n, np.nan)  # the last used sample
        self.arrivals = np.full(n, np.nan)
        self._gap = np.zeros(n)
        self.in_time: Flags = np.zeros(n, np.bool_)
        self._running: Flags = np.zeros(n, np.bool_)

        self.skipped = np.zeros(n, np.int64)
        self.timestamps = np.zeros(n, np.int64)
        self.dt = np.zeros(n)
        self.rows: Flags = np.zeros(n, np.bool_)
        self.predict: Flags = np.zeros(n, np.bool_)

    def advance(
        self,
        scan: Scan,
        samples: Judgement,
        enabled: Flags,
        init: Flags,
        of_the_plc: NDArray[np.float64] | None = None,
    ) -> None:
        """Decide this scan's steps; clears `init[axes]` where the observer has to start again.

        `of_the_plc`: the step that the PLC's own observer used for this sample, seconds, NaN where that is not known.
        """
        elapsed = scan.dt if 0.0 < scan.dt < math.inf else 0.0
        usable = samples.usable
        self._pending += elapsed
        self.unseen += elapsed

        # Start again after disable, and after too long without a usable sample: a scan's own period is no gap.
        np.subtract(self.unseen, scan.period, out=self._gap)
        np.less_equal(self._gap, self._reinit_after, out=self.in_time)
        np.logical_and(init, self.in_time, out=init)
        np.logical_and(init, enabled, out=init)

        running = np.logical_and(usable, init, out=self._running)  # those that go on from where they are
        if self._by_scan_only:
            np.copyto(self.dt, self._pending)
            np.less_equal(self.dt, 0.0, out=self.predict)
            np.logical_and(self.predict, running, out=self.predict)
        else:
            self._measure(scan, elapsed, samples)
        np.greater(usable, self.predict, out=self.rows)
        if not running.all():
            started = self.rows & ~running  # or disabled
            self.dt[started] = np.where(enabled[started], elapsed, 0.0)
            self._repeated_for[started] = 0.0
        if self._nominal.any():
            np.copyto(self.dt, scan.period, where=self._nominal & (self.dt > 0.0))
        np.copyto(self.dt, self._pending, where=self.predict)
        if of_the_plc is not None:
            self._follow(of_the_plc, running, enabled)

        if not elapsed > 0.0 or not usable.all():
            self._skip(elapsed, usable, enabled)
        np.copyto(self._pending, 0.0, where=self.rows)
        np.copyto(self.unseen, 0.0, where=usable)
        np.copyto(self.timestamps, samples.timestamps, where=usable)
        np.copyto(self._read, samples.read, where=usable)
        np.copyto(self.arrivals, samples.arrivals, where=usable)

    def due(self, period: float, rows: Flags) -> None:
        """`dt` of rows that are to be carried on without a sample: all the time since they were last stepped."""
        np.copyto(self.dt, np.where(self._nominal & (self._pending > 0.0), period, self._pending), where=rows)

    def carried(self, rows: Flags, *, committed: bool) -> None:
        """These rows were carried on by their `dt`, which makes no gap; committed: their state is of now."""
        self.unseen[rows] = 0.0
        if committed:
            self._ahead[rows] += self.dt[rows]
            self._pending[rows] = 0.0

    def _skip(self, elapsed: float, usable: Flags, enabled: Flags) -> None:
        """Count what is skipped, and forget its time where the axis is to lose it as the AOI's own text does."""
        self.skipped += enabled & ~usable if elapsed > 0.0 else enabled
        np.copyto(self._pending, 0.0, where=self._loses & ~usable)

    def _measure(self, scan: Scan, elapsed: float, samples: Judgement) -> None:
        """`dt` and `predict` of running axes where timestamps or repeated samples matter."""
        usable, running = samples.usable, self._running
        since = np.where(
            self._by_arrival,
            samples.arrivals - self.arrivals,
            (samples.timestamps - self.timestamps) / 1e9,  # the double next to the quotient, as a PLC has it
        )
        same_stamp = since == 0.0
        # A frozen stamp under a new value is a new sample with a useless stamp, not a repetition.
        repeated = same_stamp & ((samples.arrivals == self.arrivals) | (samples.read == self._read))
        repeated_for = np.where(repeated, self._repeated_for + elapsed, 0.0)
        np.copyto(self._repeated_for, repeated_for, where=usable)
        predict = running & repeated & self._may_predict & (repeated_for < self._held_after)

        # The stamps' own interval, less what was already stepped on repetitions. Backwards, or further ahead of our
        # own clock than an axis may be without samples: the source's clock was set, our measured time serves.
        rest = since - self._ahead
        sound = self._by_stamp & (since > 0.0) & (rest <= self._pending + self._reinit_after)
        self.dt[:] = np.where(sound, rest, self._pending)
        self.predict[:] = predict | (running & (self.dt <= 0.0))

        # A state that steps, or starts, on a stamp that did not move gets ahead of it. What is left over when the
        # stamp moves is carried; above one period it is two clocks that run apart.
        carried = np.where(sound & running, np.clip(-rest, 0.0, scan.period), 0.0)
        ahead = np.where(same_stamp, self._ahead + self._pending, carried)
        np.copyto(self._ahead, ahead, where=usable & ~predict)

    def _follow(self, of_the_plc: NDArray[np.float64], running: Flags, enabled: Flags) -> None:
        """Use the PLC's own steps, unless they cannot span the time that we measured: then a sample was missed."""
        near = (of_the_plc < self.dt * _SAME_STEP) & (of_the_plc * _SAME_STEP > self.dt)
        starts = ~running & enabled & (of_the_plc > 0.0) & (of_the_plc <= self._reinit_after)
        np.copyto(self.dt, of_the_plc, where=self.rows & (starts | (running & near)))
