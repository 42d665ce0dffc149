"""The adapter of a batch kernel whose state is named rows: it says which array is which leaf."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from softplc.kernel.batch.frame import Rows
from softplc.observers.axes import AxisPlace
from softplc.observers.kernel import Flags, Given, Numbers


class _Keyed(Protocol):
    @property
    def group_key(self) -> tuple[Any, ...]: ...


def require_one_group(places: Sequence[AxisPlace], configs: Sequence[_Keyed]) -> None:
    """Raises ValueError unless there is one configuration for each place, all with the same `group_key`."""
    if len(places) != len(configs) or len({config.group_key for config in configs}) != 1:
        raise ValueError("expected one configuration for each axis, all with the same group_key")


class RowsKernel:
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
        self._state, self._tuning, self._step = state, tuning, step
        names = {"Position": "y", "Velocity": "y_dot", **estimates}
        self.estimates: Mapping[str, Numbers] = {leaf: getattr(state, name) for leaf, name in names.items()}
        self.tuning: Mapping[str, Numbers] = {leaf: getattr(tuning, name) for leaf, name in tuned.items()}

    @property
    def init(self) -> Flags:
        """Which axes have started."""
        return self._state.init

    def step(self, given: Given) -> NDArray[np.uint8]:
        """One scan of the rows."""
        return self._step(self._state, self._tuning, EnableIn=given.enable, x=given.z, dt=given.dt, rows=given.rows)

    def finite(self) -> Flags:
        """Axes without NaN and infinity in the state."""
        return self._state.finite()

    def clear(self, rows: Flags) -> None:
        """Forget everything about these axes."""
        self._state.clear(rows)

    def predict(self, dt: NDArray[np.float64]) -> tuple[Numbers, Numbers]:
        """Position carried on at the velocity."""
        return self._state.y + self._state.y_dot * dt, self._state.y_dot
