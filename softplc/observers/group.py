"""What surrounds the kernel in every observer: samples in, verdicts, time steps, standard tags out."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import DTypeLike, NDArray

from softplc.kernel.result import Result
from softplc.observers.axes import AxisPlace
from softplc.observers.enable import Enable
from softplc.observers.judgement import Judgement
from softplc.observers.timestep import TimeStep
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

KERNEL_TAGS: Final = ("Position", "Velocity", "Innovation", "S", "K0", "K1", "P00", "P01", "P11")
"""The tags that a kernel's arrays fill, in this order."""
_ESTIMATES: Final = (*KERNEL_TAGS, "NIS", "Dt")


class AxisGroup:
    """All axes of one observer type and precision in one task. Arrays[axes]; one call of `begin` and `finish` a scan.

    Between the two the observer steps its kernel with `samples.z`, `time.dt`, `enable.state` on `time.rows`.
    `kernel` gives the kernel's own arrays for KERNEL_TAGS, `tuning` a constant[axes] for each tuning tag's last name
    part. Raises ValueError when the axes' blocks differ in their tags.
    """

    def __init__(
        self,
        places: Sequence[AxisPlace],
        dtype: DTypeLike,
        kernel: Sequence[NDArray[Any]],
        tuning: Mapping[str, NDArray[Any]],
    ) -> None:
        self.samples = Judgement(places, dtype)
        self.enable = Enable(places)
        self.time = TimeStep(places)
        self._kernel = tuple(kernel)
        self._tags = _Tags(places)
        n = len(places)
        self._has_values = np.zeros(n, np.bool_)
        self._arrivals = np.full(n, np.nan)  # newest ever
        self._started = np.nan
        for leaf, values in tuning.items():
            self._tags.row(leaf)[:] = values

    def begin(self, scan: Scan, inputs: Image, init: NDArray[np.bool_]) -> None:
        """Judge the samples and decide the time steps; clears `init` where the kernel has to start again."""
        self.enable.read(inputs)
        self.samples.judge(inputs, self._has_values)
        self.time.advance(scan, self.samples, self.enable.state, init)

    def finish(self, scan: Scan, outputs: Image, results: NDArray[np.uint8], finite: NDArray[np.bool_]) -> None:
        """Write the standard tags of what the kernel did; `finite` tells where its state is a number."""
        samples, time, tags = self.samples, self.time, self._tags
        usual = time.rows.all() and finite.all()
        if usual:
            for row, values in zip(tags.kernel, self._kernel, strict=True):
                row[:] = values
            np.copyto(tags.row("Dt"), time.dt)
            self._has_values.fill(True)
        else:
            self._take_some(finite)
        if not usual or results.any():
            self._explain(results, finite)

        innovation, S, nis = tags.row("Innovation"), tags.row("S"), tags.row("NIS")
        np.multiply(innovation, innovation, out=nis)
        np.divide(nis, S, out=nis, where=S > 0.0)
        np.copyto(nis, 0.0, where=~(S > 0.0))

        tags.row("Raw")[:] = samples.raw
        tags.row("Age")[:] = self._age(scan)
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
        for row, values in zip(tags.kernel, self._kernel, strict=True):
            np.copyto(row, values, where=taken)
        np.copyto(tags.row("Dt"), time.dt, where=taken | time.predict)
        self._has_values |= taken
        if time.predict.any():
            x, v = self._kernel[0], self._kernel[1]
            np.copyto(tags.row("Position"), x + v * time.dt, where=time.predict)
            np.copyto(tags.row("Velocity"), v, where=time.predict)

    def _explain(self, results: NDArray[np.uint8], finite: NDArray[np.bool_]) -> None:
        """Status and reason of what the kernel did; they go before what an Uncertain input says."""
        samples = self.samples
        for result, (status, reason) in _OUTCOME.items():
            where = results == result
            samples.status[where] = status
            samples.reason[where] = reason
        predicted = self.time.predict & (samples.reason == Reason.NONE)
        samples.reason[predicted] = Reason.PREDICTED
        stuck = predicted & ~(self._tags.row("S") > 0.0)  # the state that is carried on stems from a skipped update
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
        leaves = [tag.name.rpartition(".")[2] for tag in blocks[0].tags]
        for block in blocks:
            if [tag.name.rpartition(".")[2] for tag in block.tags] != leaves:
                raise ValueError(
                    f"axes of one observer must have the same tags: {blocks[0].name} and {block.name} differ"
                )
        shape = (len(leaves), len(blocks))
        self._rows = {leaf: row for row, leaf in enumerate(leaves)}
        self._estimates = np.array([self._rows[leaf] for leaf in _ESTIMATES], np.intp)
        starts = np.array([block.start for block in blocks], np.intp)
        self._index = starts[np.newaxis, :] + np.arange(len(leaves))[:, np.newaxis]
        adjacent = bool((np.diff(starts) == len(leaves)).all())
        self._run = slice(blocks[0].start, blocks[-1].stop) if adjacent else None
        self._values = np.zeros(shape)
        self._statuses = np.full(shape, StatusCode.GOOD, np.uint32)
        self._stamps = np.zeros(shape, np.int64)
        self._enable = np.zeros(len(blocks), np.bool_)
        self._first = True
        self.kernel = tuple(self.row(leaf) for leaf in KERNEL_TAGS)

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
        for leaf in ("Age", "Quality", "Reason", "Enabled"):
            self._stamps[rows[leaf]] = scan.timestamp
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
