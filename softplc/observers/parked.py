"""What goes on of axes that nobody steps any more: Age grows, and what tells its state has the time of the scan."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from softplc.tags import Image
from softplc.timing import Scan


class Waiting(NamedTuple):
    """Where the tags lie in the outputs: `ages` [n] and all that are of each scan; `since` [n] monotonic seconds."""

    ages: NDArray[np.intp]
    since: NDArray[np.float64]
    each_scan: NDArray[np.intp]

    def go_on(self, scan: Scan, outputs: Image) -> None:
        """One scan of waiting."""
        outputs.values[self.ages] = np.maximum(scan.start - self.since, 0.0)
        outputs.source_timestamps[self.each_scan] = scan.timestamp


def together(parts: Sequence[Waiting]) -> Waiting:
    """The axes of all parts, of one at least."""
    return Waiting(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))
