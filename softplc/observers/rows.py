"""The adapter of a batch kernel whose state is named rows: it says which array is which leaf."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from softplc.kernel.batch.frame import Rows
from softplc.observers.kernel import Given, StateKernel


class RowsKernel(StateKernel):
    """n axes of one batch kernel. `estimates`: leaf → name of the state's array, beside Position and Velocity.

    `tuned`: leaf → name of the tuning's array.
    """

    def __init__(
        self,
        state: Rows,
        tuning: Any,
        step: Callable[..., NDArray[np.uint8]],
        *,
        estimates: Mapping[str, str],
        tuned: Mapping[str, str],
    ) -> None:
        super().__init__(
            state,
            {leaf: getattr(state, name) for leaf, name in estimates.items()},
            {leaf: getattr(tuning, name) for leaf, name in tuned.items()},
        )
        self._state, self._tuning, self._step = state, tuning, step

    def step(self, given: Given) -> NDArray[np.uint8]:
        """One scan of the rows."""
        return self._step(self._state, self._tuning, EnableIn=given.enable, x=given.z, dt=given.dt, rows=given.rows)
