"""Moving average: the mean of the last n samples, and the difference of two consecutive means over measured time."""

from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from softplc.kernel.batch import moving_average as batch
from softplc.model import Model
from softplc.observers.axes import AxisPlace, require_one_group
from softplc.observers.kernel import Given
from softplc.observers.observer import AxisObserver
from softplc.observers.rows import RowsKernel


class MovingAverageConfig(Model):
    """The mean of the last samples; it lags by (window − 1)/2 scans, its velocity by window/2."""

    type: Literal["moving_average"]
    window: Annotated[int, Field(ge=2, le=1000)]
    """Samples that are averaged. Bigger smooths more and lags more."""

    @property
    def group_key(self) -> tuple[str, ...]:
        """Axes of one task whose configurations have the same key are stepped by one observer."""
        return (self.type,)

    @property
    def estimates(self) -> tuple[str, ...]:
        """Leaves beside Position and Velocity."""
        return ()

    @property
    def tuning(self) -> tuple[str, ...]:
        """Leaves of the tuning."""
        return ("window",)

    @staticmethod
    def build(places: Sequence[AxisPlace], configs: Sequence["MovingAverageConfig"]) -> AxisObserver:
        """One observer that steps all these axes. Raises ValueError when they do not belong together."""
        require_one_group(places, configs)
        return AxisObserver(places, np.float64, MovingAverageKernel([config.window for config in configs]))


class MovingAverageKernel(RowsKernel):
    """The moving averages of n axes, each with its own window; an axis whose window is changed starts anew."""

    _state: batch.MovingAverageBatchState
    _tuning: batch.MovingAverageTuning

    def __init__(self, windows: Sequence[int]) -> None:
        state = batch.MovingAverageBatchState(len(windows), longest=max(windows))
        tuning = batch.MovingAverageTuning(window=windows)
        super().__init__(state, tuning, batch.step, estimates={}, tuned={"window": "window"})
        self._in_use = tuning.window.copy()

    def step(self, given: Given) -> NDArray[np.uint8]:
        """One scan of the rows."""
        window, state = self._tuning.window, self._state
        changed = window != self._in_use
        if changed.any():
            np.maximum(window, 2, out=window)
            state.reserve(int(window.max()))
            state.init[changed] = False
            self._in_use[:] = window
        return super().step(given)
