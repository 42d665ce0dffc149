"""What clients may write: Enable, Reset and the tuning of each axis, where the configuration lets them."""

import math
from collections.abc import Sequence

import numpy as np

from softplc.observers.axes import AxisPlace
from softplc.observers.enable import Enable
from softplc.observers.kernel import Flags, Kernel
from softplc.tags import DataType, Tag


class Commands:
    """Takes written values between two scans; the next `begin` of the group acts on them.

    `resets` bool[axes]: the axis is to start anew. `reset_state` bool[axes]: what Reset shows. `retuned`: (leaf,
    axis) of parameters that were changed in the kernel, which keeps its state.
    """

    def __init__(self, places: Sequence[AxisPlace], enable: Enable, kernel: Kernel) -> None:
        self._enable, self._kernel = enable, kernel
        self._writable: dict[int, tuple[str, int, Tag]] = {}
        for axis, place in enumerate(places):
            for offset, tag in enumerate(place.block.tags):
                leaf = tag.name.rpartition(".")[2]
                if tag.writable and (leaf == "Reset" or leaf in kernel.tuning):
                    self._writable[place.block.start + offset] = (leaf, axis, tag)
        self.reset_state: Flags = np.zeros(len(places), np.bool_)
        self.resets: Flags = np.zeros(len(places), np.bool_)
        self.retuned: list[tuple[str, int]] = []

    def take(self, index: int, value: float) -> bool:
        """Take a written value for the tag at this index of the outputs; False when it cannot be taken."""
        if self._enable.command(index, value):
            return True
        found = self._writable.get(index)
        if found is None or not math.isfinite(value):
            return False
        leaf, axis, tag = found
        if leaf == "Reset":
            self.resets[axis] |= value != 0.0 and not self.reset_state[axis]
            self.reset_state[axis] = value != 0.0
            return True
        if not may_be_written(tag, value):
            return False
        self._kernel.tuning[leaf][axis] = value
        self.retuned.append((leaf, axis))
        return True


def may_be_written(tag: Tag, value: float) -> bool:
    """A finite value lies within the tag's limits, and is a whole number where the tag holds nothing else."""
    low, high = tag.limits or (-math.inf, math.inf)
    return low <= value <= high and (tag.data_type is DataType.DOUBLE or value == math.floor(value))
