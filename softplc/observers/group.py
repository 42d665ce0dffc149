"""What surrounds the kernel in every observer: samples in, verdicts, time steps, standard tags out."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import DTypeLike, NDArray

from softplc.kernel.result import Result
from softplc.observers.axes import AxisPlace
from softplc.observers.commands import Commands
from softplc.observers.consistency import LAMP, Consistency
from softplc.observers.enable import Enable
from softplc.observers.judgement import Judgement
from softplc.observers.kernel import Flags, Given, Kernel, Numbers
from softplc.observers.modes import Modes
from softplc.observers.now import Now
from softplc.observers.parked import Waiting
from softplc.observers.published import Published
from softplc.observers.shadow import Shadow
from softplc.observers.timestep import TimeStep
from softplc.observers.turns import Turns
from softplc.sample import Reason, StatusCode, quality
from softplc.tags import Image
from softplc.timing import Scan

_OUTCOME: Final = {
    Result.INITIALISED: (StatusCode.UNCERTAIN_INITIAL_VALUE, Reason.INITIALISING),
    Result.DISABLED: (StatusCode.UNCERTAIN_SUB_NORMAL, Reason.DISABLED),
    Result.DT_INVALID: (StatusCode.UNCERTAIN_SUB_NORMAL, Reason.DT_INVALID),
    Result.S_NOT_POSITIVE: (StatusCode.UNCERTAIN_SUB_NORMAL, Reason.INNOVATION_VARIANCE),
    Result.REJECTED: (StatusCode.UNCERTAIN_SUB_NORMAL, Reason.INNOVATION_GATE),
    Result.HELD: (StatusCode.UNCERTAIN_SUB_NORMAL, Reason.HELD_AT_STOP),
    Result.WARMING_UP: (StatusCode.UNCERTAIN_INITIAL_VALUE, Reason.INITIALISING),
}

_MOST: Final = float(np.finfo(np.float64).max)
_FAR_OFF: Final = 1e6  # NIS: a thousand σ, which no noise and no motion makes, but one wild sample does


class AxisGroup:
    """All axes that one kernel steps, in one task. Arrays[axes]; one call of `begin` and `finish` a scan.

    Between the two the observer steps the kernel with `given`. Raises ValueError when the axes' blocks differ in
    their tags, or the axes in the window of their consistency tags.
    """

    def __init__(self, places: Sequence[AxisPlace], dtype: DTypeLike, kernel: Kernel) -> None:
        self.samples = Judgement(places, dtype)
        self.enable = Enable(places)
        self.time = TimeStep(places)
        self._kernel = kernel
        self.commands = Commands(places, self.enable, kernel)
        self._tags = Published(places)
        n = len(places)
        contacts = [(row, place.contact) for row, place in enumerate(places) if place.contact is not None]
        self._contacts = np.array(contacts, np.intp).reshape(-1, 2).T  # rows, and their inputs
        self.given = Given(self.enable.state, self.samples.z, self.time.dt, self.time.rows, np.full(n, np.nan))
        self._has_values = np.zeros(n, np.bool_)
        self.modes = Modes(places, kernel, self._tags, self._has_values)
        self._rejected = np.zeros(n, np.bool_)  # the last sample that was stepped
        self._started_on = np.zeros(n, np.bool_)  # the same: velocity is an assumption yet
        self._arrivals = np.full(n, np.nan)  # newest ever
        self._started = np.nan
        for leaf, values in kernel.tuning.items():
            self._tags.row(leaf)[:] = values
        spec = places[0].spec
        if any((place.spec.consistency, place.spec.shadow) != (spec.consistency, spec.shadow) for place in places):
            raise ValueError("axes of one observer must have the same consistency and shadow")
        self._consistency = Consistency(spec, kernel, self._tags, n, dtype) if LAMP in self._tags else None
        self._shadow = Shadow(places, self._tags) if spec.shadow else None
        own_dt = [-1 if place.shadow_dt is None else place.shadow_dt for place in places]
        self._own_dt = np.array(own_dt, np.intp) if any(index >= 0 for index in own_dt) else None
        self._turns = (
            Turns(places) if any(place.spec.signal and place.spec.signal.modulo for place in places) else None
        )
        self._now = None if spec.dead_time is None else Now(places, kernel, self._tags)
        self._inputs: Image | None = None

    def begin(self, scan: Scan, inputs: Image) -> None:
        """Judge the samples and decide the time steps; makes the kernel start anew where it has to."""
        self._inputs = inputs
        if np.isnan(self._started):
            self._started = scan.start
        self.enable.read(inputs)
        self._obey()
        self.samples.judge(scan, inputs, self._has_values, self.time.unseen)
        if self.samples.signal is not None and self.samples.signal.anew is not None:
            self._kernel.init[self.samples.signal.anew] = False
        self.time.advance(scan, self.samples, self.enable.state, self._kernel.init, self._steps_of_the_plc(inputs))
        self.modes.begin(scan, self.samples, self.time, self.enable.state)
        rows, contacts = self._contacts
        self.given.contact[rows] = inputs.values[contacts]  # NaN while it is Bad

    def _obey(self) -> None:
        """Do what clients have written since the last scan. A new tuning leaves the state as it is."""
        commands = self.commands
        if commands.retuned:
            retuned: Flags = np.zeros(len(commands.resets), np.bool_)
            for leaf, axis in commands.retuned:
                self._tags.retuned(leaf, axis, float(self._kernel.tuning[leaf][axis]))
                retuned[axis] = True
            commands.retuned.clear()
            if self._consistency is not None:
                self._consistency.clear(retuned)
        if commands.resets.any():
            self._kernel.clear(commands.resets)
            self.modes.clear(commands.resets)
            for room in (self._consistency, self._shadow, self.samples.signal):
                if room is not None:
                    room.clear(commands.resets)
            commands.resets.fill(False)

    def _steps_of_the_plc(self, inputs: Image) -> NDArray[np.float64] | None:
        """The time steps that PLCs measured themselves, seconds; NaN where there is none."""
        if self._own_dt is None:
            return None
        known = (self._own_dt >= 0) & (inputs.statuses[self._own_dt] < np.uint32(StatusCode.BAD))
        return np.where(known, inputs.values[self._own_dt] / 1000.0, np.nan)

    def finish(self, scan: Scan, outputs: Image, results: NDArray[np.uint8], finite: NDArray[np.bool_]) -> None:
        """Write the standard tags of what the kernel did; `finite` tells where its state is a number."""
        samples, time, tags = self.samples, self.time, self._tags
        if self._turns is not None:
            self._turns.shift(self._kernel, samples.signal)
        usual = time.rows.all() and finite.all()
        if usual:
            for leaf, values in self._kernel.estimates.items():
                tags.row(leaf)[:] = values
            np.copyto(tags.row("Dt"), time.dt)
            self._has_values.fill(True)
        else:
            self._take_some(finite)
        plain = usual and not results.any()
        if plain:
            self._rejected.fill(False)
            self._started_on.fill(False)
        else:
            self._explain(results, finite)

        if "NIS" in tags:
            self._normalise(tags.row("Innovation"), tags.row("S"), tags.row("NIS"))

        if not plain or not self.modes.quiet:
            self.modes.finish(samples, time, self.enable.state, results, finite)
        self._finish_positions(scan, results, finite)
        stepped = time.rows & finite
        if self._consistency is not None:
            self._consistency.judge(samples, stepped, results)
        if self._shadow is not None and self._inputs is not None:
            self._shadow.judge(scan, self._inputs, samples, stepped, self.enable.state, results)

        tags.row("Raw")[:] = samples.raw
        tags.row("Age")[:] = self._age(scan)
        tags.row("Skipped")[:] = self.time.skipped
        tags.row("Quality")[:] = quality(samples.status)
        tags.row("Reason")[:] = samples.reason
        tags.row("Enabled")[:] = tags.row("Enable")[:] = self.enable.state
        tags.row("Reset")[:] = self.commands.reset_state
        tags.write(scan, outputs, samples, self.modes.stamps(samples, time))

    def _finish_positions(self, scan: Scan, results: NDArray[np.uint8], finite: Flags) -> None:
        """Positions of now, and those of rotary axes within their turn, after whatever else wrote them."""
        if self._now is not None:
            self._now.publish(scan, self.samples, self.time, self.modes, results, finite)
        if self._turns is not None:
            self._turns.wrap(self._tags)

    def succeed(self, other: "AxisGroup", rows: NDArray[np.intp], *, ramp: bool) -> None:
        """Go on for these axes of another group, whose state is lost; `ramp`: from the positions that they had."""
        self.enable.state[:] = other.enable.state[rows]
        self.commands.reset_state[:] = other.commands.reset_state[rows]
        self.time.skipped[:] = other.time.skipped[rows]
        for leaf, values in self._kernel.tuning.items():
            values[:] = other._kernel.tuning[leaf][rows]
            self._tags.row(leaf)[:] = values
        self._arrivals[:], self._started = other._arrivals[rows], other._started
        self.time.timestamps[:] = other.time.timestamps[rows]
        if self.samples.signal is not None and other.samples.signal is not None:
            self.samples.signal.adopt(other.samples.signal, rows)
        if ramp:
            self._tags.adopt(other._tags, rows)
            self._has_values[:] = other._has_values[rows]
        self.modes.resume(other.modes, rows)

    def park(self, outputs: Image) -> None:
        """Every estimate is NaN and BadInternalError from here; Raw keeps its last value, Uncertain."""
        self._tags.park(outputs)

    @property
    def waiting(self) -> Waiting:
        """Age, and what else goes on of axes that are parked."""
        return Waiting(self._tags.ages, self._since(), self._tags.of_each_scan)

    def _take_some(self, finite: NDArray[np.bool_]) -> None:
        """Take over the rows that stepped, predict those that did not, hold the others as they were."""
        tags, time, modes = self._tags, self.time, self.modes
        taken = time.rows & finite
        new = taken | (modes.carried & finite)
        for leaf, values in self._kernel.estimates.items():
            np.copyto(tags.row(leaf), values, where=new)
        self._has_values |= taken
        ahead = time.predict | modes.ahead
        np.copyto(tags.row("Dt"), time.dt, where=new | ahead)
        if ahead.any():
            position, velocity = self._kernel.predict(time.dt)
            np.copyto(tags.row("Position"), position, where=ahead)
            np.copyto(tags.row("Velocity"), velocity, where=ahead)

    def _explain(self, results: NDArray[np.uint8], finite: NDArray[np.bool_]) -> None:
        """Status and reason of what the kernel did; they go before what an Uncertain input says."""
        samples = self.samples
        starts = (results == Result.INITIALISED) | (results == Result.WARMING_UP)
        np.copyto(self._started_on, starts, where=self.time.rows)
        results[self.time.predict & self._started_on] = Result.INITIALISED  # a repetition tells no velocity
        for result, (status, reason) in _OUTCOME.items():
            where = results == result
            samples.status[where] = status
            samples.reason[where] = reason
        predicted = self.time.predict & (samples.reason == Reason.NONE)
        samples.reason[predicted] = Reason.PREDICTED
        if "S" in self._tags:  # what is carried on may stem from a skipped update
            stuck = predicted & ~(self._tags.row("S") > 0.0)
            samples.status[stuck], samples.reason[stuck] = _OUTCOME[Result.S_NOT_POSITIVE]
        np.copyto(self._rejected, results == Result.REJECTED, where=self.time.rows)
        again = predicted & self._rejected  # a rejected sample is no better for being repeated
        samples.status[again], samples.reason[again] = _OUTCOME[Result.REJECTED]

        lost = self.time.rows & ~finite
        if lost.any():
            nothing = lost & ~self._has_values
            samples.status[lost] = StatusCode.UNCERTAIN_LAST_USABLE_VALUE
            samples.status[nothing] = StatusCode.BAD_OUT_OF_RANGE
            samples.reason[lost] = Reason.NOT_FINITE
            samples.blank = nothing if samples.blank is None else samples.blank | nothing

    def _normalise(self, innovation: Numbers, S: Numbers, nis: Numbers) -> None:
        """NIS of every axis, y²/S; one that nothing explains makes its axis Uncertain."""
        np.multiply(innovation, innovation, out=nis)
        np.divide(nis, S, out=nis, where=S > 0.0)
        np.copyto(nis, 0.0, where=~(S > 0.0))
        np.minimum(nis, _MOST, out=nis)  # the square may overflow where nothing else did
        if nis.max() > _FAR_OFF:
            self._doubt(nis > _FAR_OFF)

    def _doubt(self, far: Flags) -> None:
        """A wild sample that nothing kept out is in the state: say so until the estimate has found back."""
        samples = self.samples
        far &= (samples.reason == Reason.NONE) | (samples.reason == Reason.PREDICTED)
        samples.status[far], samples.reason[far] = StatusCode.UNCERTAIN_SUB_NORMAL, Reason.FAR_OFF

    def _age(self, scan: Scan) -> NDArray[np.float64]:
        """Seconds since the newest sample arrived, since the first scan where none ever did."""
        np.fmax(self._arrivals, self.samples.arrivals, out=self._arrivals)
        age: NDArray[np.float64] = np.maximum(scan.start - self._since(), 0.0)
        return age

    def _since(self) -> NDArray[np.float64]:
        return np.where(np.isnan(self._arrivals), self._started, self._arrivals)
