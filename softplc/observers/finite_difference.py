"""Finite difference: the position as measured, the velocity its backward difference. What filters are better than."""

from collections.abc import Sequence
from typing import Literal

from softplc.kernel.batch import finite_difference as batch
from softplc.model import Model
from softplc.observers.axes import AxisPlace, require_one_group
from softplc.observers.observer import AxisObserver
from softplc.observers.rows import RowsKernel


class FiniteDifferenceConfig(Model):
    """Position as measured, velocity its difference over the measured Δt. There is nothing to tune."""

    type: Literal["finite_difference"]

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
        return ()

    @staticmethod
    def build(places: Sequence[AxisPlace], configs: Sequence["FiniteDifferenceConfig"]) -> AxisObserver:
        """One observer that steps all these axes. Raises ValueError when they do not belong together."""
        require_one_group(places, configs)
        state = batch.FiniteDifferenceBatchState(len(places))
        kernel = RowsKernel(state, batch.FiniteDifferenceTuning(), batch.step, estimates={}, tuned={})
        return AxisObserver(places, state.dtype, kernel)
