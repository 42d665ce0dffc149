"""What an observer type brings: its kernel's state behind one small interface."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[Any]  # float64[n] or float32[n]
Flags = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Given:
    """What one scan gives to the kernel. Arrays[n] that stay the same objects from scan to scan.

    `z`: measured position, u. `dt`: seconds, above zero where `rows` and `enable` are true, except at a start.
    `rows`: step these; leave the others untouched. `contact`: not 0 while the axis touches its stop, NaN where that
    is not known.
    """

    enable: Flags
    z: NDArray[np.float64]
    dt: NDArray[np.float64]
    rows: Flags
    contact: NDArray[np.float64]


class Kernel(Protocol):
    """n axes of one observer type: adapts `softplc.kernel` to what `AxisObserver` needs.

    A kernel is stepped with what may enter a state: finite, in range, with a measured time step.
    """

    @property
    def init(self) -> Flags:
        """Which axes have started. Cleared from outside where an axis is to start anew with its next sample."""
        ...

    @property
    def estimates(self) -> Mapping[str, Numbers]:
        """Leaf → array[n] after the step: Position, Velocity and each of the model's `estimates` but NIS."""
        ...

    @property
    def tuning(self) -> Mapping[str, Numbers]:
        """Leaf → array[n] of the parameters in use. Changing an entry changes the tuning from the next step on."""
        ...

    def step(self, given: Given) -> NDArray[np.uint8]:
        """One scan of the rows; returns the `kernel.result.Result` of each axis, valid until the next step."""
        ...

    def finite(self) -> Flags:
        """Axes whose state holds no NaN and no infinity; valid until the next call."""
        ...

    def clear(self, rows: Flags) -> None:
        """Forget everything about these axes, as before the first scan."""
        ...

    def predict(self, dt: NDArray[np.float64]) -> tuple[Numbers, Numbers]:
        """Position and velocity carried on by dt seconds from the state, which stays as it is."""
        ...

    def shift(self, rows: Flags, by: NDArray[np.float64]) -> None:
        """The origin of these axes moves: every position in the state, Position too, grows by `by` [n], u."""
        ...

    def coast(self, dt: NDArray[np.float64], rows: Flags) -> bool:
        """Carry the state of these rows on by dt seconds without a measurement, so that its variance grows.

        False, with nothing done, where the state cannot be carried on because it is made of past samples: then
        `predict` says where the axis should be by now, and the next sample is stepped with all the time since the
        last one.
        """
        ...


class BatchState(Protocol):
    """What the adapters need of a batch kernel's state; arrays[n] that stay the same objects."""

    init: Flags
    y: Numbers
    y_dot: Numbers

    def finite(self) -> Flags:
        """Axes without NaN and infinity."""
        ...

    def clear(self, rows: Flags) -> None:
        """As before the first scan."""
        ...

    def shift(self, rows: Flags, by: NDArray[np.float64]) -> None:
        """Every position grows by `by` [n], u."""
        ...


class StateKernel:
    """What the adapters of batch kernels share: the state behind the Kernel protocol, all but its `step`.

    `estimates`: leaf → array of the state, beside Position and Velocity. `tuning`: leaf → array of the tuning.
    """

    def __init__(self, state: BatchState, estimates: Mapping[str, Numbers], tuning: Mapping[str, Numbers]) -> None:
        self._axes = state
        self.estimates: Mapping[str, Numbers] = {"Position": state.y, "Velocity": state.y_dot, **estimates}
        self.tuning: Mapping[str, Numbers] = tuning

    @property
    def init(self) -> Flags:
        """Which axes have started."""
        return self._axes.init

    def finite(self) -> Flags:
        """Axes without NaN and infinity in the state."""
        return self._axes.finite()

    def clear(self, rows: Flags) -> None:
        """Forget everything about these axes."""
        self._axes.clear(rows)

    def predict(self, dt: NDArray[np.float64]) -> tuple[Numbers, Numbers]:
        """Position carried on at the velocity."""
        return self._axes.y + self._axes.y_dot * dt, self._axes.y_dot

    def coast(self, dt: NDArray[np.float64], rows: Flags) -> bool:
        """Not by itself."""
        return False

    def shift(self, rows: Flags, by: NDArray[np.float64]) -> None:
        """The origin of these axes moves by -`by`, u."""
        self._axes.shift(rows, by)
