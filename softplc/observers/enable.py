"""Whether each axis' observer is to run: by configuration, by a tag of a source, or by a tag that clients write."""

import math
from collections.abc import Sequence

import numpy as np

from softplc.observers.axes import AxisPlace
from softplc.sample import StatusCode
from softplc.tags import Image


class Enable:
    """`state` bool[axes]: the observer is to run."""

    def __init__(self, places: Sequence[AxisPlace]) -> None:
        self.state = np.array([place.spec.enable for place in places], np.bool_)
        tagged = [(row, place.enable) for row, place in enumerate(places) if place.enable is not None]
        self._rows = np.array([row for row, _ in tagged], np.intp)
        self._index = np.array([index for _, index in tagged], np.intp)
        self._writable = {
            place.block.index("Enable"): row for row, place in enumerate(places) if place.spec.enable_writable
        }

    def read(self, inputs: Image) -> None:
        """Follow the enable tags: not 0 is true; a Bad one, or NaN, leaves the state as it was."""
        if not len(self._index):
            return
        values = inputs.values[self._index]
        known = (inputs.statuses[self._index] < np.uint32(StatusCode.BAD)) & ~np.isnan(values)
        self.state[self._rows[known]] = values[known] != 0.0

    def command(self, index: int, value: float) -> bool:
        """Take a written value for the Enable tag at this index of the outputs; False when it is not writable."""
        row = self._writable.get(index)
        if row is None or math.isnan(value):
            return False
        self.state[row] = value != 0.0
        return True
