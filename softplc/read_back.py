"""What is read back of written tags: it has to be one of the values that were written lately."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from softplc.sample import StatusCode, WriteState
from softplc.tags import Image

_REMEMBERED: Final = 64  # answered writes, of which any may still be read back
_REAL: Final = 2.0**-23  # what a REAL loses of a value, at the most

Rows = NDArray[np.intp]
Numbers = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ReadBack:
    """The written tag as it is read along: its index in the inputs, and what counts as the same value.

    `tolerance` in the output's unit. `within`: seconds in which an older value may still be read back; one that was
    never written, or longer ago, is a mismatch.
    """

    index: int
    tolerance: float
    within: float


class ReadBacks:
    """The tags that are read back, and what was written into them: `rows` says which of them."""

    def __init__(self, tags: Sequence[ReadBack]) -> None:
        self._indices = np.array([tag.index for tag in tags], np.intp)
        self._tolerances = np.array([tag.tolerance for tag in tags], np.float64)
        self._within = np.array([tag.within for tag in tags], np.float64)
        self._values = np.zeros((len(tags), _REMEMBERED))
        self._times = np.zeros((len(tags), _REMEMBERED))
        self._newest = np.full(len(tags), -1, np.intp)  # number of the last value written
        self._first = np.zeros(len(tags), np.intp)  # number of the first one that counts

    def note(self, rows: Rows, values: Numbers, times: Numbers) -> None:
        """The source took these values, at these monotonic times."""
        self._newest[rows] += 1
        places = self._newest[rows] % _REMEMBERED
        self._values[rows, places], self._times[rows, places] = values, times

    def forget(self, rows: Rows) -> None:
        """The link was lost, or the output was not Good: what the source holds is not ours any more."""
        self._first[rows] = self._newest[rows] + 1

    def found(self, row: int, inputs: Image) -> float:
        """What was read back last."""
        return inputs.values.item(self._indices[row])

    def judge(self, rows: Rows, now: float, inputs: Image) -> NDArray[np.uint8]:
        """The WriteState of each: what was read in this scan, compared with what was written, the newest first."""
        statuses, found = inputs.statuses[self._indices[rows]], inputs.values[self._indices[rows]]
        states = np.full(len(rows), WriteState.WAITING, np.uint8)
        states[statuses >= np.uint32(StatusCode.BAD)] = WriteState.UNVERIFIED
        left = np.flatnonzero(statuses == StatusCode.GOOD)
        for back in range(_REMEMBERED):
            left = left[self._newest[rows[left]] - back >= self._first[rows[left]]]
            if not left.size:
                return states
            row = rows[left]
            places = (self._newest[row] - back) % _REMEMBERED
            written, age = self._values[row, places], now - self._times[row, places]
            alike = np.abs(found[left] - written) <= self._tolerances[row] + _REAL * np.abs(written)
            old = ~alike & (age > self._within[row])
            states[left[alike]] = WriteState.WRITTEN
            states[left[old]] = WriteState.MISMATCH
            left = left[~alike & ~old]
        states[left] = WriteState.MISMATCH  # unlike everything that is remembered
        return states
