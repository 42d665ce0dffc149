"""The one implementation of the Observer contract: any kernel, surrounded by what all observers share."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import DTypeLike, NDArray

from softplc.observers.axes import AxisPlace
from softplc.observers.group import AxisGroup
from softplc.observers.kernel import Kernel
from softplc.observers.parked import Waiting
from softplc.tags import Image
from softplc.timing import Scan


class AxisObserver:
    """Steps every axis of the group in one call into its kernel.

    `dtype` is the precision of the kernel. Raises ValueError when the axes' blocks differ in their tags.
    """

    def __init__(self, places: Sequence[AxisPlace], dtype: DTypeLike, kernel: Kernel) -> None:
        self._kernel = kernel
        self._group = AxisGroup(places, dtype, kernel)

    @np.errstate(all="ignore")
    def step(self, scan: Scan, inputs: Image, outputs: Image) -> None:
        """Advance every axis by one scan: latched `inputs` in, the axes' blocks of `outputs` out."""
        kernel, group = self._kernel, self._group
        group.begin(scan, inputs)
        results = kernel.step(group.given)
        finite = kernel.finite()
        if not finite.all():
            kernel.clear(~finite)  # they start again with the next usable sample
        group.finish(scan, outputs, results, finite)

    def succeed(self, other: "AxisObserver", rows: NDArray[np.intp], *, ramp: bool) -> None:
        """Take the place of these axes of another observer: all that clients have written, none of its state.

        The axes come back as after an outage; `ramp`: from the positions that they had.
        """
        self._group.succeed(other._group, rows, ramp=ramp)

    def command(self, index: int, value: float) -> bool:
        """Take a written value for the tag at this index of `outputs`; False when it is none of the writable ones."""
        return self._group.commands.take(index, value)

    def park(self, scan: Scan, outputs: Image) -> None:
        """Mark the estimates of every axis Bad: this observer failed and is not stepped any more."""
        self._group.park(outputs)
        self.waiting.go_on(scan, outputs)

    @property
    def waiting(self) -> Waiting:
        """What goes on of its axes while they are parked."""
        return self._group.waiting
