"""What surrounds the kernel in every observer: samples in, verdicts, time steps, standard tags out."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import DTypeLike, NDArray

from softplc.kernel.result import Result
from softplc.observers.axes import AxisPlace
from softplc.observers.enable import Enable
from softplc.observers.judgement import Judgement
from softplc.observers.kernel import Given, Kernel
from softplc.observers.leaves import STATE
from softplc.observers.timestep import TimeStep
from softplc.sample import Reason, StatusCode, quality
from softplc.tags import Block, Image, Role
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


class AxisGroup:
    """All axes that one kernel steps, in one task. Arrays[axes]; one call of `begin` and `finish` a scan.

    Between the two the observer steps the kernel with `given`. Raises ValueError when the axes' blocks differ in
    their tags.
    """

    def __init__(self, places: Sequence[AxisPlace], dtype: DTypeLike, kernel: Kernel) -> None:
        self.samples = Judgement(places, dtype)
        self.enable = Enable(places)
        self.time = TimeStep(places)
        self._kernel = kernel
        self._tags = _Tags(places)
        n = len(places)
        self._contacts = [(row, place.contact) for row, place in enumerate(places) if place.contact is not None]
        self.given = Given(self.enable.state, self.samples.z, self.time.dt, self.time.rows, np.full(n, np.nan))
        self._has_values = np.zeros(n, np.bool_)
        self._arrivals = np.full(n, np.nan)  # newest ever
        self._started = np.nan
        for leaf, values in kernel.tuning.items():
            self._tags.row(leaf)[:] = values

    def begin(self, scan: Scan, inputs: Image) -> None:
        """Judge the samples and decide the time steps; makes the kernel start anew where it has to."""
        self.enable.read(inputs)
        self.samples.judge(inputs, self._has_values)
        self.time.advance(scan, self.samples, self.enable.state, self._kernel.init)
        for row, index in self._contacts:
            self.given.contact[row] = inputs.values[index]  # NaN while it is Bad

    def finish(self, scan: Scan, outputs: Image, results: NDArray[np.uint8], finite: NDArray[np.bool_]) -> None:
        """Write the standard tags of what the kernel did; `finite` tells where its state is a number."""
        samples, time, tags = self.samples, self.time, self._tags
        usual = time.rows.all() and finite.all()
        if usual:
            for leaf, values in self._kernel.estimates.items():
                tags.row(leaf)[:] = values
            np.copyto(tags.row("Dt"), time.dt)
            self._has_values.fill(True)
        else:
            self._take_some(finite)
        if not usual or results.any():
            self._explain(results, finite)

        if "NIS" in tags:
            innovation, S, nis = tags.row("Innovation"), tags.row("S"), tags.row("NIS")
            np.multiply(innovation, innovation, out=nis)
            np.divide(nis, S, out=nis, where=S > 0.0)
            np.copyto(nis, 0.0, where=~(S > 0.0))

        tags.row("Raw")[:] = samples.raw
        tags.row("Age")[:] = self._age(scan)
        tags.row("Skipped")[:] = self.time.skipped
        tags.row("Quality")[:] = quality(samples.status)
        tags.row("Reason")[:] = samples.reason
        tags.row("Enabled")[:] = self.enable.state
        tags.write(scan, outputs, samples, time.timestamps, self.enable.state)

    def park(self, outputs: Image) -> None:
        """Every estimate is NaN and BadInternalError from here; Raw stays as it was last."""
        self._tags.park(outputs)

    def _take_some(self, finite: NDArray[np.bool_]) -> None:
        """Take over the rows that stepped, predict those that did not, hold the others as they were."""
        tags, time = self._tags, self.time
        taken = time.rows & finite
        for leaf, values in self._kernel.estimates.items():
            np.copyto(tags.row(leaf), values, where=taken)
        np.copyto(tags.row("Dt"), time.dt, where=taken | time.predict)
        self._has_values |= taken
        if time.predict.any():
            position, velocity = self._kernel.predict(time.dt)
            np.copyto(tags.row("Position"), position, where=time.predict)
            np.copyto(tags.row("Velocity"), velocity, where=time.predict)

    def _explain(self, results: NDArray[np.uint8], finite: NDArray[np.bool_]) -> None:
        """Status and reason of what the kernel did; they go before what an Uncertain input says."""
        samples = self.samples
        for result, (status, reason) in _OUTCOME.items():
            where = results == result
            samples.status[where] = status
            samples.reason[where] = reason
        predicted = self.time.predict & (samples.reason == Reason.NONE)
        samples.reason[predicted] = Reason.PREDICTED
        if "S" in self._tags:  # what is carried on may stem from a skipped update
            stuck = predicted & ~(self._tags.row("S") > 0.0)
            samples.status[stuck], samples.reason[stuck] = _OUTCOME[Result.S_NOT_POSITIVE]

        lost = self.time.rows & ~finite
        if lost.any():
            nothing = lost & ~self._has_values
            samples.status[lost] = StatusCode.UNCERTAIN_LAST_USABLE_VALUE
            samples.status[nothing] = StatusCode.BAD_OUT_OF_RANGE
            samples.reason[lost] = Reason.NOT_FINITE
            samples.blank = nothing if samples.blank is None else samples.blank | nothing

    def _age(self, scan: Scan) -> NDArray[np.float64]:
        """Seconds since the newest sample arrived, since the first scan where none ever did."""
        if np.isnan(self._started):
            self._started = scan.start
        np.fmax(self._arrivals, self.samples.arrivals, out=self._arrivals)
        age: NDArray[np.float64] = scan.start - np.where(np.isnan(self._arrivals), self._started, self._arrivals)
        np.maximum(age, 0.0, out=age)
        return age


class _Tags:
    """The published tags of the group as arrays[tags, axes], and where they lie in the outputs."""

    def __init__(self, places: Sequence[AxisPlace]) -> None:
        blocks = [place.block for place in places]
        leaves = _leaves(blocks[0])
        for block in blocks:
            if _leaves(block) != leaves:
                raise ValueError(
                    f"axes of one observer must have the same tags: {blocks[0].name} and {block.name} differ"
                )
        shape = (len(leaves), len(blocks))
        self._rows = {leaf: row for row, leaf in enumerate(leaves)}
        tuning = {leaf for tag, leaf in zip(blocks[0].tags, leaves, strict=True) if tag.role is Role.TUNING}
        others = {"Raw", *STATE, *tuning}
        self._estimates = np.array([row for leaf, row in self._rows.items() if leaf not in others], np.intp)
        self._state = np.array(
            [row for leaf, row in self._rows.items() if leaf in STATE and leaf != "Enable"], np.intp
        )
        starts = np.array([block.start for block in blocks], np.intp)
        self._index = starts[np.newaxis, :] + np.arange(len(leaves))[:, np.newaxis]
        adjacent = bool((np.diff(starts) == len(leaves)).all())
        self._run = slice(blocks[0].start, blocks[-1].stop) if adjacent else None
        self._values = np.zeros(shape)
        self._statuses = np.full(shape, StatusCode.GOOD, np.uint32)
        self._stamps = np.zeros(shape, np.int64)
        self._enable = np.zeros(len(blocks), np.bool_)
        self._first = True

    def __contains__(self, leaf: str) -> bool:
        return leaf in self._rows

    def row(self, leaf: str) -> NDArray[np.float64]:
        """The values of one tag of every axis; they stay until they are overwritten."""
        values: NDArray[np.float64] = self._values[self._rows[leaf]]
        return values

    def write(
        self,
        scan: Scan,
        outputs: Image,
        samples: Judgement,
        timestamps: NDArray[np.int64],
        enable: NDArray[np.bool_],
    ) -> None:
        """Copy everything into the outputs; estimates of axes without a value become NaN there, not here."""
        rows, values = self._rows, self._values
        self._statuses[self._estimates] = samples.status
        self._statuses[rows["Raw"]] = samples.raw_status
        self._stamps[self._estimates] = timestamps
        self._stamps[rows["Raw"]] = samples.timestamps
        self._stamps[self._state] = scan.timestamp
        if self._first:  # tuning and Enable carry the time since when they are as they are
            self._stamps[rows["Enable"] :] = scan.timestamp
            self._first = False
        np.copyto(self._stamps[rows["Enable"]], scan.timestamp, where=enable != self._enable)
        self._enable[:] = values[rows["Enable"]] = enable

        if samples.blank is not None and samples.blank.any():
            values = values.copy()
            values[np.ix_(self._estimates, np.flatnonzero(samples.blank))] = np.nan
        for image, own in (
            (outputs.values, values),
            (outputs.statuses, self._statuses),
            (outputs.source_timestamps, self._stamps),
        ):
            if self._run is None:
                image[self._index] = own
            else:
                image[self._run].reshape(own.shape[::-1])[:] = own.T

    def park(self, outputs: Image) -> None:
        """Mark the estimates in the outputs, and say why."""
        estimates = self._index[self._estimates]
        outputs.values[estimates] = np.nan
        outputs.statuses[estimates] = StatusCode.BAD_INTERNAL_ERROR
        for leaf, value in (("Quality", 0), ("Reason", Reason.INTERNAL_ERROR), ("Enabled", 0)):
            outputs.values[self._index[self._rows[leaf]]] = value
            outputs.statuses[self._index[self._rows[leaf]]] = StatusCode.GOOD


def _leaves(block: Block) -> list[str]:
    return [tag.name.rpartition(".")[2] for tag in block.tags]
