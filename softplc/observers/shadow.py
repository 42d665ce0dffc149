"""An axis beside the same observer in the PLC: the difference of the two, and its largest amount, as tags.

A difference is taken in each scan in which our observer stepped, of our estimate and of the PLC's own output as it
was latched in the same scan. When both saw every sample with the same time steps, it is exactly zero.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from softplc.kernel.result import Result
from softplc.observers.axes import AxisPlace
from softplc.observers.judgement import Judgement
from softplc.observers.kernel import Flags
from softplc.observers.published import Published
from softplc.sample import StatusCode
from softplc.tags import Image
from softplc.timing import Scan

_BAD: Final = np.uint32(StatusCode.BAD)
_WAITING: Final = np.uint32(StatusCode.BAD_WAITING_FOR_INITIAL_DATA)
_SEVERITY: Final = np.uint32(30)  # the top two bits
_PASSED_THROUGH: Final = (Result.DISABLED, Result.DT_INVALID, Result.SKIPPED)


class Shadow:
    """Fills the difference tags of n axes that have the same of them. Arrays[n]."""

    def __init__(self, places: Sequence[AxisPlace], tags: Published) -> None:
        spec = places[0].spec
        self._tags = tags
        self._settling = np.array([place.spec.shadow_settling for place in places])
        self._running_for = np.zeros(len(places))
        self._was_enabled: Flags = np.zeros(len(places), np.bool_)
        self._pairs: list[_Pair] = []
        if "position" in spec.shadow:
            turns = [place.spec.signal.modulo if place.spec.signal else None for place in places]
            self._pairs.append(_Pair("Position", [place.shadow_position for place in places], tags, turns))
        if "velocity" in spec.shadow:
            self._pairs.append(_Pair("Velocity", [place.shadow_velocity for place in places], tags))

    def clear(self, rows: Flags) -> None:
        """Begin again to look for the largest difference."""
        self._running_for[rows] = 0.0
        for pair in self._pairs:
            pair.largest[rows] = np.nan

    def judge(
        self,
        scan: Scan,
        inputs: Image,
        samples: Judgement,
        stepped: Flags,
        enabled: Flags,
        results: NDArray[np.uint8],
    ) -> None:
        """Compare what the kernel did in this scan; `stepped` are the rows whose state is from this scan."""
        risen = enabled & ~self._was_enabled
        if risen.any():
            self.clear(risen)
        self._was_enabled[:] = enabled
        self._running_for += max(scan.dt, 0.0)
        self._running_for[results == Result.INITIALISED] = 0.0

        compared = stepped & ~np.isin(results, _PASSED_THROUGH)
        settled = compared & (self._running_for >= self._settling)
        for pair in self._pairs:
            pair.compare(inputs, compared, settled)
            pair.publish(self._tags, samples)


class _Pair:
    """One quantity, ours and the PLC's; where an axis turns, differences are modulo its `turns`."""

    def __init__(
        self,
        quantity: str,
        index: Sequence[int | None],
        tags: Published,
        turns: Sequence[float | None] = (),
    ) -> None:
        if any(at is None for at in index):
            raise ValueError(f"expected the place of the PLC's own {quantity.lower()} among the inputs for each axis")
        self._index = np.array(index, np.intp)
        self._turning = np.flatnonzero([turn is not None for turn in turns])
        self._turn = np.array([turn for turn in turns if turn is not None])
        self._own = tags.row(quantity)
        self._rows = tags.rows(f"{quantity}Delta"), tags.rows(f"{quantity}DeltaMax")
        self._shown = tags.row(f"{quantity}Delta"), tags.row(f"{quantity}DeltaMax")
        self._last = np.full(len(index), np.nan)
        self._status = np.zeros(len(index), np.uint32)
        self.largest = np.full(len(index), np.nan)

    def compare(self, inputs: Image, compared: Flags, settled: Flags) -> None:
        """Take the differences of the rows that are to be compared; those that are settled count for the largest."""
        value, status = inputs.values[self._index], inputs.statuses[self._index]
        finite = np.isfinite(value)
        self._status = np.where(finite | (status >= _BAD), status, np.uint32(StatusCode.BAD_OUT_OF_RANGE))
        known = finite & (status < _BAD)
        delta = self._own - value
        if len(self._turning):
            delta[self._turning] -= self._turn * np.rint(delta[self._turning] / self._turn)
        np.copyto(self._last, delta, where=compared & known)
        np.copyto(self.largest, np.fmax(self.largest, np.abs(delta)), where=settled & known)

    def publish(self, tags: Published, samples: Judgement) -> None:
        """The difference is as good as the worse of the two; the largest is Good from the first that counted."""
        theirs_is_worse = self._status >> _SEVERITY > samples.status >> _SEVERITY
        status = np.where(theirs_is_worse, self._status, samples.status)
        if samples.blank is not None:
            status = np.where(samples.blank, samples.status, status)
        status = np.where(np.isnan(self._last) & (status < _BAD), _WAITING, status)
        delta, largest = self._shown
        delta[:] = np.where(status >= _BAD, np.nan, self._last)
        largest[:] = self.largest
        tags.tell(self._rows[0], status)
        tags.tell(self._rows[1], np.where(np.isnan(self.largest), _WAITING, np.uint32(StatusCode.GOOD)))
